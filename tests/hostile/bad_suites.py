"""Suites that are not YAML, are invalid, or try to run code."""

import os
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

from bad_arguments import SUITE
from bad_input import BadInput

BASE = """\
suite: small
title: A small suite
episodes: 2
seed: 0
scene:
  profile: charms
  lanes: 3
  traffic_vehicles: 5
  density: 1.0
  ego_slots: 6
  simulation_hz: 15
  decision_hz: 3
  duration_s: 2.0
egos:
  - agent: idm_mobil
traffic_models:
  - traffic: idm_mobil
columns: []
pairs: false
references: []
"""
PREVENTABLE = f"{BASE}preventable_by: idm_mobil\n"
TRAINING = """\
pipeline: charms
title: A small training
seed: 0
hyperparameters:
  learning_rate: 1.0e-4
  batch_size: 32
  discount: 0.99
  replay_buffer: 1000
  learning_starts: 100
  steps_per_gradient_step: 2
  target_update_steps: 500
  exploration_final: 0.05
  max_gradient_norm: 10.0
  hidden_layers: [4]
  scenes: 10
curve_steps: 100
checkpoint_s: 60.0
weights:
  safe: {safety: 1.0, efficiency: 0.8, comfort: 0.2}
stages:
  one:
    steps: 100
    weights: safe
    svo: egoistic
    traffic: level_0
"""
HUGE = "0x" + "f" * 5000
LAUGHS = "a0: &a0 [x, x]\n" + "".join(
    f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}, *a{k - 1}, *a{k - 1}]\n" for k in range(1, 60)
)

NOT_YAML: dict[str, str | bytes] = {
    "empty": "",
    "a comment": "# nothing\n",
    "a word": "suite",
    "a list": "- suite\n",
    "a number": "7",
    "NUL": "suite: \0",
    "an escape sequence": "suite: \x1b[2J",
    "UTF-16": SUITE.encode("utf-16"),
    "no UTF-8": b"suite: \xff\xfe\xfa",
    "half a character": "suite: é".encode()[:-1],
    "a picture": b"\x89PNG\r\n\x1a\n" + bytes(1000),
    "tabs": SUITE.replace("\n", "\n\t"),
    "open bracket": SUITE.replace("2.0,", "[2.0,"),
    "open quote": SUITE.replace("small", '"small'),
    "open brace": SUITE + "{",
    "two documents": SUITE + "---\n" + SUITE,
    "a future version": "%YAML 9.9\n---\n" + SUITE,
    "an unknown directive": "%TAG ! tag:example.com,2000:\n--- !x\n" + SUITE,
    "a billion laughs": LAUGHS + SUITE,
    "an alias of itself": "title: &a [*a]\n" + SUITE,
    "an alias of nothing": "title: *nothing\n" + SUITE,
    "a merge of a number": "<<: 3\n" + SUITE,
    "a key twice": SUITE + "suite: again\n",
    "a list as a key": "? [a, b]\n: c\n" + SUITE,
    "a mapping as a key": "? {a: b}\n: c\n" + SUITE,
    "a null key": "~: c\n" + SUITE,
    "a number as a key": "3: c\n" + SUITE,
    "a key of many digits": "0x" + "f" * 1000 + ": c\n" + SUITE,
    "deep lists": "title: " + "[" * 100_000,
    "deep lists, closed": "title: " + "[" * 50_000 + "]" * 50_000,
    "deep mappings": "title: " + "{a: " * 30_000,
    "deep blocks": "title:\n" + "".join(" " * k + "-\n" for k in range(1, 400)),
    "deep one-line blocks": "title: \n  " + "- " * 30_000,
    "code: apply": "title: !!python/object/apply:os.mkdir [canary]\n" + SUITE,
    "code: new": "title: !!python/object/new:os.mkdir [canary]\n" + SUITE,
    "code: name": "title: !!python/name:os.mkdir\n" + SUITE,
    "code: module": "title: !!python/module:os\n" + SUITE,
    "an int of nothing": "title: !!int ''\n" + SUITE,
    "a float of nothing": "title: !!float ''\n" + SUITE,
    "a bool of neither": "title: !!bool maybe\n" + SUITE,
    "a time of no time": "title: !!timestamp soon\n" + SUITE,
    "bytes": "title: !!binary aGk=\n" + SUITE,
    "no base64": "title: !!binary é\n" + SUITE,
    "a set": "title: !!set {a, b}\n" + SUITE,
    "an own tag": "title: !mine x\n" + SUITE,
    "binary of no digits": "title: 0b_\n" + SUITE,
    "hex of no digits": "title: 0x_\n" + SUITE,
    "an octal seed": "seed: 010\n" + SUITE,
    "a 99th hour": "title: 2001-01-01 99:99:99\n" + SUITE,
    "5,000 digits": "title: " + "9" * 5000 + "\n" + SUITE,
    "5,000 hex digits": f"title: {HUGE}\n" + SUITE,
    "base 60 without end": "title: 1" + ":59" * 20_000 + "\n" + SUITE,
    "the value =": "title: =\n" + SUITE,
    "half a surrogate": SUITE.replace("small", r'"small\uD800"'),
    "half a surrogate as a key": r'"\uDFFF": 1' + "\n" + SUITE,
    "beyond Unicode": r'title: "\U00110000"' + "\n" + SUITE,
    "too large": "#" * 2**20 + "\n" + SUITE,
    "30,000 egos": SUITE.replace("egos: [", "egos: [" + "{agent: level_0}, " * 30_000),
    "20,000 unknown keys": "".join(f"key_{k}: 1\n" for k in range(20_000)) + SUITE,
    "a key of 100,000 letters": "k" * 100_000 + ": 1\n" + SUITE,
    "a pipeline of 100,000 letters": "pipeline: " + "p" * 100_000,
    "no pipeline": "pipeline: nobody",
    "a list of pipelines": "pipeline: [charms]",
    "a pipeline by path": "pipeline: ../charms",
}

_JUNK = ("many", "-1", ".nan", ".inf", "1.5e+308", "[]", "{}", "~", "true", '""', HUGE)
"""None of these is a valid number, except the large one in a field without a limit."""
_NUMBERS = ("episodes", "seed", "lanes", "traffic_vehicles", "ego_slots", "simulation_hz",
            "decision_hz", "duration_s")  # fmt: skip
_TRAINING_NUMBERS = ("batch_size", "discount", "replay_buffer", "steps_per_gradient_step",
                     "hidden_layers", "scenes", "curve_steps", "steps")  # fmt: skip


def _with(text: str, field: str, value: str) -> str:
    """Returns the suite with another value for the first field of that name."""
    lines = text.splitlines(keepends=True)
    at = next(k for k, line in enumerate(lines) if line.lstrip(" -").startswith(f"{field}:"))
    lines[at] = lines[at].partition(f"{field}:")[0] + f"{field}: {value}\n"
    return "".join(lines)


FIELDS = {
    f"{field}: {value[:12]}": _with(text, field, value)
    for text, fields in ((BASE, _NUMBERS), (TRAINING, _TRAINING_NUMBERS))
    for field, value in product(fields, _JUNK)
    if (field, value) != ("hidden_layers", "[]")
}


def _scenario(lane: str = "1", points: str = "sobol", range: str = "[0, 1]", more: str = "") -> str:
    """Returns a scenario with a wrong value."""
    at = f"{{name: a, lane: {lane}, x_m: 50, speed_mps: 25{', ' * bool(more)}{more}}}"
    ego = "ego: {lane: 0, speed_mps: 25}"
    parameters = f"parameters: {{p: {range}}}, points: {points}"
    return f"{{scenario: {{{parameters}, {ego}, vehicles: [{at}]}}}}"


_VALUES: tuple[tuple[str, str, Sequence[str]], ...] = (
    (BASE, "suite", ("../up", "/etc/passwd", "..", "a/b", "-x", '"a\\n"', "x" * 65, "[]", "~")),
    (BASE, "density", ("-1", "0", ".nan", ".inf", "1.0e-300", "1.0e+300", "[]", "true")),
    (BASE, "profile", (
        "nobody", "[]", "7", "x" * 50_000, "{}", "{name: nobody}", "{name: charms, wings: 2}",
        "{name: charms, lane_width_m: 0}", "{name: charms, lane_width_m: .nan}",
        "{name: charms, lane_width_m: 1.0e+300}", "{name: charms, lane_width_m: 1.0e-300}",
        "{name: charms, road_length_m: 1.0e+308}", "{name: charms, speed_limit_mps: 1.0e+308}",
        "{name: charms, vehicle_length_m: 1.0e+308}", "{name: charms, tau_lateral_s: 1.0e-308}",
        "{name: charms, target_speeds_mps: [.nan, .nan]}",
        "{name: charms, target_speeds_mps: [.inf, .inf]}",
        "{name: charms, target_speeds_mps: [20.0]}",
        "{name: charms, target_speeds_mps: [30.0, 20.0]}",
        "{name: charms, target_speed_steps_mps: [1.0]}",
        "{name: charms, target_speed_steps_mps: [0.25, 0.0]}",
        "{name: highway-env, target_speed_steps_mps: [0.25, 0.5]}",
        "{name: charms, speed_min_mps: 34}", "{name: charms, idm_mobil: {politeness: -1}}",
        "{name: charms, idm_mobil: 3}", "{name: charms, idm_mobil: {exponent_low: 1.0e+308}}",
    )),
    (BASE, "egos", ("[]", "3", "{}", "[3]", "[[]]", "[{}]", "[{agent: idm_mobil, agent2: x}]")),
    (BASE, "agent", (
        "nobody", "7", "[]", "{}", "~", '""', "x" * 81, "{name: idm_mobil, onnx: x}",
        "{name: idm_mobil, decision_hz: 3}", "{name: idm_mobil, options: {wings: 2}}",
        "{name: idm_mobil, options: {'a b': 2}}", "{name: idm_mobil, options: {3: 2}}",
        "{name: idm_mobil, options: [1]}", f"{{name: outside_explorer, options: {{seed: {HUGE}}}}}",
        "{onnx: nowhere.onnx}", "{onnx: .}", '{onnx: ""}', "{onnx: 7}", "{onnx: /etc/passwd}",
        r'{onnx: "a\0b"}', r'{onnx: "\e[2Jx"}', "{onnx: /dev/zero}", "{onnx: /dev/null}",
        "{onnx: /proc/self/mem}", "{onnx: " + "x" * 100_000 + "}", "{onnx: " + "../" * 2000 + "x}",
        "{onnx: https://example.com/policy.onnx}", "{onnx: x, decision_hz: 0}", "nowhere.onnx",
        "{onnx: nowhere.onnx, decision_hz: 0}", "{name: nowhere.onnx, options: {a: 1}}",
        "{onnx: x, decision_hz: .nan}", "{onnx: x, options: {a: 1}}",
        r'"idm_mobil\e[31m"', r'"idm_mobil\u202E"',
    )),
    (BASE, "traffic", (
        "nobody", "7", "[]", "{}", "{mixture: {}}", "{mixture: [idm_mobil]}",
        "{mixture: {idm_mobil: 0.5}}", "{mixture: {idm_mobil: .nan}}", "{mixture: {idm_mobil: 2}}",
        "{mixture: {idm_mobil: -1, level_0: 1}}", "{mixture: {nobody: 1.0}}",
        "{name: idm_mobil, mixture: {idm_mobil: 1.0}}", "{name: idm_mobil, options: {tau: 1}}",
        "{name: pch, options: {tau: .nan}}", "{name: pch, options: {tau: 1.0e+308}}",
        f"{{name: pch, options: {{tau: {HUGE}}}}}", "{name: pch, options: {beta: [1]}}",
        "{name: pch, options: {tau: 2001-01-01}}", "nowhere.onnx", "/dev/zero", "{onnx: /dev/zero}",
        "{mixture: {nowhere.onnx: 1.0}}", '{mixture: {"a\\0b.onnx": 1.0}}', "{onnx: nowhere.onnx}",
        "../" * 2000 + "x.onnx", "{mixture: {" + "../" * 2000 + "x.onnx: 1.0}}",
        "{name: nowhere.onnx, options: {a: 1}}", "{onnx: nowhere.onnx, decision_hz: 3}",
        "{name: pch, options: {styles: 3}}", "{name: pch, options: {styles: {kind: level_0}}}",
        "{name: pch, options: {styles: {safe-egoistic: 3}}}",
        "{name: pch, options: {styles: {safe-egoistic: nowhere.onnx}}}",
        '{name: pch, options: {styles: {safe-egoistic: "a\\e[2J.onnx"}}}',
        "{name: pch, options: {styles: {safe-egoistic: " + "x" * 9000 + ".onnx}}}",
        "{scenario: 3}", "{scenario: {}}", _scenario(lane="5"), _scenario(lane="99"),
        _scenario(lane=".nan"), _scenario(lane='"1 / 0"'), _scenario(lane='"__import__"'),
        _scenario(lane='"' + "(" * 99 + '"'), _scenario(lane='"' + "-" * 99 + '"'),
        _scenario(lane='"p ** p"'), _scenario(lane='"0x' + "f" * 90 + '"'),
        _scenario(points="[]"), _scenario(points="[{p: 7}]"), _scenario(points="often"),
        _scenario(points="{latin_hypercube: 0}"), _scenario(points="{latin_hypercube: .inf}"),
        _scenario(range="[2, 1]"), _scenario(range="[1]"), _scenario(range="[.nan, 1]"),
        _scenario(range="{range: [0, 1], normal: [0.5, 0]}"), _scenario(more="agent: nobody"),
        _scenario(more="agent: /dev/zero"), _scenario(more="behind: ego"),
        _scenario(more="actions: [{at_s: -1, acceleration_mps2: 1}]"),
        _scenario(more="actions: [{at_s: 1, acceleration_mps2: 1.0e+300}]"),
        _scenario(more="actions: [{at_s: 0, lane: 1, duration_s: 0}]"),
        _scenario(more="actions: [{at_s: 0, lane: -1, duration_s: 1}]"),
    )),
    (PREVENTABLE, "preventable_by", ("nobody", "3", "[3]", "[idm_mobil, idm_mobil]")),
    (BASE, "columns", ("[nothing]", "[3]", "nothing", "[" + "x" * 50_000 + "]")),
    (BASE, "pairs", ("true", "3", '"yes"')),
    (BASE, "references", (
        "[nobody]", "[{recordings: nowhere}]", "[{recordings: suite.yaml}]", "[i24, i24]",
        "[{recordings: /dev/zero}]", r'[{recordings: "a\0b"}]', "[{}]", "[3]",
        "[../references/i24]",
    )),
    (BASE, "title", ("3", "[]", "~", r'"\e]0;owned\a"')),
    (TRAINING, "pipeline", ("Charms", "charms.training")),
    (TRAINING, "weights", ("{}", "[]", "{Safe: {}}", "{safe: {safety: .nan}}")),
    (TRAINING, "svo", ("kind", "3", "[]")),
    (TRAINING, "learning_rate", ("0", ".nan", "-1", ".inf", "fast")),
    (TRAINING, "hidden_layers", (
        "[1000000000, 1000000000]", "[-4]", "[4.5]", "[" + "4, " * 9 + "4]", "4"
    )),
    (TRAINING, "replay_buffer", ("1000000000",)),
    (TRAINING, "batch_size", ("1000000000",)),
    (TRAINING, "checkpoint_s", ("0", ".nan", "often")),
    (TRAINING, "traffic", (
        "{}", "nobody", "one", "3", "[level_0]", "{agent: level_0}", "{mixture: {nobody: 1}}",
        "{mixture: {level_0: 0.5}}", "{mixture: {level_0: .nan}}", "{mixture: {one: 1}}",
        "{name: level_0, mixture: {level_0: 1}}", "{name: level_0, options: {speed: 3}}",
    )),
    (TRAINING, "steps", ("101",)),
)  # fmt: skip

VALUES = {
    f"{field}: {value[:200]}": _with(text, field, value)
    for text, field, values in _VALUES
    for value in values
}
MORE = {
    "its own folder": BASE + "folder: /etc\n",
    "an unknown key": BASE + "suiet: x\n",
    "a metric nobody knows": BASE.replace("idm_mobil\nt", "idm_mobil\n    paper: {x: 1}\nt"),
    "a paper's infinity": BASE.replace(
        "idm_mobil\nt", "idm_mobil\n    paper: {speed_mean: .inf}\nt"
    ),
    "two egos of one name": BASE.replace("idm_mobil\nt", "idm_mobil\n  - agent: idm_mobil\nt"),
    "a label of two lines": BASE.replace("idm_mobil\nt", 'idm_mobil\n    label: "a\\nb"\nt'),
    "a label that clears the screen": BASE.replace(
        "idm_mobil\nt", 'idm_mobil\n    label: "\\e[2J"\nt'
    ),
    "300 egos in 300 traffics": BASE.replace(
        "  - agent: idm_mobil\n",
        "".join(f"  - {{agent: idm_mobil, label: e{k}}}\n" for k in range(300)),
    ).replace(
        "  - traffic: idm_mobil\n",
        "".join(f"  - {{traffic: idm_mobil, label: t{k}}}\n" for k in range(300)),
    ),
    "ten thousand million episodes": BASE.replace("episodes: 2", "episodes: 10000000").replace(
        "  - agent: idm_mobil\n",
        "".join(f"  - {{agent: idm_mobil, label: e{k}}}\n" for k in range(90)),
    ),
    "a stage like itself": TRAINING + "  two: {like: two}\n",
    "a stage like one that is like another": TRAINING + "  two: {like: one}\n  six: {like: two}\n",
    "a stage like a list": TRAINING + "  two: {like: [one]}\n",
    "a stage by path": TRAINING + "  ../two: {like: one}\n",
    "stages that need each other": TRAINING
    + "  two: {like: one, traffic: six}\n  six: {like: one, traffic: two}\n",
    "5,000 stages": TRAINING
    + "".join(f"  s{k}: {{like: one, traffic: one}}\n" for k in range(5000)),
    "no human recordings": TRAINING + "human: {recordings: nowhere, stages: {two: {}}}\n",
    "human recordings with a NUL": TRAINING + 'human: {recordings: "a\\0b", stages: {two: {}}}\n',
    "a human stage that is there": TRAINING + "human: {recordings: ., stages: {one: {}}}\n",
    "a human stage from nothing": TRAINING
    + "human: {recordings: ., stages: {two: {fine_tunes: six}}}\n",
    "10^9 epochs of batches of 10^9": TRAINING
    + "human: {recordings: ., stages: {two: {settings: {batch_size: 1000000000}}}}\n",
}


def _bad(title: str, text: str | bytes) -> BadInput:
    def make(folder: Path) -> Sequence[str]:
        path = folder / "suite.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return "run", "suite.yaml", "--output", "run"

    return BadInput(f"suite: {title}", make)


def _special(title: str, make_file: Callable[[Path], object]) -> tuple[BadInput, BadInput]:
    """A special file, given as a suite and as a network."""

    def as_suite(folder: Path) -> Sequence[str]:
        make_file(folder / "special")
        return "run", "special"

    def as_network(folder: Path) -> Sequence[str]:
        make_file(folder / "special.onnx")
        (folder / "suite.yaml").write_text(_with(BASE, "agent", "special.onnx"))
        return "run", "suite.yaml"

    return BadInput(f"{title} as a suite", as_suite), BadInput(f"{title} as a network", as_network)


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


SPECIAL = (
    *_special("a pipe", os.mkfifo),
    *_special("a folder", Path.mkdir),
    *_special("a link to itself", lambda path: path.symlink_to(path)),
    *_special("a link to /dev/zero", lambda path: path.symlink_to("/dev/zero")),
    *_special("a file of a terabyte", _sparse),
    *_special("an empty file", Path.touch),
)
CASES = tuple(_bad(*case) for case in {**NOT_YAML, **FIELDS, **VALUES, **MORE}.items()) + SPECIAL

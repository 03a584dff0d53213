"""Suites that are not YAML, are invalid, or try to run code."""

import os
from collections.abc import Callable, Sequence
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
    "NUL": "suite: \0",
    "an escape sequence": "suite: \x1b[2J",
    "half a character": "suite: é".encode()[:-1],
    "tabs": SUITE.replace("\n", "\n\t"),
    "open quote": SUITE.replace("small", '"small'),
    "two documents": SUITE + "---\n" + SUITE,
    "a future version": "%YAML 9.9\n---\n" + SUITE,
    "a billion laughs": LAUGHS + SUITE,
    "a list as a key": "? [a, b]\n: c\n" + SUITE,
    "a number as a key": "3: c\n" + SUITE,
    "deep lists": "title: " + "[" * 100_000,
    "code: apply": "title: !!python/object/apply:os.mkdir [canary]\n" + SUITE,
    "base 60 without end": "title: 1" + ":59" * 20_000 + "\n" + SUITE,
    "half a surrogate": SUITE.replace("small", r'"small\uD800"'),
    "beyond Unicode": r'title: "\U00110000"' + "\n" + SUITE,
    "a key of 100,000 letters": "k" * 100_000 + ": 1\n" + SUITE,
    "a pipeline of 100,000 letters": "pipeline: " + "p" * 100_000,
    "a pipeline by path": "pipeline: ../charms",
}


def _with(text: str, field: str, value: str) -> str:
    """Returns the suite with another value for the first field of that name."""
    lines = text.splitlines(keepends=True)
    at = next(k for k, line in enumerate(lines) if line.lstrip(" -").startswith(f"{field}:"))
    lines[at] = lines[at].partition(f"{field}:")[0] + f"{field}: {value}\n"
    return "".join(lines)


def _scenario(lane: str = "1", points: str = "sobol", range: str = "[0, 1]", more: str = "") -> str:
    """Returns a scenario with a wrong value."""
    at = f"{{name: a, lane: {lane}, x_m: 50, speed_mps: 25{', ' * bool(more)}{more}}}"
    ego = "ego: {lane: 0, speed_mps: 25}"
    parameters = f"parameters: {{p: {range}}}, points: {points}"
    return f"{{scenario: {{{parameters}, {ego}, vehicles: [{at}]}}}}"


_VALUES: tuple[tuple[str, str, Sequence[str]], ...] = (
    (BASE, "suite", ("../up", "[]")),
    (BASE, "seed", (HUGE,)),
    (BASE, "duration_s", ("many", ".nan", ".inf", "1.5e+308")),
    (BASE, "profile", (
        "nobody", "[]", "{}", "{name: charms, target_speeds_mps: [.inf, .inf]}",
        "{name: charms, target_speeds_mps: [20.0]}", "{name: charms, vehicle_length_m: 1.0e+9}",
        "{name: charms, target_speeds_mps: [30.0, 20.0]}",
        "{name: charms, target_speed_steps_mps: [1.0]}",
        "{name: charms, target_speed_steps_mps: [0.25, 0.0]}",
        "{name: highway-env, target_speed_steps_mps: [0.25, 0.5]}",
        "{name: charms, speed_min_mps: 34}", "{name: charms, idm_mobil: {politeness: -1}}",
    )),
    (BASE, "agent", (
        '""', "{name: idm_mobil, options: {wings: 2}}",
        "{name: idm_mobil, options: {3: 2}}", "{name: idm_mobil, options: [1]}",
        "{onnx: nowhere.onnx}", r'{onnx: "a\0b"}', "{onnx: /dev/zero}",
        "{onnx: " + "../" * 2000 + "x}", "{onnx: nowhere.onnx, decision_hz: 0}",
        r'"idm_mobil\e[31m"', r'"idm_mobil\u202E"',
    )),
    (BASE, "traffic", (
        "nobody", "{}", "{mixture: {idm_mobil: 0.5}}", "{mixture: {idm_mobil: .nan}}",
        "{mixture: {nobody: 1.0}}", "{name: idm_mobil, options: {tau: 1}}",
        "{name: pch, options: {tau: .nan}}", "{name: pch, options: {tau: 1.0e+308}}",
        "{name: pch, options: {beta: [1]}}", "{name: pch, options: {tau: 2001-01-01}}",
        '{mixture: {"a\\0b.onnx": 1.0}}', "../" * 2000 + "x.onnx",
        "{name: pch, options: {styles: 3}}", "{name: pch, options: {styles: {kind: level_0}}}",
        "{name: pch, options: {styles: {safe-egoistic: 3}}}",
        "{name: pch, options: {styles: {safe-egoistic: nowhere.onnx}}}", "{scenario: {}}",
        _scenario(lane=".nan"),
        _scenario(lane='"__import__"'), _scenario(lane='"' + "(" * 99 + '"'),
        _scenario(lane='"p ** p"'), _scenario(points="[]"), _scenario(points="often"),
        _scenario(more="agent: nobody"),
    )),
    (PREVENTABLE, "preventable_by", ("nobody", "[idm_mobil, idm_mobil]")),
    (BASE, "columns", ("[nothing]",)),
    (BASE, "pairs", ("true", "3")),
    (BASE, "references", (
        "[{recordings: nowhere}]", "[{recordings: suite.yaml}]", "[{recordings: /dev/zero}]",
        r'[{recordings: "a\0b"}]',
    )),
    (BASE, "title", (r'"\e]0;owned\a"',)),
    (TRAINING, "weights", ("{Safe: {}}", "{safe: {safety: .nan}}")),
    (TRAINING, "svo", ("kind",)),
    (TRAINING, "learning_rate", ("0", ".nan")),
    (TRAINING, "hidden_layers", ("many", "[1000000000, 1000000000]", "[" + "4, " * 9 + "4]")),
    (TRAINING, "traffic", ("nobody", "{mixture: {nobody: 1}}")),
    (TRAINING, "steps", ("101",)),
)  # fmt: skip

VALUES = {
    f"{field}: {value[:200]}": _with(text, field, value)
    for text, field, values in _VALUES
    for value in values
}
MORE = {
    "its own folder": BASE + "folder: /etc\n",
    "two egos of one name": BASE.replace("idm_mobil\nt", "idm_mobil\n  - agent: idm_mobil\nt"),
    "ten thousand million episodes": BASE.replace("episodes: 2", "episodes: 10000000").replace(
        "  - agent: idm_mobil\n",
        "".join(f"  - {{agent: idm_mobil, label: e{k}}}\n" for k in range(90)),
    ),
    "a stage like itself": TRAINING + "  two: {like: two}\n",
    "a stage like a list": TRAINING + "  two: {like: [one]}\n",
    "stages that need each other": TRAINING
    + "  two: {like: one, traffic: six}\n  six: {like: one, traffic: two}\n",
    "no human recordings": TRAINING + "human: {recordings: nowhere, stages: {two: {}}}\n",
    "a human stage that is there": TRAINING + "human: {recordings: ., stages: {one: {}}}\n",
    "a human stage from nothing": TRAINING
    + "human: {recordings: ., stages: {two: {fine_tunes: six}}}\n",
}


def _bad(title: str, text: str | bytes) -> BadInput:
    def make(folder: Path) -> Sequence[str]:
        path = folder / "suite.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return "run", "suite.yaml", "--output", "run"

    return BadInput(f"suite: {title}", make)


def _special(title: str, make_file: Callable[[Path], object]) -> tuple[BadInput, ...]:
    """A special file, given as a suite, as a network and as a road."""

    def as_suite(folder: Path) -> Sequence[str]:
        make_file(folder / "special")
        return "run", "special"

    def as_network(folder: Path) -> Sequence[str]:
        make_file(folder / "special.onnx")
        (folder / "suite.yaml").write_text(_with(BASE, "agent", "special.onnx"))
        return "run", "suite.yaml"

    def as_road(folder: Path) -> Sequence[str]:
        make_file(folder / "special")
        (folder / "suite.yaml").write_text(f"{BASE}roads:\n  - file: special\n")
        return "run", "suite.yaml"

    return (
        BadInput(f"{title} as a suite", as_suite),
        BadInput(f"{title} as a network", as_network),
        BadInput(f"{title} as a road", as_road),
    )


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
CASES = tuple(_bad(*case) for case in {**NOT_YAML, **VALUES, **MORE}.items()) + SPECIAL

"""The plan of docs/training-plan.md: trains its networks and drives them in its test.

NETWORKS is a folder that gets `seed-SEED/NETWORK.onnx` with manifests and learning curves.
RECORDINGS holds those of US-101 in highD's format. RUNS gets the run folders of the test. What is
finished is not done again, and what was interrupted continues.

    python tools/plan.py train NETWORKS RECORDINGS ego 3010 3011
    python tools/plan.py test NETWORKS RUNS main density-1.5
"""

import argparse
import itertools
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import yaml

import charms_bench

ROOT = Path(__file__).resolve().parent.parent
SUITE = ROOT / "suites" / "train.yaml"
EGO = "charms_efficient_egoistic"
STYLES = [
    f"{priority}_{svo}"
    for priority in ("efficient", "safe")
    for svo in ("competitive", "egoistic", "prosocial", "altruistic")
]
ALGORITHMS = ("dqn", "ppo")
PAPER = ROOT / "suites" / "train-paper.yaml"


def no_brake(suite: dict[str, Any]) -> None:
    """Without BRAKE."""
    del suite["actions"]


def no_prior(suite: dict[str, Any]) -> None:
    """Without the cost of what people seldom do."""
    del suite["stages"]["efficient_egoistic"]["prior"]


def level_0(suite: dict[str, Any]) -> None:
    """As Level-1: among Level-0 drivers only."""
    suite["stages"]["efficient_egoistic"]["conditions"] = ["level_0", "level_0", "hazards"]


ABLATIONS: dict[str, Callable[[dict[str, Any]], None]] = {
    "no-brake": no_brake, "no-prior": no_prior, "level-0": level_0,
}  # fmt: skip
SEEDS = range(3010, 3020)
"""The training seeds; of styles and ablations, the first five."""

FIRST_EPISODE, EPISODES = 607_118_000, 6_000
SCENE = {"profile": "charms", "lanes": 3, "traffic_vehicles": 20, "density": 1.0, "ego_slots": 6}
HUMAN = {"traffic": "human", "label": "Human (I-75)"}
IDM_MOBIL = {"traffic": "idm_mobil", "label": "IDM+MOBIL"}
BOTH = [HUMAN, IDM_MOBIL]
OTHERS = [
    {"traffic": "stackelberg", "label": "Stackelberg"},
    {"traffic": "imitation", "label": "Imitation Learning"},
    {"traffic": {"mixture": {"prior_level_k": 0.5, "prior_level_k_safe": 0.5}},
     "label": "Prior Level-k"},
    {"traffic": {"name": "pch", "options": {"tau": 1.5, "beta": 0.5}}, "label": "CHARMS (PCH)"},
]  # fmt: skip
HELD_OUT = (  # beyond the ranges of `hazards` in the training suite, one parameter each
    ("slow", 0, {"gap_m": [35, 50]}),
    ("cut-in", 1, {"slower_mps": [12, 16]}),
    ("cut-out", 2, {"gap_m": [10, 20]}),
    ("braking", 4, {"braking_mps2": [9, 11]}),
)
RULES = [
    {"agent": "idm_mobil", "label": "IDM+MOBIL"},
    *({"agent": {"name": "mutant", "options": {"headway": each}},
       "label": f"IDM+MOBIL, headway x {each:g}"} for each in (0.8, 0.6, 0.4, 0.2)),
    {"agent": {"name": "mutant", "options": {"headway": 0.2, "imposes_mps2": 4.5}},
     "label": "IDM+MOBIL, tuned"},
    {"agent": "human", "label": "Human (I-75)"},
]  # fmt: skip
"""Egos without training. The front of IDM+MOBIL by its time headway stands beside CHARMS."""


def train(networks: Path, recordings: Path, what: str, seed: int) -> None:
    """Trains the networks of a seed and puts them into its folder."""
    folder = networks / f"seed-{seed}"
    if what in ALGORITHMS:
        tool = ROOT / "tools" / "train_stable_baselines3.py"
        _call(sys.executable, tool, SUITE, "efficient_egoistic", what, networks, seed)
        return
    file = PAPER if what == "paper" else SUITE
    suite = yaml.safe_load(file.read_text(encoding="utf-8"))
    if what in ABLATIONS:
        ABLATIONS[what](suite)
    stages: dict[str, str | None] = {EGO: what}
    if what in ("ego", "styles"):
        stages = dict.fromkeys([EGO] if what == "ego" else [f"charms_{each}" for each in STYLES])
    run = folder / "trainings" / ("styles" if what == "ego" else what)
    run.mkdir(parents=True, exist_ok=True)
    for done in (folder / "trainings" / "styles").iterdir() if what in ABLATIONS else ():
        if done.name.startswith(("level_1-", "people-", "samples")):  # equal ones have equal names
            shutil.copytree(done, run / done.name, dirs_exist_ok=True)
    file = written(suite, folder / f"{what}.yaml")
    for stage, name in stages.items():
        if not (folder / f"{name or stage}.json").exists():
            given = ("--only", stage, "--output", run, "--recordings", recordings, "--workers", 1)
            _call("charms-bench", "run", file, "--seed", seed, *given)
            made = (run / "networks").iterdir()
            for trained in sorted(made, key=lambda each: each.suffix == ".json"):
                kept = trained.name.replace(stage, name) if name else trained.name
                if name is None or trained.stem == stage:
                    shutil.copy(trained, folder / kept)


def drive(networks: Path, runs: Path, name: str) -> None:
    """Drives one of the tests."""
    charms_bench.run(write_test(networks, runs, name), runs / name)


def write_test(networks: Path, runs: Path, name: str) -> Path:
    """Writes the suite of a test, with the networks that are there."""
    suite = TESTS[name](networks.resolve())
    suite = {"seed": FIRST_EPISODE, "episodes": EPISODES} | suite | {"suite": name}
    runs.mkdir(parents=True, exist_ok=True)
    return written(suite, runs / f"{name}.yaml")


def _found(networks: Path, name: str, label: str, seeds: Iterable[int]) -> list[dict[str, Any]]:
    """The networks of seeds as egos."""
    paths = {seed: networks / f"seed-{seed}" / f"{name}.onnx" for seed in seeds}
    return [
        {"agent": str(path), "label": f"{label}, seed {seed}"}
        for seed, path in paths.items()
        if path.exists()
    ]


def _charms(networks: Path) -> list[dict[str, Any]]:
    return RULES + _found(networks, EGO, "CHARMS", SEEDS)


def _main(networks: Path) -> dict[str, Any]:
    """All networks but the styles."""
    egos = _charms(networks)
    egos += _found(networks, EGO.removeprefix("charms_"), "Before fine-tuning", SEEDS)
    for algorithm in ALGORITHMS:
        egos += _found(networks, algorithm, algorithm.upper(), SEEDS)
    for name, without in ABLATIONS.items():
        egos += _found(networks, name, (without.__doc__ or "").rstrip("."), SEEDS)
    egos += _found(networks, "paper", "CHARMS by the paper", SEEDS)
    return {"scene": SCENE, "egos": egos, "traffic_models": BOTH}


def _hazards(networks: Path) -> dict[str, Any]:
    """The hazards that are held out."""
    found = yaml.safe_load(SUITE.read_text(encoding="utf-8"))["conditions"]["hazards"]
    models = []
    for label, k, held_out in HELD_OUT:
        found[k]["traffic"]["scenario"]["parameters"] |= held_out
        models.append({"label": label, "traffic": found[k]["traffic"]})
    profile = {**found[0]["profile"], "ego_control_rate": "simulation"}
    scene = {"profile": profile, "lanes": 3, "simulation_hz": 30, "duration_s": 14.0}
    return {"scene": scene, "egos": _charms(networks), "traffic_models": models}


def _r157(networks: Path) -> dict[str, Any]:
    """The suite `r157` at other points, with its rules and CHARMS."""
    suite = yaml.safe_load((ROOT / "suites" / "r157.yaml").read_text(encoding="utf-8"))
    egos = suite["egos"][:3] + _found(networks, EGO, "CHARMS", SEEDS)
    return {**suite, "seed": FIRST_EPISODE, "egos": egos}


def _trials(networks: Path) -> dict[str, Any]:
    """The episodes by which the trials of DQN and PPO are compared, `NETWORKS/trials/NAME`."""
    found = sorted(networks.glob("trials/*/seed-*/*.json"))
    egos = [{"agent": str(each.with_suffix(".onnx")), "label": each.parts[-3]} for each in found]
    common = {"seed": 970_000_000, "episodes": 600, "scene": SCENE}
    return common | {"egos": RULES[:1] + egos, "traffic_models": BOTH}


def _validation(networks: Path) -> dict[str, Any]:
    """The episodes by which, with the likeness to drivers, the seed that ships is selected."""
    egos = _found(networks, EGO, "CHARMS", SEEDS)
    common = {"seed": 962_000_000, "episodes": 1_500, "scene": SCENE}
    return common | {"egos": egos, "traffic_models": BOTH}


def _styles(networks: Path) -> dict[str, Any]:
    """The styles as egos, before and after fine-tuning."""
    egos = []
    for style in STYLES:
        egos += _found(networks, f"charms_{style}", style, SEEDS[:5])
        egos += _found(networks, style, f"{style} before fine-tuning", SEEDS[:5])
    return {"scene": SCENE, "egos": egos, "traffic_models": [IDM_MOBIL]}


def _style_traffic(networks: Path) -> dict[str, Any]:
    """Each style alone in all other vehicles."""
    models = [
        {"traffic": each["agent"], "label": each["label"]}
        for style in STYLES
        for each in _found(networks, f"charms_{style}", style, SEEDS[:5])
    ]
    return {"episodes": 300, "scene": SCENE, "egos": RULES[:1], "traffic_models": models}


def _pch(networks: Path) -> dict[str, Any]:
    """Traffic of the styles by tau and beta."""
    models = []
    for seed in SEEDS[:5]:
        folder = networks / f"seed-{seed}"
        styles = {each.replace("_", "-"): str(folder / f"charms_{each}.onnx") for each in STYLES}
        for tau, beta in itertools.product((0.5, 1.5, 3.0), (0.0, 0.5, 1.0)):
            options = {"tau": tau, "beta": beta, "styles": styles}
            label = f"tau {tau:g}, beta {beta:g}, seed {seed}"
            models.append({"traffic": {"name": "pch", "options": options}, "label": label})
    return {"episodes": 300, "scene": SCENE, "egos": RULES[:1], "traffic_models": models}


def _in(scene: dict[str, Any], models: list[dict[str, Any]]) -> Callable[[Path], dict[str, Any]]:
    def suite(networks: Path) -> dict[str, Any]:
        return {"scene": SCENE | scene, "egos": _charms(networks), "traffic_models": models}

    return suite


TESTS: dict[str, Callable[[Path], dict[str, Any]]] = {
    "trials": _trials,
    "validation": _validation,
    "main": _main,
    "density-1-5": _in({"density": 1.5}, BOTH),
    "density-2": _in({"density": 2.0}, BOTH),
    "lanes-2": _in({"lanes": 2}, BOTH),
    "lanes-4": _in({"lanes": 4}, BOTH),
    "lanes-5": _in({"lanes": 5}, BOTH),
    "others": _in({}, OTHERS),
    "sealed-density": _in({"density": 1.75}, BOTH),
    "sealed-lanes": _in({"lanes": 6}, BOTH),
    "sealed-traffic": _in({}, [{"traffic": "gipps", "label": "Gipps"}]),
    "sealed-hazards": _hazards,
    "sealed-r157": _r157,
    "styles": _styles,
    "style-traffic": _style_traffic,
    "pch": _pch,
}
"""The suite of each test, for a folder of networks."""
TUNING = ("trials", "validation")
"""Suites that select networks, and are not tests."""


class _Plain(yaml.SafeDumper):
    """Writes equal parts in full, because suites have no aliases."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def written(suite: dict[str, Any], file: Path) -> Path:
    file.write_text(yaml.dump(suite, Dumper=_Plain, sort_keys=False), encoding="utf-8")
    return file


def _call(*command: object) -> None:
    subprocess.run([str(each) for each in command], check=True)


def main() -> None:
    """Trains or tests what the arguments name."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    training = commands.add_parser("train")
    training.add_argument("networks", type=Path)
    training.add_argument("recordings", type=Path)
    training.add_argument("what", choices=("ego", "styles", "paper", *ALGORITHMS, *ABLATIONS))
    training.add_argument("seeds", type=int, nargs="+")
    testing = commands.add_parser("test")
    testing.add_argument("networks", type=Path)
    testing.add_argument("runs", type=Path)
    testing.add_argument("tests", nargs="*", help=", ".join(TESTS))
    given = parser.parse_args()
    if given.command == "train":
        for seed in given.seeds:
            train(given.networks, given.recordings, given.what, seed)
    else:
        for each in given.tests or [name for name in TESTS if name not in TUNING]:
            drive(given.networks, given.runs, each)


if __name__ == "__main__":
    main()

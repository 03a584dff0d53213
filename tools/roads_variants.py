"""The variants of CHARMS for all roads that `roads_ablations` trains."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from plan_roads import SEED
from result_pages import ROOT

SUITE = ROOT / "suites" / "train-roads-self-play.yaml"
STEPS_OF_LEVEL_1, STEPS = 57_600, 300_160
"""The second are those of all stages together."""
COMPLETE, ONE_STYLE = "CHARMS", "one style"
Document = dict[str, Any]


def without_self_play(suite: Document) -> None:
    """The others drive in the same scenes in place of the network itself."""
    for condition in suite["conditions"]["own_network"]:
        del condition["traffic"]


def in_the_egos_place(suite: Document) -> None:
    for conditions in suite["conditions"].values():
        for condition in conditions:
            condition.pop("ego_slots", None)


def without_exit_lanes(suite: Document) -> None:
    suite["observation"] = "interaction"


def without_level_1(suite: Document) -> None:
    del suite["stages"]["level_1"]
    suite["stages"]["roads"] |= {"traffic": "yielding_human", "steps": STEPS}


def by_self_play_alone(suite: Document) -> None:
    """Where agents drive the others, they are the network itself."""
    without_level_1(suite)
    suite["stages"]["roads"]["traffic"] = "roads"


def among_level_0(suite: Document) -> None:
    without_level_1(suite)
    without_self_play(suite)


def without_svo(suite: Document) -> None:
    styles = suite["stages"]["roads"]["styles"]
    for name in [name for name in styles if not name.endswith("_egoistic")]:
        del styles[name]


def one_style(suite: Document) -> None:
    styles = suite["stages"]["roads"]["styles"]
    for name in [*styles][1:]:
        del styles[name]


def without_prior(suite: Document) -> None:
    for stage in suite["stages"].values():
        del stage["prior"]
    del suite["human"]


def without_brake(suite: Document) -> None:
    suite["actions"].pop()


VARIANTS: dict[str, Callable[[Document], None]] = {
    COMPLETE: lambda suite: None,
    "without self-play": without_self_play,
    "without Level-1 in the traffic": without_level_1,
    "self-play alone": by_self_play_alone,
    "among Level-0 drivers alone": among_level_0,
    "in the ego's place alone": in_the_egos_place,
    "without the lanes of exits": without_exit_lanes,
    "without SVO": without_svo,
    ONE_STYLE: one_style,
    "without the prior": without_prior,
    "without BRAKE": without_brake,
}


def written(folder: Path, name: str, seed: int) -> Path:
    """The suite of a variant with a seed."""
    suite = yaml.safe_load(SUITE.read_text(encoding="utf-8")) | {"seed": seed}
    stages = suite["stages"]
    stages["level_1"]["steps"] = STEPS_OF_LEVEL_1
    stages["roads"]["steps"] = STEPS - STEPS_OF_LEVEL_1
    VARIANTS[name](suite)
    file = folder / f"{name}{SEED}{seed}.yaml"
    file.write_text(yaml.safe_dump(suite, sort_keys=False), encoding="utf-8")
    return file

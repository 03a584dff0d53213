"""Drives the networks of docs/training-plan-roads.md in the tests of the plan.

    python tools/plan_roads.py NETWORKS RUNS [TEST ...]

NETWORKS/SEED is the run folder of the training with that seed, and RUNS gets that of each test.
What is finished is not driven again. `write_results.py plan-roads` writes what they do.
"""

import json
import sys
from pathlib import Path
from typing import Any

import yaml
from result_pages import ROOT

import charms_bench

CHARMS, LEVEL_1 = "CHARMS", "Level-1"
SEED = ", seed "
"""Stands between the label of a training configuration and its seed."""
STYLES = [f"{priority}_{svo}" for priority in ("efficient", "safe")
          for svo in ("egoistic", "competitive", "prosocial", "altruistic")]  # fmt: skip
"""The first is CHARMS wherever not all of them drive."""
OF_STYLES = "styles"
"""The test in which all of them do."""
OF_LEVELS = "levels"
"""The test in which Level-1 drives."""
STRAIGHT = "straight"
"""The test on the straight road."""
TRAFFIC = "traffic"
"""The test of the styles as traffic."""
MERGE, EXIT, ROUNDABOUT = "merge-v1", "exit-v1", "roundabout-v1"
INTERSECTION = {"name": "intersection-v1", "duration_s": 30.0}
OWN, PEOPLE = "environment", {"traffic": "yielding_human", "label": "Yielding human"}
UNKNOWN = [{"traffic": "human", "label": "Human"}, {"traffic": "idm_mobil", "label": "IDM+MOBIL"}]
RULES = [
    {"agent": "human", "label": "Human"},
    {"agent": "yielding_human", "label": "Yielding human"},
    {"agent": "idm_mobil", "label": "IDM+MOBIL"},
    {"agent": "charms", "label": "CHARMS of the straight road"},
]
GENERIC = [
    {"name": "merge-generic-v1", "label": "merge-generic-v1, 4 lanes, 12 vehicles",
     "configuration": {"lanes_count": 4, "vehicles_count": 12}},
    {"name": "roundabout-generic-v1", "label": "roundabout-generic-v1, radius 40 m, 3 lanes",
     "configuration": {"roundabout_radius": 40, "roundabout_lanes": 3}},
]  # fmt: skip
PLACES, FILES = ROOT / "tools" / "junctions", ROOT.parent / "shared" / "data" / "maps"
JUNCTIONS = [{"file": str(PLACES / f"{name}.json"), "label": name.replace("-", " ")}
             for name in ("t-junction", "wide-crossing")]  # fmt: skip
MAPS = (
    ("opendrive/esmini_fabriksgatan.xodr", "opendrive/esmini_lane_offset_intersection.xodr",
     "opendrive/esmini_simple_4way_intersection.xodr", "sumo/crossing_4lane.net.xml"),
    ("opendrive/esmini_highway_exit.xodr", "opendrive/esmini_highway_merge.xodr",
     "sumo/cloverleaf.net.xml", "sumo/merge_3lane.net.xml"),
)  # fmt: skip
"""Intersections and motorways with ramps, of which one each is drawn; see `drawn_maps`."""
FIRST_SEED = 4060
OTHERS = ["merge-v0", "exit-v0", "roundabout-v0", "u-turn-v1", "two-way-v0", "merge-generic-v1",
          "roundabout-generic-v1"]  # fmt: skip
THREE = [MERGE, EXIT, ROUNDABOUT]
AROUND = "environment", "idm_mobil", "human", "yielding_human"
AS_TRAFFIC = ["charms-roads", *(f"charms-roads-{each.replace('_', '-')}" for each in STYLES[1:])]
"""The packaged network, which is that of the selected seed."""
TESTS: dict[str, dict[str, Any]] = {
    "validation": {"seed": 976_000_000, "episodes": 300, "roads": [*THREE, INTERSECTION]},
    "validation-people": {
        "seed": 976_000_000, "episodes": 300, "roads": THREE, "traffic_models": [PEOPLE]
    },
    "own": {"roads": [*THREE, INTERSECTION], "episodes": 6_000},
    "people": {"roads": THREE, "traffic_models": [PEOPLE], "episodes": 6_000},
    OF_LEVELS: {"roads": [*THREE, INTERSECTION]},
    "unknown": {"roads": THREE, "traffic_models": UNKNOWN},
    "generic": {"roads": GENERIC},
    "junctions": {"roads": JUNCTIONS},
    "maps": {},
    OF_STYLES: {"roads": [MERGE, ROUNDABOUT], "traffic_models": [PEOPLE]},
    "others": {"roads": OTHERS},
    STRAIGHT: {"traffic_models": UNKNOWN, "episodes": 1_800, "scene": {"duration_s": 20.0}},
    TRAFFIC: {
        "roads": THREE, "episodes": 1_500, "egos": [{"agent": "yielding_human"}],
        "traffic_models": [{"traffic": name} for name in (*AROUND, *AS_TRAFFIC)],
    },
}  # fmt: skip
"""What each suite adds to 600 episodes from seed 988,000,000 of 45 s."""
VALIDATION = "validation", "validation-people"
"""What selects, and is no test."""


def seeds_of(networks: Path) -> list[int]:
    """The seeds whose networks are there."""
    return sorted(int(each.parts[-3]) for each in networks.glob("*/networks/roads.onnx"))


def egos_of(test: str, folder: Path) -> dict[str, dict[str, str]]:
    """The networks of a seed that drive in a test, by their labels."""
    roads = str(folder / "networks" / "roads.onnx")
    if test == OF_STYLES:
        return {style.replace("_", " "): {"onnx": roads, "style": style} for style in STYLES}
    if test == OF_LEVELS:
        return {LEVEL_1: {"onnx": str(folder / "networks" / "level_1.onnx")}}
    return {CHARMS: {"onnx": roads, "style": STYLES[0]}}


def drawn_maps(networks: Path) -> list[dict[str, str]]:
    """A map of each kind, drawn by the hash of the network of the first seed."""
    manifest = networks / str(FIRST_SEED) / "networks" / "roads.json"
    number = int(json.loads(manifest.read_text(encoding="utf-8"))["onnx_sha256"], 16)
    names = [kind[number % len(kind)] for kind in MAPS]
    return [{"file": str(FILES / name), "label": Path(name).name.split(".")[0]} for name in names]


def drive(networks: Path, runs: Path, *tests: str) -> None:
    """Drives tests, by default all but those of the validation."""
    runs.mkdir(parents=True, exist_ok=True)
    for test in tests or [name for name in TESTS if name not in VALIDATION]:
        egos: list[dict[str, Any]] = [*RULES]
        for seed in seeds_of(networks):
            for label, agent in egos_of(test, networks.resolve() / str(seed)).items():
                egos.append({"agent": agent, "label": f"{label}{SEED}{seed}"})
        common = {"suite": test, "seed": 988_000_000, "episodes": 600, "scene": {"duration_s": 45}}
        file = runs / f"{test}.yaml"
        own = TESTS[test] | ({"roads": drawn_maps(networks)} if test == "maps" else {})
        file.write_text(yaml.safe_dump(common | {"egos": egos} | own, sort_keys=False))
        charms_bench.run(file, runs / test)


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("usage: python tools/plan_roads.py NETWORKS RUNS [TEST ...]")
    drive(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])

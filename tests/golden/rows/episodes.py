"""Episodes of runs that are looked at again, rare events, searches and a dataset."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import yaml
from rows.case import Cases, Values, adding_to
from rows.cells import PROJECT, SUITES
from rows.hashing import Digests, hash_of

import charms_bench
from charms_bench.engine.events import Crash, TimeToCollision, lowest_levels
from charms_bench.engine.simulation import Simulation
from charms_bench.episodes.avoidability import avoidability, collisions
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import Replay, replay
from charms_bench.episodes.search import Search
from charms_bench.episodes.severity import margins
from charms_bench.episodes.what_if import what_if
from charms_bench.plugins.specs import drivers_of
from charms_bench.runs.rare_task import RareTask, estimate, software_of
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite, load_suite
from charms_bench.testing.verify import default_cases

CASES: Cases = {}
case = adding_to(CASES)


def looked_at(suite: Suite | dict[str, Any], folder: Path) -> RecordedCell:
    """Runs a suite of one cell."""
    made = suite if isinstance(suite, Suite) else Suite.model_validate(suite)
    return RecordedCell(run(made, folder / "run", workers=1), 0, Path())


CROWDED: dict[str, Any] = {
    "suite": "crowded",
    "episodes": 12,
    "scene": {"duration_s": 8.0, "traffic_vehicles": 10, "density": 2.0, "ego_slots": 3},
    "egos": [{"agent": "imitation"}],
    "traffic_models": [{"traffic": {"mixture": {"idm_mobil": 0.6, "level_0": 0.4}}}],
}


def trajectories(replays: list[Replay]) -> Values:
    """Returns hashes of the trajectories of some replays."""
    tables = [each.trajectories() for each in replays]
    return {
        name: "".join(hash_of(table[name]) for table in tables) for name in tables[0].columns
    } | {"endings": [each.ending for each in replays]}


@case("replay")
def replays(folder: Path) -> Values:
    return trajectories(replay(looked_at(CROWDED, folder), [0, 1]))


@case("replay on a road")
def road_replay(folder: Path) -> Values:
    suite = load_suite(PROJECT / "suites" / "roads-traffic.yaml")
    entries = {"egos": suite.egos[1:2], "roads": suite.roads[:1], "traffics": suite.traffics[2:]}
    entries |= {"episodes": 2}
    replays = replay(looked_at(suite.model_copy(update=entries), folder), [0, 1])
    rows = pl.concat(each.trajectories() for each in replays)
    assert not rows["lane"].null_count()  # lanes were null when the rows were recorded
    empty = hash_of(pl.Series([None] * replays[0].trajectories().height, dtype=pl.Int8))
    empty += hash_of(pl.Series([None] * replays[1].trajectories().height, dtype=pl.Int8))
    return trajectories(replays) | dict.fromkeys(("lane", "target_lane"), empty)


@case("what-if")
def other_futures(folder: Path) -> Values:
    cell = looked_at(CROWDED, folder)
    ego = what_if(cell, 0, 3, "stackelberg", None)
    other = what_if(cell, 1, 2, "human", 4)
    futures = [pair for each in (ego, other) for pair in each.futures()]
    told = [asdict(future) for pair in futures for future in pair]
    return trajectories([ego.other, other.other]) | {"futures": told}


@case("avoidability")
def avoidable(folder: Path) -> Values:
    cell = looked_at(CROWDED, folder)
    agents = ["idm_mobil", "stackelberg", "charms"]
    found = avoidability(cell, collisions(cell)[:3], agents=agents)
    records = (json.loads(json.dumps(asdict(each))) for each in found)
    return {
        "collisions": [
            {k: each[k] for k in each if k not in ("road", "ego_index")} for each in records
        ]
    }


TRUCKS = [
    {"name": "car", "proportion": 0.5},
    {"name": "truck", "proportion": 0.5, "length_m": 16.0, "width_m": 2.5},
]
for name, event, types in (
    ("rare event", "ttc:below_s=1.0", []),
    ("rare event among trucks", "ttc:below_s=1.0", TRUCKS),
    ("rare crash", "crash", []),
):

    @case(name)
    def rare(folder: Path, event: str = event, types: list[dict[str, Any]] = types) -> Values:
        scene = CROWDED["scene"] | {"vehicle_types": types}
        changes = {"egos": [{"agent": "human"}], "scene": scene}
        (cell,) = Suite.model_validate(CROWDED | changes).cells
        ego, traffic = cell.ego.agent, cell.traffic.traffic
        shared: dict[str, Any] = {
            "title": "rare",
            "scene": cell.scene,
            "ego": ego,
            "traffic": traffic,
            "networks": {},
            "software": software_of(ego, traffic, {}, event),
            "event": event,
            "samples": 100,
            "seed": 0,
        }
        pilot = estimate(RareTask(**shared))
        made = estimate(RareTask(**shared, run=1, pilot=pilot))
        return {
            "thresholds": [round(each, 9) for each in pilot.thresholds],
            "shares": [*made.shares],
            "acceptance": [*made.acceptance],
            "episodes": made.evaluations,
        }


@case("closeness of egos to vehicles of different widths")
def closeness(folder: Path) -> Values:
    suite = load_suite(SUITES["crowd-of-widths"])
    found = {}
    for cell in suite.cells:
        traffic = cell.traffic.traffic.make()
        agents = {each.key: each.make({}) for each in drivers_of(cell.ego.agent, traffic)}
        for event in (TimeToCollision(1.0), Crash()):
            simulation = Simulation(cell.scene, 40, cell.ego.agent.key, traffic, agents)
            simulation.reset(np.arange(40, dtype=np.uint64))
            levels = lowest_levels(simulation, event)
            found[f"{cell.ego.title}, {type(event).__name__}"] = levels.round(9).tolist()
    return found


@case("margins in scenarios with vehicles of different sizes")
def severity(folder: Path) -> Values:
    found = {}
    for number, each in enumerate(default_cases()[0]):
        if each.scene.scenario is not None and each.ego and each.ego.name == "stackelberg":
            traffic = each.traffic.make()
            agents = {each.key: each.make({}) for each in drivers_of(each.ego, traffic)}
            simulation = Simulation(each.scene, 20, each.ego.key, traffic, agents)
            found[f"case {number}"] = margins(simulation, np.arange(20)).tolist()
    return found


@case("search for failures")
def search(folder: Path) -> Values:
    suite = load_suite(PROJECT / "suites" / "r157.yaml")
    references = [each for each in suite.egos if each.title in suite.preventable_by]
    cell = next(each for each in suite.cells if each.ego.agent.name == "imitation")
    found = Search(cell, references, suite.folder)
    found.run(failures=3, budget=300, seed=0)
    return {
        "failures": found.failures,
        "preventable_by": found.preventable_by,
        "episodes": found.simulations,
        "to_first": found.simulations_to_first,
    }


@case("minari dataset")
def minari_dataset(folder: Path) -> Values:
    from minari import MinariDataset

    suite = CROWDED | {"egos": [{"agent": "prior_level_k"}], "episodes": 4}
    (folder / "suite.yaml").write_text(yaml.safe_dump(suite))
    made = charms_bench.run(folder / "suite.yaml", folder / "run", workers=1)
    path = made.dataset("minari", folder / "crowded-v0")
    digests = Digests()
    for episode in MinariDataset(path / "data"):
        digests.add(
            observations=episode.observations,
            actions=episode.actions,
            rewards=episode.rewards,
            ends=(episode.terminations, episode.truncations),
        )
    return digests.values()

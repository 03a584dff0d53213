"""Simulations with policies and drivers that no suite has, and continued from states."""

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rows.case import Cases, Values, adding_to
from rows.cells import PROJECT, with_stand_ins
from rows.hashing import Digests
from rows.policies import Braking, Canny, Noisy, Planning, Recurrent, Remembering, Steering, Wrong

from charms_bench import Policy, load_state, save_state
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import Mixture, OneAgent, Traffic
from charms_bench.runs.shard import engine_on
from charms_bench.runs.suite import load_suite
from charms_bench.world.scene import SceneSettings

CASES: Cases = {}
case = adding_to(CASES)
SMALL: dict[str, Any] = {"traffic_vehicles": 10, "density": 2.0, "duration_s": 10.0}
STATE = ("x", "y", "heading", "speed", "acceleration", "steering", "lane", "target_lane",
         "target_speed", "timer_s", "crashed", "present", "length", "width")  # fmt: skip


def followed(simulation: Simulation, own: tuple[str, ...] = ()) -> Values:
    """Simulates all episodes to their ends; returns hashes of the state after each decision."""
    digests = Digests()
    while simulation.scene.active.any():
        simulation.step()
        scene = simulation.scene
        digests.add(**{name: getattr(scene, name) for name in (*STATE, *own)})
    digests.add(ending=simulation.ending, steps=simulation.steps, collision=simulation.collision)
    return digests.values() | {"endings": simulation.ending.tolist()}


def simulation_of(
    scene: Mapping[str, Any] | SceneSettings,
    ego: str,
    traffic: Traffic,
    seeds: int = 6,
    **own: Agent,
) -> Simulation:
    """A simulation of the first seeds; `own` are agents that are not installed."""
    agents = {name: own.get(name) or make_agent(name) for name in {ego, *traffic.agents}}
    settings = scene if isinstance(scene, SceneSettings) else SceneSettings.model_validate(scene)
    engine = engine_on(settings)
    simulation = Simulation(settings, seeds, ego, traffic, agents, engine)
    simulation.reset(np.arange(seeds, dtype=np.uint64))
    return simulation


WHOLE: dict[str, tuple[str, str, dict[str, Any]]] = {
    "IDM+MOBIL": ("idm_mobil", "idm_mobil", {}),
    "IDM+MOBIL, control in every step": (
        "idm_mobil",
        "idm_mobil",
        {"profile": {"name": "charms", "ego_control_rate": "simulation"}},
    ),
    "Stackelberg": (
        "stackelberg",
        "idm_mobil",
        {"lanes": 4, "traffic_vehicles": 30, "density": 2.0},
    ),
    "IDM+MOBIL in Stackelberg": (
        "idm_mobil",
        "stackelberg",
        {"lanes": 5, "traffic_vehicles": 24, "density": 3.0},
    ),
    "highway-env": ("idm_mobil", "idm_mobil", {"profile": "highway-env", "density": 3.0}),
}
"""The ego, the traffic and the scene of cases with 40 episodes; the dense ones have wrecks."""
for name, cell in WHOLE.items():

    @case(f"whole scenes, {name}")
    def whole(folder: Path, cell: tuple[str, str, dict[str, Any]] = cell) -> Values:
        ego, traffic, scene = cell
        return followed(simulation_of(scene, ego, OneAgent(traffic), 40))


POLICIES: dict[str, Callable[[], Policy]] = {
    "memory": Recurrent, "noise": Noisy, "history": Remembering, "continuous actions": Steering,
    "own speed steps": Canny,
}  # fmt: skip
for name, make in POLICIES.items():

    @case(f"policy with {name}, as ego and in the traffic")
    def policy(folder: Path, make: Callable[[], Policy] = make) -> Values:
        traffic = Mixture({"idm_mobil": 0.5, "other": 0.5})
        made = simulation_of(SMALL, "own", traffic, own=make(), other=make())
        return followed(made, ("memory", "repeats"))


@case("driver model with memory and parameters")
def model(folder: Path) -> Values:
    traffic = Mixture({"human": 0.5, "other": 0.5})
    made = simulation_of(SMALL, "own", traffic, own=Braking(), other=Braking())
    return followed(made, ("memory", "parameters"))


@case("planner as ego")
def planner(folder: Path) -> Values:
    return followed(simulation_of(SMALL | {"duration_s": 5.0}, "mpc", OneAgent("idm_mobil"), 3))


@case("planner in the traffic, with Stackelberg in its rollouts")
def planners(folder: Path) -> Values:
    own = make_agent("mpc", {"horizon": 4, "others": "stackelberg"})
    traffic = Mixture({"idm_mobil": 0.6, "planner": 0.4})
    return followed(simulation_of(SMALL | {"duration_s": 4.0}, "human", traffic, 2, planner=own))


@case("planner with continuous plans")
def continuous_planner(folder: Path) -> Values:
    scene = SMALL | {"duration_s": 4.0}
    return followed(simulation_of(scene, "own", OneAgent("idm_mobil"), 3, own=Planning()))


POPULATIONS = ("i24", "i75", str(Path(__file__).with_name("idm-mobil-i75.json")))
for population in POPULATIONS:

    @case(f"human drivers of {Path(population).stem}")
    def humans(folder: Path, population: str = population) -> Values:
        own = make_agent("human", {"population": population})
        scene = {"traffic_vehicles": 40, "density": 1.5, "lanes": 4, "duration_s": 6.0}
        made = simulation_of(scene, "own", OneAgent("own"), own=own)
        made.advance()
        drawn = np.median(made.scene.memory, axis=(0, 1))
        return followed(made, ("memory", "parameters")) | {"medians": drawn.round(9).tolist()}


TYPES = [
    {"name": "car", "proportion": 0.7, "length_m": {"normal": [4.7, 0.4], "range": [3.5, 5.8]}},
    {"name": "truck", "proportion": 0.3, "length_m": 16.0},
]
OPEN: dict[str, Any] = {
    "profile": {"name": "naturalistic", "road_length_m": 700.0},
    "traffic_vehicles": 6,
    "density": 2.0,
    "duration_s": 16.0,
    "inflow": {"vehicles_per_hour_and_lane": 1800, "capacity": 40},
    "vehicle_types": TYPES,
}


@case("state of the straight road")
def straight_state(folder: Path) -> Values:
    traffic = Mixture({"idm_mobil": 0.4, "human": 0.3, "imitation": 0.3})
    return continued(lambda: simulation_of(SMALL, "stackelberg", traffic), folder)


@case("state of an open road")
def open_state(folder: Path) -> Values:
    traffic = Mixture({"idm_mobil_varied": 0.5, "human": 0.5})
    return continued(lambda: simulation_of(OPEN, "charms", traffic, 3), folder)


@case("state of recorded traffic")
def recorded_state(folder: Path) -> Values:
    suite = with_stand_ins("recorded", folder)
    traffic = suite.traffics[1].traffic.make()
    return continued(lambda: simulation_of(suite.scene, "stackelberg", traffic))


for number, title in ((0, "a merge"), (4, "an exit")):

    @case(f"state on {title}")
    def road_state(folder: Path, number: int = number) -> Values:
        cell = load_suite(PROJECT / "suites" / "roads-traffic.yaml").cells[number]
        traffic = cell.traffic.traffic.make()
        return continued(lambda: simulation_of(cell.scene, "human", traffic, 3))


def continued(make: Callable[[], Simulation], folder: Path | None = None) -> Values:
    """Simulates a while, and goes on in another simulation; with a folder, from a file."""
    first, again = make(), make()
    for _ in range(4):
        first.step()
    state = first.state()
    if folder is not None:
        save_state(state, folder / "state.json")
        state = load_state(folder / "state.json")
    again.restore(state)
    return followed(again)


@case("actions that do not exist")
def wrong_actions(folder: Path) -> Values:
    said: Values = {}
    for row in (0, 2, 5):
        simulation = simulation_of(SMALL, "wrong", OneAgent("idm_mobil"), wrong=Wrong(row))
        try:
            simulation.step()
        except AgentError as error:
            said[str(row)] = str(error)
    return said


if __name__ == "__main__":
    found = {name: made(Path()) for name, made in CASES.items() if name.startswith("whole")}
    json.dump(found, sys.stdout)

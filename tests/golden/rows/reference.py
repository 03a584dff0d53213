"""Hashes of the state of episodes, decision by decision, for the cases of `charms-bench verify`.

They are recorded through the reference, highway-env's own vehicles, and compared with the engine.
"""

from collections.abc import Callable, Iterator
from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rows.cells import with_stand_ins
from rows.hashing import bytes_of
from rows.policies import Braking, Canny, Noisy, Recurrent, Remembering, Steering

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.specs import AgentSpec, drivers_of, networks_of
from charms_bench.testing.exact_maths import use_exact_maths
from charms_bench.testing.reference_engine import HighwayEnvEngine
from charms_bench.testing.straight_parity import StraightCase, random_controls
from charms_bench.testing.verify import cases_of, default_cases

OWN: dict[str, Callable[[], Agent]] = {
    "memory": Recurrent,
    "noise": Noisy,
    "history": Remembering,
    "continuous": Steering,
    "own steps": Canny,
    "driver model": Braking,
}
"""Agents that are not installed."""
EGOS = {
    "recorded": ("recorded", "stackelberg", "charms"),
    "r157": ("careful_human", "idm_mobil"),
}
"""The egos of some suites whose cells are cases."""
PROFILES = ("charms", "highway-env", "naturalistic")
QUANTITIES = ("x", "y", "heading", "speed", "lane", "target_lane", "crashed", "timer_s")
EPISODES, DECISIONS = 3, 24
Hashes = NDArray[np.uint32]


def cases(folder: Path) -> dict[str, StraightCase]:
    """Returns the cases that need this project's agents, sources or scenes, by name.

    `folder` is empty and for a recording.
    """
    every = default_cases()[0] + default_cases(continuous=True)[0]
    for suite, egos in EGOS.items():
        found_in = cases_of(with_stand_ins(suite, folder))
        every += [
            case
            for case in found_in
            if isinstance(case, StraightCase) and case.ego and case.ego.name in egos
        ]
    for number, name in enumerate(OWN):
        scene = {"traffic_vehicles": 12, "profile": PROFILES[number % len(PROFILES)]}
        traffic = {"mixture": {"idm_mobil": 0.5, name: 0.5}}
        every.append(StraightCase.model_validate({"scene": scene, "ego": name, "traffic": traffic}))
    found: dict[str, StraightCase] = {}
    for case in every:
        if not is_of_highway_env(case):
            name = f"{case.title}, {name_of(case)}"
            again = sum(each.rpartition(" ")[0] == name for each in found)
            found[f"{name} {again + 1}"] = case
    return found


def name_of(case: StraightCase) -> str:
    """Returns a traffic model's name, or what takes its place."""
    return case.traffic.name or ("scenario" if case.traffic.scenario else "mixture")


def is_of_highway_env(case: StraightCase) -> bool:
    """Whether a case has only highway-env's vehicles, in scenes as highway-env draws them."""
    is_plain = case.ego is None or case.ego.name == "idm_mobil"
    scene = case.scene
    return (
        is_plain
        and case.traffic.name == "idm_mobil"
        and not (scene.vehicle_types or scene.inflow or scene.recording)
    )


def hashes(case: StraightCase, engine: MakeEngine = BatchedEngine) -> Hashes:
    """Returns the hashes of a case, [episodes, decisions, quantities].

    With the reference engine, the process has to be a worker; see `worker_environment`.
    """
    if engine is HighwayEnvEngine:
        use_exact_maths()
    traffic = case.traffic.make()
    networks = networks_of(case.ego, traffic, case.folder) if case.ego else {}
    drivers = (
        drivers_of(case.ego, traffic) if case.ego else map(AgentSpec.model_validate, traffic.agents)
    )
    agents = {
        driver.key: OWN[driver.name]() if driver.name in OWN else driver.make(networks)
        for driver in drivers
    }
    ego, kind = (case.ego.key, "meta") if case.ego else (None, "continuous")
    simulation = Simulation(case.scene, EPISODES, ego, traffic, agents, engine, kind)
    simulation.reset(np.arange(EPISODES, dtype=np.uint64))
    return np.stack([*decisions(simulation, is_outside=case.ego is None)], axis=1)


def through_reference(named: tuple[str, StraightCase]) -> Hashes:
    """Returns the hashes of a case in the reference, in a worker."""
    return hashes(named[1], HighwayEnvEngine)


def decisions(simulation: Simulation, is_outside: bool) -> Iterator[Hashes]:
    """Yields the hashes after each decision, [episodes, quantities]."""
    scene = simulation.scene
    controls = [random_controls(seed, DECISIONS) for seed in range(EPISODES)]
    for decision in range(DECISIONS):
        given = np.stack([each[decision] for each in controls])
        simulation.step(*[given] * is_outside)
        yield np.array(
            [[hash_of(getattr(scene, name)[b]) for name in QUANTITIES] for b in range(EPISODES)]
        )


def hash_of(numbers: np.ndarray) -> np.uint32:
    """Returns the hash of some numbers."""
    return np.frombuffer(blake2b(bytes_of(numbers), digest_size=4).digest(), "<u4")[0]

"""Measures environment steps a second: this engine, highway-env and, if installed, EnvPool.

An environment step is one decision of the ego: a third of a second of traffic at 15 Hz, the
observation, and a new scene when the episode is over. Everything is measured in one run, in turn,
several times, so that ratios hold on a machine whose speed drifts.
"""

import multiprocessing
import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing.connection import Connection
from statistics import median
from typing import Any

import numpy as np

from charms_bench.engine.simulation import RUNNING, Simulation
from charms_bench.plugins.registry import make_agent, make_traffic
from charms_bench.world.actions import IDLE, Actions
from charms_bench.world.observations import neighbours
from charms_bench.world.scene import SceneSettings

_SETTINGS = SceneSettings()
_SCENES = 512
_SEED = 10**6
_OBSERVATION = {"type": "Kinematics", "vehicles_count": 7}

Contestant = Callable[[float], tuple[int, float]]
"""Steps for about so many seconds: the environment steps made, and the seconds they took."""


@dataclass(frozen=True)
class Measurement:
    """What one contestant managed."""

    name: str
    threads: int
    vehicles: int
    steps_per_s: float
    """Median over the rounds."""
    low: float
    high: float

    @property
    def ns_per_vehicle_step(self) -> float:
        """Thread time of one vehicle's simulation step, with its share of everything else."""
        simulation_steps = _SETTINGS.simulation_hz // _SETTINGS.decision_hz
        return 1e9 * self.threads / (self.steps_per_s * simulation_steps * self.vehicles)


def bench(
    vehicles: int = 21,
    traffic: str = "idm_mobil",
    seconds: float = 2.0,
    rounds: int = 3,
    progress: Callable[[str], None] = lambda name: None,
) -> list[Measurement]:
    """Measures every contestant `rounds` times for about `seconds`, in turn.

    Args:
        vehicles: Vehicles in a scene, the ego included.
        traffic: The traffic by name; EnvPool and highway-env have their own IDM.
        seconds: Of one measurement.
        rounds: Measurements of each.
        progress: Told what is being measured.
    """
    settings = _SETTINGS.model_copy(update={"traffic_vehicles": vehicles - 1})
    crowded = _SETTINGS.model_copy(update={"traffic_vehicles": 199})
    all_threads = os.cpu_count() or 1
    contestants: list[tuple[str, int, int, Contestant]] = [
        ("batched", 1, vehicles, _batched(settings, traffic)),
        ("batched", all_threads, vehicles, _in_processes(settings, traffic, all_threads)),
        ("batched", 1, 200, _batched(crowded, traffic)),
        ("highway-env engine", 1, vehicles, _reference(settings, traffic)),
        ("highway-env", 1, vehicles, _highway_env(settings)),
    ]
    if find_spec("envpool"):
        contestants += [
            ("EnvPool", 1, vehicles, _envpool(settings, 1)),
            ("EnvPool", all_threads, vehicles, _envpool(settings, all_threads)),
        ]
    return _in_turn(contestants, seconds, rounds, progress)


def bench_environments(
    count: int,
    vehicles: int = 21,
    traffic: str = "idm_mobil",
    seconds: float = 2.0,
    rounds: int = 3,
    progress: Callable[[str], None] = lambda name: None,
) -> list[Measurement]:
    """Measures Gymnasium's vector environments of `count` environments each, in the same way.

    All of them see seven rows of `Kinematics`. highway-env's are in one process after another, or
    in a process each.
    """
    import gymnasium
    import highway_env  # noqa: F401  # registers highway-v0

    from charms_bench import envs

    theirs = _config(_SETTINGS.model_copy(update={"traffic_vehicles": vehicles - 1}))
    ours: dict[str, Any] = {
        "traffic": traffic,
        "traffic_vehicles": vehicles - 1,
        "observation": _OBSERVATION,
    }
    processes = min(count, os.cpu_count() or 1)  # that run at a time
    made = [
        ("Ego-v0", 1, gymnasium.make_vec(envs.ID, count, **ours)),
        ("highway-env, sync", 1, gymnasium.make_vec("highway-v0", count, "sync", config=theirs)),
        ("highway-env", processes, gymnasium.make_vec("highway-v0", count, "async", config=theirs)),
    ]
    contestants = []
    for name, threads, environments in made:
        environments.reset(seed=_SEED)
        contestant = _in_step(environments, np.full(count, IDLE))
        contestants.append((name, threads, vehicles, contestant))
    return _in_turn(contestants, seconds, rounds, progress)


def _in_turn(
    contestants: list[tuple[str, int, int, Contestant]],
    seconds: float,
    rounds: int,
    progress: Callable[[str], None],
) -> list[Measurement]:
    """Measures name, threads, vehicles and contestant; see `bench`."""
    rates: list[list[float]] = [[] for _ in contestants]
    for _, _, _, contestant in contestants:
        contestant(0.0)  # compiles and allocates
    for _ in range(rounds):
        for (name, threads, size, contestant), measured in zip(contestants, rates, strict=True):
            progress(f"{name}, {size} vehicles, {threads} thread{'s' * (threads > 1)}")
            steps, took = contestant(seconds)
            measured.append(steps / took)
    return [
        Measurement(name, threads, size, median(measured), min(measured), max(measured))
        for (name, threads, size, _), measured in zip(contestants, rates, strict=True)
    ]


def _batched(settings: SceneSettings, traffic: str) -> Contestant:
    simulation = _simulation(settings, traffic, "batched", _SCENES)

    def run(seconds: float) -> tuple[int, float]:
        start = time.perf_counter()
        return _drive(simulation, start + seconds), time.perf_counter() - start

    return run


def _in_processes(settings: SceneSettings, traffic: str, count: int) -> Contestant:
    """This engine as `run` uses it: one thread in each of several processes."""
    context = multiprocessing.get_context("spawn")
    pipes = []
    for _ in range(count):
        ours, theirs = context.Pipe()
        arguments = (theirs, settings, traffic)
        context.Process(target=_serve, args=arguments, daemon=True).start()
        pipes.append(ours)

    def run(seconds: float) -> tuple[int, float]:
        for pipe in pipes:
            pipe.send(seconds)
        answers = [pipe.recv() for pipe in pipes]
        return sum(steps for steps, _ in answers), max(took for _, took in answers)

    return run


def _serve(pipe: Connection, settings: SceneSettings, traffic: str) -> None:
    run = _batched(settings, traffic)
    with suppress(EOFError):  # nobody asks any more
        while True:
            pipe.send(run(pipe.recv()))


def _reference(settings: SceneSettings, traffic: str) -> Contestant:
    simulation = _simulation(settings, traffic, "highway-env", 1)

    def run(seconds: float) -> tuple[int, float]:
        start = time.perf_counter()
        return _drive(simulation, start + seconds), time.perf_counter() - start

    return run


def _simulation(settings: SceneSettings, traffic: str, engine: Any, scenes: int) -> Simulation:
    plugin = make_traffic(traffic)
    agents = {name: make_agent(name) for name in plugin.agents}
    simulation = Simulation(settings, scenes, None, plugin, agents, engine)
    simulation.reset(np.arange(_SEED, _SEED + scenes, dtype=np.uint64))
    # Episodes in all stages, so that every step has its share of new scenes.
    simulation.steps[:] = np.arange(scenes) * settings.decisions // scenes
    return simulation


def _drive(simulation: Simulation, until: float) -> int:
    """Steps until that time, at least once; returns the environment steps made."""
    actions = np.full(simulation.seeds.size, IDLE)
    steps = 0
    while True:
        simulation.step(actions)
        ended = np.nonzero(simulation.ending != RUNNING)[0]
        if ended.size:
            simulation.reset(simulation.seeds[ended] + np.uint64(simulation.seeds.size), ended)
        neighbours(simulation.scene, simulation.ego_vehicles)
        steps += simulation.seeds.size
        if time.perf_counter() >= until:
            return steps


def _highway_env(settings: SceneSettings) -> Contestant:
    import gymnasium
    import highway_env  # noqa: F401  # registers highway-v0

    environment = gymnasium.make("highway-v0", config=_config(settings))
    environment.reset(seed=_SEED)

    def run(seconds: float) -> tuple[int, float]:
        start = time.perf_counter()
        steps = 0
        while True:
            _, _, terminated, truncated, _ = environment.step(IDLE)
            steps += 1
            if terminated or truncated:
                environment.reset()
            if time.perf_counter() >= start + seconds:
                return steps, time.perf_counter() - start

    return run


def _config(settings: SceneSettings) -> dict[str, Any]:
    """The same scene to highway-env."""
    return {
        "lanes_count": settings.lanes,
        "vehicles_count": settings.traffic_vehicles,
        "simulation_frequency": settings.simulation_hz,
        "policy_frequency": settings.decision_hz,
        "duration": settings.duration_s,
        "observation": _OBSERVATION,
    }


def _in_step(environments: Any, actions: Actions) -> Contestant:
    """Environments that have been reset and make their steps together."""

    def run(seconds: float) -> tuple[int, float]:
        start = time.perf_counter()
        steps = 0
        while True:
            environments.step(actions)
            steps += actions.size
            if time.perf_counter() >= start + seconds:
                return steps, time.perf_counter() - start

    return run


def _envpool(settings: SceneSettings, threads: int) -> Contestant:
    import envpool

    environments = envpool.make_gymnasium(
        "Highway-v0",
        num_envs=64 * threads,
        num_threads=threads,
        max_episode_steps=settings.decisions,
        lanes_count=settings.lanes,
        vehicles_count=settings.traffic_vehicles,
        observation_vehicles_count=7,
        simulation_frequency=settings.simulation_hz,
        policy_frequency=settings.decision_hz,
        duration=round(settings.duration_s),
    )
    environments.reset()
    return _in_step(environments, np.full(64 * threads, IDLE, dtype=np.int32))

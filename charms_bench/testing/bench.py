"""Measures environment steps per second: this engine, highway-env and, if installed, EnvPool.

One environment step is one decision of the ego: a third of a second of traffic at 15 Hz, the
observation, and a new scene when the episode is over. All contestants are measured in turn, several
times, in one run. So their ratios hold even if the speed of the machine drifts.
"""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from importlib.util import find_spec
from statistics import median
from typing import Any

import numpy as np

from charms_bench.engine import EngineName
from charms_bench.engine.endings import RUNNING
from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.threads import ONE_THREAD
from charms_bench.foundation.workers import Pool
from charms_bench.plugins.registry import make_agent, make_traffic
from charms_bench.testing.bench_learners import highway_env_learners, our_learners
from charms_bench.world.actions import IDLE
from charms_bench.world.observations import neighbours
from charms_bench.world.scene import SceneSettings

_SETTINGS = SceneSettings()
_SIMULATION_STEPS = _SETTINGS.steps_per_decision
_SCENES = 384
_SCALE_VEHICLES = (21, 200, 2000)
_SCALE_SCENES = tuple(10**k for k in range(6))
_MOST_VEHICLES = 2_000_000
_SEED = 10**6
_OBSERVATION = {"type": "Kinematics", "vehicles_count": 7}

Step = Callable[[], int]
"""Makes some environment steps and returns how many."""
Stepping = Callable[[float], tuple[int, float]]
"""Steps for about so many seconds: the environment steps made, and the seconds that they took."""
Contestant = tuple[str, int, int, Stepping]
"""A name, a number of threads, the vehicles in a scene, and what is measured."""


@dataclass(frozen=True)
class Measurement:
    """The speed of one contestant."""

    name: str
    threads: int
    vehicles: int
    steps_per_s: float
    """Median over the rounds."""
    low: float
    high: float
    scenes: int = 1
    """Scenes that one thread advances together."""

    @property
    def vehicle_updates_per_s(self) -> float:
        """Vehicles times simulation steps."""
        return self.steps_per_s * _SIMULATION_STEPS * self.vehicles

    @property
    def ns_per_vehicle_step(self) -> float:
        """Thread time per vehicle and simulation step, with its share of everything else."""
        return 1e9 * self.threads / self.vehicle_updates_per_s


def bench(
    vehicles: int = 21,
    traffic: str = "idm_mobil",
    seconds: float = 2.0,
    rounds: int = 3,
    progress: Callable[[str], None] = lambda name: None,
    environments: int | None = None,
    learners: bool = False,
) -> list[Measurement]:
    """Measures every contestant `rounds` times for about `seconds`, in turn.

    Args:
        vehicles: Vehicles in a scene, the ego included.
        traffic: The traffic by name; EnvPool and highway-env have their own IDM.
        seconds: Duration of one measurement.
        rounds: Measurements of each contestant.
        progress: Called with the name of what is measured next.
        environments: If given, the contestants are Gymnasium's vector environments of this many
            environments each; otherwise they are the engines.
        learners: Whether the contestants are environments in which all vehicles are driven from
            outside. Their steps are decisions of vehicles.
    """
    settings = _SETTINGS.model_copy(update={"traffic_vehicles": vehicles - 1})
    rates: list[list[float]] = []
    with ExitStack() as stack:
        if learners:
            contestants = _learners(settings, stack)
        elif environments:
            contestants = _vector_environments(settings, traffic, environments)
        else:
            contestants = _engines(settings, traffic, stack)
        for *_, stepping in contestants:
            stepping(0.0)  # compiles and allocates
            rates.append([])
        for _ in range(rounds):
            for (name, threads, size, stepping), measured in zip(contestants, rates, strict=True):
                progress(f"{name}, {size} vehicles, {threads} thread{'s' * (threads > 1)}")
                steps, took = stepping(seconds)
                measured.append(steps / took)
    return [
        Measurement(name, threads, size, median(measured), min(measured), max(measured))
        for (name, threads, size, _), measured in zip(contestants, rates, strict=True)
    ]


def scale(
    seconds: float = 1.0, rounds: int = 3, progress: Callable[[str], None] = lambda name: None
) -> list[Measurement]:
    """Measures this engine with 1 to all cores, 21 to 2,000 vehicles and 1 to 100,000 scenes.

    At most two million vehicles are simulated at once; see `bench` for the arguments.
    """
    cores = os.cpu_count() or 1
    measured = []
    for threads in sorted({1, cores} | {2**k for k in range(cores.bit_length())}):
        for vehicles in _SCALE_VEHICLES:
            settings = _SETTINGS.model_copy(update={"traffic_vehicles": vehicles - 1})
            most = _MOST_VEHICLES // (threads * vehicles)
            for scenes in dict.fromkeys(min(scenes, most) for scenes in _SCALE_SCENES):
                progress(f"{threads} threads, {vehicles:,} vehicles, {scenes:,} scenes")
                make = partial(_ours, settings, "idm_mobil", scenes=scenes)
                with _processes(make, threads) as stepping:
                    stepping(0.0)
                    answers = [stepping(seconds) for _ in range(rounds)]
                rates = [steps / took for steps, took in answers]
                spread = (median(rates), min(rates), max(rates))
                measured.append(Measurement("batched", threads, vehicles, *spread, scenes))
    return measured


def _engines(settings: SceneSettings, traffic: str, stack: ExitStack) -> list[Contestant]:
    crowded = settings.model_copy(update={"traffic_vehicles": 199})
    cores, vehicles = os.cpu_count() or 1, settings.vehicles
    together = stack.enter_context(_processes(partial(_ours, settings, traffic), cores))
    ours = [
        ("batched", 1, vehicles, _stepping(_ours(settings, traffic))),
        ("batched", cores, vehicles, together),
        ("batched", 1, 200, _stepping(_ours(crowded, traffic))),
        ("highway-env engine", 1, vehicles, _stepping(_ours(settings, traffic, "highway-env", 1))),
        ("highway-env", 1, vehicles, _stepping(_highway_env(settings))),
    ]
    return ours + [
        ("EnvPool", threads, vehicles, _stepping(_envpool(settings, threads, 64 * threads)))
        for threads in (1, cores)
        if find_spec("envpool")
    ]


def _learners(settings: SceneSettings, stack: ExitStack) -> list[Contestant]:
    """On one core and on all; the environments observe seven rows of `Kinematics`."""
    contestants = []
    ours = partial(our_learners, settings, _SCENES, _OBSERVATION, _SEED)
    theirs = partial(highway_env_learners, settings, _OBSERVATION, _SEED)
    cores = os.cpu_count() or 1
    for name, processes, make in (
        ("LearnersVectorEnv", 1, ours),
        ("LearnersVectorEnv", cores, ours),
        ("highway-env, one core", 1, theirs),
        ("highway-env", cores, theirs),
    ):
        stepping = stack.enter_context(_processes(make, processes))
        contestants.append((name, processes, settings.vehicles, stepping))
    return contestants


def _vector_environments(settings: SceneSettings, traffic: str, count: int) -> list[Contestant]:
    """All of them observe seven rows of `Kinematics`.

    highway-env's environments run in one process, or in one process each. EnvPool is measured if
    it is installed.
    """
    import gymnasium
    import highway_env  # noqa: F401  # registers highway-v0

    from charms_bench import envs

    theirs = _config(settings)
    ours: dict[str, Any] = {
        "traffic": traffic,
        "traffic_vehicles": settings.traffic_vehicles,
        "observation": _OBSERVATION,
    }
    processes = min(count, os.cpu_count() or 1)  # that run at the same time
    contestants: list[Contestant] = []
    for name, threads, environments in (
        ("Ego-v0", 1, gymnasium.make_vec(envs.ID, count, **ours)),
        ("highway-env, sync", 1, gymnasium.make_vec("highway-v0", count, "sync", config=theirs)),
        ("highway-env", processes, gymnasium.make_vec("highway-v0", count, "async", config=theirs)),
    ):
        environments.reset(seed=_SEED)
        stepping = _stepping(_together(environments, count))
        contestants.append((name, threads, settings.vehicles, stepping))
    if find_spec("envpool"):
        pool = _stepping(_envpool(settings, 1, count))
        contestants.append(("EnvPool", 1, settings.vehicles, pool))
    return contestants


def _stepping(step: Step) -> Stepping:
    """Repeats a step, at least once, until the time is over."""

    def run(seconds: float) -> tuple[int, float]:
        start = time.perf_counter()
        steps = step()
        while time.perf_counter() < start + seconds:
            steps += step()
        return steps, time.perf_counter() - start

    return run


@contextmanager
def _processes(make: Callable[[], Step], count: int) -> Iterator[Stepping]:
    """Makes and repeats a step in each of several processes of one thread, as `run` does."""
    with Pool(_Repeated(make), count, environment=ONE_THREAD) as pool:

        def run(seconds: float) -> tuple[int, float]:
            pool.add([seconds] * count)
            answers = [answer for _, answer in pool.results()]
            return sum(steps for steps, _ in answers), max(took for _, took in answers)

        yield run


class _Repeated:
    """Repeats a step that is made once in each process."""

    def __init__(self, make: Callable[[], Step]) -> None:
        self.make = make

    def __call__(self, seconds: float) -> tuple[int, float]:
        return self._stepping(seconds)

    @cached_property
    def _stepping(self) -> Stepping:
        return _stepping(self.make())


def _ours(
    settings: SceneSettings, traffic: str, engine: EngineName = "batched", scenes: int = _SCENES
) -> Step:
    plugin = make_traffic(traffic)
    agents = {name: make_agent(name) for name in plugin.agents}
    simulation = Simulation(settings, scenes, None, plugin, agents, engine)
    simulation.reset(np.arange(_SEED, _SEED + scenes, dtype=np.uint64))
    # Episodes at all stages, so that every step has its share of new scenes.
    simulation.steps[:] = np.arange(scenes) * settings.decisions // scenes
    actions = np.full(scenes, IDLE)

    def step() -> int:
        simulation.step(actions)
        ended = np.nonzero(simulation.ending != RUNNING)[0]
        if ended.size:
            simulation.reset(simulation.seeds[ended] + np.uint64(scenes), ended)
        neighbours(simulation.scene, simulation.ego_vehicles)
        return scenes

    return step


def _highway_env(settings: SceneSettings) -> Step:
    import gymnasium
    import highway_env  # noqa: F401  # registers highway-v0

    environment = gymnasium.make("highway-v0", config=_config(settings))
    environment.reset(seed=_SEED)

    def step() -> int:
        _, _, terminated, truncated, _ = environment.step(IDLE)
        if terminated or truncated:
            environment.reset()
        return 1

    return step


def _config(settings: SceneSettings) -> dict[str, Any]:
    """highway-env's configuration of the same scene."""
    return {
        "lanes_count": settings.lanes,
        "vehicles_count": settings.traffic_vehicles,
        "simulation_frequency": settings.simulation_hz,
        "policy_frequency": settings.decision_hz,
        "duration": settings.duration_s,
        "observation": _OBSERVATION,
    }


def _together(environments: Any, count: int, dtype: Any = np.int64) -> Step:
    """A step of a vector environment that has been reset."""
    actions = np.full(count, IDLE, dtype=dtype)

    def step() -> int:
        environments.step(actions)
        return count

    return step


def _envpool(settings: SceneSettings, threads: int, count: int) -> Step:
    import envpool

    environments = envpool.make_gymnasium(
        "Highway-v0",
        num_envs=count,
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
    return _together(environments, count, np.int32)

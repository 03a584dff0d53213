"""Measures environment steps per second: this engine, highway-env and, if installed, EnvPool.

One environment step is one decision of the ego: a third of a second of traffic at 15 Hz, the
observation, and a new scene when the episode is over. All contestants are measured in turn, several
times, in one run. So their ratios hold even if the speed of the machine drifts.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from functools import cache, partial
from importlib.util import find_spec
from statistics import median
from typing import Any

import numpy as np

from charms_bench.foundation.threads import ONE_THREAD
from charms_bench.foundation.workers import Pool
from charms_bench.testing import contestants as making
from charms_bench.testing.contestants import OBSERVATION, SEED, Stepping
from charms_bench.testing.reference_engine import HighwayEnvEngine
from charms_bench.world.actions import IDLE
from charms_bench.world.scene import SceneSettings

_SETTINGS = SceneSettings()
_SIMULATION_STEPS = _SETTINGS.steps_per_decision
_SCALE_VEHICLES = (21, 200, 2000)
_SCALE_SCENES = tuple(10**k for k in range(6))
_MOST_VEHICLES = 2_000_000

Contestant = tuple[str, int, int, Stepping]
"""A name, a number of threads, the vehicles in a scene, and what is measured."""
Spread = tuple[float, float, float]
"""The median over the rounds, the lowest and the highest."""


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

    def record(self) -> dict[str, Any]:
        """All numbers by name, and the simulation steps of vehicles, which take thread time."""
        updates = self.steps_per_s * _SIMULATION_STEPS * self.vehicles
        derived = {
            "vehicle_updates_per_s": updates,
            "ns_per_vehicle_step": 1e9 * self.threads / updates,
        }
        return asdict(self) | derived


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

    The contestants are the engines, or Gymnasium's vector environments of size `environments`,
    or environments in which all vehicles are `learners`; the steps of these are decisions of
    vehicles. EnvPool and highway-env have their own IDM, whatever the traffic is. `progress` is
    called with the name of what is measured next.
    """
    settings = _SETTINGS.model_copy(update={"traffic_vehicles": vehicles - 1})
    with ExitStack() as stack:
        if learners:
            contestants = [*_learners(settings, stack)]
        elif environments:
            contestants = [*_vector_environments(settings, traffic, environments)]
        else:
            contestants = _engines(settings, traffic, stack)
        titled = [
            (f"{name}, {size} vehicles, {threads} thread{'s' * (threads > 1)}", stepping)
            for name, threads, size, stepping in contestants
        ]
        rates = _rates(titled, seconds, rounds, progress)
    return [
        Measurement(*contestant[:3], *spread)
        for contestant, spread in zip(contestants, rates, strict=True)
    ]


def bench_road(
    name: str, seconds: float, rounds: int, progress: Callable[[str], None], environments: int
) -> list[dict[str, Any]]:
    """Measures a vector environment with `environments` environments, and one of highway-env.

    They are on one thread, in decisions per second. Actions are random, and observations and new
    episodes are included. For the other arguments, see `bench`.
    """
    ours = f"charms_bench/{name}", making.road(name, environments)
    theirs = "highway-env", making.highway_env_road(name)
    rates = _rates([ours, theirs], seconds, rounds, progress)
    names = ("name", "environments", "decisions_per_s", "low", "high", "times_highway_env")
    return [
        dict(zip(names, (title, count, *rate, rate[0] / rates[1][0]), strict=True))
        for (title, _), count, rate in zip((ours, theirs), (environments, 1), rates, strict=True)
    ]


def _rates(
    contestants: Sequence[tuple[str, Stepping]],
    seconds: float,
    rounds: int,
    progress: Callable[[str], None],
) -> list[Spread]:
    """Steps per second of each contestant, with its title, which are measured in turn."""
    rates: list[list[float]] = []
    for _, stepping in contestants:
        stepping(0.0)  # compiles and allocates
        rates.append([])
    for _ in range(rounds):
        for (title, stepping), measured in zip(contestants, rates, strict=True):
            progress(title)
            steps, took = stepping(seconds)
            measured.append(steps / took)
    return [(median(each), min(each), max(each)) for each in rates]


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
                make = partial(making.compiled, settings, "idm_mobil", scenes=scenes)
                with _processes(make, threads) as stepping:
                    (spread,) = _rates([("", stepping)], seconds, rounds, lambda title: None)
                measured.append(Measurement("batched", threads, vehicles, *spread, scenes))
    return measured


def _engines(settings: SceneSettings, traffic: str, stack: ExitStack) -> list[Contestant]:
    crowded = settings.model_copy(update={"traffic_vehicles": 199})
    cores, vehicles = os.cpu_count() or 1, settings.vehicles
    reference = making.compiled(settings, traffic, HighwayEnvEngine, 1)
    together = stack.enter_context(_processes(partial(making.compiled, settings, traffic), cores))
    ours = [
        ("batched", 1, vehicles, making.compiled(settings, traffic)),
        ("batched", cores, vehicles, together),
        ("batched", 1, 200, making.compiled(crowded, traffic)),
        ("highway-env engine", 1, vehicles, reference),
        ("highway-env", 1, vehicles, making.highway_env(settings)),
    ]
    return ours + [
        ("EnvPool", threads, vehicles, making.envpool(settings, threads, 64 * threads))
        for threads in (1, cores)
        if find_spec("envpool")
    ]


def _learners(settings: SceneSettings, stack: ExitStack) -> Iterator[Contestant]:
    """On one core and on all; the environments observe seven rows of `Kinematics`."""
    cores, ours, theirs = os.cpu_count() or 1, making.learners, making.highway_env_learners
    for name, count, make in (
        ("LearnersVectorEnv", 1, ours),
        ("LearnersVectorEnv", cores, ours),
        ("highway-env, one core", 1, theirs),
        ("highway-env", cores, theirs),
    ):
        stepping = stack.enter_context(_processes(partial(make, settings), count))
        yield name, count, settings.vehicles, stepping


def _vector_environments(settings: SceneSettings, traffic: str, count: int) -> Iterator[Contestant]:
    """All of them observe seven rows of `Kinematics`.

    highway-env's environments run in one process, or in one process each. EnvPool is measured if
    it is installed.
    """
    import gymnasium
    import highway_env  # noqa: F401  # registers highway-v0

    from charms_bench import envs

    theirs = making.config(settings)
    ours: dict[str, Any] = {
        "traffic": traffic,
        "traffic_vehicles": settings.traffic_vehicles,
        "observation": OBSERVATION,
    }
    processes = min(count, os.cpu_count() or 1)  # that run at the same time
    idle = np.full(count, IDLE)
    for name, threads, environments in (
        ("Ego-v0", 1, gymnasium.make_vec(envs.ID, count, **ours)),
        ("highway-env, sync", 1, gymnasium.make_vec("highway-v0", count, "sync", config=theirs)),
        ("highway-env", processes, gymnasium.make_vec("highway-v0", count, "async", config=theirs)),
    ):
        environments.reset(seed=SEED)
        stepping = making.vector_environments(environments, count, lambda: idle)
        yield name, threads, settings.vehicles, stepping
    if find_spec("envpool"):
        yield "EnvPool", 1, settings.vehicles, making.envpool(settings, 1, count)


@contextmanager
def _processes(make: Callable[[], Stepping], count: int) -> Iterator[Stepping]:
    """Makes a contestant in each of several processes of one thread, and runs them together."""
    with Pool(partial(_run, make), count, environment=ONE_THREAD) as pool:

        def run(seconds: float) -> tuple[int, float]:
            pool.add([seconds] * count)
            answers = [answer for _, answer in pool.results()]
            return sum(steps for steps, _ in answers), max(took for _, took in answers)

        yield run


def _run(make: Callable[[], Stepping], seconds: float) -> tuple[int, float]:
    """Runs a contestant that is made once in each process."""
    return _made(make)(seconds)


@cache
def _made(make: Callable[[], Stepping]) -> Stepping:
    return make()

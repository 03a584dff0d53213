"""How much a driver is like recorded drivers in recorded scenes on their own roads.

A driver takes the places of recorded drivers for as long as their scenes last. The components are
those of `humans.likeness`, with three differences, because scenes last seconds: the closed loop
compares place and speed after 1, 2, 4 and 8 s, and 1 is the recording itself; drivers are not put
into situations that no recording has; and lane changes are not counted. Halves are halves of the
scenes, and 0 is constant speed along the way.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from charms_bench.engine.endings import RUNNING, TIME
from charms_bench.engine.simulation import Simulation
from charms_bench.humans.driven_situations import Driven
from charms_bench.humans.likeness import Score, Yardstick
from charms_bench.humans.resimulation import FEWEST_DRIVERS, REPETITIONS
from charms_bench.plugins.agent import Agent, DriverModel
from charms_bench.plugins.traffic import Traffic
from charms_bench.roads.engine import RoadEngine
from charms_bench.roads.settings import moments_on
from charms_bench.statistics.energy_score import energy_score
from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings, Vehicles

HORIZONS_S = (1, 2, 4, 8)
BESIDE_M = 0.01
"""The least gap of vehicles that do not collide: a leader can be beside its follower."""


class ConstantSpeed(DriverModel):
    """Keeps its speed and its lane."""

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        return np.zeros(vehicles[0].size), scene.lane[vehicles]


class AsRecorded(ConstantSpeed):
    """Moves as recorded."""

    follows_recording = True


def scenes_in(path: Path) -> list[Path]:
    """The CommonRoad scenarios in a folder without other recordings, or the one that a file is."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    found = [each for each in files if each.suffix == ".xml"]
    return [] if any(each.suffix == ".csv" for each in files) else found


def drive_in_scene(
    settings: SceneSettings,
    ego: str,
    traffic: Traffic,
    agents: Mapping[str, Agent],
    repetitions: int = REPETITIONS,
) -> Floats:
    """(S, M, T, 6) x, y, speed as it stands after a collision, speed, gap and the leader's speed.

    An ego's agent is in the places of the S recorded egos of a scene, M times, at 1 Hz. Neither its
    goal nor leaving its lane is the end.
    """
    network = settings.network
    assert network is not None
    profile = settings.profile.model_copy(update={"offroad_terminal": False})
    settings = settings.model_copy(update={"profile": profile})
    egos = len(moments_on(network))
    count, seconds = egos * repetitions, int(settings.duration_s + 1e-3)
    simulation = Simulation(settings, count, ego, traffic, agents, RoadEngine)
    simulation.reset(np.arange(count, dtype=np.uint64))
    engine = simulation.engine
    assert isinstance(engine, RoadEngine)
    engine.episodes.scenes.vehicles["goal_s"][:, 0] = np.inf
    found = []
    for second in range(1 + seconds):
        for _ in range(settings.simulation_hz if second else 0):
            simulation.advance()
            if simulation.phase == settings.steps_per_decision:
                simulation.finish_step()
        scene, state = engine.scene, engine.state
        own = np.arange(count), scene.ego
        drives = np.isin(simulation.ending, (RUNNING, TIME))
        leader, follows = scene.leader(own, scene.lane[own])
        gap = np.where(follows, np.maximum(scene.gap_to(own, leader), BESIDE_M), np.inf)
        speed = np.where(drives, scene.speed[own], np.nan)
        ahead = np.where(follows, scene.speed[own[0], leader], speed)
        values = state.x[:, 0], state.y[:, 0], np.nan_to_num(speed), speed
        found.append(np.stack([*values, np.where(drives, gap, 0.0), ahead], axis=-1))
    by_ego = np.stack(found, axis=1).reshape(repetitions, egos, 1 + seconds, 6)
    return np.moveaxis(by_ego, 0, 1)


def in_scenes(parts: Sequence[Floats]) -> Driven:
    """What a driver did in all scenes, of what it did in each; `Driven.driver` is the scene."""
    longest = max(each.shape[2] for each in parts)
    same = [
        np.pad(each, ((0, 0), (0, 0), (0, longest - each.shape[2]), (0, 0)), constant_values=np.nan)
        for each in parts
    ]
    number = np.repeat(np.arange(len(parts)), [len(each) for each in parts])
    x, y, stands, speed, gap, ahead = np.moveaxis(np.concatenate(same), -1, 0)
    lanes = np.full((len(parts), 4), np.nan)
    return Driven(number, gap, speed, ahead, lanes, np.stack([x, y, stands], axis=-1))


class SceneYardstick(Yardstick):
    """The recorded drivers of scenes, and a vehicle at constant speed, which scores 0."""

    def __init__(self, human: Driven, constant: Driven) -> None:
        """Both drove in the same S situations."""
        self.horizons_s = tuple(
            each for each in HORIZONS_S if _scenes_until(human, each) >= FEWEST_DRIVERS
        )
        """Those that enough scenes reach."""
        apart = _reached(constant)[:, :1] - _reached(human)
        squares = np.nanmean(apart[:, 0, self.horizons_s, :] ** 2, axis=0)
        place, speed = squares[:, :2].sum(axis=-1), squares[:, 2]
        super().__init__(
            human, constant, constant, human, np.sqrt(np.stack([place, place, speed], axis=-1))
        )

    def scores(self, tested: Driven) -> dict[str, Score]:
        """As for a `Yardstick`, without what the scenes are too few or too short for."""
        return _computed(super().scores(tested))

    def ceiling(self) -> dict[str, Score]:
        return _computed({"closed_loop": Score(1.0, 1.0, 1.0), **super().ceiling()})

    def _unseen(self, driven: Driven) -> Driven:
        return driven

    def _energy_of(self, driven: Driven) -> Floats:
        found = np.zeros((self._drivers, len(self.horizons_s)))
        for k, horizon_s in enumerate(self.horizons_s):
            draws, observed = (_reached(each)[:, :, horizon_s] for each in (driven, self._human))
            lasts = np.isfinite(observed[:, 0, 0])
            scores = energy_score(
                draws[lasts] / self._scales[k], observed[lasts, 0] / self._scales[k]
            )
            found[:, k] = np.bincount(self._number[lasts], scores, self._drivers)
        return found


def _computed(scores: dict[str, Score]) -> dict[str, Score]:
    return {name: each for name, each in scores.items() if np.isfinite(each.low)}


def _reached(driven: Driven) -> Floats:
    assert driven.reached is not None
    return driven.reached


def _scenes_until(driven: Driven, second: int) -> int:
    """How many scenes last for so many seconds."""
    if second >= driven.speed.shape[-1]:
        return 0
    return np.unique(driven.driver[np.isfinite(_reached(driven)[:, 0, second, 0])]).size

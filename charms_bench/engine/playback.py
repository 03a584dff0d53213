"""Episodes that start at moments of recordings, and the vehicles that are moved as recorded.

A simulation step ends between two frames, or at one. Between two frames, positions, headings and
speeds are interpolated linearly. The vehicles of a `DriverModel.follows_recording` are put where
the recording says after every step.

A vehicle appears at the first step at or after its first frame. It stays out of the episode if its
place is not free then: it would overlap a vehicle, or one of the two would have to brake harder
than `DRAC_LIMIT_MPS2`. A vehicle that follows the recording leaves after its last frame; any other
drives on. Two vehicles that both follow the recording never collide, and let each other appear.
"""

import math
from typing import NamedTuple

import numpy as np

from charms_bench.engine.meta_actions import nearest_target_speed
from charms_bench.engine.parameters import set_parameters
from charms_bench.engine.running import RunningEpisodes
from charms_bench.engine.source import Source
from charms_bench.engine.stepping import Put
from charms_bench.errors import InputError
from charms_bench.foundation import maths
from charms_bench.foundation.compiled import compiled
from charms_bench.foundation.generator import seeded
from charms_bench.world.gaps import gap_to, requires_braking, side_gap
from charms_bench.world.recorded_moments import Tracks, moments_of
from charms_bench.world.road import closest_lane, heading_at, local_coordinates
from charms_bench.world.scene import Bools, Floats, Ints, Scene
from charms_bench.world.thresholds import DRAC_LIMIT_MPS2

DEVIATION_M = 2.0
"""An ego this far from its recorded position has deviated from the recording."""
_ROUNDING = 1e-9
"""Frames; times of steps are products and quotients of rates."""
_STREAM = 7
"""The random stream of a seed that draws temperaments; see `engine.parameters` for another."""


class Played(NamedTuple):
    """The moments of B scenes."""

    track: Ints
    """[B, N] the track of each place's vehicle, -1 for none."""
    frame: Ints
    """[B] the frame at the start."""
    frames_per_step: Floats
    """[B]"""


class Recorded(Source):
    """Vehicles that are at a recorded moment where an episode starts, and come and go after it.

    A `DataError` says that the recordings cannot be read, or have changed.
    """

    is_foreseen = False  # a planner does not know what was recorded next

    def __init__(self, episodes: RunningEpisodes) -> None:
        super().__init__(episodes)
        if not episodes.egos_end_episodes:
            raise InputError(
                "scene.recording: recorded vehicles that come and go cannot be driven from "
                "outside; expected an ego only"
            )
        shape = episodes.scene.x.shape
        self._moments = episodes.engine.moments or moments_of(episodes.settings)
        self._played = Played(np.full(shape, -1), np.zeros(shape[0], np.int64), np.ones(shape[0]))
        self._models = [*episodes.models]
        self._followers = episodes.follow_recording
        successor = episodes.traffic.after_deviation
        self._successor = episodes.agents.index(successor) if successor else -1
        self._speeds = np.array(episodes.settings.profile.target_speeds_mps, dtype=np.float64)
        self._put = Put.empty(shape)

    def resume(self, rows: Ints) -> None:
        """Plays the moments of these seeds in the scenes `rows` (R,)."""
        moments, played, episodes = self._moments, self._played, self._episodes
        number = moments.numbers_of(episodes.seeds[rows])
        played.track[rows] = moments.vehicles[number]
        played.frame[rows] = moments.frame[number]
        played.frames_per_step[rows] = moments.rate_hz[number] / episodes.settings.simulation_hz

    def start(self, rows: Ints, seats: Ints, draws: Floats | None) -> None:
        """Fills the scenes `rows` (R,) with the vehicles of their moments.

        The ego has the first place, and the others follow in the order in which they appear.
        """
        self.resume(rows)
        scene, seeds = self._episodes.scene, self._episodes.seeds[rows]
        self._episodes.engine.drivers[rows] = seats
        scene.generator[rows] = seeded(seeds)
        scene.ego[rows], scene.active[rows], scene.present[rows] = 0, True, False
        scene.acceleration[rows] = scene.steering[rows] = 0.0
        scene.crashed[rows] = scene.impact[rows] = False
        tracks, track = self._moments.tracks, self._played.track[rows]
        scene.length[rows], scene.width[rows] = tracks.length[track], tracks.width[track]
        vehicles = track.shape[1]
        draws = np.array([np.random.default_rng([int(seed), _STREAM]).random(vehicles)
                          for seed in seeds])  # fmt: skip
        scene.temperament[rows] = draws
        scene.order[rows] = scene.rank[rows] = np.arange(vehicles)
        self._appear(rows, np.zeros_like(self._episodes.steps), is_start=True)
        self._settle(rows)

    def before_step(self) -> None:
        """Has vehicles leave whose last frame is before the step's end."""
        episodes, put = self._episodes, self._put
        put.follows[:] = np.isin(episodes.engine.drivers, self._followers)
        play(episodes.engine.state, self._played, self._moments.tracks, episodes.frames + 1, put)
        if put.leaves.any():
            episodes.engine.state.present[put.leaves] = False
            self._settle(np.nonzero(put.leaves.any(axis=1))[0])

    def before_move(self) -> Put:
        """Where the step ends for the vehicles that follow the recording."""
        return self._put

    def after_step(self) -> None:
        """Has vehicles appear, and drivers take over that the ego's deviation calls for."""
        changed = np.zeros(self._episodes.seeds.size, dtype=np.bool_)
        if self._successor >= 0:
            changed |= self._hand_over()
        active = np.nonzero(self._episodes.engine.state.active)[0]
        changed[active] |= self._appear(active, self._episodes.frames)
        if changed.any():
            self._settle(np.nonzero(changed)[0])

    def _appear(self, rows: Ints, now: Ints, is_start: bool = False) -> Bools:
        """(R,) whether vehicles appear in the scenes `rows` (R,) at the steps `now` [B]."""
        episodes, tracks = self._episodes, self._moments.tracks
        drivers = episodes.engine.drivers
        follows, modelled = np.isin(drivers, self._followers), np.isin(drivers, self._models)
        seated = follows, modelled, np.isin(drivers, episodes.unrounded)
        return appear(
            episodes.engine.state, self._played, tracks, rows, now, is_start, *seated, self._speeds
        )

    def _hand_over(self) -> Bools:
        """(B,) whether other drivers take over now, because the ego has deviated."""
        episodes = self._episodes
        scene, drivers = episodes.engine.state, episodes.engine.drivers
        taken = np.isin(drivers, self._followers)
        taken[episodes.ego_vehicles] = False
        away = distances_of_egos(scene, self._played, self._moments.tracks, self._episodes.frames)
        taken &= (scene.active & (away > DEVIATION_M))[:, None]
        if taken.any():
            drivers[taken] = self._successor
            scene.repeats[taken] = 0
            if self._successor not in self._models:
                rounds = self._speeds.size and self._successor not in episodes.unrounded
                wanted = [nearest_target_speed(v, 0, self._speeds) if rounds else v
                          for v in scene.speed[taken]]  # fmt: skip
                scene.target_speed[taken] = wanted
        return np.asarray(taken.any(axis=1))

    def _settle(self, rows: Ints) -> None:
        """Has the engine take over what has changed in the scenes `rows` (R,)."""
        episodes = self._episodes
        episodes.engine.settle(rows, episodes.seeds[rows])
        set_parameters(episodes, rows)


class RecordedOnRoad(Recorded):
    """Vehicles of a recorded scene on its own road, which places them at the start."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        super().__init__(episodes)
        tracks, egos = self._moments.tracks, self._moments.vehicles[:, 0]
        ego = episodes.agents.index(episodes.ego_agent)
        needs_ego = self._successor >= 0 or ego in self._followers
        if needs_ego and (tracks.first[egos] == tracks.last[egos]).any():
            raise InputError(
                f"{episodes.settings.network}: the vehicle of a planning problem is not recorded, "
                "so it can neither drive as recorded nor deviate; expected another ego and other "
                "traffic, or configuration.start: recorded"
            )

    def start(self, rows: Ints, seats: Ints, draws: Floats | None) -> None:
        episodes = self._episodes
        episodes.engine.reset(rows, episodes.seeds[rows], seats, draws)
        self.resume(rows)


@compiled
def interpolated(tracks: Tracks, track: int, at: float) -> tuple[float, float, float, float]:
    """Position, heading and speed on a track at a frame, which may lie between two."""
    since = at - tracks.first[track]
    whole = math.floor(since + _ROUNDING)
    k, part = tracks.row[track] + whole, since - whole
    x, y, heading, speed = tracks.x[k], tracks.y[k], tracks.heading[k], tracks.speed[k]
    if part > _ROUNDING:
        x += part * (tracks.x[k + 1] - x)
        y += part * (tracks.y[k + 1] - y)
        heading += part * (tracks.heading[k + 1] - heading)
        speed += part * (tracks.speed[k + 1] - speed)
    return x, y, heading, speed


@compiled
def play(scene: Scene, played: Played, tracks: Tracks, steps: Ints, put: Put) -> None:
    """Fills in where the vehicles that follow the recording are after the step `steps` [B]."""
    dt = scene.constants.dt
    for b in range(scene.active.size):
        at = played.frame[b] + steps[b] * played.frames_per_step[b]
        for i in range(scene.x.shape[1]):
            put.moves[b, i] = put.leaves[b, i] = False
            # A vehicle that has joined at the place later has another number.
            track = played.track[b, i] if scene.entry[b, i] == i else -1
            is_here = scene.active[b] and scene.present[b, i] and not scene.crashed[b, i]
            if not (is_here and put.follows[b, i] and track >= 0):
                continue
            if at > tracks.last[track] + _ROUNDING:
                put.leaves[b, i] = True
                continue
            x, y, heading, speed = interpolated(tracks, track, at)
            put.moves[b, i] = True
            put.x[b, i], put.y[b, i], put.heading[b, i], put.speed[b, i] = x, y, heading, speed
            put.acceleration[b, i] = (speed - scene.speed[b, i]) / dt


@compiled
def appear(
    scene: Scene,
    played: Played,
    tracks: Tracks,
    rows: Ints,
    steps: Ints,
    is_start: bool,
    follows: Bools,
    modelled: Bools,
    unrounded: Bools,
    speeds: Floats,
) -> Bools:
    """Places the vehicles that appear in the scenes `rows` (R,) at the step `steps` [B].

    At the start, these are all that are recorded then. Returns whether a scene has any (R,).
    """
    period = scene.constants.idm_mobil.lane_change_period_s
    changed = np.zeros(rows.size, dtype=np.bool_)
    for r in range(rows.size):
        b = rows[r]
        at = played.frame[b] + steps[b] * played.frames_per_step[b]
        before = -np.inf if is_start else at - played.frames_per_step[b]
        for i in range(scene.x.shape[1]):
            track = played.track[b, i] if scene.entry[b, i] == i else -1
            if track < 0 or scene.present[b, i]:
                continue
            first = tracks.first[track]
            is_new = before + _ROUNDING < first <= at + _ROUNDING
            if not is_new or at > tracks.last[track] + _ROUNDING:
                continue
            x, y, heading, speed = interpolated(tracks, track, at)
            lane = closest_lane(scene.road, x, y, heading)
            if not is_start and not is_free(scene, b, i, x, y, lane, speed, follows):
                continue
            scene.x[b, i], scene.y[b, i], scene.heading[b, i] = x, y, heading
            scene.speed[b, i], scene.present[b, i] = speed, True
            scene.acceleration[b, i] = scene.steering[b, i] = 0.0
            scene.target_lane[b, i] = lane
            wanted = tracks.fastest[track] if modelled[b, i] else speed
            if speeds.size and not unrounded[b, i]:
                wanted = nearest_target_speed(speed, 0, speeds)
            scene.target_speed[b, i] = wanted
            phase = (x + y) * math.pi  # as IDMVehicle.__init__
            scene.timer_s[b, i] = phase % period
            changed[r] = True
    return changed


@compiled
def is_free(
    scene: Scene, b: int, i: int, x: float, y: float, lane: int, speed: float, follows: Bools
) -> bool:
    """Whether a vehicle can appear at a position on a lane; see the module."""
    s, _ = local_coordinates(scene.road, lane, x, y)
    sine, cosine = maths.sin_cos(heading_at(scene.road, lane, s))
    for j in range(scene.x.shape[1]):
        if j == i or not scene.present[b, j] or (follows[b, i] and follows[b, j]):
            continue
        dx, dy = scene.x[b, j] - x, scene.y[b, j] - y
        aside = dy * cosine - dx * sine
        if side_gap(0.0, aside, scene.width[b, i], scene.width[b, j]) > 0:
            continue
        distance = dx * cosine + dy * sine
        is_ahead = distance > 0
        gap = gap_to(abs(distance), scene.length[b, i], scene.length[b, j])
        closing = speed - scene.speed[b, j] if is_ahead else scene.speed[b, j] - speed
        if gap <= 0 or requires_braking(gap, closing, DRAC_LIMIT_MPS2):
            return False
    return True


@compiled
def distances_of_egos(scene: Scene, played: Played, tracks: Tracks, steps: Ints) -> Floats:
    """(B,) how far egos are from where their vehicles are recorded at the step `steps` [B]."""
    away = np.zeros(steps.size)
    for b in range(steps.size):
        if scene.active[b]:
            at = played.frame[b] + steps[b] * played.frames_per_step[b]
            ego = scene.ego[b]
            x, y, _, _ = interpolated(tracks, played.track[b, ego], at)
            away[b] = math.sqrt((scene.x[b, ego] - x) ** 2 + (scene.y[b, ego] - y) ** 2)
    return away

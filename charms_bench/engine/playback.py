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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.meta_actions import nearest_target_speed
from charms_bench.engine.parameters import set_parameters
from charms_bench.engine.state import vacate
from charms_bench.engine.stepping import Put
from charms_bench.foundation.compiled import compiled
from charms_bench.foundation.generator import seeded
from charms_bench.plugins.agent import DriverModel
from charms_bench.world.actions import follows_profile
from charms_bench.world.gaps import gap_to, side_gap
from charms_bench.world.moments import Tracks, moments_of
from charms_bench.world.road import closest_lane
from charms_bench.world.scene import Bools, Floats, Ints, Scene
from charms_bench.world.thresholds import DRAC_LIMIT_MPS2

if TYPE_CHECKING:
    from charms_bench.engine.simulation import Simulation

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


class Playback:
    """Starts the episodes of a simulation at recorded moments, and has vehicles come and go."""

    def __init__(self, simulation: "Simulation", after_deviation: str) -> None:
        shape = simulation.scene.x.shape
        self._made = simulation
        self._moments = moments_of(simulation.settings)
        self._played = Played(np.full(shape, -1), np.zeros(shape[0], np.int64), np.ones(shape[0]))
        models = [(k, a) for k, a in simulation.made.items() if isinstance(a, DriverModel)]
        self._models = [k for k, _ in models]
        own = simulation.own_actions
        self._unrounded = [*self._models, *(k for k in own if not follows_profile(own[k]))]
        """Agents whose vehicles do not start at one of the profile's target speeds."""
        self._followers = [k for k, model in models if model.follows_recording]
        agents = simulation.agents
        self._successor = agents.index(after_deviation) if after_deviation else -1
        self._speeds = np.array(simulation.settings.profile.target_speeds_mps, dtype=np.float64)
        self._put = Put.empty(shape)

    def choose(self, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        """Plays the moments of these seeds in the scenes `rows` (R,)."""
        moments, played = self._moments, self._played
        number = moments.numbers_of(seeds)
        played.track[rows] = moments.vehicles[number]
        played.frame[rows] = moments.frame[number]
        played.frames_per_step[rows] = moments.rate_hz[number] / self._made.settings.simulation_hz

    def start(self, rows: Ints, seeds: NDArray[np.uint64], agents: Ints) -> None:
        """Fills the scenes `rows` (R,) with the vehicles of their moments.

        The ego has the first place, and the others follow in the order in which they appear.
        `agents` (R, N) are the agent of the ego, and then those of the other vehicles.
        """
        self.choose(rows, seeds)
        made, scene = self._made, self._made.scene
        made.engine.drivers[rows] = agents
        scene.generator[rows] = seeded(seeds)
        scene.ego[rows], scene.active[rows], scene.present[rows] = 0, True, False
        scene.acceleration[rows] = scene.steering[rows] = 0.0
        scene.crashed[rows] = scene.impact[rows] = False
        tracks, track = self._moments.tracks, self._played.track[rows]
        scene.length[rows], scene.width[rows] = tracks.length[track], tracks.width[track]
        vehicles = track.shape[1]
        draws = [np.random.default_rng([int(seed), _STREAM]).random(vehicles) for seed in seeds]
        scene.temperament[rows] = draws
        scene.order[rows] = scene.rank[rows] = np.arange(vehicles)
        self._appear(rows, is_start=True)
        self._settle(rows)

    def before_step(self) -> Put:
        """Has vehicles leave whose last frame is before the next step's end.

        Returns where that step ends for those that follow the recording.
        """
        made, put = self._made, self._put
        put.follows[:] = np.isin(made.engine.drivers, self._followers)
        step = self._now() + 1
        play(made.scene, self._played, self._moments.tracks, step, put)
        if put.leaves.any():
            made.scene.present[put.leaves] = False
            self._settle(np.nonzero(put.leaves.any(axis=1))[0])
        return put

    def after_step(self) -> None:
        """Has vehicles appear, and drivers take over that the ego's deviation calls for."""
        changed = np.zeros(self._made.seeds.size, dtype=np.bool_)
        if self._successor >= 0:
            changed |= self._hand_over()
        active = np.nonzero(self._made.scene.active)[0]
        changed[active] |= self._appear(active)
        if changed.any():
            self._settle(np.nonzero(changed)[0])

    def _now(self) -> Ints:
        """(B,) the simulation steps since the start."""
        made = self._made
        return np.asarray(made.steps * made.settings.steps_per_decision + made.phase)

    def _appear(self, rows: Ints, is_start: bool = False) -> Bools:
        """(R,) whether vehicles appear now in the scenes `rows` (R,)."""
        made, tracks = self._made, self._moments.tracks
        now = np.zeros_like(made.steps) if is_start else self._now()
        drivers = made.engine.drivers
        follows, modelled = np.isin(drivers, self._followers), np.isin(drivers, self._models)
        seated = follows, modelled, np.isin(drivers, self._unrounded)
        return appear(made.scene, self._played, tracks, rows, now, is_start, *seated, self._speeds)

    def _hand_over(self) -> Bools:
        """(B,) whether other drivers take over now, because the ego has deviated."""
        made, scene, drivers = self._made, self._made.scene, self._made.engine.drivers
        taken = np.isin(drivers, self._followers)
        taken[made.ego_vehicles] = False
        away = distances_of_egos(scene, self._played, self._moments.tracks, self._now())
        taken &= (scene.active & (away > DEVIATION_M))[:, None]
        if taken.any():
            drivers[taken] = self._successor
            scene.repeats[taken] = 0
            if self._successor not in self._models:
                rounds = self._speeds.size and self._successor not in self._unrounded
                wanted = [nearest_target_speed(v, 0, self._speeds) if rounds else v
                          for v in scene.speed[taken]]  # fmt: skip
                scene.target_speed[taken] = wanted
        return np.asarray(taken.any(axis=1))

    def _settle(self, rows: Ints) -> None:
        """Has the engine take over what has changed in the scenes `rows` (R,)."""
        made = self._made
        vacate(made.scene, rows)
        made.engine.restore(rows, made.seeds[rows])
        set_parameters(made, rows)


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
            put.lane[b, i] = closest_lane(scene.road, x, y, heading)


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
            if not is_start and not is_free(scene, b, i, x, y, speed, follows):
                continue
            scene.x[b, i], scene.y[b, i], scene.heading[b, i] = x, y, heading
            scene.speed[b, i], scene.present[b, i] = speed, True
            scene.acceleration[b, i] = scene.steering[b, i] = 0.0
            scene.target_lane[b, i] = closest_lane(scene.road, x, y, heading)
            wanted = tracks.fastest[track] if modelled[b, i] else speed
            if speeds.size and not unrounded[b, i]:
                wanted = nearest_target_speed(speed, 0, speeds)
            scene.target_speed[b, i] = wanted
            phase = (x + y) * math.pi  # as IDMVehicle.__init__
            scene.timer_s[b, i] = phase % period
            changed[r] = True
    return changed


@compiled
def is_free(scene: Scene, b: int, i: int, x: float, y: float, speed: float, follows: Bools) -> bool:
    """Whether a vehicle can appear at a position; see the module."""
    for j in range(scene.x.shape[1]):
        if j == i or not scene.present[b, j] or (follows[b, i] and follows[b, j]):
            continue
        if side_gap(y, scene.y[b, j], scene.width[b, i], scene.width[b, j]) > 0:
            continue
        distance = scene.x[b, j] - x
        is_ahead = distance > 0
        gap = gap_to(abs(distance), scene.length[b, i], scene.length[b, j])
        closing = speed - scene.speed[b, j] if is_ahead else scene.speed[b, j] - speed
        if gap <= 0 or (closing > 0 and closing**2 > 2 * DRAC_LIMIT_MPS2 * gap):
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

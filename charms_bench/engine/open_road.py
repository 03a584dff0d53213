"""Open boundaries: after a simulation step, vehicles enter a straight road, and others leave it.

Arrivals are a Poisson process that depends on an episode's seed alone. A vehicle that has arrived
enters at x = 0, on the lane with the most room behind the last vehicle that is on it or steers to
it. It enters as fast as that vehicle, or at its desired speed if that is lower, when at least the
gap that the profile's IDM wants at that speed is ahead of it. Until then it waits before the road,
and those after it wait too. A vehicle leaves when its centre has reached the end.

Both engines use this module. A state has all that it needs: the last vehicle's number says who has
entered.
"""

import math
from typing import NamedTuple

import numpy as np

from charms_bench.engine.collision_kinds import NO_COLLISION
from charms_bench.engine.endings import RUNNING, TIME
from charms_bench.engine.parameters import set_parameters
from charms_bench.engine.running import RunningEpisodes
from charms_bench.engine.seats import vacate
from charms_bench.engine.source import Source
from charms_bench.engine.type_draws import draw_vehicles
from charms_bench.errors import InputError
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.world.gaps import following_distance, overhang
from charms_bench.world.idm_mobil import equilibrium_gap
from charms_bench.world.road import is_near_lane, position
from charms_bench.world.scene import Bools, Floats, Ints, Scene

STREAM, AGENTS_STREAM = 6, 7
"""The random streams of a seed that draw arrivals and their agents."""


class _Arrival(NamedTuple):
    """A vehicle that enters; SI units."""

    number: int
    """In the order of entry [`Scene.entry`]."""
    desired_speed: float
    length: float
    width: float
    temperament: float


class Inflow(Source):
    """Vehicles that enter at the start of the road and leave at its end."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        super().__init__(episodes)
        if not episodes.egos_end_episodes:
            what = "vehicles that enter need a driver; expected an ego only"
            raise InputError(f"scene.inflow: {what}")
        settings = episodes.settings
        assert settings.inflow is not None
        self._per_s = settings.inflow.vehicles_per_hour_and_lane * settings.lanes / 3600
        expected = self._per_s * settings.duration_s
        self._most = math.ceil(expected + 10 * math.sqrt(expected) + 10)
        """More vehicles than ever arrive in an episode."""
        scenes = episodes.seeds.size
        self._times_s = np.full((scenes, self._most + 1), np.inf)
        self._agents = np.zeros((scenes, self._most), dtype=np.int64)
        self._entered = np.zeros(scenes, dtype=np.int64)
        self._next: list[_Arrival | None] = [None] * scenes

    def start(self, rows: Ints, seats: Ints, draws: Floats | None) -> None:
        """Leaves only the vehicles at the start."""
        episodes = self._episodes
        episodes.scene.present[rows, 1 + episodes.settings.traffic_vehicles :] = False
        vacate(episodes.scene, rows)
        episodes.engine.restore(rows, episodes.seeds[rows])
        self.resume(rows)

    def resume(self, rows: Ints) -> None:
        """Draws the arrivals, and their agents."""
        episodes = self._episodes
        for row in rows.tolist():
            rng = np.random.default_rng([int(episodes.seeds[row]), STREAM])
            self._times_s[row, :-1] = rng.exponential(1 / self._per_s, self._most).cumsum()
            self._next[row] = None
        self._agents[rows] = episodes.seats_of(AGENTS_STREAM, rows, self._most)
        last = episodes.scene.entry[rows].max(axis=1)
        self._entered[rows] = last + 1 - episodes.settings.vehicles

    def after_step(self) -> None:
        """Lets vehicles leave and enter; raises an `InputError` if a scene is full."""
        episodes, scene = self._episodes, self._episodes.scene
        end = episodes.settings.profile.road_length_m
        changed = have_left(scene, end)
        if changed.any():
            vacate(scene, np.nonzero(changed)[0])
        times_s = episodes.frames / episodes.settings.simulation_hz
        due = self._times_s[episodes.everyone, self._entered] <= times_s
        for row in np.nonzero(due & scene.active)[0]:
            changed[row] |= self._enter(int(row), times_s[row])
        if changed.any():
            rows = np.nonzero(changed)[0]
            episodes.engine.restore(rows, episodes.seeds[rows])

    def _enter(self, row: int, time_s: float) -> bool:
        """Lets vehicles enter a scene that have arrived until a time; returns whether any has."""
        episodes, scene, has_entered = self._episodes, self._episodes.scene, False
        c = episodes.settings.profile.idm_mobil
        while self._times_s[row, self._entered[row]] <= time_s:
            newcomer = self._next[row] = self._next[row] or self._arrival(row)
            lane, room, leader_speed = entrance(scene, row, newcomer.length)
            speed = min(newcomer.desired_speed, leader_speed)
            if room < equilibrium_gap(speed, c):
                break
            self._admit(row, newcomer, lane, speed)
            # The next vehicle sees it.
            episodes.engine.restore(np.array([row]), episodes.seeds[[row]])
            has_entered = True
        return has_entered

    def _arrival(self, row: int) -> _Arrival:
        """The next vehicle that enters a scene."""
        episodes, profile = self._episodes, self._episodes.settings.profile
        number = episodes.settings.vehicles + self._entered[row]
        entry, is_ego = np.array([[number]]), np.array([[False]])
        drawn = draw_vehicles(episodes.settings, episodes.seeds[[row]], entry, is_ego)
        desired, length, width = (float(each[0, 0]) for each in drawn)
        rng = np.random.default_rng([int(episodes.seeds[row]), STREAM, int(number)])
        fraction, temperament = rng.random(2).tolist()
        low, high = profile.spawn_speed_low, profile.spawn_speed_high
        if math.isnan(desired):
            desired = (low + (high - low) * fraction) * profile.speed_limit_mps
        return _Arrival(int(number), desired, length, width, temperament)

    def _admit(self, row: int, newcomer: _Arrival, lane: int, speed: float) -> None:
        """Puts the next vehicle at the start of a lane."""
        episodes, scene = self._episodes, self._episodes.scene
        is_free = ~scene.present[row]
        is_free[scene.ego[row]] = False
        if not is_free.any():
            raise InputError(
                f"scene.inflow.capacity: episode {episodes.seeds[row]} is full at step "
                f"{episodes.steps[row]}, with {scene.present[row].sum()} vehicles; use a larger "
                "number"
            )
        at = row, int(is_free.argmax())
        _, y = position(scene.road, lane, 0.0, 0.0)
        period = scene.constants.idm_mobil.lane_change_period_s
        values = {
            "present": True,
            "entry": newcomer.number,
            "x": 0.0,
            "y": y,
            "speed": speed,
            "length": newcomer.length,
            "width": newcomer.width,
            "target_speed": newcomer.desired_speed,
            "target_lane": lane,
            "temperament": newcomer.temperament,
            "timer_s": (y * math.pi) % period,  # as IDMVehicle.__init__
        }
        others = ("heading", "acceleration", "steering", "repeats", "memory", "crashed", "impact")
        for name, value in {**values, **dict.fromkeys(others, 0)}.items():
            getattr(scene, name)[at] = value
        episodes.engine.drivers[at] = self._agents[row, self._entered[row]]
        episodes.has_action[at], episodes.collision[at] = False, NO_COLLISION
        set_parameters(episodes, np.array(at[:1]), np.array(at[1:]))
        self._entered[row] += 1
        self._next[row] = None

    def after_decision(self) -> None:
        """Ends the episodes whose egos have reached the end of the road."""
        episodes, egos = self._episodes, self._episodes.ego_vehicles
        at_end = episodes.scene.x[egos] >= episodes.settings.profile.road_length_m
        episodes.ending[at_end & (episodes.ending == RUNNING)] = TIME


@compiled_of_scenes
def have_left(scene: Scene, end: float) -> Bools:
    """Removes the vehicles at or beyond the end, except egos; returns in which scenes (B,)."""
    found = np.zeros(scene.ego.size, dtype=np.bool_)
    for b in range(scene.ego.size):
        k = scene.x.shape[1] - 1
        while scene.active[b] and k >= 0 and scene.x[b, scene.order[b, k]] >= end:
            i = scene.order[b, k]
            if i != scene.ego[b]:
                scene.present[b, i] = False
                found[b] = True
            k -= 1
    return found


@compiled_of_scenes
def entrance(scene: Scene, b: int, length: float) -> tuple[int, float, float]:
    """The lane on which a new vehicle has most room, m, that room, and its leader's speed, m/s."""
    c, road, best, most, speed = scene.constants, scene.road, 0, -math.inf, 0.0
    own = overhang(length, c.length)
    for lane in range(road.lanes):
        room, its = math.inf, math.inf
        for k in range(scene.x.shape[1]):
            i = scene.order[b, k]
            is_there = is_near_lane(road, lane, scene.y[b, i]) or scene.target_lane[b, i] == lane
            if scene.present[b, i] and is_there:
                other = overhang(scene.length[b, i], c.length)
                room = following_distance(scene.x[b, i], own, other)
                its = scene.speed[b, i]
                break
        if room > most:
            best, most, speed = lane, room, its
    return best, most, speed

"""What is kept of every vehicle: frames, from which all rows are computed.

A frame is one scene at one moment. There is one at every decision. Where vehicles collide between
two decisions, there is one more: fault depends on how they met, and one simulation step later the
wrecks have moved on. The ego and all other vehicles are kept alike.

A shard can have 20,000 decisions or 2,001 vehicles. So rows are computed from a frame when it has
been taken, and then only the last decision of each scene is kept.
"""

from typing import Any, NamedTuple

import numpy as np

from charms_bench.engine.collision_kinds import NO_COLLISION
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.views import Views
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, index, inlined
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT
from charms_bench.world.road import Straight, distance_along, is_on_lane
from charms_bench.world.scene import Bools, Ints, Scene

LONG_AGO = -1_000_000
NOBODY = -1
Some = tuple[int, int]
"""The vehicles from one place until before another one, in compiled code."""


def record(**fields: str) -> np.dtype[np.void]:
    """A type of records, from the names of its fields by NumPy's codes for their types."""
    types = [(name, code) for code, names in fields.items() for name in names.split()]
    return np.dtype(types, align=True)


MOMENT = record(i8="scene now before decision first after seen seen_after", b1="ends")
"""When a frame was taken.

now, before: The vehicles in this frame and at the decision before, or at the start.
decision: The decision interval that the frame ends or is in, counted from 1.
first, after: The vehicles that are looked at, until before `after`; in a frame, all.
seen, seen_after: The rows of `SEEN` of the only vehicle that is looked at; in a frame, none.
ends: Whether the episode has ended.
"""
VEHICLE = record(
    f8="x y heading direction_x direction_y speed acceleration steering length width",
    i4="lane_since target_since",
    i2="left_leader leader right_leader left_follower follower right_follower",
    i1="lane target_lane action collision",
    b1="crashed is_on_road lost",
)
"""A vehicle in a frame; fields without a comment are those of `Scene` and `Simulation`.

lane_since, target_since: The decisions at which the nearest lane and the target lane last changed.
leader, follower: On the nearest lane, or `NOBODY`; the others are on the lanes beside it.
action: -1 stands for none.
is_on_road: Whether the centre is on the nearest lane.
lost: Whether the vehicle has crashed or left the road, in this frame or at a decision before it.
"""
SEEN = record(f8="x y direction_x direction_y", i2="place", i1="lane target_lane")
"""Another vehicle as one sees it along its own way, where it differs from `VEHICLE`.

A vehicle that is looked at has `NEAR` rows: its left leader, its leader, its right leader and its
follower. Their `place` is `NOBODY` if there is none. More rows, if any, are all other vehicles,
without directions."""
NEAR = 4


@inlined
def distance_to(road: Straight, own: Any, other: Any) -> float:
    """How far another vehicle of a frame is ahead along a vehicle's lane, m, centre to centre."""
    return float(distance_along(road, own.lane, own.x, own.y, other.x, other.y))


class Frames(NamedTuple):
    """The frames of some scenes, as `MOMENT` (S,) and `VEHICLE` (2 B, N)."""

    moments: Any
    vehicles: Any


class Primitives:
    """Takes frames of a simulation with B scenes, which begin now.

    With `views`, each vehicle is described along its own way, without its neighbours, and else
    along that of the ego; on the straight road, this is the same.
    """

    def __init__(self, simulation: Simulation, views: Views | None = None) -> None:
        scenes, vehicles = simulation.scene.x.shape
        self._simulation, self._views = simulation, views
        self._vehicles = np.zeros((2 * scenes, vehicles), dtype=VEHICLE)
        self._last = np.arange(scenes)
        scene = self.scene
        self._collided = scene.crashed.copy()
        self._present = scene.present.copy()
        self._entry = scene.entry.copy()
        settings = simulation.settings
        is_open = settings.recording is not None or settings.inflow is not None
        self.changes = is_open or settings.network is not None or not self._present.all()
        """Whether vehicles can appear and leave."""
        self.left = np.zeros_like(self._present)
        """[B, N] the places whose vehicle has left in the last decision interval."""
        self.at_decision(self._last.copy())
        self._vehicles["lane_since"] = LONG_AGO
        self._vehicles["target_since"] = 0
        self._vehicles["lost"] = False
        self._vehicles["lost"][self._last] = ~scene.present

    @property
    def scene(self) -> Scene:
        """The vehicles that count, as they are now."""
        return self._simulation.scene if self._views is None else self._views.own

    def last(self, name: str) -> Any:
        """[B, N] a field of the vehicles at the last decision, or at the start."""
        return self._vehicles[name][self._last]

    def at_decision(self, scenes: Ints) -> Frames:
        """The frames of the scenes (S,) at the decision that has just been reached."""
        scene = self.scene
        if self.changes:
            self.left = self._present & ~(scene.present & (scene.entry == self._entry))
            self._collided &= ~self.left
        frames = self.take(scenes, 0)
        self._last[scenes] = frames.moments["now"]
        if self.changes:
            self._present[scenes] = scene.present[scenes]
            self._entry[scenes] = scene.entry[scenes]
        return frames

    def at_collision(self) -> Frames:
        """The frames of the scenes in which vehicles have just collided."""
        collided = self._simulation.collision != NO_COLLISION
        scenes = np.nonzero((collided & ~self._collided).any(axis=1))[0]
        self._collided |= collided
        return self.take(scenes, 1)

    def take(self, scenes: Ints, ahead: int) -> Frames:
        """The frames of the scenes (S,), whose decision is the last one or some `ahead`."""
        made, scene = self._simulation, self.scene
        collision = made.collision if self._views is None else self._views.collision
        moments = np.empty(scenes.size, dtype=MOMENT)
        note_moments(scenes, self._last, made.steps, ahead, scene.active, moments)
        moments["seen"] = moments["seen_after"] = moments["first"] = 0
        moments["after"] = scene.x.shape[1]
        frames = Frames(moments, self._vehicles)
        seen = (scene, *frames, collision, made.action, made.has_action)
        if self.changes:
            self._take_changing(seen, scenes, moments)
        else:
            take(*seen)
        return frames

    def _take_changing(self, seen: tuple[Any, ...], scenes: Ints, moments: Any) -> None:
        """Fills in frames of scenes (S,) in which vehicles have appeared or left.

        A vehicle counts from the first decision at which it is there until the last one.
        """
        scene, vehicles = self.scene, self._vehicles
        is_here, was_here = scene.present[scenes], self._present[scenes]
        has_stayed = is_here & was_here & (scene.entry[scenes] == self._entry[scenes])
        has_appeared = is_here & ~has_stayed
        # The lanes of another road have other numbers: this is no lane change.
        begins = has_appeared if self._views is None else has_appeared | self._views.turned[scenes]
        each, places = np.nonzero(begins)
        before = moments["before"][each], places
        for name in ("lane", "target_lane"):
            vehicles[name][before] = getattr(scene, name)[scenes[each], places]
        each, places = np.nonzero(has_appeared)
        before, now = ((moments[name][each], places) for name in ("before", "now"))
        vehicles["lane_since"][before] = LONG_AGO
        vehicles["lost"][moments["before"]] |= ~has_stayed
        take(*seen)
        vehicles["lost"][now] = vehicles["crashed"][now] | ~vehicles["is_on_road"][now]
        each, places = np.nonzero(~is_here)
        vehicles["acceleration"][moments["now"][each], places] = np.nan


@compiled
def note_moments(
    scenes: Ints, last: Ints, steps: Ints, ahead: int, active: Bools, moments: Any
) -> None:
    """Fills in the moments of the frames of the scenes (S,)."""
    for s in range(scenes.size):
        b, moment = scenes[s], moments[s]
        moment.scene, moment.before = b, last[b]
        moment.now = (last[b] + last.size) % (2 * last.size)
        moment.decision = steps[b] + ahead
        moment.ends = not active[b]


@compiled_of_scenes
def take(
    scene: Scene, moments: Any, vehicles: Any, collision: Ints, action: Ints, has_action: Bools
) -> None:
    """Fills in the vehicles of some frames."""
    road, leaders, followers = scene.road, scene.leaders, scene.followers
    for moment in moments:
        b, decision = index(moment.scene), moment.decision
        now, before = vehicles[moment.now], vehicles[moment.before]
        for i in range(now.size):
            own, was, lane = now[i], before[i], scene.lane[b, i]
            own.x, own.y, own.heading = scene.x[b, i], scene.y[b, i], scene.heading[b, i]
            own.direction_x, own.direction_y = scene.direction_x[b, i], scene.direction_y[b, i]
            own.speed, own.acceleration = scene.speed[b, i], scene.acceleration[b, i]
            own.steering = scene.steering[b, i]
            own.length, own.width = scene.length[b, i], scene.width[b, i]
            own.lane, own.target_lane = lane, scene.target_lane[b, i]
            own.leader, own.follower = leaders[b, i, OWN], followers[b, i, OWN]
            own.left_leader, own.left_follower = leaders[b, i, LEFT], followers[b, i, LEFT]
            own.right_leader, own.right_follower = leaders[b, i, RIGHT], followers[b, i, RIGHT]
            own.action = action[b, i] if has_action[b, i] else -1
            own.crashed, own.collision = scene.crashed[b, i], collision[b, i]
            own.is_on_road = is_on_lane(road, lane, own.x, own.y, 0.0)
            own.lost = was.lost or own.crashed or not own.is_on_road
            own.lane_since = was.lane_since if lane == was.lane else decision
            has_same_target = own.target_lane == was.target_lane
            own.target_since = was.target_since if has_same_target else decision

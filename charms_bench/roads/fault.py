"""Which vehicle is at fault for a collision of the ego on a road with junctions.

On the straight road, `recording.fault` judges by lanes alone. Here, vehicles merge, cross and meet,
so the rule first asks who had the right of way. It follows the Vienna Convention on Road Traffic
(1968); where that leaves a number open, it is this project's choice.

1. Whoever strikes an obstacle or a wreck is at fault, and whoever drives backwards (Article 14).
2. **Oncoming** (the angle is above 120 degrees): the vehicle on a lane of the other direction,
   beside all lanes, or on a lane of both directions with another one to its right (Articles 10 to
   12).
3. **Right of way**: a lane of a ramp or of the entry of a roundabout yields to the main lanes, and
   in an intersection, a lane yields to those with a higher priority (Article 18). It counts for
   `YIELDING_S` after a vehicle has left the lane. The vehicle that should have yielded is at fault,
   unless the other one strikes it and could have braked: from 0.75 s after it came into the way
   of the other, this required at most 3.35 m/s2 (UN R157; Archer 2005).
4. **Rear end** (the angle is below 26 degrees, or one of the two stands): the striking vehicle,
   which has to keep its distance (Article 13). But if the struck vehicle moved across lanes into
   its way within the last `ENTERED_S`, and braking from 0.75 s later on required more than 3.35
   m/s2, it is the struck vehicle (Article 14).
5. **Crossing**, above 60 degrees, where neither lane has the right of way: the vehicle that has the
   other one on its right yields, as in 3.
6. **Side by side**: the vehicle that began last to move out of its lane towards the other one and
   has not returned to its middle, or both if they began in the same simulation step.

What this does not decide is undecided, such as a vehicle that meets another one beside the lanes of
both.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.collision_kinds import SIDE_COLLISION, STRIKING, STRUCK
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.roads.scenes import OBSTACLE, Scenes
from charms_bench.world.gaps import requires_braking
from charms_bench.world.road import heading_at, is_on_lane, local_coordinates
from charms_bench.world.road_network import Network, roads_after
from charms_bench.world.scene import Vehicles
from charms_bench.world.thresholds import DRAC_LIMIT_MPS2, DRIFT_MPS, ENTERED_S, LANE_KEEPING_M

REACTION_S = 0.75
"""That of the careful and competent driver of UN Regulation 157."""
YIELDING_S = 1.0
"""For so long after it has left a lane, a vehicle has to yield as on that lane."""
STATIONARY_MPS, BACKWARDS_MPS = 0.5, -0.5
"""A vehicle stands up to the first speed, and drives backwards up to the second one."""
KEPT_S = 5.0
"""The longest past that decides about fault."""
REAR_END_COS, SIDE_COS = 0.9, 0.5
"""The least cosines of the angle between vehicles; see `engine.collision_kinds`."""
NO_RANK = -1
"""Of a lane that says nothing about the right of way."""
MOMENT = np.dtype(
    [
        *((name, np.float64) for name in ("x", "y", "heading", "speed")),
        ("lane", np.int64),
        ("is_pushed", np.bool_),
    ]
)


class Track(NamedTuple):
    """What a vehicle did in T simulation steps, the last of which is that before a collision."""

    moments: NDArray[np.void]
    """(T,) rows of `MOMENT`; m, rad, m/s, the nearest lane, and whether an impact pushes it."""
    length: float
    width: float


class Fault:
    """Judges the collisions of the egos of B scenes, and of other vehicles that are asked about.

    A lane has the right of way over those with a lower rank (L,); `NO_RANK` says nothing.
    """

    def __init__(self, count: int, scenes: Scenes, ranks: Ints) -> None:
        self.at_fault = np.full(count, np.nan)
        """(B,) 1 if the ego is at fault for its collision, 0 if not, NaN if that is undecided or
        there was none."""
        self._dt, self._ranks = float(scenes.constants["dt"][0]), ranks
        kept = round(KEPT_S / self._dt)
        self._moments = np.zeros((kept, count, scenes.vehicles.shape[1]), MOMENT)
        self._noted = np.zeros(count, dtype=np.int64)
        self._wrecked = np.zeros(self._moments.shape[1:], dtype=np.int64)
        """(B, N) since how many simulation steps a vehicle has been a wreck."""

    def start(self, rows: Ints) -> None:
        """Starts episodes in the scenes `rows` (R,), or continues them from a saved state.

        States do not hold what vehicles did before, so fault is then judged by what follows.
        """
        self.at_fault[rows], self._noted[rows], self._wrecked[rows] = np.nan, 0, 0

    def forget(self, scenes: Scenes, vehicles: Vehicles) -> None:
        """Vehicles that have just come to their places have done nothing before."""
        rows, places = vehicles
        self._wrecked[vehicles] = 0
        for name in ("x", "y", "heading", "speed", "lane"):
            self._moments[name][:, rows, places] = scenes.vehicles[name][vehicles]

    def note(self, scenes: Scenes, rows: Ints) -> None:
        """Notes a simulation step of the scenes `rows`, and judges the egos that have collided."""
        _note(scenes, rows, self._moments, self._noted, self._wrecked)
        for b in rows[self._wrecked[rows, 0] == 1].tolist():
            self.at_fault[b], _ = self.judged(scenes, b, 0)

    def judged(self, scenes: Scenes, b: int, i: int) -> tuple[float, int]:
        """Whether a vehicle that has collided in the last step noted is at fault, and how it has.

        The first is as in `at_fault`, and the second an index into `collision_kinds.COLLISIONS`.
        """
        vehicles, wrecked = scenes.vehicles[b], self._wrecked[b]
        away = np.hypot(vehicles["x"] - vehicles["x"][i], vehicles["y"] - vehicles["y"][i])
        away[(wrecked == 0) & (vehicles["kind"] > OBSTACLE)] = np.inf
        away[vehicles["kind"] < OBSTACLE] = away[i] = np.inf
        j = int(np.argmin(away))
        steps = self._steps_before_impact(b, i)
        own, other = (self._track(scenes, b, k, steps) for k in (i, j))
        how = _how(own, other)
        if vehicles["kind"][j] == OBSTACLE or wrecked[j] > 1:
            return float(vehicles["kind"][j] == OBSTACLE or _strikes(own, other)), how
        found = at_fault(scenes.road, self._ranks, own, other, self._dt)
        return math.nan if found is None else float(found[0]), how

    def _steps_before_impact(self, b: int, i: int) -> Ints:
        kept, noted = len(self._moments), int(self._noted[b])
        steps = np.arange(max(noted - kept, 0), noted) % kept
        # highway-env pushes vehicles apart before it calls them crashed.
        pushed, last = self._moments["is_pushed"][steps, b, i], steps.size - 1
        while last > 0 and pushed[last - 1]:
            last -= 1
        return steps[: last + 1]

    def _track(self, scenes: Scenes, b: int, i: int, steps: Ints) -> Track:
        vehicle = scenes.vehicles[b, i]
        size = float(vehicle["length"]), float(vehicle["width"])
        return Track(self._moments[steps, b, i], *size)


@compiled_of_scenes
def _note(
    scenes: Scenes, rows: Ints, moments: NDArray[np.void], noted: Ints, wrecked: Ints
) -> None:
    for b in rows:
        k = noted[b] % moments.shape[0]
        noted[b] += 1
        for i in range(moments.shape[2]):
            vehicle, moment = scenes.vehicles[b, i], moments[k, b, i]
            moment.x, moment.y, moment.heading = vehicle.x, vehicle.y, vehicle.heading
            moment.speed, moment.lane = vehicle.speed, vehicle.lane
            moment.is_pushed = vehicle.has_impact
            wrecked[b, i] += vehicle.crashed


def ranks_of(road: Network, main: Bools) -> Ints:
    """The ranks (L,) of a road on which lanes that lead to the lanes `main` (L,) yield to them."""
    lanes = road.lanes
    leads = main.copy()
    for _ in range(lanes.size):  # until nothing changes: a lane that leads to such a lane
        for lane in np.nonzero(~leads)[0].tolist():
            after = roads_after(road, lane)
            leads[lane] = any(leads[each : each + lanes["lanes"][each]].any() for each in after)
    return np.where(main, 1, np.where(leads, 0, NO_RANK)) if main.any() else np.full(main.size, -1)


def at_fault(
    road: Network, ranks: Ints, one: Track, other: Track, dt: float
) -> tuple[bool, bool] | None:
    """Whether each of two vehicles that have just collided is at fault; None if it is undecided.

    Their tracks have the same steps of `dt`, s; `ranks` (L,) are those of `Fault`.
    """
    recent, yielding = round(ENTERED_S / dt), round(YIELDING_S / dt)
    speeds = [float(each.moments["speed"][-1]) for each in (one, other)]
    is_back, other_is_back = (speed <= BACKWARDS_MPS for speed in speeds)
    if is_back != other_is_back:
        return is_back, other_is_back
    apart = float(other.moments["heading"][-1] - one.moments["heading"][-1])
    cosine = math.cos(apart)
    if cosine <= -SIDE_COS:
        is_wrong, other_is_wrong = _is_on_wrong_side(road, one), _is_on_wrong_side(road, other)
        if is_wrong != other_is_wrong:
            return is_wrong, other_is_wrong
    rank, other_rank = (_rank(ranks, each, yielding) for each in (one, other))
    has_ranks = NO_RANK not in (rank, other_rank)
    if has_ranks and rank != other_rank:
        return _of_intruder(rank < other_rank, one, other)
    stands, other_stands = (speed <= STATIONARY_MPS for speed in speeds)
    if stands != other_stands:
        return _of_struck(road, stands, one, other, recent)
    if cosine >= REAR_END_COS and (ahead := _ahead(one, other)) is not None:
        return _of_struck(road, ahead is one, one, other, recent)
    if has_ranks and abs(cosine) < SIDE_COS:
        # The y-axis points to the right of the x-axis, so the other one comes from the right.
        return _of_intruder(math.sin(apart) < 0, one, other)
    began, other_began = _moved_out(road, one, other), _moved_out(road, other, one)
    if cosine <= -SIDE_COS or began == other_began == -1:
        return None
    return began >= other_began, other_began >= began


def _of_struck(
    road: Network, is_first: bool, one: Track, other: Track, recent: int
) -> tuple[bool, bool]:
    """Who is at fault if the first of two vehicles is struck by the other one, or else strikes it.

    The struck one can only be if it has moved across lanes within so many steps.
    """
    if _moved_aside(road, one if is_first else other, recent):
        return _of_intruder(is_first, one, other, recent)
    return not is_first, is_first


def _of_intruder(
    is_first: bool, one: Track, other: Track, most: int | None = None
) -> tuple[bool, bool]:
    """Who is at fault if the first of two vehicles, or else the other one, should have yielded.

    It is, unless the other one strikes it and could have braked since it came into its way. If it
    came there more than `most` steps ago, or was there from the first step on, it did not come.
    """
    intruder, owner = (one, other) if is_first else (other, one)
    is_at_fault = True
    if _strikes(owner, intruder):
        came = last = len(owner.moments) - 1
        while came > 0 and _along(owner, intruder, came - 1) is not None:
            came -= 1
        is_at_fault = came > 0 and (most is None or last - came <= most)
        if is_at_fault and (found := _along(owner, intruder, came)) is not None:
            gap, closing = found
            gap -= closing * REACTION_S
            is_at_fault = gap <= 0 or bool(requires_braking(gap, closing, DRAC_LIMIT_MPS2))
    return is_at_fault == is_first, is_at_fault != is_first


def _along(owner: Track, intruder: Track, step: int) -> tuple[float, float] | None:
    """The gap to a vehicle on the way that another one still drives, m, and how fast it closes.

    The way ends where the other one's front is at the contact. None if no part of the vehicle is on
    it.
    """
    way = np.stack((owner.moments["x"], owner.moments["y"]), axis=1)[step:]
    heading = owner.moments["heading"][-1]
    end = way[-1] + owner.length * np.array([np.cos(heading), np.sin(heading)])
    parts = np.diff(np.vstack((way, end)), axis=0)
    lengths = np.hypot(parts[:, 0], parts[:, 1])
    moves = lengths > 0
    starts, lengths = way[moves], lengths[moves]
    units = parts[moves] / lengths[:, None]
    before = np.cumsum(lengths) - lengths
    to = _points(intruder, step)[:, None] - starts
    along = (to * units).sum(axis=2)
    aside = to[..., 0] * -units[:, 1] + to[..., 1] * units[:, 0]
    is_beside = (along >= 0) & (along <= lengths) & (np.abs(aside) <= intruder.length)
    if not (is_beside & (np.abs(aside) <= owner.width / 2)).any():
        return None
    nearest = np.argmin(np.where(is_beside, before + along, np.inf))
    point, part = np.unravel_index(nearest, is_beside.shape)
    moment = intruder.moments[step]
    turn = moment["heading"] - np.arctan2(units[part, 1], units[part, 0])
    gap = before[part] + along[point, part] - owner.length / 2
    with_way = max(moment["speed"] * np.cos(turn), 0.0)
    return float(gap), float(owner.moments["speed"][step] - with_way)


def _points(track: Track, step: int) -> Floats:
    """Points (K, 2) of a vehicle, at most a quarter of its length apart."""
    moment = track.moments[step]
    forward, aside = np.meshgrid(
        np.linspace(-0.5, 0.5, 5) * track.length, np.linspace(-0.5, 0.5, 3) * track.width
    )
    cosine, sine = np.cos(moment["heading"]), np.sin(moment["heading"])
    x = moment["x"] + forward * cosine - aside * sine
    y = moment["y"] + forward * sine + aside * cosine
    return np.stack((x.ravel(), y.ravel()), axis=1)


def _seen_from(one: Track, x: Any, y: Any) -> tuple[Any, Any]:
    """How far points are ahead of a vehicle's centre and to its right at the contact, m."""
    own = one.moments[-1]
    cosine, sine = np.cos(own["heading"]), np.sin(own["heading"])
    dx, dy = x - own["x"], y - own["y"]
    return dx * cosine + dy * sine, dy * cosine - dx * sine


def _strikes(one: Track, other: Track) -> bool:
    """Whether a vehicle moves into a stationary one, or touches another one with its front."""
    if other.moments["speed"][-1] <= STATIONARY_MPS < one.moments["speed"][-1]:
        return True
    points = _points(other, -1)
    ahead, aside = _seen_from(one, points[:, 0], points[:, 1])
    nearest = np.argmin(np.maximum(np.abs(ahead) / one.length, np.abs(aside) / one.width))
    return bool(ahead[nearest] / one.length >= abs(aside[nearest]) / one.width)


def _ahead(one: Track, other: Track) -> Track | None:
    """The vehicle whose rear the other, faster one has hit; None if they touch at their sides."""
    how = _how(one, other, -1.0)
    struck, striking = (other, one) if how == STRIKING else (one, other)
    is_faster = striking.moments["speed"][-1] > struck.moments["speed"][-1]
    return struck if how != SIDE_COLLISION and is_faster else None


def _how(one: Track, other: Track, least_cos: float = REAR_END_COS) -> int:
    """How a vehicle has collided with another one, as `collision_kinds` says of those in lanes.

    Where the cosine of the angle between the two is less, it is a side collision.
    """
    ahead, aside = _seen_from(one, other.moments["x"][-1], other.moments["y"][-1])
    along = (one.length + other.length) / 2 - abs(ahead)
    across = (one.width + other.width) / 2 - abs(aside)
    apart = float(other.moments["heading"][-1] - one.moments["heading"][-1])
    if along >= across or math.cos(apart) < least_cos:
        return SIDE_COLLISION
    return STRIKING if ahead > 0 else STRUCK


def _rank(ranks: Ints, track: Track, recent: int) -> int:
    """The lowest rank of the lanes on which a vehicle has been within so many steps."""
    known = ranks[track.moments["lane"][-1 - recent :]]
    known = known[known != NO_RANK]
    return int(known.min()) if known.size else NO_RANK


def _is_on_wrong_side(road: Network, track: Track) -> bool:
    """Whether a vehicle is on no lane of its direction, or could drive to the right of oncomers."""
    own = track.moments[-1]
    x, y = float(own["x"]), float(own["y"])
    here = [lane for lane in range(road.lanes.size) if is_on_lane(road, lane, x, y, 0.0)]
    is_mine = {}
    for lane in here:
        s, _ = local_coordinates(road, lane, x, y)
        is_mine[lane] = math.cos(heading_at(road, lane, s) - own["heading"]) > 0
    mine = [lane for lane in here if is_mine[lane]]
    is_shared = len(mine) < len(here)
    return not mine or (is_shared and all(road.lanes["right"][lane] >= 0 for lane in mine))


def _beside(road: Network, track: Track) -> Iterator[tuple[int, float, float]]:
    """The nearest lane in each step, how far the vehicle is to the right of it, and its drift.

    In m, and in m/s to the right.
    """
    for moment, r, heading in zip(track.moments, *_on_lanes(road, track.moments), strict=True):
        drift = float(moment["speed"]) * math.sin(float(moment["heading"]) - float(heading))
        yield int(moment["lane"]), float(r), drift


@compiled
def _on_lanes(road: Network, moments: NDArray[np.void]) -> tuple[Floats, Floats]:
    """How far a vehicle is to the right of its nearest lane in each step, and that lane's heading.

    In m and rad.
    """
    beside, headings = np.empty(moments.size), np.empty(moments.size)
    for k in range(moments.size):
        moment = moments[k]
        s, beside[k] = local_coordinates(road, moment.lane, moment.x, moment.y)
        headings[k] = heading_at(road, moment.lane, s)
    return beside, headings


def _moved_aside(road: Network, track: Track, most: int) -> bool:
    """Whether a vehicle has moved across its nearest lane within the last `most` steps."""
    steps = [*_beside(road, track)][-1 - most :]
    return any(abs(r) > LANE_KEEPING_M and abs(drift) > DRIFT_MPS for _, r, drift in steps)


def _moved_out(road: Network, track: Track, other: Track) -> int:
    """The step in which a vehicle last began to move out of its lane, towards another vehicle.

    -1 if it has kept its lane, or has returned to its middle.
    """
    _, aside = _seen_from(track, other.moments["x"][-1], other.moments["y"][-1])
    side = math.copysign(1.0, aside)
    began, left, was_moving = -1, -1, False
    for k, (lane, r, drift) in enumerate(_beside(road, track)):
        is_moving = side * r > LANE_KEEPING_M and side * drift > DRIFT_MPS
        if is_moving and not was_moving:
            began, left = k, lane
        elif lane == left and abs(r) <= LANE_KEEPING_M:
            began = -1
        was_moving = is_moving
    return began

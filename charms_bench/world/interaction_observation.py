"""The observation `interaction`: what a driver can see of the vehicles along and across its way.

It is the same on every road, (8 + K, 8) float32 in [-1, 1] with K = `conflicts` rows of vehicles
whose ways meet that of the vehicle, the ego. Distances are along lanes; those of vehicles on the
ego's way are between bumpers, and those to conflict points from the vehicles' centres.

- Row 0, the ego: speed / 33 m/s; target speed less speed / 10 m/s; how often FASTER (or,
  negative, SLOWER) was its last meta-action in a row / 4; acceleration / 10 m/s2; target lane less
  lane; its offset from the middle of its lane / 4 m and its lateral speed / 5 m/s, both positive to
  the right; and the speed limit / 33 m/s.
- Row 1, the way: whether there is a lane to its left, and to its right, to which it may change; the
  lane changes that its route asks for, positive to the right / 4, and the distance to where they
  must be done / 100 m, with `exit_lanes` also where vehicles can leave their road from any lane;
  the distance to the end of its route / 200 m; the distances to the next
  conflict point where it gives way, and to the next where it does not / 100 m; and the angle by
  which its way turns within the next 25 m / pi. Distances are 1 if there is no such place in range.
- Rows 2 to 7, the nearest vehicles within 100 m on the left, own and right lane, the leader of each
  before the follower: presence; the gap / 100 m; its speed less the ego's / 20 m/s; its speed / 33
  m/s, negative for oncoming vehicles; its offset to the right / 12 m; its lateral speed / 5 m/s;
  how fast the gap closes / the gap, 1/s; and the time gap of the vehicle behind / 5 s.
- Rows from 8 on, vehicles within 100 m of a point where their lane crosses the ego's way or merges
  with it, each at its first such point, sorted by the sum of both distances: presence; the ego's
  distance / 100 m; the vehicle's distance / 100 m; its speed / 33 m/s; the time that it needs to
  the point less the ego's, both at their speeds / 10 s; 1 if the lanes cross and 0 if they merge; 1
  if the ego has the right of way, -1 if the vehicle has it, 0 if that is not said; and the ego's
  time to the point / 10 s. A vehicle stays there until one of both has passed the point by
  `CLEAR_M`.

It contains nothing that a driver cannot see: no routes, target lanes, target speeds, drivers or
memories of other vehicles. A vehicle counts for every point to which the lanes ahead of it can
lead.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from charms_bench.foundation.compiled import clip, compiled, compiled_of_scenes
from charms_bench.foundation.fields import FrozenModel, NonNegative
from charms_bench.foundation.philox import uniforms
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT
from charms_bench.world.gaps import gap_to
from charms_bench.world.road import side_lanes
from charms_bench.world.scene import Floats, Ints, Observations, Scene, Vehicles

EGO, WAY, FIRST_NEIGHBOUR, FIRST_CONFLICT = 0, 1, 2, 8
"""The rows of the ego and of its way, and the first ones of its neighbours and of conflicts."""
COLUMNS = 8
RANGE_M, GOAL_RANGE_M = 100.0, 200.0
SPEED_MPS, RELATIVE_MPS, CHANGE_MPS, LATERAL_MPS = 33.0, 20.0, 10.0, 5.0
REPEATS, LANE_M, ASIDE_M = 4.0, 4.0, 12.0
TIME_GAP_S, TIME_S = 5.0, 10.0
SLOWEST_MPS, SHORTEST_M = 0.5, 1.0
"""Times are computed with at least this speed, and rates with at least this gap."""
CLEAR_M = 5.0
"""A vehicle of usual length has left a conflict point so far behind it."""
TURN_WITHIN_M = 25.0


class Interaction(FrozenModel):
    """The observation `interaction`."""

    name: ClassVar[str] = "interaction"

    version: Literal[1] = 1
    """Of the definition: a change of what a number means raises it."""
    conflicts: Annotated[int, Field(ge=1, le=50)] = 6
    """K, the rows of vehicles whose ways meet the ego's."""
    occlusion: bool = False
    """Whether these rows lack vehicles whose centre is hidden from the ego's behind another one."""
    exit_lanes: Annotated[bool, Field(exclude_if=lambda value: not value)] = False
    """Whether a route also asks for the lane that leads to its next road, where vehicles can get
    there from any lane, as to the exit of a roundabout; not said in files of networks without."""
    distance_noise_m: NonNegative = 0.0
    speed_noise_mps: NonNegative = 0.0
    """Standard deviations of the errors with which distances to other vehicles, and of them to
    conflict points, and their speeds are seen. Both errors are sums of four uniform numbers, drawn
    from what the ego is and sees, so that an episode that is simulated again has them again."""
    delay_decisions: Annotated[int, Field(ge=0, le=20, exclude_if=lambda value: value == 0)] = 0
    """How many decisions earlier the rows of other vehicles, from 2 on, have been seen. Nothing is
    older than the first decision of the ego. Files of networks say it where there is a delay, so
    that those trained before have the bytes of those trained since."""

    @property
    def shape(self) -> tuple[int, int]:
        """The rows and columns of one vehicle's observation."""
        return FIRST_CONFLICT + self.conflicts, COLUMNS

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        """The observations of M vehicles, (M, 8 + K, 8)."""
        observations = np.zeros((vehicles[0].size, *self.shape), dtype=np.float32)
        _fill(scene, vehicles[0], vehicles[1], observations)
        if scene.junctions is not None:
            how = self.occlusion, self.exit_lanes
            scene.junctions.describe(vehicles, observations, *how)
        if self.distance_noise_m or self.speed_noise_mps:
            self._blur(scene.x[vehicles], scene.y[vehicles], observations)
        return observations

    def delayed(self, seen: Observations) -> Observations:
        """What M egos are shown, (M, T - D, 8 + K, 8), with the delay D.

        `seen` (M, T, 8 + K, 8) are their last T observations, the oldest first; those of decisions
        before the first one are zeros.
        """
        seen, delay = seen.copy(), self.delay_decisions
        for k in reversed(range(seen.shape[1] - 1)):
            is_missing = ~seen[:, k].any(axis=(1, 2))
            seen[is_missing, k] = seen[is_missing, k + 1]
        shown = seen[:, delay:].copy()
        shown[:, :, FIRST_NEIGHBOUR:] = seen[:, : shown.shape[1], FIRST_NEIGHBOUR:]
        return shown

    def _blur(self, x: Floats, y: Floats, observations: Observations) -> None:
        """Adds the errors to the rows of other vehicles that M egos at x, y (M,) see."""
        rows = observations[:, FIRST_NEIGHBOUR:]
        seen = observations.sum(axis=(1, 2), dtype=np.float64)
        words = x.view(np.uint64), y.view(np.uint64), seen.view(np.uint64)
        drawn = uniforms(*words, 8 * rows.shape[1])
        errors = (drawn.reshape(*rows.shape[:2], 2, 4).sum(axis=-1) - 2.0) * 3**0.5
        apart = errors[..., 0] * self.distance_noise_m
        speed = errors[..., 1] * self.speed_noise_mps
        values, split = rows.astype(np.float64), FIRST_CONFLICT - FIRST_NEIGHBOUR
        near, met = values[:, :split], values[:, split:]
        gap = near[..., 1] * RANGE_M + apart[:, :split]
        own = near[..., 3] * SPEED_MPS - near[..., 2] * RELATIVE_MPS
        other = near[..., 3] * SPEED_MPS + speed[:, :split]
        behind = np.arange(split) % 2 == 1
        following = np.maximum(np.where(behind, other, own), SLOWEST_MPS)
        closing = np.where(behind, other - own, own - other) / np.maximum(gap, SHORTEST_M)
        for column, found in (
            (1, gap / RANGE_M),
            (2, (other - own) / RELATIVE_MPS),
            (3, other / SPEED_MPS),
            (6, closing),
            (7, gap / following / TIME_GAP_S),
        ):
            near[..., column] = found
        away = met[..., 2] * RANGE_M + apart[:, split:]
        other = np.maximum(met[..., 3] * SPEED_MPS + speed[:, split:], 0.0)
        met[..., 2], met[..., 3] = away / RANGE_M, other / SPEED_MPS
        met[..., 4] = away / np.maximum(other, SLOWEST_MPS) / TIME_S - met[..., 7]
        rows[:] = np.where(values[..., :1] > 0, np.clip(values, -1.0, 1.0), 0.0)


@compiled_of_scenes
def _fill(scene: Scene, rows: Ints, places: Ints, observations: Observations) -> None:
    """Writes the rows of M vehicles' observations that a straight road has."""
    for m in range(rows.size):
        b, i, seen = rows[m], places[m], observations[m]
        lane, speed = scene.lane[b, i], scene.speed[b, i]
        own, way = seen[EGO], seen[WAY]
        own[0] = clip(speed / SPEED_MPS, -1.0, 1.0)
        own[1] = clip((scene.target_speed[b, i] - speed) / CHANGE_MPS, -1.0, 1.0)
        own[2] = clip(scene.repeats[b, i] / REPEATS, -1.0, 1.0)
        own[3] = clip(scene.acceleration[b, i] / CHANGE_MPS, -1.0, 1.0)
        own[4] = clip(float(scene.target_lane[b, i] - lane), -1.0, 1.0)
        aside = scene.y[b, i] - lane * scene.road.lane_width
        own[5] = clip(aside / LANE_M, -1.0, 1.0)
        own[6] = clip(speed * scene.direction_y[b, i] / LATERAL_MPS, -1.0, 1.0)
        own[7] = clip(scene.road.speed_limit / SPEED_MPS, 0.0, 1.0)
        left, right = side_lanes(scene.road, lane)
        way[0], way[1] = left >= 0, right >= 0
        way[3], way[4], way[5], way[6] = 1.0, 1.0, 1.0, 1.0
        for side, candidate in enumerate((LEFT, OWN, RIGHT)):
            found = scene.leaders[b, i, candidate], scene.followers[b, i, candidate]
            for behind, j in enumerate(found):
                row = seen[FIRST_NEIGHBOUR + 2 * side + behind]
                if j >= 0:
                    _write_neighbour(scene, b, i, j, behind == 1, row)


@compiled
def _write_neighbour(
    scene: Scene, b: int, i: int, j: int, is_behind: bool, row: Observations
) -> None:
    """Writes the row of vehicle j, ahead of vehicle i or behind it, if it is in range."""
    gap = gap_to(abs(scene.x[b, j] - scene.x[b, i]), scene.length[b, i], scene.length[b, j])
    if gap > RANGE_M:
        return
    speed = scene.speed[b, i] * scene.direction_x[b, i]
    other = scene.speed[b, j] * scene.direction_x[b, j]
    closing = other - speed if is_behind else speed - other
    following = other if is_behind else speed
    row[0] = 1.0
    row[1] = clip(gap / RANGE_M, -1.0, 1.0)
    row[2] = clip((other - speed) / RELATIVE_MPS, -1.0, 1.0)
    row[3] = clip(other / SPEED_MPS, -1.0, 1.0)
    row[4] = clip((scene.y[b, j] - scene.y[b, i]) / ASIDE_M, -1.0, 1.0)
    row[5] = clip(scene.speed[b, j] * scene.direction_y[b, j] / LATERAL_MPS, -1.0, 1.0)
    row[6] = clip(closing / max(gap, SHORTEST_M), -1.0, 1.0)
    row[7] = clip(gap / max(following, SLOWEST_MPS) / TIME_GAP_S, -1.0, 1.0)

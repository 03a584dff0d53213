"""Calibrated drivers who also give way where ways cross and merge, by gap acceptance.

Populations are calibrated on motorways, without giving way. Where the observation `interaction`
says that a vehicle has the right of way, or does not say who has it, this driver looks at when that
vehicle arrives at the conflict point. The driver

1. accepts the gap if the vehicle arrives there later than the critical headway after the driver has
   reached the stop line, or has passed before. The critical headways are those of the Highway
   Capacity Manual (6th edition, 2016): 6.5 s to cross (chapter 20, through traffic of the minor
   street under two-way stop control), and 4.98 s to merge (chapter 22, the entry of a roundabout
   with one lane);
2. otherwise approaches the stop line as a stationary leader, with the driver's own IDM;
3. does not stop beyond the line any more;
4. if nothing says who has the right of way, gives way to the vehicle that arrives first;
5. never drives into a conflict point that another vehicle occupies.

The stop line is `STOP_M` before the conflict point, so that neither vehicle is in the other's lane.
"""

import math

import numpy as np

from charms_baselines.human import Human
from charms_bench.foundation.arrays import Floats
from charms_bench.foundation.compiled import compiled
from charms_bench.world.interaction_observation import (
    CLEAR_M,
    EGO,
    FIRST_CONFLICT,
    RANGE_M,
    SLOWEST_MPS,
    SPEED_MPS,
    Interaction,
)
from charms_bench.world.scene import Observations, Scene, Vehicles

CROSSING_S, MERGING_S = 6.5, 4.98
"""Critical headways."""
STOP_M = 4.0
"""From the front of a waiting vehicle to the conflict point: half a lane and 2 m."""
COMMITTED_M = 1.0
"""A driver whose front is so close to the stop line does not stop there any more."""
_SEEN = Interaction(conflicts=10)


class YieldingHuman(Human):
    """The driver `human` with gap acceptance at junctions; see the module."""

    def stops(self, scene: Scene, vehicles: Vehicles) -> Floats:
        """The gaps (M,) from M vehicles to the first stop line before which they wait, m."""
        if scene.junctions is None:
            return super().stops(scene, vehicles)
        return stop_lines(scene, vehicles)


def stop_lines(scene: Scene, vehicles: Vehicles, critical: float = 1.0) -> Floats:
    """The gaps (M,) from M vehicles to the first stop line before which they wait, m.

    `critical` scales the critical headways. Without a line, a gap is infinite.
    """
    return _stop_lines(_SEEN(scene, vehicles), scene.length[vehicles], critical)


@compiled
def _stop_lines(seen: Observations, lengths: Floats, scale: float) -> Floats:
    """The gaps of `stop_lines`, from what M vehicles see and their lengths, m."""
    gaps = np.full(lengths.size, math.inf)
    for m in range(lengths.size):
        own_speed = max(np.float64(seen[m, EGO, 0]) * SPEED_MPS, SLOWEST_MPS)
        for row in seen[m, FIRST_CONFLICT:].astype(np.float64):
            is_there, own, other, speed, _, is_crossing, right, _ = row
            own, other = own * RANGE_M, other * RANGE_M
            speed = max(speed * SPEED_MPS, SLOWEST_MPS)
            line = own - lengths[m] / 2 - STOP_M
            if not is_there or line <= -COMMITTED_M:
                continue
            at_line = max(line, 0.0) / own_speed
            arrives, leaves = other / speed, (other + CLEAR_M) / speed
            critical = scale * (CROSSING_S if is_crossing else MERGING_S)
            is_second = right < 0 or (right == 0 and arrives < own / own_speed)
            is_close = arrives < at_line + critical and leaves > at_line
            is_inside = is_crossing > 0 and abs(other) <= CLEAR_M and leaves > at_line
            if (is_second and is_close) or is_inside:
                gaps[m] = min(gaps[m], max(line, 0.1))
    return gaps

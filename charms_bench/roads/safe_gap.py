"""Whether the gaps on a lane are large enough for a vehicle that changes there."""

from charms_bench.foundation.compiled import compiled
from charms_bench.roads.locating import coordinates_of
from charms_bench.roads.scenes import Here, vehicle_of
from charms_bench.roads.vehicle_order import neighbours
from charms_bench.world.gaps import gap_to, is_within, requires_braking
from charms_bench.world.thresholds import DRAC_LIMIT_MPS2

HEADWAY_S = 0.3
"""The least time headway."""


@compiled
def is_safe(here: Here, i: int, lane: int) -> bool:
    """Whether on a lane, neither vehicle i nor its follower has to brake hard to avoid a collision.

    The deceleration that just avoids one is at most `DRAC_LIMIT_MPS2`, and the time headway at
    least `HEADWAY_S`.
    """
    front, rear = neighbours(here, i, lane)
    for behind, ahead in ((i, front), (rear, i)):
        if behind < 0 or ahead < 0:
            continue
        own, other = vehicle_of(here, behind), vehicle_of(here, ahead)
        distance = coordinates_of(here, ahead, lane).s - coordinates_of(here, behind, lane).s
        gap, closing = gap_to(distance, own.length, other.length), own.speed - other.speed
        is_close = is_within(gap, own.speed, HEADWAY_S)
        if is_close or requires_braking(gap, closing, DRAC_LIMIT_MPS2):
            return False
    return True

"""The nearest of parallel straight lanes, for code that does not ask the road yet."""

from charms_bench.world.road import first_nearest as closest_lane

__all__ = ["closest_lane"]

"""Agents, a traffic and metrics of a distribution that charms-bench knows nothing about."""

import numpy as np
import polars as pl

from charms_bench import ACTIONS, DriverModel, Policy, Traffic
from charms_bench.metrics import Metric, MetricSet
from charms_bench.metrics.metric import ratio

IDLE, LANE_RIGHT, SLOWER = (ACTIONS.index(name) for name in ("IDLE", "LANE_RIGHT", "SLOWER"))


class KeepRight(Policy):
    """Slows down behind others, and moves right where it sees nobody there."""

    def decide(self, observations):
        front, right = observations[:, 3], observations[:, 5:7, 0]
        close = (front[:, 0] > 0) & (front[:, 1] < 0.2)
        actions = np.where(right.any(axis=1), IDLE, LANE_RIGHT)
        return np.where(close, SLOWER, actions)


class Explorer(Policy):
    """Keeps right, but now and then does anything at all.

    What it does then follows from what it sees and from its seed: two seeds are two drivers of
    one kind, whose noise is independent.
    """

    def __init__(self, noise=0.1, seed=0):
        self.noise = noise
        self.seed = seed
        self.driver = KeepRight()

    def decide(self, observations):
        bits = np.ascontiguousarray(observations, dtype=np.float32).view(np.uint32)
        draw = np.full(len(bits), self.seed + 1, dtype=np.uint64)
        for column in bits.reshape(len(bits), -1).T:
            draw = (draw ^ column) * np.uint64(0x9E3779B97F4A7C15)
            draw ^= draw >> np.uint64(29)
        whim = (draw >> np.uint64(40)) / 2**24 < self.noise
        anything = draw % np.uint64(len(ACTIONS))
        return np.where(whim, anything, self.driver.decide(observations)).astype(int)


class Pacer(DriverModel):
    """Keeps 2 s behind its leader, and drifts to the lane on the left now and then."""

    def drive(self, scene, vehicles):
        lane = scene.lane[vehicles]
        leader, present = scene.leader(vehicles, lane)
        gap = scene.x[vehicles[0], leader] - scene.x[vehicles]
        speed = scene.speed[vehicles]
        wanted = np.where(present, np.minimum(gap / 2, 30.0), 30.0)
        bored = scene.timer_s[vehicles] > 4 + scene.temperament[vehicles]
        scene.timer_s[vehicles] = np.where(bored, 0.0, scene.timer_s[vehicles])
        _, occupied = scene.follower(vehicles, lane - 1)
        target = np.where(bored & ~occupied, np.maximum(lane - 1, 0), scene.target_lane[vehicles])
        return np.clip(wanted - speed, -5.0, 2.0), target


class HalfAndHalf(Traffic):
    """Each of the two with the same probability."""

    agents = ("outside_policy", "outside_model")

    def assign(self, rng, scenes, vehicles):
        return rng.choice(self.agents, size=(scenes, vehicles))


def comfort(jerk_mps3=2.0):
    """One metric: how often the ride is jerky."""
    jerk = pl.col("jerk_mps3")
    jerky = Metric(
        name="jerky",
        unit="",
        description=f"proportion of decisions with a jerk beyond {jerk_mps3:g} m/s³",
        rests_on="pairs of steps",
        sums=(jerk.count(), jerk.abs().gt(jerk_mps3).sum()),
        value=ratio,
        interval="proportion",
    )
    return MetricSet(name="comfort", version=3, metrics=(jerky,))


FUEL = Metric("fuel", "l", "needs a column that is not recorded", "", (pl.sum("fuel"),), np.sum)
BROKEN = MetricSet(name="broken", version=1, metrics=(FUEL,))


class Raising(Policy):
    def decide(self, observations):
        raise ValueError("out of petrol")


class Misshapen(Policy):
    def decide(self, observations):
        return np.zeros((len(observations), 2), dtype=int)


class OutOfRange(Policy):
    def decide(self, observations):
        return np.full(len(observations), 7)


class NotFinite(DriverModel):
    def drive(self, scene, vehicles):
        return np.full(len(vehicles[0]), np.nan), scene.lane[vehicles]


class NoAgent:
    pass

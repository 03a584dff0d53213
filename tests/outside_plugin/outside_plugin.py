"""Agents and a traffic of a distribution that charms-bench knows nothing about."""

import numpy as np

from charms_bench import ACTIONS, DriverModel, Policy, Traffic

IDLE, LANE_RIGHT, SLOWER = (ACTIONS.index(name) for name in ("IDLE", "LANE_RIGHT", "SLOWER"))


class KeepRight(Policy):
    """Slows down behind others, and moves right where it sees nobody there."""

    def decide(self, observations):
        front, right = observations[:, 3], observations[:, 5:7, 0]
        close = (front[:, 0] > 0) & (front[:, 1] < 0.2)
        actions = np.where(right.any(axis=1), IDLE, LANE_RIGHT)
        return np.where(close, SLOWER, actions)


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

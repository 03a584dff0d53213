"""What drivers did in recorded situations, and its description in numbers.

Situations on motorways last 30 s. Scenes on other roads are shorter: what follows is not a number.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from charms_bench.humans.held_out import SEED
from charms_bench.humans.trips import RATE_HZ, Driver, Trip
from charms_bench.world.gaps import is_within, time_headway
from charms_bench.world.scene import Bools, Floats, Ints

REVERSAL_MPS2 = 0.15
"""An acceleration reverses if its sign changes between two seconds and both exceed this."""
STRONG_MPS2 = 1.1
HARD_BRAKING_MPS2 = 1.5
SHORT_HEADWAY_S = 1.0


@dataclass(frozen=True, eq=False)
class Driven:
    """What M repetitions of a driver did in S recorded situations of T - 1 seconds, at 1 Hz."""

    driver: Ints
    """(S,) the recorded driver whose place was taken."""
    gap: Floats
    """(S, M, T) bumper to bumper, m; infinite without a leader."""
    speed: Floats
    """(S, M, T) m/s."""
    leader_speed: Floats
    """(S, M, T) m/s."""
    lanes: Floats
    """(L, 4) kilometres, lane changes, undone lane changes and collisions of independent units:
    recorded drivers or episodes. Lane changes are not a number where lanes are unknown."""
    reached: Floats | None = None
    """(S, M, T, 3) x, y and speed on a scene's own road; after a collision, it stands there."""

    @property
    def collided(self) -> Bools:
        """(S, M) whether the driver drove into the leader."""
        return np.asarray((self.gap <= 0).any(axis=-1))

    def of(self, part: slice) -> "Driven":
        """The same in a part of the situations."""
        arrays = self.driver[part], self.gap[part], self.speed[part], self.leader_speed[part]
        return Driven(*arrays, self.lanes)


def recorded(parts: Sequence[Trip], lanes: Floats) -> Driven:
    """What the recorded drivers did."""
    return in_place(parts, lanes, lambda part, _: (part.gap[None], part.speed[None]))


def in_place(parts: Sequence[Trip], lanes: Floats, driver: Driver, seed: int = SEED) -> Driven:
    """What a driver does in the places of recorded drivers, at 1 Hz, with given lane changes."""
    rng, every = np.random.default_rng(seed), slice(None, None, RATE_HZ)
    gaps, speeds = zip(*(driver(part, rng) for part in parts), strict=True)
    gap, speed = (np.array([each[:, every] for each in both]) for both in (gaps, speeds))
    leader_speed = np.array([part.leader_speed[every] for part in parts])[:, None]
    ahead = np.broadcast_to(leader_speed, speed.shape)
    return Driven(np.array([part.driver for part in parts]), gap, speed, ahead, lanes)


def conduct(driven: Driven) -> dict[str, float | None]:
    """How a driver drove, in numbers; accelerations are means over 1 s, gaps from bumper to bumper.

    There are no rates of lane changes where lanes are unknown, and no time gap without a leader.
    """
    every = np.diff(driven.speed, axis=-1)
    known = np.isfinite(every)
    acceleration = every[known]
    gap, speed = driven.gap[..., 1:][known], driven.speed[..., 1:][known]
    follows = np.isfinite(gap)
    km, changes, undone, collisions = driven.lanes.sum(axis=0)
    return {
        "seconds": float(acceleration.size),
        "acceleration_std_mps2": float(acceleration.std()),
        "strong_acceleration": float((np.abs(acceleration) > STRONG_MPS2).mean()),
        "reversals_per_minute": float(60 * reversals(every)[known[..., 1:]].mean()),
        "hard_braking_per_h": float(3600 * (acceleration < -HARD_BRAKING_MPS2).mean()),
        "time_gap_median_s": float(np.median(time_headway(gap, speed)[follows])),
        "short_headway": float(is_within(gap, speed, SHORT_HEADWAY_S).mean()),
        "collided": float(driven.collided.mean()),
        "collisions_per_1000km": float(1000 * collisions / km) if np.isfinite(km) else None,
        "lane_changes_per_km": float(changes / km) if np.isfinite(changes) else None,
        "undone_lane_changes": float(undone / changes) if changes > 0 else None,
    }


def reversals(acceleration: Floats) -> Bools:
    """(..., n - 1) whether accelerations (..., n) reverse after the one before."""
    before, after = acceleration[..., :-1], acceleration[..., 1:]
    is_strong = np.minimum(np.abs(before), np.abs(after)) > REVERSAL_MPS2
    return np.asarray(is_strong & (before * after < 0))

"""How much a driver is like recorded drivers.

A driver replaces recorded drivers, for 30 s behind their recorded leaders, and in equally many
situations that no recording has; see `unseen_situations`. Three components are scored, and the
worst of them is the total:

- **closed loop**, in the recorded situations: the energy score of gap and speed after 10, 20 and
  30 s. 0 is constant velocity, and 1 is IDM with the recorded driver's own parameters and noise.
- **given the scene**, in the other situations: distributions of acceleration, jerk and reversals,
  as means over 1 s, given the speed, the gap and the closing speed.
- **events**, in the other situations: rates of hard braking, short headways, collisions and, in
  traffic, collisions and, where lanes are known, lane changes and undone ones. The worst counts.

For the last two, a driver that replaces one half of the recorded drivers is compared with the
other half. 0 is the better of constant velocity and an IDM that wants the speed that it was spawned
with, and 1 is what the recorded drivers of the first half score. Data sets are never pooled.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from charms_bench.humans.driven_situations import (
    HARD_BRAKING_MPS2,
    SHORT_HEADWAY_S,
    Driven,
    reversals,
)
from charms_bench.humans.held_out import HORIZONS_S, SEED
from charms_bench.statistics.energy_score import energy_score
from charms_bench.world.gaps import is_within, time_headway
from charms_bench.world.scene import Bools, Floats, Ints

COMPONENTS = ("closed_loop", "given_scene", "events")
SPEEDS_MPS = (0.0, 10.0, 22.0, 28.0, 100.0)
TIME_GAPS_S = (0.0, 1.0, 1.5, 2.5, 1000.0)
CLOSING_MPS = (-100.0, -0.5, 0.5, 100.0)
"""Edges of the strata of speed, of density by its time gap, and of closing speed."""
ACCELERATIONS_MPS2 = (-100.0, -1.5, -0.8, -0.4, -0.15, 0.15, 0.4, 0.8, 1.5, 100.0)
JERKS_MPS3 = (-100.0, -0.8, -0.4, -0.15, 0.15, 0.4, 0.8, 100.0)
PRIOR_EVENTS, PRIOR_COLLISIONS = 5.0, 1.0
"""Added to each number of events, so that one event of one driver does not decide a score."""
PRIOR_PER_KM = 0.01
"""The same for collisions in traffic: those of one vehicle in 100 km cost 1."""
_PRIORS = PRIOR_EVENTS, PRIOR_EVENTS, PRIOR_COLLISIONS
EVENTS = (
    "hard_braking",
    "short_headway",
    "collision",
    "lane_change",
    "undone_lane_change",
    "collision_in_traffic",
)
LEAST_SPAN = np.log(2)
"""A rate twice as high or half as high costs at most 1, even where the floor has the right rate.
Twice the distance between halves of the recorded drivers costs at most 1, too."""
HALVES = 200
SMALLEST_STRATUM_S = 30
"""Seconds of recorded driving; smaller strata are left out."""
_STRATA = (len(SPEEDS_MPS) - 1) * (len(TIME_GAPS_S) - 1) * (len(CLOSING_MPS) - 1)
_BINS = (len(ACCELERATIONS_MPS2) - 1, len(JERKS_MPS3) - 1, 2)


@dataclass(frozen=True)
class Score:
    """A component, or the total, with its 95 % interval over recorded drivers."""

    value: float
    low: float
    high: float


class _Sums:
    """What is added up of a driver, by repetition (M) and by recorded driver (D)."""

    def __init__(self, driven: Driven, drivers: int = 0) -> None:
        """With a number of `drivers`, only the first ones count, or further ones drove nothing."""
        found, number = np.unique(driven.driver, return_inverse=True)
        shape = driven.speed.shape[1], drivers or found.size
        self.strata = [np.zeros((*shape, _STRATA, bins)) for bins in _BINS]
        self.events = np.zeros((*shape, len(_PRIORS)))
        self.seconds = np.zeros(shape)
        for d in range(shape[1]):
            own = number == d
            for m in range(shape[0]):
                speed, gap = driven.speed[own, m], driven.gap[own, m]
                leader_speed = driven.leader_speed[own, m]
                for total, counts in zip(
                    self.strata, _histograms(speed, gap, leader_speed), strict=True
                ):
                    total[m, d] = counts
                self.events[m, d], self.seconds[m, d] = _events(speed, gap)
        self.lanes = driven.lanes

    def keep(self, strata: Bools) -> "_Sums":
        """Leaves out the other strata, which weigh nothing in any half."""
        self.strata = [each[:, :, strata] for each in self.strata]
        return self


class _Halves:
    """Recorded drivers with weights (D,), split into halves H times."""

    def __init__(self, human: _Sums, weights: Floats, is_first: Bools, lanes: Floats) -> None:
        """`is_first` (H, D) are the first halves, and `lanes` (H, 2, 4) are sums of lane counts."""
        self.weights, self._lanes = weights, lanes
        one, self._other = weights * is_first, weights * ~is_first
        self._recorded = [np.tensordot(one, each[0], 1) for each in human.strata]
        self._expected = _rates(human, one, lanes[:, 0], lanes[:, 0, 0])

    def distances(self, tested: _Sums, lanes: Floats | None = None) -> Floats:
        """(H, 7) of scene and events, of a driver in the second half from humans in the first.

        They are means over the repetitions. `lanes` (4,) are the driver's sums of lane counts;
        the humans have those of their second half.
        """
        km = self._lanes[:, 0, 0]
        own = self._lanes[:, 1] if lanes is None else np.broadcast_to(lanes, (km.size, 4))
        found = np.zeros((km.size, 1 + len(EVENTS)))
        for m in range(len(tested.events)):
            driven = [np.tensordot(self._other, each[m], 1) for each in tested.strata]
            found[:, 0] += _apart(self._recorded, driven)
            rates = _rates(tested, self._other, own, km, m)
            found[:, 1:] += np.abs(np.log(rates / self._expected))
        return found / len(tested.events)


class Yardstick:
    """The recorded drivers, and the drivers that the scores 0 and 1 are defined by.

    Args:
        human: What the recorded drivers did in S situations.
        constant: What constant velocity does there, and in S situations that no recording has.
        spawn_only: What an IDM with the speed of its spawn does in the same 2 S situations.
        own: What IDM does there with the recorded drivers' own parameters and noise.
        scales: (H, 2) gaps and speeds are divided by these in energy scores.
    """

    def __init__(
        self, human: Driven, constant: Driven, spawn_only: Driven, own: Driven, scales: Floats
    ) -> None:
        self._human, self._scales = human, scales
        self._of = cache(self._of_driver)
        drivers, self._number = np.unique(human.driver, return_inverse=True)
        self._drivers = drivers.size
        self._energy = [self._energy_of(each) for each in (constant, own)]
        people = _Sums(human)
        self._kept = people.strata[0][0].sum(axis=(0, 2)) >= SMALLEST_STRATUM_S
        people.keep(self._kept)
        others = [_Sums(self._unseen(each)).keep(self._kept) for each in (constant, spawn_only)]
        rng, every = np.random.default_rng(SEED), np.tile(np.arange(self._drivers), (HALVES, 1))
        is_first = rng.permuted(every, axis=1) < self._drivers / 2
        units = len(human.lanes)
        drawn = rng.integers(max(units, 1), size=(HALVES, 2, units // 2))
        self._parts = []
        """All drivers, then all but one."""
        self._of_people, self._span = np.empty((2, 1 + self._drivers, 1 + len(EVENTS)))
        """Distances between halves of the drivers, and those of scores 0 and 1, by part."""
        parts = np.concatenate([np.ones((1, self._drivers)), 1 - np.eye(self._drivers)])
        for part, weights in enumerate(parts):
            lanes = self._without(human.lanes, part)[drawn].sum(axis=2)
            halves = _Halves(people, weights, is_first, lanes)
            self._parts.append(halves)
            splits = halves.distances(people)
            if part == 0:
                self._splits = splits
            lanes_of = [self._without(each.lanes, part).sum(axis=0) for each in others]
            floors = [
                halves.distances(*each).mean(axis=0) for each in zip(others, lanes_of, strict=True)
            ]
            floor = np.min(floors, axis=0)
            self._of_people[part] = splits.mean(axis=0)
            self._span[part] = floor - self._of_people[part]
        least = np.maximum(self._of_people[:, 1:], LEAST_SPAN)
        self._span[:, 1:] = np.maximum(self._span[:, 1:], least)

    def scores(self, tested: Driven) -> dict[str, Score]:
        """The components and the total of a driver in the same 2 S situations."""
        return _of_worst(self._of(tested))

    def differences(self, tested: Driven, other: Driven) -> dict[str, Score]:
        """How much higher the other driver scores, over the same recorded drivers."""
        one, two = (_with_worst(self._of(each)) for each in (tested, other))
        return _named(_jackknifed(two - one))

    def ceiling(self) -> dict[str, Score]:
        """What one half of the recorded drivers scores against the other: 1, with an interval.

        The closed loop has none, because a driver has driven each situation once.
        """
        splits = 1 - (self._splits - self._of_people[0]) / self._span[0]
        found = {"given_scene": splits[:, 0], "events": np.nanmin(splits[:, 1:], axis=1)}
        bounds = {name: np.quantile(each, [0.025, 0.975]) for name, each in found.items()}
        return {name: Score(1.0, *map(float, each)) for name, each in bounds.items()}

    def of_others(self, people: Driven) -> dict[str, Score]:
        """What other recorded drivers score, who drove in other situations.

        The closed loop compares drivers in one situation, so it has no score.
        """
        found = self._by_part(_Sums(people, self._drivers), self._energy[1], people.lanes)
        return {name: each for name, each in _of_worst(found).items() if name in COMPONENTS[1:]}

    def _of_driver(self, tested: Driven) -> Floats:
        sums = _Sums(self._unseen(tested))
        return self._by_part(sums, self._energy_of(tested), tested.lanes)

    def _unseen(self, driven: Driven) -> Driven:
        """What a driver did in the situations that no recording has."""
        return driven.of(slice(len(self._human.driver), None))

    def _by_part(self, sums: _Sums, energy: Floats, units: Floats) -> Floats:
        """(1 + D, 8) closed loop, scene and events: of all drivers, then without each of them."""
        sums.keep(self._kept)
        found = np.empty((1 + self._drivers, 2 + len(EVENTS)))
        for part, halves in enumerate(self._parts):
            lanes = self._without(units, part).sum(axis=0)
            apart = halves.distances(sums, lanes).mean(axis=0)
            scores = 1 - (apart - self._of_people[part]) / self._span[part]
            constant, own, of_tested = (halves.weights @ each for each in (*self._energy, energy))
            closed_loop = np.mean((constant - of_tested) / (constant - own))
            found[part] = closed_loop, *scores
        return found

    def _energy_of(self, driven: Driven) -> Floats:
        """(D, H) sums of energy scores by recorded driver."""
        recorded = driven.of(slice(len(self._human.driver)))
        energy = _energy_scores(recorded, self._human, self._scales)
        return np.array([np.bincount(self._number, each) for each in energy.T]).T

    def _without(self, lanes: Floats, part: int) -> Floats:
        """(L, 4) lane counts of a part; without a driver, every D-th unit is left out, too."""
        left_out = (np.arange(len(lanes)) % self._drivers == part - 1) & (part > 0)
        return np.where(left_out[:, None], 0.0, lanes)


def _of_worst(found: Floats) -> dict[str, Score]:
    """The components and the total of scores (1 + D, 8), see `_by_part`.

    The bounds of the worst are the worst bounds: another score may be the worst of other drivers.
    """
    return _named(_with_worst(_jackknifed(found)))


def _with_worst(scores: Floats) -> Floats:
    """(..., 4) closed loop, scene, the worst of the events, and the total, of scores (..., 8)."""
    events = np.nanmin(scores[..., 2:], axis=-1, keepdims=True)
    components = np.concatenate([scores[..., :2], events], axis=-1)
    return np.concatenate([components, components.min(axis=-1, keepdims=True)], axis=-1)


def _jackknifed(found: Floats) -> Floats:
    """(3, C) values and 95 % intervals of C scores (1 + D, C) of all drivers and without each.

    The jackknife, with Student's distribution (Efron & Tibshirani 1993, section 11.2).
    """
    from scipy.stats import t

    value, others = found[0], found[1:]
    apart = ((others - others.mean(axis=0)) ** 2).sum(axis=0) * (1 - 1 / len(others))
    size = t.ppf(0.975, len(others) - 1) * np.sqrt(apart)
    return np.stack([value, value - size, value + size])


def _named(scores: Floats) -> dict[str, Score]:
    """The components and the total, of their values and bounds (3, 4)."""
    names = *COMPONENTS, "total"
    return {name: Score(*map(float, each)) for name, each in zip(names, scores.T, strict=True)}


def _energy_scores(tested: Driven, human: Driven, scales: Floats) -> Floats:
    """(S, H) energy scores at the horizons."""
    found = []
    for k, horizon_s in enumerate(HORIZONS_S):
        draws = np.stack([tested.gap[..., horizon_s], tested.speed[..., horizon_s]], axis=-1)
        observed = np.stack([human.gap[:, 0, horizon_s], human.speed[:, 0, horizon_s]], axis=-1)
        found.append(energy_score(draws / scales[k], observed / scales[k]))
    return np.stack(found, axis=-1)


def _apart(of_human: Sequence[Floats], of_tested: Sequence[Floats]) -> Floats:
    """(H,) mean total variation of acceleration, jerk and reversals in the strata, from 0 to 1.

    Both are seconds (H, strata, bins). Strata weigh as much as the recorded drivers are in them. A
    stratum in which the tested driver never is counts as 1.
    """
    distances = []
    for p, q in zip(of_human, of_tested, strict=True):
        seconds, visits = p.sum(axis=-1), q.sum(axis=-1)
        weights = np.where(seconds >= SMALLEST_STRATUM_S, seconds, 0.0)
        p, q = p / np.maximum(seconds, 1)[..., None], q / np.maximum(visits, 1)[..., None]
        apart = np.where(visits > 0, np.abs(p - q).sum(axis=-1) / 2, 1.0)
        with np.errstate(invalid="ignore"):  # not a number if no stratum is large enough
            distances.append((apart * weights).sum(axis=-1) / weights.sum(axis=-1))
    return np.asarray(np.mean(distances, axis=0))


def _histograms(speed: Floats, gap: Floats, leader_speed: Floats) -> list[Floats]:
    """(strata, bins) seconds by acceleration, jerk and reversal, of speeds and gaps (S, T)."""
    acceleration = np.diff(speed, axis=-1)
    jerk, after = np.diff(acceleration, axis=-1), acceleration[:, 1:]
    reverses = reversals(acceleration).astype(np.int64)
    seen, gap = speed[:, 1:-1], gap[:, 1:-1]
    stratum = _bin(seen, SPEEDS_MPS)
    for value, edges in (
        (time_headway(gap, seen), TIME_GAPS_S),
        (seen - leader_speed[:, 1:-1], CLOSING_MPS),
    ):
        stratum = stratum * (len(edges) - 1) + _bin(value, edges)
    found = []
    known = np.isfinite(jerk)
    binned = _bin(after, ACCELERATIONS_MPS2), _bin(jerk, JERKS_MPS3), reverses
    for values, bins in zip(binned, _BINS, strict=True):
        counts = np.bincount((stratum * bins + values)[known], minlength=_STRATA * bins)
        found.append(counts.reshape(_STRATA, bins).astype(np.float64))
    return found


def _bin(values: Floats, edges: tuple[float, ...]) -> Ints:
    return np.asarray(np.clip(np.searchsorted(edges, values, "right") - 1, 0, len(edges) - 2))


def _events(speed: Floats, gap: Floats) -> tuple[Floats, int]:
    """(3,) seconds of hard braking and of short headways, collisions, and all seconds."""
    acceleration = np.diff(speed, axis=-1)
    is_hard = acceleration < -HARD_BRAKING_MPS2
    is_short = is_within(gap[:, 1:], speed[:, 1:], SHORT_HEADWAY_S)
    collided = (gap <= 0).any(axis=-1)
    counted = is_hard.sum(), is_short.sum(), collided.sum()
    return np.array(counted, dtype=np.float64), int(np.isfinite(acceleration).sum())


def _rates(driven: _Sums, weights: Floats, lanes: Floats, half_km: Floats, m: int = 0) -> Floats:
    """(H, 6) rates of events by second and by km, of lanes (H, 4); NaN where lanes are unknown.

    The prior is one of a rate on as many kilometres as half of the recorded drivers drove, so that
    a driver who drives further does not seem to change lanes less often.
    """
    seconds = weights @ driven.seconds[m]
    behind = (weights @ driven.events[m] + _PRIORS) / seconds[:, None]
    changes = PRIOR_EVENTS / half_km
    priors = np.stack([changes, changes, np.full(changes.shape, PRIOR_PER_KM)], axis=-1)
    in_lanes = lanes[:, 1:] / lanes[:, :1] + priors
    return np.concatenate([behind, in_lanes], axis=1)

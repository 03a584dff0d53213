"""How much a driver is like recorded drivers: a score that copying recorded numbers cannot win.

A driver is put in the place of recorded drivers, for 30 s behind their recorded leaders. Three
components are scored, and the worst of them is the total:

- **closed loop**: the energy score of gap and speed after 10, 20 and 30 s. 0 is constant velocity,
  and 1 is IDM with the recorded driver's own parameters and noise.
- **given the scene**: distributions of acceleration, jerk and reversals, as means over 1 s, given
  the speed, the gap and the closing speed.
- **events**: rates of hard braking, short headways and, where lanes are known, lane changes and
  undone ones. The worst of them is the component.

For the last two, a driver in the place of one half of the recorded drivers is compared with the
other half. 0 is the better of constant velocity and an IDM that wants the speed that it was spawned
with, and 1 is what the recorded drivers of the first half score. Data sets are never pooled.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from charms_bench.people.held_out import HORIZONS_S, SEED
from charms_bench.people.trips import RATE_HZ, Trip
from charms_bench.statistics.energy_score import energy_score
from charms_bench.world.scene import Floats, Ints

COMPONENTS = ("closed_loop", "given_scene", "events")
SPEEDS_MPS = (0.0, 10.0, 22.0, 28.0, 100.0)
TIME_GAPS_S = (0.0, 1.0, 1.5, 2.5, 1000.0)
CLOSING_MPS = (-100.0, -0.5, 0.5, 100.0)
"""Edges of the strata of speed, of density by its time gap, and of closing speed."""
ACCELERATIONS_MPS2 = (-100.0, -1.5, -0.8, -0.4, -0.15, 0.15, 0.4, 0.8, 1.5, 100.0)
JERKS_MPS3 = (-100.0, -0.8, -0.4, -0.15, 0.15, 0.4, 0.8, 100.0)
REVERSAL_MPS2 = 0.15
"""An acceleration reverses if its sign changes between two seconds and both exceed this."""
HARD_BRAKING_MPS2 = 1.5
SHORT_HEADWAY_S = 1.0
PRIOR_EVENTS = 0.5
"""Added to each number of events, so that the logarithm of no event is finite."""
EVENTS = ("hard_braking", "short_headway", "lane_change", "undone_lane_change")
LEAST_SPAN = np.log(2)
"""A rate twice as high or half as high costs at most 1, even where the floor has the right rate.
Twice the distance between halves of the recorded drivers costs at most 1, too."""
HALVES, HALVES_OF_RESAMPLE = 100, 5
RESAMPLES = 200
SMALLEST_STRATUM_S = 30
"""Seconds of recorded driving; smaller strata are left out."""
_STRATA = (len(SPEEDS_MPS) - 1) * (len(TIME_GAPS_S) - 1) * (len(CLOSING_MPS) - 1)
_BINS = (len(ACCELERATIONS_MPS2) - 1, len(JERKS_MPS3) - 1, 2)


@dataclass(frozen=True, eq=False)
class Driven:
    """What M repetitions of a driver did in S recorded situations of 30 s, at 1 Hz."""

    driver: Ints
    """(S,) the recorded driver whose place was taken."""
    gap: Floats
    """(S, M, 31) bumper to bumper, m."""
    speed: Floats
    """(S, M, 31) m/s."""
    leader_speed: Floats
    """(S, 31) m/s."""
    lanes: Floats
    """(L, 3) kilometres, lane changes and undone lane changes of independent units: recorded
    vehicles or episodes. (0, 3) where lanes are unknown."""


def recorded(parts: Sequence[Trip], lanes: Floats) -> Driven:
    """What the recorded drivers did."""
    every = slice(None, None, RATE_HZ)
    return Driven(
        np.array([part.driver for part in parts]),
        np.array([part.gap[None, every] for part in parts]),
        np.array([part.speed[None, every] for part in parts]),
        np.array([part.leader_speed[every] for part in parts]),
        lanes,
    )


@dataclass(frozen=True)
class Score:
    """A component, or the total, with its 95 % interval over recorded drivers."""

    value: float
    low: float
    high: float


class _Sums:
    """What is added up of a driver, by recorded driver (D)."""

    def __init__(self, driven: Driven, human: Driven, scales: Floats) -> None:
        drivers, number = np.unique(driven.driver, return_inverse=True)
        count = drivers.size
        energy = _energy_scores(driven, human, scales)
        self.energy = np.array([np.bincount(number, each, count) for each in energy.T]).T
        # One repetition, as many seconds as the recorded drivers have.
        self.strata = [np.zeros((count, _STRATA, bins)) for bins in _BINS]
        self.events = np.zeros((count, 2))
        self.seconds = np.zeros(count)
        for d in range(count):
            own = number == d
            parts = driven.speed[own, 0], driven.gap[own, 0], driven.leader_speed[own]
            for total, counts in zip(self.strata, _histograms(*parts), strict=True):
                total[d] = counts
            self.events[d], self.seconds[d] = _events(*parts[:2])
        self.lanes = driven.lanes


class Yardstick:
    """The recorded drivers, and the drivers that the scores 0 and 1 are defined by.

    Args:
        human: What the recorded drivers did.
        constant: What constant velocity does in their place.
        spawn_only: What an IDM with the speed of its spawn does.
        own: What IDM does with the recorded drivers' own parameters and noise.
        scales: (H, 2) gaps and speeds are divided by these in energy scores.
    """

    def __init__(
        self, human: Driven, constant: Driven, spawn_only: Driven, own: Driven, scales: Floats
    ) -> None:
        self._driven, self._scales = human, scales
        self._human, self._constant, self._spawn_only, self._own = (
            _Sums(each, human, scales) for each in (human, constant, spawn_only, own)
        )
        self._drivers = np.unique(human.driver).size
        every, rng = np.ones(self._drivers), np.random.default_rng(SEED)
        _, of_people, *others = self._distances(self._human, every, HALVES, rng)
        self._span = np.minimum(*others) - of_people
        """(5,) the distances that a score from 0 to 1 stands for."""
        self._span[1:] = np.maximum(self._span[1:], np.maximum(of_people[1:], LEAST_SPAN))

    def scores(self, tested: Driven) -> dict[str, Score]:
        """The components and the total of a driver in the same situations."""
        return self._with_intervals(self._resampled(tested))

    def differences(self, tested: Driven, other: Driven) -> dict[str, Score]:
        """How much higher the other driver scores, over the same resampled drivers."""
        return self._with_intervals(self._resampled(other) - self._resampled(tested))

    def ceiling(self) -> dict[str, Score]:
        """What one half of the recorded drivers scores against the other: 1, with an interval.

        The closed loop has none, because a driver has driven each situation once.
        """
        rng, every = np.random.default_rng(SEED), np.ones(self._drivers)
        splits = [self._distances(self._human, every, 1, rng)[1] for _ in range(HALVES)]
        scores = 1 - (np.array(splits) - np.mean(splits, axis=0)) / self._span
        found = {"given_scene": scores[:, 0], "events": np.nanmin(scores[:, 1:], axis=1)}
        bounds = {name: np.quantile(each, [0.025, 0.975]) for name, each in found.items()}
        return {
            name: Score(float(each.mean()), *map(float, bounds[name]))
            for name, each in found.items()
        }

    def _resampled(self, tested: Driven) -> Floats:
        """(1 + R, 4) components and total: of all drivers, then of resampled drivers."""
        rng = np.random.default_rng(SEED)
        sums = _Sums(tested, self._driven, self._scales)
        every = np.ones(self._drivers)
        found = [self._components(sums, every, HALVES, rng)]
        for _ in range(RESAMPLES):
            drawn = rng.integers(self._drivers, size=self._drivers)
            weights = np.bincount(drawn, minlength=self._drivers).astype(np.float64)
            found.append(self._components(sums, weights, HALVES_OF_RESAMPLE, rng))
        components = np.array(found)
        return np.column_stack([components, components.min(axis=1)])

    def _with_intervals(self, resampled: Floats) -> dict[str, Score]:
        low, high = np.nanquantile(resampled[1:], [0.025, 0.975], axis=0)
        return {
            name: Score(float(resampled[0, k]), float(low[k]), float(high[k]))
            for k, name in enumerate((*COMPONENTS, "total"))
        }

    def _components(
        self, tested: _Sums, weights: Floats, halves: int, rng: np.random.Generator
    ) -> Floats:
        of_constant, of_own, of_tested = (
            weights @ each.energy for each in (self._constant, self._own, tested)
        )
        closed_loop = np.mean((of_constant - of_tested) / (of_constant - of_own))
        of_tested, of_people, *_ = self._distances(tested, weights, halves, rng)
        scores = 1 - (of_tested - of_people) / self._span
        return np.array([closed_loop, scores[0], np.nanmin(scores[1:])])

    def _distances(
        self, tested: _Sums, weights: Floats, halves: int, rng: np.random.Generator
    ) -> Floats:
        """(4, 5) distances of scene and events, of contestants in one half from people in another.

        The contestants are the tested driver, people, constant velocity and spawn-only IDM.
        """
        contestants = tested, self._human, self._constant, self._spawn_only
        distances = np.zeros((len(contestants), 1 + len(EVENTS)))
        for _ in range(halves):
            is_first = rng.permutation(self._drivers) < self._drivers / 2
            one, other = weights * is_first, weights * ~is_first
            lanes = _half_rates(self._human.lanes, rng)
            for k, contestant in enumerate(contestants):
                own = lanes[1] if k == 1 else contestant.lanes.sum(axis=0)
                rates = _rates(contestant, other, own, lanes[0, 0])
                expected = _rates(self._human, one, lanes[0], lanes[0, 0])
                distances[k, 0] += _apart(self._human, one, contestant, other)
                distances[k, 1:] += np.abs(np.log(rates / expected))
        return distances / halves


def _energy_scores(tested: Driven, human: Driven, scales: Floats) -> Floats:
    """(S, H) energy scores at the horizons."""
    found = []
    for k, horizon_s in enumerate(HORIZONS_S):
        draws = np.stack([tested.gap[..., horizon_s], tested.speed[..., horizon_s]], axis=-1)
        observed = np.stack([human.gap[:, 0, horizon_s], human.speed[:, 0, horizon_s]], axis=-1)
        found.append(energy_score(draws / scales[k], observed / scales[k]))
    return np.stack(found, axis=-1)


def _apart(human: _Sums, one: Floats, tested: _Sums, other: Floats) -> float:
    """Mean total variation of acceleration, jerk and reversals in the strata, from 0 to 1.

    Strata weigh as much as the recorded drivers, with weights `one`, are in them. A stratum in
    which the other driver never is counts as 1.
    """
    distances = []
    for of_human, of_tested in zip(human.strata, tested.strata, strict=True):
        p, q = np.tensordot(one, of_human, 1), np.tensordot(other, of_tested, 1)
        seconds, visits = p.sum(axis=1), q.sum(axis=1)
        used = seconds >= SMALLEST_STRATUM_S
        p, q = p / np.maximum(seconds, 1)[:, None], q / np.maximum(visits, 1)[:, None]
        apart = np.where(visits > 0, np.abs(p - q).sum(axis=1) / 2, 1.0)
        distances.append((apart * seconds)[used].sum() / seconds[used].sum())
    return float(np.mean(distances))


def _histograms(speed: Floats, gap: Floats, leader_speed: Floats) -> list[Floats]:
    """(strata, bins) seconds by acceleration, jerk and reversal, of speeds and gaps (S, 31)."""
    acceleration = np.diff(speed, axis=-1)
    jerk = np.diff(acceleration, axis=-1)
    before, after = acceleration[:, :-1], acceleration[:, 1:]
    is_strong = np.minimum(np.abs(before), np.abs(after)) > REVERSAL_MPS2
    reverses = (is_strong & (before * after < 0)).astype(np.int64)
    seen, gap = speed[:, 1:-1], gap[:, 1:-1]
    stratum = _bin(seen, SPEEDS_MPS)
    for value, edges in (
        (gap / np.maximum(seen, 1.0), TIME_GAPS_S),
        (seen - leader_speed[:, 1:-1], CLOSING_MPS),
    ):
        stratum = stratum * (len(edges) - 1) + _bin(value, edges)
    found = []
    binned = _bin(after, ACCELERATIONS_MPS2), _bin(jerk, JERKS_MPS3), reverses
    for values, bins in zip(binned, _BINS, strict=True):
        counts = np.bincount((stratum * bins + values).ravel(), minlength=_STRATA * bins)
        found.append(counts.reshape(_STRATA, bins).astype(np.float64))
    return found


def _bin(values: Floats, edges: tuple[float, ...]) -> Ints:
    return np.asarray(np.clip(np.searchsorted(edges, values, "right") - 1, 0, len(edges) - 2))


def _events(speed: Floats, gap: Floats) -> tuple[Floats, int]:
    """(2,) seconds of hard braking and of short headways, and all seconds."""
    is_hard = np.diff(speed, axis=-1) < -HARD_BRAKING_MPS2
    is_short = gap[:, 1:] < SHORT_HEADWAY_S * speed[:, 1:]
    return np.array([is_hard.sum(), is_short.sum()], dtype=np.float64), is_hard.size


def _rates(driven: _Sums, weights: Floats, lanes: Floats, half_km: float) -> Floats:
    """(4,) rates of events by second and by km, of lanes (3,); NaN where lanes are unknown.

    The prior is one of a rate on as many kilometres as half of the recorded drivers drove, so that
    who drives further is not thought to change lanes less.
    """
    braking = (weights @ driven.events + PRIOR_EVENTS) / (weights @ driven.seconds)
    km, *changes = lanes
    return np.append(
        braking, np.array(changes) / (km or np.nan) + PRIOR_EVENTS / (half_km or np.nan)
    )


def _half_rates(lanes: Floats, rng: np.random.Generator) -> Floats:
    """(2, 3) sums over two random halves of resampled units."""
    units = len(lanes)
    drawn = rng.integers(max(units, 1), size=(2, units // 2))
    return np.asarray(lanes[drawn].sum(axis=1))

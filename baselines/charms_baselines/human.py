"""Drivers drawn from a population that was calibrated on recorded drivers, compiled."""

import math
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from charms_bench import DriverModel
from charms_bench.errors import InputError
from charms_bench.foundation import maths
from charms_bench.foundation.compiled import clip, compiled_of_scenes, index, inlined
from charms_bench.foundation.philox import uniforms
from charms_bench.humans import car_following, suited_drivers
from charms_bench.humans import population as populations
from charms_bench.humans.car_following import BRAKING_LIMIT_MPS2, idm
from charms_bench.humans.population import Population, read_population
from charms_bench.humans.suited_drivers import DEVIATION_MPS2, TRIES
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT, TARGET
from charms_bench.world.gaps import gap_to
from charms_bench.world.road import distance_along, is_reachable, side_lanes
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

CONSIDERS_EVERY_S = 1.0
"""Time between two choices of a lane; `humans.lane_choices` fits choices at this interval."""
SLOWEST_MPS = 3.0
"""Of the speed on which a driver's parameters depend, as in `humans.calibration`."""
SHORTEST_M, LONGEST_M = 1.0, 100.0
"""Gaps of the trips that populations are fitted to; a leader further ahead does not count."""
DRIVEN, FELT, NOISE, CLOCK, FIRST = range(5)
"""What a driver remembers: the number of calls, the lagged acceleration, the noise, the time since
the last choice of a lane, and, from `FIRST` on, the driver's own parameters."""
DRAWS = 3
"""Random numbers of each call: one of the noise and one of each side lane."""
_DIGITS = 9
"""The last bits of linear algebra depend on the processor; those of rounded numbers do not."""
QUANTILES = ("desired_speed", "time_gap", "jam_gap", "acceleration", "deceleration")
_OF_A_TRY = 1 + len(QUANTILES)
"""Random numbers of each driver that is drawn: whether it is kept, and the next one's quantiles."""


class _Driving(NamedTuple):
    """A population as compiled code reads it; P = 5 parameters of IDM.

    The first index says whether the driver starts behind a leader.
    """

    mean: Floats
    """(2, P) of their logarithms, at a time gap of 1 s and a speed of 1 m/s."""
    slope: Floats
    """(2, P, 2) change of their logarithms with those of the time gap and the speed."""
    root: Floats
    """(2, P, P) Cholesky factor of their covariance in a known situation."""
    median: Floats
    """(P,) the median driver's parameters, with which lanes are weighed."""
    lag_s: float
    noise: float
    noise_s: float
    threshold: float
    scale: float
    speed_mps: float


class Human(DriverModel):
    """IDM along the lane and a random choice of lanes, as calibrated on recorded drivers.

    Each driver has own parameters, which are correlated with each other, with the speed that the
    driver wants when the episode starts, and with the time gap to the leader at that time. Drivers
    who would brake or accelerate hard at once are drawn again; see `humans.suited_drivers`. Then
    the parameters that end in `_quantile` are those of the first driver drawn. The acceleration
    follows IDM's with a lag, and correlated noise is added.

    Args:
        population: The name of a population in the package, or a JSON file that
            `charms-bench calibrate` has written.

    Raises:
        InputError: There is no such population, or it does not describe IDM drivers.
    """

    memory_width = FIRST + len(QUANTILES)
    parameters: Mapping[str, tuple[float, float]] = MappingProxyType(
        {**{f"{name}_quantile": (0.0, 1.0) for name in QUANTILES}, "noise_seed": (0.0, 1.0)}
    )

    def __init__(self, population: str = "i75") -> None:
        drivers = read_population(population)
        if drivers.model != "idm":
            raise InputError(
                f"human: the population '{population}' has drivers of the model {drivers.model}; "
                "expected idm"
            )
        self._driving = _driving(drivers)
        self.files_sha256 = _sha256(drivers)

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        keys = (scene.parameters[vehicles][:, len(QUANTILES)] * 2.0**53).astype(np.uint64)
        calls = scene.memory[vehicles][:, DRIVEN].astype(np.uint64)
        count = DRAWS if calls.all() else DRAWS + _OF_A_TRY * TRIES
        draws = uniforms(keys, calls, scene.entry[vehicles].astype(np.uint64), count)
        stops = self.stops(scene, vehicles)
        return _drive(scene, vehicles[0], vehicles[1], draws, self._driving, stops)

    def stops(self, scene: Scene, vehicles: Vehicles) -> Floats:
        """The gaps (M,) from M vehicles to where they want to stop, m; none by default."""
        return np.full(vehicles[0].size, math.inf)


def _driving(drivers: Population) -> _Driving:
    mean, covariance = drivers.arrays
    size = len(QUANTILES)
    means, slopes, roots = np.empty((2, size)), np.zeros((2, size, 2)), np.empty((2, size, size))
    # The situation is the first time gap, which not every driver has, and the leader's speed.
    for k, known in enumerate(([size + 1], [size, size + 1])):
        given = covariance[np.ix_(known, known)]
        slope = np.linalg.solve(given, covariance[known, :size]).T
        means[k] = mean[:size] - slope @ mean[known]
        slopes[k, :, 2 - len(known) :] = slope
        roots[k] = np.linalg.cholesky(covariance[:size, :size] - slope @ given @ slope.T)
    changes = drivers.lane_changes
    return _Driving(
        mean=means.round(_DIGITS),
        slope=slopes.round(_DIGITS),
        root=roots.round(_DIGITS),
        median=np.exp(mean[:size]).round(_DIGITS),
        lag_s=drivers.lag_s,
        noise=drivers.noise_mps2,
        noise_s=drivers.noise_s,
        threshold=changes.threshold_mps2 if changes else math.inf,
        scale=changes.scale_mps2 if changes else 1.0,
        speed_mps=changes.speed_mps if changes else 1.0,
    )


def _sha256(drivers: Population) -> str:
    digest = sha256(drivers.model_dump_json().encode())
    for module in (car_following, populations, suited_drivers):
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.hexdigest()


@compiled_of_scenes
def _drive(
    scene: Scene, rows: Ints, places: Ints, draws: Floats, d: _Driving, stops: Floats
) -> tuple[Floats, Ints]:
    c, road, memory, timer_s = scene.constants, scene.road, scene.memory, scene.timer_s
    limit = c.idm_mobil.imposed_braking_mps2
    acceleration, target_lane = np.zeros(rows.size), np.empty(rows.size, dtype=np.int64)
    median = d.median.copy()
    for m in range(rows.size):
        b, i = index(rows[m]), index(places[m])
        own = memory[b, i]
        is_first, elapsed_s = own[DRIVEN] == 0.0, timer_s[b, i]
        p = own[FIRST:]
        if is_first:
            own[CLOCK] = elapsed_s  # a random part of the interval
            _choose(p, scene, b, i, draws[m, DRAWS:], d)
        else:
            own[CLOCK] += elapsed_s
        own[DRIVEN] += 1.0
        timer_s[b, i] = 0.0
        lane, target = scene.lane[b, i], scene.target_lane[b, i]
        target_lane[m], towards = target, TARGET
        if scene.crashed[b, i]:
            continue
        if lane == target and own[CLOCK] > CONSIDERS_EVERY_S - c.dt / 2:
            own[CLOCK] = 0.0
            kept = max(_weighed(scene, b, i, scene.leaders[b, i, OWN], median, d), -limit)
            left, right = side_lanes(road, lane)
            for side, candidate in ((left, LEFT), (right, RIGHT)):
                if side < 0 or not is_reachable(road, side, scene.x[b, i], scene.y[b, i]):
                    continue
                offered = _weighed(scene, b, i, scene.leaders[b, i, candidate], median, d)
                follower = scene.followers[b, i, candidate]
                imposed = _weighed(scene, b, follower, i, median, d) if follower >= 0 else 0.0
                if offered >= -limit and imposed >= -limit:
                    need = (d.threshold - (offered - kept)) / d.scale
                    odds = 1 + maths.exp(clip(need, -50.0, 50.0))
                    # The first draw is that of the noise.
                    if draws[m, candidate] * odds * d.speed_mps < scene.speed[b, i]:
                        target, towards = side, candidate
        wanted = _behind(scene, b, i, scene.leaders[b, i, OWN], p)
        if lane != target:
            wanted = min(wanted, _behind(scene, b, i, scene.leaders[b, i, towards], p))
        if stops[m] < math.inf:
            wanted = min(wanted, idm(max(scene.speed[b, i], 0.0), stops[m], 0.0, p))
        step_s = c.dt if is_first else elapsed_s
        is_slow = not is_first and d.lag_s > step_s
        own[FELT] += (wanted - own[FELT]) * (step_s / d.lag_s if is_slow else 1.0)
        kept_noise = 0.0 if is_first else maths.exp(-step_s / d.noise_s)
        fresh = d.noise * math.sqrt(1 - kept_noise * kept_noise)
        own[NOISE] = kept_noise * own[NOISE] + fresh * _normal(draws[m, 0])
        acceleration[m] = clip(own[FELT] + own[NOISE], -BRAKING_LIMIT_MPS2, BRAKING_LIMIT_MPS2)
        target_lane[m] = target
    return acceleration, target_lane


@inlined
def _choose(p: Floats, scene: Scene, b: int, i: int, draws: Floats, d: _Driving) -> None:
    """Sets the parameters p (P,) of a driver that suits the start, as `suited_drivers` does."""
    leader = scene.leaders[b, i, OWN]
    gap = LONGEST_M + 1
    if leader >= 0:
        gap = _gap(scene, b, i, leader)
    time_gap = max(gap, SHORTEST_M) / max(scene.speed[b, i], SLOWEST_MPS)
    speed = max(scene.target_speed[b, i], SLOWEST_MPS)
    is_led = 1 if gap <= LONGEST_M else 0
    best, smallest = 0, math.inf
    for attempt in range(TRIES + 1):
        k = attempt if attempt < TRIES else best
        quantiles = draws[_OF_A_TRY * k - len(QUANTILES) :] if k > 0 else scene.parameters[b, i]
        _draw(p, quantiles, time_gap, speed, is_led, d)
        first = abs(_behind(scene, b, i, leader, p))
        deviations = min(first / DEVIATION_MPS2, 10.0)
        if attempt == TRIES or draws[_OF_A_TRY * k] < maths.exp(-deviations * deviations / 2):
            break
        if first < smallest:
            best, smallest = k, first


@inlined
def _draw(
    p: Floats, quantiles: Floats, time_gap: float, speed: float, is_led: int, d: _Driving
) -> None:
    """Sets a driver's parameters p (P,) from the quantiles that the driver drew."""
    mean, slope, root = d.mean[is_led], d.slope[is_led], d.root[is_led]
    for k in range(p.size):
        logarithm = mean[k]
        for j in range(k + 1):
            logarithm += root[k, j] * _normal(quantiles[j])
        p[k] = maths.exp(logarithm) * _power(time_gap, slope[k, 0]) * _power(speed, slope[k, 1])


@inlined
def _power(base: float, exponent: float) -> float:
    """The power of a positive base; `maths.power` needs a positive exponent."""
    value = maths.power(base, abs(exponent) + 1e-12)
    return value if exponent > 0 else 1 / value


@inlined
def _normal(quantile: float) -> float:
    """A standard normal number, by Tukey's lambda distribution (Joiner & Rosenblatt 1971).

    Up to 3 standard deviations, it is exact to 0.03, and it lies within 5.
    """
    below, above = max(quantile, 1e-15), max(1 - quantile, 1e-15)
    return (maths.power(below, 0.1349) - maths.power(above, 0.1349)) / 0.1975


@inlined
def _weighed(scene: Scene, b: int, i: int, leader: int, median: Floats, d: _Driving) -> float:
    """The acceleration of the median driver, with which lanes are weighed, in vehicle i's place.

    The desired speed is at least the vehicle's speed, as in `humans.lane_choices`.
    """
    median[0] = max(d.median[0], scene.speed[b, i])
    return _behind(scene, b, i, leader, median)


@inlined
def _behind(scene: Scene, b: int, i: int, leader: int, p: Floats) -> float:
    """The acceleration of vehicle i of scene b behind a leader; -1 stands for none."""
    speed = scene.speed
    gap, ahead = math.inf, speed[b, i]
    if leader >= 0:
        gap = _gap(scene, b, i, leader)
        ahead = speed[b, leader] * scene.direction_x[b, leader]
    return idm(max(speed[b, i], 0.0), gap, ahead, p)


@inlined
def _gap(scene: Scene, b: int, i: int, leader: int) -> float:
    """The gap from vehicle i of scene b to its leader, bumper to bumper, m."""
    x, y, length = scene.x, scene.y, scene.length
    here, there = (x[b, i], y[b, i]), (x[b, leader], y[b, leader])
    distance = distance_along(scene.road, scene.lane[b, i], *here, *there)
    return float(gap_to(distance, length[b, i], length[b, leader]))

"""Drivers with known faults, on which a likeness score is tried: copying must not win.

All of them take the places of recorded drivers, without the engine. The calibrated driver is drawn
from a population. The others copy recorded accelerations without looking at the scene, brake or
accelerate all the time, or do what the calibrated driver does with a known change. The memoriser
has the recordings by which drivers are scored, and repeats the one that it recognises.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from charms_bench.humans.calibration import conditional, ou_noise, situation_of
from charms_bench.humans.car_following import MODELS, drive
from charms_bench.humans.driven_situations import Driven, in_place
from charms_bench.humans.held_out import SEED
from charms_bench.humans.population import Population
from charms_bench.humans.simple_models import REPETITIONS
from charms_bench.humans.suited_drivers import suited
from charms_bench.humans.trips import RATE_HZ, Driver, Trip
from charms_bench.world.scene import Floats

CALIBRATED = "calibrated driver"
LONGER = 1.2
"""Headways of the known change, as a multiple."""


def controls(parts: Sequence[Trip], human: Driven, population: Population) -> dict[str, Driven]:
    """The calibrated driver and the other ones, by name.

    `parts` are the S situations of `human`, and then S that no recording has.
    """
    recorded, lanes = parts[: len(human.driver)], human.lanes
    found = {
        CALIBRATED: in_place(parts, lanes, calibrated(population)),
        "another draw": in_place(parts, lanes, calibrated(population), seed=SEED + 1),
        "the recording with the nearest start": in_place(parts, lanes, memoriser(recorded)),
        "accelerations drawn independently": in_place(parts, lanes, copier(recorded)),
        "sequences of other situations": in_place(parts, lanes, blind(recorded)),
        "braking or accelerating by 1 m/s2": in_place(parts, lanes, bang_bang),
        "desired time gaps 20 % longer": in_place(parts, lanes, calibrated(population, LONGER)),
    }
    usual = found[CALIBRATED]
    start = usual.speed[..., :1]
    found["headways 20 % longer"] = replace(usual, gap=usual.gap * LONGER)
    found["accelerations x 2"] = replace(usual, speed=start + 2 * (usual.speed - start))
    if np.isfinite(lanes).all():
        found["lane changes x 5"] = replace(usual, lanes=lanes * [1, 5, 1, 1])
    return found


def calibrated(population: Population, headway: float = 1.0) -> Driver:
    """Drivers of a population that suit the start; then their desired time gaps are multiplied."""
    model = MODELS[population.model]
    scale = np.where(np.array(model.parameters) == "time_gap_s", headway, 1.0)

    def drives(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        mean, spread = conditional(*population.arrays, situation_of([trip]))

        def draw(count: int) -> Floats:
            return np.exp(rng.multivariate_normal(mean, spread, size=count))

        p = suited(model, trip, REPETITIONS, draw, rng) * scale
        shape = len(p), trip.gap.size
        noise = ou_noise(rng, shape, population.noise_mps2, population.noise_s)
        return drive(model, trip, p, population.lag_s, noise)

    return drives


def memoriser(parts: Sequence[Trip]) -> Driver:
    """Repeats the recorded situation whose first gap and speed are the nearest."""
    starts = np.array([[part.gap[0], part.speed[0]] for part in parts])

    def drives(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        apart = (starts - [trip.gap[0], trip.speed[0]]) / starts.std(axis=0)
        nearest = parts[int((apart**2).sum(axis=1).argmin())]
        return _along(trip, np.tile(np.diff(nearest.speed), (REPETITIONS, 1)))

    return drives


def copier(parts: Sequence[Trip]) -> Driver:
    """Draws each second's acceleration from the recorded ones."""
    recorded = np.concatenate([np.diff(part.speed[::RATE_HZ]) for part in parts])

    def drives(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        seconds = (trip.gap.size - 1) // RATE_HZ
        drawn = rng.choice(recorded, (REPETITIONS, seconds))
        return _along(trip, np.repeat(drawn, RATE_HZ, axis=1) / RATE_HZ)

    return drives


def blind(parts: Sequence[Trip]) -> Driver:
    """Repeats what recorded drivers did in other situations."""

    def drives(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        others = rng.integers(len(parts), size=REPETITIONS)
        return _along(trip, np.array([np.diff(parts[k].speed) for k in others]))

    return drives


def bang_bang(trip: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Accelerates or brakes by 1 m/s2, for a time gap of 1.4 s."""
    changes, speed, x = np.empty((1, trip.gap.size - 1)), trip.speed[0], 0.0
    for k in range(changes.size):
        is_far = trip.leader_x[k] - trip.leader_x[0] + trip.gap[0] - x > 1.4 * speed + 2
        changes[0, k] = (1 if is_far or speed < 1 else -1) / RATE_HZ
        x += speed / RATE_HZ
        speed += changes[0, k]
    gaps, speeds = _along(trip, changes)
    return np.repeat(gaps, REPETITIONS, axis=0), np.repeat(speeds, REPETITIONS, axis=0)


def _along(trip: Trip, changes: Floats) -> tuple[Floats, Floats]:
    """Gaps and speeds (M, n) from changes of speed (M, n - 1), from the trip's first ones on."""
    start = np.full((len(changes), 1), trip.speed[0])
    speeds = np.maximum(np.cumsum(np.append(start, changes, axis=1), axis=1), 0.0)
    driven_m = np.cumsum(speeds[:, :-1], axis=1) / RATE_HZ
    ahead = trip.leader_x - trip.leader_x[0] + trip.gap[0]
    return ahead - np.pad(driven_m, ((0, 0), (1, 0))), speeds

"""Recorded drivers: car-following models behind a leader, and choices of lanes."""

from pathlib import Path

import numpy as np
from rows.case import Cases, Values, adding_to
from rows.hashing import Digests
from rows.recording import write_recording

from charms_bench.humans.car_following import MODELS, drive
from charms_bench.humans.lane_choices import read_choices
from charms_bench.humans.trips import RATE_HZ, Trip

CASES: Cases = {}
case = adding_to(CASES)


@case("car following behind a leader who stops and goes")
def following(folder: Path) -> Values:
    phase = np.arange(60 * RATE_HZ) / RATE_HZ % 20.0
    leader_speed = np.maximum(np.abs(phase - 10.0) * 3.0 - 4.0, 0.0)
    leader_x = 30.0 + np.concatenate([[0.0], np.cumsum(leader_speed[:-1])]) / RATE_HZ
    trip = Trip(0, np.full(phase.size, 30.0), leader_speed, leader_x, leader_speed)
    noise = np.random.default_rng(0).integers(-4, 5, (2, phase.size)) / 8
    digests = Digests()
    for name, model in MODELS.items():
        drivers = np.array([model.usual, np.multiply(model.usual, 1.25)])
        gaps, speeds = drive(model, trip, drivers, 0.3, noise)
        digests.add(**{f"{name} gap": gaps, f"{name} speed": speeds})
    return digests.values()


@case("choices of lanes in a recording")
def choices(folder: Path) -> Values:
    write_recording(folder)
    found = read_choices(folder, np.array(MODELS["idm"].usual))
    digests = Digests()
    digests.add(gain=found.gain, changed=found.changed, speed=found.speed)
    return digests.values() | {"choices": len(found.gain), "changes": int(found.changed.sum())}

"""Fits the populations of I-24 and I-75: `python tools/make_populations.py DATA FOLDER`.

DATA is a folder that holds `i24_car_following.parquet` and `i75_lane_trajectories.parquet`, and
FOLDER is where the populations are written. Those in the package are older: their second number of
the situation was the mean speed of the leader over the trip. Lane changes are those of all
vehicles of I-75, because half of them have fewer than ten to open lanes.
"""

import sys
from pathlib import Path

from charms_bench.humans.calibrated import calibrate
from charms_bench.humans.lane_choices import fit_choices, read_choices
from charms_bench.humans.reference import references
from charms_bench.humans.trips import read_trips

FILES = {"i24": "i24_car_following.parquet", "i75": "i75_lane_trajectories.parquet"}
ORIGINS = {
    "i24": "CIRCLES, I-24, Nashville: one instrumented car in 60 runs, which count as drivers. Its "
    "lanes are unknown; the lane changes are those of I-75.",
    "i75": "HIGH-SIM, I-75, Florida: main lanes. Vehicles are assumed to be 5 m long.",
}


def main(data: Path, folder: Path) -> None:
    """Writes both populations into a folder."""
    folder.mkdir(exist_ok=True)
    for name, file in FILES.items():
        found = calibrate(read_trips(data / file), print)
        choices = read_choices(data / FILES["i75"], found.fit.point)
        terms = references()[name].terms
        population = found.population(name, ORIGINS[name], terms, fit_choices(choices))
        (folder / f"{name}.json").write_text(population.to_json(), encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python tools/make_populations.py DATA FOLDER")
    main(*map(Path, sys.argv[1:]))

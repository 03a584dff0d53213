"""Makes the populations of drivers in the package: `python tools/make_populations.py DATA`.

DATA is a folder that holds `i24_car_following.parquet` and `i75_lane_trajectories.parquet`.
"""

import sys
from pathlib import Path

from charms_bench.people.calibrated import calibrate
from charms_bench.people.lane_choices import fit_choices, read_choices
from charms_bench.people.population import POPULATIONS
from charms_bench.people.reference import references
from charms_bench.people.trips import read_trips

FILES = {"i24": "i24_car_following.parquet", "i75": "i75_lane_trajectories.parquet"}
ORIGINS = {
    "i24": "CIRCLES, I-24, Nashville: one instrumented car in 60 runs, which count as drivers. Its "
    "lanes are unknown; the lane changes are those of I-75.",
    "i75": "HIGH-SIM, I-75, Florida: main lanes. Vehicles are assumed to be 5 m long.",
}


def main(data: Path) -> None:
    """Writes all populations into the package."""
    POPULATIONS.mkdir(exist_ok=True)
    for name, file in FILES.items():
        found = calibrate(read_trips(data / file), print)
        choices = read_choices(data / FILES["i75"], found.fit.point)
        terms = references()[name].terms
        population = found.population(name, ORIGINS[name], terms, fit_choices(choices))
        (POPULATIONS / f"{name}.json").write_text(population.to_json(), encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/make_populations.py DATA")
    main(Path(sys.argv[1]))

"""Recorded speeds by meta-actions: `python tools/recorded_through_interface.py DATA [POLICY ...]`.

DATA is a folder that holds `i24_car_following.parquet` and `i75_lane_trajectories.parquet`. At each
decision, 3 times a second, the driver chooses the one of FASTER, SLOWER and IDLE after which its
speed is the nearest to the recorded one at the next decision. The table has the proportion of
decisions whose mean acceleration is above 1.1 m/s2 and the standard deviation of the accelerations,
of the recorded drivers and of those through the interface of each profile. Each POLICY, the name of
an agent or the path of a network, adds the interface of `charms` with that policy's meta-actions.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from charms_agents.human.interface import DECISION_HZ, through_interface

from charms_bench.people.trips import RATE_HZ, read_trips
from charms_bench.plugins.registry import make_agent
from charms_bench.world.actions import DEFAULT_ACTIONS, meta_actions_of
from charms_bench.world.profile import CHARMS, NATURALISTIC
from charms_bench.world.scene import Floats

FILES = {"I-24": "i24_car_following.parquet", "I-75": "i75_lane_trajectories.parquet"}
STRONG_MPS2 = 1.1


def at_decisions(values: Floats) -> Floats:
    """Recorded values (n,) at the decisions of a driver."""
    time_s = np.arange(values.size) / RATE_HZ
    return np.interp(np.arange(0.0, time_s[-1], 1 / DECISION_HZ), time_s, values)


def main(data: Path, policies: Sequence[str]) -> None:
    """Prints the table."""
    actions_of = {name: getattr(make_agent(name), "actions", "meta") for name in policies}
    print("| recording | driver | above 1.1 m/s² | standard deviation, m/s² |")
    print("|---|---|---:|---:|")
    for name, file in FILES.items():
        decided = [at_decisions(trip.speed) for trip in read_trips(data / file)]
        drivers = {"recorded": decided}
        interfaces = {f"`{each.name}`": (each, DEFAULT_ACTIONS) for each in (CHARMS, NATURALISTIC)}
        for policy, actions in actions_of.items():
            interfaces[f"`charms` and `{policy}`"] = CHARMS, meta_actions_of(actions)
        for name_of_interface, interface in interfaces.items():
            drivers[f"through the interface of {name_of_interface}"] = [
                through_interface(each[:, None], *interface).speed[:, 0] for each in decided
            ]
        for driver, speeds in drivers.items():
            found = np.concatenate([np.diff(each) * DECISION_HZ for each in speeds])
            strong = (np.abs(found) > STRONG_MPS2).mean()
            print(f"| {name} | {driver} | {strong:.1%} | {found.std():.2f} |")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python tools/recorded_through_interface.py DATA [POLICY ...]")
    main(Path(sys.argv[1]), sys.argv[2:])

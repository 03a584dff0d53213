"""Recorded speeds by meta-actions: `python tools/recorded_through_interface.py DATA [POLICY ...]`.

DATA is a folder that holds `i24_car_following.parquet` and `i75_lane_trajectories.parquet`. At each
decision, 3 times a second, the driver chooses the one of FASTER, SLOWER and IDLE after which its
speed is the nearest to the recorded one at the next decision. The table has the proportion of
decisions whose mean acceleration is above 1.1 m/s2 and the standard deviation of the accelerations,
of the recorded drivers and of those through the interface of each profile. Each POLICY, the name of
an agent or the path of a network, adds the interface of `charms` with that policy's speed steps.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from charms_bench.metrics.mean_acceleration import STRONG_MPS2
from charms_bench.people.trips import RATE_HZ, read_trips
from charms_bench.plugins.registry import make_agent
from charms_bench.world.actions import FASTER, IDLE, SLOWER
from charms_bench.world.profile import CHARMS, NATURALISTIC, Profile
from charms_bench.world.scene import Floats

FILES = {"I-24": "i24_car_following.parquet", "I-75": "i75_lane_trajectories.parquet"}
SIMULATION_HZ, DECISION_HZ = 15, 3


def through_interface(
    recorded: Floats, profile: Profile, own_steps: Sequence[float] = ()
) -> tuple[Floats, list[int]]:
    """Speeds (D,) at decisions, and the actions between them, of a driver who follows speeds (D,).

    The profile's bounds of speeds do not count. `own_steps` are those of `Policy`.
    """
    steps = own_steps or profile.target_speed_steps_mps or (profile.target_speed_step_mps,)
    speed = target = recorded[0]
    repeats, speeds, actions = 0, [speed], []
    for wanted in recorded[1:]:
        options = []
        for sign, action in ((0, IDLE), (1, FASTER), (-1, SLOWER)):
            again = abs(repeats) + 1 if sign * repeats > 0 else 1
            aimed = target + sign * steps[min(again, len(steps)) - 1]
            after = speed
            held = (aimed - speed) / profile.tau_acceleration_s
            for _ in range(SIMULATION_HZ // DECISION_HZ):
                if profile.ego_control_rate == "simulation":
                    held = (aimed - after) / profile.tau_acceleration_s
                after += held / SIMULATION_HZ
            options.append((abs(after - wanted), after, aimed, sign * again, action))
        _, speed, target, repeats, action = min(options)
        speeds.append(speed)
        actions.append(action)
    return np.array(speeds), actions


def main(data: Path, policies: Sequence[str]) -> None:
    """Prints the table."""
    steps_of = {name: getattr(make_agent(name), "target_speed_steps_mps", ()) for name in policies}
    print("| recording | driver | above 1.1 m/s² | standard deviation, m/s² |")
    print("|---|---|---:|---:|")
    for name, file in FILES.items():
        trips = read_trips(data / file)
        decided = []
        for trip in trips:
            time_s = np.arange(trip.speed.size) / RATE_HZ
            at = np.arange(0.0, time_s[-1], 1 / DECISION_HZ)
            decided.append(np.interp(at, time_s, trip.speed))
        drivers = {"recorded": decided}
        for profile in (CHARMS, NATURALISTIC):
            followed = [through_interface(each, profile)[0] for each in decided]
            drivers[f"through the interface of `{profile.name}`"] = followed
        for policy, steps in steps_of.items():
            followed = [through_interface(each, CHARMS, steps)[0] for each in decided]
            drivers[f"through the interface of `charms` and `{policy}`"] = followed
        for driver, speeds in drivers.items():
            found = np.concatenate([np.diff(each) * DECISION_HZ for each in speeds])
            strong = (np.abs(found) > STRONG_MPS2).mean()
            print(f"| {name} | {driver} | {strong:.1%} | {found.std():.2f} |")


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python tools/recorded_through_interface.py DATA [POLICY ...]")
    main(Path(sys.argv[1]), sys.argv[2:])

"""Compares `Ego-v0` with stock `highway-v0`: `python tools/against_highway_v0.py FOLDER`.

Every episode has a configuration drawn at random: 2 to 6 lanes, 5 to 60 vehicles, density 0.6 to 3,
1, 3, 5 or 15 decisions per second, 10 to 40 s. Random meta-actions drive the ego. In every second
episode they are IDLE and SLOWER only, so that about half of these last until their time is over.
An episode differs if an observation or a reward differs by more than 1e-6, or if the episodes do
not end in the same step. The same is counted for stock highway-env under another NumPy dispatch.
Every episode that differs is listed. FOLDER keeps the episodes, so the command continues where it
was interrupted. `--episodes N` sets their number, by default 200.
"""

from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import highway_env  # noqa: F401  # registers highway-v0
import numpy as np
from against_stock import VARIABLES, asked, counted, keep, print_difference, simulate_in_processes
from numpy.typing import NDArray

import charms_bench.envs  # registers Ego-v0
from charms_bench.envs.highway_reward import HighwayReward
from charms_bench.testing.verify import random_controls
from charms_bench.world.actions import ACTIONS, IDLE, SLOWER

TOLERANCE = 1e-6
OURS = ("lanes", "traffic_vehicles", "density", "decision_hz", "duration_s")
STOCK = ("lanes_count", "vehicles_count", "vehicles_density", "policy_frequency", "duration")
"""What the two environments call the numbers of a configuration after its seed."""


class Configuration(NamedTuple):
    """A configuration of `highway-v0`, and the seed of its episode."""

    seed: int
    lanes: int
    vehicles: int
    density: float
    decision_hz: int
    duration_s: float

    @classmethod
    def drawn(cls, seed: int) -> "Configuration":
        rng = np.random.default_rng([seed, 3])
        lanes, vehicles = int(rng.integers(2, 7)), int(rng.integers(5, 61))
        density, decision_hz = float(rng.uniform(0.6, 3.0)), int(rng.choice([1, 3, 5, 15]))
        return cls(seed, lanes, vehicles, density, decision_hz, float(rng.integers(10, 41)))

    def make(self, contestant: str, continuous: bool) -> Any:
        if contestant == "ours":
            return gymnasium.make(
                charms_bench.envs.ID,
                actions="continuous" if continuous else "meta",
                reward=HighwayReward(),
                profile="highway-env",
                ego_slots=1,
                observation="Kinematics",
                **dict(zip(OURS, self[1:], strict=True)),
            )
        config: dict[str, Any] = dict(zip(STOCK, self[1:], strict=True))
        if continuous:
            config["action"] = {"type": "ContinuousAction"}
        return gymnasium.make("highway-v0", config=config)


def simulate(configuration: Configuration, contestant: str, continuous: bool, path: Path) -> None:
    """Writes the observations, rewards and endings of an episode."""
    environment = configuration.make(contestant, continuous)
    rng = np.random.default_rng([configuration.seed, 4])
    observations = [environment.reset(seed=configuration.seed)[0]]
    rewards, ending = [], (False, False)
    actions = [IDLE, SLOWER] if configuration.seed % 2 else range(len(ACTIONS))
    controls = random_controls(configuration.seed, 15 * 41).astype(np.float32)
    while not any(ending):
        action = controls[len(rewards)] if continuous else int(rng.choice(actions))
        step = environment.step(action)
        observations.append(step[0])
        rewards.append(step[1])
        ending = step[2:4]
    keep(path, observations=observations, rewards=rewards, terminated=ending[0])


def difference(ours: dict[str, NDArray[Any]], stock: dict[str, NDArray[Any]]) -> str:
    """The first difference of an episode from stock highway-env in words; empty if none."""
    for step, (reward, expected) in enumerate(zip(ours["rewards"], stock["rewards"], strict=False)):
        seen, known = ours["observations"][step + 1], stock["observations"][step + 1]
        apart = np.abs(seen - known).max()
        if max(apart, abs(reward - expected)) > TOLERANCE:
            speed = np.hypot(*known[0, 3:5]) * 80
            return f"step {step + 1}: observation {apart:.1e}, ego at {speed:.1f} m/s"
    if ours["rewards"].size != stock["rewards"].size or ours["terminated"] != stock["terminated"]:
        return f"ends in step {ours['rewards'].size}, stock in step {stock['rewards'].size}"
    return ""


def main() -> None:
    parser = asked(__doc__, "episodes", 200)
    parser.add_argument("--continuous", action="store_true")
    given = parser.parse_args()
    configurations = [Configuration.drawn(seed) for seed in range(given.episodes)]
    paths = {
        name: [given.folder / name / f"{each.seed}.npz" for each in configurations]
        for name in VARIABLES
    }
    if given.simulate:
        for configuration, path in zip(configurations, paths[given.simulate], strict=True):
            if not path.exists():
                simulate(configuration, given.simulate, given.continuous, path)
        return
    simulate_in_processes(__file__)
    differs = {}
    for name in ("ours", "dispatch"):
        print(name)
        found, timed = [], 0
        for each, path, stock in zip(configurations, paths[name], paths["stock"], strict=True):
            with np.load(path) as mine, np.load(stock) as theirs:
                found.append(difference(dict(mine), dict(theirs)))
                timed += not theirs["terminated"]
            if found[-1]:
                print(f"  {each}: {found[-1]}")
        differs[name] = np.array([bool(text) for text in found])
        print(f"  {counted(differs[name])}; {timed} last their full time")
    print_difference(differs["ours"], differs["dispatch"])


if __name__ == "__main__":
    main()

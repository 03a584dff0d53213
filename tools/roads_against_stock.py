"""Compares an environment with stock highway-env: `python tools/roads_against_stock.py FOLDER`.

`--road NAME` names the environment, by default merge-v0. Stock highway-env has nothing replaced.
The environment of charms-bench, and stock highway-env under another NumPy dispatch, are each
compared with it in the same episodes, with the same actions: those of `charms-bench verify --road`.
`--episodes N` sets their number, by default 200. An episode differs if after any decision the
number of vehicles, the lane or the crash of one or the ending differs, or if a position, heading,
speed, observation or reward differs by more than 1e-6. It is compared up to its 200th decision.

The starts of 1,000 episodes (`--starts N`) of charms-bench and stock highway-env are compared with
everything that `verify` compares; one differs if a number does by more than 1e-9. FOLDER keeps the
episodes, so the command continues where it was interrupted.
"""

from pathlib import Path
from typing import Any

import against_stock
import gymnasium
import highway_env  # noqa: F401  # registers its environments
import numpy as np
from numpy.typing import NDArray

import charms_bench.envs  # noqa: F401  # registers those of charms-bench
from charms_bench.roads import TASKS
from charms_bench.roads.episodes import Episodes
from charms_bench.testing.parity import compare, differences
from charms_bench.testing.road_parity import MOST_DECISIONS, RoadCase, action_for
from charms_bench.testing.stock_roads import unchanged_idm

TOLERANCE = 1e-6
AT_START = 1e-9
FUNCTIONS = {"sin": 1, "cos": 1, "tan": 1, "arctan2": 2, "power": 2}
"""Functions that move highway-env's vehicles, and how many arguments each takes."""
ARGUMENTS = 1_000_000


def simulate(road: str, contestant: str, paths: list[Path], folder: Path) -> None:
    """Writes what is compared of each episode; stock highway-env chooses the actions of all."""
    prefix = "charms_bench/" if contestant == "ours" else ""
    environment: Any = gymnasium.spec(prefix + road).make(disable_env_checker=True)
    episodes = Episodes(road, 1)
    for seed, path in enumerate(paths):
        if path.exists():
            continue
        rng, is_random = np.random.default_rng([seed, 6]), seed % 2 == 0
        given = None
        if contestant != "stock":
            with np.load(folder / "stock" / path.name) as stock:
                given = stock["actions"]
        after = [(environment.reset(seed=seed)[0],)]
        states = [state_of(environment)]
        actions: list[list[Any]] = []
        while len(actions) < (MOST_DECISIONS if given is None else len(given)):
            if given is None:
                egos = environment.unwrapped.controlled_vehicles[: episodes.agents]
                actions.append([action_for(episodes, ego, rng, is_random) for ego in egos])
            else:
                actions.append([*given[len(actions)]])
            step = environment.step(tuple(actions[-1]) if episodes.has_agents else actions[-1][0])
            after.append(step[:4])
            states.append(state_of(environment))
            if np.all(step[2]) or step[3]:
                break
        both = [*zip(states, after, strict=True)]
        numbers = [flat((state[0], step[:2])) for state, step in both]
        events = [
            f"{state[1]} {[np.array(each).tolist() for each in step[2:]]}" for state, step in both
        ]
        against_stock.keep(
            path,
            actions=actions,
            events=events,
            lengths=[part.size for part in numbers],
            numbers=np.concatenate(numbers),
        )


def state_of(environment: Any) -> tuple[list[Any], list[Any]]:
    """What is a number and what is not of the vehicles on the road."""
    vehicles = environment.unwrapped.road.vehicles
    numbers = [[*each.position, each.heading, each.speed] for each in vehicles]
    return numbers, [(*each.lane_index, bool(each.crashed)) for each in vehicles]


def flat(values: Any) -> NDArray[np.float64]:
    """The numbers in tuples, lists and dictionaries of arrays."""
    if isinstance(values, dict):
        values = [values[name] for name in sorted(values)]
    if isinstance(values, (tuple, list)):
        return np.concatenate([np.empty(0), *map(flat, values)])
    return np.asarray(values, dtype=np.float64).ravel()


def largest_difference(ours: dict[str, NDArray[Any]], stock: dict[str, NDArray[Any]]) -> float:
    """The largest difference between numbers of an episode; infinite if anything else differs."""
    if any(not np.array_equal(ours[each], stock[each]) for each in ("events", "lengths")):
        return np.inf
    return float(differences(ours["numbers"], stock["numbers"]).max(initial=0.0))


def values(contestant: str) -> dict[str, NDArray[np.float64]]:
    """What NumPy's functions return for the same arguments."""
    rng = np.random.default_rng(0)
    arguments = rng.uniform(0.1, 10, (2, ARGUMENTS))
    return {name: getattr(np, name)(*arguments[:count]) for name, count in FUNCTIONS.items()}


def print_functions(folder: Path) -> None:
    """Prints how often a function of NumPy returns something else under the other dispatch."""
    with (
        np.load(folder / "stock" / "functions.npz") as stock,
        np.load(folder / "dispatch" / "functions.npz") as other,
    ):
        found = [f"{name} {np.mean(stock[name] != other[name]):.2%}" for name in FUNCTIONS]
    print(f"the other dispatch changes the last bits of {', '.join(found)} of the values")


def main() -> None:
    parser = against_stock.asked(__doc__, "episodes", 200)
    parser.add_argument("--road", choices=TASKS, default="merge-v0", metavar="NAME")
    parser.add_argument("--starts", type=int, default=1000)
    given = parser.parse_args()
    paths = {
        name: [given.folder / name / f"{given.road}-{k}.npz" for k in range(given.episodes)]
        for name in against_stock.VARIABLES
    }
    if name := given.simulate:
        against_stock.keep(given.folder / name / "functions.npz", **values(name))
        with unchanged_idm():
            simulate(given.road, name, paths[name], given.folder)
        return
    against_stock.simulate_in_processes(__file__)
    print(given.road)
    found = compare(RoadCase(given.road), range(given.starts), steps=0, tolerance=AT_START)
    print(
        f"  {len(found.differences)} of {found.episodes} starts differ, "
        f"by at most {found.largest_at_start:.1e}"
    )
    apart = {}
    for name, title in against_stock.TITLES.items():
        apart[name] = np.empty(given.episodes)
        for k, (path, stock) in enumerate(zip(paths[name], paths["stock"], strict=True)):
            with np.load(path) as mine, np.load(stock) as theirs:
                apart[name][k] = largest_difference(dict(mine), dict(theirs))
        same = apart[name][apart[name] <= TOLERANCE]
        print(f"  {title}: {against_stock.counted(apart[name] > TOLERANCE)}", end="")
        print(f", {np.isinf(apart[name]).sum()} by more than numbers", end="")
        print(f"; else numbers differ by at most {same.max():.1e}" if same.size else "")
    against_stock.print_difference(apart["ours"] > TOLERANCE, apart["dispatch"] > TOLERANCE)
    print_functions(given.folder)


if __name__ == "__main__":
    main()

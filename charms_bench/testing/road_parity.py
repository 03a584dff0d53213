"""Compares highway-env's environments with those of `charms_bench.roads`, decision by decision."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import gymnasium
import numpy as np

from charms_bench.roads.controls import Controls
from charms_bench.roads.episodes import Decision, Episodes
from charms_bench.roads.scenes import OBSTACLE
from charms_bench.runs.suite import Suite
from charms_bench.testing.chunks import in_chunks
from charms_bench.testing.stock_roads import unchanged_idm

NUMBERS = (
    *("x", "y", "heading", "speed", "acceleration", "steering", "target_speed"),
    *("lateral_speed", "yaw_rate"),
)
"""What is compared of a vehicle that has it."""
MOST_DECISIONS = 200
"""An episode that is not over then is not compared further."""
Pairs = dict[str, tuple[Any, Any]]
"""Our value and highway-env's, by what they are of."""
_CHUNK = 10
_SHARE_OF_IDLE = 0.8
_LOOK_AHEAD_S = 0.3


@dataclass
class Comparison:
    """What the comparison of some episodes found."""

    name: str
    episodes: int = 0
    decisions: int = 0
    crashed: int = 0
    """Episodes in which the ego crashed."""
    largest: float = 0.0
    """The largest difference of a number, also between rewards and between observations."""
    largest_at_start: float = 0.0
    """The same, of the starts of episodes alone."""
    own_s: float = 0.0
    """The CPU time of charms-bench for what was compared, s, where it is measured."""
    stock_s: float = 0.0
    """The same of highway-env."""
    differing: list[str] = field(default_factory=list)
    """The first difference of each episode that has one above the tolerance."""

    def __add__(self, other: "Comparison") -> "Comparison":
        sums = {
            name: getattr(self, name) + getattr(other, name)
            for name in ("episodes", "decisions", "crashed", "own_s", "stock_s", "differing")
        }
        largest = {
            name: max(getattr(self, name), getattr(other, name))
            for name in ("largest", "largest_at_start")
        }
        return Comparison(self.name, **sums, **largest)


def roads_of(suite: Suite) -> list[tuple[str, str, Mapping[str, Any]]]:
    """The title, highway-env's name and the configuration of each road of a suite.

    The simulation rate is the suite's. The agents of a suite drive these roads in the engine that
    is compared; highway-env cannot ask them.
    """
    rate = {"simulation_frequency": suite.scene.simulation_hz}
    networks = {cell.road.title: cell.scene.network for cell in suite.cells if cell.road}
    return [
        (title, network.name, {**(network.configuration or {}), **rate})
        for title, network in networks.items()
        if network is not None
    ]


def verify_road(
    name: str,
    episodes: int,
    seed: int = 0,
    workers: int | None = None,
    progress: Callable[[int], None] = lambda episodes: None,
    config: Mapping[str, Any] | None = None,
    decisions: int = MOST_DECISIONS,
) -> Comparison:
    """Compares the episodes `seed` to `seed + episodes - 1` of an environment to the last bit.

    In every other episode, actions are random; in the others, most are IDLE, or the ego steers
    towards the middle of its lane. At most `decisions` decisions are compared; with 0, only the
    starts of the episodes. For the other arguments, see `in_chunks`.
    """
    some, seeds = partial(compare, decisions=decisions, config=config), range(seed, seed + episodes)
    (found,) = in_chunks(some, [name], seeds, _CHUNK, str, workers, progress, environments=True)
    return sum(found, Comparison(name))


@unchanged_idm()
def compare(
    name: str,
    seeds: range,
    decisions: int = MOST_DECISIONS,
    tolerance: float = 0.0,
    config: Mapping[str, Any] | None = None,
) -> Comparison:
    """Compares episodes with highway-env as it computes in this process.

    At most `decisions` decisions are compared; with 0, only the starts of the episodes.
    """
    import highway_env  # noqa: F401  # registers its environments

    stock: Any = gymnasium.spec(name).make(disable_env_checker=True)
    # Some environments take no configuration when they are made.
    stock.reset(options={"config": dict(config or {})})
    names = [*stock.unwrapped.road.network.lanes_dict()]
    ours, found = Episodes(name, 1, config), Comparison(name)
    for seed in seeds:
        rng, is_random = np.random.default_rng([seed, 6]), seed % 2 == 0
        expected = [stock.reset(seed=seed)[0]]
        ours.seed(ours.everyone, np.array([seed], dtype=np.uint64))
        ours.start(ours.everyone)
        apart, what = _apart(stock, ours, names, expected, None)
        found.largest_at_start = max(found.largest_at_start, apart)
        found.episodes += 1
        for _ in range(decisions if apart <= tolerance else 0):
            vehicles = stock.unwrapped.controlled_vehicles[: ours.agents]
            actions = tuple(action_for(ours, each, rng, is_random) for each in vehicles)
            parts = tuple(np.asarray(each)[None] for each in actions)
            expected = list(stock.step(actions if ours.has_agents else actions[0]))
            decision = ours.step(parts if ours.has_agents else parts[0])
            apart, what = _apart(stock, ours, names, expected, decision)
            found.decisions += 1
            found.largest = max(found.largest, apart)
            if apart > tolerance or np.all(expected[2]) or expected[3]:
                break
        found.crashed += bool(ours.scenes.vehicles["crashed"][0, : ours.task.egos].any())
        found.largest = max(found.largest, apart)
        if apart > tolerance:
            found.differing.append(f"episode {seed}, decision {ours.steps[0]}: {what}")
    return found


def action_for(ours: Episodes, vehicle: Any, rng: np.random.Generator, is_random: bool) -> Any:
    """A random action, or one that keeps highway-env's vehicle on the road."""
    actions = ours.actions
    if isinstance(actions, Controls):
        if isinstance(actions.space, gymnasium.spaces.Discrete):
            return int(rng.integers(actions.space.n))
        controls = rng.uniform(-1, 1, actions.space.shape or ()).astype(np.float32)
        if not is_random:
            controls *= np.float32(0.1)
            controls[-1] += np.float32(_steering(vehicle))
        return controls
    action = int(rng.integers(len(actions.names)))
    if not is_random and "FASTER" in actions.names:
        name = rng.choice(("FASTER", "SLOWER"))
        action = actions.names.index("IDLE" if rng.random() < _SHARE_OF_IDLE else str(name))
    return action


def _steering(vehicle: Any) -> float:
    """A steering angle towards the middle of the lane, rad."""
    s, r = vehicle.lane.local_coordinates(vehicle.position)
    ahead = vehicle.lane.heading_at(s + max(vehicle.speed, 1.0) * _LOOK_AHEAD_S)
    turn = (ahead - vehicle.heading + np.pi) % (2 * np.pi) - np.pi
    return float(np.clip(turn - 0.1 * r, -1, 1))


def _apart(
    stock: Any, ours: Episodes, names: list[Any], expected: list[Any], decision: Decision | None
) -> tuple[float, str]:
    """The largest difference now and its quantity; infinity for what is not a number."""
    found: Any = ours.observe() if decision is None else decision.observations
    their = expected[0]
    if isinstance(found, tuple):
        found, their = dict(enumerate(found)), dict(enumerate(their))
    elif not isinstance(found, dict):
        found, their = {"observation": found}, {"observation": their}
    pairs: Pairs = {f"{what}": (found[what][0], their[what]) for what in found}
    road, table = stock.unwrapped.road, ours.scenes.vehicles[0, ours.scenes.order["place"][0]]
    vehicles = [each for each in table if each["kind"] > OBSTACLE]
    if len(vehicles) != len(road.vehicles):
        return np.inf, f"{len(vehicles)} and {len(road.vehicles)} vehicles"
    pairs |= pairs_of(vehicles, road.vehicles, names)
    if decision is not None:
        _, reward, terminated, truncated, info = expected
        if ours.is_split:
            reward, terminated = stock.unwrapped._reward(None), stock.unwrapped._is_terminated()
        pairs["reward"] = decision.rewards[0], reward
        for term, value in zip(ours.task.terms, decision.terms[0], strict=True):
            pairs[term] = value, info["rewards"][term]
        ended = decision.terminated[0], decision.truncated[0]
        pairs["end"] = 0.0, 0.0 if ended == (terminated, truncated) else np.inf
        for name, value in ours.task.information(ours.scenes).items():
            pairs[name] = value[0], info[name]
    return largest(pairs)


def pairs_of(ours: Sequence[Any], stock: Sequence[Any], names: list[Any]) -> Pairs:
    """What is compared of the vehicles of a road, by its name."""
    pairs: Pairs = {}
    for k, (vehicle, theirs) in enumerate(zip(ours, stock, strict=True)):
        values = {**vars(theirs), **theirs.action}
        values |= dict(zip("xy", theirs.position, strict=True))
        numbers = [each for each in NUMBERS if each in values]
        pairs |= {f"{each} of vehicle {k}": (vehicle[each], values[each]) for each in numbers}
        is_same = {
            "lane": names[vehicle["lane"]] == theirs.lane_index,
            "crashed": vehicle["crashed"] == theirs.crashed,
            "yielding": vehicle["is_yielding"] == getattr(theirs, "is_yielding", False),
        }
        if "route" in values:
            steps = [tuple(step) for step in theirs.route or ()]
            is_same |= {
                "target lane": names[vehicle["target_lane"]] == theirs.target_lane_index,
                "route": route_of(vehicle, names) == steps,
            }
        pairs |= {
            f"{each} of vehicle {k}": (0.0, 0.0 if is_same[each] else np.inf) for each in is_same
        }
        if hasattr(theirs, "timer"):
            pairs[f"timer of vehicle {k}"] = vehicle["timer_s"], theirs.timer
            pairs[f"exponent of vehicle {k}"] = vehicle["exponent"], theirs.DELTA
        if hasattr(theirs, "STEERING_PARAMETERS"):
            gains = [*theirs.ACCELERATION_PARAMETERS, *theirs.STEERING_PARAMETERS]
            pairs[f"gains of vehicle {k}"] = vehicle["gains"], gains
    return pairs


def largest(pairs: Pairs) -> tuple[float, str]:
    """The largest difference of two values, and what it is of."""
    apart = {what: difference(*pair) for what, pair in pairs.items()}
    what = max(apart, key=lambda name: apart[name])
    return apart[what], f"{what}: {pairs[what][0]!r} (ours), {pairs[what][1]!r} (highway-env)"


def difference(ours: Any, theirs: Any) -> float:
    """The largest difference of numbers in arrays of the same shape; infinite for other shapes."""
    one, other = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    if one.shape != other.shape:
        return float("inf")
    is_same = (one == other) | (np.isnan(one) & np.isnan(other))  # infinities, too
    apart = np.abs(one[~is_same] - other[~is_same])
    return float(np.nan_to_num(apart, nan=np.inf, posinf=np.inf).max(initial=0.0))


def route_of(vehicle: Any, names: list[Any]) -> list[Any]:
    """A vehicle's route as highway-env writes it."""
    steps = range(int(vehicle["route_step"]), int(vehicle["route_end"]))
    numbers = [int(vehicle["route_numbers"][k]) for k in steps]
    roads = [names[vehicle["route_roads"][k]][:2] for k in steps]
    return [(*road, None if k < 0 else k) for road, k in zip(roads, numbers, strict=True)]

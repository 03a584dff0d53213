"""Episodes of highway-env's environments, decision by decision."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np

from charms_bench.roads.continuous_actions import Controls
from charms_bench.roads.episodes import Decision, Episodes
from charms_bench.roads.scenes import OBSTACLE
from charms_bench.testing.parity import Values

NUMBERS = (
    *("x", "y", "heading", "speed", "acceleration", "steering", "target_speed"),
    *("lateral_speed", "yaw_rate"),
)
"""What is compared of a vehicle that has it."""
MOST_DECISIONS = 200
"""An episode that is not over then is not compared further."""
_IDLE_PROBABILITY = 0.8
_LOOK_AHEAD_S = 0.3


@dataclass(frozen=True)
class RoadCase:
    """One of highway-env's environments with a configuration.

    In every other episode, actions are random; in the others, most are IDLE, or the ego steers
    towards the middle of its lane.
    """

    name: str
    configuration: Mapping[str, Any] = field(default_factory=dict)
    label: str = ""

    @property
    def title(self) -> str:
        """The label, or highway-env's name."""
        return self.label or self.name

    def episode(self) -> "RoadEpisode":
        """One in both environments."""
        return RoadEpisode(self)


class RoadEpisode:
    """The same episode in highway-env's environment and in that of `charms_bench.roads`."""

    step_name = "decision"

    def __init__(self, case: RoadCase) -> None:
        import highway_env  # noqa: F401  # registers its environments

        stock: Any = gymnasium.spec(case.name).make(disable_env_checker=True)
        # Some environments take no configuration when they are made.
        stock.reset(options={"config": dict(case.configuration)})
        self._stock, self._names = stock, [*stock.unwrapped.road.network.lanes_dict()]
        self._ours = Episodes(case.name, 1, case.configuration)

    def start(self, seed: int) -> None:
        self._rng, self._is_random = np.random.default_rng([seed, 6]), seed % 2 == 0
        self._expected = [self._stock.reset(seed=seed)[0]]
        self._decision: Decision | None = None
        self._ours.seed(self._ours.everyone, np.array([seed], dtype=np.uint64))
        self._ours.start(self._ours.everyone)

    def advance(self) -> None:
        vehicles = self._stock.unwrapped.controlled_vehicles[: self._ours.agents]
        self._actions = tuple(
            action_for(self._ours, each, self._rng, self._is_random) for each in vehicles
        )
        parts = tuple(np.asarray(each)[None] for each in self._actions)
        self._decision = self._ours.step(parts if self._ours.has_agents else parts[0])

    def advance_stock(self) -> None:
        actions = self._actions if self._ours.has_agents else self._actions[0]
        self._expected = list(self._stock.step(actions))

    def is_over(self) -> bool:
        if self._decision is None:
            return False
        is_last = self._ours.steps[0] >= MOST_DECISIONS
        return bool(is_last or np.all(self._expected[2]) or self._expected[3])

    def has_crashed(self) -> bool:
        return bool(self._ours.scenes.vehicles["crashed"][0, : self._ours.task.egos].any())

    def values(self) -> Values:
        ours, stock, decision = self._ours, self._stock.unwrapped, self._decision
        found: Any = ours.observe() if decision is None else decision.observations
        their = self._expected[0]
        if isinstance(found, tuple):
            found, their = dict(enumerate(found)), dict(enumerate(their))
        elif not isinstance(found, dict):
            found, their = {"observation": found}, {"observation": their}
        pairs: Values = {f"{what}": (found[what][0], their[what]) for what in found}
        table = ours.scenes.vehicles[0, ours.scenes.order["place"][0]]
        vehicles = [each for each in table if each["kind"] > OBSTACLE]
        if len(vehicles) != len(stock.road.vehicles):
            return {"number of vehicles": (len(vehicles), len(stock.road.vehicles))}
        pairs |= values_of(vehicles, stock.road.vehicles, self._names)
        if decision is not None:
            _, reward, terminated, truncated, info = self._expected
            if ours.is_split:
                reward, terminated = stock._reward(None), stock._is_terminated()
            pairs["reward"] = decision.rewards[0], reward
            for term, value in zip(ours.task.terms, decision.terms[0], strict=True):
                pairs[term] = value, info["rewards"][term]
            pairs["terminated"] = decision.terminated[0], terminated
            pairs["truncated"] = decision.truncated[0], truncated
            for name, value in ours.task.information(ours.scenes).items():
                pairs[name] = value[0], info[name]
        return pairs


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
        action = actions.names.index("IDLE" if rng.random() < _IDLE_PROBABILITY else str(name))
    return action


def _steering(vehicle: Any) -> float:
    """A steering angle towards the middle of the lane, rad."""
    s, r = vehicle.lane.local_coordinates(vehicle.position)
    ahead = vehicle.lane.heading_at(s + max(vehicle.speed, 1.0) * _LOOK_AHEAD_S)
    turn = (ahead - vehicle.heading + np.pi) % (2 * np.pi) - np.pi
    return float(np.clip(turn - 0.1 * r, -1, 1))


def values_of(ours: Sequence[Any], stock: Sequence[Any], names: list[Any]) -> Values:
    """What is compared of the vehicles of a road."""
    pairs: Values = {}
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


def route_of(vehicle: Any, names: list[Any]) -> list[Any]:
    """A vehicle's route as highway-env writes it."""
    steps = range(int(vehicle["route_step"]), int(vehicle["route_end"]))
    numbers = [int(vehicle["route_numbers"][k]) for k in steps]
    roads = [names[vehicle["route_roads"][k]][:2] for k in steps]
    return [(*road, None if k < 0 else k) for road, k in zip(roads, numbers, strict=True)]

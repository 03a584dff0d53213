"""Reads from this project's roads what the golden traces have of highway-env's."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from recorded_traces import Floats, Traces, canonical

from charms_bench.foundation.maths import sin_cos
from charms_bench.roads.episodes import Episodes, Seen
from charms_bench.roads.scenes import COMMANDED, DYNAMICAL, IDM, OBSTACLE, ROUTE_STEPS
from charms_bench.world.road import closest_lane

_NAMES = {"yielding": "is_yielding", "timer": "timer_s"}
"""The columns of `scenes.VEHICLE` that have another name than the quantity."""
_COLUMNS = (
    *("x", "y", "heading", "speed", "acceleration", "steering", "lane", "crashed", "yielding"),
    *("target_speed", "target_lane", "timer", "exponent"),
    *("speed_index", "lateral_speed", "yaw_rate"),
)
_FROM_KIND = {"target_speed": COMMANDED, "target_lane": COMMANDED, "timer": IDM, "exponent": IDM}
"""Quantities that vehicles of lower kinds do not have."""
_OF_KIND = {"speed_index": COMMANDED, "lateral_speed": DYNAMICAL, "yaw_rate": DYNAMICAL}
"""Quantities that vehicles of other kinds do not have."""


class Roads:
    """Episodes of the configuration of some traces; see `comparison.Replayed`."""

    def __init__(self, traces: Traces, count: int, config: dict[str, Any]) -> None:
        self._episodes = Episodes(traces.name, count, config)
        task = self._episodes.task
        self._terms, self._infos = [task.terms.index(name) for name in traces.terms], traces.infos
        self._counts_time = not traces.name.startswith("lane-keeping")  # only ours counts there

    def start(self, seeds: NDArray[np.uint64]) -> list[dict[str, Floats]]:
        """Starts all episodes; returns the frame of each."""
        episodes = self._episodes
        episodes.seed(episodes.everyone, seeds)
        episodes.start(episodes.everyone)
        return self._frames(episodes.everyone, episodes.observe())

    def start_again(self, row: int) -> dict[str, Floats]:
        """Starts an episode with the random generator as it is; returns its frame."""
        rows = np.array([row])
        self._episodes.start(rows)
        return self._frames(rows, self._episodes.observe(rows))[0]

    def step(self, actions: NDArray[Any]) -> list[dict[str, Floats]]:
        """Carries out the actions (B, agents, ...) of a decision; returns the frame of each."""
        episodes = self._episodes
        parts = tuple(actions.swapaxes(0, 1))
        decision = episodes.step(parts if episodes.has_agents else parts[0])
        frames = self._frames(episodes.everyone, decision.observations)
        found = {"speed": episodes.scenes.vehicles["speed"][:, 0]}
        found["crashed"] = episodes.scenes.vehicles["crashed"][:, 0]
        found |= episodes.task.information(episodes.scenes)
        for b, frame in enumerate(frames):
            reward, end = decision.rewards[b], decision.terminated[b]
            rewards, ends = reward, end
            if episodes.is_split:
                rewards, ends = found["agents_rewards"][b], found["agents_terminated"][b]
            frame["reward"] = canonical(np.append(rewards, reward))
            frame["ended"] = canonical(np.append(ends, (end, decision.truncated[b])))
            frame["terms"] = canonical(decision.terms[b, self._terms])
            infos = [np.ravel(found[name][b]) for name in self._infos]
            frame["info"] = canonical(np.concatenate([*infos, np.zeros(0)]))
        return frames

    def place(self, row: int, placed: Mapping[str, float]) -> None:
        """Moves a vehicle; see `Episode.placed`."""
        scenes = self._episodes.scenes
        number = int(scenes.order["place"][row, int(placed["vehicle"])])
        vehicle, where = scenes.vehicles[row, number], (placed["x"], placed["y"], placed["heading"])
        vehicle["x"], vehicle["y"], vehicle["heading"] = where
        vehicle["direction_y"], vehicle["direction_x"] = sin_cos(placed["heading"])
        vehicle["speed"] = placed["speed"]
        vehicle["lane"] = vehicle["target_lane"] = closest_lane(scenes.road, *where)

    def words(self) -> NDArray[np.uint64]:
        """[B, 6] the states of the random generators."""
        return self._episodes.scenes.generator

    def _frames(self, rows: NDArray[Any], seen: Seen) -> list[dict[str, Floats]]:
        scenes = self._episodes.scenes
        table = scenes.vehicles[rows[:, None], scenes.order["place"][rows]]
        values = _quantities(table, bool(scenes.constants["is_linear"][0]))
        objects = canonical(
            np.stack([values[name] for name in ("x", "y", "heading", "crashed")], 2)
        )
        kinds, routes = table["kind"], _routes(table)
        frames = []
        for b, row in enumerate(rows):
            is_vehicle = kinds[b] > OBSTACLE
            frame = {name: each[b][is_vehicle] for name, each in values.items()}
            frame["route"] = routes[b][is_vehicle]
            frame["route"] = frame["route"][~np.isnan(frame["route"])]
            frame["objects"] = objects[b][(kinds[b] > 0) & ~is_vehicle]
            frame["vehicles"] = np.array([len(frame["x"])], dtype=np.float64)
            frame["time"] = scenes.time[[row]] * self._counts_time
            frame["observation"] = canonical(np.concatenate(_observed(seen, b)))
            frame |= dict.fromkeys(("reward", "terms", "ended", "info"), np.zeros(0))
            frames.append(frame)
        return frames


def _quantities(table: NDArray[Any], is_linear: bool) -> dict[str, Floats]:
    """The quantities (B, N, ...) of vehicles that are not lists."""
    kinds = table["kind"]
    values = {name: table[_NAMES.get(name, name)].astype(np.float64) for name in _COLUMNS}
    for name, kind in _FROM_KIND.items():
        values[name][kinds < kind] = np.nan
    for name, kind in _OF_KIND.items():
        values[name][kinds != kind] = np.nan
    has_gains = (kinds == IDM)[..., None] & is_linear
    values["gains"] = np.where(has_gains, table["gains"], np.nan)
    impact = np.stack((table["impact_x"], table["impact_y"]), axis=-1)
    values["impact"] = np.where(table["has_impact"][..., None], impact, np.nan)
    values["size"] = np.stack((table["length"], table["width"]), axis=-1)
    return {name: canonical(each) for name, each in values.items()}


def _routes(table: NDArray[Any]) -> Floats:
    """[B, N, 1 + 2 ROUTE_STEPS] the routes, filled up with not-a-numbers between the numbers."""
    step, steps = np.arange(ROUTE_STEPS), table["route_end"] - table["route_step"]
    routes = np.full((*table.shape, 1 + 2 * ROUTE_STEPS), np.nan)
    routes[..., 0] = np.where(table["kind"] >= COMMANDED, steps, 0)
    is_ahead = (step >= table["route_step"][..., None]) & (step < table["route_end"][..., None])
    routes[..., 1::2] = np.where(is_ahead, table["route_roads"], np.nan)
    routes[..., 2::2] = np.where(is_ahead, table["route_numbers"], np.nan)
    return routes


def _observed(seen: Any, row: int) -> list[Any]:
    """The parts of an observation, flat."""
    parts = seen if isinstance(seen, tuple) else (seen,)
    parts = [p for part in parts for p in (part.values() if isinstance(part, dict) else (part,))]
    return [np.ravel(part[row]) for part in parts]

"""Records golden traces of straight roads: `python record_straight.py [SCENE ...]`.

The scenes and constants are those of the profiles `highway-env` and `charms`. The traffic is
highway-env's `IDMVehicle`; the ego is one too, obeys random meta-actions, or is given accelerations
and steering angles. highway-env computes with portable mathematics; see `portable_mathematics`.
"""

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from counted_events import count_events, counts, note
from highway_env.envs.common.action import ContinuousAction
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.kinematics import Vehicle
from portable_mathematics import ENVIRONMENT, restart_with, use_portable_mathematics
from record import quantities_of, words_of
from recorded_traces import (
    OF_STRAIGHT_ROADS,
    Episode,
    Frame,
    Traces,
    canonical,
    hash_of,
    keep_values_of_one,
    together,
)

SIMULATION_HZ, DURATION_S = 15, 20.0
ACTIONS = "LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER"
EGOS = "idm", "meta", "continuous"


@dataclass(frozen=True)
class Scene:
    """A kind of scene; vehicles spawn 1 / density apart, and the ego is one of the first."""

    profile: str
    lanes: int
    vehicles: int
    density: float
    decision_hz: int = 3
    holds: bool = False
    """Whether the ego's steering and acceleration are computed once per decision only."""
    decisions: int = 12
    """Most episodes are recorded for so many decisions only."""


CHARMS = {
    "KP_A": 1 / 0.8,
    "KP_HEADING": 1 / 0.5,
    "KP_LATERAL": 1 / 1.5,
    "MIN_SPEED": 22.0,
    "MAX_SPEED": 33.0,
    "DELTA_SPEED": 1.0,
    "TIME_WANTED": 1.0,
}
"""What highway-env's classes have in the profile `charms`."""
SPEED_LIMITS = {"charms": 33.0, "highway-env": 30.0}
EGO_SPEEDS = {"charms": 30.0, "highway-env": 25.0}
EGO_SLOTS = {"charms": 6, "highway-env": 1}
EGO_SPACING = {"charms": None, "highway-env": 2.0}
SCENES = {
    "charms-3": Scene("charms", 3, 21, 1.0, holds=True),
    "charms-2": Scene("charms", 2, 13, 2.0, holds=True),
    "charms-4": Scene("charms", 4, 31, 3.0, holds=True, decisions=8),
    "charms-every-step": Scene("charms", 3, 21, 1.5),
    "charms-5": Scene("charms", 5, 60, 2.0, holds=True, decisions=4),
    "highway-env-3": Scene("highway-env", 3, 21, 1.0),
    "highway-env-dense": Scene("highway-env", 3, 16, 3.0),
    "highway-env-5": Scene("highway-env", 5, 41, 1.5, decisions=6),
    "highway-env-2": Scene("highway-env", 2, 6, 0.5, decision_hz=1),
}
EPISODES, LONG = 20, 3
"""Of each scene and ego, and how many of them are recorded until their end."""


class RelativeMetaVehicle(ControlledVehicle):
    """Obeys meta-actions: lane commands count from its lane, and target speeds have a range."""

    target_lane_index: Any
    target_speed: float

    def act(self, action: Any = None) -> None:
        start = self.target_lane_index
        if action in ("LANE_LEFT", "LANE_RIGHT"):
            self.target_lane_index = self.lane_index
            lanes = len(self.road.network.all_side_lanes(self.lane_index))
            edge = 0 if action == "LANE_LEFT" else lanes - 1
            super().act(action)
            if self.target_lane_index == self.lane_index and self.lane_index[2] != edge:
                self.target_lane_index = start  # out of reach, so the command has no effect
            return
        super().act(action)
        if action in ("FASTER", "SLOWER"):
            self.target_speed = float(np.clip(self.target_speed, 22.0, 33.0))


def traces_of(name: str) -> Traces:
    """Simulates the episodes of a scene, 20 for each kind of ego."""
    scene, start, episodes = SCENES[name], counts.copy(), []
    for ego in EGOS:
        for seed in range(EPISODES):
            episodes.append(_episode(scene, ego, seed))
    keep_values_of_one(episodes)
    events = {event: int(number - start[event]) for event, number in counts.items()}
    return Traces(name, episodes, events=events, quantities=OF_STRAIGHT_ROADS)


def _episode(scene: Scene, kind: str, seed: int) -> Episode:
    road, ego, vehicles = _spawned(scene, kind, np.random.default_rng(seed))
    rng, frames, words = np.random.default_rng([seed, 6]), [], []
    given, has_time = _given(scene, kind, seed, rng), True
    frames.append(_frame(vehicles, ego, [0, 0]))
    words.append(words_of(road.np_random))
    most = len(given) if seed < LONG else scene.decisions
    while has_time and len(frames) <= min(most, len(given)):
        action = given[len(frames) - 1]
        for step in range(SIMULATION_HZ // scene.decision_hz):
            if step == 0 and kind == "meta":
                vehicles[ego].act(ACTIONS[action[0]])
            if step == 0 and kind == "continuous":
                vehicles[ego].act(ContinuousAction(None).get_action(action[0]))
            for vehicle in vehicles:
                if vehicle is not vehicles[ego] or step == 0 or not scene.holds:
                    vehicle.act()
            road.step(1 / SIMULATION_HZ)
        has_time = len(frames) < len(given)
        failed = vehicles[ego].crashed or (scene.profile == "charms" and not vehicles[ego].on_road)
        frames.append(_frame(vehicles, ego, [failed, not (has_time or failed)]))
        words.append(words_of(road.np_random))
        note(road)
        if failed:
            break
    hashes = [[hash_of(canonical(frame[name])) for name in OF_STRAIGHT_ROADS] for frame in frames]
    values = {name: together(frames, name) for name in OF_STRAIGHT_ROADS}
    of_frames = np.array(hashes, np.uint32), np.array(words, np.uint64)
    config = {
        "profile": scene.profile,
        "lanes": scene.lanes,
        "vehicles": scene.vehicles,
        "density": scene.density,
        "decision_hz": scene.decision_hz,
        "holds": scene.holds,
        "ego": kind,
    }
    return Episode(seed, config, given[: len(frames) - 1], *of_frames, values)


def _given(scene: Scene, kind: str, seed: int, rng: np.random.Generator) -> Any:
    """The ego's actions (T, 1) or (T, 1, 2) until the end of an episode.

    Some continuous ones are of float32, with which highway-env computes other bits.
    """
    count, passed = 0, 0.0
    while passed < DURATION_S:
        count, passed = count + 1, passed + 1 / scene.decision_hz
    if scene.profile == "charms":
        count = round(DURATION_S * scene.decision_hz)
    if kind == "idm":
        return np.zeros((count, 1), dtype=np.int64)
    if kind == "meta":
        return rng.integers(len(ACTIONS), size=(count, 1))
    size = np.array([1.0, 10 ** rng.uniform(-3, 0)])
    mean, spread = rng.uniform(-1, 1, 2), rng.uniform(0, 1, 2)
    controls = np.clip(size * (mean + spread * rng.normal(size=(count, 1, 2))), -1, 1)
    return controls.astype(np.float32 if seed >= EPISODES // 2 else np.float64)


def _spawned(scene: Scene, kind: str, rng: np.random.Generator) -> tuple[Road, int, list[Any]]:
    """A road, the index of the ego, and the vehicles [`HighwayEnv._create_vehicles`]."""
    network, profile = RoadNetwork(), scene.profile
    for lane in range(scene.lanes):
        ends = np.array([[0.0, lane * 4.0], [10_000.0, lane * 4.0]])
        network.add_lane("0", "1", StraightLane(*ends, speed_limit=SPEED_LIMITS[profile]))
    commanded = RelativeMetaVehicle if profile == "charms" else MDPVehicle
    classes = {"idm": IDMVehicle, "meta": commanded, "continuous": Vehicle}
    road = Road(network=network, np_random=rng)
    ego = int(rng.integers(0, EGO_SLOTS[profile]))
    for k in range(scene.vehicles):
        own = classes[kind] if k == ego else IDMVehicle
        own = type(own.__name__, (own,), CHARMS if profile == "charms" else {})
        spacing = (EGO_SPACING[profile] if k == ego else None) or 1 / scene.density
        speed = EGO_SPEEDS[profile] if k == ego else None
        road.vehicles.append(own.create_random(road, speed=speed, spacing=spacing))
        if k != ego:
            road.vehicles[k].randomize_behavior()
    share = rng.random()  # drawn for every ego
    if kind == "idm":
        low, high = IDMVehicle.DELTA_RANGE
        road.vehicles[ego].DELTA = low + (high - low) * share
    return road, ego, road.vehicles


def _frame(vehicles: list[Any], ego: int, ended: list[Any]) -> Frame:
    lanes = {("0", "1", lane): lane for lane in range(8)}
    each = [quantities_of(vehicle, lanes) for vehicle in vehicles]
    frame = {name: np.array([one[name] for one in each]) for name in OF_STRAIGHT_ROADS[:-2]}
    return {**frame, "ego": np.array([ego]), "ended": np.array(ended)}


if __name__ == "__main__":
    restart_with(ENVIRONMENT)
    use_portable_mathematics()
    count_events()
    for name in sys.argv[1:] or SCENES:
        path = Path(__file__).with_name(f"straight-{name}.npz")
        if path.exists():
            continue
        start = time.process_time()
        found = traces_of(name)
        found.write(path)
        decisions = sum(each.decisions for each in found.episodes)
        print(
            f"{name}: {time.process_time() - start:.0f} s, {decisions} decisions, "
            f"{path.stat().st_size / 1000:.0f} kB",
            flush=True,
        )

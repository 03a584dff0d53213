"""Records golden traces of highway-env's environments: `python record.py [ID ...]`.

Writes a file for each environment, unless there is one. highway-env computes with portable
mathematics; see `portable_mathematics`. No code of this project but that mathematics takes part.
"""

import copy
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from counted_events import count_events, counts, note
from drawn_configurations import configurations
from portable_mathematics import (
    ENVIRONMENT,
    restart_with,
    unchanged_idm,
    use_portable_mathematics,
)
from recorded_traces import (
    QUANTITIES,
    Episode,
    Frame,
    Traces,
    canonical,
    hash_of,
    keep_values_of_one,
    together,
)

IDS = (
    *("highway-v0", "highway-fast-v0", "merge-v0", "merge-v1"),
    *("merge-generic-v0", "merge-generic-v1", "two-way-v0", "exit-v0", "exit-v1"),
    *("u-turn-v0", "u-turn-v1", "roundabout-v0", "roundabout-v1"),
    *("roundabout-generic-v0", "roundabout-generic-v1", "racetrack-v0", "racetrack-v1"),
    *("racetrack-large-v0", "racetrack-large-v1", "racetrack-oval-v0", "racetrack-oval-v1"),
    *("parking-v0", "parking-ActionRepeat-v0", "parking-parked-v0", "lane-keeping-v0"),
    *("intersection-v0", "intersection-v1", "intersection-v2"),
    *(f"intersection-multi-agent-v{version}" for version in range(3)),
)
EPISODES = 20
"""In the default configuration, and as many in other configurations."""
MOST_DECISIONS, MOST_OF_LONG = 30, 120
LONG = 1
"""The first episodes of each half are recorded until they end, or for `MOST_OF_LONG` decisions."""
FEWER = {"highway-v0": (12, 40)}
"""Smaller numbers of decisions for environments that take long to simulate."""
PLACED: dict[str, list[list[dict[str, float]]]] = {
    "merge-v0": [
        [  # three vehicles overlap
            {"vehicle": 1, "x": 100.0, "y": 0.0, "heading": 0.0, "speed": 20.0},
            {"vehicle": 2, "x": 104.0, "y": 0.5, "heading": 0.1, "speed": 20.0},
            {"vehicle": 3, "x": 102.0, "y": 1.8, "heading": -0.1, "speed": 19.0},
        ],
        [  # two vehicles are as far along a lane, in front of one and behind another one
            {"vehicle": 1, "x": 100.0, "y": 1.5, "heading": 0.0, "speed": 20.0},
            {"vehicle": 2, "x": 100.0, "y": 4.0, "heading": 0.0, "speed": 30.0},
            {"vehicle": 3, "x": 75.0, "y": 4.0, "heading": 0.0, "speed": 25.0},
            {"vehicle": 4, "x": 140.0, "y": 0.0, "heading": 0.0, "speed": 15.0},
        ],
        [  # the same in the other order
            {"vehicle": 1, "x": 100.0, "y": 4.0, "heading": 0.0, "speed": 30.0},
            {"vehicle": 2, "x": 100.0, "y": 1.5, "heading": 0.0, "speed": 20.0},
            {"vehicle": 3, "x": 75.0, "y": 4.0, "heading": 0.0, "speed": 25.0},
            {"vehicle": 4, "x": 140.0, "y": 0.0, "heading": 0.0, "speed": 15.0},
        ],
        [  # a vehicle hits the obstacle at the end of the ramp
            {"vehicle": 4, "x": 300.0, "y": 8.0, "heading": 0.0, "speed": 25.0},
        ],
    ]
}
"""Vehicles that are moved after the start, for events that do not occur otherwise."""


def traces_of(name: str) -> Traces:
    """Simulates the episodes of an environment."""
    with unchanged_idm():
        env: Any = gymnasium.make(name, disable_env_checker=True)
    default, found = copy.deepcopy(env.unwrapped.config), Traces(name, [])
    drawn = enumerate(configurations(name, EPISODES))
    cases: list[tuple[int, dict[str, Any], list[dict[str, float]]]] = [
        *((seed, {}, []) for seed in range(EPISODES)),
        *((100 + k, config, []) for k, config in drawn),
        *((200 + k, {}, placed) for k, placed in enumerate(PLACED.get(name, []))),
    ]
    found.events = dict.fromkeys(counts, 0)
    for seed, config, placed in cases:
        most = FEWER.get(name, (MOST_DECISIONS, MOST_OF_LONG))[seed % 100 < LONG]
        env.unwrapped.config = copy.deepcopy(default)
        with unchanged_idm():
            env.reset(seed=seed, options={"config": copy.deepcopy(config)})
            start = counts.copy()
            found.episodes.append(_episode(env, seed, config, placed, most, found))
        for event, number in counts.items():
            found.events[event] += int(number - start[event])
    keep_values_of_one(found.episodes[:EPISODES])
    keep_values_of_one(found.episodes[EPISODES:])
    return found


def _episode(
    env: Any,
    seed: int,
    config: dict[str, Any],
    placed: list[dict[str, float]],
    most: int,
    traces: Traces,
) -> Episode:
    """An episode with random actions if the seed is even; if not, most keep the lane and speed."""
    rng, is_random = np.random.default_rng([seed, 6]), seed % 2 == 0
    base = env.unwrapped
    observation, _ = env.reset(seed=seed)
    lanes = {index: k for k, index in enumerate(base.road.network.lanes_dict())}
    frames, words, given = [frame_of(base, lanes, observation)], [words_of(base.np_random)], []
    for each in placed:
        _place(base.road.vehicles[each["vehicle"]], each)
    note(base.road)
    while len(given) < most:
        actions = tuple(actions_of(base, rng, is_random))
        given.append(np.stack(actions))
        has_agents = hasattr(base.action_type, "agents_action_types")
        action = actions if has_agents else actions[0]
        observation, *outcome = env.step(action)
        frame = frame_of(base, lanes, observation)
        frames.append({**frame, **_outcome(base, action, outcome, traces)})
        words.append(words_of(base.np_random))
        note(base.road)
        if np.all(outcome[1]) or outcome[2]:
            break
    observation, _ = env.reset()
    lanes = {index: k for k, index in enumerate(base.road.network.lanes_dict())}
    frames.append(frame_of(base, lanes, observation))
    words.append(words_of(base.np_random))
    hashes = [[hash_of(canonical(frame[name])) for name in QUANTITIES] for frame in frames]
    values = {name: together(frames, name) for name in QUANTITIES}
    of_frames = np.array(hashes, np.uint32), np.array(words, np.uint64)
    return Episode(seed, config, np.array(given), *of_frames, values, placed)


def _place(vehicle: Any, given: dict[str, float]) -> None:
    """Moves a vehicle and has it stay on the lane where it is then."""
    vehicle.position = np.array([given["x"], given["y"]])
    vehicle.heading, vehicle.speed = given["heading"], given["speed"]
    vehicle.on_state_update()
    vehicle.target_lane_index = vehicle.lane_index


def actions_of(env: Any, rng: np.random.Generator, is_random: bool) -> Iterator[Any]:
    """An action for each agent."""
    kinds = getattr(env.action_type, "agents_action_types", [env.action_type])
    for kind, vehicle in zip(kinds, env.controlled_vehicles, strict=False):
        space = kind.space()
        if isinstance(space, gymnasium.spaces.Box):
            controls = rng.uniform(-1, 1, space.shape).astype(np.float32)
            if not is_random:
                controls *= np.float32(0.1)
                controls[-1] += np.float32(_steering(vehicle))
            yield controls
            continue
        action, names = int(rng.integers(space.n)), getattr(kind, "actions_indexes", {})
        if not is_random and "FASTER" in names:
            name = str(rng.choice(("FASTER", "SLOWER")))
            action = names["IDLE" if rng.random() < 0.8 else name]
        yield action


def _steering(vehicle: Any) -> float:
    """A steering angle towards the middle of the lane, rad."""
    s, r = vehicle.lane.local_coordinates(vehicle.position)
    ahead = vehicle.lane.heading_at(s + max(vehicle.speed, 1.0) * 0.3)
    turn = (ahead - vehicle.heading + np.pi) % (2 * np.pi) - np.pi
    return float(np.clip(turn - 0.1 * r, -1, 1))


def frame_of(env: Any, lanes: dict[Any, int], observation: Any) -> Frame:
    """What can be seen of an environment after a reset or a decision."""
    each = [quantities_of(vehicle, lanes) for vehicle in env.road.vehicles]
    frame = {name: np.array([one[name] for one in each]) for name in each[0] if name != "route"}
    frame["route"] = np.array([number for one in each for number in one["route"]])
    frame["vehicles"] = np.array([len(each)])
    objects = [[*one.position, one.heading, one.crashed] for one in env.road.objects]
    frame["objects"] = np.array(objects, dtype=np.float64)
    frame["time"] = np.array([env.time])
    frame["observation"] = np.array(list(_numbers(observation)))
    return frame | dict.fromkeys(("reward", "terms", "ended", "info"), np.zeros(0))


def _outcome(env: Any, action: Any, outcome: list[Any], traces: Traces) -> Frame:
    """The rest of a frame after a decision."""
    reward, terminated, truncated, info = outcome
    terms = info.get("rewards", {})
    infos = {name: info[name] for name in sorted(info) if name not in ("rewards", "action")}
    traces.terms, traces.infos = list(terms), list(infos)
    # A wrapper can give each agent its own reward and ending instead of these.
    return {
        "reward": np.array([*_numbers(reward), env._reward(action)]),
        "ended": np.array([*_numbers(terminated), env._is_terminated(), truncated]),
        "terms": np.array(list(_numbers(terms))),
        "info": np.array(list(_numbers(infos))),
    }


def quantities_of(vehicle: Any, lanes: dict[Any, int]) -> dict[str, Any]:
    """The quantities of a vehicle; see `recorded_traces.OF_VEHICLES`."""
    names = ("heading", "speed", "target_speed", "lateral_speed", "yaw_rate", "speed_index")
    found = {name: getattr(vehicle, name, np.nan) for name in (*names, "timer", "crashed")}
    found["x"], found["y"] = vehicle.position
    found |= {name: vehicle.action[name] for name in ("acceleration", "steering")}
    target = getattr(vehicle, "target_lane_index", None)
    found["lane"] = lanes[vehicle.lane_index]
    found["target_lane"] = np.nan if target is None else lanes[target]
    found["yielding"] = getattr(vehicle, "is_yielding", False)
    found["exponent"] = vehicle.DELTA if hasattr(vehicle, "timer") else np.nan
    gains = np.full(5, np.nan)
    if hasattr(vehicle, "STEERING_PARAMETERS"):
        gains[:3], gains[3:] = vehicle.ACCELERATION_PARAMETERS, vehicle.STEERING_PARAMETERS
    found["gains"] = gains
    found["impact"] = np.full(2, np.nan) if vehicle.impact is None else vehicle.impact
    found["size"] = vehicle.LENGTH, vehicle.WIDTH
    steps = getattr(vehicle, "route", None) or ()
    pairs = [(lanes[*step[:2], 0], -1 if step[2] is None else step[2]) for step in steps]
    found["route"] = [len(steps), *(number for pair in pairs for number in pair)]
    return found


def _numbers(value: Any) -> Iterator[float]:
    """The numbers in nested values, dictionaries in their own order."""
    if isinstance(value, dict):
        value = tuple(value.values())
    if isinstance(value, (tuple, list)):
        for each in value:
            yield from _numbers(each)
    else:
        yield from np.asarray(value, dtype=np.float64).ravel().tolist()


def words_of(generator: np.random.Generator) -> list[int]:
    """The state of a random generator; see `Episode.words`."""
    found: Any = generator.bit_generator.state
    words = (divmod(found["state"][part], 2**64) for part in ("state", "inc"))
    return [*(word for pair in words for word in pair), found["uinteger"], found["has_uint32"]]


if __name__ == "__main__":
    restart_with(ENVIRONMENT)
    use_portable_mathematics()
    count_events()
    for name in sys.argv[1:] or IDS:
        path = Path(__file__).with_name(f"{name}.npz")
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

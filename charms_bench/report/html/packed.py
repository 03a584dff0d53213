"""Packs a replay for a page: rounded to integers, as differences over time, compressed.

Every quantity is rounded to a unit too small to be seen (1 cm, 1 mrad, 10 ms), so its differences
from step to step are small integers, which compress well.
"""

import zlib
from base64 import b64encode
from typing import Any

import numpy as np

from charms_bench.episodes.ego_view import EgoView, ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.foundation.names import shown_agent
from charms_bench.world.picture import BRAKE_LIGHT_MPS2
from charms_bench.world.scene import Bools, Floats, Ints

CRASHED, BRAKES, LEFT, RIGHT = 1, 2, 4, 8
"""Bits of a vehicle's `flags`; LEFT and RIGHT mean that it is changing lanes to that side."""
NONE = -1
"""Written where a quantity that is never negative is not defined."""
_CHANGING = 0.2
"""Distance from its target lane, in lane widths, above which a vehicle is changing lanes."""


def pack(replay: Replay, view: EgoView, ghosts: Replay | None = None) -> dict[str, Any]:
    """A replay for JSON, and another future of the same vehicles, which is drawn as ghosts.

    vehicles, frames, hz, lanes, lane_m, ego: Plain numbers.
    reach_m: How far ahead of the ego the road is to be seen.
    length_m, width_m: Of each vehicle.
    agents: The agents' names, the ego's first.
    agent: For each vehicle, the index of its agent in `agents`.
    columns: Name, unit and width (vehicles, or 1) of each quantity, in the order of `data`.
    data: base64 of deflated little-endian int32, [frames, width] for each quantity, each row minus
        the row before it.
    ghosts: Frames, columns and data of the other future, or null.
    """
    profile, ego = replay.settings.profile, replay.ego
    views = [view] if ghosts is None else [view, ego_view(ghosts)]
    vehicles = replay.x.shape[1]
    agents = list(dict.fromkeys([replay.agents[ego], *sorted(replay.agents)]))
    columns: dict[str, tuple[float, Floats | Ints]] = {
        **_of_vehicles(replay),
        "speed": (0.01, replay.speed[:, ego]),
        "acceleration": (0.01, replay.acceleration[:, ego]),
        "action": (1, np.where(replay.has_action[:, ego], replay.action[:, ego], -1)),
        "lane": (1, replay.lane[:, ego]),
        "target": (1, replay.target_lane[:, ego]),
        "ahead": (0.01, view.gap_ahead),
        "behind": (0.01, view.gap_behind),
        "ttc": (0.01, view.ttc),
        "reward": (0.001, view.reward),
    }
    return {
        "vehicles": vehicles,
        "hz": replay.settings.simulation_hz,
        "lanes": replay.settings.lanes,
        "lane_m": profile.lane_width_m,
        "reach_m": round(max(each.reach_m for each in views), 1),
        "length_m": replay.length[0].tolist(),
        "width_m": replay.width[0].tolist(),
        "ego": ego,
        "agents": [shown_agent(name) for name in agents],
        "agent": [agents.index(name) for name in replay.agents],
        "actions": [action.replace("_", " ").lower() for action in replay.action_names],
        **_packed(columns),
        "ghosts": None if ghosts is None else _packed(_of_vehicles(ghosts)),
    }


def _of_vehicles(replay: Replay) -> dict[str, tuple[float, Floats | Ints]]:
    """The unit and the values [frames, vehicles] of what is drawn of every vehicle."""
    return {
        "x": (0.01, replay.x),
        "y": (0.01, replay.y),
        "heading": (0.001, replay.heading),
        "flags": (1, _flags(replay)),
    }


def _packed(columns: dict[str, tuple[float, Floats | Ints]]) -> dict[str, Any]:
    whole = [_differences(values, unit) for unit, values in columns.values()]
    data = b"".join(part.astype("<i4").tobytes() for part in whole)
    return {
        "frames": len(whole[0]),
        "columns": [
            [name, unit, part.shape[1]]
            for (name, (unit, _)), part in zip(columns.items(), whole, strict=True)
        ],
        "data": b64encode(zlib.compress(data, 9)).decode(),
    }


def _differences(values: Floats | Ints, unit: float) -> Ints:
    """[frames, width] integers, each row minus the row before it."""
    rounded = np.round(values.astype(np.float64) / unit)
    whole = np.nan_to_num(rounded, nan=NONE).astype(np.int64).reshape(len(values), -1)
    return np.diff(whole, axis=0, prepend=0)


def _flags(replay: Replay) -> Ints:
    width = replay.settings.profile.lane_width_m
    aim = replay.target_lane * width - replay.y
    changing: Bools = (np.abs(aim) > _CHANGING * width) & ~replay.crashed
    lights = BRAKES * (replay.acceleration < -BRAKE_LIGHT_MPS2)
    sides = LEFT * (changing & (aim < 0)) + RIGHT * (changing & (aim > 0))
    return np.asarray(CRASHED * replay.crashed + lights + sides)

"""The format of the golden traces: hashes of what every episode was like after each decision.

A file has the episodes of one environment. An episode has F = D + 2 frames: its start, one after
each of its D decisions, and the start that a reset without a seed leads to; on straight roads, it
has F = D + 1 frames, because there are no resets. A frame has one value of
each quantity: a list of numbers, such as the x of all vehicles. Of each value, a file has a hash of
4 bytes; of the values of some episodes, all numbers too.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
OF_VEHICLES = (
    *("x", "y", "heading", "speed", "acceleration", "steering", "target_speed"),
    *("lateral_speed", "yaw_rate", "lane", "target_lane", "speed_index", "crashed", "yielding"),
    *("timer", "exponent", "gains", "impact", "size", "route"),
)
"""The quantities that have a number, or several, for each vehicle, in highway-env's order.

What a vehicle does not have is not a number. Lanes are indices in the order of `lanes_dict`. A
route is the number of its steps, then for each step the first lane of its road, and its number or
-1."""
QUANTITIES = (
    *("vehicles", *OF_VEHICLES, "objects", "time"),
    *("observation", "reward", "terms", "ended", "info"),
)
"""The last four have no numbers at the start of an episode."""
OF_STRAIGHT_ROADS = (
    *("x", "y", "heading", "speed", "acceleration", "steering", "target_speed"),
    *("lane", "target_lane", "crashed", "timer", "exponent", "impact", "ego", "ended"),
)
MOST_NUMBERS = 12_000
"""All numbers of an episode are written if there are at most so many."""
Frame = Mapping[str, Floats]
"""The value of each quantity, of any shape."""


def canonical(value: Any) -> Floats:
    """The numbers of a value with one zero and one not-a-number."""
    numbers = np.asarray(value, dtype="<f8") + 0.0  # -0.0 + 0.0 is 0.0
    return np.where(np.isnan(numbers), np.nan, numbers)


def hash_of(numbers: Floats) -> int:
    """The hash of canonical numbers."""
    return int.from_bytes(blake2b(numbers.tobytes(), digest_size=4).digest(), "little")


@dataclass
class Episode:
    """An episode and its frames."""

    seed: int
    config: dict[str, Any]
    actions: NDArray[Any]
    """(D, agents) indices, or (D, agents, axes) numbers."""
    hashes: NDArray[np.uint32]
    """[F, Q]"""
    words: NDArray[np.uint64]
    """[F, 6] the state of the random generator: the high and the low word of its state, the
    same of its increment, the half of a word that it has left, and whether it has one."""
    values: dict[str, Floats] = field(default_factory=dict)
    """[F, numbers] of each quantity, filled up with not-a-numbers; empty for most episodes."""
    placed: list[dict[str, float]] = field(default_factory=list)
    """Vehicles that are moved after the first frame: their number `vehicle` in highway-env's order,
    `x`, `y`, `heading` and `speed`. Their target lane is the lane where they are then."""

    @property
    def decisions(self) -> int:
        return len(self.actions)


@dataclass
class Traces:
    """The episodes of an environment or of a scene."""

    name: str
    episodes: list[Episode]
    terms: list[str] = field(default_factory=list)
    """The names of the numbers of the quantity `terms`."""
    infos: list[str] = field(default_factory=list)
    """The same of `info`."""
    events: dict[str, int] = field(default_factory=dict)
    """How often what occurred."""
    quantities: tuple[str, ...] = QUANTITIES

    def write(self, path: Path) -> None:
        heads, values = [], []
        for each in self.episodes:
            widths = {name: numbers.shape[1] for name, numbers in each.values.items()}
            values += [numbers.ravel() for numbers in each.values.values()]
            heads.append(
                {
                    "seed": each.seed,
                    "config": each.config,
                    "actions": [str(each.actions.dtype), *each.actions.shape],
                    "frames": len(each.hashes),
                    "widths": widths,
                    "placed": each.placed,
                }
            )
        head = {
            name: getattr(self, name) for name in ("name", "terms", "infos", "events", "quantities")
        }
        text = json.dumps({**head, "episodes": heads})
        np.savez_compressed(
            path,
            head=np.frombuffer(text.encode(), np.uint8),
            actions=np.concatenate([each.actions.ravel() for each in self.episodes], dtype="<f8"),
            hashes=np.concatenate([each.hashes for each in self.episodes]).T.astype("<u4"),
            words=np.concatenate([each.words for each in self.episodes]).T.astype("<u8"),
            values=np.concatenate([*values, np.zeros(0)]).astype("<f8"),
        )

    @classmethod
    def read(cls, path: Path) -> "Traces":
        with np.load(path, allow_pickle=False) as found:
            arrays = {name: found[name] for name in found.files}
        head = json.loads(arrays["head"].tobytes())
        hashes, words = _Parts(arrays["hashes"].T), _Parts(arrays["words"].T)
        actions, values = _Parts(arrays["actions"]), _Parts(arrays["values"])
        episodes = []
        for each in head.pop("episodes"):
            kind, *shape = each["actions"]
            frames = each["frames"]
            own = {
                name: values.take(frames * width).reshape(frames, width)
                for name, width in each["widths"].items()
            }
            given = actions.take(int(np.prod(shape))).reshape(shape).astype(kind)
            of_frames = hashes.take(frames), words.take(frames)
            seed, config, placed = each["seed"], each["config"], each["placed"]
            episodes.append(Episode(seed, config, given, *of_frames, own, placed))
        return cls(episodes=episodes, **{**head, "quantities": tuple(head["quantities"])})


class _Parts:
    """The rows of an array, taken one after the other."""

    def __init__(self, array: NDArray[Any]) -> None:
        self._rest = array

    def take(self, rows: int) -> NDArray[Any]:
        taken, self._rest = self._rest[:rows], self._rest[rows:]
        return taken


def together(frames: Sequence[Frame], name: str) -> Floats:
    """[F, numbers] a quantity of some frames, filled up with not-a-numbers."""
    each = [canonical(frame[name]).ravel() for frame in frames]
    found = np.full((len(each), max(map(len, each))), np.nan)
    for row, numbers in zip(found, each, strict=True):
        row[: len(numbers)] = numbers
    return found


def keep_values_of_one(episodes: Sequence[Episode]) -> None:
    """Keeps all numbers of the longest episode that is small enough, or of the smallest one."""
    sizes = [sum(numbers.size for numbers in each.values.values()) for each in episodes]
    fits = [size for size in sizes if size <= MOST_NUMBERS]
    kept = sizes.index(max(fits) if fits else min(sizes))
    for k, each in enumerate(episodes):
        if k != kept:
            each.values = {}

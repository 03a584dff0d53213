"""Shows a plugin the same scenes again and compares its answers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import BrokenWordError
from charms_bench.world.scene import ARRAYS, WRITABLE, Ints, Scene, Vehicles

ROUNDING = 1e-9
"""Largest relative difference of two answers, for plugins whose libraries add in another order when
there are fewer vehicles."""
Answers = Sequence[NDArray[Any]]
"""Arrays (M, ...)."""
Ask = Callable[[Scene, Vehicles], Answers]


@dataclass(frozen=True)
class SceneQuestion:
    """What a plugin was shown, and what it answered."""

    name: str
    """What was asked, for messages."""
    scene: Scene
    """A copy of the scenes; a driver model that is asked writes to it."""
    vehicles: Vehicles
    """M vehicles."""
    said: Answers
    """The answers; those for crashed vehicles do not matter."""

    def part(self, rows: Ints) -> "SceneQuestion":
        """The question about the scenes `rows` (R,) in this order, ready to be asked.

        What a driver model writes is a copy, and all other arrays cannot be written to.
        """
        successive = (
            rows.size and rows[-1] - rows[0] == rows.size - 1 and (np.diff(rows) == 1).all()
        )
        some: Any = slice(rows[0], rows[-1] + 1) if successive else rows
        arrays = {name: getattr(self.scene, name)[some] for name in ARRAYS}
        for each in arrays.values():
            each.flags.writeable = False
        arrays |= {name: arrays[name].copy() for name in WRITABLE}
        place = np.full(len(self.scene.active), -1)
        place[rows] = np.arange(rows.size)
        shown = place[self.vehicles[0]]
        index = np.argsort(shown, kind="stable")[np.count_nonzero(shown < 0) :]
        vehicles = shown[index].astype(self.vehicles[0].dtype), self.vehicles[1][index]
        said = [answer[index] for answer in self.said]
        return SceneQuestion(self.name, self.scene._replace(**arrays), vehicles, said)

    def halved(self, times: int) -> "SceneQuestion":
        """A copy of the question about some of the scenes; see `halved`."""
        rows = np.unique(self.vehicles[0])
        return self.part(rows[halved(rows.size, times)])

    def check(self, ask: Ask, how: str) -> None:
        """Asks again, once; raises a `BrokenWordError` that says `how` if an answer differs."""
        again = ask(self.scene, tuple(map(np.copy, self.vehicles)))
        for then, now in zip(self.said, again, strict=True):
            if now.shape != then.shape:
                raise BrokenWordError(f"{self.name} returned shape {now.shape} when {how}")
            if np.array_equal(then, now):
                continue
            wrong = ~self.scene.crashed[self.vehicles] & ~_close(then, now)
            if wrong.any():
                at = int(wrong.argmax())
                values = f"{then[at]}, and {now[at]}" if now.ndim == 1 else "other values"
                raise BrokenWordError(f"{self.name} returned {values} when {how}", at)


def some_of(indices: Ints, rng: np.random.Generator) -> Ints:
    """Half of the indices, in another order."""
    return rng.permutation(indices)[: max(1, indices.size // 2)]


def halved(size: int, times: int) -> Ints:
    """The indices of so many things, halved so many times, and never the same one alone twice."""
    return np.asarray((np.arange(max(1, size >> times)) + times) % size)


def copied(scene: Scene) -> Scene:
    """A copy of all arrays."""
    return scene._replace(**{name: getattr(scene, name).copy() for name in ARRAYS})


def check_scene(
    name: str, scene: Scene, before: Scene, vehicles: Vehicles, asked: Vehicles, writes: bool
) -> None:
    """Checks that a plugin changed nothing of what it was shown, which was `before` and `asked`.

    If it `writes`, it may change the arrays `WRITABLE` of its vehicles.
    """
    for array in ARRAYS:
        now, then = getattr(scene, array), getattr(before, array)
        if writes and array in WRITABLE:
            now, then = now.copy(), then.copy()
            now[asked] = then[asked] = 0.0
        if not np.array_equal(now, then, equal_nan=now.dtype.kind == "f"):
            raise BrokenWordError(f"{name} changed scene.{array}")
    if not all(map(np.array_equal, vehicles, asked)):
        raise BrokenWordError(f"{name} changed the indices that it was given")


def _close(one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether answers (M, ...) are equal but for rounding, (M,)."""
    if one.dtype.kind not in "fiu" or other.dtype.kind not in "fiu":
        return np.asarray(one == other)
    close = np.isclose(one, other, ROUNDING, ROUNDING, equal_nan=True)
    return np.asarray(close.reshape(len(one), -1).all(axis=1))

"""Shows a plugin the same scenes again and compares its answers."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import BrokenWordError
from charms_bench.world.scene import Ints, Scene, Vehicles

SCENES = 3
"""Most scenes that are shown again in another order; at least one is left out."""
ROUNDING = 1e-9
"""Largest relative difference of two answers, for plugins whose libraries add in another order when
there are fewer vehicles."""
_ARRAYS = tuple(name for name in Scene._fields if name != "constants")
Answers = Sequence[NDArray[Any]]
"""Arrays (M, ...)."""
Ask = Callable[[Scene, Vehicles], Answers]


@dataclass(frozen=True)
class SceneQuestion:
    """What a plugin was shown, and what it answered."""

    name: str
    """What was asked, for messages."""
    scene: Scene
    """A copy of the scenes, which must not be changed."""
    vehicles: Vehicles
    """M vehicles."""
    said: Answers
    """The answers; those for crashed vehicles do not matter."""

    def part(self, rows: Ints | None) -> tuple["SceneQuestion", Ints]:
        """The same about the scenes `rows` (R,) in this order; by default all.

        Returns:
            The question about K of the M vehicles, and their indices (K,) among the M.
        """
        if rows is None:
            vehicles = tuple(map(np.copy, self.vehicles))
            question = replace(self, scene=copied(self.scene), vehicles=vehicles)
            return question, np.arange(vehicles[0].size)
        arrays = {name: getattr(self.scene, name)[rows] for name in _ARRAYS}
        parts = [np.nonzero(self.vehicles[0] == row)[0] for row in rows]
        index = np.concatenate(parts)
        shown = np.repeat(np.arange(rows.size), [part.size for part in parts])
        vehicles = shown.astype(self.vehicles[0].dtype), self.vehicles[1][index]
        said = [answer[index] for answer in self.said]
        return SceneQuestion(self.name, self.scene._replace(**arrays), vehicles, said), index

    def check(self, ask: Ask, how: str, rows: Ints | None = None) -> None:
        """Asks again about some scenes; see `part`.

        Args:
            ask: Asks the plugin.
            how: In words, how it is asked.
            rows: The scenes.

        Raises:
            BrokenWordError: An answer differs.
        """
        part, index = self.part(rows)
        again = ask(part.scene.read_only(), part.vehicles)
        for then, now in zip(part.said, again, strict=True):
            if now.shape != then.shape:
                raise BrokenWordError(f"{self.name} returned shape {now.shape} when {how}")
            if np.array_equal(then, now):
                continue
            driven = ~self.scene.crashed[self.vehicles][index]
            wrong = driven & ~_close(then, now)
            if wrong.any():
                at = int(wrong.argmax())
                values = f"{then[at]}, and {now[at]}" if now.ndim == 1 else "other values"
                raise BrokenWordError(f"{self.name} returned {values} when {how}", int(index[at]))

    def check_order(self, ask: Ask, rng: np.random.Generator) -> "SceneQuestion":
        """Asks again about all scenes, about some in another order, and about one alone.

        Returns:
            The question about some of the scenes, to be asked later.

        Raises:
            BrokenWordError: An answer differs.
        """
        rows = np.unique(self.vehicles[0])
        some = rng.permutation(rows)[: max(1, min(SCENES, rows.size - 1))]
        self.check(ask, "asked again")
        self.check(ask, f"shown {some.size} of the scenes in another order", some)
        self.check(ask, "shown this scene alone", some[:1])
        return self.part(some)[0]


def copied(scene: Scene) -> Scene:
    """A copy of all arrays."""
    return scene._replace(**{name: getattr(scene, name).copy() for name in _ARRAYS})


def changed_array(scene: Scene, before: Scene, timers: Vehicles | None) -> str:
    """The first array that differs, but for the timers of some vehicles; empty if none does."""
    for name in _ARRAYS:
        now, then = getattr(scene, name), getattr(before, name)
        if name == "timer_s" and timers is not None:
            now, then = now.copy(), then.copy()
            now[timers] = then[timers] = 0.0
        if not (np.array_equal(now, then) or np.array_equal(now, then, equal_nan=True)):
            return name
    return ""


def _close(one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether answers (M, ...) are equal but for rounding, (M,)."""
    if one.dtype.kind not in "fiu" or other.dtype.kind not in "fiu":
        return np.asarray(one == other)
    close = np.isclose(one, other, ROUNDING, ROUNDING, equal_nan=True)
    return np.asarray(close.reshape(len(one), -1).all(axis=1))

"""Searches for a sequence of the ego's meta-actions that keeps it on the road and uncrashed.

The search is exhaustive: every sequence of the ego's meta-actions, in batches of restored scenes,
deepest first. A scene that equals one already visited at the same decision, to the last bit, is
left out, because it has the same futures.
"""

from hashlib import blake2b

import numpy as np

from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import ARRAYS, OF_SCENES, SceneState
from charms_bench.world.scene import Ints

_PLAYS_NO_PART = {*OF_SCENES, "action", "has_action", "drivers", "collision"} - {"network"}
_DECIDES = sorted({*ARRAYS} - _PLAYS_NO_PART)
"""The arrays by which the scenes of one episode at one decision may differ in what follows."""


class EscapeSearch:
    """Searches of one collision; what one search has ruled out, the next need not visit.

    Args:
        simulation: Scenes whose egos are driven from outside; as many as are simulated at once.
        until: The decision that the ego has to survive, counted from 1.
        budget: The most decisions to simulate in all searches.
    """

    def __init__(self, simulation: Simulation, until: int, budget: int) -> None:
        self._simulation = simulation
        self._actions = len(simulation.meta_actions[simulation.agents.index("")])
        self._until = until
        self._budget = budget
        self.nodes = 0
        self._dead: dict[int, set[bytes]] = {}
        """Digests of scenes without an escape, by the number of decisions made."""

    def finds(self, start: SceneState) -> bool | None:
        """Whether some sequence escapes from a state of one scene; None if the budget ends.

        After an answer False, the searches that follow use what this one has visited.
        """
        waiting: dict[int, list[SceneState]] = {int(start.steps[0]): [start]}
        at_once = max(1, len(self._simulation.seeds) // self._actions)
        while waiting:
            depth = max(waiting)
            state = waiting[depth].pop()
            if not waiting[depth]:
                del waiting[depth]
            if len(state) > at_once:
                waiting.setdefault(depth, []).append(state.take(np.arange(at_once, len(state))))
                state = state.take(np.arange(at_once))
            if self.nodes + len(state) * self._actions > self._budget:
                return None
            after = self._expand(state)
            if len(after) == 0:
                continue
            if depth + 1 == self._until:
                return True
            fresh = self._unvisited(after, depth + 1)
            if fresh.size:
                waiting.setdefault(depth + 1, []).append(after.take(fresh))
        return False

    def _expand(self, state: SceneState) -> SceneState:
        """The scenes after each meta-action in which the ego has not failed."""
        simulation, count = self._simulation, len(state) * self._actions
        self.nodes += count
        rows = np.arange(count)
        simulation.scene.active[:] = False
        simulation.restore(state.take(np.repeat(np.arange(len(state)), self._actions)), rows)
        actions = np.zeros(len(simulation.seeds), dtype=np.int64)
        actions[:count] = np.tile(np.arange(self._actions), len(state))
        simulation.step(actions)
        return simulation.state(rows[~simulation.failed[:count]])

    def _unvisited(self, state: SceneState, depth: int) -> Ints:
        dead = self._dead.setdefault(depth, set())
        values = [getattr(state, name).reshape(len(state), -1) for name in _DECIDES]
        whole = np.concatenate([np.ascontiguousarray(v).view(np.uint8) for v in values], axis=1)
        fresh = []
        for row, each in enumerate(whole):
            digest = blake2b(each.tobytes(), digest_size=16).digest()
            if digest not in dead:
                dead.add(digest)
                fresh.append(row)
        return np.array(fresh, dtype=np.int64)

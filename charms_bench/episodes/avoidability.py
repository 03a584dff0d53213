"""Until when the ego could have avoided a collision, and whose action led to it.

A future avoids the collision if the ego neither collides nor leaves the road until the end of the
first decision interval that ends at least 2 s after the recorded collision. All other vehicles
react as their agents do.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from math import ceil
from typing import Literal

import numpy as np
import polars as pl

from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.episodes.escape import EscapeSearch
from charms_bench.episodes.recorded_cell import RecordedCell, check_guests
from charms_bench.episodes.replay import replay
from charms_bench.errors import AgentError, InputError
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.registry import AGENTS, make_agent, plugins
from charms_bench.plugins.traffic import OneAgent
from charms_bench.recording.columns import of_ego
from charms_bench.runs.cells import title_of
from charms_bench.world.action_texts import described_actions
from charms_bench.world.actions import Actions, MetaAction, meta_actions_of
from charms_bench.world.scene import Bools, Ints, Observations, SceneSettings

AFTERWARDS_S = 2.0
NEAR_M = 50.0
"""A vehicle this close to the ego, along the road, may have caused the collision."""
BUDGET = 200_000
"""Decisions simulated per collision, unless another number is asked for."""
AT_ONCE = 20
"""Episodes whose states are in memory together."""
_SCENES = 500
"""Scenes that a search simulates together."""
Verdict = Literal["avoidable", "spawn", "unknown"]


@dataclass(frozen=True)
class Replacement:
    """The latest meta-action whose replacement avoids a collision."""

    step: int
    """The decision, from 1."""
    vehicle: int
    """Whose it was: the index in the order of spawning."""
    is_ego: bool
    agent: str
    was: str
    instead: str


@dataclass(frozen=True)
class Avoidability:
    """How one collision of the ego could have been avoided."""

    ego: str
    """Title of the ego."""
    traffic: str
    episode: int
    ending: str
    step: int
    """The decision in whose interval the ego collided, from 1."""
    collided_s: float
    """When it collided: the end of the simulation step, as in `what_happened`."""
    verdict: Verdict
    """`spawn` if no sequence of meta-actions avoids it from the first decision on; `unknown` if the
    budget ended before an answer."""
    last_step: int | None
    """The last decision from which some sequence of the ego's meta-actions avoids it."""
    avoided_by: tuple[str, ...]
    """The agents that avoid it if they drive the ego from that decision on."""
    hit_by: tuple[str, ...]
    """The agents that do not."""
    replacement: Replacement | None
    """The latest single meta-action that could have avoided it; None if there is none."""
    nodes: int
    """Decisions that the search simulated."""
    road: str | None = None
    """Title of the road; None for the straight road of the scene."""
    ego_index: int | None = None
    """Which of several egos; None if there is one."""

    def __repr__(self) -> str:
        around = title_of([*filter(None, (self.road, self.traffic))])
        which = "" if self.ego_index is None else f" ego {self.ego_index},"
        where = f"{self.ego} in {around},{which} episode {self.episode}"
        last = "" if self.last_step is None else f", last avoidable at decision {self.last_step}"
        return f"<Avoidability of {where}, collision in decision {self.step}: {self.verdict}{last}>"


def collisions(cell: RecordedCell) -> list[int]:
    """The seeds of a cell's episodes that end with a collision of the ego."""
    episodes = of_ego(cell.rows.episodes, cell.ego_index)
    collided = episodes.filter(pl.col("ending").is_in(["rear_end", "side"]))
    return [int(seed) for seed in collided["episode"]]


def avoidability(
    cell: RecordedCell,
    episodes: Sequence[int],
    budget: int = BUDGET,
    agents: Sequence[str] | None = None,
    tell: Callable[[int], None] = lambda done: None,
) -> list[Avoidability]:
    """How the collisions of some episodes of a cell could have been avoided, in their order.

    The episodes are given by their seeds, and `budget` is the most decisions that the search may
    simulate for one collision. Of the `agents`, by default all that are installed and usable, it is
    tried who avoids it. `tell` is called with the number of collisions done since the last call.
    Raises an `InputError` if an episode does not end with a collision of the ego, and what `replay`
    raises.
    """
    tried = _usable(cell.cell.scene) if agents is None else tuple(agents)
    found: list[Avoidability] = []
    for start in range(0, len(episodes), AT_ONCE):
        found += _Chunk(cell, episodes[start : start + AT_ONCE], budget).results(tried, tell)
    return found


def _usable(settings: SceneSettings) -> tuple[str, ...]:
    """The installed agents that can be made and whose rates fit."""
    names = []
    for name in plugins(AGENTS):
        with suppress(InputError):
            agent = make_agent(name)
            if getattr(agent, "follows_recording", False):
                continue
            Simulation(settings, 1, name, OneAgent(name), {name: agent})
            if settings.network is not None:
                check_guests({name: agent}, settings)
            names.append(name)
    return tuple(names)


class _Always(Policy):
    """Takes one action whatever it sees."""

    def __init__(self, action: int, decision_hz: float, actions: tuple[MetaAction, ...]) -> None:
        self._action, self.decision_hz, self.actions = action, decision_hz, actions

    def decide(self, observations: Observations) -> Actions:
        return np.full(len(observations), self._action)


def _override(action: int, actions: tuple[MetaAction, ...]) -> str:
    """The name of the agent that always takes one of these meta-actions."""
    return f"always {actions[action].name} of {described_actions(actions)}"


class _Chunk:
    """Some episodes of a cell, with their states before every decision."""

    def __init__(self, cell: RecordedCell, episodes: Sequence[int], budget: int) -> None:
        self._budget, scene = budget, cell.cell.scene
        self._replays = replay(cell, episodes)
        for each in self._replays:
            if each.ending not in ("rear_end", "side"):
                raise InputError(
                    f"{cell.run.folder.path}: episode {each.episode} does not end with a collision "
                    f"of the ego, but with '{each.ending}'"
                )
        # The last collision may be so late that 2 s after it the episode would be over. Recordings
        # decide how long an episode is, and the duration decides which recorded moments there are.
        more = {"duration_s": scene.duration_s + AFTERWARDS_S + 1 / scene.decision_hz}
        self._settings = scene if scene.is_recorded else scene.model_copy(update=more)
        self._simulation = partial(cell.simulation, settings=self._settings)
        self._last = np.array([each.steps.height for each in self._replays])
        frames = [int(each.crashed[:, each.ego].argmax()) for each in self._replays]
        beyond = AFTERWARDS_S * scene.simulation_hz
        until = [ceil((k + beyond) / scene.steps_per_decision) for k in frames]
        self._until = np.minimum(until, self._settings.decisions)
        simulation = self._simulation(len(episodes))
        simulation.reset(np.array(episodes, dtype=np.uint64))
        self._kept = [simulation.state()]
        """The states of all episodes by the number of decisions made."""
        for _ in range(self._last.max()):
            simulation.step()
            self._kept.append(simulation.state())
        self._made = simulation.made

    def _before(self, episode: int, step: int) -> SceneState:
        return self._kept[step - 1].take(np.array([episode]))

    def results(self, tried: Sequence[str], tell: Callable[[int], None]) -> list[Avoidability]:
        """What could have been done about each collision."""
        searched = []
        outside = self._simulation(_SCENES, is_ego_outside=True)
        for episode in range(len(self._replays)):
            searched.append(self._last_escape(episode, outside))
            tell(1)
        avoids = self._who_avoids(tried, [last for _, last, _ in searched])
        override = {
            _override(k, actions): _Always(k, self._settings.decision_hz, actions)
            for actions in dict.fromkeys(outside.meta_actions.values())
            for k in range(len(actions))
        }
        overridden = self._simulation(_SCENES, override)
        found = []
        for episode, (each, (verdict, last, nodes)) in enumerate(
            zip(self._replays, searched, strict=True)
        ):
            own = {name: done[episode] for name, done in avoids.items()} if last else {}
            found.append(
                Avoidability(
                    ego=each.cell.ego.title,
                    traffic=each.cell.traffic.title,
                    episode=each.episode,
                    ending=each.ending,
                    step=int(self._last[episode]),
                    collided_s=float(each.t_s[each.crashed[:, each.ego].argmax()]),
                    verdict=verdict,
                    last_step=last,
                    avoided_by=tuple(name for name, does in own.items() if does),
                    hit_by=tuple(name for name, does in own.items() if not does),
                    replacement=self._replacement(episode, overridden),
                    nodes=nodes,
                    road=each.cell.road.title if each.cell.road else None,
                    ego_index=each.ego_index,
                )
            )
        return found

    def _last_escape(self, episode: int, outside: Simulation) -> tuple[Verdict, int | None, int]:
        """The verdict, the last decision with an escape, and the decisions simulated."""
        search = EscapeSearch(outside, int(self._until[episode]), self._budget)
        for step in range(int(self._last[episode]), 0, -1):
            start = self._before(episode, step)
            escapes = search.finds(start.seated(start.ego, ""))
            if escapes is None:
                return "unknown", None, search.nodes
            if escapes:
                return "avoidable", step, search.nodes
        return "spawn", None, search.nodes

    def _who_avoids(self, tried: Sequence[str], steps: Sequence[int | None]) -> dict[str, Bools]:
        """[E] by agent, whether it avoids each collision from these decisions on."""
        episodes = [k for k, step in enumerate(steps) if step is not None]
        if not episodes:
            return {}
        starts = SceneState.joined([self._before(k, steps[k] or 0) for k in episodes])
        found = {}
        for name in tried:
            simulation = self._simulation(len(episodes), {name: make_agent(name)})
            simulation.restore(starts.seated(starts.ego, name))
            with suppress(AgentError):
                avoids = self._survive(simulation, self._until[episodes])
                found[name] = np.zeros(len(steps), dtype=np.bool_)
                found[name][episodes] = avoids
        return found

    @staticmethod
    def _survive(simulation: Simulation, until: Ints) -> Bools:
        """Whether the egos of the active scenes have not failed when so many decisions are made."""
        rows = np.arange(until.size)
        while (simulation.scene.active[rows] & (simulation.steps[rows] < until)).any():
            simulation.step()
        return ~simulation.failed[rows] | (simulation.steps[rows] > until)

    def _replacement(self, episode: int, simulation: Simulation) -> Replacement | None:
        """The latest replacement; of several vehicles, that of the nearest to the ego."""
        for step in range(int(self._last[episode]), 0, -1):
            state = self._before(episode, step)
            taken = self._kept[step].action[episode]
            for place in self._deciding(state):
                actions = simulation.meta_actions[int(state.drivers[0, place])]
                others = [action for action in range(len(actions)) if action != taken[place]]
                rows = np.arange(len(others))
                start = replace(state.take(np.zeros_like(rows)), agents=simulation.agents)
                replaced = start.drivers.copy()
                names = [_override(action, actions) for action in others]
                replaced[:, place] = [simulation.agents.index(name) for name in names]
                simulation.scene.active[:] = False
                simulation.restore(start.with_arrays({"drivers": replaced}), rows)
                simulation.step()
                after = simulation.state(rows).with_arrays({"drivers": start.drivers})
                simulation.restore(after, rows)
                avoids = self._survive(simulation, np.full(rows.size, self._until[episode]))
                if avoids.any():
                    agent = state.agents[state.drivers[0, place]]
                    was, instead = taken[place], others[int(avoids.argmax())]
                    is_ego = bool(place == state.ego[0])
                    said = (agent, actions[was].name, actions[instead].name)
                    return Replacement(step, self._number(state, place), is_ego, *said)
        return None

    def _number(self, state: SceneState, place: int) -> int:
        """The index of the vehicle at a place in the order in which vehicles appear."""
        inflow, number = self._settings.straight_inflow, int(state.entry[0, place])
        if inflow is None:
            return int(place)
        return number - (number > self._settings.traffic_vehicles) * inflow.capacity

    def _deciding(self, state: SceneState) -> Ints:
        """The vehicles near the ego that decide on a meta-action now, the nearest first."""
        distance = np.abs(state.x[0] - state.x[0, state.ego[0]])
        frame = int(state.steps[0]) * self._settings.steps_per_decision
        periods = {
            k: round(self._settings.simulation_hz / agent.decision_hz)
            for k, agent in self._made.items()
            if isinstance(agent, Policy) and meta_actions_of(agent.actions)
        }
        decides = [k in periods and frame % periods[k] == 0 for k in state.drivers[0].tolist()]
        near = np.array(decides) & (distance <= NEAR_M) & ~state.crashed[0]
        return np.asarray(sorted(np.nonzero(near)[0], key=lambda place: float(distance[place])))

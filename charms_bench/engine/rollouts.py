"""What a planner asks: what would follow if its vehicles carried out plans.

Each plan is simulated from a copy of the scene, in which one agent drives all other vehicles. The
copy has everything that can be seen of them, and none of what their drivers are: an agent with
parameters gets the middles of their ranges, and a scenario's prescribed actions are not known.
"""

from typing import Any, NamedTuple

import numpy as np

from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.endings import are_off_road
from charms_bench.engine.prescribed import TEMPERAMENT
from charms_bench.engine.running import RunningEpisodes
from charms_bench.engine.state import SceneState, state_of
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.registry import others_of
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import Actions, meta_actions_of, problem_of
from charms_bench.world.scene import Bools, Floats, Ints, Vehicles

SCENES = 512
"""Scenes that are simulated at once."""
VIEWED = 2**18
"""Vehicles in the views of all vehicles of these scenes, at most, where each sees its own."""


class Outcomes(NamedTuple):
    """What M vehicles do and meet with K plans of H decisions each; every array is (M, K, H).

    The values are those at the end of each decision. After a vehicle has crashed or left the road,
    or after the end of the episode, they no longer change.
    """

    x: Floats
    """Centre along the road, m."""
    y: Floats
    """Centre across the road, m."""
    speed: Floats
    """m/s"""
    lane: Ints
    """Nearest lane."""
    gap: Floats
    """Distance to the leader on the nearest lane, centre to centre, m; infinite without one."""
    leader_speed: Floats
    """m/s; 0 without a leader."""
    failed: Bools
    """Whether the vehicle has crashed or left the road."""


class Rollouts:
    """Simulates plans of M vehicles; a planner receives it as `rollouts`."""

    def __init__(self, futures: "Futures", vehicles: Vehicles) -> None:
        self._futures, self._vehicles = futures, vehicles

    def __len__(self) -> int:
        return self._vehicles[0].size

    def __getitem__(self, some: Ints) -> "Rollouts":
        """The same for some of the vehicles."""
        return Rollouts(self._futures, tuple(each[some] for each in self._vehicles))

    def __call__(self, plans: Actions) -> Outcomes:
        """What follows from plans.

        Args:
            plans: (K, H) meta-actions, the same plans for each vehicle, or (M, K, H) with plans of
                its own for each; one action per decision of the planner. Continuous actions have
                one more axis, (..., 2).

        Raises:
            InputError: The plans have another shape.
        """
        return self._futures.outcomes(self._vehicles, np.asarray(plans))


class Futures:
    """The simulations in which a planner of a simulation looks ahead."""

    def __init__(self, simulation: RunningEpisodes, planner: Policy) -> None:
        self._made, self._planner = simulation, planner
        self._period = round(simulation.settings.simulation_hz / planner.decision_hz)
        self._on_network = simulation.settings.network is not None
        self._scenes = SCENES
        if self._on_network:
            self._scenes = min(SCENES, max(1, VIEWED // simulation.settings.vehicles**2))
        self._beside: Any = None

    def of(self, vehicles: Vehicles) -> Rollouts:
        """The rollouts of M vehicles."""
        return Rollouts(self, vehicles)

    @property
    def _simulation(self) -> Any:
        """A simulation of `_scenes` scenes, made when it is first needed."""
        if self._beside is None:
            others, actions = self._planner.rollouts_with, self._planner.actions
            agents, simulation = {others: others_of(self._planner)}, type(self._made)
            kind = self._made.make_engine if self._on_network else BatchedEngine
            scenes, traffic = self._scenes, OneAgent(others)
            self._beside = simulation(
                self._made.settings, scenes, None, traffic, agents, kind, actions=actions
            )
            sources = self._beside.sources
            self._beside.sources = tuple(each for each in sources if each.is_foreseen)
        return self._beside

    def outcomes(self, vehicles: Vehicles, plans: Actions) -> Outcomes:
        """See `Rollouts`."""
        rows, places = vehicles
        actions = self._planner.actions
        dimensions = 2 if meta_actions_of(actions) else 3
        if plans.ndim == dimensions:
            plans = np.broadcast_to(plans, (rows.size, *plans.shape))
        if plans.ndim != dimensions + 1 or len(plans) != rows.size:
            raise InputError(
                f"rollouts: plans of shape {plans.shape}; expected (plans, decisions), or "
                f"({rows.size}, plans, decisions) with plans for each vehicle"
            )
        if dimensions == 2 and (what := problem_of(plans.ravel(), actions, plans.size)[0]):
            raise InputError(f"rollouts: plans have {what}")
        shape = plans.shape[:3]
        found = Outcomes(*(np.zeros(shape, dtype) for dtype in _DTYPES))
        flat = [array.reshape(-1, shape[2]) for array in found]
        # The ego can be controlled in another way than other vehicles (`Profile.ego_control_rate`).
        is_ego = self._made.scene.ego[rows] == places
        for part in (np.nonzero(is_ego)[0], np.nonzero(~is_ego)[0]):
            each = (part[:, None] * shape[1] + np.arange(shape[1])).ravel()
            for start in range(0, each.size, self._scenes):
                index = each[start : start + self._scenes]
                which = index // shape[1]
                state = self._state((rows[which], places[which]))
                given = plans.reshape(-1, *plans.shape[2:])[index]
                holds = bool(is_ego[which[0]])
                driven = self._driven(state, places[which], given, holds)
                for array, values in zip(flat, driven, strict=True):
                    array[index] = values
        return found

    def _state(self, vehicles: Vehicles) -> SceneState:
        """Copies of scenes in which each of the vehicles (S,) is the ego, driven from outside."""
        rows, places = vehicles
        unique, which = np.unique(rows, return_inverse=True)
        state = state_of(self._made, unique).take(which)
        own = np.arange(rows.size), places
        counted = state.repeats[own]  # decides what the first action of a plan does
        everyone = np.ones(state.drivers.shape, dtype=np.bool_)
        state = state.driven_by(self._planner.rollouts_with, everyone).seated(places, "")
        repeats = state.repeats.copy()
        repeats[own] = counted
        index = [self._simulation.agents.index(name) if name in self._simulation.agents else 0
                 for name in state.agents]  # fmt: skip
        arrays: dict[str, Any] = {
            **state.arrays(),
            "drivers": np.array(index)[state.drivers],
            "ego": state.ego if self._on_network else places,
            "repeats": repeats,
            "ending": np.zeros(rows.size, dtype=np.int64),
            "active": np.ones(rows.size, dtype=np.bool_),
            "temperament": np.full(state.x.shape, TEMPERAMENT),
        }
        made = self._simulation
        return SceneState(made.settings, made.agents, state.phase, **arrays)

    def _driven(self, state: SceneState, places: Ints, plans: Actions, holds: bool) -> list[Any]:
        """The outcomes (S, H) of plans (S, H) of the vehicles at some places (S,) of a state."""
        made, scenes = self._simulation, np.arange(len(state))
        made.holds_egos = holds and self._made.holds_egos
        # On a network, the ego is always the first vehicle, and others outlast its episode.
        made.egos_end_episodes = bool((state.ego == places).all())
        made.scene.active[:] = False
        made.restore(state, scenes)
        for agent, ranges in made.ranges.items():
            middles = [(low + high) / 2 for low, high in ranges.values()]
            made.scene.parameters[made.engine.drivers == agent, : len(ranges)] = middles
        own, c = (scenes, places), made.settings
        failed, found = np.zeros(scenes.size, dtype=np.bool_), []
        for decision in range(plans.shape[1]):
            made.command(own, plans[:, decision])
            for _ in range(self._period):
                made.advance()
                if made.phase == c.steps_per_decision:
                    made.finish_step()
            now = self._now(own)
            failed = failed | now[-1]
            found.append((*now[:-1], failed))
        return [np.stack(each, axis=1) for each in zip(*found, strict=True)]

    def _now(self, own: Vehicles) -> tuple[Any, ...]:
        """The values (S,) of `Outcomes` for vehicles of the first S scenes."""
        made = self._simulation
        scene, seen = made.engine.seen_by(own)
        lane = scene.lane[seen]
        leader, present = scene.leader(seen, lane)
        ahead = (seen[0], leader)
        gap = np.where(present, scene.x[ahead] - scene.x[seen], np.inf)
        leader_speed = np.where(present, scene.speed[ahead], 0.0)
        failed = made.failed[own[0]]
        if not made.egos_end_episodes:
            failed = made.engine.state.crashed[own]
            if made.settings.profile.offroad_terminal:
                failed = failed | are_off_road(scene, *seen)
        return scene.x[seen], scene.y[seen], scene.speed[seen], lane, gap, leader_speed, failed


_DTYPES = (float, float, float, np.int64, float, float, np.bool_)

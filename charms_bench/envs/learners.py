"""L vehicles in each of B scenes that the caller drives: what every environment steps."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import index
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.collision_kinds import NO_COLLISION, SIDE_COLLISION
from charms_bench.engine.endings import OFF_ROAD, REAR_END, RUNNING, SIDE, TIME, are_off_road
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.envs import ID
from charms_bench.envs.rendering import Renderer, frame_of, moment_of
from charms_bench.envs.spaces import spaces_of
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import OneAgent, Traffic, assigned
from charms_bench.world.actions import ACTIONS, CONTROLS, ActionKind, Actions, problem_of
from charms_bench.world.observations import Observation, neighbours
from charms_bench.world.scene import Bools, Floats, Ints, Scene, SceneSettings, Vehicles

C = TypeVar("C")
VehicleReward = Callable[[Scene, Vehicles], Floats]
"""The rewards (M,) of M vehicles after a decision interval."""


class Reward(Protocol[C]):
    """The reward of a decision. It keeps no state; `prepare` returns what it needs, of type C."""

    def prepare(self, simulation: Simulation, actions: Actions) -> C:
        """What to remember of the scene before the egos' actions are carried out."""

    def __call__(self, simulation: Simulation, prepared: C) -> Floats:
        """The rewards (B,) after the decision interval, before ended episodes restart."""


class Outcome(NamedTuple):
    """What a decision interval did to the learners, (B L,)."""

    rewards: Floats
    """0 for a learner that did not drive any more."""
    terminated: Bools
    """Whether the learner has crashed or left the road in this interval."""
    truncated: Bools
    """Whether the scene's time is over while the learner drives."""
    endings: Ints
    """Index into `ENDINGS`; `RUNNING` unless the learner ended in this interval."""


class Learners:
    """L vehicles in each of B scenes, which the actions given to `step` drive.

    In arrays (B L,), the learners of the first scene come first.

    Vehicle 0 is the ego, and vehicle k is the k-th of the others in the order of spawning. A
    learner that has crashed, or has left the road if the profile ends episodes then, gets no more
    actions. Its vehicle stays in the scene, which goes on for the others until its time is over.

    Args:
        settings: What the scenes have in common.
        scenes: B.
        numbers: The learners' vehicles, which include 0; None for all vehicles.
        traffic: Assigns a driver to each vehicle that is not a learner.
        agents: All agents that `traffic` names, by name.
        reward: The reward of a decision: of the vehicles that drive, or if 0 is the only number,
            of the egos.
        observation: The learners' observation.
        render_mode: One of `RENDER_MODES`, or None.
        title: The environment's name, for messages and pictures.
        actions: The kind of the learners' actions.

    Raises:
        InputError: A number is not that of a vehicle, or it is given twice, or 0 is missing; or
            there is no scene, or no such render mode.
    """

    def __init__(
        self,
        settings: SceneSettings,
        scenes: int,
        numbers: Iterable[int] | None,
        traffic: Traffic,
        agents: Mapping[str, Agent],
        reward: Reward[Any] | VehicleReward,
        observation: Observation = neighbours,
        render_mode: str | None = None,
        title: str = ID,
        actions: ActionKind = "meta",
    ) -> None:
        if scenes < 1:
            raise InputError(f"scenes is {scenes}; expected at least 1")
        everyone = range(settings.vehicles)
        self.numbers = _checked(everyone if numbers is None else numbers, settings.vehicles)
        self.scene_of = np.repeat(np.arange(scenes), len(self.numbers))
        """(B L,) the learners' scenes."""
        driven = traffic if self.numbers == (0,) else FromOutside(self.numbers, traffic)
        if len(self.numbers) == settings.vehicles > 1:
            driven = OneAgent("")
        self.simulation = Simulation(settings, scenes, None, driven, agents, actions=actions)
        self.returns = np.zeros(self.scene_of.size)
        """(B L,) sums of the rewards so far."""
        scene = self.simulation.scene
        self._are_egos = len(self.numbers) == 1
        self.places = scene.ego if self._are_egos else np.zeros_like(self.scene_of)
        """(B L,) the learners' places in their scenes, in the order of spawning."""
        self.alive = scene.active if self._are_egos else np.zeros(self.returns.size, dtype=np.bool_)
        """(B L,) whether the learner drives, so that its next action counts."""
        self.spaces = spaces_of(settings, observation, actions)
        """Of a learner's observations and of its actions."""
        self.renderer = Renderer(
            lambda row: frame_of(moment_of(self.simulation, row, title)),
            scenes,
            settings.decision_hz,
            render_mode,
            title,
        )
        self.kind, self.observation = actions, observation
        self._reward: Any = reward

    @property
    def vehicles(self) -> Vehicles:
        """The M learners that drive, by scene and then in the order of `numbers`; or all egos."""
        if self._are_egos:
            return self.scene_of, self.places
        return self.scene_of[self.alive], self.places[self.alive]

    def reset(self, seeds: NDArray[np.uint64], rows: Ints) -> None:
        """Starts an episode in each of the scenes `rows`, in which all learners drive."""
        self.simulation.reset(seeds, rows)
        which = self.of_scenes(rows)
        self.returns[which] = 0.0
        if not self._are_egos:
            ego, others = self.simulation.scene.ego[rows, None], np.array(self.numbers) - 1
            self.places[which] = np.where(others < 0, ego, others + (others >= ego)).ravel()
            self.alive[which] = True

    def of_scenes(self, rows: Ints) -> Ints:
        """The indices (R L,) of the learners of R scenes."""
        count = len(self.numbers)
        return rows if self._are_egos else (rows[:, None] * count + np.arange(count)).ravel()

    def restore(self, state: SceneState) -> None:
        """Continues all scenes from a state, in which the egos are the only learners.

        Raises:
            InputError: It is not a `SceneState`, it does not fit, or its scenes are not between two
                decisions.
        """
        if not isinstance(state, SceneState):
            raise InputError(f"found {type(state).__name__}, expected a SceneState")
        if state.phase:
            raise InputError(
                f"the state was saved {state.phase} simulation steps after a decision; an "
                "environment continues states between two decisions"
            )
        if not state.active.all():
            ended = state.seeds[~state.active][0]
            raise InputError(f"the state of episode {ended} was saved after the episode had ended")
        self.simulation.restore(state.seated(state.ego, ""))
        self.returns[:] = 0.0

    def step(self, actions: Actions) -> Outcome:
        """Carries out the actions (B L,) or (B L, 2) of the learners for one decision interval.

        Raises:
            InputError: The actions have another shape or type, or one is out of range.
        """
        what, wrong = problem_of(actions, self.kind, self.alive.size)
        if what:
            meaning = ", ".join(ACTIONS if self.kind == "meta" else CONTROLS)
            who = "ego" if len(self.numbers) == 1 else "learner"
            raise InputError(f"step: {who} {wrong}: {what}: {meaning}")
        simulation, reward = self.simulation, self._reward
        is_of_egos = hasattr(reward, "prepare")
        prepared = reward.prepare(simulation, actions) if is_of_egos else None
        drove, vehicles = self.alive, self.vehicles
        if self._are_egos:
            simulation.step(actions)
        else:
            simulation.command(vehicles, actions[drove])
            simulation.step()
        self.renderer.show()
        rewards = reward(*((simulation, prepared) if is_of_egos else (simulation.scene, vehicles)))
        if self._are_egos:
            endings = simulation.ending.copy()
        else:
            endings = np.full(drove.size, RUNNING)
            endings[drove] = self._endings(vehicles)
            of_all = np.zeros(drove.size)
            of_all[drove] = rewards
            rewards = of_all
            self.alive = drove & (endings == RUNNING)
        self.returns += rewards
        # The endings after TIME are failures.
        return Outcome(rewards, endings > TIME, endings == TIME, endings)

    def _endings(self, vehicles: Vehicles) -> Ints:
        """(M,) how M vehicles have ended in this interval."""
        simulation = self.simulation
        collision = simulation.collision[vehicles]
        endings = np.where(simulation.truncated[vehicles[0]], TIME, RUNNING)
        if simulation.settings.profile.offroad_terminal:
            endings[are_off_road(simulation.scene, *vehicles)] = OFF_ROAD
        endings[collision != NO_COLLISION] = REAR_END
        endings[collision == SIDE_COLLISION] = SIDE
        return endings


class FromOutside(Traffic):
    """A traffic in which vehicles with these numbers have no agent; the caller drives them.

    The others have the same drivers as without learners. The ego is no part of a traffic.
    """

    def __init__(self, numbers: Sequence[int], traffic: Traffic) -> None:
        self.agents = ("", *traffic.agents)
        self._traffic = traffic
        self._driven = [number - 1 for number in numbers if number > 0]

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        names = np.array(assigned(self._traffic, rng, scenes, vehicles))
        names[:, self._driven] = ""
        return names


def _checked(numbers: Iterable[int], vehicles: int) -> tuple[int, ...]:
    """The learners' numbers in ascending order."""
    try:
        found = sorted(index(number) for number in numbers)
    except TypeError:
        found = []
    if not found or found[0] != 0 or found[-1] >= vehicles or len({*found}) < len(found):
        shown = ", ".join(map(str, found[:20])) + ", ..." * (len(found) > 20) or f"{numbers!r:.80}"
        raise InputError(
            f"learners: found {shown}; expected different numbers from 0 to {vehicles - 1}, of "
            f"which one is 0, the ego, such as range({min(3, vehicles)})"
        )
    return tuple(found)

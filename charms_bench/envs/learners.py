"""L vehicles in each of B scenes that the caller drives: what every environment steps."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import prod
from operator import index
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.collision_kinds import NO_COLLISION, SIDE_COLLISION
from charms_bench.engine.endings import GOAL, OFF_ROAD, REAR_END, RUNNING, SIDE, TIME, are_off_road
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.engine.stepping import advance
from charms_bench.envs import ID
from charms_bench.envs.given_actions import GivenActions, GivenLike
from charms_bench.envs.spaces import spaces_of
from charms_bench.errors import InputError, ScenarioError
from charms_bench.foundation.progress import ENGINE, ENGINE_OF_ROADS, note_compiling
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.deciding import delay_of, kept_of, shown_of
from charms_bench.plugins.traffic import OneAgent, Traffic, assigned
from charms_bench.world.action_mask import ActionMasks, action_masks
from charms_bench.world.actions import DEFAULT_ACTIONS, Actions, meta_actions_of
from charms_bench.world.observations import Observation, neighbours
from charms_bench.world.scene import (
    Bools,
    Floats,
    Ints,
    Observations,
    Scene,
    SceneSettings,
    Vehicles,
)

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

    Vehicle 0 is the ego, and vehicle k is the k-th of the others in the order of spawning. On some
    roads, not all of them are there in each episode, and obstacles count, too, but none drives. A
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
        title: The environment's name, for messages and pictures.
        actions: The learners' actions; see `GivenActions`.
        longitudinal: Whether their actions change the speed.
        lateral: Whether their actions change the lane, or steer.

    Raises:
        InputError: A number is not a vehicle's, is given twice, or 0 is missing; there are several
            numbers on a road that vehicles enter during the episode; or there is no scene, or no
            action.
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
        title: str = ID,
        actions: GivenLike = "meta",
        longitudinal: bool = True,
        lateral: bool = True,
    ) -> None:
        self.title = title
        self.actions = GivenActions(actions, longitudinal, lateral, title)
        if scenes < 1:
            raise InputError(f"scenes is {scenes}; expected at least 1")
        if not callable(reward):
            raise InputError(f"{title}: reward is {reward!r:.80}; expected a function or a Reward")
        everyone = range(settings.vehicles)
        self.numbers = _checked(everyone if numbers is None else numbers, settings.vehicles)
        self.scene_of = np.repeat(np.arange(scenes), len(self.numbers))
        """(B L,) the learners' scenes."""
        driven = traffic if self.numbers == (0,) else FromOutside(self.numbers, traffic)
        if len(self.numbers) == settings.vehicles > 1:
            driven = OneAgent("")
        like = self.actions.like
        engine = _engine_of(settings, agents, title)
        with self._placing():
            self._kept = delay_of(observation) * prod(observation.shape)
            given = driven, agents, engine, like, self._kept
            self.simulation = Simulation(settings, scenes, None, *given)
        if len(self.numbers) > 1 and self.simulation.engine.renewal_steps:
            raise InputError(
                f"{title}: learners: other vehicles come to this road later, which no "
                "learner drives; expected one learner, 0"
            )
        self.returns = np.zeros(self.scene_of.size)
        """(B L,) sums of the rewards so far."""
        self._are_egos = len(self.numbers) == 1
        self._places = np.zeros_like(self.scene_of)
        self._alive = np.zeros(self.returns.size, dtype=np.bool_)
        self.spaces = spaces_of(settings, observation, like)[0], self.actions.space
        """Of a learner's observations and of its actions."""
        self._observation = observation
        self._reward: Any = reward
        self._has_started = False

    @property
    def places(self) -> Ints:
        """(B L,) the learners' places in their scenes, in the order of spawning."""
        return self.simulation.scene.ego if self._are_egos else self._places

    @property
    def alive(self) -> Bools:
        """(B L,) whether the learner drives, so that its next action counts."""
        return self.simulation.scene.active if self._are_egos else self._alive

    @property
    def vehicles(self) -> Vehicles:
        """The M learners that drive, by scene and then in the order of `numbers`; or all egos."""
        if self._are_egos:
            return self.scene_of, self.places
        return self.scene_of[self.alive], self.places[self.alive]

    def reset(self, seeds: NDArray[np.uint64], rows: Ints) -> None:
        """Starts an episode in each of the scenes `rows`, in which all learners drive."""
        with self._placing():
            self.simulation.reset(seeds, rows)
        self._has_started = True
        which = self.of_scenes(rows)
        self.returns[which] = 0.0
        if not self._are_egos:
            ego, others = self.simulation.scene.ego[rows, None], np.array(self.numbers) - 1
            self._places[which] = np.where(others < 0, ego, others + (others >= ego)).ravel()
            present = self.simulation.engine.state.present
            self._alive[which] = present[self.scene_of[which], self._places[which]]

    @contextmanager
    def _placing(self) -> Iterator[None]:
        """Adds the scenario's key to an error about vehicles that cannot be placed."""
        try:
            yield
        except ScenarioError as error:
            at = ".".join(map(str, ("scenario", *error.location)))
            raise InputError(f"{self.title}: {at}: {error}") from error

    def of_scenes(self, rows: Ints) -> Ints:
        """The indices (R L,) of the learners of R scenes."""
        count = len(self.numbers)
        return rows if self._are_egos else (rows[:, None] * count + np.arange(count)).ravel()

    def scenes_of(self, mask: Any) -> Any:
        """The mask (B,) of scenes from one (B L,) of learners.

        Raises:
            InputError: It divides the learners of a scene.
        """
        if mask is None or self._are_egos or np.shape(mask) != self.returns.shape:
            return mask
        each = np.asarray(mask).reshape(-1, len(self.numbers))
        if (each != each[:, :1]).any():
            raise InputError("reset: option 'reset_mask': the learners of a scene start together")
        return each[:, 0]

    def restore(
        self, state: SceneState, places: Ints | None = None, alive: Bools | None = None
    ) -> None:
        """Continues all scenes from a state.

        Args:
            state: That of the scenes.
            places: (B L,) the learners' places, unless the egos are the only learners.
            alive: (B L,) which of them drive.

        Raises:
            InputError: It is not a `SceneState`, it does not fit, its scenes are not between two
                decisions, or it is one of other learners.
        """
        if not isinstance(state, SceneState):
            raise InputError(f"found {type(state).__name__}, expected a SceneState")
        found = 1 if places is None else places.size // len(state)
        if found != len(self.numbers):
            count = len(self.numbers)
            raise InputError(f"the state has {found} learners in a scene; expected {count}")
        if state.phase:
            raise InputError(
                f"the state was saved {state.phase} simulation steps after a decision; an "
                "environment continues states between two decisions"
            )
        if not state.active.all():
            ended = state.seeds[~state.active][0]
            raise InputError(f"the state of episode {ended} was saved after the episode had ended")
        self.simulation.restore(state.seated(state.ego, ""))
        if places is not None and alive is not None:
            self._places[:], self._alive[:] = places, alive
        self._has_started = True
        self.returns[:] = 0.0

    def observe(self, vehicles: Vehicles) -> Observations:
        """The observations (M, rows, columns) of M vehicles."""
        seen = np.asarray(self._observation(*self.simulation.engine.seen_by(vehicles)))
        if self._kept:
            seen = shown_of(self._observation, seen, self._earlier(vehicles))[:, 0]
        return seen

    def _earlier(self, vehicles: Vehicles) -> Floats:
        """The observations (M, W) of earlier decisions of M vehicles; see `shown_of`."""
        return self.simulation.scene.memory[vehicles][:, : self._kept]

    def _keep(self, vehicles: Vehicles) -> None:
        """Keeps what M vehicles observe, for later decisions."""
        seen = np.asarray(self._observation(*self.simulation.engine.seen_by(vehicles)))
        kept = kept_of(seen, self._earlier(vehicles))
        rows, places = vehicles
        self.simulation.scene.memory[rows, places, : self._kept] = kept

    def masks(self, vehicles: Vehicles) -> ActionMasks:
        """The action masks (M, A) of M vehicles; see `world.action_mask`."""
        self.check_started("action masks")
        own = meta_actions_of(self.actions.like) or DEFAULT_ACTIONS
        seen = self.simulation.engine.seen_by(vehicles)
        return action_masks(*seen, own)[:, self.actions.meaning]

    def check_started(self, what: str) -> None:
        """Raises a `ResetNeeded` before the first reset."""
        if not self._has_started:
            raise ResetNeeded(f"{what} before the first reset")

    def step(self, actions: Any) -> Outcome:
        """Carries out the actions (B L, ...) of the learners for one decision interval.

        Raises:
            InputError: The actions have another shape or type, or one is out of range.
            ResetNeeded: No episode has started.
        """
        self.check_started("step")
        who = "ego" if self._are_egos else "learner"
        actions = self.actions(actions, who, self.alive.size)
        simulation, reward = self.simulation, self._reward
        is_of_egos = hasattr(reward, "prepare")
        prepared = reward.prepare(simulation, actions) if is_of_egos else None
        drove, vehicles = self.alive, self.vehicles
        if self._kept:
            self._keep(vehicles)
        if self._are_egos:
            simulation.step(actions)
        else:
            simulation.command(vehicles, actions[drove])
            simulation.step()
        seen = (simulation, prepared) if is_of_egos else simulation.engine.seen_by(vehicles)
        rewards = reward(*seen)
        if self._are_egos:
            endings = simulation.ending.copy()
        else:
            endings = np.full(drove.size, RUNNING)
            endings[drove] = self._endings(vehicles)
            of_all = np.zeros(drove.size)
            of_all[drove] = rewards
            rewards = of_all
            self._alive = drove & (endings == RUNNING)
        self.returns += rewards
        # The endings after TIME are failures, and the goal of a road.
        return Outcome(rewards, endings > TIME, endings == TIME, endings)

    def _endings(self, vehicles: Vehicles) -> Ints:
        """(M,) how M vehicles have ended in this interval.

        On a road, the ego reaches its goal, and a vehicle that leaves the scene reaches its own.
        """
        simulation, (rows, places) = self.simulation, vehicles
        engine, collision = simulation.engine, simulation.collision[vehicles]
        endings = np.where(simulation.truncated[rows], TIME, RUNNING)
        is_ego = places == engine.state.ego[rows]
        endings[(engine.goals[rows] & is_ego) | ~engine.state.present[vehicles]] = GOAL
        if simulation.settings.profile.offroad_terminal:
            scene, seen = engine.seen_by(vehicles)
            endings[are_off_road(scene, *seen)] = OFF_ROAD
        endings[collision != NO_COLLISION] = REAR_END
        endings[collision == SIDE_COLLISION] = SIDE
        return endings


class FromOutside(Traffic):
    """A traffic in which vehicles with these numbers have no agent; the caller drives them.

    The others have the same drivers as without learners. The ego is not part of the traffic.
    """

    def __init__(self, numbers: Sequence[int], traffic: Traffic) -> None:
        self.agents = ("", *traffic.agents)
        self._traffic = traffic
        self._driven = [number - 1 for number in numbers if number > 0]

    def assign(self, rng: np.random.Generator, scenes: int, vehicles: int) -> NDArray[np.str_]:
        names = np.array(assigned(self._traffic, rng, scenes, vehicles))
        names[:, self._driven] = ""
        return names


def _engine_of(settings: SceneSettings, agents: Mapping[str, Agent], title: str) -> MakeEngine:
    """The engine of the straight road, or that of a road; says so if it has to be compiled.

    Raises:
        InputError: An agent cannot drive on the road.
    """
    if settings.network is None:
        note_compiling(advance, ENGINE)
        return BatchedEngine
    from charms_bench.roads.agent_stepping import advance as advance_on_road
    from charms_bench.roads.engine import RoadEngine
    from charms_bench.roads.settings import problem_of_driver  # slow to import

    for name, agent in agents.items():
        if what := problem_of_driver(agent):
            raise InputError(
                f"{title}: agent '{name}' cannot drive on the road '{settings.network}': {what}"
            )
    note_compiling(advance_on_road, ENGINE_OF_ROADS)
    return RoadEngine


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

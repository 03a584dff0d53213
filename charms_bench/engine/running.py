"""B episodes that run together: what is noted of them, who drives in them, and their engine."""

from collections.abc import Callable, Mapping
from itertools import chain
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine import Cast, MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.endings import GOAL, RUNNING, TIME, are_off_road
from charms_bench.errors import (
    PLUGIN_ERRORS,
    AgentError,
    BrokenWordError,
    InputError,
    ScenarioError,
    raised,
)
from charms_bench.foundation.compiled import compiled
from charms_bench.plugins.agent import ACCELERATION_LIMIT_MPS2, Agent, DriverModel, Policy
from charms_bench.plugins.deciding import check_declared, check_road, kept_width
from charms_bench.plugins.registry import others_of
from charms_bench.plugins.traffic import OneAgent, Traffic, assigned
from charms_bench.world.actions import (
    ACTIONS,
    DEFAULT_ACTIONS,
    Actions,
    ActionsLike,
    follows_profile,
    meta_actions_of,
)
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import Bools, Floats, Ints, Scene, SceneSettings, Vehicles
from charms_bench.world.vehicle_types import check_driver_parameters

Ranges = Mapping[str, tuple[float, float]]
"""The parameters of a driver model, and their ranges."""


class RunningEpisodes:
    """What sources, states and planners see of a simulation; its arguments are those."""

    def __init__(
        self,
        settings: SceneSettings,
        scenes: int,
        ego: str | None,
        traffic: Traffic,
        agents: Mapping[str, Agent],
        engine: MakeEngine = BatchedEngine,
        actions: ActionsLike = "meta",
        memory: int = 0,
    ) -> None:
        self.settings = settings
        self.make_engine = engine
        """What has made the engine."""
        self.seeds = np.zeros(scenes, dtype=np.uint64)
        """[B] the episodes' seeds."""
        self.steps = np.zeros(scenes, dtype=np.int64)
        """[B] decisions made."""
        self.ending = np.zeros(scenes, dtype=np.int64)
        """[B] index into `ENDINGS`. A collision is noted in the simulation step of its occurrence,
        every other ending after the decision interval."""
        self.action = np.zeros((scenes, settings.vehicles), dtype=np.int64)
        """[B, N] the last meta-action, an index into those of the vehicle's driver; only meaningful
        where `has_action` is true."""
        self.decided: list[tuple[Vehicles, Actions]] = []
        """What policies have decided in the last simulation step."""
        self.has_action = np.zeros(self.action.shape, dtype=np.bool_)
        """[B, N] whether the vehicle has been given a meta-action; never under a driver model,
        and never with continuous actions."""
        self.collision = np.zeros((scenes, settings.vehicles), dtype=np.int8)
        """[B, N] index into `COLLISIONS`, noted in the simulation step of the collision."""
        self.holds_egos = settings.profile.ego_control_rate == "decision"
        """Whether egos keep their control during a decision interval."""
        self.phase = 0
        """Simulation steps of the current decision interval so far; all scenes share it."""
        self.step_watchers: list[Callable[[], None]] = []
        """Called after every simulation step, before collisions are noted."""
        self.collision_watchers: list[Callable[[], None]] = []
        """Called after a simulation step in which vehicles have collided."""
        self.everyone = np.arange(scenes)
        """[B] the index of each scene."""
        self.traffic = traffic
        self._assigns = not isinstance(traffic, OneAgent)
        """Whether the traffic has to be asked; a plugin that lists one agent may return another."""
        self.egos_end_episodes = "" not in traffic.agents
        """Whether collisions of egos end their episodes, and not time alone."""
        self.ego_agent = ego or ""
        """The name of the agent that drives the egos; empty if they are driven from outside."""
        self.agents = tuple(dict.fromkeys((self.ego_agent, *traffic.agents)))
        """The names of the agents that `engine.drivers` holds indices of, in the order in which
        their driver models act."""
        undriven = ("", PRESCRIBED)
        self.made = {k: agents[name] for k, name in enumerate(self.agents) if name not in undriven}
        """The agents by their index; none for what is driven from outside or prescribed."""
        for k, agent in self.made.items():
            _check_agent(self.agents[k], agent, settings)
        self.policies = {k: each for k, each in self.made.items() if isinstance(each, Policy)}
        """The policies among them."""
        self.models = models = {
            k: _CheckedModel(self.agents[k], agent, self)
            for k, agent in self.made.items()
            if isinstance(agent, DriverModel)
        }
        ranges_of = {self.agents[k]: models[k].parameters if k in models else {} for k in self.made}
        try:
            check_driver_parameters(settings.vehicle_types, ranges_of)
        except ScenarioError as error:
            at = ".".join(map(str, error.location))
            raise InputError(f"scene.{at}: {error}") from error
        self.ranges = {k: model.parameters for k, model in models.items() if model.parameters}
        """The parameters of driver models and their ranges, by the index of the agent."""
        outside = {k: meta_actions_of(actions) for k, name in enumerate(self.agents) if not name}
        self.meta_actions = outside | {
            k: meta_actions_of(policy.actions) for k, policy in self.policies.items()
        }
        """The meta-actions of policies and of what is driven from outside, by the index of the
        agent; none if its actions are continuous."""
        continuous = [k for k, own in self.meta_actions.items() if not own]
        self.own_actions = {
            k: own for k, own in self.meta_actions.items() if own and own != DEFAULT_ACTIONS
        }
        """Those of the agents that have other ones than highway-env's."""
        bound_to_none = (k for k, own in self.own_actions.items() if not follows_profile(own))
        self.unrounded = [*models, *bound_to_none]
        """The agents whose vehicles do not start at one of the profile's target speeds."""
        names = {k: [action.name for action in own] for k, own in self.own_actions.items()}
        self.action_names = tuple(dict.fromkeys([*ACTIONS, *chain(*names.values())]))
        """The names of the meta-actions of all agents; highway-env's come first."""
        self._numbers = {
            k: np.array([self.action_names.index(name) for name in own]) for k, own in names.items()
        }
        self.follow_recording = [k for k, model in models.items() if model.follows_recording]
        """The driver models that drive as recorded."""
        self.kept_widths = {k: kept_width(policy) for k, policy in self.policies.items()}
        """The widths of the memories of policies, by the index of the agent."""
        widths = (*self.kept_widths.values(), *(model.memory_width for model in models.values()))
        memory = max(memory, *widths, 0)
        self.prescribed = [k for k, name in enumerate(self.agents) if name == PRESCRIBED]
        cast = models, continuous, memory, self.prescribed, self.own_actions, self.policies
        self.engine = engine(settings, scenes, Cast(*cast))

    @property
    def scene(self) -> Scene:
        """The state of all scenes."""
        return self.engine.scene

    @property
    def drivers(self) -> NDArray[np.str_]:
        """[B, N] the name of each vehicle's agent; empty for a vehicle driven from outside."""
        return np.asarray(np.array(self.agents)[self.engine.drivers])

    @property
    def named_actions(self) -> Ints:
        """[B, N] the last meta-actions as indices of `action_names`."""
        named = self.action.copy()
        for k, numbers in self._numbers.items():
            its = self.engine.drivers == k
            named[its] = numbers[np.minimum(named[its], numbers.size - 1)]
        return np.minimum(named, len(self.action_names) - 1)

    @property
    def failed(self) -> Bools:
        """[B] whether the ego has collided or left the road, which terminates the episode."""
        ending = self.ending
        return np.asarray((ending != RUNNING) & (ending != TIME) & (ending != GOAL))

    @property
    def truncated(self) -> Bools:
        """[B] whether the episode's time is over."""
        return np.equal(self.ending, TIME, dtype=np.bool_)

    @property
    def is_off_road(self) -> Bools:
        """[B] whether the ego's centre is outside its lane [`RoadObject.on_road`]."""
        return are_off_road(self.scene, *self.ego_vehicles)

    @property
    def ego_vehicles(self) -> Vehicles:
        """The egos (B,) of all scenes."""
        return self.everyone, self.engine.state.ego

    @property
    def frames(self) -> Ints:
        """[B] the simulation steps since the start."""
        return self.steps * self.settings.steps_per_decision + self.phase

    def seats_of(self, stream: int, rows: Ints, count: int) -> Ints:
        """[R, count] the indices of agents that the traffic assigns in the scenes `rows` (R,).

        They are drawn from a random stream of each seed: drivers do not change where vehicles are.
        """
        seats = np.full((rows.size, count), len(self.agents) - 1)
        if not self._assigns:
            return seats
        index = {name: k for k, name in enumerate(self.agents)}
        for r, seed in enumerate(self.seeds[rows].tolist()):
            rng = np.random.default_rng([seed, stream])
            try:
                names = list(map(str, assigned(self.traffic, rng, 1, count)[0]))
            except BrokenWordError as error:
                raise AgentError(f"the traffic, episode {seed}: {error}") from error
            except PLUGIN_ERRORS as error:
                raise AgentError(f"the traffic, episode {seed}: {raised(error)}") from error
            seats[r] = [index[name] for name in names]
        return seats

    def blame(self, name: str, vehicles: Vehicles, what: str, wrong: int = 0) -> AgentError:
        """An agent's error about one of its M vehicles, given by its index."""
        row = vehicles[0][wrong]
        where = f"episode {self.seeds[row]}, step {self.steps[row]}"
        return AgentError(f"agent '{name}', {where}: {what}")


def _check_agent(name: str, agent: Agent, settings: SceneSettings) -> None:
    try:
        check_declared(agent)
        if isinstance(agent, DriverModel):
            return
        if agent.rollouts_with:
            others_of(agent)
        check_road(agent, settings.network is not None)
    except InputError as error:
        raise InputError(f"agent '{name}': {error}") from error
    hz = agent.decision_hz
    steps = settings.simulation_hz / hz if isinstance(hz, Real) and hz > 0 else 0.5
    if not 1 <= steps <= 1e9 or steps != round(steps):
        fitting = settings.simulation_hz_for(float(hz)) if isinstance(hz, Real) else None
        instead = f"; `simulation_hz: {fitting}` in the scene is" if fitting is not None else ""
        raise InputError(
            f"agent '{name}' decides {hz} times per second; simulation_hz "
            f"{settings.simulation_hz} is not a multiple of this rate{instead}"
        )


def _checked_ranges(name: str, model: DriverModel) -> Ranges:
    try:
        ranges = {
            str(key): (float(low), float(high)) for key, (low, high) in model.parameters.items()
        }
    except (AttributeError, TypeError, ValueError):
        ranges = {"": (np.inf, -np.inf)}
    if not all(-np.inf < low <= high < np.inf for low, high in ranges.values()):
        raise InputError(
            f"agent '{name}': its attribute `parameters` is {str(model.parameters)[:80]!r}; "
            "expected ranges by name, such as {'time_headway_s': (0.6, 2.0)}"
        )
    return ranges


class _CheckedModel(DriverModel):
    """Checks what a driver model returns, and passes it on."""

    def __init__(self, name: str, model: DriverModel, episodes: RunningEpisodes) -> None:
        self._name, self._model, self._episodes = name, model, episodes
        self.highway_env_class = model.highway_env_class  # type: ignore[misc]  # the model's
        self.parameters = _checked_ranges(name, model)
        self.memory_width = model.memory_width
        self.follows_recording = model.follows_recording

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        try:
            with np.errstate():  # what a plugin sets is for itself
                answer = self._model.drive(scene, vehicles)
            acceleration, target_lane = np.asarray(answer[0]), np.asarray(answer[1])
            if acceleration.shape == target_lane.shape == vehicles[0].shape:
                acceleration = acceleration.astype(np.float64, copy=False)
        except BrokenWordError as error:
            what = str(error)
            raise self._episodes.blame(self._name, vehicles, what, error.vehicle) from error
        except PLUGIN_ERRORS as error:
            raise self._episodes.blame(self._name, vehicles, raised(error)) from error
        if self.memory_width:
            finite = np.isfinite(scene.memory[vehicles][:, : self.memory_width]).all(axis=1)
            if not finite.all():
                what = "drive left memory that is not finite"
                raise self._episodes.blame(self._name, vehicles, what, int(finite.argmin()))
        shape, lanes, limit = vehicles[0].shape, scene.road.lanes, ACCELERATION_LIMIT_MPS2
        wrong, what = 0, ""
        if acceleration.shape != shape or target_lane.shape != shape:
            what = f"shapes {acceleration.shape} and {target_lane.shape}; expected {shape} twice"
        elif target_lane.dtype.kind not in "iu":
            what = f"lanes of {target_lane.dtype}; expected integers"
        elif (wrong := _first_wrong(acceleration, target_lane, lanes)) >= 0:
            if abs(acceleration[wrong]) <= limit:
                what = f"{target_lane[wrong]}; expected a lane from 0 to {lanes - 1}"
            else:
                what = f"{acceleration[wrong]}; expected an acceleration within ±{limit:g} m/s²"
        if what:
            raise self._episodes.blame(self._name, vehicles, f"drive returned {what}", wrong)
        return acceleration, target_lane


@compiled
def _first_wrong(acceleration: Floats, target_lane: Ints, lanes: int) -> int:
    """The index of the first answer of a driver model that is out of range, or -1."""
    for m in range(acceleration.size):
        in_range = abs(acceleration[m]) <= ACCELERATION_LIMIT_MPS2
        if not (in_range and 0 <= target_lane[m] < lanes):
            return m
    return -1

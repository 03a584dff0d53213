"""B episodes at once: agents decide, an engine moves the vehicles, and each ending is noted."""

from collections.abc import Callable, Mapping
from itertools import chain
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine import EngineName, MakeEngine, make_engine
from charms_bench.engine.collision_kinds import (
    ANY_ANGLE,
    NO_COLLISION,
    REAR_END_COS,
    SIDE_COLLISION,
    are_noted,
    note_collisions,
)
from charms_bench.engine.endings import (
    GOAL,
    REAR_END,
    RUNNING,
    SIDE,
    TIME,
    are_off_road,
    end_episodes,
)
from charms_bench.engine.open_road import OpenRoad
from charms_bench.engine.parameters import Ranges, set_parameters
from charms_bench.engine.playback import Playback
from charms_bench.engine.rollouts import Futures, others_of
from charms_bench.engine.seats import vehicles_of
from charms_bench.engine.state import SceneState, restore, state_of
from charms_bench.errors import (
    PLUGIN_ERRORS,
    AgentError,
    BrokenWordError,
    InputError,
    ScenarioError,
    raised,
)
from charms_bench.foundation.compiled import compiled
from charms_bench.foundation.philox import uniforms
from charms_bench.plugins.agent import ACCELERATION_LIMIT_MPS2, Agent, DriverModel, Policy
from charms_bench.plugins.deciding import Asked, check_declared, decide, kept_width
from charms_bench.plugins.traffic import OneAgent, Traffic, assigned
from charms_bench.world.actions import (
    ACTIONS,
    DEFAULT_ACTIONS,
    Actions,
    ActionsLike,
    meta_actions_of,
    problem_of,
)
from charms_bench.world.observations import observation_of
from charms_bench.world.scenario import PRESCRIBED
from charms_bench.world.scene import Bools, Floats, Ints, Scene, SceneSettings, Vehicles
from charms_bench.world.vehicle_types import check_driver_parameters


class Simulation:
    """B scenes that advance together until each has ended.

    Args:
        settings: What the scenes have in common.
        scenes: B.
        ego: The name of the ego's agent. If None, the actions given to `step` drive the ego.
        traffic: Assigns a driver to each of the other vehicles. A vehicle with an empty name is
            driven by `command`. If there are such vehicles, only time ends an episode.
        agents: All agents that `ego` and `traffic` name, by name.
        engine: `batched` or `highway-env`, or what makes the engine.
        actions: The actions given to `step`, as `Policy.actions`.

    Raises:
        InputError: A policy's rate does not fit the simulation rate, or its observation or its kind
            of actions does not exist.
    """

    def __init__(
        self,
        settings: SceneSettings,
        scenes: int,
        ego: str | None,
        traffic: Traffic,
        agents: Mapping[str, Agent],
        engine: EngineName | MakeEngine = "batched",
        actions: ActionsLike = "meta",
    ) -> None:
        self.settings = settings
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
        self._traffic = traffic
        self._assigns = not isinstance(traffic, OneAgent)
        """Whether the traffic has to be asked; a plugin that lists one agent may return another."""
        self._egos_end_episodes = "" not in traffic.agents
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
        self._policies = {k: each for k, each in self.made.items() if isinstance(each, Policy)}
        models = {
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
            k: meta_actions_of(policy.actions) for k, policy in self._policies.items()
        }
        """The meta-actions of policies and of what is driven from outside, by the index of the
        agent; none if its actions are continuous."""
        continuous = [k for k, own in self.meta_actions.items() if not own]
        self.own_actions = {
            k: own for k, own in self.meta_actions.items() if own and own != DEFAULT_ACTIONS
        }
        """Those of the agents that have other ones than highway-env's."""
        names = {k: [action.name for action in own] for k, own in self.own_actions.items()}
        self.action_names = tuple(dict.fromkeys([*ACTIONS, *chain(*names.values())]))
        """The names of the meta-actions of all agents; highway-env's come first."""
        self._numbers = {
            k: np.array([self.action_names.index(name) for name in own]) for k, own in names.items()
        }
        self._follows_recording = [k for k, model in models.items() if model.follows_recording]
        self._kept_widths = {k: kept_width(policy) for k, policy in self._policies.items()}
        widths = (*self._kept_widths.values(), *(model.memory_width for model in models.values()))
        memory = max(widths, default=0)
        prescribed = [k for k, name in enumerate(self.agents) if name == PRESCRIBED]
        self.engine = make_engine(
            engine, settings, scenes, models, continuous, memory, prescribed, self.own_actions
        )
        self._futures = {
            k: Futures(self, policy) for k, policy in self._policies.items() if policy.rollouts_with
        }
        if settings.inflow and not self._egos_end_episodes:
            raise InputError(
                "scene.inflow: vehicles that enter need a driver; expected an ego only"
            )
        if settings.recording and not self._egos_end_episodes:
            raise InputError(
                "scene.recording: recorded vehicles that come and go cannot be driven from "
                "outside; expected an ego only"
            )
        self._open_road = OpenRoad(self) if settings.inflow else None
        self.playback: Playback | None = None
        """Has recorded vehicles come, move and go, in scenes of recordings."""
        if settings.recording is not None:
            self.playback = Playback(self, traffic.after_deviation)

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
        return self.everyone, self.scene.ego

    def reset(
        self, seeds: NDArray[np.uint64], rows: Ints | None = None, draws: Floats | None = None
    ) -> None:
        """Starts an episode in each of the scenes `rows`; by default, in all scenes.

        If `draws` (R, 4 N + 1) are given, vehicles are placed by them (see `engine.draws`), and the
        seeds only decide what the traffic, types and drivers' parameters draw.
        """
        rows = np.arange(self.seeds.size) if rows is None else rows
        self.seeds[rows] = seeds
        others = self.settings.vehicles - 1
        index = {name: k for k, name in enumerate(self.agents)}
        drivers = np.full((rows.size, 1 + others), len(self.agents) - 1)
        drivers[:, 0] = self.agents.index(self.ego_agent)
        for r, seed in enumerate(seeds if self._assigns else ()):
            # Its own random stream: the drivers do not change where vehicles start.
            rng = np.random.default_rng([int(seed), 1])
            drivers[r, 1:] = [index[name] for name in self._assigned(rng, int(seed), others)]
        if self.settings.recording is None:
            for k in self._follows_recording:
                if (drivers == k).any():
                    raise InputError(
                        f"agent '{self.agents[k]}' drives as recorded; give the scene recordings"
                    )
        self.scene.present[rows] = True
        self.scene.entry[rows] = np.arange(self.settings.vehicles)
        if self.playback is not None:
            self.playback.start(rows, seeds, drivers)
        else:
            self.engine.reset(rows, seeds, drivers, draws)
        if self._open_road is not None:
            self._open_road.empty(rows)
            self._schedule(rows)
        set_parameters(self, rows)
        self.scene.memory[rows] = 0.0
        self.scene.repeats[rows] = 0
        self.steps[rows] = 0
        self.ending[rows] = RUNNING
        self.phase = 0
        self.collision[rows] = NO_COLLISION
        self.has_action[rows] = False

    def _assigned(self, rng: np.random.Generator, seed: int, others: int) -> list[str]:
        """The names of the agents of an episode's other vehicles."""
        try:
            return list(map(str, assigned(self._traffic, rng, 1, others)[0]))
        except BrokenWordError as error:
            raise AgentError(f"the traffic, episode {seed}: {error}") from error
        except PLUGIN_ERRORS as error:
            raise AgentError(f"the traffic, episode {seed}: {raised(error)}") from error

    def state(self, rows: Ints | None = None) -> SceneState:
        """Saves the scenes `rows`, at any simulation step; by default, all scenes."""
        return state_of(self, self.everyone if rows is None else rows)

    def restore(self, state: SceneState, rows: Ints | None = None) -> None:
        """Continues the scenes of a state in the scenes `rows`; by default, in all scenes.

        Raises:
            InputError: The state does not fit; see `engine.state.restore`.
        """
        rows = self.everyone if rows is None else rows
        restore(self, state, rows)
        self._schedule(rows)

    def _schedule(self, rows: Ints) -> None:
        """Draws the vehicles that will enter the scenes `rows`, and their drivers."""
        if self._open_road is None:
            return
        index, most = {name: k for k, name in enumerate(self.agents)}, self._open_road.most
        agents = np.full((rows.size, most), len(self.agents) - 1)
        for r, seed in enumerate(self.seeds[rows] if self._assigns else ()):
            rng = np.random.default_rng([int(seed), 7])
            agents[r] = [index[name] for name in self._assigned(rng, int(seed), most)]
        self._open_road.schedule(rows, agents)

    def step(self, ego_actions: Actions | None = None) -> None:
        """Advances every running episode to the end of its decision interval.

        `ego_actions` are the meta-actions (B,), or the continuous actions (B, 2), of egos driven
        from outside; they take effect at the beginning of an interval.
        """
        for frame in range(self.phase, self.settings.steps_per_decision):
            self.advance(ego_actions if frame == 0 else None)
        self.finish_step()

    def advance(self, ego_actions: Actions | None = None) -> None:
        """Advances every running episode by one simulation step."""
        active = self.scene.active
        if ego_actions is not None:
            rows = np.nonzero(active)[0]
            self.command((rows, self.scene.ego[rows]), ego_actions[rows])
        self.decided = []  # all policies see the scene before any action is carried out
        for agent, policy in self._policies.items():
            period = round(self.settings.simulation_hz / policy.decision_hz)
            if self.settings.steps_per_decision % period == 0 and self.phase % period:
                continue  # quicker than to look at every scene
            frames = self.steps * self.settings.steps_per_decision + self.phase
            now = active & (frames % period == 0)
            vehicles = vehicles_of(
                agent, self.engine.drivers, now, self.engine.occupied, self.scene.entry
            )
            if vehicles[0].size:
                number = (frames // period)[vehicles[0]].astype(np.uint64)
                self.decided.append((vehicles, self._decide(agent, policy, vehicles, number)))
        for whose, actions in self.decided:
            self.command(whose, actions)
        put = None if self.playback is None else self.playback.before_step()
        self.engine.advance(hold_egos=self.holds_egos and self.phase > 0, put=put)
        self.phase += 1
        for watch in self.step_watchers:
            watch()
        self._note_collisions()
        if self._open_road is not None:
            self._open_road.pass_boundaries()
        if self.playback is not None:
            self.playback.after_step()

    def finish_step(self) -> None:
        """Counts the decision interval and ends the episodes that are over."""
        self.phase = 0
        if self._open_road is not None:
            self._open_road.end_at_the_end()
        ends_off_road = self.settings.profile.offroad_terminal and self._egos_end_episodes
        decisions, goals = self.settings.decisions, self.engine.goals
        end_episodes(self.scene, decisions, ends_off_road, goals, self.steps, self.ending)

    def command(self, vehicles: Vehicles, actions: Actions) -> None:
        """Gives M vehicles their meta-actions (M,), or their continuous actions (M, 2)."""
        self.engine.command(vehicles, actions)
        if actions.ndim == 1:
            self.action[vehicles] = actions
            self.has_action[vehicles] = True

    def _decide(
        self, agent: int, policy: Policy, vehicles: Vehicles, number: NDArray[np.uint64]
    ) -> Actions:
        """The actions of M vehicles, in their decisions `number` (M,)."""
        name = self.agents[agent]
        kept: Any = (*vehicles, slice(self._kept_widths[agent]))
        noise = np.empty((vehicles[0].size, 0))
        if policy.noise_draws:
            identity = self.scene.entry[vehicles].astype(np.uint64)
            noise = uniforms(self.seeds[vehicles[0]], number, identity, policy.noise_draws)
        rollouts = self._futures[agent].of(vehicles) if policy.rollouts_with else None
        try:
            with np.errstate():  # what a plugin sets is for itself
                observations = observation_of(policy.observation)(*self.engine.seen_by(vehicles))
                asked = Asked(observations, self.scene.memory[kept], noise, rollouts)
                actions, self.scene.memory[kept] = decide(policy, asked)
        except BrokenWordError as error:
            raise self.blame(name, vehicles, str(error), error.vehicle) from error
        except PLUGIN_ERRORS as error:
            raise self.blame(name, vehicles, raised(error)) from error
        what, wrong = problem_of(actions, policy.actions, vehicles[0].size)
        if what:
            raise self.blame(name, vehicles, f"decide returned {what}", wrong)
        return actions.copy()  # the policy may keep the array, and change it

    def blame(self, name: str, vehicles: Vehicles, what: str, wrong: int = 0) -> AgentError:
        """An agent's error about one of its M vehicles, given by its index."""
        row = vehicles[0][wrong]
        return AgentError(
            f"agent '{name}', episode {self.seeds[row]}, step {self.steps[row]}: {what}"
        )

    def _note_collisions(self) -> None:
        """Notes how vehicles have just collided, before the wrecks move on."""
        scene = self.scene
        if are_noted(scene.crashed, self.collision):
            return
        least_cos = ANY_ANGLE if self.settings.network is None else REAR_END_COS
        note_collisions(scene, self.collision, least_cos)
        for watch in self.collision_watchers:
            watch()
        if not self._egos_end_episodes:
            return
        of_egos = self.collision[self.ego_vehicles]
        has_collided = (self.ending == RUNNING) & (of_egos != NO_COLLISION)
        self.ending[has_collided] = REAR_END
        self.ending[has_collided & (of_egos == SIDE_COLLISION)] = SIDE


def _check_agent(name: str, agent: Agent, settings: SceneSettings) -> None:
    try:
        check_declared(agent)
        if isinstance(agent, DriverModel):
            return
        if agent.rollouts_with:
            others_of(agent)
    except InputError as error:
        raise InputError(f"agent '{name}': {error}") from error
    hz = agent.decision_hz
    steps = settings.simulation_hz / hz if isinstance(hz, Real) and hz > 0 else 0.5
    if not 1 <= steps <= 1e9 or steps != round(steps):
        fitting = settings.simulation_hz_for(float(hz)) if isinstance(hz, Real) else None
        raise InputError(
            f"agent '{name}' decides {hz} times per second; simulation_hz "
            f"{settings.simulation_hz} is not a multiple of this rate"
            + f"; `simulation_hz: {fitting}` in the scene is"
            * (fitting is not None)
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

    def __init__(self, name: str, model: DriverModel, simulation: Simulation) -> None:
        self._name, self._model, self._simulation = name, model, simulation
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
            raise self._simulation.blame(self._name, vehicles, what, error.vehicle) from error
        except PLUGIN_ERRORS as error:
            raise self._simulation.blame(self._name, vehicles, raised(error)) from error
        if self.memory_width:
            finite = np.isfinite(scene.memory[vehicles][:, : self.memory_width]).all(axis=1)
            if not finite.all():
                what = "drive left memory that is not finite"
                raise self._simulation.blame(self._name, vehicles, what, int(finite.argmin()))
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
            raise self._simulation.blame(self._name, vehicles, f"drive returned {what}", wrong)
        return acceleration, target_lane


@compiled
def _first_wrong(acceleration: Floats, target_lane: Ints, lanes: int) -> int:
    """The index of the first answer of a driver model that is out of range, or -1."""
    for m in range(acceleration.size):
        in_range = abs(acceleration[m]) <= ACCELERATION_LIMIT_MPS2
        if not (in_range and 0 <= target_lane[m] < lanes):
            return m
    return -1

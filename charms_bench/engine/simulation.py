"""B episodes at once: agents decide, an engine moves the vehicles, and each ending is noted."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.collision_kinds import (
    ANY_ANGLE,
    NO_COLLISION,
    REAR_END_COS,
    SIDE_COLLISION,
    are_noted,
    note_collisions,
)
from charms_bench.engine.crossing import Crossing
from charms_bench.engine.endings import REAR_END, RUNNING, SIDE, end_episodes
from charms_bench.engine.open_road import Inflow
from charms_bench.engine.parameters import set_parameters
from charms_bench.engine.playback import Recorded, RecordedOnRoad
from charms_bench.engine.prescribed import Placed
from charms_bench.engine.rollouts import Futures
from charms_bench.engine.running import RunningEpisodes
from charms_bench.engine.seats import vehicles_of
from charms_bench.engine.source import Drawn, Source
from charms_bench.engine.state import SceneState, restore, state_of
from charms_bench.engine.stepping import Put
from charms_bench.errors import PLUGIN_ERRORS, BrokenWordError, InputError, raised
from charms_bench.foundation.philox import uniforms
from charms_bench.plugins.agent import Agent, Policy
from charms_bench.plugins.deciding import Asked, decide
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.actions import Actions, ActionsLike, problem_of
from charms_bench.world.observations import observation_of
from charms_bench.world.scene import Floats, Ints, SceneSettings, Vehicles


class Simulation(RunningEpisodes):
    """B scenes that advance together until each has ended.

    Args:
        settings: What the scenes have in common.
        scenes: B.
        ego: The name of the ego's agent. If None, the actions given to `step` drive the ego.
        traffic: Assigns a driver to each of the other vehicles. A vehicle with an empty name is
            driven by `command`. If there are such vehicles, only time ends an episode.
        agents: All agents that `ego` and `traffic` name, by name.
        engine: what makes the engine; by default that of the straight road.
        actions: The actions given to `step`, as `Policy.actions`.
        memory: How many numbers the scenes keep of each vehicle, at least.

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
        engine: MakeEngine = BatchedEngine,
        actions: ActionsLike = "meta",
        memory: int = 0,
    ) -> None:
        super().__init__(settings, scenes, ego, traffic, agents, engine, actions, memory)
        self._futures = {
            k: Futures(self, policy) for k, policy in self.policies.items() if policy.rollouts_with
        }
        self.sources = sources_of(self)
        """Where vehicles come from, in the order in which the sources act."""

    def reset(
        self, seeds: NDArray[np.uint64], rows: Ints | None = None, draws: Floats | None = None
    ) -> None:
        """Starts an episode in each of the scenes `rows`; by default, in all scenes.

        If `draws` (R, D) are given, vehicles are placed by them (see `engine.draws`), and the
        seeds only decide what the traffic, types and drivers' parameters draw.
        """
        rows = np.arange(self.seeds.size) if rows is None else rows
        if self.engine.egos > 1 and not self.ego_agent:
            raise InputError(
                f"{self.engine.egos} egos drive on the road '{self.settings.network}', and Ego-v0 "
                "has one; your program drives several in RoadParallelEnv"
            )
        self.seeds[rows] = seeds
        seats = np.empty((rows.size, self.settings.vehicles), dtype=np.int64)
        seats[:, 0] = self.agents.index(self.ego_agent)
        seats[:, 1:] = self.seats_of(1, rows, self.settings.vehicles - 1)
        seats[:, : self.engine.egos] = seats[:, :1]
        if not self.settings.is_recorded:
            for k in self.follow_recording:
                if (seats == k).any():
                    raise InputError(
                        f"agent '{self.agents[k]}' drives as recorded; give the scene recordings"
                    )
        self.scene.present[rows] = True
        self.scene.entry[rows] = np.arange(self.settings.vehicles)
        for source in self.sources:
            source.start(rows, seats, draws)
        set_parameters(self, rows)
        self.scene.memory[rows] = 0.0
        self.scene.repeats[rows] = 0
        self.steps[rows] = 0
        self.ending[rows] = RUNNING
        self.phase = 0
        self.collision[rows] = NO_COLLISION
        self.has_action[rows] = False

    def state(self, rows: Ints | None = None) -> SceneState:
        """Saves the scenes `rows`, at any simulation step; by default, all scenes."""
        return state_of(self, self.everyone if rows is None else rows)

    def restore(self, state: SceneState, rows: Ints | None = None) -> None:
        """Continues the scenes of a state in the scenes `rows`; by default, in all scenes.

        Raises:
            InputError: The state does not fit; see `engine.state.restore`.
        """
        rows = self.everyone if rows is None else rows
        restore(self, self.sources, state, rows)

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
        state = self.engine.state
        if ego_actions is not None:
            rows = np.nonzero(state.active)[0]
            self.command((rows, state.ego[rows]), ego_actions[rows])
        self.decided = []  # all policies see the scene before any action is carried out
        for agent, policy in self.policies.items():
            period = round(self.settings.simulation_hz / policy.decision_hz)
            if self.settings.steps_per_decision % period == 0 and self.phase % period:
                continue  # quicker than to look at every scene
            frames = self.frames
            now = state.active & (frames % period == 0)
            vehicles = vehicles_of(agent, self.engine.drivers, now, state.present, state.entry)
            if vehicles[0].size:
                number = (frames // period)[vehicles[0]].astype(np.uint64)
                self.decided.append((vehicles, self._decide(agent, policy, vehicles, number)))
        for whose, actions in self.decided:
            self.command(whose, actions)
        for source in self.sources:
            source.before_step()
        self.engine.advance(self.holds_egos and self.phase > 0, self._before_move)
        self.phase += 1
        for watch in self.step_watchers:
            watch()
        self._note_collisions()
        for source in self.sources:
            source.after_step()

    def _before_move(self) -> Put | None:
        """Where the step ends for the vehicles of the source that says it."""
        put = None
        for source in self.sources:
            put = source.before_move() or put
        return put

    def finish_step(self) -> None:
        """Counts the decision interval and ends the episodes that are over."""
        self.phase = 0
        for source in self.sources:
            source.after_decision()
        ends_off_road = self.settings.profile.offroad_terminal and self.egos_end_episodes
        decisions, goals = self.settings.decisions, self.engine.goals & self.egos_end_episodes
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
        kept: Any = (*vehicles, slice(self.kept_widths[agent]))
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

    def _note_collisions(self) -> None:
        """Notes how vehicles have just collided, before the wrecks move on."""
        if are_noted(self.engine.state.crashed, self.collision):
            return
        least_cos = ANY_ANGLE if self.settings.network is None else REAR_END_COS
        note_collisions(self.scene, self.collision, least_cos)
        for watch in self.collision_watchers:
            watch()
        if not self.egos_end_episodes:
            return
        of_egos = self.collision[self.ego_vehicles]
        has_collided = (self.ending == RUNNING) & (of_egos != NO_COLLISION)
        self.ending[has_collided] = REAR_END
        self.ending[has_collided & (of_egos == SIDE_COLLISION)] = SIDE


def sources_of(episodes: RunningEpisodes) -> tuple[Source, ...]:
    """The sources that the settings of episodes name, in the order in which they act.

    Raises an `InputError` if vehicles of one that need drivers are driven from outside.
    """
    settings = episodes.settings
    if settings.scenario is not None and settings.network is None:
        return (Placed(episodes),)
    if settings.recording is not None:
        return (Recorded(episodes),)
    if episodes.engine.moments is not None:
        return (RecordedOnRoad(episodes), Crossing(episodes))
    if episodes.engine.renewal_steps:
        return (Drawn(episodes), Crossing(episodes))
    return (Drawn(episodes), Inflow(episodes)) if settings.inflow else (Drawn(episodes),)

"""Episodes as a `gymnasium.vector.VectorEnv`: the actions given to `step` drive the egos."""

from collections.abc import Mapping
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from charms_bench.engine.endings import RUNNING
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.envs.rendering import RENDER_MODES, Renderer
from charms_bench.envs.torch_threads import warn_of_torch_threads
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.action_mask import ActionMasks, action_masks
from charms_bench.world.actions import ACTIONS, CONTROLS, ActionKind, Actions, problem_of
from charms_bench.world.observations import (
    EGO,
    SPEED_SCALE_MPS,
    Y_SCALE_M,
    Neighbours,
    Observation,
    neighbours,
)
from charms_bench.world.scene import Bools, Floats, Ints, Observations, SceneSettings

C = TypeVar("C")


class Reward(Protocol[C]):
    """The reward of a decision. It keeps no state; `prepare` returns what it needs, of type C."""

    def prepare(self, simulation: Simulation, actions: Actions) -> C:
        """What to remember of the scene before the egos' actions are carried out."""

    def __call__(self, simulation: Simulation, prepared: C) -> Floats:
        """The rewards (B,) after the decision interval, before ended episodes restart."""


class EpisodesState(NamedTuple):
    """The state of every running episode, and the environment's counters."""

    scenes: SceneState
    returns: Floats
    """[B] sums of the rewards so far."""
    next_seed: int


def spaces_of(
    settings: SceneSettings, observation: Observation = neighbours, kind: ActionKind = "meta"
) -> tuple[spaces.Space[Any], spaces.Space[Any]]:
    """Gymnasium's spaces of the ego's observations and actions.

    In `neighbours` and `paper_neighbours`, the rows of other vehicles and an action mask are within
    [-1, 1]. The bounds of the ego's position across the road and of its velocity are twice the
    values that occur while it drives; with continuous actions, its position has no bounds. Other
    observations have no bounds, as in highway-env.
    """
    actions: spaces.Space[Any] = spaces.Discrete(len(ACTIONS))
    if kind == "continuous":
        actions = spaces.Box(-1.0, 1.0, (len(CONTROLS),), np.float32)
    if not isinstance(observation, Neighbours):
        return spaces.Box(-np.inf, np.inf, observation.shape, np.float32), actions
    profile = settings.profile
    targets = (profile.target_speed_max_mps, *profile.target_speeds_mps)
    fastest = max(profile.speed_max_mps, -profile.speed_min_mps, profile.ego_speed_mps, *targets)
    high = np.ones(observation.shape, dtype=np.float32)
    high[EGO, 2] = 2 * settings.lanes * profile.lane_width_m / Y_SCALE_M
    if kind == "continuous":
        high[EGO, 2] = np.inf
    high[EGO, 3:] = 2 * fastest / SPEED_SCALE_MPS
    return spaces.Box(-high, high, dtype=np.float32), actions


def state_in(options: dict[str, Any] | None) -> SceneState | None:
    """The option `state` of `reset`.

    Raises:
        InputError: There is another option, or it is not a state.
    """
    options = options or {}
    if unknown := sorted(options.keys() - {"state"}):
        raise InputError(f"reset takes the option 'state', got {', '.join(unknown)}")
    state = options.get("state")
    if state is not None and not isinstance(state, SceneState):
        found = type(state).__name__
        raise InputError(f"reset: expected a SceneState as the option 'state', found {found}")
    return state


def check_actions(actions: NDArray[Any], kind: ActionKind, egos: int) -> None:
    """Refuses arrays that are not actions of B egos.

    Raises:
        InputError: The shape or the type is wrong, or an action is out of range.
    """
    what, wrong = problem_of(actions, kind, egos)
    if what:
        meaning = ", ".join(ACTIONS if kind == "meta" else CONTROLS)
        raise InputError(f"step: ego {wrong}: {what}: {meaning}")


def continue_from(simulation: Simulation, state: SceneState) -> None:
    """Continues all scenes of a simulation whose egos are driven from outside.

    Raises:
        InputError: It is not a `SceneState`, it does not fit, or its scenes are not between two
            decisions.
    """
    if not isinstance(state, SceneState):
        raise InputError(f"found {type(state).__name__}, expected a SceneState")
    if state.phase:
        raise InputError(
            f"the state was saved {state.phase} simulation steps after a decision; an environment "
            "continues states between two decisions"
        )
    if not state.active.all():
        ended = state.seeds[~state.active][0]
        raise InputError(f"the state of episode {ended} was saved after the episode had ended")
    simulation.restore(state.seated(state.ego, ""))


def mask_infos(masks: ActionMasks) -> dict[str, Any]:
    """Gymnasium's infos with the action masks (E, 5) of E environments."""
    return {"action_mask": masks, "_action_mask": np.ones(len(masks), dtype=np.bool_)}


def final_infos(
    ended: Bools, observations: Observations, values: Mapping[str, NDArray[Any]]
) -> dict[str, Any]:
    """Gymnasium's infos about the environments (E,) whose episodes ended in this step.

    Args:
        ended: Which have ended.
        observations: (E, rows, columns) the last ones.
        values: The facts in `final_info`, (E,) each.
    """
    final_obs = np.full(ended.size, None, dtype=object)
    for row in np.nonzero(ended)[0]:
        final_obs[row] = observations[row].copy()
    final_info = {name: np.where(ended, every, 0) for name, every in values.items()}
    final_info |= {f"_{name}": ended.copy() for name in values}
    final = {"final_obs": final_obs, "final_info": final_info}
    return final | {f"_{name}": ended.copy() for name in final}


class HighwayVectorEnv(VectorEnv[Observations, Actions, NDArray[Any]], Generic[C]):
    """B episodes side by side; when one ends, the next starts within the same step.

    An episode terminates when the ego collides or leaves the road, and is truncated when its time
    is over. The k-th episode to start has the seed `first_seed + k`.

    Args:
        settings: What the scenes have in common.
        scenes: B.
        traffic: Assigns a driver to each of the other vehicles.
        agents: All agents that `traffic` names, by name.
        reward: The reward of a decision.
        first_seed: The first episode's seed, unless a seed is given to `reset`.
        observation: The egos' observation.
        actions: The kind of the egos' actions.
        render_mode: `rgb_array` or `human`; see `render`.

    Raises:
        InputError: There is no such render mode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # gymnasium's declaration
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": RENDER_MODES,
    }
    autoreset_mode = AutoresetMode.SAME_STEP
    """As the attribute of Gymnasium's own vector environments, which TorchRL reads."""

    def __init__(
        self,
        settings: SceneSettings,
        scenes: int,
        traffic: Traffic,
        agents: Mapping[str, Agent],
        reward: Reward[C],
        first_seed: int = 0,
        observation: Observation = neighbours,
        actions: ActionKind = "meta",
        render_mode: str | None = None,
    ) -> None:
        self.num_envs = scenes
        spaces_of_one = spaces_of(settings, observation, actions)
        self.single_observation_space, self.single_action_space = spaces_of_one
        self.observation_space = batch_space(self.single_observation_space, scenes)
        self.action_space = batch_space(self.single_action_space, scenes)
        self.simulation = Simulation(settings, scenes, None, traffic, agents, actions=actions)
        self._kind = actions
        self._reward = reward
        self._observation = observation
        self._next_seed = first_seed
        self._returns = np.zeros(scenes)
        self._renderer = Renderer(self.simulation, render_mode)
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": settings.decision_hz}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Starts an episode in every scene.

        Args:
            seed: The first episode's seed; None continues with the next unused seed.
            options: `state`, a `SceneState` of B running scenes in which the episodes start.

        Returns:
            Observations and infos; with meta-actions, these have the `action_mask`; see `step`.

        Raises:
            InputError: There is another option, or the state does not fit.
        """
        warn_of_torch_threads()
        super().reset(seed=seed)
        if seed is not None:
            self._next_seed = seed
        if (state := state_in(options)) is None:
            self._start(np.arange(self.num_envs))
        else:
            continue_from(self.simulation, state)
            self._returns[:] = 0
        self._renderer.show()
        return self._observe(), self._infos()

    def step(self, actions: Actions) -> tuple[Observations, Floats, Bools, Bools, dict[str, Any]]:
        """Carries out the egos' actions, (B,) or continuous (B, 2), for one decision interval.

        Returns:
            Observations (B, rows, columns), rewards (B,), terminations (B,), truncations (B,), and
            infos. With meta-actions, these have the `action_mask` (B, 5) of the next step; see
            `world.action_mask`. They also have the `final_obs` and the `final_info` of the episodes
            that ended: `ending` (an index into `engine.simulation.ENDINGS`), `steps`,
            `episode_return` and `seed`.

        Raises:
            InputError: The actions have another shape or type, or one is out of range.
        """
        check_actions(actions, self._kind, self.num_envs)
        simulation = self.simulation
        prepared = self._reward.prepare(simulation, actions)
        simulation.step(actions)
        self._renderer.show()
        rewards = self._reward(simulation, prepared)
        self._returns += rewards
        terminations, truncations = simulation.failed, simulation.truncated
        observations = self._observe()
        infos: dict[str, Any] = {}
        ended = simulation.ending != RUNNING
        rows = np.nonzero(ended)[0]
        if rows.size:
            values: dict[str, NDArray[Any]] = {
                "ending": simulation.ending,
                "steps": simulation.steps,
                "episode_return": self._returns,
                "seed": simulation.seeds,
            }
            infos = final_infos(ended, observations, values)
            self._start(rows)
            started = (rows, simulation.scene.ego[rows])
            observations[rows] = self._observation(simulation.scene, started)
        return observations, rewards, terminations, truncations, infos | self._infos()

    def action_masks(self) -> Bools:
        """The action masks (B, 5) of the egos, as sb3-contrib's `MaskablePPO` asks for them."""
        simulation = self.simulation
        return action_masks(simulation.scene, simulation.ego_vehicles).astype(np.bool_)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The scenes as animations of replays draw them, B times (height, width, 3), if asked for.

        Where an episode has just ended, this is the start of the next one. In the render mode
        `human`, `reset` and `step` show the first scenes in a window after each decision, in real
        time and with the ends of their episodes, and nothing is returned.

        Raises:
            InputError: There is no display for the window.
        """
        return self._renderer.render()

    def close_extras(self, **_: Any) -> None:
        """Closes the window."""
        self._renderer.close()

    def get_state(self) -> EpisodesState:
        """The state of every episode, for `set_state`."""
        return EpisodesState(self.simulation.state(), self._returns.copy(), self._next_seed)

    def set_state(self, state: EpisodesState) -> Observations:
        """Continues as after `get_state`; returns the egos' observations.

        Raises:
            InputError: The state does not fit.
        """
        if not isinstance(state, EpisodesState):
            raise InputError(
                f"found {type(state).__name__}, expected an EpisodesState; a SceneState continues "
                'with reset(options={"state": state})'
            )
        continue_from(self.simulation, state.scenes)
        self._returns[:] = state.returns
        self._next_seed = state.next_seed
        return self._observe()

    def _start(self, rows: Ints) -> None:
        seeds = np.arange(self._next_seed, self._next_seed + rows.size, dtype=np.uint64)
        self._next_seed += rows.size
        self._returns[rows] = 0
        self.simulation.reset(seeds, rows)

    def _observe(self) -> Observations:
        return self._observation(self.simulation.scene, self.simulation.ego_vehicles)

    def _infos(self) -> dict[str, Any]:
        """The infos of every step; continuous actions have no mask."""
        if self._kind != "meta":
            return {}
        return mask_infos(action_masks(self.simulation.scene, self.simulation.ego_vehicles))

"""Episodes as a `gymnasium.vector.VectorEnv`: the actions given to `step` drive the learners."""

from collections.abc import Mapping
from typing import Any, Generic, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.envs.learners import C, Learners, Reward
from charms_bench.envs.rendering import RENDER_MODES
from charms_bench.envs.torch_threads import warn_of_torch_threads
from charms_bench.errors import InputError
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.action_mask import ActionMasks, action_masks
from charms_bench.world.actions import ActionKind, Actions
from charms_bench.world.observations import Observation, neighbours
from charms_bench.world.scene import Bools, Floats, Ints, Observations, SceneSettings, Vehicles


class EpisodesState(NamedTuple):
    """The state of every running episode, and the environment's counters."""

    scenes: SceneState
    returns: Floats
    """[B] sums of the rewards so far."""
    next_seed: int


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


class ScenesVectorEnv(VectorEnv[Observations, Actions, NDArray[Any]]):
    """B scenes with L learners each, as B L environments; those of the first scene come first.

    When no learner of a scene is left, the next scene starts within the same step. Until then, the
    observations of learners that have left are zeros, their rewards are 0, and their actions have
    no effect. The k-th scene to start has the seed `first_seed + k`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # gymnasium's declaration
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": RENDER_MODES,
    }
    autoreset_mode = AutoresetMode.SAME_STEP
    """As the attribute of Gymnasium's own vector environments, which TorchRL reads."""

    def __init__(self, learners: Learners, first_seed: int) -> None:
        self._learners, self._next_seed = learners, first_seed
        self.num_envs = learners.returns.size
        self.single_observation_space, self.single_action_space = learners.spaces
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.simulation: Simulation = learners.simulation
        self.render_mode = learners.renderer.mode
        self.metadata = {**self.metadata, "render_fps": self.simulation.settings.decision_hz}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Starts an episode in every scene.

        Args:
            seed: The first episode's seed; None continues with the next unused seed.
            options: If the egos are the only learners, `state`, a `SceneState` of B running scenes
                in which the episodes start.

        Returns:
            Observations and infos; with meta-actions, these have the `action_mask`; see `step`.

        Raises:
            InputError: There is another option, or the state does not fit.
        """
        warn_of_torch_threads()
        super().reset(seed=seed)
        if seed is not None:
            self._next_seed = seed
        learners = self._learners
        if options and len(learners.numbers) > 1:
            raise InputError(f"reset takes no options, got {', '.join(map(str, options))}")
        if (state := state_in(options)) is None:
            self._start(np.arange(self.simulation.seeds.size))
        else:
            learners.restore(state)
        learners.renderer.show()
        return self._observe(learners.vehicles, learners.alive), self._infos()

    def step(self, actions: Actions) -> tuple[Observations, Floats, Bools, Bools, dict[str, Any]]:
        """Carries out the actions, (B L,) or continuous (B L, 2), for one decision interval.

        Returns:
            Observations (B L, rows, columns), rewards (B L,), terminations (B L,), truncations
            (B L,), and infos. With meta-actions, these have the `action_mask` (B L, 5) of the next
            step; see `world.action_mask`. They also have the `final_obs` and the `final_info` of
            the learners whose episodes ended: `ending` (an index into
            `engine.simulation.ENDINGS`), `steps`, `episode_return` and the scene's `seed`.

        Raises:
            InputError: The actions have another shape or type, or one is out of range.
        """
        learners, simulation = self._learners, self.simulation
        vehicles, drove = learners.vehicles, learners.alive
        rewards, terminations, truncations, endings = learners.step(actions)
        observations = self._observe(vehicles, drove)
        infos: dict[str, Any] = {}
        ended = terminations | truncations
        if (rows := np.nonzero(ended)[0]).size:
            final_obs = np.full(ended.size, None, dtype=object)
            for row in rows:
                final_obs[row] = observations[row].copy()
            facts = {
                "ending": endings,
                "steps": simulation.steps[learners.scene_of],
                "episode_return": learners.returns,
                "seed": simulation.seeds[learners.scene_of],
            }
            final_info = {name: np.where(ended, every, 0) for name, every in facts.items()}
            final_info |= {f"_{name}": ended.copy() for name in facts}
            infos = {"final_obs": final_obs, "final_info": final_info}
            infos |= {f"_{name}": ended.copy() for name in infos}
            observations[rows] = 0.0
            driven = learners.alive.reshape(simulation.seeds.size, -1)
            if (over := np.nonzero(~driven.any(axis=1))[0]).size:
                self._start(over)
                first = learners.of_scenes(over)
                started = learners.scene_of[first], learners.places[first]
                observations[first] = learners.observation(simulation.scene, started)
        infos |= self._infos()
        return observations, rewards, terminations, truncations, infos

    def action_masks(self) -> Bools:
        """The action masks (B L, 5), as sb3-contrib's `MaskablePPO` asks for them."""
        return self._masks().astype(np.bool_)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The scenes as animations of replays draw them, B times (height, width, 3), if asked for.

        Where an episode has just ended, this is the start of the next one. In the render mode
        `human`, `reset` and `step` show the first scenes in a window after each decision, in real
        time and with the ends of their episodes, and nothing is returned.

        Raises:
            InputError: There is no display for the window.
        """
        return self._learners.renderer.render()

    def close_extras(self, **_: Any) -> None:
        """Closes the window."""
        self._learners.renderer.close()

    def _start(self, rows: Ints) -> None:
        seeds = np.arange(self._next_seed, self._next_seed + rows.size, dtype=np.uint64)
        self._next_seed += rows.size
        self._learners.reset(seeds, rows)

    def _observe(self, vehicles: Vehicles, alive: Bools) -> Observations:
        """The observations (B L, rows, columns), zeros where `alive` (B L,) is false."""
        return _spread(self._learners.observation(self.simulation.scene, vehicles), alive, 0)

    def _masks(self) -> ActionMasks:
        """The action masks (B L, 5); all 1 for learners that do not drive any more."""
        of_drivers = action_masks(self.simulation.scene, self._learners.vehicles)
        return _spread(of_drivers, self._learners.alive, 1)

    def _infos(self) -> dict[str, Any]:
        """The infos of every step; continuous actions have no mask."""
        if self._learners.kind != "meta":
            return {}
        known = np.ones(self.num_envs, dtype=np.bool_)
        return {"action_mask": self._masks(), "_action_mask": known}


def _spread(values: NDArray[Any], alive: Bools, fill: int) -> NDArray[Any]:
    """Values (M, ...) of the M learners that are `alive` (B L,), as (B L, ...)."""
    if len(values) == alive.size:
        return values
    spread = np.full((alive.size, *values.shape[1:]), fill, dtype=values.dtype)
    spread[alive] = values
    return spread


class HighwayVectorEnv(ScenesVectorEnv, Generic[C]):
    """B episodes side by side; when one ends, the next starts within the same step.

    An episode terminates when the ego collides or leaves the road, and is truncated when its time
    is over. The k-th episode to start has the seed `first_seed + k`, unless `reset` is given one.
    The other arguments are those of `Learners`, and the egos are the learners.

    Raises:
        InputError: There is no such render mode.
    """

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
        how = (traffic, agents, reward, observation, render_mode)
        super().__init__(Learners(settings, scenes, (0,), *how, actions=actions), first_seed)

    def get_state(self) -> EpisodesState:
        """The state of every episode, for `set_state`."""
        returns = self._learners.returns.copy()
        return EpisodesState(self.simulation.state(), returns, self._next_seed)

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
        learners = self._learners
        learners.restore(state.scenes)
        learners.returns[:] = state.returns
        self._next_seed = state.next_seed
        return self._observe(learners.vehicles, learners.alive)

"""Episodes as a `gymnasium.vector.VectorEnv`: the actions given to `step` drive the learners."""

from collections.abc import Mapping, Sequence
from typing import Any, Generic, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.envs import ID
from charms_bench.envs.autoreset import Autoreset
from charms_bench.envs.given_actions import GivenLike
from charms_bench.envs.learners import C, Learners, Reward
from charms_bench.envs.rendering import RENDER_MODES
from charms_bench.envs.seeds import checked_seed, random_seeds, seeds_of
from charms_bench.envs.torch_threads import warn_of_torch_threads
from charms_bench.errors import InputError
from charms_bench.foundation.generator import State, seeded, word
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.action_mask import ActionMasks
from charms_bench.world.actions import Actions
from charms_bench.world.observations import Observation, neighbours
from charms_bench.world.scene import (
    EVALUATION_SEEDS,
    Bools,
    Floats,
    Ints,
    Observations,
    SceneSettings,
    Vehicles,
)


class EpisodesState(NamedTuple):
    """The state of every running episode, and the environment's counters."""

    scenes: SceneState
    returns: Floats
    """[B] sums of the rewards so far."""
    next_seed: int | None
    """None if the generators draw the next seeds."""
    generators: State | None = None
    """[B, 6] the random generators of the scenes; None leaves them as they are."""


def checked_options(options: dict[str, Any] | None) -> dict[str, Any]:
    """The options of `reset`, none by default; an `InputError` if they are something else."""
    if options is not None and not isinstance(options, dict):
        raise InputError(f"reset: options is {options!r:.80}; expected a dictionary")
    return options or {}


def state_in(options: dict[str, Any] | None) -> SceneState | None:
    """The option `state` of `reset`.

    Raises:
        InputError: There is another option, or it is not a state.
    """
    options = checked_options(options)
    if unknown := sorted(options.keys() - {"state"}):
        raise InputError(f"reset takes the option 'state', got {', '.join(unknown)}")
    state = options.get("state")
    if state is not None and not isinstance(state, SceneState):
        found = type(state).__name__
        raise InputError(f"reset: expected a SceneState as the option 'state', found {found}")
    return state


class ScenesVectorEnv(VectorEnv[Observations, Actions, NDArray[Any]]):
    """B scenes with L learners each, as B L environments; those of the first scene come first.

    When no learner of a scene is left, the next scene starts: within the same step, or as
    `autoreset_mode` says, one of Gymnasium's `AutoresetMode`. Until then, the observations of
    learners that have left are zeros, their rewards are 0, and their actions have no effect.

    The k-th scene to start has the seed `first_seed + k`, until `reset` is given a seed. Without
    `first_seed`, each scene has a random generator of its own, as in Gymnasium's own vector
    environments, which draws the seeds of its next episodes as `EgoEnv` does.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # gymnasium's declaration
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": RENDER_MODES,
    }

    def __init__(
        self,
        learners: Learners,
        first_seed: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    ) -> None:
        self._learners = learners
        self._next_seed = None if first_seed is None else checked_seed(first_seed)
        scenes = learners.simulation.seeds.size
        self._generators = seeded(random_seeds(scenes))
        self._autoreset = Autoreset(autoreset_mode, scenes, type(self).__name__)
        self.autoreset_mode = self._autoreset.mode
        """As the attribute of Gymnasium's own vector environments, which TorchRL reads."""
        self.num_envs = learners.returns.size
        self.single_observation_space, self.single_action_space = learners.spaces
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.render_mode = learners.renderer.mode
        self.metadata = {
            **self.metadata,
            "autoreset_mode": self.autoreset_mode,
            "render_fps": self.simulation.settings.decision_hz,
        }

    @property
    def simulation(self) -> Simulation:
        """The simulation of all scenes."""
        return self._learners.simulation

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Starts an episode in every scene.

        Args:
            seed: The seed of the first scene's episode, from which those of the others count on, or
                one for each scene; None continues.
            options: `reset_mask` (B L,), true where episodes start and false where they go on. If
                the egos are the only learners, `state`, a `SceneState` of B running scenes in which
                the episodes start.

        Returns:
            Observations and infos; with meta-actions, these have the `action_mask`; see `step`.

        Raises:
            InputError: There is another option, or the state, a seed or the mask does not fit.
        """
        warn_of_torch_threads()
        learners, options = self._learners, dict(checked_options(options))
        seeds = seeds_of(seed, self.simulation.seeds.size)
        mask = options.pop("reset_mask", None)
        if options and len(learners.numbers) > 1:
            raise InputError(f"reset takes the option 'reset_mask', got {', '.join(options)}")
        state = state_in(options)
        if state is not None and mask is not None:
            raise InputError("reset takes one of the options 'reset_mask' and 'state'")
        rows = self._autoreset.of_reset(learners.scenes_of(mask))
        super().reset(seed=seeds[0])
        for row in rows.tolist():
            if (own := seeds[row]) is not None:
                self._generators[row] = seeded(np.array([own], dtype=np.uint64))[0]
                self._next_seed = None
        if state is None:
            self._start(rows, seeds)
        else:
            learners.restore(state)
        learners.show()
        return self._observe(learners.vehicles, learners.alive), self._infos()

    def step(self, actions: Any) -> tuple[Observations, Floats, Bools, Bools, dict[str, Any]]:
        """Carries out the actions, (B L,) or continuous (B L, 2), for one decision interval.

        Returns:
            Observations (B L, rows, columns), rewards (B L,), terminations (B L,), truncations
            (B L,), and infos. With meta-actions, these have the `action_mask` (B L, A) of the next
            step; see `world.action_mask`. They also have the `final_obs` and the `final_info` of
            the learners whose episodes ended: `ending` (an index into
            `engine.simulation.ENDINGS`), `steps`, `episode_return` and the scene's `seed`. If the
            next episodes do not start in the same step, these four are infos themselves.

        Raises:
            InputError: The actions have another shape or type, or one is out of range.
            ResetNeeded: There was no reset yet, or ended episodes wait for one.
        """
        learners, simulation = self._learners, self.simulation
        due = self._autoreset.before_step()
        vehicles, drove = learners.vehicles, learners.alive
        rewards, terminations, truncations, endings = learners.step(actions)
        observations = self._observe(vehicles, drove)
        infos: dict[str, Any] = {}
        if due.size:
            waited, rewards = learners.of_scenes(due), rewards.copy()
            rewards[waited], terminations[waited], truncations[waited] = 0.0, False, False
        ended = terminations | truncations
        if (rows := np.nonzero(ended)[0]).size:
            facts = {
                "ending": endings,
                "steps": simulation.steps[learners.scene_of],
                "episode_return": learners.returns,
                "seed": simulation.seeds[learners.scene_of],
            }
            infos = {name: np.where(ended, every, 0) for name, every in facts.items()}
            infos |= {f"_{name}": ended.copy() for name in facts}
        if rows.size and self.autoreset_mode == AutoresetMode.SAME_STEP:
            final_obs = np.full(ended.size, None, dtype=object)
            for row in rows:
                final_obs[row] = observations[row].copy()
            infos = {"final_obs": final_obs, "final_info": infos}
            infos |= {f"_{name}": ended.copy() for name in infos}
            observations[rows] = 0.0
        driven = learners.alive.reshape(simulation.seeds.size, -1)
        over = np.asarray(~driven.any(axis=1))
        over[due] = False
        starting = np.concatenate([due, self._autoreset.after_step(over)])
        if starting.size:
            self._start(starting)
            first = learners.of_scenes(starting)
            first = first[learners.alive[first]]
            observations[first] = learners.observe(
                (learners.scene_of[first], learners.places[first])
            )
        infos |= self._infos()
        return observations, rewards, terminations, truncations, infos

    def action_masks(self) -> Bools:
        """The action masks (B L, A), as sb3-contrib's `MaskablePPO` asks for them."""
        return self._masks().astype(np.bool_)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The scenes as animations of replays draw them, B times (height, width, 3), if asked for.

        Where an episode has just ended, this is the start of the next one. In the render mode
        `human`, `reset` and `step` show the first scenes in a window after each decision, in real
        time and with the ends of their episodes, and nothing is returned.

        Raises:
            InputError: There is no display for the window.
        """
        return self._learners.render()

    def close_extras(self, **_: Any) -> None:
        """Closes the window."""
        self._learners.renderer.close()

    def _start(self, rows: Ints, given: Sequence[int | None] = ()) -> None:
        """Starts an episode in each of the scenes `rows`, with its seed if there is one."""
        seeds = np.empty(rows.size, dtype=np.uint64)
        for k, row in enumerate(rows.tolist()):
            own = given[row] if given else None
            if own is None and self._next_seed is not None:
                own, self._next_seed = self._next_seed, self._next_seed + 1
            if own is None:  # as `EgoEnv.reset`: `integers(2**62)` are the upper bits of a word
                own = EVALUATION_SEEDS + (int(word(self._generators[row])) >> 2)
            seeds[k] = own
        self._learners.reset(seeds, rows)

    def _observe(self, vehicles: Vehicles, alive: Bools) -> Observations:
        """The observations (B L, rows, columns), zeros where `alive` (B L,) is false."""
        return _spread(self._learners.observe(vehicles), alive, 0)

    def _masks(self) -> ActionMasks:
        """The action masks (B L, A); all 1 for learners that do not drive any more."""
        learners = self._learners
        return _spread(learners.masks(learners.vehicles), learners.alive, 1)

    def _infos(self) -> dict[str, Any]:
        """The infos of every step; continuous actions have no mask."""
        if self._learners.actions.kind != "meta":
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
    """B episodes side by side; when one ends, the next starts, by default within the same step.

    An episode terminates when the ego collides or leaves the road, and is truncated when its time
    is over. `first_seed` and `autoreset_mode` are those of `ScenesVectorEnv`. The other arguments
    are those of `Learners`, and the egos are the learners.

    Raises:
        InputError: There is no such render mode or autoreset mode, or no action.
    """

    def __init__(
        self,
        settings: SceneSettings,
        scenes: int,
        traffic: Traffic,
        agents: Mapping[str, Agent],
        reward: Reward[C],
        first_seed: int | None = None,
        observation: Observation = neighbours,
        actions: GivenLike = "meta",
        render_mode: str | None = None,
        longitudinal: bool = True,
        lateral: bool = True,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    ) -> None:
        how = (traffic, agents, reward, observation, render_mode)
        chosen = (actions, longitudinal, lateral)
        learners = Learners(settings, scenes, (0,), *how, ID, *chosen)
        super().__init__(learners, first_seed, autoreset_mode)

    def get_state(self) -> EpisodesState:
        """The state of every episode, for `set_state`."""
        counters = self._learners.returns.copy(), self._next_seed, self._generators.copy()
        return EpisodesState(self.simulation.state(), *counters)

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
        if state.generators is not None:
            self._generators[:] = state.generators
        self._autoreset.continue_all()
        return self._observe(learners.vehicles, learners.alive)

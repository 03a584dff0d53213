"""Episodes side by side as a `gymnasium.vector.VectorEnv`."""

from collections.abc import Mapping, Sequence
from typing import Any, Generic

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from charms_bench.envs import ID
from charms_bench.envs.autoreset import Autoreset
from charms_bench.envs.base_env import restore_option
from charms_bench.envs.episodes import Episodes, Seeds, checked_options, masked, row_of
from charms_bench.envs.given_actions import GivenLike
from charms_bench.envs.learners import C, Learners, Reward
from charms_bench.envs.rendering import RENDER_MODES, Renderer
from charms_bench.envs.scene_episodes import EpisodesState as EpisodesState
from charms_bench.envs.scene_episodes import OfScenes, SceneEpisodes
from charms_bench.envs.seeds import checked_seed, seeds_of
from charms_bench.envs.torch_threads import warn_of_torch_threads
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.traffic import Traffic
from charms_bench.world.observations import Observation, neighbours
from charms_bench.world.scene import SceneSettings


class ScenesVectorEnv(VectorEnv[Any, Any, NDArray[Any]]):
    """B scenes as N environments: one per scene, or B L if each scene has L learners.

    When all learners of a scene have left, its next episode starts: within the same step, or
    as `autoreset_mode` says, one of Gymnasium's `AutoresetMode`. Until then, the observations of
    learners that have left are zeros, their rewards are 0, and their actions have no effect.

    The k-th episode to start has the seed `first_seed + k`, until `reset` is given a seed. Without
    `first_seed`, each scene has a random generator of its own, as in Gymnasium's own vector
    environments, which the next episodes continue.

    Args:
        episodes: The episodes of the scenes.
        render_mode: `rgb_array`, `human`, or None.
        first_seed: That of the first episode.
        autoreset_mode: When the next episodes start.

    Raises:
        InputError: The mode does not exist, or the seed is not a seed.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # gymnasium's declaration
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": RENDER_MODES,
    }

    def __init__(
        self,
        episodes: Episodes,
        render_mode: str | None = None,
        first_seed: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
    ) -> None:
        self._episodes: Any = episodes
        self._next_seed = None if first_seed is None else checked_seed(first_seed)
        self._autoreset = Autoreset(autoreset_mode, episodes.scenes, episodes.title)
        self.autoreset_mode = self._autoreset.mode
        """As the attribute of Gymnasium's own vector environments, which TorchRL reads."""
        self.num_envs = episodes.environments
        self._every = np.ones(self.num_envs, dtype=np.bool_)
        self.single_observation_space, self.single_action_space = episodes.spaces
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.render_mode = render_mode
        hz = episodes.decision_hz
        self._renderer = Renderer(episodes.scenes, hz, render_mode, episodes.title)
        self.metadata = {
            **self.metadata,
            "autoreset_mode": self.autoreset_mode,
            "render_fps": hz,
        }

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode in every scene.

        Args:
            seed: The seed of the first scene's episode, from which those of the others count on, or
                one for each scene; None continues.
            options: `reset_mask` (N,), true where episodes start and false where they go on, or
                `state`, as of `get_state` of one environment, but of B scenes, in which all start.

        Returns:
            Observations and infos; with the meta-actions of `Ego-v0`, these have the `action_mask`;
            see `step`.

        Raises:
            InputError: There is another option, or the state, a seed or the mask does not fit.
        """
        warn_of_torch_threads()
        episodes, options = self._episodes, checked_options(options, "reset_mask", "state")
        seeds = seeds_of(seed, episodes.scenes)
        mask, state = options.get("reset_mask"), options.get("state")
        if state is not None and mask is not None:
            raise InputError("reset takes one of the options 'reset_mask' and 'state'")
        rows = self._autoreset.of_reset(episodes.scenes_of(mask))
        super().reset(seed=seeds[0])
        given = [seeds[row] for row in rows.tolist()]
        if any(own is not None for own in given):
            self._next_seed = None
        episodes.reseed(rows, given)
        if state is None:
            episodes.start(rows, self._counted(given))
        else:
            restore_option(episodes, state)
        self._renderer.show(episodes.frame)
        infos = masked(episodes.first(), self._starting(rows))
        return episodes.observe(), infos | masked(episodes.always(), self._every)

    def step(self, actions: Any) -> tuple[Any, Floats, Bools, Bools, dict[str, Any]]:
        """Carries out the actions (N, ...) until the next decision.

        Returns:
            Observations (N, ...), rewards (N,), terminations (N,), truncations (N,), and infos.
            Where an episode has ended and the next starts in the same step, the observation is the
            next one's, and infos have the `final_obs` and the `final_info`.

            In `Ego-v0` with meta-actions and of learners, infos have the `action_mask` (N, A) of
            the next step; see `world.action_mask`. Those about an episode that has ended are
            `ending` (an index into `engine.simulation.ENDINGS`), `steps`, `episode_return` and the
            scene's `seed`. On highway-env's roads, infos are highway-env's.

        Raises:
            InputError: The actions have another shape or type, or one is out of range.
            ResetNeeded: There was no reset yet, or ended episodes wait for one.
        """
        episodes = self._episodes
        due = self._autoreset.before_step()
        observations, rewards, terminated, truncated = episodes.decide(actions, due)
        self._renderer.show(episodes.frame)
        known = self._every
        if due.size:
            waited, rewards, known = episodes.of_scenes(due), rewards.copy(), known.copy()
            rewards[waited], terminated[waited], truncated[waited] = 0.0, False, False
            known[waited] = False
        ended = terminated | truncated
        facts = episodes.facts(known)
        infos = masked(facts, known)
        if due.size or ended.any():
            infos = self._restarted(observations, ended, due, facts, infos)
        if always := episodes.always():
            infos |= masked(always, self._every)
        return observations, rewards, terminated, truncated, infos

    def _restarted(
        self,
        observations: Any,
        ended: Bools,
        due: Ints,
        facts: dict[str, Any],
        infos: dict[str, Any],
    ) -> dict[str, Any]:
        """Starts the next episodes of the scenes `due` and of those that are over; returns infos.

        Puts their first observations among `observations`.
        """
        episodes, final = self._episodes, self._episodes.final(ended)
        if self.autoreset_mode == AutoresetMode.SAME_STEP and ended.any():
            final_obs = np.full(ended.size, None, dtype=object)
            for row in np.flatnonzero(ended):
                final_obs[row] = row_of(observations, row)
            final_info = masked({**facts, **final}, ended)
            final = {"final_obs": final_obs, "final_info": final_info}
            if ended.size > episodes.scenes:  # other learners may go on
                observations[ended] = 0.0
        over = episodes.over(ended)
        over[due] = False
        starting = np.concatenate([due, self._autoreset.after_step(over)])
        if starting.size:
            episodes.start(starting, self._counted([None] * starting.size))
            episodes.begin(observations, starting)
            starts = self._starting(starting)
            infos = masked(facts, ~starts)
            for name, values in episodes.first().items():
                infos |= {name: values, f"_{name}": starts | infos.get(f"_{name}", False)}
        return infos | (masked(final, ended) if ended.any() else {})

    def _starting(self, rows: Ints) -> Bools:
        """(N,) the environments of scenes."""
        found = np.zeros(self.num_envs, dtype=np.bool_)
        found[self._episodes.of_scenes(rows)] = True
        return found

    def action_masks(self) -> Bools:
        """The action masks (N, A), as sb3-contrib's `MaskablePPO` asks for them.

        Where actions are tuples, the masks are (N, agents, A).

        Raises:
            InputError: The actions are not meta-actions.
            ResetNeeded: There was no reset yet.
        """
        return np.asarray(self._episodes.masks()).astype(np.bool_)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The scenes as animations of replays draw them, B times (height, width, 3), if asked for.

        Where an episode has just ended, this is the start of the next one. In the render mode
        `human`, `reset` and `step` show the first scenes in a window after each decision, in real
        time and with the ends of their episodes, and nothing is returned.

        Raises:
            InputError: There is no display for the window.
        """
        self._episodes.check_started("render")
        return self._renderer.render(self._episodes.frame)

    def close_extras(self, **_: Any) -> None:
        """Closes the window."""
        self._renderer.close()

    def get_state(self) -> Any:
        """The state of every episode, for `set_state`."""
        return self._episodes.saved(self._next_seed)

    def set_state(self, state: Any) -> Any:
        """Continues as after `get_state`; returns the last observations.

        Raises:
            InputError: The state does not fit.
        """
        self._next_seed = self._episodes.load(state)
        self._autoreset.continue_all()
        return self._episodes.observe()

    def _counted(self, given: Seeds) -> Seeds:
        """The seeds of the next episodes, counted on from `first_seed` where none is given."""
        if self._next_seed is None:
            return given
        first, count = self._next_seed, sum(own is None for own in given)
        self._next_seed += count
        left = iter(range(first, first + count))
        return [next(left) if own is None else own for own in given]


class HighwayVectorEnv(OfScenes, ScenesVectorEnv, Generic[C]):
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
        how = (traffic, agents, reward, observation, ID, actions, longitudinal, lateral)
        episodes = SceneEpisodes(Learners(settings, scenes, (0,), *how))
        super().__init__(episodes, render_mode, first_seed, autoreset_mode)

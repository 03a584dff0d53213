"""The vector environment as a Stable-Baselines3 `VecEnv`; the only module that imports it."""

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from charms_bench.errors import InputError

ENDED = ("ending", "steps", "episode_return", "seed", "speed", "crashed", "is_success")
"""Facts about an ended episode, in its last info under `final_info`; those that the environment
knows."""


class EpisodesVecEnv(VecEnv):
    """Adapts a `HighwayVectorEnv`, `LearnersVectorEnv` or `RoadVectorEnv` to Stable-Baselines3.

    The last observation of an ended episode is `infos[i]["terminal_observation"]`.
    `infos[i]["TimeLimit.truncated"]` is True if the episode ended because its time was over.
    Hindsight Experience Replay works where the environment has goals. As with `DummyVecEnv`, `seed`
    counts at the next reset, and environment i then has the seed `seed + i`.

    Raises:
        InputError: Ended episodes do not restart in the same step.
    """

    def __init__(self, episodes: VectorEnv[Any, Any, Any]) -> None:
        mode = episodes.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise InputError(f"EpisodesVecEnv: autoreset_mode is {mode}; expected 'SameStep'")
        self.episodes = episodes
        self.render_mode = episodes.render_mode
        super().__init__(
            episodes.num_envs, episodes.single_observation_space, episodes.single_action_space
        )
        self.metadata = episodes.metadata
        self._actions: NDArray[Any] = np.zeros(episodes.num_envs, dtype=np.int64)

    def reset(self) -> Any:
        observations, _ = self.episodes.reset(seed=self._seeds[0])
        self._reset_seeds()
        return observations

    def set_options(self, options: Any = None) -> None:
        if options:
            warnings.warn(
                "EpisodesVecEnv: set_options has no effect; give options to `make_vec`, or to "
                "`reset` of the vector environment",
                stacklevel=2,
            )

    def step_async(self, actions: NDArray[Any]) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, terminations, truncations, final = self.episodes.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = terminations | truncations
        for row in np.nonzero(ended)[0]:
            facts = final["final_info"]
            known = {name: facts[name][row].item() for name in ENDED if name in facts}
            infos[row] = {
                "terminal_observation": final["final_obs"][row],
                "TimeLimit.truncated": bool(truncations[row] and not terminations[row]),
                "final_info": known,
            }
            if "is_success" in known:  # where evaluations of Stable-Baselines3 look for it
                infos[row]["is_success"] = known["is_success"]
        return observations, rewards.astype(np.float32), ended, infos

    def close(self) -> None:
        self.episodes.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]

    def set_attr(self, *_: Any, **__: Any) -> None:
        raise NotImplementedError("episodes share attributes; set them in the constructor")

    def env_method(
        self, method_name: str, *given: Any, indices: VecEnvIndices = None, **_: Any
    ) -> list[Any]:
        episodes: Any = self.episodes.unwrapped
        if method_name == "compute_reward":  # which Hindsight Experience Replay asks for
            return [episodes.compute_reward(*given)] * len(list(self._get_indices(indices)))
        if method_name != "action_masks":  # which sb3-contrib's MaskablePPO asks for
            raise NotImplementedError("episodes have no methods of their own")
        masks = self.action_masks()
        return [masks[row] for row in self._get_indices(indices)]

    def action_masks(self) -> NDArray[np.bool_]:
        """The action masks of all episodes, (B, A)."""
        episodes: Any = self.episodes.unwrapped
        return np.asarray(episodes.action_masks())

    def render(self, mode: str | None = None) -> NDArray[Any] | None:
        if self.render_mode == "human":  # the environment has one window for all episodes
            self.episodes.render()
            return None
        return super().render(mode)

    def get_images(self) -> Sequence[NDArray[Any] | None]:
        frames: Any = self.episodes.render()
        return frames or ()

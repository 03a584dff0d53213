"""One episode after another, as a Gymnasium environment."""

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.envs.episodes import FIRST_SCENE, Episodes, checked_options, row_of
from charms_bench.envs.rendering import RENDER_MODES, Renderer
from charms_bench.envs.seeds import checked_seed
from charms_bench.envs.torch_threads import warn_of_torch_threads
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools


class SingleEnv(gymnasium.Env[Any, Any]):
    """The environment of episodes in one scene, with one learner or a tuple of them.

    Args:
        episodes: The episodes.
        render_mode: `rgb_array`, `human`, or None.

    Raises:
        InputError: There is no such mode.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}  # noqa: RUF012  # gymnasium's

    def __init__(self, episodes: Episodes, render_mode: str | None) -> None:
        self._episodes: Any = episodes
        self.observation_space, self.action_space = episodes.spaces
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": episodes.decision_hz}
        self._renderer = Renderer(1, episodes.decision_hz, render_mode, episodes.title)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: The episode's seed; None continues the random generator.
            options: `state`, one of `get_state`, which the episode continues.

        Returns:
            The observation and the info.

        Raises:
            InputError: There is another option, or the state does not fit, or the seed is none.
        """
        warn_of_torch_threads()
        seed = None if seed is None else checked_seed(seed)
        state = checked_options(options, "state").get("state")
        super().reset(seed=seed)
        self._episodes.reseed(FIRST_SCENE, [seed])
        if state is None:
            self._episodes.start(FIRST_SCENE, [seed])
        else:
            restore_option(self._episodes, state)
        self._renderer.show(self._episodes.frame)
        return row_of(self._episodes.observe(), 0), self._episodes.first_info()

    def step(self, action: Any) -> tuple[Any, Any, Any, bool, dict[str, Any]]:
        """Carries out an action until the next decision.

        Returns:
            Observation, reward, terminated, truncated, and the info.

        Raises:
            InputError: The action is not one of `action_space`.
            ResetNeeded: No episode has started, or it is over.
        """
        decided = self._episodes.decide_one(action)
        self._renderer.show(self._episodes.frame)
        observation, *outcome = self._episodes.result(decided, action)
        return observation, *outcome

    def action_masks(self) -> Bools:
        """The action mask (A,), as sb3-contrib's `MaskablePPO` asks for it.

        With several agents, the masks are (agents, A).

        Raises:
            InputError: The actions are not meta-actions.
            ResetNeeded: There was no reset yet.
        """
        return np.asarray(self._episodes.masks()[0], dtype=np.bool_)

    def render(self) -> NDArray[np.uint8] | None:
        """The scene as animations of replays draw it, (height, width, 3), in `rgb_array`.

        In the mode `human`, `reset` and `step` show it in a window after each decision, in real
        time, and nothing is returned.

        Raises:
            InputError: There is no display for the window.
        """
        self._episodes.check_started("render")
        frames = self._renderer.render(self._episodes.frame)
        return frames[0] if frames else None

    def close(self) -> None:
        """Closes the window."""
        self._renderer.close()

    def get_state(self) -> Any:
        """The state of the episode, for `set_state`."""
        return self._episodes.state()

    def set_state(self, state: Any) -> Any:
        """Continues the episode of a state; returns its last observation.

        Raises:
            InputError: The state does not fit.
        """
        self._episodes.restore(state)
        return row_of(self._episodes.observe(), 0)


def restore_option(episodes: Episodes, state: Any) -> None:
    """Starts in the option `state` of a reset."""
    try:
        episodes.restore(state)
    except InputError as error:
        raise InputError(f"reset: option 'state': {error}") from error

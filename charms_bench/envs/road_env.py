"""highway-env's other environments, such as `charms_bench/merge-v0`, alone and as vectors."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from charms_bench.envs.rendering import RENDER_MODES, Renderer
from charms_bench.envs.road_rendering import RoadPictures
from charms_bench.envs.torch_threads import warn_of_torch_threads
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.roads.episodes import Decision, Episodes
from charms_bench.world.actions import ACTIONS, LANE_LEFT, LANE_RIGHT
from charms_bench.world.road import is_reachable, side_lanes
from charms_bench.world.scene import Observations

Spaces = tuple[gymnasium.Space[Any], gymnasium.Space[Any]]


class RoadEnv(gymnasium.Env[Observations, Any]):
    """One episode after another of one of highway-env's environments.

    The same seed gives the scene of highway-env, and the same actions the same episode.

    Args:
        name: highway-env's name of the environment, such as `merge-v0`.
        config: highway-env's configuration; what is not given has its default.
        render_mode: `rgb_array`, `human`, or None.

    Raises:
        InputError: The configuration has an unknown key or a value that is not supported, or there
            is no such mode.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}  # noqa: RUF012  # gymnasium's declaration

    def __init__(
        self,
        name: str,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._name, self.render_mode = name, render_mode
        self._episodes = _episodes(name, 1, config)
        self._episodes.seed(self._episodes.everyone, _random_seeds(1))
        self.observation_space, self.action_space = _spaces(self._episodes)
        self.metadata = {**self.metadata, "render_fps": self.config["policy_frequency"]}
        self._renderer = _renderer(self, name, 1)

    @property
    def config(self) -> dict[str, Any]:
        """highway-env's configuration, with the defaults."""
        return self._episodes.config

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Starts an episode.

        Args:
            seed: That of the random generator; None continues it.
            options: `config`, values that change the configuration from now on.

        Returns:
            The observation, and an info with the ego's `speed` and whether it has `crashed`.

        Raises:
            InputError: There is another option, or a value is not supported.
        """
        warn_of_torch_threads()
        super().reset(seed=seed)
        if unknown := sorted((options or {}).keys() - {"config"}):
            raise InputError(f"reset takes the option 'config', got {', '.join(unknown)}")
        if options:
            before = self._episodes.scenes.generator
            self._episodes = _episodes(self._name, 1, {**self.config, **options["config"]})
            self._episodes.scenes.generator[:] = before
            self.observation_space, self.action_space = _spaces(self._episodes)
        episodes = self._episodes
        if seed is not None:
            episodes.seed(episodes.everyone, np.array([seed], dtype=np.uint64))
        episodes.start(episodes.everyone)
        self._renderer.show()
        return self._observe(), {name: each[0] for name, each in _facts(episodes).items()}

    def step(
        self, action: np.int64 | int
    ) -> tuple[Observations, float, bool, bool, dict[str, Any]]:
        """Carries out the ego's action until the next decision.

        Returns:
            Observation, reward, terminated, truncated, and highway-env's info.

        Raises:
            InputError: The action is not one of `action_space`.
        """
        episodes = self._episodes
        decision = episodes.step(_checked(np.array([action]), episodes))
        info = {name: each[0] for name, each in _facts(episodes).items()}
        info |= {"action": action, "rewards": dict(_terms(episodes, decision, 0))}
        info |= {name: each[0] for name, each in episodes.task.information(episodes.scenes).items()}
        ended = bool(decision.terminated[0]), bool(decision.truncated[0])
        self._renderer.show()
        return self._observe(), float(decision.rewards[0]), *ended, info

    def get_available_actions(self) -> list[int]:
        """The actions that have an effect now [`DiscreteMetaAction.get_available_actions`]."""
        scenes, names = self._episodes.scenes, self._episodes.actions.names
        ego = scenes.vehicles[0, 0]
        possible = ["IDLE"]
        left, right = side_lanes(scenes.road, int(ego["lane"]))
        for lane, name in ((left, ACTIONS[LANE_LEFT]), (right, ACTIONS[LANE_RIGHT])):
            if lane >= 0 and is_reachable(scenes.road, lane, float(ego["x"]), float(ego["y"])):
                possible.append(name)
        possible += ["FASTER"] * bool(ego["speed_index"] < scenes.target_speeds.size - 1)
        possible += ["SLOWER"] * bool(ego["speed_index"] > 0)
        return [names.index(name) for name in possible if name in names]

    def render(self) -> Any:
        """The picture (height, width, 3) in the mode `rgb_array`; None in other modes."""
        frames = self._renderer.render()
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Closes the window."""
        self._renderer.close()

    def _observe(self) -> Observations:
        return np.asarray(self._episodes.observe()[0])


class RoadVectorEnv(VectorEnv[Observations, Any, NDArray[Any]]):
    """B environments `RoadEnv` side by side; where an episode ends, the next starts at once.

    As in Gymnasium's own vector environments, each has a random generator of its own, which the
    next episodes continue, and `reset(seed=k)` seeds the i-th with `k + i`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # gymnasium's declaration
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": RENDER_MODES,
    }

    def __init__(
        self,
        num_envs: int,
        name: str,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._episodes = _episodes(name, num_envs, config)
        self.num_envs, self.render_mode = num_envs, render_mode
        self.metadata = {**self.metadata, "render_fps": self.config["policy_frequency"]}
        self._renderer = _renderer(self, name, num_envs)
        self.single_observation_space, self.single_action_space = _spaces(self._episodes)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._episodes.seed(self._episodes.everyone, _random_seeds(num_envs))
        self._known = np.ones(num_envs, dtype=np.bool_)

    @property
    def config(self) -> dict[str, Any]:
        """highway-env's configuration, with the defaults."""
        return self._episodes.config

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Starts an episode in every environment; see `RoadEnv.reset`.

        Args:
            seed: The seed of the first environment, or one for each; None continues.
            options: None are known.

        Raises:
            InputError: There is an option, or the number of seeds is wrong.
        """
        warn_of_torch_threads()
        if options:
            raise InputError(f"reset takes no options, got {', '.join(map(str, options))}")
        episodes = self._episodes
        seeds = [seed + k for k in range(self.num_envs)] if isinstance(seed, int) else seed
        seeds = [None] * self.num_envs if seeds is None else list(seeds)
        if len(seeds) != self.num_envs:
            raise InputError(f"reset: {len(seeds)} seeds; expected {self.num_envs}")
        rows = np.array([k for k, each in enumerate(seeds) if each is not None], dtype=np.int64)
        given = [each for each in seeds if each is not None]
        episodes.seed(rows, np.array(given, dtype=np.uint64))
        episodes.start(episodes.everyone)
        return episodes.observe(), self._masked(_facts(episodes), self._known)

    def step(self, actions: Ints) -> tuple[Observations, Floats, Bools, Bools, dict[str, Any]]:
        """Carries out the actions (B,) until the next decision.

        Returns:
            Observations (B, ...), rewards (B,), terminations (B,), truncations (B,), and
            highway-env's infos. Where an episode has ended, these have the `final_obs` and the
            `final_info`, and the observation is the next episode's.

        Raises:
            InputError: An action is not one of `action_space`.
        """
        episodes, known = self._episodes, self._known
        actions = _checked(np.asarray(actions), episodes)
        decision = episodes.step(actions)
        ended = decision.terminated | decision.truncated
        observations = episodes.observe()
        terms = self._masked(dict(_terms(episodes, decision)), known)
        facts = {**_facts(episodes), "action": actions, "rewards": terms}
        facts |= episodes.task.information(episodes.scenes)
        infos = self._masked(facts, known)
        if (rows := np.nonzero(ended)[0]).size:
            final_obs = np.full(self.num_envs, None, dtype=object)
            for row in rows:
                final_obs[row] = observations[row].copy()
            final = {"final_obs": final_obs, "final_info": self._masked(facts, ended)}
            episodes.start(rows)
            infos = self._masked(facts, ~ended) | self._masked(_facts(episodes), known)
            infos |= self._masked(final, ended)
            observations[rows] = episodes.observe(rows)
        self._renderer.show()
        return observations, decision.rewards, decision.terminated, decision.truncated, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The pictures (height, width, 3) in the mode `rgb_array`; None in other modes."""
        return self._renderer.render()

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the window."""
        self._renderer.close()

    def _masked(self, facts: dict[str, Any], known: Bools) -> dict[str, Any]:
        """Infos with the masks (B,) beside them that Gymnasium expects."""
        return {**facts, **{f"_{name}": known for name in facts}}


def _episodes(name: str, count: int, config: Mapping[str, Any] | None) -> Episodes:
    try:
        return Episodes(name, count, config)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def _renderer(env: "RoadEnv | RoadVectorEnv", name: str, scenes: int) -> Renderer:
    """What draws the scenes of an environment."""
    pictures, hz = RoadPictures(), env.config["policy_frequency"]
    return Renderer(
        lambda row: pictures.frame(env._episodes, row), scenes, hz, env.render_mode, name
    )


def _spaces(episodes: Episodes) -> Spaces:
    observer = episodes.observer
    box = gymnasium.spaces.Box(observer.low, observer.high, observer.shape, np.float32)
    return box, gymnasium.spaces.Discrete(len(episodes.actions.names))


def _checked(actions: NDArray[Any], episodes: Episodes) -> Ints:
    """The actions (B,), if they are such."""
    count, most = episodes.everyone.size, len(episodes.actions.names)
    if actions.shape != (count,) or actions.dtype.kind not in "iu":
        found = f"{actions.dtype} of shape {actions.shape}"
        raise InputError(f"actions: {found}; expected integers of shape ({count},)")
    if not ((actions >= 0) & (actions < most)).all():
        wrong = actions[(actions < 0) | (actions >= most)][0]
        raise InputError(f"action {wrong}; expected 0 to {most - 1}")
    return actions.astype(np.int64, copy=False)


def _facts(episodes: Episodes) -> dict[str, NDArray[Any]]:
    """What every info has, (B,) by name [`AbstractEnv._info`]."""
    ego = episodes.scenes.vehicles[:, 0]
    return {"speed": ego["speed"].copy(), "crashed": ego["crashed"].copy()}


def _terms(episodes: Episodes, decision: Decision, row: Any = slice(None)) -> Any:
    """The terms of the rewards by name, without their weights."""
    return zip(episodes.task.terms, np.moveaxis(decision.terms, 1, 0)[:, row], strict=True)


def _random_seeds(count: int) -> NDArray[np.uint64]:
    """Seeds (B,) from the operating system."""
    return np.random.SeedSequence().generate_state(count, np.uint64).astype(np.uint64)

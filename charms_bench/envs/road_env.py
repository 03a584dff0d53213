"""highway-env's other environments, such as `charms_bench/merge-v0`, alone and as vectors."""

import json
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from itertools import product
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from charms_bench.envs.autoreset import Autoreset
from charms_bench.envs.given_actions import array_of
from charms_bench.envs.rendering import RENDER_MODES, Frame, Renderer
from charms_bench.envs.road_rendering import RoadPictures
from charms_bench.envs.road_state import RoadState, RoadVehicle, missing, vehicles_of
from charms_bench.envs.seeds import checked_seed, random_seeds, seeds_of
from charms_bench.envs.spaces import trained_in
from charms_bench.envs.torch_threads import warn_of_torch_threads
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.roads.available_actions import available_actions
from charms_bench.roads.configuration import MetaActions, plain
from charms_bench.roads.controls import Controls
from charms_bench.roads.episodes import Decision, Episodes, EpisodesState, Seen
from charms_bench.roads.parking import Parking

Spaces = tuple[gymnasium.Space[Any], gymnasium.Space[Any]]
RoadReward = Callable[[NDArray[np.void], Mapping[str, Floats]], Floats]
"""A reward of one's own (B,) after a decision. It is given the vehicles (B, N), which are rows of
`roads.scenes.VEHICLE` of which the first is the ego, and the terms of highway-env's reward (B,) by
name."""


class RoadScenes:
    """What all environments of highway-env's roads share: alone, as vectors and of named agents."""

    _name: str
    _episodes: Episodes
    _renderer: Renderer
    _pictures: RoadPictures
    _reward: RoadReward | None
    _seen: Any = None
    """The last observations (B, ...); None before the first reset."""

    def _masks(self) -> Bools:
        """The action masks (B, A) of the first ego, or (B, egos, A) where actions are tuples."""
        episodes, actions = self._episodes, self._meta_actions
        self._check_started("action masks")
        masks = available_actions(episodes.scenes, episodes.agents)[..., actions.meaning]
        return masks if episodes.has_agents else masks[:, 0]

    @property
    def _meta_actions(self) -> MetaActions:
        if isinstance(self._episodes.actions, Controls):
            raise InputError(f"{self._name}: action masks: expected meta-actions")
        return self._episodes.actions

    def _step(self, actions: Any) -> Decision:
        """What actions lead to, with the rewards of one's own if there are such."""
        decision = self._episodes.step(actions)
        self._seen = decision.observations
        if self._reward is None:
            return decision
        vehicles = self._episodes.scenes.vehicles[:]
        vehicles.flags.writeable = False
        rewards = np.array(self._reward(vehicles, dict(_terms(self._episodes, decision))), float)
        if rewards.shape != decision.rewards.shape:
            expected = f"expected {decision.rewards.shape}, one for each environment"
            raise InputError(f"{self._name}: reward: found the shape {rewards.shape}; {expected}")
        return decision._replace(rewards=rewards)

    def _frame(self, row: int) -> Frame:
        return self._pictures.frame(self._episodes, row)

    def _check_started(self, what: str) -> None:
        if self._seen is None:
            raise ResetNeeded(f"{what} before the first reset")


class _SavedScenes(RoadScenes):
    """Those whose episodes continue from states."""

    def get_state(self) -> EpisodesState:
        """The state of every episode, for `set_state`.

        Raises:
            ResetNeeded: There was no reset yet.
        """
        self._check_started("get_state")
        return self._episodes.state(self._seen)

    def _continue(self, state: EpisodesState) -> None:
        """Continues the episodes of a state."""
        try:
            self._seen = self._episodes.restore(state)
        except InputError as error:
            raise InputError(f"{self._name}: {error}") from error


class RoadEnv(_SavedScenes, gymnasium.Env[Any, Any]):
    """One episode after another of one of highway-env's environments.

    The same seed gives the scene of highway-env, and the same actions the same episode.

    Args:
        name: highway-env's name of the environment, such as `merge-v0`.
        config: highway-env's configuration; what is not given has its default.
        render_mode: `rgb_array`, `human`, or None.
        reward: The reward of a decision; by default that of highway-env.

    Raises:
        InputError: The configuration has an unknown key or a value that is not supported, there is
            no such mode, or a reward is given where there are several agents.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}  # noqa: RUF012  # gymnasium's declaration

    def __init__(
        self,
        name: str,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        reward: RoadReward | None = None,
    ) -> None:
        self._name, self.render_mode = name, render_mode
        self._episodes = episodes_of(name, 1, config)
        self._reward = _checked_reward(reward, self._episodes)
        self.config = deepcopy(self._episodes.config)
        """highway-env's configuration, with the defaults; changes count from the next reset on."""
        self._episodes.seed(self._episodes.everyone, random_seeds(1))
        self.observation_space, self.action_space = spaces_of(self._episodes)
        self.metadata = {**self.metadata, "render_fps": self.config["policy_frequency"]}
        self._renderer = Renderer(1, self.config["policy_frequency"], render_mode, name)
        self._pictures = RoadPictures()
        self._vehicles: dict[int, RoadVehicle] = {}

    def __getattr__(self, name: str) -> Any:
        """Says what to use instead of what highway-env has and this environment has not."""
        raise missing(self, name)

    @property
    def action_type(self) -> Any:
        """The actions; of meta-actions, it has `actions` and `actions_indexes`."""
        return self._episodes.actions

    @property
    def time(self) -> float:
        """Since the start of the episode, s."""
        return float(self._episodes.scenes.time[0])

    @property
    def road(self) -> RoadState:
        """The vehicles on the road as they are now, which cannot be changed.

        After a step, ask again.
        """
        return RoadState([*self._now().values()])

    @property
    def controlled_vehicles(self) -> list[RoadVehicle]:
        """The egos among `road.vehicles`."""
        return [self._now()[ego] for ego in range(self._episodes.task.egos)]

    @property
    def vehicle(self) -> RoadVehicle:
        """The first ego."""
        return self.controlled_vehicles[0]

    def _now(self) -> dict[int, RoadVehicle]:
        self._check_started("vehicles")
        if not self._vehicles:
            self._vehicles = vehicles_of(self._episodes, 0)
        return self._vehicles

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
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
        seed = None if seed is None else checked_seed(seed)
        if not isinstance(options or {}, Mapping) or {*(options or {})} - {"config"}:
            raise InputError(f"reset takes the option 'config', got {options!r}")
        config = (options or {}).get("config") or {}
        if not isinstance(config, Mapping):
            raise InputError(f"reset: option 'config': {config!r}; expected a dictionary")
        changed = plain({**self.config, **config})
        if changed != self._episodes.config:
            before = self._episodes.scenes.generator
            self._episodes = episodes_of(self._name, 1, changed)
            self._episodes.scenes.generator[:] = before
            self.observation_space, self.action_space = spaces_of(self._episodes)
        self.config = deepcopy(changed)
        episodes = self._episodes
        if seed is not None:
            episodes.seed(episodes.everyone, np.array([seed], dtype=np.uint64))
        super().reset(seed=seed)
        episodes.start(episodes.everyone)
        self._seen = episodes.observe()
        self._vehicles = {}
        self._renderer.show(self._frame)
        info = {name: each[0].item() for name, each in _facts(episodes).items()}
        return _row(self._seen, 0), info

    def step(self, action: Any) -> tuple[Any, Any, Any, bool, dict[str, Any]]:
        """Carries out the ego's action until the next decision, or a tuple of those of the agents.

        Returns:
            Observation, reward, terminated, truncated, and highway-env's info. Where highway-env
            has several agents, the observation is a tuple of theirs; in `intersection-multi-agent`
            from `-v1` on, so are reward and terminated.

        Raises:
            InputError: The action is not one of `action_space`.
            ResetNeeded: There was no reset yet.
        """
        episodes = self._episodes
        self._check_started("step")
        if episodes.has_agents:
            checked = _checked([array_of(each)[None] for each in _parts(action)], episodes)
        else:
            checked = _checked(array_of(action)[None], episodes)
        decision = self._step(checked)
        self._vehicles = {}
        info: dict[str, Any] = {}
        if episodes.task.has_info:
            info |= {name: each[0].item() for name, each in _facts(episodes).items()}
            info["action"] = action
        if episodes.task.terms:
            terms = _terms(episodes, decision, 0)
            info["rewards"] = {name: term.item() for name, term in terms}
        for name, each in episodes.task.information(episodes.scenes).items():
            info[name] = tuple(each[0].tolist()) if np.ndim(each) > 1 else each[0].item()
        self._renderer.show(self._frame)
        seen, truncated = _row(self._seen, 0), bool(decision.truncated[0])
        if episodes.is_split:
            return seen, info["agents_rewards"], info["agents_terminated"], truncated, info
        return seen, float(decision.rewards[0]), bool(decision.terminated[0]), truncated, info

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Changes the configuration from the next reset on [`AbstractEnv.configure`]."""
        self.config |= deepcopy(dict(config or {}))

    def set_record_video_wrapper(self, wrapper: Any) -> None:
        """Does nothing, since each decision has one picture [`set_record_video_wrapper`]."""

    def get_available_actions(self) -> Any:
        """The actions that have an effect now [`DiscreteMetaAction.get_available_actions`].

        With several agents, these are the combinations of theirs.
        """
        names, masks = self._meta_actions.names, self._masks()[0]
        possible = [names.index(each) for each in _AS_IN_HIGHWAY_ENV if each in names]
        each = [[k for k in possible if mask[k]] for mask in np.atleast_2d(masks)]
        return product(*each) if self._episodes.has_agents else each[0]

    def action_masks(self) -> Bools:
        """Which actions have an effect now, (A,), as sb3-contrib's `MaskablePPO` asks for it.

        With several agents, the masks are (agents, A).

        Raises:
            InputError: The actions are no meta-actions.
            ResetNeeded: There was no reset yet.
        """
        return np.asarray(self._masks()[0])

    def set_state(self, state: EpisodesState) -> Any:
        """Continues the episode of a state of `get_state`; returns its last observation.

        Raises:
            InputError: It is of another environment, configuration or number of episodes.
        """
        self._continue(state)
        self._vehicles = {}
        return _row(self._seen, 0)

    def render(self) -> Any:
        """The picture (height, width, 3) in the mode `rgb_array`; None in other modes."""
        self._check_started("render")
        frames = self._renderer.render(self._frame)
        return None if frames is None else frames[0]

    def close(self) -> None:
        """Closes the window."""
        self._renderer.close()


class GoalRoadEnv(RoadEnv):
    """A `RoadEnv` whose observations have goals."""

    def compute_reward(
        self, achieved_goal: Floats, desired_goal: Floats, info: Any = None, p: float = 0.5
    ) -> Any:
        """The rewards (...) of goals (..., F), as Hindsight Experience Replay needs them.

        Args:
            achieved_goal: What was reached.
            desired_goal: What should have been reached.
            info: Not used.
            p: The exponent of the distance.
        """
        return _goal_rewards(self._name, self._episodes, achieved_goal, desired_goal, p)


class RoadVectorEnv(_SavedScenes, VectorEnv[Any, Any, NDArray[Any]]):
    """B environments `RoadEnv` side by side; where an episode ends, the next starts at once.

    `autoreset_mode` is another of Gymnasium's `AutoresetMode`, in which it starts in the next step,
    or when the caller resets it.

    As in Gymnasium's own vector environments, each has a random generator of its own, which the
    next episodes continue, and `reset(seed=k)` seeds the i-th with `k + i`.

    With several agents, observations and actions are tuples of theirs. Rewards are the means over
    the agents, an episode ends where highway-env's does without `MultiAgentWrapper`, and infos have
    `agents_rewards` and `agents_terminated` (B, A).
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
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        reward: RoadReward | None = None,
    ) -> None:
        self._name = name
        self._autoreset = Autoreset(autoreset_mode, num_envs, name)
        self.autoreset_mode = self._autoreset.mode
        """As the attribute of Gymnasium's own vector environments, which TorchRL reads."""
        self._episodes = episodes_of(name, num_envs, config)
        self._reward = _checked_reward(reward, self._episodes)
        self.num_envs, self.render_mode = num_envs, render_mode
        hz = self.config["policy_frequency"]
        self.metadata = {
            **self.metadata,
            "autoreset_mode": self.autoreset_mode,
            "render_fps": hz,
        }
        self._renderer = Renderer(num_envs, hz, render_mode, name)
        self._pictures = RoadPictures()
        self.single_observation_space, self.single_action_space = spaces_of(self._episodes)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._episodes.seed(self._episodes.everyone, random_seeds(num_envs))
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
    ) -> tuple[Any, dict[str, Any]]:
        """Starts an episode in every environment; see `RoadEnv.reset`.

        Args:
            seed: The seed of the first environment, or one for each; None continues.
            options: `reset_mask` (B,), true where episodes start and false where they go on.

        Raises:
            InputError: There is another option, or a seed or the mask is wrong.
        """
        warn_of_torch_threads()
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            found = ", ".join(map(str, options))
            raise InputError(f"reset takes the option 'reset_mask', got {found}")
        episodes, seeds = self._episodes, seeds_of(seed, self.num_envs)
        rows = self._autoreset.of_reset(mask)
        given = np.array([row for row in rows if seeds[row] is not None], dtype=np.int64)
        episodes.seed(given, np.array([seeds[row] for row in given], dtype=np.uint64))
        episodes.start(rows)
        first = episodes.observe(rows)
        if mask is not None:
            seen = deepcopy(self._seen)
            _put(seen, rows, first)
            first = seen
        self._seen = first
        self._renderer.show(self._frame)
        return first, self._masked(_facts(episodes), np.isin(episodes.everyone, rows))

    def step(self, actions: Any) -> tuple[Any, Floats, Bools, Bools, dict[str, Any]]:
        """Carries out the actions (B, ...) until the next decision.

        Returns:
            Observations (B, ...), rewards (B,), terminations (B,), truncations (B,), and
            highway-env's infos. Where an episode has ended and the next starts in the same step,
            these have the `final_obs` and the `final_info`, and the observation is the next one's.

        Raises:
            InputError: An action is not one of `action_space`.
            ResetNeeded: There was no reset yet, or ended episodes wait for one.
        """
        episodes = self._episodes
        due = self._autoreset.before_step()
        generators = episodes.scenes.generator[due].copy()
        decision = self._step(_checked(actions, episodes))
        episodes.scenes.generator[due] = generators
        rewards, terminated, truncated = decision.rewards, decision.terminated, decision.truncated
        rewards[due], terminated[due], truncated[due] = 0.0, False, False
        ended = terminated | truncated
        observations = decision.observations
        has_info, known = episodes.task.has_info, ~np.isin(episodes.everyone, due)
        given = actions if episodes.has_agents else array_of(actions)
        facts: dict[str, Any] = {**_facts(episodes), "action": given} if has_info else {}
        if episodes.task.terms:
            facts["rewards"] = self._masked(dict(_terms(episodes, decision)), known)
        facts |= episodes.task.information(episodes.scenes)
        infos = self._masked(facts, known)
        over = self._autoreset.after_step(ended)
        if (rows := np.concatenate([due, over])).size:
            starts = np.isin(episodes.everyone, rows)
            final_obs = np.full(self.num_envs, None, dtype=object)
            for row in over:
                final_obs[row] = _row(observations, row)
            final = {"final_obs": final_obs, "final_info": self._masked(facts, ended)}
            episodes.start(rows)
            first = self._masked(_facts(episodes), self._known if has_info else starts)
            infos = self._masked(facts, ~starts) | first
            if over.size:
                infos |= self._masked(final, ended)
            _put(observations, rows, episodes.observe(rows))
        self._renderer.show(self._frame)
        return observations, rewards, terminated, truncated, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """The pictures (height, width, 3) in the mode `rgb_array`; None in other modes."""
        self._check_started("render")
        return self._renderer.render(self._frame)

    def action_masks(self) -> Bools:
        """Which actions have an effect now, (B, A), or of several agents (B, agents, A).

        Raises:
            InputError: The actions are no meta-actions.
            ResetNeeded: There was no reset yet.
        """
        return self._masks()

    def set_state(self, state: EpisodesState) -> Any:
        """Continues the episodes of a state of `get_state`; returns their last observations.

        Raises:
            InputError: It is of another environment, configuration or number of episodes.
        """
        self._continue(state)
        self._autoreset.continue_all()
        return deepcopy(self._seen)

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the window."""
        self._renderer.close()

    def compute_reward(
        self, achieved_goal: Floats, desired_goal: Floats, info: Any = None, p: float = 0.5
    ) -> Any:
        """The rewards of goals; see `RoadEnv.compute_reward`."""
        return _goal_rewards(self._name, self._episodes, achieved_goal, desired_goal, p)

    def _masked(self, facts: dict[str, Any], known: Bools) -> dict[str, Any]:
        """Infos with the masks (B,) beside them that Gymnasium expects."""
        return {**facts, **{f"_{name}": known for name in facts}}


_AS_IN_HIGHWAY_ENV = ("IDLE", "LANE_LEFT", "LANE_RIGHT", "FASTER", "SLOWER")
"""The order of [`DiscreteMetaAction.get_available_actions`]."""


def episodes_of(name: str, count: int, config: Mapping[str, Any] | None) -> Episodes:
    """The scenes of environments; errors name them."""
    try:
        return Episodes(name, count, config)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error


def spaces_of(episodes: Episodes) -> Spaces:
    """The spaces of the observations and the actions of one environment."""
    config = episodes.config
    where = {
        "environment": episodes.name,
        "decision_hz": config["policy_frequency"],
        "observation": json.dumps(config["observation"], default=str),
        "action": json.dumps(config["action"], default=str),
    }
    seen = [trained_in(observer.space, where) for observer in episodes.observers]
    chosen = [episodes.actions.space for _ in range(episodes.agents)]
    return (
        gymnasium.spaces.Tuple(seen) if episodes.sees_agents else seen[0],
        gymnasium.spaces.Tuple(chosen) if episodes.has_agents else chosen[0],
    )


def _checked(actions: Any, episodes: Episodes) -> Any:
    """The actions (B, ...) or those of each agent, if they are such."""
    if not episodes.has_agents:
        return _checked_of_one(array_of(actions), episodes)
    parts = _parts(actions)
    if len(parts) != episodes.agents:
        raise InputError(f"actions of {len(parts)} agents; expected {episodes.agents}")
    return tuple(_checked_of_one(array_of(each), episodes) for each in parts)


def _checked_reward(reward: RoadReward | None, episodes: Episodes) -> RoadReward | None:
    """The reward, if one can be given."""
    if reward is None or (callable(reward) and not episodes.has_agents):
        return reward
    found = "there are several agents" if callable(reward) else f"found {reward!r:.80}"
    raise InputError(f"{episodes.name}: reward: {found}; expected a function for one agent")


def _parts(actions: Any) -> list[Any]:
    """The actions of the agents, from any sequence."""
    try:
        return list(actions)
    except TypeError as error:
        raise InputError(f"action {actions!r}; expected those of several agents") from error


def _checked_of_one(actions: NDArray[Any], episodes: Episodes) -> NDArray[Any]:
    """The actions (B, ...) of one agent, if they are such."""
    space = episodes.actions.space
    is_discrete = isinstance(space, gymnasium.spaces.Discrete)
    shape = episodes.everyone.size, *(space.shape or ())
    if actions.shape != shape or actions.dtype.kind not in ("iu" if is_discrete else "iuf"):
        found = f"{actions.dtype} of shape {actions.shape}"
        expected = "integers" if is_discrete else "numbers"
        raise InputError(f"actions: {found}; expected {expected} of shape {shape}")
    if not isinstance(space, gymnasium.spaces.Discrete):
        clips = isinstance(episodes.actions, Controls) and episodes.actions.clips
        if not (~np.isnan(actions) if clips else np.isfinite(actions)).all():
            raise InputError("actions: not all of them are finite")
        return actions if actions.dtype == np.float32 else actions.astype(np.float64)
    most = int(space.n)
    if not ((actions >= 0) & (actions < most)).all():
        wrong = actions[(actions < 0) | (actions >= most)][0]
        raise InputError(f"action {wrong}; expected 0 to {most - 1}")
    return actions.astype(np.int64, copy=False)


def _row(observations: Seen, row: Any) -> Any:
    """One of several observations."""
    if isinstance(observations, tuple):
        return tuple(_row(each, row) for each in observations)
    if isinstance(observations, dict):
        return {name: each[row].copy() for name, each in observations.items()}
    return observations[row].copy()


def _put(observations: Seen, rows: Ints, others: Any) -> None:
    """Replaces some of several observations."""
    if isinstance(observations, tuple):
        for each, other in zip(observations, others, strict=True):
            _put(each, rows, other)
    elif isinstance(observations, dict):
        for name, values in observations.items():
            values[rows] = others[name]
    else:
        observations[rows] = others


def _goal_rewards(
    name: str, episodes: Episodes, achieved: Floats, desired: Floats, exponent: float
) -> Any:
    if not isinstance(episodes.task, Parking):
        raise InputError(f"{name}: compute_reward: there are no goals")
    found = episodes.task.goal_rewards(achieved, desired, exponent)
    return found if found.ndim else found[()]


def _facts(episodes: Episodes) -> dict[str, NDArray[Any]]:
    """What every info has, (B,) by name [`AbstractEnv._info`]."""
    ego = episodes.scenes.vehicles[:, 0]
    return {"speed": ego["speed"].copy(), "crashed": ego["crashed"].copy()}


def _terms(episodes: Episodes, decision: Decision, row: Any = slice(None)) -> Any:
    """The terms of the rewards by name, without their weights."""
    return zip(episodes.task.terms, np.moveaxis(decision.terms, 1, 0)[:, row], strict=True)

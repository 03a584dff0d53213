"""Episodes of highway-env's environments, such as `merge-v0`."""

import json
from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from charms_bench.envs.episodes import (
    NO_SCENES,
    Decided,
    Episodes,
    Seeds,
    Spaces,
    masked,
    put,
    row_of,
)
from charms_bench.envs.given_actions import array_of
from charms_bench.envs.rendering import Frame
from charms_bench.envs.road_rendering import RoadPictures
from charms_bench.envs.road_state import RoadVehicle, vehicles_of
from charms_bench.envs.seeds import random_seeds
from charms_bench.envs.spaces import trained_in
from charms_bench.errors import InputError
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.progress import ENGINE_OF_ROADS, note_compiling
from charms_bench.roads.available_actions import available_actions
from charms_bench.roads.configuration import MetaActions
from charms_bench.roads.continuous_actions import Controls
from charms_bench.roads.episodes import Decision, EpisodesState
from charms_bench.roads.episodes import Episodes as RoadScenes
from charms_bench.roads.parking import Parking
from charms_bench.roads.stepping import decide

RoadReward = Callable[[NDArray[np.void], Mapping[str, Floats]], Floats]
"""A custom reward (B,) after a decision, or (B, agents) where there are several agents. It is
given the vehicles (B, N), rows of `roads.scenes.VEHICLE` in which the egos come first,
and the terms of highway-env's reward (B,) by name."""


class RoadEpisodes(Episodes):
    """The episodes of an environment with highway-env's name.

    The seed of an episode is that of the scene's random generator; without one, it continues.

    Args:
        name: highway-env's name of the environment.
        count: B.
        config: highway-env's configuration; what is not given has its default.
        reward: The reward of a decision; by default that of highway-env.

    Raises:
        InputError: The configuration has an unknown key or a value that is not supported, or the
            reward is not a function.
    """

    def __init__(
        self,
        name: str,
        count: int,
        config: Mapping[str, Any] | None = None,
        reward: RoadReward | None = None,
    ) -> None:
        if not (reward is None or callable(reward)):
            raise InputError(f"{name}: reward: found {reward!r:.80}; expected a function")
        self.title, self.scenes, self.environments = name, count, count
        self._reward, self._pictures = reward, RoadPictures()
        self.configure(config)
        self.inner.seed(self.inner.everyone, random_seeds(count))

    def configure(self, config: Mapping[str, Any] | None) -> None:
        """Gives the next episodes a configuration.

        Raises:
            InputError: It has an unknown key or a value that is not supported.
        """
        try:
            self.inner = RoadScenes(self.title, self.scenes, config)
        except InputError as error:
            raise InputError(f"{self.title}: {error}") from error
        note_compiling(decide, ENGINE_OF_ROADS)
        inner = self.inner
        self.decision_hz = inner.config["policy_frequency"]
        self.spaces = spaces_of(inner)
        self.numbers = range(inner.agents)
        self.action_names = getattr(inner.actions, "names", ())
        self.idle = self.action_names.index("IDLE") if "IDLE" in self.action_names else 0
        self._seen: Any = None
        """The last observations (B, ...); None before the first start."""
        self._decision: Any = None
        self._given: Any = None
        self._own_rewards: Floats | None = None
        """(B, agents) the last rewards of one's own."""
        self._vehicles: dict[int, RoadVehicle] = {}

    def check_started(self, what: str) -> None:
        if self._seen is None:
            raise ResetNeeded(f"{what} before the first reset")

    def reseed(self, rows: Ints, seeds: Seeds) -> None:
        """Leaves the observations as they are that were returned before."""
        if rows.size < self.scenes:
            self._seen = deepcopy(self._seen)

    def start(self, rows: Ints, seeds: Seeds) -> None:
        inner = self.inner
        given = [k for k, own in enumerate(seeds) if own is not None]
        if given:
            inner.seed(rows[given], np.array([seeds[k] for k in given], dtype=np.uint64))
        inner.start(rows)
        first = inner.observe(rows)
        if self._seen is None or rows.size == self.scenes:
            self._seen = first
        else:
            put(self._seen, rows, first)
        self._vehicles = {}

    def observe(self) -> Any:
        return self._seen

    def begin(self, observations: Any, rows: Ints) -> None:
        if observations is not self._seen:
            put(observations, rows, row_of(self._seen, rows))

    def decide(self, actions: Any, due: Ints = NO_SCENES) -> Decided:
        inner, generator = self.inner, self.inner.scenes.generator
        self.check_started("step")
        self._given = actions if inner.has_agents else array_of(actions)
        before = generator[due].copy()
        decision = inner.step(_checked(self._given, inner))
        generator[due] = before
        self._decision, self._seen, self._vehicles = decision, decision.observations, {}
        rewards = decision.rewards if self._reward is None else self._rewards(decision)
        return Decided(decision.observations, rewards, decision.terminated, decision.truncated)

    def _rewards(self, decision: Decision) -> Floats:
        """Rewards (B,) of one's own; those of several agents are averaged, as in highway-env."""
        vehicles = self.inner.scenes.vehicles[:]
        vehicles.flags.writeable = False
        found = np.array(self._reward(vehicles, dict(_terms(self.inner, decision))), float)  # type: ignore[misc]
        agents = (self.inner.agents,) * self.inner.has_agents
        if found.shape != (shape := (self.scenes, *agents)):
            expected = f"expected {shape}, one for each environment" + " and agent" * bool(agents)
            raise InputError(f"{self.title}: reward: found the shape {found.shape}; {expected}")
        if not agents:
            return found
        self._own_rewards = found
        return np.asarray(found.mean(axis=1))

    def facts(self, known: Bools) -> dict[str, Any]:
        """highway-env's infos."""
        inner, facts = self.inner, {}
        if inner.task.has_info:
            facts = {**self.first(), "action": self._given}
        if inner.task.terms:
            facts["rewards"] = masked(dict(_terms(inner, self._decision)), known)
        return facts | self._information()

    def _information(self) -> dict[str, Any]:
        """What the task adds to infos, (B, ...) by name."""
        found = self.inner.task.information(self.inner.scenes)
        own = {} if self._own_rewards is None else {"agents_rewards": self._own_rewards}
        return {**found, **own}

    def first(self) -> dict[str, Any]:
        """What every info has, (B,) by name [`AbstractEnv._info`]."""
        ego = self.inner.scenes.vehicles[:, 0]
        return {"speed": ego["speed"].copy(), "crashed": ego["crashed"].copy()}

    @property
    def meta_actions(self) -> MetaActions:
        """The meta-actions; an `InputError` if there are none."""
        if isinstance(self.inner.actions, Controls):
            raise InputError(f"{self.title}: action masks: expected meta-actions")
        return self.inner.actions

    def masks(self) -> Any:
        """The action masks (B, A) of the first ego, or (B, agents, A) where actions are tuples."""
        inner, meaning = self.inner, self.meta_actions.meaning
        self.check_started("action masks")
        masks = available_actions(inner.scenes, inner.agents)[..., meaning]
        return masks if inner.has_agents else masks[:, 0]

    def frame(self, row: int) -> Frame:
        return self._pictures.frame(self.inner, row)

    def state(self) -> EpisodesState:
        self.check_started("get_state")
        return self.inner.state(self._seen)

    def restore(self, state: Any) -> None:
        try:
            self._seen = self.inner.restore(state)
        except InputError as error:
            raise InputError(f"{self.title}: {error}") from error
        self._vehicles = {}

    def saved(self, next_seed: int | None) -> EpisodesState:
        return self.state()._replace(next_seed=next_seed)

    def load(self, state: Any) -> int | None:
        self.restore(state)
        found: int | None = state.next_seed
        return found

    def decide_one(self, action: Any) -> Decided:
        if not self.inner.has_agents:
            return self.decide(array_of(action)[None])
        return self.decide([array_of(each)[None] for each in _parts(action)])

    def result(self, decided: Decided, action: Any) -> Any:
        """In `intersection-multi-agent` from `-v1` on, rewards and endings are tuples."""
        inner, info = self.inner, self.first_info() if self.inner.task.has_info else {}
        if info:
            info["action"] = action
        if inner.task.terms:
            terms = self._decision.terms[0].tolist()
            info["rewards"] = dict(zip(inner.task.terms, terms, strict=True))
        for name, each in self._information().items():
            info[name] = tuple(each[0].tolist()) if np.ndim(each) > 1 else each[0].item()
        seen, truncated = row_of(decided.observations, 0), bool(decided.truncated[0])
        if inner.is_split:
            return seen, info["agents_rewards"], info["agents_terminated"], truncated, info
        reward, terminated = float(decided.rewards[0]), bool(decided.terminated[0])
        return seen, reward, terminated, truncated, info

    def first_info(self) -> dict[str, Any]:
        return {name: each[0].item() for name, each in self.first().items()}

    def vehicles(self) -> dict[int, RoadVehicle]:
        """The vehicles of the first scene by their places."""
        self.check_started("vehicles")
        if not self._vehicles:
            self._vehicles = vehicles_of(self.inner, 0)
        return self._vehicles

    def goal_rewards(self, achieved: Floats, desired: Floats, exponent: float) -> Any:
        """The rewards (...) of goals (..., F)."""
        if not isinstance(self.inner.task, Parking):
            raise InputError(f"{self.title}: compute_reward: there are no goals")
        found = self.inner.task.goal_rewards(achieved, desired, exponent)
        return found if found.ndim else found[()]

    def check_agents(self) -> None:
        """Checks that each agent has observations, meta-actions and rewards of its own."""
        inner, title = self.inner, self.title
        if not (inner.has_agents and inner.sees_agents):
            raise InputError(
                f"{title}: expected actions of type 'MultiAgentAction' and observations of type "
                "'MultiAgentObservation'"
            )
        if not inner.task.rewards_each:
            raise InputError(f"{title}: highway-env has rewards of the first of several egos only")
        if "IDLE" not in self.action_names:
            raise InputError(f"{title}: expected actions of type 'DiscreteMetaAction'")

    def spaces_of_agents(self) -> list[Spaces]:
        seen: Any
        chosen: Any
        seen, chosen = self.spaces
        return [*zip(seen, chosen, strict=True)]

    def driving(self) -> Bools:
        return np.ones(self.inner.agents, dtype=np.bool_)

    def decide_each(self, chosen: Ints) -> tuple[list[float], list[bool], list[bool]]:
        decided, found = self.decide(tuple(chosen[:, None])), self._information()
        rewards, terminated = found["agents_rewards"][0], found["agents_terminated"][0]
        truncated = [bool(decided.truncated[0])] * self.inner.agents
        return rewards.tolist(), terminated.tolist(), truncated

    def seen_by(self, which: Ints) -> list[Any]:
        return [self._seen[k][0] for k in which]

    def infos_of(self, which: Ints, *, starts: bool = False) -> list[dict[str, Any]]:
        vehicles, masks = self.inner.scenes.vehicles[0], self.masks()[0]
        return [
            {
                "speed": float(vehicles["speed"][k]),
                "crashed": bool(vehicles["crashed"][k]),
                "action_mask": masks[k].astype(np.int8),
            }
            for k in which
        ]


def described(episodes: RoadScenes) -> dict[str, Any]:
    """What the space of observations says of its environment; see `spaces.trained_in`."""
    config = episodes.config
    return {
        "environment": episodes.name,
        "decision_hz": config["policy_frequency"],
        "observation": json.dumps(config["observation"], default=str),
        "action": json.dumps(config["action"], default=str),
    }


def spaces_of(episodes: RoadScenes) -> Spaces:
    """The spaces of the observations and the actions of one environment."""
    where = described(episodes)
    seen = [trained_in(observer.space, where) for observer in episodes.observers]
    chosen = [episodes.actions.space for _ in range(episodes.agents)]
    return (
        gymnasium.spaces.Tuple(seen) if episodes.sees_agents else seen[0],
        gymnasium.spaces.Tuple(chosen) if episodes.has_agents else chosen[0],
    )


def _checked(actions: Any, episodes: RoadScenes) -> Any:
    """The actions (B, ...) or those of each agent, if they are such."""
    if not episodes.has_agents:
        return _checked_of_one(actions, episodes)
    parts = _parts(actions)
    if len(parts) != episodes.agents:
        raise InputError(f"actions of {len(parts)} agents; expected {episodes.agents}")
    return tuple(_checked_of_one(array_of(each), episodes) for each in parts)


def _parts(actions: Any) -> list[Any]:
    """The actions of the agents, from any sequence."""
    try:
        return list(actions)
    except TypeError as error:
        raise InputError(f"action {actions!r}; expected those of several agents") from error


def _checked_of_one(actions: NDArray[Any], episodes: RoadScenes) -> NDArray[Any]:
    """The actions (B, ...) of one agent, if they are such."""
    space = episodes.action_space
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
    if actions.min() < 0 or actions.max() >= most:
        wrong = actions[(actions < 0) | (actions >= most)][0]
        raise InputError(f"action {wrong}; expected 0 to {most - 1}")
    return actions.astype(np.int64, copy=False)


def _terms(episodes: RoadScenes, decision: Decision) -> Any:
    """The terms (B,) of the rewards by name, without their weights."""
    return zip(episodes.task.terms, decision.terms.T, strict=True)

"""The episodes that a network learns from: environments of different scenes, side by side."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_agents.training.network import Arrays
from charms_bench.engine.state_file import check_state
from charms_bench.envs.vector_env import EpisodesState, HighwayVectorEnv
from charms_bench.world.scene import Bools, Floats, Observations

_ENDED = ("ending", "steps", "episode_return")


class Step(NamedTuple):
    """A decision in each of B environments."""

    observed: Observations
    """(B, rows, columns) before the next decision: of the next episode, where one has ended."""
    following: Observations
    """(B, rows, columns) after this decision, also where the episode has ended."""
    rewards: Floats
    failed: Bools
    """(B,) whether the ego has crashed or left the road."""
    ended: Bools
    """(B,) whether the episode is over, for that reason or because its time is."""
    facts: list[dict[str, Any]]
    """The ending, steps and return of each ended episode."""


class Episodes:
    """Vector environments as one; those of the first come first."""

    def __init__(self, environments: Sequence[HighwayVectorEnv[Any]]) -> None:
        self._environments = environments
        self._ends = list(accumulate(each.num_envs for each in environments))

    def reset(self) -> Observations:
        """Starts an episode in every environment; returns the observations (B, rows, columns)."""
        return np.concatenate([each.reset()[0] for each in self._environments])

    def step(self, actions: NDArray[np.int64]) -> Step:
        """Carries out the actions (B,)."""
        given = np.split(actions, self._ends[:-1])
        steps = [_step(each, own) for each, own in zip(self._environments, given, strict=True)]
        *arrays, facts = zip(*steps, strict=True)
        joined = [fact for each in facts for fact in each]
        observed, following, rewards, failed, ended = map(np.concatenate, arrays)
        return Step(observed, following, rewards, failed, ended, joined)

    def arrays(self) -> Arrays:
        """The state of all running episodes, as plain arrays."""
        arrays: Arrays = {}
        for k, environment in enumerate(self._environments):
            state = environment.get_state()
            arrays[f"episodes/{k}/next_seed"] = np.array(state.next_seed)
            arrays[f"episodes/{k}/returns"] = state.returns
            for name, array in state.scenes.arrays().items():
                arrays[f"scenes/{k}/{name}"] = array
        return arrays

    def load_arrays(self, arrays: Arrays) -> Observations:
        """Takes over what `arrays` returned for the same environments; returns observations."""
        observed = []
        for k, environment in enumerate(self._environments):
            own = environment.get_state().scenes
            scenes = own.with_arrays({name: arrays[f"scenes/{k}/{name}"] for name in own.arrays()})
            scenes = replace(scenes, is_from_file=True)
            check_state(scenes)
            returns, next_seed = (
                arrays[f"episodes/{k}/{name}"] for name in ("returns", "next_seed")
            )
            observed.append(environment.set_state(EpisodesState(scenes, returns, int(next_seed))))
        return np.concatenate(observed)


def _step(environment: HighwayVectorEnv[Any], actions: NDArray[np.int64]) -> Step:
    observed, rewards, failed, is_over, infos = environment.step(actions)
    following, ended = observed.copy(), failed | is_over
    rows = np.flatnonzero(ended)
    for row in rows:
        following[row] = infos["final_obs"][row]
    facts = [{name: infos["final_info"][name][row].item() for name in _ENDED} for row in rows]
    return Step(observed, following, rewards, failed, ended, facts)

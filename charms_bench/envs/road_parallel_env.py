"""highway-env's environments with several agents as a PettingZoo `ParallelEnv`.

It needs the extra `pettingzoo`.
"""

from collections.abc import Mapping
from typing import Any

from charms_bench.envs.parallel_env import AgentsParallelEnv
from charms_bench.envs.rendering import RENDER_MODES
from charms_bench.envs.road_episodes import RoadEpisodes, RoadReward


class RoadParallelEnv(AgentsParallelEnv):
    """An `AgentsParallelEnv` of one of highway-env's environments with several agents.

    `vehicle_k` is the k-th of highway-env's `controlled_vehicles`. That of an agent that has left
    is given no more actions but `IDLE`. The same seed gives the scene of highway-env, and the same
    actions the same episode. Infos contain the vehicle's `speed` and whether it has `crashed`.

    Args:
        name: highway-env's name of the environment, such as `intersection-multi-agent-v1`.
        config: highway-env's configuration; what is not given has its default.
        render_mode: `rgb_array`, `human`, or None.
        reward: The rewards (1, agents) of a decision, see `RoadReward`; by default highway-env's.

    Raises:
        InputError: The environment has one agent or actions that are not meta-actions, its
            configuration is not supported, or there is no such mode.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # pettingzoo's declaration
        "name": "charms_bench_road_v0",
        "render_modes": RENDER_MODES,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        name: str,
        config: Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        reward: RoadReward | None = None,
    ) -> None:
        episodes = RoadEpisodes(name, 1, config, reward)
        episodes.check_agents()
        super().__init__(episodes, render_mode)

"""Gymnasium environments. Importing this package registers `charms_bench/Ego-v0`, and
highway-env's environments under its own names, such as `charms_bench/merge-v0`.

    import gymnasium
    import charms_bench.envs

    gymnasium.make("charms_bench/Ego-v0", traffic="pch", density=1.5)
    gymnasium.make_vec("charms_bench/Ego-v0", num_envs=100, traffic={"idm_mobil": 1.0})

With the name `charms_bench.envs:charms_bench/Ego-v0`, Gymnasium imports the package itself.
"""

import gymnasium

from charms_bench.roads import TASKS

ID = "charms_bench/Ego-v0"

gymnasium.register(
    ID,
    entry_point="charms_bench.envs.ego_env:EgoEnv",
    vector_entry_point="charms_bench.envs.ego_env:ego_vector_env",
)
for _name, _task in TASKS.items():
    _kind = "GoalRoadEnv" if _task.startswith("parking:") else "RoadEnv"
    gymnasium.register(
        f"charms_bench/{_name}",
        entry_point=f"charms_bench.envs.road_env:{_kind}",
        vector_entry_point="charms_bench.envs.road_env:RoadVectorEnv",
        # The checker warns of rewards and endings that are tuples [`MultiAgentWrapper`].
        disable_env_checker="multi-agent" in _name,
        kwargs={"name": _name},
    )

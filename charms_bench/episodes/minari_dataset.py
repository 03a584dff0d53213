"""What the ego of a run observed, did and gained, as a Minari dataset.

The rewards are those of `charms_bench/Ego-v0` for the ego's kind of actions, so an environment that
starts with an episode's seed and takes its actions gives the same observations and rewards.
"""

import re
from collections.abc import Callable, Sequence
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import polars as pl
from gymnasium.envs.registration import EnvSpec

from charms_bench import __version__
from charms_bench.engine.endings import ENDINGS
from charms_bench.engine.simulation import Simulation
from charms_bench.envs import ID
from charms_bench.envs.ego_env import reward_of
from charms_bench.envs.learners import Reward
from charms_bench.envs.spaces import spaces_of
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.errors import InputError
from charms_bench.foundation.words import counted
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.deciding import delay_of
from charms_bench.plugins.registry import is_network
from charms_bench.recording.recording import Recording
from charms_bench.runs.suite import Cell
from charms_bench.world.action_texts import action_objects
from charms_bench.world.actions import DEFAULT_ACTIONS, Actions, meta_actions_of
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import Neighbours, observation_of

if TYPE_CHECKING:
    from minari.data_collector import EpisodeBuffer


def check_name(path: Path) -> None:
    """Raises an `InputError` if Minari is missing, or cannot load a dataset from this folder."""
    try:
        import h5py  # noqa: F401  # only whether it is installed
        import minari  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"Minari datasets need Minari ({error}); pip install 'charms-bench[dataset]'"
        ) from error
    if not re.fullmatch(r"[\w-]+-v\d+", path.name):
        raise InputError(
            f"{path}: is not a name of a Minari dataset; expected letters, digits, - and _, and a "
            "version at the end, as in charms-v0"
        )


def check_policy(recorded: RecordedCell) -> Policy:
    """The ego's policy; raises an `InputError` if its actions are not those of an environment."""
    chosen, path = recorded.cell, recorded.run.folder.path
    policy, title = chosen.ego.agent.make(recorded.networks), chosen.ego.title
    if not isinstance(policy, Policy):
        raise InputError(
            f"{path}: {title} is a driver model, without observations and actions; choose "
            "an ego that is a policy, or --format highd, which has the trajectories of all egos"
        )
    if policy.decision_hz != chosen.scene.decision_hz:
        raise InputError(
            f"{path}: {title} decides {policy.decision_hz:g} times per second and the "
            f"suite records {chosen.scene.decision_hz} decisions per second; expected equal rates, "
            f"as after a run of the suite with scene.decision_hz: {policy.decision_hz:g}"
        )
    if delay_of(observation_of(policy.observation)):
        raise InputError(
            f"{path}: {title} sees others with a delay, and a dataset has what is there; expected "
            "an observation without delay_decisions, or --format highd"
        )
    return policy


def write_minari(
    recorded: RecordedCell,
    episodes: Sequence[int],
    path: Path,
    name: str,
    tell: Callable[[int], object],
) -> None:
    """Writes a dataset, which Minari will load by this name, into an empty folder.

    The ego is one that `check_policy` accepts. `tell` is told how many episodes have been written.
    Raises a `RunFolderError` if an episode no longer runs as it was recorded.
    """
    import minari
    from minari.dataset.minari_storage import MinariStorage

    chosen, suite = recorded.cell, recorded.run.suite.suite
    policy = check_policy(recorded)
    observation = observation_of(policy.observation)
    # `minari.create_dataset_from_buffers` keeps all episodes in memory and takes no folder.
    data = path.absolute() / "data"  # Minari cannot measure the size of a relative path
    spaces = spaces_of(chosen.scene, observation, policy.actions)
    storage = MinariStorage.new(data, *spaces, environment_of(chosen, policy))
    storage.update_metadata(
        {
            "dataset_id": name,
            "algorithm_name": chosen.ego.title,
            "author": {"charms-bench"},
            "description": f"{chosen.title}, {counted(len(episodes), 'episode')} of suite {suite}",
            "requirements": [f"charms-bench=={__version__}"],
            "minari_version": minari.__version__,
        }
    )
    first = 0
    while first < len(episodes):
        shard = recorded.shard_of(episodes[first])
        some = episodes[first : first + len(shard)]
        buffers, endings = _simulated(recorded, some, shard, policy)
        storage.update_episodes(buffers)
        numbers = range(first, first + len(some))
        storage.update_episode_metadata([{"ending": each} for each in endings], numbers)
        tell(len(some))
        first += len(some)


def environment_of(cell: Cell, policy: Policy) -> EnvSpec | None:
    """Returns what `gymnasium.make` needs to make the environment of a cell's episodes.

    It is None where plain values cannot describe the environment: for a scenario, a road, a traffic
    with options, a network given by path, or an observation of a plugin.
    """
    traffic, observation = cell.traffic.traffic, observation_of(policy.observation)
    is_plain = not (traffic.options or traffic.scenario or cell.road)
    is_plain &= not any(map(is_network, (traffic.name or "", *traffic.mixture)))
    if not is_plain or not isinstance(observation, Neighbours | Kinematics):
        return None
    actions = meta_actions_of(policy.actions)
    is_own = actions not in ((), DEFAULT_ACTIONS)
    spec = deepcopy(gymnasium.spec(ID))
    spec.kwargs = {
        "traffic": traffic.name or traffic.mixture,
        "observation": {"type": observation.name, **observation.model_dump(mode="json")},
        "actions": action_objects(actions) if is_own else policy.actions,
        **cell.scene.model_dump(mode="json"),
    }
    return spec


def _of_egos(simulation: Simulation) -> Actions:
    """What policies have just decided for the egos, of all scenes; 0 in those that are over."""
    decided = []
    for (rows, places), actions in simulation.decided:
        are_egos = places == simulation.scene.ego[rows]
        decided.append((rows[are_egos], actions[are_egos]))
    (rows, actions), *_ = [each for each in decided if each[0].size]
    taken = np.zeros((simulation.scene.active.size, *actions.shape[1:]), actions.dtype)
    taken[rows] = actions
    return taken


def _simulated(
    recorded: RecordedCell, episodes: Sequence[int], shard: range, policy: Policy
) -> tuple[list["EpisodeBuffer"], list[str]]:
    """Returns the egos' episodes, and how each ended.

    They are the first episodes of a shard, which is simulated as in the run: the size of a batch
    can decide between two actions that are almost equally good.
    """
    from minari.data_collector import EpisodeBuffer

    simulation = recorded.simulation(len(shard))
    simulation.reset(np.array(shard, dtype=np.uint64))
    recording, observation = Recording(simulation), observation_of(policy.observation)
    reward: Reward[Any] = reward_of(policy.actions, simulation.settings)
    egos = simulation.ego_vehicles
    observed = [observation(simulation.scene, egos)]
    taken, gained = [], []
    while simulation.scene.active.any():
        before = reward.prepare(simulation, simulation.action[egos])
        simulation.advance()
        taken.append(_of_egos(simulation))
        while simulation.phase < simulation.settings.steps_per_decision:
            simulation.advance()
        simulation.finish_step()
        recording.note()
        gained.append(reward(simulation, before))
        observed.append(observation(simulation.scene, egos))
    steps = recording.steps().filter(pl.col("episode").is_in(list(episodes)))
    recorded.check_steps(recorded.steps(episodes), steps)
    observations, actions, rewards = np.stack(observed), np.stack(taken), np.stack(gained)
    failed, truncated = simulation.failed, simulation.truncated
    buffers = []
    for b, episode in enumerate(episodes):
        length = int(simulation.steps[b])
        is_last = np.arange(length) == length - 1
        buffers.append(
            EpisodeBuffer(
                seed=episode,
                observations=observations[: length + 1, b],
                actions=actions[:length, b],
                rewards=rewards[:length, b],
                terminations=is_last & failed[b],
                truncations=is_last & truncated[b],
            )
        )
    return buffers, [ENDINGS[ending] for ending in simulation.ending[: len(episodes)]]

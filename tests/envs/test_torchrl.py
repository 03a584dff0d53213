"""The vector environment as TorchRL sees it."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from charms_bench.envs import ID

torchrl = pytest.importorskip("torchrl.envs", reason="`tox -e libraries` has it")

SEED, SCENES, DECISIONS = 900_000_000, 3, 40


def made() -> Any:
    return gymnasium.make_vec(ID, num_envs=SCENES, density=2.0)


@pytest.mark.filterwarnings("ignore")
def test_torchrl_sees_the_ends_and_the_starts_of_episodes() -> None:
    env = torchrl.GymWrapper(made(), categorical_action_encoding=True)
    env.set_seed(SEED)  # which resets, and so does the rollout
    rolled = env.rollout(DECISIONS, break_when_any_done=False)
    ours = made()
    ours.reset(seed=SEED)
    observations, _ = ours.reset()
    ends = 0
    for k in range(DECISIONS):
        seen = rolled[:, k]
        np.testing.assert_array_equal(seen["observation"], observations)
        observations, rewards, failed, over, infos = ours.step(seen["action"].numpy())
        after, ended = observations.copy(), failed | over
        for row in np.nonzero(ended)[0]:
            after[row] = infos["final_obs"][row]
        np.testing.assert_array_equal(seen["next", "observation"], after)
        np.testing.assert_allclose(seen["next", "reward"][:, 0], rewards, rtol=1e-6)
        np.testing.assert_array_equal(seen["next", "terminated"][:, 0], failed)
        np.testing.assert_array_equal(seen["next", "truncated"][:, 0], over)
        ends += ended.sum()
    assert ends >= 3

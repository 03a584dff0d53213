"""Level-k drivers without human data: Level-0, and CHARMS before its fine-tuning."""

from importlib.resources import files

import numpy as np

from charms_bench.agent import IDLE, SLOWER, Actions, Observations, Policy
from charms_bench.observation import FRONT, X_SCALE_M
from charms_bench.onnx_policy import OnnxPolicy


class Level0(Policy):
    """Keeps speed and lane; SLOWER while a slower vehicle is within 30 m ahead in its lane."""

    def decide(self, observations: Observations) -> Actions:
        presence, x, _, vx, _ = observations[:, FRONT].T
        return np.where((presence > 0) & (x * X_SCALE_M < 30) & (vx < 0), SLOWER, IDLE)


def prior_level_k() -> OnnxPolicy:
    """The packaged Level-2 network, efficient and egoistic, as reinforcement learning left it."""
    return OnnxPolicy(str(files("charms_agents") / "policies" / "prior_level_k.onnx"))

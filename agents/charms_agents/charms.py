"""The paper's agents that are networks; the network files are in this package."""

from functools import partial
from importlib.resources import files

from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy

SVOS = ("competitive", "egoistic", "prosocial", "altruistic")
"""Social value orientations, from the least to the most weight on other drivers."""
STYLES = {
    "charms" if (priority, svo) == ("efficient", "egoistic") else f"charms-{priority}-{svo}": (
        priority,
        svo,
    )
    for priority in ("efficient", "safe")
    for svo in SVOS
}
"""Priority and orientation of each agent of CHARMS; `charms` is the agent in the paper's table."""


def packaged(network: str) -> OnnxPolicy:
    """The policy of a network in this package; raises a `ModelError` if it is not installed."""
    file = files("charms_agents") / "policies" / f"{network}.onnx"
    if not file.is_file():
        raise ModelError(
            f"the network '{network}' is not in this installation of charms-bench; "
            "suites/train.yaml or suites/train-baselines.yaml trains it, and the path of the "
            "trained file is an agent's name"
        )
    return OnnxPolicy(str(file))


efficient_competitive, efficient_egoistic, efficient_prosocial, efficient_altruistic = (
    partial(packaged, f"charms_efficient_{svo}") for svo in SVOS
)
safe_competitive, safe_egoistic, safe_prosocial, safe_altruistic = (
    partial(packaged, f"charms_safe_{svo}") for svo in SVOS
)
best_response = partial(packaged, "best_response")
imitation = partial(packaged, "imitation")
prior_level_k = partial(packaged, "prior_level_k")
prior_level_k_safe = partial(packaged, "prior_level_k_safe")

"""The paper's agents that are networks; the network files are in this package."""

from collections.abc import Callable
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
    """The policy of a network in this package.

    Raises:
        ModelError: The network is not in this installation, or cannot be used.
    """
    file = files("charms_agents") / "policies" / f"{network}.onnx"
    if not file.is_file():
        raise ModelError(
            f"the network '{network}' is not in this installation of charms-bench; "
            "suites/train.yaml trains it, and {onnx: path} uses the trained file"
        )
    return OnnxPolicy(str(file))


Factory = Callable[[], OnnxPolicy]

efficient_competitive: Factory = partial(packaged, "charms_efficient_competitive")
efficient_egoistic: Factory = partial(packaged, "charms_efficient_egoistic")
efficient_prosocial: Factory = partial(packaged, "charms_efficient_prosocial")
efficient_altruistic: Factory = partial(packaged, "charms_efficient_altruistic")
safe_competitive: Factory = partial(packaged, "charms_safe_competitive")
safe_egoistic: Factory = partial(packaged, "charms_safe_egoistic")
safe_prosocial: Factory = partial(packaged, "charms_safe_prosocial")
safe_altruistic: Factory = partial(packaged, "charms_safe_altruistic")
imitation: Factory = partial(packaged, "imitation")
prior_level_k: Factory = partial(packaged, "prior_level_k")
prior_level_k_safe: Factory = partial(packaged, "prior_level_k_safe")

"""The agents of the paper that are networks, from the files in this package."""

from collections.abc import Callable
from functools import partial
from importlib.resources import files

from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy

SVOS = ("competitive", "egoistic", "prosocial", "altruistic")
"""Social value orientations, by how much they care for others."""
STYLES = {
    "charms" if (priority, svo) == ("efficient", "egoistic") else f"charms-{priority}-{svo}": (
        priority,
        svo,
    )
    for priority in ("efficient", "safe")
    for svo in SVOS
}
"""What each agent of CHARMS puts first, and its orientation; `charms` is the paper's row."""


def packaged(network: str) -> OnnxPolicy:
    """The network of that name.

    Raises:
        ModelError: It is not in this installation, or cannot be used.
    """
    file = files("charms_agents") / "policies" / f"{network}.onnx"
    if not file.is_file():
        raise ModelError(
            f"the network '{network}' is not in this installation of charms-bench; "
            "suites/train.yaml trains it, and {onnx: path} drives with the file"
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

"""The agents of CHARMS and imitation: packaged networks, which learnt from human driving."""

from collections.abc import Callable
from functools import partial
from importlib.resources import files

from charms_bench.errors import ModelError
from charms_bench.onnx_policy import OnnxPolicy


def packaged(network: str) -> OnnxPolicy:
    """The packaged network of that name.

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

imitation: Factory = partial(packaged, "imitation")
efficient_competitive: Factory = partial(packaged, "charms_efficient_competitive")
efficient_egoistic: Factory = partial(packaged, "charms_efficient_egoistic")
"""The paper's row "CHARMS"."""
efficient_prosocial: Factory = partial(packaged, "charms_efficient_prosocial")
efficient_altruistic: Factory = partial(packaged, "charms_efficient_altruistic")
safe_competitive: Factory = partial(packaged, "charms_safe_competitive")
safe_egoistic: Factory = partial(packaged, "charms_safe_egoistic")
safe_prosocial: Factory = partial(packaged, "charms_safe_prosocial")
safe_altruistic: Factory = partial(packaged, "charms_safe_altruistic")

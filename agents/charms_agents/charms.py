"""The paper's agents that are networks; the network files are in this package."""

from functools import partial
from importlib.resources import files
from itertools import product

from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy

SVOS = ("competitive", "egoistic", "prosocial", "altruistic")
"""Social value orientations, from the least to the most weight on other drivers."""
STYLES = {
    "charms" if style == ("efficient", "egoistic") else "-".join(("charms", *style)): style
    for style in product(("efficient", "safe"), SVOS)
}
"""Priority and orientation of each agent of CHARMS; `charms` is the agent in the paper's table."""


def packaged(network: str) -> OnnxPolicy:
    """The policy of a network in this package; raises a `ModelError` if it is not installed."""
    file = files("charms_agents") / "policies" / f"{network}.onnx"
    if not file.is_file():
        raise ModelError(
            f"the network '{network}' is not in this installation of charms-bench; "
            "suites/train.yaml, train-baselines.yaml, train-paper.yaml or train-roads.yaml trains "
            "it, and the path of the trained file is an agent's name"
        )
    return OnnxPolicy(str(file))


efficient_competitive = partial(packaged, "charms_efficient_competitive")
"""CHARMS, efficient and competitive."""
efficient_egoistic = partial(packaged, "charms_efficient_egoistic")
"""CHARMS, efficient and egoistic: the style of the paper's Table II."""
efficient_prosocial = partial(packaged, "charms_efficient_prosocial")
"""CHARMS, efficient and prosocial."""
efficient_altruistic = partial(packaged, "charms_efficient_altruistic")
"""CHARMS, efficient and altruistic."""
safe_competitive = partial(packaged, "charms_safe_competitive")
"""CHARMS, safe and competitive."""
safe_egoistic = partial(packaged, "charms_safe_egoistic")
"""CHARMS, safe and egoistic."""
safe_prosocial = partial(packaged, "charms_safe_prosocial")
"""CHARMS, safe and prosocial."""
safe_altruistic = partial(packaged, "charms_safe_altruistic")
"""CHARMS, safe and altruistic."""
best_response = partial(packaged, "best_response")
"""The best response to CHARMS traffic, eq. 13 of the paper."""
on_roads = partial(packaged, "charms_roads")
"""CHARMS for all roads, efficient and egoistic, which observes junctions."""
paper = partial(packaged, "charms_paper")
"""CHARMS, efficient and egoistic, by the settings that the paper states; `charms` has others."""
imitation = partial(packaged, "imitation")
"""A network that imitates recorded drivers."""
prior_level_k = partial(packaged, "prior_level_k")
"""The paper's Level-k baseline, efficient."""
prior_level_k_safe = partial(packaged, "prior_level_k_safe")
"""The paper's Level-k baseline, safe."""

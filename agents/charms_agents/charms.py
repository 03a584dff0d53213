"""The paper's agents that are networks; the network files are in this package."""

from functools import partial
from importlib.resources import files
from itertools import product

from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy

SVOS = ("competitive", "egoistic", "prosocial", "altruistic")
"""Social value orientations, from the least to the most weight on other drivers."""
FAMILIES = ("charms", "charms-roads")
"""The agents of CHARMS: those of the straight road, and one network for all roads."""


def agents_of(family: str) -> dict[str, tuple[str, str]]:
    """Priority and orientation of each agent of a family, whose name is the efficient egoist's."""
    return {
        family if style == ("efficient", "egoistic") else "-".join((family, *style)): style
        for style in product(("efficient", "safe"), SVOS)
    }


STYLES = agents_of("charms")
"""Priority and orientation of each agent of CHARMS; `charms` is the agent in the paper's table."""


def packaged(network: str, style: str | None = None) -> OnnxPolicy:
    """The policy of a network in this package, in one of its styles if it has several.

    Raises:
        ModelError: It is not installed.
    """
    file = files("charms_agents") / "policies" / f"{network}.onnx"
    if not file.is_file():
        raise ModelError(
            f"the network '{network}' is not in this installation of charms-bench; "
            "suites/train.yaml, train-baselines.yaml, train-paper.yaml or train-roads.yaml trains "
            "it, and the path of the trained file is an agent's name"
        )
    return OnnxPolicy(str(file), style=style)


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
"""CHARMS for all roads, which observes junctions; it is efficient and egoistic by default."""
roads_efficient_competitive = partial(on_roads, "efficient_competitive")
roads_efficient_prosocial = partial(on_roads, "efficient_prosocial")
roads_efficient_altruistic = partial(on_roads, "efficient_altruistic")
roads_safe_competitive = partial(on_roads, "safe_competitive")
roads_safe_egoistic = partial(on_roads, "safe_egoistic")
roads_safe_prosocial = partial(on_roads, "safe_prosocial")
roads_safe_altruistic = partial(on_roads, "safe_altruistic")
paper = partial(packaged, "charms_paper")
"""CHARMS, efficient and egoistic, by the settings that the paper states; `charms` has others."""
imitation = partial(packaged, "imitation")
"""A network that imitates recorded drivers."""
prior_level_k = partial(packaged, "prior_level_k")
"""The paper's Level-k baseline, efficient."""
prior_level_k_safe = partial(packaged, "prior_level_k_safe")
"""The paper's Level-k baseline, safe."""

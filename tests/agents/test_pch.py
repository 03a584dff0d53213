"""The population of styles: held against scipy's distributions."""

import math

import numpy as np
import pytest
from charms_agents.charms import FAMILIES, STYLES, SVOS, agents_of
from charms_agents.pch import Pch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from charms_bench.errors import InputError
from charms_bench.plugins.registry import AGENTS, make_traffic, plugins

TAUS = st.floats(0, 20)
BETAS = st.floats(0, 1)


def probability(tau: float, beta: float, name: str) -> float:
    """Of eq. 12, with all that Poisson puts beyond altruistic added to it."""
    priority, svo = STYLES[name]
    k = SVOS.index(svo)
    along_svo = stats.poisson.sf(2, tau) if k == 3 else stats.poisson.pmf(k, tau)
    along_priority = stats.bernoulli.pmf(priority == "efficient", beta)
    return float(along_svo * along_priority)


@settings(deadline=None)
@given(tau=TAUS, beta=BETAS, seed=st.integers(0, 2**32))
def test_styles_are_as_frequent_as_the_closed_form_says(tau: float, beta: float, seed: int) -> None:
    vehicles = 4000
    assigned = Pch(tau, beta).assign(np.random.default_rng(seed), 1, vehicles)
    for name in STYLES:
        expected = probability(tau, beta, name)
        error = math.sqrt(expected * (1 - expected) / vehicles)
        proportion = float((assigned == name).mean())
        # Six standard errors, and two vehicles for a style that is hardly ever drawn.
        assert abs(proportion - expected) <= 6 * error + 2 / vehicles, name


def test_the_papers_point_gives_known_proportions() -> None:
    # exp(-1.5) = 0.2231; times 1.5, 1.125 and what is left; each halved.
    expected = {
        "competitive": 0.1116,
        "egoistic": 0.1673,
        "prosocial": 0.1255,
        "altruistic": 0.0956,
    }
    assigned = Pch().assign(np.random.default_rng(0), 1, 200_000)
    for name, (_, svo) in STYLES.items():
        assert (assigned == name).mean() == pytest.approx(expected[svo], abs=0.003)


def test_at_tau_zero_everybody_competes() -> None:
    assigned = Pch(tau=0.0, beta=1.0).assign(np.random.default_rng(0), 3, 20)
    assert set(assigned.ravel()) == {"charms-efficient-competitive"}


def test_other_agents_take_the_proportions_of_the_styles_that_they_are_given_for() -> None:
    styles = {"efficient-egoistic": "mine.onnx", "safe-egoistic": "mine.onnx"}
    traffic = Pch(tau=1.5, beta=0.5, styles=styles)
    assigned = traffic.assign(np.random.default_rng(0), 1, 200_000)
    # exp(-1.5) times 1.5, efficient and safe together.
    assert (assigned == "mine.onnx").mean() == pytest.approx(0.3347, abs=0.005)
    assert set(STYLES) - set(traffic.agents) == {"charms", "charms-safe-egoistic"}


@pytest.mark.parametrize("family", FAMILIES)
def test_every_style_is_an_installed_agent(family: str) -> None:
    agents = set(make_traffic("pch", {"family": family}).agents)
    assert agents == set(agents_of(family)) <= set(plugins(AGENTS))


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"tau": -0.1}, "tau must be 0 or more, got -0.1"),
        ({"tau": math.nan}, "tau must be 0 or more, got nan"),
        ({"tau": math.inf}, "tau must be 0 or more, got inf"),
        ({"tau": "1.5"}, "tau must be 0 or more, got '1.5'"),
        ({"beta": 1.1}, "beta must be from 0 to 1, got 1.1"),
        ({"beta": True}, "beta must be from 0 to 1, got True"),
        ({"styles": ["a"]}, r"styles must be a mapping of styles to agents: \['a'\]"),
        ({"styles": {"safe-egoist": "a"}}, "no style 'safe-egoist'.* Did you mean 'safe-egoistic'"),
        ({"family": "roads"}, "family: expected charms or charms-roads, got 'roads'"),
        ({"styles": {"safe-egoistic": 3}}, "safe-egoistic must be an agent's name, got 3"),
    ],
)
def test_what_is_no_parameter_is_rejected(options: dict[str, float], what: str) -> None:
    with pytest.raises(InputError, match=what):
        make_traffic("pch", options)

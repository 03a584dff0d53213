"""The careful driver of UN R157, held against a plain version at 1 kHz."""

from collections.abc import Callable
from pathlib import Path

import naive_careful_human as naive
import numpy as np
import pytest
from charms_baselines.careful_human import CarefulHuman

from charms_bench.engine.simulation import Simulation
from charms_bench.episodes.severity import margins
from charms_bench.runs.suite import load_suite
from charms_bench.world.points import Floats, values_at

SUITE = load_suite(Path(__file__).parent.parent.parent / "suites" / "r157.yaml")
EPISODES = 150
DURATION_S = 10.0
Values = dict[str, Floats]


def _cut_in(v: Values) -> naive.Others:
    return naive.cut_in(v["gap_m"], v["ego_mps"], v["closing_mps"], v["lateral_mps"])


def _cut_out(v: Values) -> naive.Others:
    return naive.cut_out(v["gap_m"], v["ego_mps"], v["lateral_mps"])


def _deceleration(v: Values) -> naive.Others:
    return naive.deceleration(v["gap_m"], v["ego_mps"], v["braking_mps2"], 1.0)


@pytest.mark.parametrize(
    ("title", "others_of"),
    [("Cut-in", _cut_in), ("Cut-out", _cut_out), ("Deceleration", _deceleration)],
)
def test_it_collides_where_the_plain_version_does_but_for_one_step_at_the_boundary(
    title: str, others_of: Callable[[Values], naive.Others]
) -> None:
    entry = next(each for each in SUITE.traffics if each.title == title)
    scene = SUITE.scene.model_copy(update={"duration_s": DURATION_S})
    settings = scene.of_scenario(entry.traffic.scenario)
    numbers = np.arange(5000, 5000 + EPISODES)
    assert entry.traffic.scenario is not None
    values = values_at(entry.traffic.scenario, numbers)
    agents = {"careful_human": CarefulHuman()}
    simulation = Simulation(settings, EPISODES, "careful_human", entry.traffic.make(), agents)
    ours = margins(simulation, numbers) <= 0

    others, ego, step_s = others_of(values), values["ego_mps"], 1 / settings.simulation_hz
    theirs = naive.crashes(others, ego, DURATION_S)
    early = naive.crashes(others, ego, DURATION_S, -step_s)
    late = naive.crashes(others, ego, DURATION_S, step_s, step_s)
    # The plain version does not model the collision of the leader that changes lanes too late.
    moved_m = values.get("lateral_mps", 1.0) * values["gap_m"] / ego
    is_compared = (moved_m > 2.1) | (title != "Cut-out")
    is_at_boundary = early != late
    assert 0 < ours[is_compared].mean() < 1
    assert is_at_boundary[is_compared].mean() < 0.05
    np.testing.assert_array_equal(
        ours[is_compared & ~is_at_boundary], theirs[is_compared & ~is_at_boundary]
    )

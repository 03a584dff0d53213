"""The careful driver of UN R157, held against a plain version at 1 kHz."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import naive_careful_human as naive
import numpy as np
import pytest
from charms_baselines.careful_human import BrakesUntil, CarefulHuman

from charms_bench.engine.simulation import Simulation
from charms_bench.episodes.severity import margins
from charms_bench.errors import InputError
from charms_bench.runs.suite import load_suite
from charms_bench.world.parameter_points import Floats, values_at

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


def _margins(title: str, driver: CarefulHuman, points: Sequence[dict[str, float]]) -> Floats:
    entry = next(each for each in SUITE.traffics if each.title == title)
    assert entry.traffic.scenario is not None
    scenario = entry.traffic.scenario.model_copy(update={"points": tuple(points)})
    scene = SUITE.scene.model_copy(update={"duration_s": DURATION_S})
    settings = scene.of_scenario(scenario)
    agents = {"careful_human": driver}
    simulation = Simulation(settings, len(points), "careful_human", entry.traffic.make(), agents)
    return margins(simulation, np.arange(len(points)))


@pytest.mark.parametrize(
    ("title", "others_of"),
    [("Cut-in", _cut_in), ("Cut-out", _cut_out), ("Deceleration", _deceleration)],
)
def test_it_collides_where_the_plain_version_does_but_for_one_step_at_the_boundary(
    title: str, others_of: Callable[[Values], naive.Others]
) -> None:
    entry = next(each for each in SUITE.traffics if each.title == title)
    assert entry.traffic.scenario is not None
    values = values_at(entry.traffic.scenario, np.arange(5000, 5000 + EPISODES))
    points = [{name: each[k] for name, each in values.items()} for k in range(EPISODES)]
    # The plain version does not model the collision of the leader that changes lanes too late.
    moved_m = values.get("lateral_mps", 1.0) * values["gap_m"] / values["ego_mps"]
    is_compared = (moved_m > 2.1) | (title != "Cut-out")

    # The plain version on time, a step early and a step late, by both rules, in one simulation.
    rules, step_s = get_args(BrakesUntil), 1 / SUITE.scene.simulation_hz
    shape = (len(rules), 3, EPISODES)
    repeated = {name: np.broadcast_to(each, shape).ravel() for name, each in values.items()}

    def each_of(axis: int, of: Sequence[float]) -> Floats:
        return np.broadcast_to(np.expand_dims(of, (1 - axis, 2)), shape).ravel()

    crashes = naive.crashes(
        others_of(repeated),
        repeated["ego_mps"],
        DURATION_S,
        stops=each_of(0, [rule == "standstill" for rule in rules]),
        later_s=each_of(1, [0.0, -step_s, step_s]),
        ahead_s=each_of(1, [0.0, 0.0, step_s]),
    )
    for rule, (theirs, early, late) in zip(rules, crashes.reshape(shape), strict=True):
        ours = _margins(title, CarefulHuman(rule), points) <= 0
        is_at_boundary = early != late
        assert 0 < ours[is_compared].mean() < 1
        assert is_at_boundary[is_compared].mean() < 0.05
        np.testing.assert_array_equal(
            ours[is_compared & ~is_at_boundary], theirs[is_compared & ~is_at_boundary], rule
        )


def test_only_who_releases_the_brake_gets_away_from_a_vehicle_that_it_has_slipped_past() -> None:
    # The intruder is 0.375 m aside after 0.47 s. The driver reacts 0.4 s later and brakes from
    # 1.62 s on. Until then it has covered 18.9 m more than the intruder and is beside it; its
    # centre is ahead after 1.8 s and its rear after 2.2 s. The intruder reaches its path after
    # 2.5 s. If the driver still brakes, the intruder hits it from behind after about 4.7 s.
    point = {"gap_m": 15.743, "closing_mps": 11.645, "ego_mps": 28.032, "lateral_mps": 0.794}
    (clear,) = _margins("Cut-in", CarefulHuman("clear"), [point])
    (standstill,) = _margins("Cut-in", CarefulHuman("standstill"), [point])
    assert clear > 0 > standstill


def test_an_unknown_rule_is_named() -> None:
    rule: Any = "later"
    with pytest.raises(InputError, match="brakes_until: found 'later', expected 'clear' or 'stan"):
        CarefulHuman(rule)

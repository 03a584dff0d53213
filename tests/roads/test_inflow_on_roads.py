"""Vehicles that flow into roads: how many, where, how far apart, and what is rejected."""

from typing import Any

import numpy as np
import pytest
from road_simulations import simulation

from charms_bench import load_state, save_state
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError

FLOW = {"vehicles_per_hour_and_lane": 600, "capacity": 100}


def flowing(road: str, traffic: str = "environment", flow: Any = FLOW, **scene: Any) -> Simulation:
    return simulation(road, traffic, inflow=flow, duration_s=60.0, **scene)


def continued(made: Simulation, decisions: int) -> None:
    """Advances all scenes, whatever happens to their egos."""
    for _ in range(decisions):
        made.step()
        made.ending[:] = 0
        made.engine.state.active[:] = True


@pytest.mark.parametrize("traffic", ["environment", "idm_mobil"])
@pytest.mark.parametrize(("road", "lanes"), [("exit-v1", 6), ("merge-v1", 3), ("motorway", 5)])
def test_as_many_vehicles_come_as_the_rate_says(road: str, lanes: int, traffic: str) -> None:
    made = flowing(road, traffic)
    first = made.engine.state.entry.max()
    continued(made, 90)
    come = made.engine.state.entry.max(axis=1) - first
    expected = 4 * lanes * 600 / 3600 * 30
    assert abs(come.sum() - expected) < 4 * np.sqrt(expected)


def test_vehicles_leave_where_the_lanes_end() -> None:
    made = flowing("merge-v1", "idm_mobil")
    continued(made, 150)
    state = made.engine.state
    others = state.present & (np.arange(state.x.shape[1]) > 0)
    assert others.sum(axis=1).min() > 5
    # The lanes end at 460 m, and no vehicle drives 3 m in a simulation step.
    assert state.x[others].max() < 460 + 3


def test_a_vehicle_enters_with_the_gap_that_idm_wants() -> None:
    made = flowing("merge-v1", flow={"vehicles_per_hour_and_lane": 3000, "capacity": 100})
    state, entered = made.engine.state, 0
    last = state.entry.max(axis=1)
    for _ in range(150):
        made.advance()
        for row in np.nonzero(state.entry.max(axis=1) > last)[0]:
            own = int(state.entry[row].argmax())
            there = state.present[row] & (abs(state.y[row] - state.y[row, own]) < 1.0)
            there &= state.x[row] > state.x[row, own]
            if there.any():
                ahead = (state.x[row] - state.x[row, own])[there].min()
                assert ahead >= 10.0 + 1.5 * state.speed[row, own] - 1e-9
                entered += 1
        last = state.entry.max(axis=1)
    assert entered > 10


@pytest.mark.parametrize("road", ["exit-v1", "motorway"])
def test_a_saved_state_continues_exactly(road: str, tmp_path: Any) -> None:
    types = [
        {"name": "car", "proportion": 0.7},
        {"name": "truck", "proportion": 0.3, "length_m": 12.0},
    ]
    made = flowing(road, "human", vehicle_types=types)
    continued(made, 20)
    save_state(made.state(), tmp_path / "state")
    other = flowing(road, "human", vehicle_types=types)
    other.restore(load_state(tmp_path / "state"))
    for _ in range(20):
        made.step()
        other.step()
        assert made.state() == other.state()
    assert (made.engine.state.entry.max(axis=1) > made.settings.vehicles).all()


def test_a_full_road_is_an_error() -> None:
    made = flowing("exit-v1", flow={"vehicles_per_hour_and_lane": 2000, "capacity": 3})
    with pytest.raises(InputError, match=r"scene\.inflow\.capacity: an episode is full after"):
        continued(made, 90)


@pytest.mark.parametrize(
    ("road", "why"),
    [
        ("racetrack-v1", "each of its lanes begins where another ends"),
        ("intersection-v1", r"configuration\.spawn_probability"),
    ],
)
def test_nothing_flows_into_a_road_that_has_no_start(road: str, why: str) -> None:
    with pytest.raises(InputError, match=rf"scene\.inflow: nothing flows into '{road}': .*{why}"):
        flowing(road)

"""What is measured steps, and its numbers fit each other."""

import pytest

from charms_bench.testing.bench import bench


def test_environments_of_both_kinds_are_measured_in_the_same_scene() -> None:
    told: list[str] = []
    measured = bench(6, seconds=0.05, rounds=2, progress=told.append, environments=2)
    assert [m.name for m in measured] == ["Ego-v0", "highway-env, sync", "highway-env"]
    assert len(told) == 2 * len(measured)
    for m in measured:
        assert 0 < m.low <= m.steps_per_s <= m.high
        # 5 simulation steps of 6 vehicles in a decision
        steps = m.steps_per_s / m.threads * 5 * 6
        assert m.ns_per_vehicle_step == pytest.approx(1e9 / steps)

"""What is measured steps, and its numbers fit each other."""

import json
from pathlib import Path

import pytest
from command_line import charms_bench

from charms_bench.testing.bench import bench, scale


def test_environments_of_both_kinds_are_measured_in_the_same_scene() -> None:
    told: list[str] = []
    measured = bench(6, seconds=0.05, rounds=2, progress=told.append, environments=2)
    names = [m.name for m in measured if m.name != "EnvPool"]  # which need not be installed
    assert names == ["Ego-v0", "highway-env, sync", "highway-env"]
    assert len(told) == 2 * len(measured)
    for m in measured:
        assert 0 < m.low <= m.steps_per_s <= m.high
        # 5 simulation steps of 6 vehicles in a decision
        steps = m.steps_per_s / m.threads * 5 * 6
        assert m.record()["ns_per_vehicle_step"] == pytest.approx(1e9 / steps)


def test_many_learners_are_measured_beside_highway_envs_on_one_core_and_on_all() -> None:
    command = "charms-bench bench --learners"
    page = Path(__file__).parents[2] / "docs" / "environments.md"
    assert f"\n{command}\n" in page.read_text(encoding="utf-8")
    options = ["--vehicles", 6, "--seconds", 0.1, "--rounds", 2, "--json"]
    done = charms_bench(*command.split()[1:], *options)
    assert done.returncode == 0, done.stderr
    measured = json.loads(done.stdout)
    ours, ours_on_all, theirs, theirs_on_all = measured
    assert [m["name"] for m in (ours, ours_on_all)] == ["LearnersVectorEnv"] * 2
    assert [m["name"] for m in (theirs, theirs_on_all)] == ["highway-env, one core", "highway-env"]
    assert ours["threads"] == theirs["threads"] == 1
    for m in measured:
        assert 0 < m["low"] <= m["decisions_per_s"] <= m["high"]
        rate = theirs_on_all["decisions_per_s"]
        assert m["times_highway_env"] == pytest.approx(m["decisions_per_s"] / rate)


def test_the_scale_covers_all_sizes_of_up_to_two_million_vehicles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("charms_bench.testing.bench.os.cpu_count", lambda: 1)
    monkeypatch.setattr("charms_bench.testing.bench._SCALE_VEHICLES", (6, 40))
    monkeypatch.setattr("charms_bench.testing.bench._SCALE_SCENES", (1, 10))
    monkeypatch.setattr("charms_bench.testing.bench._MOST_VEHICLES", 79)
    measured = scale(seconds=0.01, rounds=1)
    assert [(m.threads, m.vehicles, m.scenes) for m in measured] == [
        (1, 6, 1),
        (1, 6, 10),
        (1, 40, 1),
    ]
    updates = [m.record()["vehicle_updates_per_s"] for m in measured]
    assert updates == [m.steps_per_s * 5 * m.vehicles for m in measured]

"""Which network of a training is kept."""

# ruff: noqa: E402  (nothing below can be imported without the extra 'train')

from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra 'train'")
pytest.importorskip("onnx", reason="needs the extra 'train'")

from charms_agents.training.network import untrained
from charms_agents.training.network_file import export
from charms_agents.training.settings import FIRST_VALIDATION_SEED, Validation
from charms_agents.training.validation import Keeper, Validated

import charms_bench
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.world.actions import ACTIONS
from charms_bench.world.scene import SceneSettings

SCENE = SceneSettings(duration_s=10.0, ego_slots=6, density=1.5)
SUITE = """\
suite: validation
title: The same episodes
episodes: 40
seed: {seed}
scene: {{profile: charms, duration_s: 10.0, ego_slots: 6, density: 1.5}}
egos: [{{agent: {network}, label: network}}]
traffics: [{{traffic: idm_mobil, label: IDM+MOBIL}}]
columns: [speed_mean, crashed_episodes]
"""


def rule(**changes: Any) -> Validation:
    traffic = TrafficSpec(name="idm_mobil")
    given = {"last_steps": 100, "every_steps": 50, "episodes": 40}
    given |= {"ttc_below_3s": 1.0, "crashed_episodes": 1.0}
    return Validation(**{**given, "traffic": traffic, **changes})


def always(action: str) -> torch.nn.Sequential:
    """A network that chooses one action whatever it sees."""
    network = untrained([4], seed=0)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.zero_()
        network[-1].bias[ACTIONS.index(action)] = 1.0
    return network


def shown(keeper: Keeper, *found: Validated, monkeypatch: pytest.MonkeyPatch) -> Keeper:
    """Shows the keeper a network for each of these results."""
    results = iter(found)
    monkeypatch.setattr(keeper, "_validated", lambda *_: next(results))
    for each in found:
        network = untrained([4], seed=each.steps)
        keeper.show(network, each.steps)
    return keeper


def test_a_network_drives_as_in_a_run_of_the_same_episodes(tmp_path: Path) -> None:
    network, file = always("FASTER"), tmp_path / "network.onnx"
    keeper = Keeper(rule(), SCENE, 1000)
    keeper.show(network, 1000)
    observations = np.zeros((1, 7, 5), dtype=np.float32)
    export(network, file, {"decision_hz": "3"}, observations)
    suite = tmp_path / "suite.yaml"
    suite.write_text(SUITE.format(seed=FIRST_VALIDATION_SEED, network=file))
    rows = charms_bench.run(suite, tmp_path / "run", workers=1).table.frame().to_dicts()
    expected = {
        row["metric"]: row["value"]
        for row in rows
        if row["metric_set"].startswith(
            "standard" if row["metric"] == "crashed_episodes" else "paper"
        )
    }
    kept = keeper.kept
    assert kept is not None
    assert 0 < kept.crashed_episodes < 1
    for name in ("speed_mean", "ttc_below_3s", "crashed_episodes"):
        assert getattr(kept, name) == pytest.approx(expected[name], rel=1e-5)


def test_the_fastest_network_within_the_limits_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keeper = shown(
        Keeper(rule(ttc_below_3s=0.08, crashed_episodes=0.02), SCENE, 1000),
        Validated(950, 28.5, 0.07, 0.01),
        Validated(960, 29.2, 0.07, 0.03),
        Validated(970, 28.8, 0.08, 0.02),
        Validated(980, 29.0, 0.09, 0.00),
        Validated(990, 28.7, 0.01, 0.00),
        monkeypatch=monkeypatch,
    )
    assert keeper.kept == Validated(970, 28.8, 0.08, 0.02)
    network = keeper.network
    assert network is not None
    for found, expected in zip(
        network.parameters(), untrained([4], seed=970).parameters(), strict=True
    ):
        assert torch.equal(found, expected)


def test_without_a_network_within_the_limits_crashes_count_before_short_ttc(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keeper = shown(
        Keeper(rule(ttc_below_3s=0.08, crashed_episodes=0.02), SCENE, 1000),
        Validated(950, 28.5, 0.07, 0.03),
        Validated(960, 29.2, 0.12, 0.01),
        Validated(970, 28.8, 0.10, 0.02),
        Validated(980, 29.9, 0.11, 0.00),
        monkeypatch=monkeypatch,
    )
    assert keeper.kept == Validated(970, 28.8, 0.10, 0.02)


def test_networks_of_the_last_steps_are_compared() -> None:
    keeper = Keeper(rule(), SCENE, 1000)
    assert [steps for steps in range(0, 1001, 10) if keeper.due(steps)] == [950, 1000]


def test_the_kept_network_is_part_of_a_checkpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    keeper = Keeper(rule(), SCENE, 1000)
    shown(keeper, Validated(950, 28.5, 0.09, 0.01), monkeypatch=monkeypatch)
    other = Keeper(rule(), SCENE, 1000)
    other.load_arrays(keeper.arrays())
    assert other.kept == keeper.kept
    assert keeper.network is not None
    assert other.network is not None
    for one, two in zip(keeper.network.parameters(), other.network.parameters(), strict=True):
        assert torch.equal(one, two)

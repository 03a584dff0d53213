"""Estimations of rare events continue where they were, whatever happens to them."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import polars as pl
import pytest
from command_line import charms_bench

from charms_bench import api
from charms_bench.errors import InputError, RunFolderError
from charms_bench.report.number import Number
from charms_bench.report.rare_table import plain_episodes
from charms_bench.runs import rare

SUITE = """\
suite: crowded
episodes: 2
scene: {duration_s: 2.0, traffic_vehicles: 4, ego_slots: 2, density: 2.2}
egos: [{agent: idm_mobil, label: IDM}]
traffic_models: [{traffic: {mixture: {idm_mobil: 0.5, stackelberg: 0.5}}, label: mixed}]
"""
OPTIONS = {"runs": 5, "samples": 100, "workers": 1}
EVENT = "ttc:below_s=0.7"


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    path = tmp_path / "crowded.yaml"
    path.write_text(SUITE, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> api.Rare:
    """An estimation that was not interrupted."""
    folder = tmp_path_factory.mktemp("rare")
    (folder / "crowded.yaml").write_text(SUITE, encoding="utf-8")
    return api.rare(folder / "crowded.yaml", EVENT, folder / "out", **OPTIONS)


def test_the_table_has_the_probability_its_interval_and_what_it_cost(whole: api.Rare) -> None:
    (row,) = whole.table.records()
    (probability, *_), runs = whole.table.rows[0].numbers, whole.runs
    assert row["agent"] == "IDM"
    assert row["probability"] == pytest.approx(runs["probability"].mean())
    assert probability.low < row["probability"] < probability.high
    assert row["runs"] == 5
    pilot = json.loads(json.loads(min(whole.path.glob("runs/*.json")).read_text())["run"])
    assert row["episodes"] == runs["episodes"].sum() + pilot["evaluations"]
    assert row["levels"] == len(pilot["thresholds"])
    assert row["plain_episodes"] > 0
    assert "0.7 s or less" in whole.table.title
    assert (whole.path / "tables" / "crowded-rare-ttc.md").exists()


def test_as_many_plain_episodes_give_the_same_ratio_of_ends() -> None:
    # The logarithm of a proportion p of n episodes has the standard error of sqrt((1 - p) / (n p)).
    p, n = 0.4, 1500
    margin = 1.959964 * ((1 - p) / (n * p)) ** 0.5
    assert plain_episodes(Number(p, p * math.exp(-margin), p * math.exp(margin))) == n


def test_the_note_compares_the_interval_with_that_of_as_many_plain_episodes(
    whole: api.Rare,
) -> None:
    number = whole.table.rows[0].numbers[0]
    plain = proportion_ci(number.value * number.n, number.n)
    said = f"IDM in mixed, {number.high / number.low:.2g} ({plain[1] / plain[0]:.2g})"
    assert said in whole.table.note
    assert "use more samples per level" in whole.table.note  # 100 are few


def test_a_report_has_its_table_with_the_note(whole: api.Rare, tmp_path: Path) -> None:
    made = charms_bench("report", whole.path, "--output", tmp_path / "report.html")
    assert made.returncode == 0, made.stderr
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    probability = whole.table.rows[0].numbers[0].value
    assert f"crowded: probability of the event {EVENT}" in page
    assert f"{probability:.2e}" in page.replace("\u2212", "-")
    assert "IDM in mixed, " in page


@pytest.mark.parametrize(("samples", "says"), [(995, True), (1000, False)])
def test_few_samples_are_said_before_anything_is_simulated(
    tmp_path: Path, suite: Path, monkeypatch: pytest.MonkeyPatch, samples: int, says: bool
) -> None:
    monkeypatch.setattr(rare, "on_this_machine", lambda *_: interrupt())
    notices: list[str] = []
    with pytest.raises(KeyboardInterrupt):
        api.rare(suite, EVENT, tmp_path / "out", samples=samples, notice=notices.append)
    assert [f"{samples} samples per level are few" in each for each in notices] == [True] * says


def interrupt() -> None:
    raise KeyboardInterrupt


def proportion_ci(events: float, n: int) -> tuple[float, float]:
    """Wilson's interval (Wilson 1927, eq. for p), written out."""
    z, p = 1.959964, events / n
    middle, half = p + z**2 / (2 * n), z * (p * (1 - p) / n + (z / (2 * n)) ** 2) ** 0.5
    return (middle - half) / (1 + z**2 / n), (middle + half) / (1 + z**2 / n)


def test_the_proportion_of_plain_episodes_is_in_the_interval(whole: api.Rare, suite: Path) -> None:
    import numpy as np

    from charms_bench.engine.events import TimeToCollision, lowest_levels
    from charms_bench.engine.simulation import Simulation
    from charms_bench.plugins.registry import make_agent
    from charms_bench.runs.suite import load_suite

    loaded = load_suite(suite)
    agents = {name: make_agent(name) for name in ("idm_mobil", "stackelberg")}
    traffic = loaded.traffics[0].traffic.make()
    simulation = Simulation(loaded.scene, 2000, "idm_mobil", traffic, agents)
    simulation.reset(np.arange(2000, dtype=np.uint64))
    proportion = (lowest_levels(simulation, TimeToCollision(0.7)) <= 0).mean()
    number = whole.table.rows[0].numbers[0]
    assert number.low < proportion < number.high


def test_missing_and_damaged_runs_are_made_again_and_equal_the_first(
    whole: api.Rare, suite: Path
) -> None:
    before = whole.runs
    files = sorted((whole.path / "runs").glob("*.json"))
    kept = files[0].stat().st_mtime_ns
    files[1].unlink()
    files[2].write_bytes(files[2].read_bytes()[:50])
    files[3].write_text(files[3].read_text().replace("0.1", "0.2"))
    again = api.rare(suite, EVENT, whole.path, **OPTIONS)
    assert again.runs.equals(before)
    assert files[0].stat().st_mtime_ns == kept


def test_more_runs_are_added_to_those_in_the_folder(whole: api.Rare, suite: Path) -> None:
    before = whole.runs
    more = api.rare(suite, EVENT, whole.path, **{**OPTIONS, "runs": 6})
    assert more.runs.head(5).equals(before)
    assert len(more.runs) == 6


@pytest.mark.parametrize(
    ("event", "options", "field"),
    [("crash", {}, "event"), (EVENT, {"samples": 200}, "samples"), (EVENT, {"seed": 3}, "seed")],
)
def test_a_folder_with_another_estimation_is_rejected(
    whole: api.Rare, suite: Path, event: str, options: dict[str, int], field: str
) -> None:
    with pytest.raises(RunFolderError, match=field):
        api.rare(suite, event, whole.path, **{**OPTIONS, **options})


def test_a_killed_estimation_continues(whole: api.Rare, suite: Path, tmp_path: Path) -> None:
    output = tmp_path / "out"
    arguments = [suite, "--event", EVENT, "--runs", 5, "--samples", 100, "--workers", 1]
    command = [sys.executable, "-m", "charms_bench", "rare", *arguments, "--output", output]
    process = subprocess.Popen([*map(str, command)], start_new_session=True)
    while not list(output.glob("runs/*.json")):
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    continued = api.rare(suite, EVENT, output, **OPTIONS)
    probability = pl.col("probability")
    assert continued.runs.select(probability).equals(whole.runs.head(5).select(probability))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--event", "crsh"], "Did you mean 'crash'"),
        (["--event", "ttc:below_s=0"], "below_s is 0"),
        (["--event", "ttc:above_s=1"], "above_s"),
        (["--event", "ttc:1"], "NAME:OPTION=VALUE"),
        (["--runs", "4"], "expected 5 to"),
        (["--samples", "101"], "multiple of 5"),
        (["--samples", "10"], "from 100"),
        (["--seed", "9" * 30], "seed"),
    ],
)
def test_a_wrong_option_is_a_message(suite: Path, options: list[str], said: str) -> None:
    called = charms_bench("rare", suite, "--output", suite.parent / "out", *options, columns=1000)
    assert called.returncode == 2
    assert said in called.stderr
    assert not (suite.parent / "out").exists()


def test_the_command_prints_the_table_and_json(whole: api.Rare, suite: Path) -> None:
    arguments = ("rare", suite, "--event", EVENT, "--runs", 5, "--samples", 100)
    printed = charms_bench(*arguments, "--output", whole.path)
    assert printed.returncode == 0
    assert "probability" in printed.stdout
    (first, *_) = json.loads(charms_bench(*arguments, "--output", whole.path, "--json").stdout)
    assert first["name"] == "probability"
    assert first["value"] == whole.table.rows[0].numbers[0].value


def test_a_training_suite_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "train.yaml").write_text("pipeline: charms\n", encoding="utf-8")
    with pytest.raises(InputError, match="training suite"):
        api.rare(tmp_path / "train.yaml")


def test_a_scenario_is_rejected_because_nothing_of_it_is_drawn(tmp_path: Path) -> None:
    suite = Path(__file__).parents[2] / "suites" / "r157.yaml"
    with pytest.raises(
        InputError, match=r"r157.yaml:\d+: traffic_models\[0\].traffic.scenario: rare"
    ):
        api.rare(suite, output=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_an_agent_is_estimated_beside_the_egos_and_shown(
    suite: Path, network_file: Callable[..., Path]
) -> None:
    network_file(name="mine.onnx")
    words = ("--agent", "mine.onnx", "--runs", 5, "--samples", 100, "--workers", 1)
    made = charms_bench("rare", suite.name, *words, cwd=suite.parent)
    assert made.returncode == 0, made
    folder = str(next((suite.parent / "runs").iterdir()).relative_to(suite.parent))
    shown = charms_bench("show", folder, cwd=suite.parent)
    assert "mine" in shown.stdout
    tables = json.loads(charms_bench("show", folder, "--json", cwd=suite.parent).stdout)
    assert any(row["agent"] == "mine" for table in tables.values() for row in table)

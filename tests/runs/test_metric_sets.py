"""Metric sets by name, and runs that are measured again with them."""

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from command_line import Called, charms_bench

from charms_bench.errors import InputError
from charms_bench.metrics import METRIC_SETS, PAPER, STANDARD, Metric, MetricSet, standard_after
from charms_bench.metrics.metric import Interval, problem_of_sums
from charms_bench.runs.metric_sets import metric_sets
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite

SUITE = {
    "suite": "small",
    "episodes": 12,
    "scene": {"duration_s": 5.0, "traffic_vehicles": 8},
    "egos": [{"agent": "outside_policy"}],
    "traffic_models": [{"traffic": "idm_mobil"}],
}


def test_without_names_there_are_the_usual_sets() -> None:
    assert metric_sets([]) == METRIC_SETS == (PAPER, STANDARD)


def test_other_thresholds_show_in_the_label_and_in_names() -> None:
    (found,) = metric_sets(["standard:ttc_s=2,drac_mps2=3.4"])
    assert found.label == "standard-5(ttc_s=2,drac_mps2=3.4)"
    names = [metric.name for metric in found.metrics]
    assert {"ttc_below_2s", "drac_above_3_4"} < set(names)
    assert not {"ttc_below_3s", "drac_above_3_35"} & set(names)
    assert len(names) == len(STANDARD.metrics)


def test_another_warm_up_shows_in_the_label_and_in_what_is_counted() -> None:
    (found,) = metric_sets(["standard:warm_up_s=0"])
    assert found.label == "standard-5(warm_up_s=0)"
    counted = {metric.name: metric.rests_on for metric in found.metrics}
    assert counted["speed_mean"] == "steps"
    usual = {metric.name: metric.rests_on for metric in STANDARD.metrics}
    assert usual["speed_mean"] == "steps after 3 s"


def test_a_definition_names_what_is_left_out_at_the_start() -> None:
    left_out = {f"{metric.name}: {metric.description}" for metric in STANDARD.metrics}
    assert "speed_mean: speed of the ego; without the first 3 s of an episode" in left_out
    for metric in standard_after(1.7).metrics:
        is_later = "1.7" in "".join(map(str, metric.sums))  # polars writes out an expression
        assert is_later == metric.description.endswith("; without the first 1.7 s of an episode")


def test_other_thresholds_keep_the_warm_up_of_the_suite() -> None:
    usual = PAPER, standard_after(0.0)
    (found,) = metric_sets(["standard:ttc_s=2"], usual)
    assert found.label == "standard-5(warm_up_s=0,ttc_s=2)"
    (other,) = metric_sets(["standard:warm_up_s=1"], usual)
    assert other.label == "standard-5(warm_up_s=1)"


def test_a_plugins_set_has_its_own_version() -> None:
    usual, strict = metric_sets(["outside_metrics", "outside_metrics:jerk_mps3=1"])
    assert (usual.label, strict.label) == ("comfort-3", "comfort-3(jerk_mps3=1)")


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["standrad"], "no metric set named 'standrad'.*Did you mean 'standard'"),
        (["standard:ttc_s"], "'standard:ttc_s': expected NAME:OPTION=VALUE, found 'ttc_s'"),
        (["standard:ttc_s=1,ttc_s=2"], "ttc_s is given twice"),
        (["standard:ttc_s=[1"], "ttc_s: cannot be read: expected ',' or"),
        (["standard:ttc=2"], "'standard' of charms-bench .* no option 'ttc'. Did you mean 'ttc_s'"),
        (["paper:ttc_s=2"], "metric set 'paper' takes no options; given: ttc_s"),
        (["paper", "paper"], "metric set 'paper-2': given twice"),
        (["outside_no_metrics"], "is a NoAgent, not a MetricSet"),
        (["outside_broken_metrics"], "'broken': fuel: ColumnNotFoundError: .*\"fuel\""),
    ],
)
def test_what_is_no_metric_set_is_said_in_a_sentence(texts: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        metric_sets(texts)


@pytest.mark.parametrize(
    ("interval", "sums", "message"),
    [
        ("proportion", [[2.0, 1.0], [2.0, 3.0]], "an episode has 3 events of 2"),
        ("wilson", [[1.0, 2.0]], "an episode has 2 events of 1"),
        ("rate", [[2.0, -1.0]], "finite and not negative"),
        ("garwood", [[2.0, float("nan")]], "finite and not negative"),
        ("proportion", [[2.0, 2.0], [0.0, 0.0]], ""),
        ("rate", [[2.0, 3.0]], ""),
    ],
)
def test_sums_that_are_not_of_the_kind_of_the_interval_are_named(
    interval: Interval, sums: list[list[float]], message: str
) -> None:
    metric = Metric("haste", "", "", "steps", (pl.len(), pl.len()), interval=interval)
    problem = problem_of_sums(metric, np.array(sums))
    assert message in problem
    assert bool(problem) == bool(message)


def test_an_unknown_kind_of_interval_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    metric = Metric("haste", "", "", "", (pl.len(), pl.len()), interval="wilsn")  # type: ignore[arg-type]
    made = MetricSet("mine", 1, (metric,))
    monkeypatch.setattr("charms_bench.runs.metric_sets.load", lambda group, name: made)
    with pytest.raises(InputError, match=r"'mine': haste: no interval named 'wilsn'.*'wilson'"):
        metric_sets(["mine"])


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "small"
    run(Suite.model_validate(SUITE), folder, workers=1)
    return folder


def rescore(folder: Path, *arguments: str) -> Called:
    return charms_bench("rescore", folder, *arguments)


def test_a_run_is_measured_again_from_its_rows_alone(finished: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(finished, tmp_path / "copy"))
    result = rescore(folder)
    assert result.returncode == 0, result.stderr
    table = pl.read_csv(folder / "tables" / "small.csv")
    assert table["metric_set"].unique(maintain_order=True).to_list() == ["paper-2", "standard-5"]
    rows = sorted(path.name for path in folder.rglob("*.parquet"))
    assert rows == sorted(path.name for path in finished.rglob("*.parquet"))


def test_a_plugins_metric_is_computed_from_rows_it_has_never_seen(
    finished: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(finished, tmp_path / "copy"))
    result = rescore(folder, "--set", "outside_metrics:jerk_mps3=0.5", "--json")
    (row,) = json.loads(result.stdout)
    assert (row["metric_set"], row["metric"]) == ("comfort-3(jerk_mps3=0.5)", "jerky")
    steps = pl.concat(map(pl.read_parquet, sorted((folder / "steps").glob("*.parquet"))))
    endings = pl.concat(map(pl.read_parquet, sorted((folder / "episodes").glob("*.parquet"))))
    assert endings["ending"].unique().to_list() == ["time"]  # so all steps count
    jerk = steps["acceleration"].cast(pl.Float64).diff().abs() * 3
    jerk = jerk.filter(steps["step"] > 1)
    assert row["n"] == len(jerk)
    assert row["value"] == pytest.approx((jerk > 0.5).mean(), rel=1e-5)
    text = (folder / "tables" / "small.md").read_text()
    assert "## comfort-3(jerk_mps3=0.5)" in text
    assert "- `jerky`: proportion of decisions with a jerk beyond 0.5 m/s³." in text


def test_a_longer_threshold_exposes_more(finished: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(finished, tmp_path / "copy"))
    sets = ("--set", "standard:ttc_s=1", "--set", "standard:ttc_s=60")
    rows = json.loads(rescore(folder, *sets, "--json").stdout)
    exposed = [row["value"] for row in rows if row["metric"] == "tet"]
    assert exposed[0] < exposed[1]


def test_a_mistake_is_a_message_and_leaves_the_tables(finished: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(finished, tmp_path / "copy"))
    result = rescore(folder, "--set", "standard:ttc=2")
    assert result.returncode == 2
    assert "error: metric set 'standard' of charms-bench" in result.stderr
    assert "has no option 'ttc'" in result.stderr
    assert not (folder / "tables").exists()

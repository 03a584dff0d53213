"""Pairs of cells to compare: which cells belong together, and which runs are rejected."""

import json
from collections.abc import Callable
from dataclasses import replace

import pytest
from command_line import charms_bench

from charms_bench.errors import InputError
from charms_bench.metrics import METRIC_SETS
from charms_bench.metrics.labels import label_of, set_label_of
from charms_bench.runs.finished_run import FinishedRun, open_finished
from charms_bench.runs.pairing import pairs_of
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite

SMALL = {
    "suite": "small",
    "episodes": 12,
    "scene": {"duration_s": 3.0, "traffic_vehicles": 5},
    "egos": [{"agent": "idm_mobil"}],
    "traffic_models": [{"traffic": "idm_mobil"}],
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., FinishedRun]:
    """Runs the small suite with changes, once each."""
    folder, runs = tmp_path_factory.mktemp("runs"), {}

    def make(name: str, **changes: object) -> FinishedRun:
        if name not in runs:
            suite = Suite.model_validate({**SMALL, **changes})
            run(suite, folder / name, workers=1)
            runs[name] = open_finished(folder / name)
        return runs[name]

    return make


def named(pairs: list) -> list[tuple[str, str, str]]:
    return [(one.agent, other.agent, one.traffic) for one, other in pairs]


def test_two_runs_of_one_ego_each_need_no_names(made: Callable[..., FinishedRun]) -> None:
    one, other = made("idm"), made("game", egos=[{"agent": "stackelberg"}])
    assert named(pairs_of(one, other, None)) == [("idm_mobil", "stackelberg", "idm_mobil")]


def test_egos_of_the_same_names_are_told_apart_by_their_runs(
    made: Callable[..., FinishedRun],
) -> None:
    both = [{"agent": "idm_mobil"}, {"agent": "stackelberg"}]
    calm = [{"agent": "idm_mobil"}, {"agent": {"name": "stackelberg", "options": {"gain": 0.2}}}]
    one, other = made("both", egos=both), made("calm", egos=calm)
    assert named(pairs_of(one, other, None)) == [
        (f"{ego} ({one.folder.path})", f"{ego} ({other.folder.path})", "idm_mobil")
        for ego in ("idm_mobil", "stackelberg")
    ]


def test_two_agents_of_a_run_are_compared_in_each_of_its_traffics(
    made: Callable[..., FinishedRun],
) -> None:
    crossed = made(
        "crossed",
        egos=[{"agent": "idm_mobil"}, {"agent": "stackelberg"}],
        traffic_models=[{"traffic": "idm_mobil"}, {"traffic": "stackelberg", "label": "games"}],
    )
    assert named(pairs_of(crossed, None, ("stackelberg", "idm_mobil"))) == [
        ("stackelberg", "idm_mobil", traffic) for traffic in ("idm_mobil", "games")
    ]


@pytest.mark.parametrize(
    ("name", "changes", "difference"),
    [
        ("seed", {"seed": 7}, "seed is 0 in the first and 7 in the second"),
        ("episodes", {"episodes": 11}, "episodes is 12 in the first and 11 in the second"),
        (
            "denser",
            {"scene": {"duration_s": 3.0, "traffic_vehicles": 5, "density": 1.5}},
            r"scene\.density is 1\.0 in the first and 1\.5 in the second",
        ),
        (
            "stock",
            {"scene": {"duration_s": 3.0, "traffic_vehicles": 5, "profile": "highway-env"}},
            r"scene\.profile\.\S+ is .* in the first and .* in the second",
        ),
        (
            "games",
            {"traffic_models": [{"traffic": "stackelberg"}]},
            r"traffic_models\[0\]\.name is idm_mobil in the first and stackelberg in the second",
        ),
    ],
)
def test_runs_of_other_episodes_are_rejected_and_the_field_named(
    made: Callable[..., FinishedRun], name: str, changes: dict[str, object], difference: str
) -> None:
    with pytest.raises(
        InputError, match=f"do not have the same episodes: {difference}; run one of"
    ):
        pairs_of(made("idm"), made(name, **changes), None)


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        (lambda manifest: manifest.update(charms_bench="9.9"), "charms_bench is 0.1.0 in the"),
        (
            lambda manifest: manifest["agents"]["idm_mobil"].update(version="9.9"),
            "agents.idm_mobil.version is 0.1.0 in the first and 9.9 in the second",
        ),
    ],
    ids=["harness", "traffic"],
)
def test_other_versions_of_the_harness_or_the_traffic_are_rejected(
    made: Callable[..., FinishedRun],
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[dict], None],
    difference: str,
) -> None:
    one = made("idm")
    other = replace(one, folder=type(one.folder)(one.folder.path))
    manifest = one.folder.manifest()
    change(manifest)
    monkeypatch.setattr(other.folder, "manifest", lambda: manifest)
    with pytest.raises(InputError) as rejected:
        pairs_of(one, other, None)
    assert difference in str(rejected.value)


def test_the_command_prints_a_table_of_every_metric(made: Callable[..., FinishedRun]) -> None:
    one, other = made("idm"), made("game", egos=[{"agent": "stackelberg"}])
    command = ("compare", one.folder.path.name, other.folder.path.name)
    result = charms_bench(*command, cwd=one.folder.path.parent, columns=200)
    assert result.returncode == 0, result.stderr
    for metric_set in METRIC_SETS:
        assert (
            f"idm_mobil minus stackelberg, in idm_mobil: {set_label_of(metric_set.label)}"
            in result.stdout
        )
        assert all(label_of(metric.name) in result.stdout for metric in metric_set.metrics)
    narrow = charms_bench(*command, cwd=one.folder.path.parent)
    assert max(map(len, narrow.stdout.splitlines())) <= 100


def test_json_has_a_row_for_every_metric_that_was_asked_for(
    made: Callable[..., FinishedRun],
) -> None:
    one, other = made("idm"), made("game", egos=[{"agent": "stackelberg"}])
    only = ("--metric", "crashed_episodes", "--metric", "jerk_rms")
    paths = (one.folder.path.name, other.folder.path.name)
    result = charms_bench("compare", *paths, *only, "--json", cwd=one.folder.path.parent)
    rows = json.loads(result.stdout)
    assert [row["metric"] for row in rows] == ["crashed_episodes", "jerk_rms"]
    # 12 episodes without a crash on either side: z² / (n + z²).
    most = pytest.approx(3.8415 / (12 + 3.8415), abs=1e-4)
    assert (-rows[0]["low"], rows[0]["high"]) == (most, most)
    assert rows[0]["corrected_p"] == 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("idm",), "idm: needs something to compare with; give a second run, or two egos of"),
        (("idm", "nowhere"), "nowhere: no such folder"),
        (("idm", "both"), "choose one ego of each with --egos"),
        (
            ("idm", "--egos", "idm_mobil", "idm"),
            "no ego named 'idm'. Did you mean 'idm_mobil'? Known: idm_mobil",
        ),
        (
            ("idm", "idm", "--metric", "speed"),
            "no metric named 'speed'. Did you mean 'speed_mean'? Nearest: speed_mean",
        ),
    ],
)
def test_what_cannot_be_compared_is_said_in_a_sentence(
    made: Callable[..., FinishedRun], arguments: tuple[str, ...], message: str
) -> None:
    folder = made("idm").folder.path.parent
    made("both", egos=[{"agent": "idm_mobil"}, {"agent": "stackelberg"}])
    result = charms_bench("compare", *arguments, cwd=folder)
    assert result.returncode == 2
    assert message in result.stderr
    assert "Traceback" not in result.stderr

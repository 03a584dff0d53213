"""Datasets: whole or not at all, and what is rejected."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from command_line import charms_bench as called

import charms_bench
from charms_bench.episodes import dataset, minari_dataset
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.errors import InputError
from charms_bench.plugins.registry import make_agent
from charms_bench.runs.suite import Suite
from charms_bench.world.interaction_observation import Interaction

SUITE = """\
suite: small
episodes: 4
seed: 900000000
scene: {duration_s: 3.0, traffic_vehicles: 5}
egos:
  - {agent: idm_mobil, label: IDM+MOBIL}
  - {agent: outside_policy, label: Keep right}
traffic_models: [{traffic: idm_mobil}]
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> charms_bench.Run:
    folder = tmp_path_factory.mktemp("small")
    (folder / "suite.yaml").write_text(SUITE)
    return charms_bench.run(folder / "suite.yaml", folder / "run", workers=1)


def test_recordings_of_the_first_episodes_are_written(
    run: charms_bench.Run, tmp_path: Path
) -> None:
    made = called("dataset", run.path, "--format", "highd", "--ego", "Keep right", "--episodes", 2)
    assert made.returncode == 0, made.stderr
    folder = run.path / "datasets" / "keep-right-in-idm_mobil-highd"
    assert str(folder) in made.stdout.replace("\n", "")
    recordings = [path.name for path in sorted(folder.glob("*_tracks.csv"))]
    assert recordings == ["900000000_tracks.csv", "900000001_tracks.csv"]
    assert pl.read_csv(folder / "drivers.csv").height == 2 * 6
    assert called("data", folder).returncode == 0


def test_parquet_files_have_the_states_of_all_vehicles(run: charms_bench.Run) -> None:
    options = ("--format", "parquet", "--ego", "Keep right", "--episodes", 2)
    made = called("dataset", run.path, *options)
    assert made.returncode == 0, made.stderr
    folder = run.path / "datasets" / "keep-right-in-idm_mobil-parquet"
    files = sorted(folder.iterdir())
    assert [path.name for path in files] == ["900000000.parquet", "900000001.parquet"]
    states = pl.read_parquet(files)
    assert states["vehicle"].n_unique() == 6
    at_decisions = (
        states.filter("ego")
        .group_by("episode", maintain_order=True)
        .agg(
            pl.col("x", "lane").gather_every(5, offset=5)  # 15 steps and 3 decisions per second
        )
    )
    (cell,) = (cell for cell in run.cells if cell.agent == "Keep right")
    steps = cell.steps.filter(pl.col("episode") < 900000002)
    rows = steps.group_by("episode", maintain_order=True).agg("x", "lane")
    np.testing.assert_array_equal(at_decisions["x"].explode().cast(pl.Float32), rows["x"].explode())
    assert at_decisions.select("episode", "lane").equals(rows.select("episode", "lane"))


def test_an_existing_folder_is_never_touched(run: charms_bench.Run, tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    options = ("--format", "highd", "--ego", "Keep right", "--output", tmp_path / "kept")
    rejected = called("dataset", run.path, *options)
    assert rejected.returncode == 2
    assert "already exists; delete it, or choose another with --output" in rejected.stderr
    assert not list((tmp_path / "kept").iterdir())


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_an_interrupted_dataset_leaves_nothing(
    run: charms_bench.Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def stop(*_: object) -> None:
        raise error

    monkeypatch.setattr(dataset, "drivers", stop)  # after the first recording has been written
    with pytest.raises((KeyboardInterrupt, InputError)):
        run.dataset("highd", tmp_path / "highd", ego="Keep right")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"ego": "IDM+MOBIL"}, "IDM.MOBIL is a driver model, without observations"),
        ({"ego": "Keep right", "episodes": 5}, "5 episodes; expected 1 to 4"),
        ({"ego": "Keep right", "output": "data"}, "data: .* a version at the end, as in charms-"),
    ],
)
def test_what_minari_cannot_hold_is_rejected(
    run: charms_bench.Run, options: dict[str, object], message: str
) -> None:
    pytest.importorskip("minari", reason="needs the extra 'dataset'")
    with pytest.raises(InputError, match=message):
        run.dataset("minari", **options)


def test_an_ego_that_decides_at_another_rate_is_rejected(
    run: charms_bench.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(make_agent("outside_policy")), "decision_hz", 5.0)
    with pytest.raises(InputError, match=r"equal rates, as .* the suite with scene.decision_hz: 5"):
        minari_dataset.check_policy(RecordedCell(run._finished, 1, Path()))


def test_an_ego_that_sees_others_late_is_rejected(
    run: charms_bench.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = Interaction(delay_decisions=1)
    monkeypatch.setattr(type(make_agent("outside_policy")), "observation", late)
    with pytest.raises(InputError, match="sees others with a delay"):
        minari_dataset.check_policy(RecordedCell(run._finished, 1, Path()))


def test_an_unknown_format_is_rejected(run: charms_bench.Run) -> None:
    with pytest.raises(
        InputError, match=r"no format 'minary'\. Did you mean 'minari'.*Known: minari, highd"
    ):
        run.dataset("minary", ego="Keep right")  # type: ignore[arg-type]


def test_without_minari_the_message_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "minari", None)
    with pytest.raises(InputError, match=r"pip install 'charms-bench\[dataset\]'"):
        minari_dataset.check_name(tmp_path / "charms-v0")


def test_the_files_of_two_cells_never_have_the_same_name(run: charms_bench.Run) -> None:
    egos = [{"agent": "idm_mobil", "label": label} for label in ("A/B", "A B", "a-b", "x in y")]
    traffics = [{"traffic": "idm_mobil", "label": label} for label in ("z", "y-in-z")]
    fields = run.suite.model_dump() | {"egos": [*egos, {"agent": "idm_mobil", "label": "x"}]}
    suite = Suite.model_validate(fields | {"traffics": traffics})
    names = [dataset.name_of(suite, cell) for cell in suite.cells]
    assert len(set(names)) == len(names) == 10
    assert names[::2][:3] == ["a-b-in-z", "a-b-2-in-z", "a-b-3-in-z"]

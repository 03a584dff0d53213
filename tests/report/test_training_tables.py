"""The tables of a training, as any pipeline leaves them in its run folder."""

import json
from pathlib import Path

import pytest
from handmade_cells import lines

from charms_bench.errors import RunFolderError
from charms_bench.report.terminal import grid
from charms_bench.report.training_tables import drawn_curves, stored_training

STAGES = """\
stage,style,steps,wall_s,steps_per_s,return,crashed,agreement_before,agreement
first,"safe, egoistic",1000,90.0,1200.0,39.5,0.25,,
imitation,imitation,,6.0,,,,0.253,0.448
"""
CURVES = """\
stage,steps,return_mean,crashed_share,epoch,agreement
first,500,10.0,1.0,,
first,1000,40.0,0.25,,
imitation,,,,0,0.253
imitation,,,,1,0.448
"""


COLUMNS = {
    "stages": {"agreement": {"form": ".1%"}, "wall_s": {"unit": "s", "definition": "duration"}},
    "curves": {
        "return_mean": {"over": "steps", "title": "return of an episode"},
        "crashed_share": {"over": "steps", "title": "proportion crashed", "form": ".0%"},
        "agreement": {"over": "epoch", "title": "agreement"},
    },
}


def test_a_training_shows_its_stages_and_curves(tmp_path: Path) -> None:
    (tmp_path / "stages.csv").write_text(STAGES)
    (tmp_path / "curves.csv").write_text(CURVES)
    (tmp_path / "columns.json").write_text(json.dumps(COLUMNS))
    training = stored_training(tmp_path)
    assert training.stages is not None
    assert "44.8 %" in "".join(lines(grid(training.stages)))
    shown = [line.split() for line in lines(drawn_curves(training))]
    assert ["first", "10", "▃█", "40"] in shown
    assert ["first", "1", "█▃", "0.25"] in shown
    assert ["imitation", "0.253", "▁█", "0.448"] in shown


def test_columns_that_nobody_describes_are_shown_by_their_names(tmp_path: Path) -> None:
    (tmp_path / "stages.csv").write_text(STAGES)
    (tmp_path / "curves.csv").write_text(CURVES)
    training = stored_training(tmp_path)
    assert training.stages is not None
    assert training.stages.columns[2].name == "wall_s"
    assert training.stages.columns[2].definition == "As the pipeline calls it"
    titles = [curve.title for _, curve, _ in training.drawn()]
    assert titles == ["steps", "return_mean", "crashed_share", "epoch", "agreement"]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('{"stages": {"a": {"form": "999999999d"}}}', "stages.a.form: String should match"),
        ('{"curves": {"a": {"over": "b", "title": "\\u001b"}}}', "characters that can be printed"),
        ("[", "Invalid JSON"),
    ],
)
def test_damaged_descriptions_are_rejected(tmp_path: Path, text: str, problem: str) -> None:
    (tmp_path / "columns.json").write_text(text)
    with pytest.raises(RunFolderError, match=problem) as rejected:
        stored_training(tmp_path)
    assert str(rejected.value).startswith(str(tmp_path / "columns.json"))


def test_a_stage_that_would_move_the_cursor_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "stages.csv").write_text(STAGES.replace("imitation", "\x1b[2J"))
    with pytest.raises(RunFolderError, match="has control characters"):
        stored_training(tmp_path)


def test_a_table_that_never_ends_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "stages.csv").symlink_to("/dev/zero")
    with pytest.raises(RunFolderError, match="is a pipe or a device, not a file"):
        stored_training(tmp_path)


def test_a_table_of_no_stages_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "stages.csv").write_text("name\nfirst\n")
    with pytest.raises(RunFolderError, match="expected a column 'stage', found name"):
        stored_training(tmp_path)

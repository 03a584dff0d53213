"""What the command line says of recordings."""

import json
from dataclasses import replace
from pathlib import Path

import click.testing
import pytest
from charms_agents.human.samples import CharmsSampler
from trios import Row, busy_road, write_trio
from typer.testing import CliRunner

from charms_bench.cli import app
from charms_bench.errors import DataError, InputError
from charms_bench.humans.survey import Learnable, Survey, survey
from charms_bench.report.figures.drawing import save
from charms_bench.report.figures.recordings import draw

US_101 = Path(__file__).parents[2] / "../shared/data/us101_highd_format"


def found(folder: Path) -> tuple[Survey, Learnable]:
    surveyed, learnable = survey(folder, {"charms": CharmsSampler()})
    return surveyed, learnable["charms"]


def data(*arguments: object) -> click.testing.Result:
    return CliRunner().invoke(app, ["data", *map(str, arguments)])


def test_the_survey_counts_what_was_written(tmp_path: Path) -> None:
    for number in (1, 2):
        write_trio(tmp_path, busy_road(), number)
    surveyed, learnable = found(tmp_path)
    facts = surveyed.facts()
    assert (facts["recordings"], facts["cars"], facts["trucks"]) == (2, 60, 6)
    assert (facts["rows"], facts["decisions"]) == (2 * 33 * 26, 2 * 33 * 4)
    assert facts["frame_rates_hz"] == [25.0]
    assert facts["recorded_h"] == pytest.approx(2 * 26 / 25 / 3600)
    assert facts["carriageways"] == {"3": 2}
    assert facts["speed_quantiles_mps"]["0.5"] == 30.0
    assert facts["following_distance_m"]["0.95"] == pytest.approx(30.0)
    assert facts["offset_mean_m"] == pytest.approx(0.3)
    assert learnable.accepted + sum(learnable.rejected.values()) == facts["decisions"]
    for proportions in learnable.label_shares.values():
        assert sum(proportions.values()) == pytest.approx(1.0)
    assert learnable.training + learnable.held_out <= learnable.accepted


def test_the_command_prints_what_it_found_and_draws_it(tmp_path: Path) -> None:
    folder, figure = write_trio(tmp_path, busy_road()), tmp_path / "figures" / "data.png"
    result = data(folder, "--figure", figure)
    assert result.exit_code == 0, result.output
    assert "30 cars, 3 trucks, 858 rows" in result.output
    assert "LANE_RIGHT" in result.output
    assert "truck " in result.output
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_the_command_prints_nothing_but_json(tmp_path: Path) -> None:
    result = data(write_trio(tmp_path, busy_road()), "--json")
    assert json.loads(result.stdout)["samplers"]["charms"]["rejected"]["truck"] == 3 * 4


@pytest.mark.parametrize(("shift_m", "warns"), [(0.0, True), (-0.3, False)])
def test_drivers_beside_the_centres_of_their_lanes_are_a_warning(
    shift_m: float, warns: bool, tmp_path: Path
) -> None:
    rows = [replace(row, y=row.y + shift_m) for row in busy_road()]  # 0.3 m to the right
    result = data(write_trio(tmp_path, rows))
    assert result.exit_code == 0
    assert ("0.30 m to the right" in result.stderr) == warns


def test_recordings_are_surveyed_without_any_sampler(tmp_path: Path) -> None:
    surveyed, learnable = survey(write_trio(tmp_path, busy_road()), {})
    assert surveyed.facts()["cars"] == 30
    save(draw(surveyed, learnable), tmp_path / "data.png")


def test_a_mistake_in_a_recording_reaches_the_command(tmp_path: Path) -> None:
    result = data(write_trio(tmp_path, [Row()], rate=0))
    assert isinstance(result.exception, DataError)
    assert "column 'frameRate': expected a number from 0.1 to 1000 Hz, found '0'" in str(
        result.exception
    )


def test_a_figure_of_an_unknown_format_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"data\.txt: expected a name that ends in \.pdf, \.png"):
        save(draw(*survey(write_trio(tmp_path, busy_road(frames=1)), {})), tmp_path / "data.txt")


@pytest.mark.skipif(not US_101.exists(), reason=f"no recordings in {US_101}")
def test_us_101_has_every_action() -> None:
    surveyed, learnable = found(US_101)
    assert surveyed.facts()["carriageways"] == {"1": 1, "5": 11, "6": 20}
    assert learnable.rejected["carriageway of fewer than three lanes"] > 0
    assert min(learnable.label_shares["sampled"].values()) > 0.02

"""What the command line says of recordings."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from trios import Row, busy_road, write_trio

from charms_bench.errors import InputError
from charms_bench.people.samples import SampleSettings, collect
from charms_bench.people.survey import survey
from charms_bench.report.recordings import draw

US_101 = Path(__file__).parents[2] / "../shared/data/us101_highd_format"


def charms_bench(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "charms_bench", "data", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_survey_counts_what_was_written(tmp_path: Path) -> None:
    for number in (1, 2):
        write_trio(tmp_path, busy_road(), number)
    found = survey(collect(tmp_path))
    assert (found["recordings"], found["cars"], found["trucks"]) == (2, 60, 6)
    assert (found["rows"], found["decisions"]) == (2 * 33 * 26, 2 * 33 * 4)
    assert found["frame_rates_hz"] == [25.0]
    assert found["recorded_h"] == pytest.approx(2 * 26 / 25 / 3600)
    assert found["carriageways"] == {"3": 2}
    assert found["speed_quantiles_mps"]["0.5"] == 30.0
    assert found["following_distance_m"]["0.95"] == pytest.approx(30.0)
    assert found["offset_mean_m"] == pytest.approx(0.3)
    assert found["accepted"] + sum(found["rejected"].values()) == found["decisions"]
    for shares in found["label_shares"].values():
        assert sum(shares.values()) == pytest.approx(1.0)
    assert sum(found["sampled"].values()) <= found["accepted"]
    json.dumps(found)


def test_the_command_prints_what_it_found_and_draws_it(tmp_path: Path) -> None:
    folder, figure = write_trio(tmp_path, busy_road()), tmp_path / "figures" / "data.png"
    result = charms_bench(folder, "--figure", figure)
    assert result.returncode == 0, result.stderr
    assert "30 cars, 3 trucks, 858 rows" in result.stdout
    assert "LANE_RIGHT" in result.stdout
    assert "truck " in result.stdout
    assert figure.read_bytes().startswith(b"\x89PNG")


def test_the_command_prints_nothing_but_json(tmp_path: Path) -> None:
    result = charms_bench(write_trio(tmp_path, busy_road()), "--json")
    assert json.loads(result.stdout)["rejected"]["truck"] == 3 * 4


def test_a_mistake_is_one_message_and_exit_code_2(tmp_path: Path) -> None:
    result = charms_bench(write_trio(tmp_path, [Row()], rate=0))
    assert (result.returncode, result.stdout) == (2, "")
    assert "column 'frameRate': 0 Hz; expected more than 0" in result.stderr.replace("\n", " ")
    assert "Traceback" not in result.stderr


def test_a_figure_of_an_unknown_format_is_refused(tmp_path: Path) -> None:
    collected = collect(write_trio(tmp_path, busy_road(frames=1)))
    with pytest.raises(InputError, match=r"data\.txt: expected a name that ends in \.pdf, \.png"):
        draw(collected, tmp_path / "data.txt")


@pytest.mark.skipif(not US_101.exists(), reason=f"no recordings in {US_101}")
def test_us_101_has_every_action() -> None:
    found = survey(collect(US_101, SampleSettings()))
    assert found["carriageways"] == {"1": 1, "5": 11, "6": 20}
    assert found["rejected"]["carriageway of fewer than three lanes"] > 0
    assert min(found["label_shares"]["sampled"].values()) > 0.02

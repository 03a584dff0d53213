"""`charms-bench likeness`: from recordings and a suite to scores, for any agent."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import charms_bench
from trios import Row, write_trio

from charms_bench.runs.likeness import of_half

ROOT = Path(__file__).parents[2]
NETWORK = ROOT / "agents" / "charms_agents" / "policies" / "prior_level_k.onnx"
SUITE = """\
suite: small
episodes: 2
scene:
  profile: {{name: charms, speed_min_mps: 0.0, target_speed_min_mps: 0.0,
            target_speed_steps_mps: [0.25, 0.5, 1.0, 2.0]}}
  traffic_vehicles: 5
  duration_s: 2.0
egos:
  - {{agent: human, label: Human}}
  - {{agent: {network}, label: My network}}
traffic_models:
  - {{traffic: idm_mobil, label: IDM}}
"""


def platoons() -> list[Row]:
    """Ten vehicles on each of three lanes for 31 s, whose speeds vary and who follow each other."""
    rows = []
    for number in range(30):
        place, lane = divmod(number, 3)
        time_s = np.arange(311) / 10 - place
        x = 25 * (time_s + place) + 8 * np.sin(0.3 * time_s) + 35.0 * (10 - place)
        speed = np.gradient(x, 0.1)
        row = Row(vehicle=number + 1, y=31.0 + 4 * lane, lane_id=6 + lane)
        rows += [
            replace(row, frame=k + 1, x=float(at), vx=float(v))
            for k, (at, v) in enumerate(zip(x, speed, strict=True))
        ]
    return rows


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("likeness")
    (made / "people").mkdir()
    write_trio(made / "people", platoons(), rate=10)
    (made / "small.yaml").write_text(SUITE.format(network=NETWORK))
    return made


def test_an_onnx_file_is_scored_in_a_profile_whose_steps_grow(folder: Path) -> None:
    command = ("likeness", "small.yaml", "people", "--population", "i24", "--controls")
    called = charms_bench(*command, "--figure", "likeness.png", "--json", cwd=folder)
    assert called.returncode == 0, called.stderr
    rows = {(row["kind"], row["label"]): row for row in json.loads(called.stdout)}
    mine = rows["ego", "My network"]
    assert set(mine["scores"]) == {"closed_loop", "given_scene", "events", "total"}
    assert mine["conduct"]["lane_changes_per_km"] is not None
    assert rows["reference", "constant velocity"]["scores"]["closed_loop"]["value"] == 0.0
    recorded = rows["reference", "half of the drivers"]["conduct"]
    # The speeds vary by 8 m * 0.3 / s, so accelerations by 8 m * 0.09 / s2, as a sine does.
    assert recorded["acceleration_std_mps2"] == pytest.approx(0.72 / 2**0.5, rel=0.05)
    assert rows["control", "lane changes x 5"]["differences"]["closed_loop"]["value"] == 0.0
    assert (folder / "likeness.png").stat().st_size > 10_000


def test_a_driver_by_whom_an_agent_is_selected_is_not_one_by_whom_it_is_tested() -> None:
    trips = [SimpleNamespace(driver=driver, at=k) for k, driver in enumerate([7, 3, 9, 3, 1])]
    halves = {half: of_half(trips, half) for half in ("both", "selection", "test")}
    assert [each.at for each in halves["both"]] == [0, 1, 2, 3, 4]
    assert [each.at for each in halves["selection"]] == [0, 4]  # drivers 1 and 7
    assert [each.at for each in halves["test"]] == [1, 2, 3]  # drivers 3 and 9


def test_the_tables_name_every_driver(folder: Path) -> None:
    called = charms_bench("likeness", "small.yaml", "people", "--population", "i24", cwd=folder,
                           columns=200)  # fmt: skip
    assert called.returncode == 0, called.stderr
    for label in ("drivers of the other half", "Human", "My network", "IDM"):
        assert called.stdout.count(label) >= 2


def test_without_recordings_one_line_names_the_folder(tmp_path: Path) -> None:
    command = ("likeness", "likeness", tmp_path / "people", "--population", "i24")
    called = charms_bench(*command)
    assert called.returncode == 2
    assert f"{tmp_path / 'people'}" in called.stderr
    assert "Traceback" not in called.stderr

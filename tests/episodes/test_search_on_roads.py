"""A search varies numbers of a road's configuration, and finds those in which an ego fails."""

from pathlib import Path

import numpy as np
import pytest

import charms_bench
from charms_bench.episodes.severity import lower
from charms_bench.errors import InputError, SuiteError
from charms_bench.runs.suite import load_suite
from charms_bench.world.scene import Scene, SceneSettings

SUITE = """\
suite: ramps
episodes: 2
seed: 3
scene: {duration_s: 20}
egos:
  - {agent: imitation, label: Imitation}
  - {agent: idm_mobil, label: IDM}
roads:
  - merge-v1
  - name: merge-generic-v1
    label: Ramp
    parameters: {vehicles_count: [4, 9], after_merge_length: [90, 150.5]}
preventable_by: IDM
"""


def written(folder: Path, text: str = SUITE) -> Path:
    path = folder / "ramps.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_failures_on_a_road_run_as_a_suite(tmp_path: Path) -> None:
    found = tmp_path / "search" / "found.yaml"
    made = charms_bench.search(
        written(tmp_path), "Imitation", output=found.parent, failures=2, budget=200
    )
    assert len(made.failures) == 2
    assert made.preventable_by == [["IDM"]] * 2
    assert {type(point["vehicles_count"]) for point in made.failures} == {int}
    again = charms_bench.run(found, tmp_path / "again", workers=1)
    for cell in again.cells:
        has_crashed = cell.episodes["ending"].is_in(["rear_end", "side"])
        assert has_crashed.any() == (cell.agent == "Imitation")


def test_an_interrupted_search_of_a_road_reads_what_it_has_simulated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = written(tmp_path), "Imitation", None, tmp_path / "search"
    made = charms_bench.search(*asked, failures=2, budget=200)
    monkeypatch.delattr("charms_bench.episodes.search.margins")
    again = charms_bench.search(*asked, failures=2, budget=200)
    assert (again.failures, again.simulations) == (made.failures, made.simulations)


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ("vehicles_count: [4, 9]", "vehicle_count: [4, 9]", ":10: .*no key named 'vehicle_count'"),
        ("[90, 150.5]", "[80, 150]", "after_merge_length: 80.*expected at least 90"),
    ],
)
def test_parameters_of_a_road_are_checked_with_their_line(
    tmp_path: Path, old: str, new: str, error: str
) -> None:
    with pytest.raises(SuiteError, match=error):
        load_suite(written(tmp_path, SUITE.replace(old, new)))


def test_a_search_says_which_roads_it_can_vary(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none called 'merge-v1' can be searched. Known: Ramp"):
        charms_bench.search(written(tmp_path), "Imitation", road="merge-v1")
    text = SUITE.replace("parameters", "configuration").replace("[4, 9]", "4")
    with pytest.raises(InputError, match=r"no road has `parameters` to search"):
        charms_bench.search(written(tmp_path, text.replace("[90, 150.5]", "99")), "Imitation")


def test_the_margin_on_a_road_is_the_least_distance_to_a_vehicle_in_any_direction() -> None:
    ego, crossing = (0.0, 0.0, 1.0, 0.0), (6.0, 0.5, 0.0, 1.0)
    assert lowered(ego, crossing) == pytest.approx(6.0 - (5.0 + 2.0) / 2)
    # Both drive at 3 m/s at right angles to each other.
    assert lowered(ego, (3.0, 0.5, 0.0, 1.0), crashed=True) == pytest.approx(-3.0 * 2**0.5)


def lowered(*vehicles: tuple[float, float, float, float], crashed: bool = False) -> float:
    """The margin of the first of some vehicles (x, y and direction), which drive at 3 m/s."""
    settings = SceneSettings(traffic_vehicles=len(vehicles) - 1, ego_slots=1)
    scene, found = Scene.empty(settings, 1), np.array([np.inf])
    for i, place in enumerate(vehicles):
        for name, value in zip(("x", "y", "direction_x", "direction_y"), place, strict=True):
            getattr(scene, name)[0, i] = value
    scene.active[:], scene.crashed[0, 0] = True, crashed
    lower(scene, np.full((1, len(vehicles)), 3.0), True, found)
    return float(found[0])

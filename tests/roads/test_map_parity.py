"""Vehicles drive on maps as highway-env's own classes do on the same lanes, bit for bit."""

from pathlib import Path

import pytest

from charms_bench.testing.map_parity import MapCase
from charms_bench.testing.parity import verify

MAPS = Path(__file__).parents[3] / "shared" / "data" / "maps"
PLACES = Path(__file__).parents[2] / "suites" / "places"
SOME = {
    "opendrive/carla_town01.xodr": 5,
    "opendrive/carla_town04.xodr": 3,
    "opendrive/esmini_curves.xodr": 5,
    "opendrive/esmini_e6mini.xodr": 3,
    "opendrive/esmini_fabriksgatan.xodr": 5,
    "opendrive/esmini_multi_intersections.xodr": 5,
    "sumo/cloverleaf.net.xml": 5,
    "sumo/crossing_4lane.net.xml": 10,
    "sumo/mcity.net.xml": 5,
    "sumo/merge_3lane.net.xml": 15,
    "sumo/roundabout_2lane.net.xml": 10,
    "commonroad/DEU_A9-3_1_T-1.xml": 3,
}
"""Motorways, ramps, towns and a roundabout, in three formats, with so many vehicles that
highway-env takes up to 10 s for an episode."""


def test_a_roundabout_of_polylines_and_arcs_is_that_of_highway_env() -> None:
    (found,) = verify([MapCase(PLACES / "roundabout.json", seconds=5)], range(1), workers=1)
    assert (found.steps, found.differences, found.largest) == (5, [], 0.0)


@pytest.mark.slow
@pytest.mark.skipif(not MAPS.is_dir(), reason="needs ../shared/data/maps, road maps")
@pytest.mark.parametrize(("name", "vehicles"), SOME.items())
def test_100_episodes_on_a_map_are_those_of_highway_env(name: str, vehicles: int) -> None:
    (found,) = verify([MapCase(MAPS / name, vehicles)], range(100))
    assert (found.episodes, found.differences, found.largest) == (100, [], 0.0)

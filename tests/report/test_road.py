"""The road as text: one line per lane, and every vehicle where it is."""

from dataclasses import replace

import numpy as np
import pytest

from charms_bench.envs.rendering import moment_of
from charms_bench.envs.vector_env import HighwayVectorEnv
from charms_bench.report.road import road
from charms_bench.world.picture import Moment


@pytest.fixture
def moment() -> Moment:
    """The ego at 100 m on the middle lane of three, and a vehicle 30 m ahead on the right lane."""
    from charms_bench.envs.ego_env import ego_vector_env

    env: HighwayVectorEnv[object] = ego_vector_env(
        1, traffic="level_0", traffic_vehicles=1, ego_slots=1
    )
    env.reset(seed=0)
    return replace(
        moment_of(env.simulation, 0, "title"),
        x=np.array([100.0, 130.0]),
        y=np.array([4.0, 8.0]),
        acceleration=np.array([0.0, -3.0]),
    )


def test_vehicles_stand_on_their_lanes_one_character_per_metre(moment: Moment) -> None:
    lines = road(moment, width=100).plain.split("\n")
    assert lines[0] == "title, episode 0, 0.0 s"
    assert lines[1] == lines[7] == "═" * 100  # 62 m to 162 m
    assert lines[4].index("[ego>") == 100 - 62 - 2
    assert lines[6].index("< 1 >") == 130 - 62 - 2  # it brakes
    assert "".join(lines[2:7:2]).replace("[ego>", "").replace("< 1 >", "").strip() == ""
    assert lines[8].index("|100 m") == 100 - 62


def test_a_vehicle_between_two_lanes_stands_on_their_line(moment: Moment) -> None:
    lines = road(replace(moment, y=np.array([2.0, 8.0])), width=100).plain.split("\n")
    assert "[ego>" in lines[3]


def test_wrecks_are_marked_and_vehicles_beyond_the_ends_are_not_drawn(moment: Moment) -> None:
    far = replace(moment, x=np.array([100.0, 400.0]), crashed=np.array([True, False]))
    text = road(far, width=100).plain
    assert "xegox" in text
    assert "< 1 >" not in text
    assert "action crashed" in text

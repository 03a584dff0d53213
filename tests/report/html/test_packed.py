"""Trajectories inside a page."""

import zlib
from base64 import b64decode

import numpy as np
import pytest
from handmade_replay import replay_of

from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.report.html.packed import pack


@pytest.fixture
def replay() -> Replay:
    rng = np.random.default_rng(7)
    x = np.array([0.0, 40.0, -30.0]) + rng.uniform(0.5, 2.5, (61, 3)).cumsum(axis=0)
    return replay_of(x=x, y=rng.uniform(0, 8, (61, 3)), heading=rng.normal(0, 0.1, (61, 3)))


def unpacked(packed: dict) -> dict[str, np.ndarray]:
    """What the page's script makes of it, step by step."""
    numbers = np.frombuffer(zlib.decompress(b64decode(packed["data"])), dtype="<i4")
    found, start = {}, 0
    for name, unit, width in packed["columns"]:
        end = start + packed["frames"] * width
        found[name] = numbers[start:end].reshape(-1, width).cumsum(axis=0) * unit
        start = end
    assert start == numbers.size
    return found


def test_every_vehicle_is_where_it_was_to_a_centimetre(replay: Replay) -> None:
    found = unpacked(pack(replay, ego_view(replay)))
    np.testing.assert_allclose(found["x"], replay.x, atol=0.0051)
    np.testing.assert_allclose(found["y"], replay.y, atol=0.0051)
    np.testing.assert_allclose(found["heading"], replay.heading, atol=0.00051)


def test_what_there_is_none_of_is_minus_one_unit(replay: Replay) -> None:
    view = ego_view(replay)
    found = unpacked(pack(replay, view))
    known = ~np.isnan(view.gap_ahead)
    np.testing.assert_allclose(found["ahead"][known, 0], view.gap_ahead[known], atol=0.0051)
    assert (found["ahead"][~known, 0] == -0.01).all()


def test_flags_say_who_crashed_brakes_and_changes_lanes() -> None:
    replay = replay_of(
        x=[[0.0, 20.0, 40.0, 60.0]],
        y=[[4.0, 4.0, 4.0, 4.0]],
        target_lane=[[1, 0, 2, 1]],
        acceleration=[[0.0, 0.0, -3.0, 0.0]],
        crashed=[[False, False, False, True]],
    )
    (flags,) = unpacked(pack(replay, ego_view(replay)))["flags"].tolist()
    assert flags == [0, 4, 2 + 8, 1]


def test_names_stay_whole_and_vehicles_point_at_them(replay: Replay) -> None:
    packed = pack(replay, ego_view(replay))
    assert packed["agents"] == ["somebody", "other"]
    assert packed["agent"] == [0, 1, 1]

"""The likeness score in recorded scenes on roads, with known drivers."""

from pathlib import Path

import numpy as np
import pytest
from command_line import charms_bench

from charms_bench.humans.driven_situations import Driven, conduct
from charms_bench.humans.in_scenes import SceneYardstick, in_scenes, scenes_in
from charms_bench.world.scene import Floats

SCENES, EGOS = 24, 6


def scene(seconds: int, gain: float, seed: int) -> Floats:
    """(S, 1, T, 6) egos who start at 10 m/s, change speed by `gain` times a random walk, and follow
    a leader 20 m ahead."""
    walks = np.random.default_rng(seed).normal(size=(EGOS, 1, seconds)).cumsum(axis=-1)
    speed = 10 + gain * np.concatenate([np.zeros((EGOS, 1, 1)), walks], axis=-1)
    x = np.concatenate([np.zeros((EGOS, 1, 1)), speed[..., 1:].cumsum(axis=-1)], axis=-1)
    gap, still = np.full(speed.shape, 20.0), np.zeros(speed.shape)
    return np.stack([x, still, speed, speed, gap, speed], axis=-1)


def driven(gain: float, seconds: int = 12) -> Driven:
    return in_scenes([scene(seconds, gain, seed) for seed in range(SCENES)])


@pytest.fixture(scope="module")
def yardstick() -> SceneYardstick:
    return SceneYardstick(driven(0.5), driven(0.0))


@pytest.mark.parametrize(("gain", "score"), [(0.0, 0.0), (0.25, 0.5), (0.5, 1.0)])
def test_half_of_the_way_from_constant_speed_to_the_recording_scores_one_half(
    yardstick: SceneYardstick, gain: float, score: float
) -> None:
    # Its place and its speed are in the middle between both at any time.
    assert yardstick.scores(driven(gain))["closed_loop"].value == pytest.approx(score, abs=1e-12)


def test_constant_speed_is_the_floor_and_the_recording_the_ceiling(
    yardstick: SceneYardstick,
) -> None:
    for gain, score in ((0.0, 0.0), (0.5, 1.0)):
        assert yardstick.scores(driven(gain))["given_scene"].value == pytest.approx(score)


def test_only_horizons_that_scenes_reach_are_compared(yardstick: SceneYardstick) -> None:
    assert yardstick.horizons_s == (1, 2, 4, 8)
    assert SceneYardstick(driven(0.5, 5), driven(0.0, 5)).horizons_s == (1, 2, 4)


def test_what_scenes_are_too_short_for_is_not_scored() -> None:
    short = [scene(3, gain, seed)[:1] for gain in (0.5, 0.0) for seed in range(12)]
    human, constant = in_scenes(short[:12]), in_scenes(short[12:])
    found = SceneYardstick(human, constant)
    # Of 12 drivers for 3 s, no stratum has 30 s in each half.
    assert found.scores(constant).keys() == {"closed_loop", "events"}
    assert found.ceiling().keys() == {"closed_loop", "events"}


def test_seconds_after_the_end_of_a_scene_do_not_count() -> None:
    short = in_scenes([scene(seconds, 0.5, seconds) for seconds in (3, 9)])
    assert conduct(short)["seconds"] == EGOS * (3 + 9)
    assert conduct(short)["time_gap_median_s"] == pytest.approx(2.0, abs=0.3)
    assert conduct(short)["lane_changes_per_km"] is None


def test_a_folder_with_recordings_has_no_scenes(tmp_path: Path) -> None:
    (tmp_path / "a.xml").touch()
    assert scenes_in(tmp_path) == [tmp_path / "a.xml"]
    (tmp_path / "01_tracks.csv").touch()
    assert scenes_in(tmp_path) == []


def test_recordings_need_a_population_and_scenes_have_none(tmp_path: Path) -> None:
    called = charms_bench("likeness", "likeness", tmp_path)
    assert called.returncode == 2
    assert "need --population: i24" in called.stderr
    (tmp_path / "a.xml").touch()
    called = charms_bench("likeness", "likeness", tmp_path, "--population", "i24")
    assert called.returncode == 2
    assert "CommonRoad scenarios" in called.stderr


def test_a_profile_in_which_no_vehicle_can_stop_is_rejected(tmp_path: Path) -> None:
    (tmp_path / "a.xml").touch()
    called = charms_bench("likeness", "likeness", tmp_path)
    assert called.returncode == 2
    assert "'charms' has speeds of 22 to 33 m/s" in called.stderr.replace("\n", " ")

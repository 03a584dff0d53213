"""Animations: as long as the episode, and the vehicles where they are."""

from pathlib import Path

import numpy as np
from handmade_replay import replay_of
from PIL import Image, ImageColor

from charms_bench.api.shown import ShownReplay
from charms_bench.episodes.animation import animate, moment_of
from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.world.picture import (
    AGENTS,
    ASPHALT,
    BRAKE,
    EGO,
    INDICATOR,
    WRECK,
    picture,
    status_of,
)

RED = ImageColor.getrgb(WRECK)


def test_it_lasts_as_long_as_the_episode_and_holds_the_end(tmp_path: Path) -> None:
    x = np.stack([np.linspace(0.0, 50.0, 31), np.linspace(20.0, 60.0, 31)], axis=1)
    animate(replay_of(x=x), tmp_path / "there" / "a.gif", "nothing happened")
    with Image.open(tmp_path / "there" / "a.gif") as animation:
        assert animation.size[0] == 800
        durations = []
        for frame in range(animation.n_frames):
            animation.seek(frame)
            durations.append(animation.info["duration"])
    assert len(durations) == 31
    assert sum(durations) == 2000 + 2000  # 30 steps at 15 Hz, and 2 s at the end


def test_a_replay_animates_itself_above_what_happened(tmp_path: Path) -> None:
    replay = replay_of("off_road", x=np.zeros((6, 2)), speed=31.0)
    ShownReplay(**vars(replay)).animate(tmp_path / "its own.gif")
    animate(replay, tmp_path / "told.gif", "left the road at 31.0 m/s, at t = 0.3 s")
    assert (tmp_path / "its own.gif").read_bytes() == (tmp_path / "told.gif").read_bytes()


def drawn(replay: Replay) -> Image.Image:
    return picture(moment_of(replay, ego_view(replay), 0))


def pixel(image: Image.Image, ahead_m: float, lane: int) -> tuple[int, int, int]:
    """The colour at a distance ahead of the ego: 8 px/m, 38 m behind it, 38 px above the road."""
    return image.getpixel((round((38.0 + ahead_m) * 8), 38 + round((4.0 * lane + 3.0) * 8)))


def test_vehicles_are_drawn_to_scale_around_the_ego() -> None:
    image = drawn(replay_of(x=[[100.0, 120.0, 90.0]], y=[[4.0, 0.0, 8.0]]))
    ego, other = ImageColor.getrgb(EGO), ImageColor.getrgb(AGENTS[0])
    assert pixel(image, -2.3, 1) == pixel(image, 2.3, 1) == ego
    assert pixel(image, -2.7, 1) == pixel(image, 2.7, 1) == ImageColor.getrgb(ASPHALT)
    assert pixel(image, 20.0 - 2.3, 0) == pixel(image, -10.0 + 2.3, 2) == other


def test_a_wreck_is_crossed_out() -> None:
    still = {"x": [[0.0, 20.0]], "y": [[4.0, 4.0]]}
    whole = drawn(replay_of(**still))
    wrecked = drawn(replay_of(**still, crashed=[[False, True]]))
    assert RED not in {colour for _, colour in whole.getcolors(100_000)}
    assert RED in {colour for _, colour in wrecked.getcolors(100_000)}


def test_who_changes_lanes_and_who_brakes_has_lights() -> None:
    quiet = drawn(replay_of(x=[[0.0]], y=[[4.0]]))
    changing = drawn(replay_of(x=[[0.0]], y=[[4.0]], target_lane=[[0]]))
    braking = drawn(replay_of(x=[[0.0]], y=[[4.0]], acceleration=[[-3.0]]))
    for image, light in (
        (changing, ImageColor.getrgb(INDICATOR)),
        (braking, ImageColor.getrgb(BRAKE)),
    ):
        assert light in {colour for _, colour in image.getcolors(100_000)}
        assert light not in {colour for _, colour in quiet.getcolors(100_000)}


def test_the_state_of_the_ego_has_no_minus_zero() -> None:
    replay = replay_of(x=[[0.0, 40.0]], acceleration=-0.01, speed=-0.01)
    shown = status_of(moment_of(replay, ego_view(replay), 0))
    assert (shown["acceleration"], shown["ego's speed"]) == ("+0.0 m/s²", "0.0 m/s")

"""What the environments draw: the picture of a replay, in videos and in a window."""

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from handmade_replay import replay_of

from charms_bench.engine.simulation import Simulation
from charms_bench.envs import ID
from charms_bench.envs.learners_vector_env import LearnersVectorEnv
from charms_bench.envs.rendering import SHOWN, frame_of
from charms_bench.envs.rendering import moment_of as present
from charms_bench.episodes.animation import moment_of
from charms_bench.episodes.ego_view import ego_view
from charms_bench.world.actions import FASTER, LANE_LEFT
from charms_bench.world.picture import FINE, HEADER, LINE, picture

pygame = pytest.importorskip("pygame")

CROWDED = {"density": 2.0, "duration_s": 8.0}
FIELDS = ("x", "y", "heading", "speed", "acceleration", "lane", "target_lane", "crashed")


@pytest.fixture
def display(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A display that nobody sees."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


def made(render_mode: str | None = "rgb_array", **arguments: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(ID, render_mode=render_mode, **CROWDED, **arguments)


def many(count: int, render_mode: str | None = "rgb_array") -> Any:
    return gymnasium.make_vec(ID, num_envs=count, render_mode=render_mode, **CROWDED)


def shown() -> np.ndarray:
    """What stands in the window."""
    return pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)


def of_a_replay(simulation: Simulation) -> np.ndarray:
    """The picture of a replay in which the only scene of a simulation is the last moment."""
    scene, settings = simulation.scene, simulation.settings
    frames = int(simulation.steps[0]) * settings.steps_per_decision + 1
    fields = {name: np.repeat(getattr(scene, name), frames, axis=0) for name in FIELDS}
    replay = replace(
        replay_of(**fields),
        settings=settings,
        ego=int(scene.ego[0]),
        action=np.repeat(simulation.action, frames, axis=0),
        has_action=np.repeat(simulation.has_action, frames, axis=0),
    )
    return np.asarray(picture(moment_of(replay, ego_view(replay), frames - 1)))


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_the_road_and_the_ego_look_as_in_a_replay(seed: int) -> None:
    env = made()
    env.reset(seed=seed)
    rng, over, pictures = np.random.default_rng(seed), False, 0
    body = slice(HEADER // FINE, -(LINE + 12) // FINE)  # the titles and the legends differ
    while not over:
        _, _, failed, over, _ = env.step(rng.choice([FASTER, LANE_LEFT]))
        over |= failed
        expected = of_a_replay(env.unwrapped.simulation)
        np.testing.assert_array_equal(env.render()[body], expected[body])
        pictures += 1
    assert pictures > 3


def test_every_scene_of_many_is_drawn_as_the_same_scene_alone() -> None:
    together, alone = many(3), made()
    together.reset(seed=4)
    frames = together.render()
    assert isinstance(frames, tuple)
    for seed, frame in zip((4, 5, 6), frames, strict=True):
        alone.reset(seed=seed)
        np.testing.assert_array_equal(frame, alone.render())
    assert frames[0].dtype == np.uint8
    assert frames[0].shape == (244, 800, 3)


def test_a_second_shows_as_many_pictures_as_decisions() -> None:
    assert made(decision_hz=5).metadata["render_fps"] == 5
    assert many(2).metadata["render_fps"] == 3


@pytest.mark.usefixtures("display")
def test_gymnasiums_checker_has_nothing_to_say_about_what_is_drawn() -> None:
    check_env(made(None).unwrapped)


@pytest.mark.usefixtures("display")
def test_a_copy_does_not_take_the_window_along() -> None:
    env = made("human")
    env.reset(seed=1)
    for other in (deepcopy(env), pickle.loads(pickle.dumps(env))):
        np.testing.assert_array_equal(other.step(FASTER)[0], deepcopy(env).step(FASTER)[0])


def test_gymnasium_lists_the_frames_of_an_episode() -> None:
    env = made("rgb_array_list")
    env.reset(seed=1)
    env.step(FASTER)
    assert len(env.render()) == 2


@pytest.mark.usefixtures("display")
def test_a_window_shows_each_decision_of_the_episode() -> None:
    env, drawn = made("human"), made()
    for each in (env, drawn):
        each.reset(seed=2)
    np.testing.assert_array_equal(shown(), drawn.render())
    for each in (env, drawn):
        each.step(FASTER)
    np.testing.assert_array_equal(shown(), drawn.render())
    assert env.render() is None
    env.close()
    assert pygame.display.get_surface() is None


@pytest.mark.usefixtures("display")
def test_a_window_shows_how_the_first_of_many_episodes_end() -> None:
    env, alone = many(SHOWN + 1, "human"), made()
    env.reset(seed=1)
    height = shown().shape[0] // SHOWN
    for seed in range(1, SHOWN + 1):
        alone.reset(seed=seed)
        start = (seed - 1) * height
        np.testing.assert_array_equal(shown()[start : start + height], alone.render())
    ended = np.zeros(SHOWN + 1, dtype=bool)
    alone.reset(seed=1)
    while not ended[0]:
        alone.step(FASTER)
        _, _, failed, over, _ = env.step(np.full(SHOWN + 1, FASTER))
        ended = failed | over
    np.testing.assert_array_equal(shown()[:height], alone.render())


def test_without_a_display_a_window_is_an_error_that_says_so() -> None:
    code = (
        "import gymnasium, charms_bench.envs\n"
        f"env = gymnasium.make({ID!r}, render_mode='human')\n"
        "try:\n    env.reset()\nexcept charms_bench.CharmsBenchError as error:\n    print(error)"
    )
    displays = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    environment = {name: value for name, value in os.environ.items() if name not in displays}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert "there is no display; use render_mode 'rgb_array'" in done.stdout


def test_without_a_mode_nothing_is_drawn_and_a_warning_says_why() -> None:
    env = many(2, None)
    env.reset(seed=1)
    with pytest.warns(UserWarning, match="render needs a render_mode: rgb_array or human"):
        assert env.render() is None


def test_an_environment_that_draws_nothing_loads_nothing_to_draw_with() -> None:
    code = (
        "import sys, gymnasium, charms_bench.envs\n"
        f"env = gymnasium.make({ID!r})\nenv.reset()\nenv.step(0)\n"
        "print({'PIL', 'matplotlib', 'pygame'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


def test_a_picture_has_an_even_height_on_every_road() -> None:
    env = made(profile={"name": "charms", "lane_width_m": 3.7})
    env.reset(seed=1)
    assert frame_of(present(env.unwrapped.simulation, 0, "")).shape[0] % 2 == 0


@pytest.mark.filterwarnings("ignore:.*autoreset mode is same-step")
@pytest.mark.parametrize("vector", [False, True])
def test_gymnasium_records_a_video(vector: bool, tmp_path: Any) -> None:
    moviepy = pytest.importorskip("moviepy", reason="Gymnasium records with it")
    how = {"episode_trigger": lambda episode: episode == 0, "video_length": 9}
    folder = str(tmp_path / "videos")
    env: Any
    if vector:
        env = gymnasium.wrappers.vector.RecordVideo(many(4), folder, **how)
    else:
        env = gymnasium.wrappers.RecordVideo(made(), folder, **how)
    actions = np.full(4, FASTER) if vector else FASTER
    env.reset(seed=2)
    for _ in range(9):
        env.step(actions)
    env.close()
    (path,) = (tmp_path / "videos").glob("*.mp4")
    with moviepy.VideoFileClip(str(path)) as video:
        assert video.fps == 3
        assert video.size == [1600, 488] if vector else [800, 244]
        assert video.duration == pytest.approx(10 / 3, abs=0.1)


def test_stable_baselines_records_a_video(tmp_path: Any) -> None:
    moviepy = pytest.importorskip("moviepy", reason="Stable-Baselines3 records with it")
    recorder = pytest.importorskip("stable_baselines3.common.vec_env").VecVideoRecorder
    from charms_bench.envs.sb3 import EpisodesVecEnv

    env = recorder(EpisodesVecEnv(many(4)), str(tmp_path), lambda step: step == 0, 9)
    env.reset()
    for _ in range(10):
        env.step(np.full(4, FASTER))
    (path,) = tmp_path.glob("*.mp4")
    with moviepy.VideoFileClip(str(path)) as video:
        assert video.fps == 3
        assert video.size == [1600, 488]


def test_learners_are_drawn_in_a_colour_of_their_own() -> None:
    many = LearnersVectorEnv(2, range(8), render_mode="rgb_array")
    many.reset(seed=3)
    frames = many.render()
    assert frames is not None
    assert len(frames) == 2  # one per scene
    moment = present(many.simulation, 0, "LearnersVectorEnv")
    ego = many.simulation.scene.ego[0]
    assert [moment.agents[k] for k in many._episodes.learners.places[:8]].count("learner") == 7
    assert (moment.agents[ego], list(moment.traffic)) == ("", ["idm_mobil", "learner"])
    assert many.metadata["render_fps"] == 3


def test_an_environment_of_pettingzoo_draws_its_scene() -> None:
    parallel_env = pytest.importorskip("charms_bench.envs.parallel_env")
    single = parallel_env.HighwayParallelEnv(range(8), render_mode="rgb_array")
    single.reset(seed=3)
    many = LearnersVectorEnv(1, range(8), render_mode="rgb_array")
    many.reset(seed=3)
    header = slice(HEADER // FINE, None)  # the title above it differs
    assert (single.render()[header] == many.render()[0][header]).all()

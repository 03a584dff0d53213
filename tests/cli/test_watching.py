"""`charms-bench watch` shows an episode, in a window or as text."""

from pathlib import Path

import pytest
from command_line import charms_bench


@pytest.fixture(autouse=True)
def _no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)


def test_without_a_display_and_a_terminal_there_is_a_picture_per_second() -> None:
    result = charms_bench("watch", "level_0", "--traffic", "level_0", "--seed", 3)
    assert result.returncode == 0, result.stderr
    lines = result.stdout.splitlines()
    heads = [line for line in lines if line.startswith("level_0 in level_0, episode 3, ")]
    assert heads[:2] == [f"level_0 in level_0, episode 3, {k}.0 s" for k in (0, 1)]
    roads = [line for line in lines if any(ego in line for ego in ("[ego>", "<ego>", "xegox"))]
    assert len(roads) == len(heads)
    assert lines[-1].startswith("level_0 in level_0, episode 3: ")


def test_a_network_can_be_watched(network_file: object, tmp_path: Path) -> None:
    path = network_file()  # type: ignore[operator]
    result = charms_bench("watch", path, "--traffic", "level_0", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert f"{path} in level_0, episode 0" in result.stdout.splitlines()[0]


def test_an_episode_on_a_road_is_watched_along_the_egos_way(tmp_path: Path) -> None:
    (tmp_path / "suite.yaml").write_text(
        "suite: small\nepisodes: 1\negos: [{agent: idm_mobil}]\n"
        "roads: [{name: merge-v0, duration_s: 2.0}, u-turn-v0]\n"
    )
    command = ("watch", "stackelberg", "--suite", "suite.yaml")
    result = charms_bench(*command, "--road", "merge-v0", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "stackelberg in merge-v0, episode 0, 1.0 s" in result.stdout
    assert result.stdout.splitlines()[-1].endswith("drove until the time was over")
    several = charms_bench(*command, cwd=tmp_path)
    assert (several.returncode, "2 roads; choose one with --road" in several.stderr) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("nobody",), "no agent named 'nobody'"),
        (("level_0", "--road", "merge-v0"), "--road needs --suite, a suite with `roads`"),
        (("level_0", "--traffic", "nobody"), "no traffic named 'nobody'"),
    ],
)
def test_unknown_names_are_mistakes(arguments: tuple[str, ...], message: str) -> None:
    result = charms_bench("watch", *arguments)
    assert (result.returncode, message in result.stderr) == (2, True)


def test_with_a_display_it_is_a_window(monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from charms_bench.cli import app
    from charms_bench.envs import window

    sizes: list[tuple[int, ...]] = []
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(window.Window, "show", lambda _, picture, hz: sizes.append(picture.shape))
    done = CliRunner().invoke(app, ["watch", "level_0", "--traffic", "level_0"])
    assert done.exit_code == 0, done.output
    assert "═" not in done.output
    assert len(sizes) > 15  # fifteen pictures per second, and the start
    assert {shape[1:] for shape in sizes} == {(800, 3)}


def test_the_scene_and_a_traffic_model_of_a_suite_are_watched(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(
        "suite: mine\nepisodes: 4\nseed: 7\nscene: {duration_s: 3.0, lanes: 2}\n"
        "egos: [{agent: idm_mobil}, {agent: charms}]\npairs: false\n"
        "traffic_models: [{traffic: level_0, label: Blind}, {traffic: idm_mobil}]\n"
    )
    words = ("watch", "level_0", "--suite", "mine.yaml", "--text", "--traffic")
    done = charms_bench(*words, "Blind", cwd=tmp_path)
    assert "level_0 in Blind, episode 7: " in done.stdout, done
    assert "3.0 s" in done.stdout or "collision" in done.stdout
    missing = charms_bench(*words, "idm", cwd=tmp_path)
    assert (missing.returncode, "no traffic model 'idm'" in missing.stderr) == (2, True)
    several = charms_bench("watch", "level_0", "--suite", "mine.yaml", cwd=tmp_path)
    assert "2 traffic models; choose one with --traffic" in several.stderr

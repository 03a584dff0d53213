"""The code and the commands of `docs/environments.md`, with fewer training steps and episodes.

`test_continuous_page.py` and `test_stock_dqn.py` run what is about continuous control and about
highway-env, and `tests/testing/test_bench.py` the measurement of speed.
"""

import json
import re
import runpy
import shlex
from contextlib import chdir
from pathlib import Path

import pytest
from command_line import charms_bench

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

PAGE = Path(__file__).parents[2] / "docs" / "environments.md"
STEPS = "model.learn(1_000_000)"


def examples(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_code_about_environments_runs(capsys: pytest.CaptureFixture[str]) -> None:
    shown = [each for each in examples("python") if "stable_baselines3" not in each]
    exec(compile("\n".join(shown), "environments.md", "exec"), {})
    assert 0 < float(capsys.readouterr().out) < 1  # the mean of highway-env's rewards


def test_self_play_becomes_the_ego_and_the_traffic_of_a_suite(tmp_path: Path) -> None:
    (program,) = (each for each in examples("python") if STEPS in each)
    (tmp_path / "train.py").write_text(program.replace(STEPS, "model.learn(13_440)"))
    (suite,) = (each for each in examples("yaml") if "self-play" in each)
    (tmp_path / "self-play.yaml").write_text(suite)
    (block,) = (each for each in examples("sh") if "python train.py" in each)
    commands = [shlex.split(line) for line in block.splitlines()]
    ours = [line[1:] for line in commands if line[0] == "charms-bench"]
    with chdir(tmp_path):
        runpy.run_path("train.py")
    for line in ours:
        few = ["--episodes", 2, "--workers", 1, "--json"] * (line[0] == "run")
        done = charms_bench(*line, *few, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    cells = {(row["agent"], row["traffic"]) for row in json.loads(done.stdout)}
    names = ("untrained", "self-play", "IDM+MOBIL")
    assert cells == {(ego, traffic) for ego in names for traffic in names}

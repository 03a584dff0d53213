"""The code and the commands of `docs/many-learners.md`, with fewer training steps and episodes.

`tests/testing/test_bench.py` runs its measurement of speed.
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
pytest.importorskip("onnx", reason="needs the extra 'train'")

PAGE = Path(__file__).parents[2] / "docs" / "many-learners.md"
STEPS = "model.learn(1_000_000)"


def examples(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def test_the_code_about_environments_runs(capsys: pytest.CaptureFixture[str]) -> None:
    *about_environments, _ = examples("python")
    exec(compile("\n".join(about_environments), "many-learners.md", "exec"), {})
    assert 0 < float(capsys.readouterr().out) < 1  # the mean of highway-env's rewards


def test_self_play_becomes_the_ego_and_the_traffic_of_a_suite(tmp_path: Path) -> None:
    *_, program = examples("python")
    assert STEPS in program
    (tmp_path / "train.py").write_text(program.replace(STEPS, "model.learn(13_440)"))
    (tmp_path / "self-play.yaml").write_text(*examples("yaml"))
    commands = [shlex.split(line) for block in examples("sh") for line in block.splitlines()]
    ours = [line[1:] for line in commands if line[0] == "charms-bench" and line[1] != "bench"]
    assert ["python", "train.py"] in commands
    with chdir(tmp_path):
        runpy.run_path("train.py")
    for line in ours:
        few = ["--episodes", 2, "--workers", 1, "--json"] * (line[0] == "run")
        done = charms_bench(*line, *few, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    cells = {(row["agent"], row["traffic"]) for row in json.loads(done.stdout)}
    names = ("untrained", "self-play", "IDM+MOBIL")
    assert cells == {(ego, traffic) for ego in names for traffic in names}

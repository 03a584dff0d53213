"""The code of `docs/train-your-own.md` runs as it is, except for fewer training steps."""

import json
import re
import runpy
from contextlib import chdir
from pathlib import Path

import pytest
from command_line import charms_bench

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
pytest.importorskip("onnx", reason="needs the extra 'train'")

ROOT = Path(__file__).parent.parent.parent
STEPS = "model.learn(300_000)"


def test_the_ppo_of_the_page_becomes_an_ego_of_the_suite(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "train-your-own.md").read_text(encoding="utf-8")
    _, code, commands = re.findall(r"```\w*\n(.*?)```", text, re.DOTALL)
    (entry,) = re.findall(r"`(- \{agent: \{onnx: .*?)`", text)
    (tmp_path / "train.py").write_text(code.replace(STEPS, "model.learn(6_400)"))
    assert STEPS in code
    with chdir(tmp_path):
        runpy.run_path("train.py")
    for line in commands.splitlines():
        done = charms_bench(*line.split()[1:], cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    (tmp_path / "suites").mkdir()
    suite = (ROOT / "suites" / "ego.yaml").read_text()
    (tmp_path / "suites" / "ego.yaml").write_text(suite.replace("egos:\n", f"egos:\n  {entry}\n"))
    run = ["run", "suites/ego.yaml", "--episodes", "2", "--workers", "1", "--json"]
    finished = charms_bench(*run, cwd=tmp_path)
    assert "PPO" in {row["agent"] for row in json.loads(finished.stdout)}

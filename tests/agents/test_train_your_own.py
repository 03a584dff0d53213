"""The code of `docs/train-your-own.md` runs as it is, except for fewer training steps."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

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
    subprocess.run([sys.executable, "train.py"], cwd=tmp_path, check=True)
    for line in commands.splitlines():
        command = [sys.executable, "-m", *line.replace("charms-bench", "charms_bench").split()]
        subprocess.run(command, cwd=tmp_path, check=True)
    (tmp_path / "suites").mkdir()
    suite = (ROOT / "suites" / "ego.yaml").read_text()
    (tmp_path / "suites" / "ego.yaml").write_text(suite.replace("egos:\n", f"egos:\n  {entry}\n"))
    run = ["charms_bench", "run", "suites/ego.yaml", "--episodes", "2", "--json"]
    finished = subprocess.run([sys.executable, "-m", *run], cwd=tmp_path, stdout=-1, check=True)
    assert "PPO" in {row["agent"] for row in json.loads(finished.stdout)}

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


def fenced(page: str) -> list[str]:
    """The blocks of code on a page."""
    return re.findall(r"```\w+\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)


def test_the_ppo_of_the_page_becomes_an_ego_of_the_suite(tmp_path: Path) -> None:
    _, code, *commands = fenced("docs/train-your-own.md")
    assert STEPS in code
    (tmp_path / "train.py").write_text(code.replace(STEPS, "model.learn(6_400)"))
    with chdir(tmp_path):
        runpy.run_path("train.py")
    export, evaluate = "".join(commands).splitlines()
    done = charms_bench(*export.split()[1:], cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    short = ["--episodes", "2", "--workers", "1", "--json"]
    finished = charms_bench(*evaluate.split()[1:], *short, cwd=tmp_path)
    assert "ppo" in {row["agent"] for row in json.loads(finished.stdout)}
    assert (tmp_path / "runs" / "ego-ppo").is_dir()


def test_the_readme_trains_the_same_policy() -> None:
    (script,) = (block for block in fenced("README.md") if STEPS in block)
    assert script.removeprefix("# ppo.py\n") == fenced("docs/train-your-own.md")[1]

"""The code of `docs/your-policy.md` runs, with fewer training steps, episodes and egos."""

import json
import re
import runpy
import shlex
from contextlib import chdir
from pathlib import Path

import pytest
from command_line import charms_bench

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

ROOT = Path(__file__).parent.parent.parent
STEPS = "model.learn(300_000"


def fenced(page: str) -> list[str]:
    """The blocks of code on a page."""
    return re.findall(r"```\w+\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)


def test_the_ppo_of_the_page_becomes_an_ego_of_the_suite(tmp_path: Path) -> None:
    _, code, *commands = fenced("docs/your-policy.md")
    assert STEPS in code
    (tmp_path / "train.py").write_text(code.replace(STEPS, "model.learn(6_400"))
    with chdir(tmp_path):
        runpy.run_path("train.py")
    suite = (ROOT / "suites" / "roads-traffic.yaml").read_text(encoding="utf-8")
    # Beside `mine`, the last ego alone drives, and on one of the roads; tests/golden/test_suites.py
    # has rows of the others.
    shortened = re.sub(r"(?<=egos:\n)(  - .*\n)+(?=  - .*\nroads:)", "", suite)
    shortened = shortened.replace("[merge-v1, exit-v1]", "[exit-v1]")
    (tmp_path / "roads-traffic.yaml").write_text(shortened, encoding="utf-8")
    short = {"run": ["--episodes", "2", "--workers", "1", "--json"], "report": ["--top", "1"]}
    printed = []
    for line in "".join(commands).splitlines():
        words = shlex.split(line.replace("run roads-traffic", "run roads-traffic.yaml"))[1:]
        done = charms_bench(*words, *short.get(words[0], ()), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        if words[0] == "run":
            printed.append(json.loads(done.stdout))
    assert len(printed) == 3
    assert all("mine" in {row["agent"] for row in table} for table in printed)
    assert (tmp_path / "runs" / "merge-mine").is_dir()
    assert (tmp_path / "mine.html").exists()


def test_the_readme_trains_the_same_policy() -> None:
    (script,) = (block for block in fenced("README.md") if STEPS in block)
    assert script.removeprefix("# mine.py\n") == fenced("docs/your-policy.md")[1]

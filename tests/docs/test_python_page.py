"""The Python code of `docs/python.md`, of the README and about other roads runs, in order."""

import re
import shutil
from pathlib import Path

import pytest
from written import ROOT, execute, scripts


def code_of(page: Path) -> str:
    """The Python blocks of a page that use `charms_bench`, with fewer episodes and processes."""
    # The README's other block is a training, which test_your_policy.py runs.
    code = "\n".join(part for part in scripts(page) if "PPO" not in part)
    code = code.replace(", workers=2", "").replace("samples=100", "samples=100, workers=1")
    shortened, changed = re.subn(r"episodes=\d+", "episodes=4, workers=1", code)
    assert changed == 1, "the page runs one suite"
    return shortened


@pytest.mark.parametrize("page", ["docs/python.md", "README.md"])
def test_the_code_of_the_page_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ROOT / "suites", tmp_path / "suites")
    monkeypatch.chdir(tmp_path)
    execute(ROOT / page, code_of(ROOT / page))
    assert list(tmp_path.glob("*.gif")), "a replay was drawn"
    assert page == "README.md" or (tmp_path / "state.json").exists()
    assert "IDM+MOBIL" in capsys.readouterr().out


def test_the_code_about_highway_envs_other_roads_runs() -> None:
    execute(ROOT / "docs" / "highway-env-roads.md")


def test_the_code_about_training_on_highway_envs_roads_runs() -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")
    page = ROOT / "docs" / "train-on-roads.md"
    for script in scripts(page):
        assert script.count("model.learn(") == 1
        execute(page, re.sub(r"model\.learn\(.*\)", "model.learn(220)", script))

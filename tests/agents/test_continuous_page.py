"""What `docs/environments.md` has on continuous control runs, with fewer steps and episodes."""

import json
import re
import runpy
from contextlib import chdir
from pathlib import Path

import pytest
from command_line import charms_bench

pytest.importorskip("stable_baselines3", reason="needs the extra 'train'")

PAGE = Path(__file__).parents[2] / "docs" / "environments.md"
SECTION = re.compile(r"^## Continuous control\n(.*?)^## ", re.DOTALL | re.MULTILINE)
FEWER = {
    "20_000": "400",
    "2_000": "200",
    "num_envs=20": "num_envs=4",
    "episodes: 300": "episodes: 2",
}


def test_the_sac_of_the_page_drives_in_its_suite(tmp_path: Path) -> None:
    found = SECTION.search(PAGE.read_text(encoding="utf-8"))
    assert found
    text = found[1]
    for said, instead in FEWER.items():
        assert said in text
        text = text.replace(said, instead)
    train, commands, suite = re.findall(r"```\w+\n(.*?)```", text, re.DOTALL)
    (tmp_path / "train.py").write_text(train)
    (tmp_path / "sac.yaml").write_text(suite)
    with chdir(tmp_path):
        runpy.run_path("train.py")
    *before, run = commands.splitlines()
    for line in before:
        done = charms_bench(*line.split()[1:], cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    finished = charms_bench(*run.split()[1:], "--workers", "1", "--json", cwd=tmp_path)
    rows = json.loads(finished.stdout)
    assert {row["agent"] for row in rows} == {"SAC", "idm_mobil"}
    rejected = charms_bench("verify", "--continuous", "--suite", "sac.yaml", cwd=tmp_path)
    assert rejected.returncode == 2
    assert "--suite and --continuous exclude each other" in rejected.stderr

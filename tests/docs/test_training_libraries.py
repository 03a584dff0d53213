"""The scripts of `docs/training-libraries.md` train, and what they train drives better than chance.

`tox -e libraries` has the libraries. The scripts run as they are, except for fewer training steps.
"""

from importlib.util import find_spec
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from written import ROOT, blocks, commands, run, scripts

import charms_bench.envs  # noqa: F401  # registers charms_bench/Ego-v0
from charms_bench.plugins.onnx_policy import OnnxPolicy

pytestmark = pytest.mark.slow

PAGE = ROOT / "docs" / "training-libraries.md"
STEPS, FEWER = "320_000", "64_000"
VALIDATION_SEED, EPISODES = 900_000_000, 100
NEEDED = {
    "ppo.onnx": "stable_baselines3",
    "trpo.onnx": "sb3_contrib",
    "torchrl.onnx": "torchrl",
    "one-file.onnx": "torch",
    "maskable.onnx": "sb3_contrib",
    "recurrent.onnx": "sb3_contrib",
}
"""The policies of the page, and the library of each."""


def said(command: str, folder: Path) -> str:
    done = run(command, folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def train(script: str, folder: Path) -> None:
    assert script.count(STEPS) == 1, "a script states its steps once"
    (folder / "script.py").write_text(script.replace(STEPS, FEWER), encoding="utf-8")
    said("python script.py", folder)


def mean_return(policy: OnnxPolicy | None) -> float:
    """The mean return of the validation episodes; without a policy, of random actions."""
    many = gymnasium.make_vec("charms_bench/Ego-v0", num_envs=EPISODES)
    observations, _ = many.reset(seed=VALIDATION_SEED)
    rng, returns, memory = np.random.default_rng(0), np.full(EPISODES, np.nan), None
    while np.isnan(returns).any():
        actions = rng.integers(5, size=EPISODES)
        if policy is not None:
            noise = rng.random((EPISODES, policy.noise_draws))
            values, memory = policy.values_and_memory(observations, memory, noise)
            actions = policy.actions_of(values)
        observations, _, failed, over, infos = many.step(actions)
        first = (failed | over) & np.isnan(returns)
        if first.any():
            returns[first] = infos["final_info"]["episode_return"][first]
    return float(returns.mean())


@pytest.mark.parametrize("name", NEEDED)
def test_what_a_script_has_trained_drives_better_than_chance(name: str, tmp_path: Path) -> None:
    pytest.importorskip(NEEDED[name], reason="`tox -e libraries` has it")
    stem = name.removesuffix(".onnx")
    (script,) = (each for each in scripts(PAGE) if f'"{stem}.zip"' in each or f'"{name}"' in each)
    train(script, tmp_path)
    for command in (line for block in blocks(PAGE) for line in commands(block)):
        if f" {stem}.zip " in command:
            said(command, tmp_path)
    for policy in tmp_path.glob("*.onnx"):
        assert mean_return(OnnxPolicy(policy)) > mean_return(None)


def test_a_recurrent_network_of_torch_is_a_policy_with_memory(tmp_path: Path) -> None:
    (script,) = (each for each in scripts(PAGE) if "gru.onnx" in each)
    (tmp_path / "script.py").write_text(script, encoding="utf-8")
    said("python script.py", tmp_path)
    policy = OnnxPolicy(tmp_path / "gru.onnx")
    assert (policy.memory_width, policy.noise_draws) == (64, 0)
    mean_return(policy)


def test_a_policy_that_learns_is_filmed(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3", reason="`tox -e libraries` has it")
    moviepy = pytest.importorskip("moviepy", reason="`tox -e libraries` has it")
    (script,) = (each for each in scripts(PAGE) if "RecordVideo" in each)
    train(script, tmp_path)
    videos = sorted((tmp_path / "videos").glob("*.mp4"))
    assert len(videos) == 64_000 // 32_000
    for path in videos:
        with moviepy.VideoFileClip(str(path)) as video:
            assert video.fps == 3
            assert 1 <= video.duration <= 61 / 3 + 0.1  # at most 60 decisions and the start


def test_the_time_of_a_picture_is_measured(tmp_path: Path) -> None:
    (command,) = (
        line for block in blocks(PAGE) for line in commands(block) if line.startswith("python -m")
    )
    assert "per loop" in said(command, tmp_path)


def test_the_speed_of_every_library_is_measured(tmp_path: Path) -> None:
    missing = [name for name in {*NEEDED.values(), "moviepy"} if find_spec(name) is None]
    if missing:
        pytest.skip(f"needs {', '.join(missing)}; `tox -e libraries` has them")
    (tmp_path / "docs").mkdir()
    (tmp_path / "tools").mkdir()
    text = PAGE.read_text(encoding="utf-8").replace(STEPS, "12_800")
    (tmp_path / "docs" / PAGE.name).write_text(text, encoding="utf-8")
    tool = (ROOT / "tools" / "library_speed.py").read_text(encoding="utf-8")
    (tmp_path / "tools" / "library_speed.py").write_text(tool, encoding="utf-8")
    lines = said("python tools/library_speed.py", tmp_path).splitlines()
    assert len(lines) == len(NEEDED) - 2  # MaskablePPO and RecurrentPPO are not in the table
    assert all("decisions per second" in line for line in lines)

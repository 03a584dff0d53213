"""Records how episodes start and go on when highway-env computes as installed: `record_numpy.py`.

NumPy chooses its functions by the processor. So each episode is simulated twice, in processes that
choose differently, and recorded for as long as the two agree: no longer than rounding is harmless.
Numbers are rounded to millionths.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import gymnasium
import highway_env  # noqa: F401  # registers its environments
import numpy as np
from portable_mathematics import ENVIRONMENT, unchanged_idm
from record import IDS, actions_of, frame_of
from recorded_traces import Episode, Traces, together

QUANTITIES = "x", "y", "heading", "speed", "lane"
EPISODES, MOST_DECISIONS, LONG, MOST_OF_LONG = 5, 5, 2, 20
TOLERANCE = 1e-7
UNIT = 1e-6
"""Numbers are multiples of it in the file."""
_core: Any = np._core._multiarray_umath  # type: ignore[attr-defined]


def dispatches() -> list[dict[str, str]]:
    """The environment variables of two processes."""
    features = [name for name in _core.__cpu_dispatch__ if _core.__cpu_features__.get(name)]
    return [{}, {"NPY_DISABLE_CPU_FEATURES": " ".join(features), **ENVIRONMENT}]


def simulated(name: str) -> list[Episode]:
    """The episodes of an environment in its default configuration."""
    with unchanged_idm():
        env: Any = gymnasium.make(name, disable_env_checker=True)
    base, episodes = env.unwrapped, []
    for seed in range(EPISODES):
        rng, given = np.random.default_rng([seed, 6]), []
        with unchanged_idm():
            observation, _ = env.reset(seed=seed)
            lanes = {index: k for k, index in enumerate(base.road.network.lanes_dict())}
            frames = [frame_of(base, lanes, observation)]
            while len(given) < (MOST_OF_LONG if seed < LONG else MOST_DECISIONS):
                actions = tuple(actions_of(base, rng, seed % 2 == 0))
                given.append(np.stack(actions))
                has_agents = hasattr(base.action_type, "agents_action_types")
                observation, *outcome = env.step(actions if has_agents else actions[0])
                frames.append(frame_of(base, lanes, observation))
                if np.all(outcome[1]) or outcome[2]:
                    break
        values = {each: together(frames, each) for each in QUANTITIES}
        nothing = np.zeros((len(frames), 0), np.uint32), np.zeros((len(frames), 6), np.uint64)
        episodes.append(Episode(seed, {}, np.array(given), *nothing, values))
    return episodes


def agreeing(one: Episode, other: Episode) -> Episode:
    """The first part of an episode, in which two processes agree, rounded."""
    frames = 0
    while frames < min(len(one.words), len(other.words)) and _agree(one, other, frames):
        frames += 1
    assert frames, "they disagree at the start"
    values = {name: np.rint(each[:frames] / UNIT) for name, each in one.values.items()}
    of_frames = one.hashes[:frames], one.words[:frames]
    return Episode(one.seed, {}, one.actions[: frames - 1], *of_frames, values)


def _agree(one: Episode, other: Episode, frame: int) -> bool:
    """Whether two episodes agree in a frame and in the action that led to it."""
    if frame and not np.array_equal(one.actions[frame - 1], other.actions[frame - 1]):
        return False
    for name in QUANTITIES:
        a, b = (each.values[name][frame] for each in (one, other))
        a, b = a[~np.isnan(a)], b[~np.isnan(b)]
        if a.shape != b.shape or np.abs(a - b).max(initial=0) > TOLERANCE:
            return False
    return True


if __name__ == "__main__":
    if len(sys.argv) > 1:  # one of the two processes
        for name in sys.argv[2:]:
            Traces(name, simulated(name), quantities=()).write(Path(sys.argv[1], f"{name}.npz"))
        sys.exit()
    paths = {name: Path(__file__).with_name(f"numpy-{name}.npz") for name in IDS}
    missing = [name for name, path in paths.items() if not path.exists()]
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        for folder, variables in zip((one, other), dispatches(), strict=True):
            command = [sys.executable, "-W", "ignore", __file__, folder, *missing]
            subprocess.run(command, check=True, env={**os.environ, **variables})
        for name in missing:
            found = [Traces.read(Path(folder, f"{name}.npz")).episodes for folder in (one, other)]
            episodes = [agreeing(*pair) for pair in zip(*found, strict=True)]
            Traces(name, episodes, quantities=QUANTITIES).write(paths[name])
            kept, all_ = (sum(e.decisions for e in each) for each in (episodes, found[0]))
            print(f"{name}: {kept} of {all_} decisions", flush=True)

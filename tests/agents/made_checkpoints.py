"""Checkpoints made by hand, and an environment to make those of Stable-Baselines3 in."""

import io
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from handmade_weights import dqn_weights


class Blank(gymnasium.Env[Any, Any]):
    """Spaces without anything in them."""

    def __init__(self, shape: tuple[int, ...] = (7, 5), actions: int = 5) -> None:
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, shape, np.float32)
        self.action_space = gymnasium.spaces.Discrete(actions)


def zipped(folder: Path, tensors: dict[str, Any] | None = None, **members: bytes) -> Path:
    """A checkpoint with these tensors, by default a DQN's, and other members."""
    path, buffer = folder / "made.zip", io.BytesIO()
    torch.save(dqn_weights() if tensors is None else tensors, buffer)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in {"policy.pth": buffer.getvalue(), **members}.items():
            archive.writestr(name, data)
    return path

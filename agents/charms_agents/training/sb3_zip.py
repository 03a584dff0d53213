"""A Stable-Baselines3 checkpoint -> ONNX, without running anything that is in it.

Of the zip only `policy.pth` is read, and of that only tensors: what Stable-Baselines3 pickles
(`data`) may run any code when it is loaded, and is never touched.
"""

import re
import struct
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import IO, Any
from zipfile import BadZipFile, ZipFile, ZipInfo, is_zipfile

import numpy as np
import torch

from charms_agents.training.export import export
from charms_agents.training.network import OBSERVED, Layers, layers_of, network_of
from charms_bench.agent import ACTIONS, Observations
from charms_bench.errors import ModelError
from charms_bench.observation import neighbours
from charms_bench.testing import example_scene

WEIGHTS = "policy.pth"
FILE_LIMIT_BYTES = 2**30
"""Of the zip, which may hold a replay buffer beside the weights."""
WEIGHTS_LIMIT_BYTES = 64 * 2**20
MEMBERS_LIMIT = 1000
RATIO_LIMIT = 100
"""Deflate makes zeros about 1000 times smaller, and weights hardly smaller at all."""
CHECKED_SEEDS = range(4)
"""Of the example scenes whose observations the two networks are compared on."""
_LAYER = re.compile(r"q_net\.q_net\.(\d{1,3})\.(weight|bias)")


def export_zip(checkpoint: Path, output: Path, facts: dict[str, str]) -> dict[str, Any]:
    """Writes the Q-network of a DQN's checkpoint as an ONNX file.

    ReLU, Stable-Baselines3's default, is assumed between layers: what it is stands in `data`.

    Args:
        checkpoint: The zip that Stable-Baselines3 saved.
        output: The `.onnx` file.
        facts: What its metadata say beside what this function finds out.

    Returns:
        sizes (numbers in, of each hidden layer, out), activation, sha256 of the checkpoint,
        observations and ties of the check, as `export` returns them.

    Raises:
        ModelError: The checkpoint is no zip of a DQN with an MLP that fits; nothing is written.
        RunFolderError: The output cannot be written.
    """
    digest, weights = _read(checkpoint)
    network = network_of(_layers(checkpoint, weights))
    layers = layers_of(network)
    sizes = [OBSERVED, *(bias.size for _, bias in layers)]
    provenance = {
        "source": f"{checkpoint.name}, a Stable-Baselines3 checkpoint",
        "source_sha256": digest,
        "activation": "ReLU (assumed)",
    }
    scenes = np.concatenate([_seen(seed) for seed in CHECKED_SEEDS])
    checked = export(network, output, {**provenance, **facts}, scenes)
    return {"sizes": sizes, "activation": provenance["activation"], "sha256": digest, **checked}


def _seen(seed: int) -> Observations:
    """What everybody in the example scenes of a seed sees."""
    scene = example_scene(seed)
    observations: Observations = neighbours(scene, np.nonzero(np.ones(scene.x.shape, np.bool_)))
    return observations


def _read(path: Path) -> tuple[str, bytes]:
    """The hash of a checkpoint, and its `policy.pth`."""
    try:
        with path.open("rb") as file:
            if file.seek(0, 2) > FILE_LIMIT_BYTES:
                raise ModelError(f"{path}: larger than {FILE_LIMIT_BYTES:,} bytes")
            if not is_zipfile(file):
                raise ModelError(f"{path}: is no zip; expected what Stable-Baselines3 saves")
            file.seek(0)
            digest = sha256(file.read()).hexdigest()
            members = _members(path, file)
            if WEIGHTS not in members:
                found = ", ".join(sorted(members)[:8]) or "nothing"
                raise ModelError(f"{path}: has no {WEIGHTS}; it holds: {found}")
            with ZipFile(file) as archive:
                return digest, archive.read(WEIGHTS)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (BadZipFile, RuntimeError, NotImplementedError, EOFError, struct.error) as error:
        raise ModelError(f"{path}: {WEIGHTS} cannot be unpacked: {error}") from error


def _members(path: Path, file: IO[bytes], inside: str = "") -> dict[str, ZipInfo]:
    """What a zip holds, by name, once it is found to unpack to something reasonable.

    Raises:
        ModelError: It has too many members, or one that matters is too large.
    """
    place = f"{path}: {inside}" if inside else f"{path}: "
    with ZipFile(file) as archive:
        infos = archive.infolist()
    if len(infos) > MEMBERS_LIMIT:
        raise ModelError(f"{place}{len(infos):,} members; expected at most {MEMBERS_LIMIT:,}")
    read = [info for info in infos if inside or info.filename == WEIGHTS]
    if not inside and len(read) > 1:
        raise ModelError(f"{place}{WEIGHTS} is in it {len(read)} times")
    unpacked = sum(info.file_size for info in read)
    if unpacked > WEIGHTS_LIMIT_BYTES:
        raise ModelError(
            f"{place}{WEIGHTS} unpacks to {unpacked:,} bytes; "
            f"a policy may have {WEIGHTS_LIMIT_BYTES:,} at most"
        )
    for info in read:
        if info.file_size > RATIO_LIMIT * max(info.compress_size, 1):
            raise ModelError(
                f"{place}{info.filename} unpacks to more than {RATIO_LIMIT} times its size; "
                "weights do not"
            )
    return {info.filename: info for info in infos}


def _layers(path: Path, weights: bytes) -> Layers:
    """The layers of the Q-network in a `policy.pth`."""
    tensors = _tensors(path, weights)
    network: dict[int, dict[str, torch.Tensor]] = {}
    for name, tensor in tensors.items():
        if match := _LAYER.fullmatch(name):
            network.setdefault(int(match[1]), {})[match[2]] = tensor
    if any(name.startswith("q_net.features_extractor.") for name in tensors):
        raise ModelError(
            f"{path}: looks at its observations through a features extractor with weights, as "
            "CnnPolicy does; expected MlpPolicy"
        )
    if not network:
        found = ", ".join(list(tensors)[:4]) or "no tensors"
        raise ModelError(f"{path}: has no Q-network of a DQN; {WEIGHTS} holds: {found}")
    # Linear layers at 0, 2, 4, ..., activations between them.
    if sorted(network) != list(range(0, 2 * len(network), 2)) or any(
        set(parts) != {"weight", "bias"} for parts in network.values()
    ):
        raise ModelError(
            f"{path}: its Q-network is not made of linear layers with activations between them; "
            f"it has weights at {sorted(network)}"
        )
    layers: Layers = []
    width = OBSERVED
    for index in sorted(network):
        weight, bias = network[index]["weight"], network[index]["bias"]
        _check_layer(path, index, weight, bias, width)
        layers.append((weight.numpy(), bias.numpy()))
        width = weight.shape[0]
    if width != len(ACTIONS):
        raise ModelError(f"{path}: values {width} actions; expected {len(ACTIONS)}: {ACTIONS}")
    if not all(np.isfinite(array).all() for layer in layers for array in layer):
        raise ModelError(f"{path}: some of its weights are not finite")
    return layers


def _check_layer(
    path: Path, index: int, weight: torch.Tensor, bias: torch.Tensor, width: int
) -> None:
    for tensor in (weight, bias):
        plain = tensor.layout == torch.strided and tensor.device.type == "cpu"
        if not plain or tensor.dtype != torch.float32:
            raise ModelError(f"{path}: layer {index} is {tensor.dtype}; expected torch.float32")
    if weight.ndim != 2 or bias.shape != weight.shape[:1]:
        shapes = f"weight {tuple(weight.shape)}, bias {tuple(bias.shape)}"
        raise ModelError(f"{path}: layer {index} is not linear: {shapes}")
    if weight.shape[1] != width:
        expected = f"{width}, as the layer before gives"
        if not index:
            expected = f"{width}, the observation 'neighbours' of 7 rows of 5"
        raise ModelError(
            f"{path}: layer {index} takes {weight.shape[1]} numbers; expected {expected}"
        )
    # A view can repeat a few stored numbers without end.
    if weight.numel() * weight.element_size() > weight.untyped_storage().nbytes():
        raise ModelError(f"{path}: layer {index} repeats stored numbers")


def _tensors(path: Path, weights: bytes) -> dict[str, torch.Tensor]:
    """The tensors of a `policy.pth`; nothing but tensors is ever made."""
    if not is_zipfile(BytesIO(weights)):
        raise ModelError(f"{path}: {WEIGHTS} is not in torch's format of 2020 and later")
    _members(path, BytesIO(weights), f"{WEIGHTS}: ")
    try:
        loaded = torch.load(BytesIO(weights), weights_only=True, map_location="cpu")
    except Exception as error:  # whatever torch finds wrong with it
        reason = str(error).strip().partition("\n")[0]
        raise ModelError(
            f"{path}: {WEIGHTS} holds something other than tensors, which is not loaded, or is "
            f"damaged: {type(error).__name__}: {reason[:200]}"
        ) from error
    if not isinstance(loaded, dict) or not all(
        isinstance(name, str) and isinstance(tensor, torch.Tensor)
        for name, tensor in loaded.items()
    ):
        raise ModelError(f"{path}: {WEIGHTS} holds no tensors by name")
    return loaded

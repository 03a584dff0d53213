"""A Stable-Baselines3 checkpoint -> ONNX, without running anything that is in it.

Of the zip only `policy.pth` is read, and of that only tensors, and from the JSON of `data` the
activation's name as text: what Stable-Baselines3 pickles into that may run any code when it is
loaded, and is never touched.
"""

import json
import pickletools
import re
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile, ZipInfo, is_zipfile

import numpy as np
import torch

from charms_agents.training.export import export
from charms_agents.training.network import ACTIVATIONS, Layers, layers_of, network_of
from charms_bench.errors import ModelError
from charms_bench.testing import example_scene
from charms_bench.world.actions import ACTIONS
from charms_bench.world.files import read_limited
from charms_bench.world.kinematics import Kinematics
from charms_bench.world.observations import Neighbours, neighbours
from charms_bench.world.scene import Observations

WEIGHTS, DATA = "policy.pth", "data"
FILE_LIMIT_BYTES = 256 * 2**20
"""Of the zip, which holds the weights and what their optimiser knows of each."""
LIMITS_BYTES = {WEIGHTS: 64 * 2**20, DATA: 8 * 2**20}
PICKLE_LIMIT_BYTES = 2**20
"""Of the part of `policy.pth` that says which tensors there are."""
MEMBERS_LIMIT = 1000
RATIO_LIMIT = 100
"""Deflate makes zeros about 1000 times smaller, and weights hardly smaller at all."""
CHECKED_SEEDS = range(4)
"""Of the example scenes whose observations the two networks are compared on."""
_Q_LAYER = re.compile(r"q_net\.q_net\.(\d{1,3})\.(weight|bias)")
_POLICY_LAYER = re.compile(r"mlp_extractor\.policy_net\.(\d{1,3})\.(weight|bias)")
_LOGITS = re.compile(r"action_net\.(weight|bias)")
_VALUES = re.compile(r"(mlp_extractor\.value_net\.\d{1,3}|value_net)\.(weight|bias)")
_OF_TENSORS = re.compile(
    r"collections OrderedDict|torch\._utils _rebuild_tensor_v2|torch \w+Storage"
)
"""What the pickle of a `state_dict` names."""
_MEMBER = b"PK\x01\x02"
"""With what a zip's entry of a member begins."""
KINDS = {kind.__name__: kind for kind in ACTIVATIONS.values()}
"""The activations that can be exported, by torch's name."""
_ACTIVATION = re.compile(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>")


class Checkpoint(NamedTuple):
    """What is read of a zip."""

    sha256: str
    weights: bytes
    """`policy.pth`."""
    data: bytes
    """`data`; empty where there is none."""


def export_zip(
    checkpoint: Path,
    output: Path,
    facts: dict[str, str],
    observation: Neighbours | Kinematics = neighbours,
) -> dict[str, Any]:
    """Writes the network by which a DQN or a PPO decides as an ONNX file.

    Of a DQN that is its Q-network; of a PPO, or an A2C, the policy's layers up to its logits, of
    which the largest is the action it is most likely to take. Where `data` cannot be read, the
    activation is assumed to be Stable-Baselines3's default, ReLU for a DQN and tanh for a PPO.
    The statistics of a `VecNormalize` are in no checkpoint.

    Args:
        checkpoint: The zip that Stable-Baselines3 saved.
        output: The `.onnx` file.
        facts: What its metadata say beside what this function finds out.
        observation: What it was trained on.

    Returns:
        sizes (numbers in, of each hidden layer, out), activation, sha256 of the checkpoint,
        observations and ties of the check, as `export` returns them.

    Raises:
        ModelError: The checkpoint is no zip of a DQN or PPO with an MLP that fits; nothing is
            written.
        RunFolderError: The output cannot be written.
    """
    facts = {key: value.encode(errors="replace").decode() for key, value in facts.items()}
    read = _read(checkpoint)
    numbered, usual = _deciding(checkpoint, _tensors(checkpoint, read.weights))
    said = _activation(checkpoint, read.data, usual)
    network = network_of(_layers(checkpoint, numbered, observation), KINDS[said or usual])
    rows, columns = observation.shape
    sizes = [rows * columns, *(bias.size for _, bias in layers_of(network))]
    name = checkpoint.name.encode(errors="replace").decode()
    provenance = {
        "source": f"{name}, a Stable-Baselines3 checkpoint",
        "source_sha256": read.sha256,
        "activation": said or f"{usual} (assumed)",
    }
    scenes = np.concatenate([_seen(observation, seed) for seed in CHECKED_SEEDS])
    checked = export(network, output, {**provenance, **facts}, scenes, observation)
    return {
        "sizes": sizes,
        "activation": provenance["activation"],
        "sha256": read.sha256,
        **checked,
    }


def _seen(observation: Neighbours | Kinematics, seed: int) -> Observations:
    """What everybody in the example scenes of a seed sees."""
    scene = example_scene(seed)
    return observation(scene, np.nonzero(np.ones(scene.x.shape, np.bool_)))


def _read(path: Path) -> Checkpoint:
    """The hash of a checkpoint, and what is read of it."""
    try:
        content = read_limited(path, FILE_LIMIT_BYTES)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not is_zipfile(BytesIO(content)):
        raise ModelError(f"{path}: is no zip; expected what Stable-Baselines3 saves")
    try:
        members = _members(f"{path}: ", content)
        for name, limit in LIMITS_BYTES.items():
            read = [info for info in members if info.filename == name]
            if len(read) > 1:
                raise ModelError(f"{path}: {name} is in it {len(read)} times")
            _check_size(path, name, read, limit)
        names = [info.filename for info in members]
        if WEIGHTS not in names:
            found = ", ".join(name[:40] for name in sorted(names)[:8]) or "nothing"
            raise ModelError(f"{path}: has no {WEIGHTS}; it holds: {found}")
        with ZipFile(BytesIO(content)) as archive:
            data = archive.read(DATA) if DATA in names else b""
            return Checkpoint(sha256(content).hexdigest(), archive.read(WEIGHTS), data)
    except ModelError:
        raise
    except Exception as error:  # whatever zipfile and its decompressors find wrong with it
        raise ModelError(f"{path}: {WEIGHTS} or {DATA} cannot be unpacked: {error}") from error


def _members(place: str, content: bytes) -> list[ZipInfo]:
    """What a zip holds, once it is found not to hold very many things."""
    if content.count(_MEMBER) > MEMBERS_LIMIT:
        raise ModelError(f"{place}more than {MEMBERS_LIMIT:,} members; a policy has a few dozen")
    with ZipFile(BytesIO(content)) as archive:
        return archive.infolist()


def _check_size(path: Path, name: str, members: list[ZipInfo], limit: int) -> None:
    """Refuses members, of a zip called `name` or one of that name, that would unpack to too much.

    Raises:
        ModelError: They would.
    """
    unpacked = sum(info.file_size for info in members)
    if unpacked > limit:
        raise ModelError(
            f"{path}: {name} unpacks to {unpacked:,} bytes; a policy's may have {limit:,} at most"
        )
    for info in members:
        if info.file_size > RATIO_LIMIT * max(info.compress_size, 1):
            place = name if info.filename == name else f"{name}: {info.filename}"
            raise ModelError(
                f"{path}: {place} unpacks to more than {RATIO_LIMIT} times its size; "
                "what Stable-Baselines3 saves does not"
            )


def _activation(path: Path, data: bytes, usual: str) -> str | None:
    """The activation between layers, as torch calls it; none where `data` cannot be read.

    Args:
        path: The checkpoint.
        data: Its `data`, of which only text is looked at.
        usual: What it is where nothing is said.

    Raises:
        ModelError: It is one that cannot be exported.
    """
    try:
        said = json.loads(data)["policy_kwargs"].get("activation_fn")
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError):
        return None
    if said is None:
        return usual
    match = _ACTIVATION.fullmatch(str(said))
    if match is None or match[1] not in KINDS:
        raise ModelError(
            f"{path}: has {str(said)[:80]} between its layers; expected {' or '.join(KINDS)}"
        )
    return match[1]


def _deciding(
    path: Path, tensors: dict[str, torch.Tensor]
) -> tuple[dict[int, dict[str, torch.Tensor]], str]:
    """The layers of the network that decides, by their places, and its usual activation."""
    if any("features_extractor." in name for name in tensors):
        raise ModelError(
            f"{path}: looks at its observations through a features extractor with weights, as "
            "CnnPolicy does; expected MlpPolicy"
        )
    if q_network := _matching(_Q_LAYER, tensors):
        return q_network, "ReLU"
    logits = {match[1]: tensors[name] for name in tensors if (match := _LOGITS.fullmatch(name))}
    policy = _matching(_POLICY_LAYER, tensors)
    patterns = (_POLICY_LAYER, _LOGITS, _VALUES)
    other = [name for name in tensors if not any(each.fullmatch(name) for each in patterns)]
    if not logits or other:
        found = ", ".join(other[:4]) or ", ".join(list(tensors)[:4]) or "no tensors"
        raise ModelError(
            f"{path}: has neither the Q-network of a DQN nor just the policy and the values of a "
            f"PPO; {WEIGHTS} holds: {found}"
        )
    policy[max(policy, default=-2) + 2] = logits
    return policy, "Tanh"


def _matching(
    pattern: re.Pattern[str], tensors: dict[str, torch.Tensor]
) -> dict[int, dict[str, torch.Tensor]]:
    """Weight and bias of the layers whose names match, by their places."""
    found: dict[int, dict[str, torch.Tensor]] = {}
    for name, tensor in tensors.items():
        if match := pattern.fullmatch(name):
            found.setdefault(int(match[1]), {})[match[2]] = tensor
    return found


def _layers(
    path: Path,
    network: dict[int, dict[str, torch.Tensor]],
    observation: Neighbours | Kinematics,
) -> Layers:
    """The layers as arrays, once they are found to make a network."""
    # Linear layers at 0, 2, 4, ..., activations between them.
    if sorted(network) != list(range(0, 2 * len(network), 2)) or any(
        set(parts) != {"weight", "bias"} for parts in network.values()
    ):
        raise ModelError(
            f"{path}: its network is not made of linear layers with activations between them; "
            f"it has weights at {sorted(network)}"
        )
    layers: Layers = []
    rows, columns = observation.shape
    width = rows * columns
    source = (
        f"the observation '{observation.name}' of {rows} rows of {columns}; say with --observation "
        "what it was trained on"
    )
    for index in sorted(network):
        weight, bias = network[index]["weight"], network[index]["bias"]
        _check_layer(path, index, weight, bias, width, source)
        source = "as the layer before gives"
        layers.append((weight.detach().resolve_neg().numpy(), bias.detach().resolve_neg().numpy()))
        width = weight.shape[0]
    if width != len(ACTIONS):
        raise ModelError(f"{path}: values {width} actions; expected {len(ACTIONS)}: {ACTIONS}")
    if not all(np.isfinite(array).all() for layer in layers for array in layer):
        raise ModelError(f"{path}: some of its weights are not finite")
    return layers


def _check_layer(
    path: Path, index: int, weight: torch.Tensor, bias: torch.Tensor, width: int, source: str
) -> None:
    for tensor in (weight, bias):
        plain = tensor.layout == torch.strided and tensor.device.type == "cpu"
        if not plain or tensor.dtype != torch.float32:
            raise ModelError(f"{path}: layer {index} is {tensor.dtype}; expected torch.float32")
    if weight.ndim != 2 or bias.shape != weight.shape[:1] or not weight.numel():
        shapes = f"weight {tuple(weight.shape)}, bias {tuple(bias.shape)}"
        raise ModelError(f"{path}: layer {index} is not linear: {shapes}")
    if weight.shape[1] != width:
        raise ModelError(
            f"{path}: layer {index} takes {weight.shape[1]} numbers; expected {width}, {source}"
        )
    # A view can repeat a few stored numbers without end.
    if weight.numel() * weight.element_size() > weight.untyped_storage().nbytes():
        raise ModelError(f"{path}: layer {index} repeats stored numbers")


def _tensors(path: Path, weights: bytes) -> dict[str, torch.Tensor]:
    """The tensors of a `policy.pth`; nothing but tensors is ever made."""
    if not is_zipfile(BytesIO(weights)):
        raise ModelError(f"{path}: {WEIGHTS} is not in torch's format of 2020 and later")
    try:
        members = _members(f"{path}: {WEIGHTS}: ", weights)
        _check_size(path, WEIGHTS, members, LIMITS_BYTES[WEIGHTS])
        with ZipFile(BytesIO(weights)) as archive:
            for info in members:
                if info.filename.endswith(".pkl"):
                    _check_pickle(path, info, archive)
        loaded = torch.load(BytesIO(weights), weights_only=True, map_location="cpu")
    except ModelError:
        raise
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


def _check_pickle(path: Path, info: ZipInfo, archive: ZipFile) -> None:
    """Refuses a pickle that names anything but tensors.

    torch would make no other object either, but an array of any size.

    Raises:
        ModelError: It does.
        ValueError: It is no pickle.
    """
    if info.file_size > PICKLE_LIMIT_BYTES:
        raise ModelError(f"{path}: {WEIGHTS}: {info.filename[:40]} is too large to be true")
    for opcode, argument, _ in pickletools.genops(archive.read(info)):
        names = "GLOBAL" in opcode.name or opcode.name.startswith(("EXT", "INST"))
        if names and not _OF_TENSORS.fullmatch(str(argument)):
            raise ModelError(
                f"{path}: {WEIGHTS} holds something other than tensors, which is not loaded: "
                f"{str(argument or opcode.name)[:80]}"
            )

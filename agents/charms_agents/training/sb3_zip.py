"""Exports a Stable-Baselines3 checkpoint to ONNX, without running any code from it.

Two members of the zip are read: the tensors in `policy.pth`, and the activation's name as text in
the JSON of `data`. The pickles in `data` could run any code and are never loaded.
"""

import json
import math
import pickletools
import re
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo, is_zipfile

import numpy as np
import torch

from charms_agents.training.network import ACTIVATIONS, Layers, export, layers_of, network_of
from charms_bench.errors import ModelError
from charms_bench.foundation.files import read_limited
from charms_bench.testing import example_scene
from charms_bench.world.actions import ACTIONS, CONTROLS, ActionKind, outputs_of
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.observations import Neighbours, neighbours
from charms_bench.world.scene import Observations

WEIGHTS, DATA = "policy.pth", "data"
FILE_LIMIT_BYTES = 256 * 2**20
"""Largest zip; it holds the weights and the state of their optimiser."""
LIMITS_BYTES = {WEIGHTS: 64 * 2**20, DATA: 8 * 2**20}
PICKLE_LIMIT_BYTES = 2**20
"""Largest pickle in `policy.pth`; it describes the tensors."""
MEMBERS_LIMIT = 1000
RATIO_LIMIT = 100
"""Largest compression; deflate shrinks zeros about 1000 times, but weights hardly at all."""
CHECKED_SEEDS = range(4)
"""Seeds of the example scenes on whose observations the two networks are compared."""
_Q_LAYER = re.compile(r"q_net\.q_net\.(\d{1,3})\.(weight|bias)")
_POLICY_LAYER = re.compile(r"mlp_extractor\.policy_net\.(\d{1,3})\.(weight|bias)")
_LOGITS = re.compile(r"action_net\.(weight|bias)")
_OF_POLICY = re.compile(
    r"(mlp_extractor\.(policy|value)_net\.\d{1,3}|action_net|value_net)\.(weight|bias)"
)
_LATENT_LAYER = re.compile(r"actor\.latent_pi\.(\d{1,3})\.(weight|bias)")
_MEAN = re.compile(r"actor\.mu\.(weight|bias)")
_ACTOR_LAYER = re.compile(r"actor\.mu\.(\d{1,3})\.(weight|bias)")
_OF_TENSORS = re.compile(
    r"collections OrderedDict|torch\._utils _rebuild_tensor_v2|torch \w+Storage"
)
"""The names that the pickle of a `state_dict` may refer to."""
_MEMBER = b"PK\x01\x02"
"""The first bytes of a member's entry in a zip."""
KINDS = {kind.__name__: kind for kind in ACTIVATIONS.values()}
"""The activations that can be exported, by their torch name."""
_ACTIVATION = re.compile(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>")

_BOUNDS = ("low", "high")
"""The keys of a space's bounds in `data`."""

Tensors = dict[str, torch.Tensor]
Numbered = dict[int, Tensors]
"""The weight and the bias of each layer, by its position in the network."""


class _Refusal(Exception):
    """Why a checkpoint is refused; `export_zip` adds the file's name."""


def export_zip(
    checkpoint: Path,
    output: Path,
    facts: dict[str, str],
    observation: Neighbours | Kinematics = neighbours,
) -> dict[str, Any]:
    """Writes the network that decides for a DQN, PPO, A2C, SAC or TD3 as an ONNX file.

    For a DQN this is the Q-network. For a PPO or A2C it is the policy up to its logits; the largest
    logit belongs to the most probable action. For a SAC it is the actor up to the tanh of its mean,
    and for a TD3 or DDPG the actor; their actions are continuous. The file of a `MaskablePPO` also
    takes the action mask, unless the observation is `Kinematics`. If `data` cannot be read, the
    activation is assumed to be Stable-Baselines3's default: tanh for a PPO or A2C, ReLU for the
    others. A checkpoint does not hold the statistics of a `VecNormalize`, so they are not exported.

    Args:
        checkpoint: The zip that Stable-Baselines3 saved.
        output: The `.onnx` file.
        facts: Further metadata, beside what this function finds.
        observation: The observation that the network was trained on.

    Returns:
        sizes (inputs, neurons of each hidden layer, outputs), activation, sha256 of the
        checkpoint, and observations and ties from `export`.

    Raises:
        ModelError: The checkpoint is not a zip of one of these with a suitable MLP; nothing is
            written.
        RunFolderError: The output cannot be written.
    """
    facts = {key: value.encode(errors="replace").decode() for key, value in facts.items()}
    try:
        content_sha256, weights, data = _read(checkpoint)
        numbered, usual, kind = _deciding(_tensors(weights))
        said = _activation(data, usual)
        if kind == "continuous":
            _check_action_space(data)
        layers = _layers(numbered, observation, kind)
        network = network_of(layers, KINDS[said or usual], kind)
    except _Refusal as error:
        raise ModelError(f"{checkpoint}: {error}") from error
    name = checkpoint.name.encode(errors="replace").decode()
    activation = said or f"{usual} (assumed)"
    provenance = {
        "source": f"{name}, a Stable-Baselines3 checkpoint",
        "source_sha256": content_sha256,
        "activation": activation,
    }
    masked = _is_maskable(data) and isinstance(observation, Neighbours)
    asked = observation.model_copy(update={"action_mask": True}) if masked else observation
    scenes = np.concatenate([_seen(asked, seed) for seed in CHECKED_SEEDS])
    checked = export(network, output, {**provenance, **facts}, scenes, observation, masked)
    sizes = [math.prod(observation.shape), *(bias.size for _, bias in layers_of(network))]
    return {"sizes": sizes, "activation": activation, "sha256": content_sha256, **checked}


def _seen(observation: Neighbours | Kinematics, seed: int) -> Observations:
    """The observations of all vehicles in the example scenes of a seed."""
    scene = example_scene(seed)
    return observation(scene, np.nonzero(np.ones(scene.x.shape, np.bool_)))


def _read(path: Path) -> tuple[str, bytes, bytes]:
    """The SHA-256 of a checkpoint, its `policy.pth`, and its `data`, empty if it has none."""
    try:
        content = read_limited(path, FILE_LIMIT_BYTES)
    except OSError as error:
        raise _Refusal(f"cannot be read: {error.strerror or error}") from error
    if not is_zipfile(BytesIO(content)):
        raise _Refusal("not a zip; expected a file that Stable-Baselines3 saved")
    try:
        members = _members(content)
        for name, limit in LIMITS_BYTES.items():
            read = [info for info in members if info.filename == name]
            if len(read) > 1:
                raise _Refusal(f"holds {name} {len(read)} times")
            _check_size(name, read, limit)
        names = [info.filename for info in members]
        if WEIGHTS not in names:
            found = ", ".join(name[:40] for name in sorted(names)[:8]) or "nothing"
            raise _Refusal(f"has no {WEIGHTS}; it holds: {found}")
        with ZipFile(BytesIO(content)) as archive:
            data = archive.read(DATA) if DATA in names else b""
            return sha256(content).hexdigest(), archive.read(WEIGHTS), data
    except _Refusal:
        raise
    except Exception as error:  # zipfile and its decompressors raise many kinds
        raise _Refusal(f"{WEIGHTS} or {DATA} cannot be unpacked: {error}") from error


def _members(content: bytes, place: str = "") -> list[ZipInfo]:
    """The members of a zip; refuses a zip with very many."""
    if content.count(_MEMBER) > MEMBERS_LIMIT:
        raise _Refusal(f"{place}more than {MEMBERS_LIMIT:,} members; a policy has a few dozen")
    with ZipFile(BytesIO(content)) as archive:
        return archive.infolist()


def _check_size(name: str, members: list[ZipInfo], limit: int) -> None:
    """Refuses a member `name`, or the members of a zip `name`, that would unpack to too much."""
    if (unpacked := sum(info.file_size for info in members)) > limit:
        raise _Refusal(f"{name} unpacks to {unpacked:,} bytes; expected {limit:,} at most")
    for info in members:
        if info.file_size > RATIO_LIMIT * max(info.compress_size, 1):
            place = name if info.filename == name else f"{name}: {info.filename}"
            raise _Refusal(
                f"{place} unpacks to more than {RATIO_LIMIT} times its size; "
                "files of Stable-Baselines3 do not"
            )


def _activation(data: bytes, usual: str) -> str | None:
    """The activation that the text of `data` names, or else `usual`; None if it cannot be read."""
    try:
        said = json.loads(data)["policy_kwargs"].get("activation_fn")
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError):
        return None
    if said is None:
        return usual
    match = _ACTIVATION.fullmatch(str(said))
    if match is None or match[1] not in KINDS:
        raise _Refusal(f"has {str(said)[:80]} between its layers; expected {' or '.join(KINDS)}")
    return match[1]


def _is_maskable(data: bytes) -> bool:
    """Whether `data` names a policy of sb3-contrib's `MaskablePPO`."""
    try:
        return ".maskable." in str(json.loads(data)["policy_class"]["__module__"])
    except (ValueError, RecursionError, LookupError, TypeError):
        return False


def _check_action_space(data: bytes) -> None:
    """Refuses an action space that `data` describes as other than from -1 to 1."""
    try:
        space = json.loads(data)["action_space"]
        bounds = [[float(each) for each in space[key].strip("[]").split()] for key in _BOUNDS]
    except (ValueError, RecursionError, LookupError, TypeError, AttributeError):
        return
    size = len(CONTROLS)
    if bounds != [[-1.0] * size, [1.0] * size]:
        low, high = bounds
        raise _Refusal(
            f"has actions from {low} to {high}; expected Box(-1, 1, ({size},)): {CONTROLS}"
        )


def _deciding(tensors: Tensors) -> tuple[Numbered, str, ActionKind]:
    """The layers of the deciding network by position, its default activation, and its actions."""
    if any("features_extractor." in name for name in tensors):
        raise _Refusal("has a features extractor with weights, like CnnPolicy; expected MlpPolicy")
    if q_network := _matching(_Q_LAYER, tensors):
        return q_network, "ReLU", "meta"
    if any(name.startswith("actor.") for name in tensors):
        return _actor(tensors), "ReLU", "continuous"
    logits = {match[1]: tensors[name] for name in tensors if (match := _LOGITS.fullmatch(name))}
    policy = _matching(_POLICY_LAYER, tensors)
    other = [name for name in tensors if not _OF_POLICY.fullmatch(name)]
    if not logits or other:
        found = ", ".join(other[:4]) or ", ".join(list(tensors)[:4]) or "no tensors"
        if "log_std" in tensors:
            found += ", as of a PPO with continuous actions, which is not exported"
        raise _Refusal(
            f"expected the Q-network of a DQN, the actor of a SAC or TD3, or only the policy and "
            f"value networks of a PPO; {WEIGHTS} holds: {found}"
        )
    policy[max(policy, default=-2) + 2] = logits
    return policy, "Tanh", "meta"


def _actor(tensors: Tensors) -> Numbered:
    """The layers of the actor of a SAC, TD3 or DDPG by position, up to its last tanh."""
    mean = {match[1]: tensors[name] for name in tensors if (match := _MEAN.fullmatch(name))}
    latent = _matching(_LATENT_LAYER, tensors)
    actor = _matching(_ACTOR_LAYER, tensors)
    if "actor.log_std" in tensors:
        raise _Refusal("has state-dependent exploration; expected a SAC without use_sde")
    if bool(mean) == bool(actor):
        found = ", ".join([name for name in tensors if name.startswith("actor.")][:4])
        raise _Refusal(f"expected the actor of a SAC or TD3; {WEIGHTS} holds: {found}")
    if mean:
        latent[max(latent, default=-2) + 2] = mean
    return latent if mean else actor


def _matching(pattern: re.Pattern[str], tensors: Tensors) -> Numbered:
    found: Numbered = {}
    for name, tensor in tensors.items():
        if match := pattern.fullmatch(name):
            found.setdefault(int(match[1]), {})[match[2]] = tensor
    return found


def _layers(network: Numbered, observation: Neighbours | Kinematics, kind: ActionKind) -> Layers:
    """The layers as arrays; refuses layers that do not fit together."""
    # Linear layers are at 0, 2, 4, ..., activations between them.
    if sorted(network) != list(range(0, 2 * len(network), 2)) or any(
        set(parts) != {"weight", "bias"} for parts in network.values()
    ):
        raise _Refusal(
            f"expected linear layers with an activation between each two; "
            f"found weights at positions {sorted(network)}"
        )
    layers: Layers = []
    rows, columns = observation.shape
    width = rows * columns
    source = (
        f"the observation '{observation.name}' of {rows} rows of {columns}; name the observation "
        "that it was trained on with --observation"
    )
    for index in sorted(network):
        weight, bias = network[index]["weight"], network[index]["bias"]
        for tensor in (weight, bias):
            plain = tensor.layout == torch.strided and tensor.device.type == "cpu"
            if not plain or tensor.dtype != torch.float32:
                raise _Refusal(f"layer {index} is {tensor.dtype}; expected torch.float32")
        if weight.ndim != 2 or bias.shape != weight.shape[:1] or not weight.numel():
            shapes = f"weight {tuple(weight.shape)}, bias {tuple(bias.shape)}"
            raise _Refusal(f"layer {index} is not linear: {shapes}")
        taken = weight.shape[1]
        if taken != width:
            raise _Refusal(f"layer {index} takes {taken} numbers; expected {width}, {source}")
        # A view can repeat a few stored numbers any number of times.
        if weight.numel() * weight.element_size() > weight.untyped_storage().nbytes():
            raise _Refusal(f"layer {index} repeats stored numbers")
        source = "the outputs of the layer before"
        layers.append((weight.detach().resolve_neg().numpy(), bias.detach().resolve_neg().numpy()))
        width = weight.shape[0]
    if width != outputs_of(kind):
        names = ACTIONS if kind == "meta" else CONTROLS
        raise _Refusal(f"has {width} actions; expected {len(names)}: {names}")
    if not all(np.isfinite(array).all() for layer in layers for array in layer):
        raise _Refusal("some of its weights are not finite")
    return layers


def _tensors(weights: bytes) -> Tensors:
    """The tensors of a `policy.pth`; no other objects are ever made."""
    if not is_zipfile(BytesIO(weights)):
        raise _Refusal(f"{WEIGHTS} is not in the format of torch 1.6 and later")
    try:
        members = _members(weights, f"{WEIGHTS}: ")
        _check_size(WEIGHTS, members, LIMITS_BYTES[WEIGHTS])
        with ZipFile(BytesIO(weights)) as archive:
            for info in members:
                if info.filename.endswith(".pkl"):
                    _check_pickle(info, archive)
        loaded = torch.load(BytesIO(weights), weights_only=True, map_location="cpu")
    except _Refusal:
        raise
    except Exception as error:  # torch raises many kinds
        reason = str(error).strip().partition("\n")[0]
        raise _Refusal(
            f"{WEIGHTS} is damaged, or holds something other than tensors, which is not "
            f"loaded: {type(error).__name__}: {reason[:200]}"
        ) from error
    if not isinstance(loaded, dict) or not all(
        isinstance(name, str) and isinstance(tensor, torch.Tensor)
        for name, tensor in loaded.items()
    ):
        raise _Refusal(f"{WEIGHTS} does not hold named tensors")
    return loaded


def _check_pickle(info: ZipInfo, archive: ZipFile) -> None:
    """Refuses a pickle that refers to anything but tensors.

    torch would not make other objects either, but it would make a bytearray of any size.
    """
    if info.file_size > PICKLE_LIMIT_BYTES:
        what = f"{WEIGHTS}: {info.filename[:40]}"
        raise _Refusal(f"{what} is larger than {PICKLE_LIMIT_BYTES:,} bytes")
    for opcode, argument, _ in pickletools.genops(archive.read(info)):
        names = "GLOBAL" in opcode.name or opcode.name.startswith(("EXT", "INST"))
        if names and not _OF_TENSORS.fullmatch(str(argument)):
            raise _Refusal(
                f"{WEIGHTS} holds something other than tensors, which is not loaded: "
                f"{str(argument or opcode.name)[:80]}"
            )

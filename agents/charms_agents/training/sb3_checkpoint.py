"""Reads a Stable-Baselines3 checkpoint, without running any code from it.

Two members of the zip are read: the tensors in `policy.pth`, and the activation's name as text in
the JSON of `data`. The pickles in `data` could run any code and are never loaded.
"""

import json
import pickletools
import re
from collections.abc import Sequence
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo, is_zipfile

import torch

from charms_agents.training.network_file import KINDS
from charms_bench.foundation.files import read_limited

WEIGHTS, DATA = "policy.pth", "data"
FILE_LIMIT_BYTES = 256 * 2**20
"""Largest zip; it holds the weights and the state of their optimiser."""
LIMITS_BYTES = {WEIGHTS: 64 * 2**20, DATA: 8 * 2**20}
PICKLE_LIMIT_BYTES = 2**20
"""Largest pickle in `policy.pth`; it describes the tensors."""
MEMBERS_LIMIT = 1000
RATIO_LIMIT = 100
"""Largest compression; deflate shrinks zeros about 1000 times, but weights hardly at all."""
_OF_TENSORS = re.compile(
    r"collections OrderedDict|torch\._utils _rebuild_tensor_v2|torch \w+Storage"
)
"""The names that the pickle of a `state_dict` may refer to."""
_MEMBER = b"PK\x01\x02"
_ACTIVATION = re.compile(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>")
_BOUNDS = ("low", "high")

Tensors = dict[str, torch.Tensor]


class Rejection(Exception):
    """Why a checkpoint is rejected; `export_zip` adds the file's name."""


def read_checkpoint(path: Path) -> tuple[str, bytes, bytes]:
    """The SHA-256 of a checkpoint, its `policy.pth`, and its `data`, empty if it has none."""
    try:
        content = read_limited(path, FILE_LIMIT_BYTES)
    except OSError as error:
        raise Rejection(f"cannot be read: {error.strerror or error}") from error
    if not is_zipfile(BytesIO(content)):
        raise Rejection("not a zip; expected a file that Stable-Baselines3 saved")
    try:
        members = _members(content)
        for name, limit in LIMITS_BYTES.items():
            read = [info for info in members if info.filename == name]
            if len(read) > 1:
                raise Rejection(f"holds {name} {len(read)} times")
            _check_size(name, read, limit)
        names = [info.filename for info in members]
        if WEIGHTS not in names:
            found = ", ".join(name[:40] for name in sorted(names)[:8]) or "nothing"
            raise Rejection(f"has no {WEIGHTS}; it holds: {found}")
        with ZipFile(BytesIO(content)) as archive:
            data = archive.read(DATA) if DATA in names else b""
            return sha256(content).hexdigest(), archive.read(WEIGHTS), data
    except Rejection:
        raise
    except Exception as error:  # zipfile and its decompressors raise many kinds
        raise Rejection(f"{WEIGHTS} or {DATA} cannot be unpacked: {error}") from error


def _members(content: bytes, place: str = "") -> list[ZipInfo]:
    """The members of a zip; rejects a zip with very many."""
    if content.count(_MEMBER) > MEMBERS_LIMIT:
        raise Rejection(f"{place}more than {MEMBERS_LIMIT:,} members; a policy has a few dozen")
    with ZipFile(BytesIO(content)) as archive:
        return archive.infolist()


def _check_size(name: str, members: list[ZipInfo], limit: int) -> None:
    """Rejects a member `name`, or the members of a zip `name`, that would unpack to too much."""
    if (unpacked := sum(info.file_size for info in members)) > limit:
        raise Rejection(f"{name} unpacks to {unpacked:,} bytes; expected {limit:,} at most")
    for info in members:
        if info.file_size > RATIO_LIMIT * max(info.compress_size, 1):
            place = name if info.filename == name else f"{name}: {info.filename}"
            raise Rejection(
                f"{place} unpacks to more than {RATIO_LIMIT} times its size; "
                "files of Stable-Baselines3 do not"
            )


def said_in(data: bytes) -> Any:
    """What the JSON of `data` says; None if it cannot be read."""
    try:
        return json.loads(data)
    except (ValueError, RecursionError):
        return None


def within(said: Any, *keys: str) -> Any:
    """What is said under nested keys; None if nothing is."""
    for key in keys:
        said = said.get(key) if isinstance(said, dict) else None
    return said


def activation_of(said: Any, usual: str) -> str | None:
    """The activation that `data` names, or else `usual`; None if it cannot be read.

    Rejects a features extractor of one's own, too, which need not have weights.
    """
    if not isinstance(options := within(said, "policy_kwargs"), dict):
        return None
    if (named := options.get("activation_fn")) is not None:
        match = _ACTIVATION.fullmatch(str(named))
        if match is None or match[1] not in KINDS:
            raise Rejection(
                f"has {str(named)[:80]} between its layers; expected {', '.join(KINDS)}"
            )
        usual = match[1]
    own = options.get("features_extractor_class")
    if own is not None and "stable_baselines3.common.torch_layers.Flatten" not in str(own):
        raise Rejection(
            f"has the features extractor {str(own)[:80]}; expected MlpPolicy without one"
        )
    return usual


def check_continuous(said: Any, names: Sequence[str]) -> None:
    """Rejects continuous actions that go through a tanh, or are not from -1 to 1 for each name."""
    if within(said, "policy_kwargs", "squash_output"):
        raise Rejection("squashes its output; expected a PPO or A2C without squash_output")
    space = within(said, "action_space")
    try:
        bounds = [[float(each) for each in space[key].strip("[]").split()] for key in _BOUNDS]
    except (ValueError, LookupError, TypeError, AttributeError):
        return
    size = len(names)
    if bounds != [[-1.0] * size, [1.0] * size]:
        low, high = bounds
        raise Rejection(
            f"has actions from {low} to {high}; expected Box(-1, 1, ({size},)): {names}"
        )


def tensors_of(weights: bytes) -> Tensors:
    """The tensors of a `policy.pth`; no other objects are ever made."""
    if not is_zipfile(BytesIO(weights)):
        raise Rejection(f"{WEIGHTS} is not in the format of torch 1.6 and later")
    try:
        members = _members(weights, f"{WEIGHTS}: ")
        _check_size(WEIGHTS, members, LIMITS_BYTES[WEIGHTS])
        with ZipFile(BytesIO(weights)) as archive:
            for info in members:
                if info.filename.endswith(".pkl"):
                    _check_pickle(info, archive)
        loaded = torch.load(BytesIO(weights), weights_only=True, map_location="cpu")
    except Rejection:
        raise
    except Exception as error:  # torch raises many kinds
        reason = str(error).strip().partition("\n")[0]
        raise Rejection(
            f"{WEIGHTS} is damaged, or holds something other than tensors, which is not "
            f"loaded: {type(error).__name__}: {reason[:200]}"
        ) from error
    if not isinstance(loaded, dict) or not all(
        isinstance(name, str) and isinstance(tensor, torch.Tensor)
        for name, tensor in loaded.items()
    ):
        raise Rejection(f"{WEIGHTS} does not hold named tensors")
    return loaded


def _check_pickle(info: ZipInfo, archive: ZipFile) -> None:
    """Rejects a pickle of anything but tensors; torch would make a bytearray of any size."""
    if info.file_size > PICKLE_LIMIT_BYTES:
        what = f"{WEIGHTS}: {info.filename[:40]}"
        raise Rejection(f"{what} is larger than {PICKLE_LIMIT_BYTES:,} bytes")
    for opcode, argument, _ in pickletools.genops(archive.read(info)):
        names = "GLOBAL" in opcode.name or opcode.name.startswith(("EXT", "INST"))
        if names and not _OF_TENSORS.fullmatch(str(argument)):
            raise Rejection(
                f"{WEIGHTS} holds something other than tensors, which is not loaded: "
                f"{str(argument or opcode.name)[:80]}"
            )

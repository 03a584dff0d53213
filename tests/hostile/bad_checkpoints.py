"""Zips for `export` that unpack to enormous sizes, or run code in a reader that trusts them."""

import io
import os
import pickle
import struct
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from bad_input import CANARY, BadInput
from handmade_weights import dqn_weights


class Hostile:
    """Makes the canary wherever it is unpickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (CANARY,)


def saved(thing: Any, **options: Any) -> bytes:
    buffer = io.BytesIO()
    torch.save(thing, buffer, **options)
    return buffer.getvalue()


def zipped(method: int = zipfile.ZIP_STORED, **members: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name.replace("__", "."), data)
    return buffer.getvalue()


def checkpoint(policy: Any = None, **members: bytes) -> bytes:
    if not isinstance(policy, bytes):
        policy = saved(dqn_weights() if policy is None else policy)
    return zipped(policy__pth=policy, **members)


def pickled(code: bytes) -> bytes:
    """A `policy.pth` with the given pickle."""
    records = {"archive/data.pkl": code, "archive/version": b"3\n", "archive/data/0": bytes(16)}
    return checkpoint(zipped(**{name.replace(".", "__"): data for name, data in records.items()}))


def large(size: int) -> bytes:
    return b"\x8a\x08" + struct.pack("<q", size)


def tensor_of(numbers: int) -> bytes:
    """A pickle of weights whose storage claims to hold this many numbers."""
    storage = b"X\x07\0\0\0storagectorch\nFloatStorage\nX\x01\0\0\x000X\x03\0\0\0cpu"
    tensor = b"ctorch._utils\n_rebuild_tensor_v2\n((" + storage + large(numbers) + b"tQK\0"
    tensor += b"(K\x05t(K\x01t\x89ccollections\nOrderedDict\n)RtR"
    return b"\x80\x02}X\x14\0\0\0q_net.q_net.0.weight" + tensor + b"s."


def patched(data: bytes, old: bytes, new: bytes) -> bytes:
    assert old in data
    return data.replace(old, new)


def wrecked() -> bytes:
    """A checkpoint whose packed weights are damaged."""
    data = bytearray(zipped(zipfile.ZIP_DEFLATED, policy__pth=saved(dqn_weights())))
    data[60:160] = bytes(range(100))
    return bytes(data)


def bomb(name: str, size: int) -> bytes:
    return zipped(zipfile.ZIP_DEFLATED, **{name: bytes(size)})


def many_members(count: int) -> bytes:
    return zipped(**{f"m{k}": b"" for k in range(count)})


def quoted(name: bytes) -> bytes:
    """A checkpoint whose member `policy.pth` has another name."""
    return patched(checkpoint(), b"policy.pth", name)


def encrypted() -> bytes:
    data = checkpoint()
    return patched(data, b"PK\x01\x02\x14\x03\x14\x00\x00", b"PK\x01\x02\x14\x03\x14\x00\x01")


FILES: dict[str, Callable[[], bytes]] = {
    "empty": lambda: b"",
    "a zip without its start": lambda: checkpoint()[100:],
    "no UTF-8 in a name": lambda: quoted(b"\xff\xfeicy.pth"),
    "encrypted": encrypted,
    "damaged": wrecked,
    "weights twice": lambda: patched(
        zipped(policy__pth=saved(dqn_weights()), policy__ptx=saved(dqn_weights())),
        b"policy.ptx",
        b"policy.pth",
    ),
    "a bomb": lambda: bomb("policy.pth", 63 * 2**20),
    "a larger bomb": lambda: bomb("policy.pth", 2**28),
    "a bomb in data": lambda: zipped(
        zipfile.ZIP_DEFLATED, policy__pth=saved(dqn_weights()), data=bytes(2**24)
    ),
    "a bomb in a bomb": lambda: checkpoint(bomb("archive/data.pkl", 2**26)),
    "50,000 members": lambda: many_members(50_000),
    "a pickle that makes a folder": lambda: checkpoint(Hostile()),
    "a pickle among the weights": lambda: checkpoint(dqn_weights(q_net__q_net__0__bias=Hostile())),
    "a bare pickle": lambda: checkpoint(pickle.dumps(Hostile())),
    "a bytearray of 32 GB": lambda: pickled(
        b"\x80\x02c__builtin__\nbytearray\n" + large(2**35) + b"\x85R."
    ),
    "a storage of 10^12 numbers": lambda: pickled(tensor_of(10**12)),
    "a storage of 100 numbers more than there are": lambda: pickled(tensor_of(104)),
    "a name from the stack": lambda: pickled(
        b"\x80\x04\x8c\x02os\x8c\x05mkdir\x93\x8c\x06canary\x85R."
    ),
    "an instance": lambda: pickled(b"(S'canary'\nios\nmkdir\n."),
    "a pickle without end": lambda: pickled(b"\x80\x02" + b"(" * 100_000),
    "a pickle of 2 MB": lambda: pickled(b"\x80\x02" + b"N0" * 2**20 + b"N."),
    "a place of 2^31": lambda: pickled(b"\x80\x02Nr\xff\xff\xff\x7f."),
    "no tensors": lambda: checkpoint({}),
    "an empty layer": lambda: checkpoint(
        dqn_weights(
            q_net__q_net__0__weight=torch.zeros(0, 35),
            q_net__q_net__0__bias=torch.zeros(0),
            q_net__q_net__2__weight=torch.zeros(5, 0),
        )
    ),
    "a layer that repeats itself": lambda: checkpoint(
        dqn_weights(q_net__q_net__0__weight=torch.zeros(1).expand(4, 35))
    ),
    "a layer of whole numbers": lambda: checkpoint(
        dqn_weights(q_net__q_net__0__bias=torch.zeros(4, dtype=torch.int64))
    ),
    "a sparse layer": lambda: checkpoint(
        dqn_weights(q_net__q_net__0__weight=torch.zeros(4, 35).to_sparse())
    ),
    "weights that are no numbers": lambda: checkpoint(
        dqn_weights(q_net__q_net__0__bias=torch.full((4,), torch.nan))
    ),
    "three actions": lambda: checkpoint(
        dqn_weights(q_net__q_net__2__weight=torch.zeros(3, 4), q_net__q_net__2__bias=torch.zeros(3))
    ),
    "a layer that does not fit the one before": lambda: checkpoint(
        dqn_weights(q_net__q_net__2__weight=torch.zeros(5, 6))
    ),
}


SAID = {
    "empty": "not a zip; expected",
    "a zip without its start": "cannot be unpacked",
    "no UTF-8 in a name": "cannot be unpacked",
    "encrypted": "is encrypted",
    "damaged": "cannot be unpacked: Error -3",
    "weights twice": "holds policy.pth 2 times",
    "a bomb": "policy.pth unpacks to more than 100 times its size",
    "a larger bomb": "policy.pth unpacks to 268,435,456 bytes",
    "a bomb in data": "data unpacks to 16,777,216 bytes",
    "a bomb in a bomb": "policy.pth: archive/data.pkl unpacks to more than 100 times",
    "50,000 members": "more than 1,000 members",
    "a pickle among the weights": "holds something other than tensors",
    "a bare pickle": "is not in the format of torch",
    "a storage of 10^12 numbers": "is damaged, or holds something other than tensors",
    "a storage of 100 numbers more than there are": "is damaged, or holds something other",
    "a pickle of 2 MB": "archive/data.pkl is larger than",
    "a place of 2^31": "does not hold named tensors",
    "no tensors": "expected the Q-network of a DQN",
    "an empty layer": "not linear: weight (0, 35), bias (0,)",
    "a layer that repeats itself": "repeats stored numbers",
    "a layer of whole numbers": "is torch.int64; expected torch.float32",
    "weights that are no numbers": "not finite",
    "three actions": "has 3 actions; expected 5",
    "a layer that does not fit the one before": "takes 6 numbers; expected 4, the out",
}
"""Words of the message about some of them."""


def _bad(title: str, content: Callable[[], bytes]) -> BadInput:
    def make(folder: Path) -> Sequence[str]:
        (folder / "model.zip").write_bytes(content())
        return "export", "model.zip", "out.onnx"

    return BadInput(f"checkpoint: {title}", make, SAID.get(title, ""))


CASES = tuple(_bad(*item) for item in FILES.items())

"""What a finished stage says of its network."""

import hashlib
import json
import platform
from importlib.metadata import version
from typing import Any

from charms_agents.training.job import Keyed, StageFolder
from charms_bench.world.files import write_atomically

_VERSIONS = ("charms-bench", "numba", "numpy", "onnx", "onnxruntime", "stable-baselines3", "torch")


def write_manifest(
    folder: StageFolder, job: Keyed, suite_sha256: str, results: dict[str, Any]
) -> None:
    """Writes inputs, hashes, results, versions and machine; by this a stage is finished."""
    manifest = {
        **job.inputs,
        "key": job.key,
        "suite_sha256": suite_sha256,
        "onnx_sha256": hashlib.sha256(folder.network.read_bytes()).hexdigest(),
        **results,
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in _VERSIONS},
        },
        "machine": {"system": platform.system(), "processor": platform.machine()},
    }
    text = json.dumps(manifest, indent=2) + "\n"
    write_atomically(folder.manifest, lambda path: path.write_text(text, encoding="utf-8"))

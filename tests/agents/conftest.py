"""What tests of training share."""

import re
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

NEEDS = re.compile(r"^(from|import) (charms_agents\.training|onnx|stable_baselines3|torch)\b", re.M)
collect_ignore = [] if find_spec("stable_baselines3") else [
    path.name for path in Path(__file__).parent.glob("test_*.py") if NEEDS.search(path.read_text())
]  # fmt: skip
"""Without the extra 'train', what imports it."""


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> None:
    """On several threads, small networks mostly wait."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)

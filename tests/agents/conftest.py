"""What tests of training share."""

import sys

import pytest


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> None:
    """On several threads, small networks mostly wait."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)

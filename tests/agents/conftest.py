"""What tests of training share."""

from importlib.util import find_spec

import pytest


@pytest.fixture(autouse=True, scope="session")
def _one_thread() -> None:
    """On several threads, small networks mostly wait."""
    if find_spec("torch"):
        import torch

        torch.set_num_threads(1)

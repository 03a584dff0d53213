"""A plugin of pytest that runs those tests first whose names are most like a module's."""

import os
import re

import pytest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sorts the tests by how many words of the module's path their names contain."""
    *_, room, module = ("", *os.environ.get("MUTATED", "").removesuffix(".py").split("/"))
    words = [word.rstrip("s") for word in re.findall(r"[a-z]{3,}", f"{room} {module}")]
    items.sort(key=lambda item: -sum(word in item.nodeid.lower() for word in words))

"""A plugin of pytest that runs those tests first that most probably notice a fault in a module."""

import os
import re

import pytest

TELLING = {
    "roads": r"-v\d",
    "engine": "straight",
    "world": "straight",
    "envs": "feature",
    "recording": "rows",
    "baselines": "rows",
}
"""What the names of the golden tests contain that use a room the most."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sorts the tests by how many words of the module's name theirs contain, and by its room."""
    *_, room, module = ("", *os.environ.get("MUTATED", "").removesuffix(".py").split("/"))
    words = [word.rstrip("s") for word in re.findall(r"[a-z]{3,}", module)]

    def likeness(item: pytest.Item) -> int:
        name = item.nodeid.lower()
        is_of_room = re.search(TELLING.get(room, room), name) is not None
        return 2 * sum(word in name for word in words) + is_of_room

    items.sort(key=likeness, reverse=True)

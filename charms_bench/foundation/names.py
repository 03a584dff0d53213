"""Safe and distinct names for files and links, made from titles that users choose."""

import re
from collections.abc import Collection, Iterable
from hashlib import sha256
from itertools import chain, count
from pathlib import Path

LIMIT_BYTES = 50
"""Most bytes of a name made from one title; file systems allow 255 for a whole name."""


def slug(title: str) -> str:
    """Returns a title in small letters, digits, underscores and hyphens, which may be cut."""
    words = re.sub(r"\W+", "-", title.lower()).strip("-").encode()[:LIMIT_BYTES]
    return words.decode(errors="ignore").rstrip("-") or "unnamed"


def slugs(titles: Iterable[str]) -> list[str]:
    """Returns a name for each title, no two of them equal; a title gets its `slug` if it can."""
    return distinct(map(slug, titles))


def distinct(names: Iterable[str]) -> list[str]:
    """Returns the names, each followed by a number if it was there before; see `unused`."""
    found: dict[str, None] = {}
    for name in names:
        found[unused(name, found)] = None
    return list(found)


def unused(name: str, taken: Collection[str]) -> str:
    """Returns a name, followed by the first number from 2 on if it is taken."""
    numbered = chain([name], (f"{name}-{number}" for number in count(2)))
    return next(each for each in numbered if each not in taken)


def name_of_agent(agent: str) -> str:
    """Returns a name for files about an agent or a network: its own if safe, or one with a hash."""
    if slug(agent) == agent:
        return agent
    return f"{slug(Path(agent).stem)}-{sha256(agent.encode()).hexdigest()[:8]}"

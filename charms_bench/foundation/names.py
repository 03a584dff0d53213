"""Safe and distinct names for files and links, made from titles that users choose."""

import re
from collections.abc import Collection, Iterable, Sequence
from hashlib import sha256
from itertools import chain, count
from pathlib import Path
from unicodedata import normalize

LIMIT_BYTES = 50
"""Most bytes of a name made from one title; file systems allow 255 for a whole name."""


_INVISIBLE = re.compile("[\u034f\u115f\u1160\u180b-\u180f\u2800\ufe00-\ufe0f]")
"""Characters that count as printable, but show nothing."""
_LATIN = str.maketrans(
    "АВСЕНІЈКМОРЅТХУасеіјорѕхуΑΒΕΖΗΙΚΜΝΟΡΤΥΧο", "ABCEHIJKMOPSTXYaceijopsxyABEZHIKMNOPTYXo"
)
"""Cyrillic and Greek letters that look like Latin ones."""


def appearance(title: str) -> str:
    """The form of a title that readers perceive: equal for titles that look alike."""
    visible = _INVISIBLE.sub("", normalize("NFKC", title))
    return " ".join(visible.translate(_LATIN).split())


def alike(titles: Sequence[str]) -> str:
    """The first title that looks like an earlier one; empty if all differ."""
    seen: set[str] = set()
    for title in titles:
        if (look := appearance(title)) in seen:
            return title
        seen.add(look)
    return ""


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


def shown_agent(agent: str) -> str:
    """Returns what tables and pictures call an agent: its name, or the file of a network."""
    return Path(agent).name if agent.endswith(".onnx") else agent

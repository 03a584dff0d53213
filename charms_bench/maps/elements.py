"""The elements of an XML file, read one child of the root after the other and without entities."""

import math
from collections.abc import Iterator
from pathlib import Path
from xml.parsers import expat

from charms_bench.errors import MapError

DEEPEST = 64
"""Elements within elements; maps have about ten."""
_CHUNK_BYTES = 2**20
FORMATS = "an OpenDRIVE file, a SUMO network, a CommonRoad scenario or a road file"
LONGEST_NAME = 200
LARGEST = 1e9
"""No coordinate, length or polynomial coefficient of a map is beyond this."""


class Element:
    """An element with its children; `owner` names the child of the root that it is in."""

    __slots__ = ("attributes", "children", "line", "owner", "tag", "text")

    def __init__(self, tag: str, attributes: dict[str, str], line: int, owner: str) -> None:
        self.tag, self.attributes, self.line = tag, attributes, line
        self.owner = owner or self.named()
        self.children: list[Element] = []
        self.text = ""

    def named(self) -> str:
        """The element as users find it in the file."""
        name = self.attributes.get("id")
        return f"<{self.tag}{'' if name is None else f' id={name[:80]!r}'}>"

    def fault(self, what: str) -> MapError:
        """An error about this element; who reads the file adds its name."""
        inside = "" if self.owner == self.named() else f" in {self.owner}"
        return MapError(f"line {self.line}: {self.named()}{inside}: {what}")

    def every(self, tag: str) -> list["Element"]:
        """The children with a tag."""
        return [each for each in self.children if each.tag == tag]

    def first(self, tag: str) -> "Element | None":
        """The first child with a tag."""
        return next((each for each in self.children if each.tag == tag), None)

    def inside(self, *tags: str) -> list["Element"]:
        """The elements at the end of a path of tags."""
        found = [self]
        for tag in tags:
            found = [each for one in found for each in one.every(tag)]
        return found

    def needed(self, tag: str) -> "Element":
        """The first child with a tag; raises a `MapError` without one."""
        found = self.first(tag)
        if found is None:
            raise self.fault(f"has no <{tag}>; is the file complete?")
        return found

    def get(self, name: str, default: str = "") -> str:
        """The text of an attribute."""
        return self.attributes.get(name, default)

    def word(self, name: str) -> str:
        """The text of an attribute; raises a `MapError` if it is missing or empty."""
        found = self.attributes.get(name, "")
        if not found:
            raise self.fault(f"has no {name!r}; expected a name")
        if len(found) > LONGEST_NAME:
            raise self.fault(f"{name} has {len(found)} characters; expected up to {LONGEST_NAME}")
        return found

    def number(
        self,
        name: str,
        default: float | None = None,
        low: float = -LARGEST,
        high: float = LARGEST,
    ) -> float:
        """The number in an attribute; raises a `MapError` for any other text."""
        text = self.attributes.get(name)
        if text is None:
            if default is None:
                raise self.fault(f"has no {name!r}; expected a number")
            return default
        return self.parsed(text, name, low, high)

    def parsed(self, text: str, name: str, low: float = -LARGEST, high: float = LARGEST) -> float:
        """The number that a text of this element is."""
        try:
            value = math.nan if "_" in text else float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            allowed = (
                "a finite number" if (low, high) == (-LARGEST, LARGEST) else
                f"a number from {low:g}" + (f" to {high:g}" if high < LARGEST else "")
            )  # fmt: skip
            raise self.fault(f"{name} is {text.strip()[:40]!r}; expected {allowed}")
        return value

    def whole(self, name: str) -> int:
        """The whole number in an attribute."""
        value = self.number(name)
        if value != int(value):
            raise self.fault(f"{name} is {self.get(name)!r}; expected a whole number")
        return int(value)


def printable(text: str) -> str:
    """The text with `?` for characters that no terminal and no road file shows."""
    return "".join(each if each.isprintable() else "?" for each in text)


class _Builder:
    """Collects the elements below the root as a parser finds them."""

    def __init__(self) -> None:
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._add_text
        self.parser.EntityDeclHandler = self._reject_entity
        self.parser.SkippedEntityHandler = self._reject_entity
        self.has_root = False
        self.open: list[Element] = []
        self.done: list[Element] = []
        """The root when it starts, and its children when they end."""

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        if len(self.open) == DEEPEST:
            raise self.open[-1].fault(f"is nested {DEEPEST} elements deep; a map is not")
        owner = self.open[1].owner if len(self.open) > 1 else ""
        for name, value in attributes.items():
            if not value.isprintable():
                attributes[name] = printable(value)
        element = Element(tag, attributes, self.parser.CurrentLineNumber, owner)
        if len(self.open) > 1:
            self.open[-1].children.append(element)
        elif not self.open:
            self.has_root = True
            self.done.append(element)
        self.open.append(element)

    def _end(self, tag: str) -> None:
        element = self.open.pop()
        if len(self.open) == 1:
            self.done.append(element)

    def _add_text(self, text: str) -> None:
        if not text.isspace():
            self.open[-1].text += text

    def _reject_entity(self, name: str, *others: object) -> None:
        raise MapError(
            f"line {self.parser.CurrentLineNumber}: declares or uses the entity {name[:80]!r}; "
            "maps have none, and files with entities are not read"
        )


def elements(path: Path) -> Iterator[Element]:
    """The root without its children, and then each of its children when it is complete.

    Raises:
        MapError: The file is not XML or declares an entity. It does not name the file.
        OSError: The file cannot be read.
    """
    builder = _Builder()
    with path.open("rb") as file:
        last = False
        while not last:
            chunk = file.read(_CHUNK_BYTES)
            last = not chunk
            try:
                builder.parser.Parse(chunk, last)
            except expat.ExpatError as error:
                raise _not_xml(builder, error, last) from error
            except (LookupError, ValueError) as error:
                raise MapError(f"line 1: not XML: {' '.join(str(error).split())}") from error
            yield from builder.done
            builder.done.clear()


def _not_xml(builder: _Builder, error: expat.ExpatError, is_end: bool) -> MapError:
    if is_end and builder.open:
        inner = builder.open[-1]
        return MapError(
            f"line {error.lineno}: the file ends within {inner.named()}, which starts in line "
            f"{inner.line}; is it cut short?"
        )
    what = expat.errors.messages.get(error.code, "syntax error")
    expected = "" if builder.has_root else f"; expected {FORMATS}"
    return MapError(f"line {error.lineno}: not XML: {what}{expected}")

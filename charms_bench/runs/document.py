"""Reads YAML files from users into validated models; errors name file, line and field."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from charms_bench.errors import InputError, SuiteError, first_problem, problem_in
from charms_bench.foundation.files import absolute, read_limited
from charms_bench.runs.packaged import suite_file

M = TypeVar("M", bound=BaseModel)
Location = Sequence[str | int]
"""The keys and indices that lead to a value, as pydantic gives them."""

SIZE_LIMIT_BYTES = 2**17
"""Twenty times the longest suite of this project; larger files take seconds to parse."""
DEPTH_LIMIT = 20
DIGITS_LIMIT = 40
_PLAIN = {
    "bool": ("true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": ("[-+]?(?:0|[1-9][0-9_]*|0x[0-9a-fA-F]+)", "-+0123456789"),
    "float": (
        r"[-+]?(?:\.[0-9]+|[0-9][0-9_]*(?:\.[0-9_]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf)|\.nan",
        "-+0123456789.",
    ),
    "null": ("~|null|Null|NULL|", ["~", "n", "N", ""]),
}
"""What is not a text without quotes, as in YAML 1.2, and how it can begin."""
_AMBIGUOUS = (
    ("yes|Yes|YES|no|No|NO|on|On|ON|off|Off|OFF", "true or false"),
    (r"[-+]?0(?:[0-9_]+|[ob][0-9_]+)", "an octal or binary number"),
    (r"[-+]?[0-9][0-9_]*(?::[0-5]?[0-9])+(?:\.[0-9_]*)?", "a number to the base of 60"),
)
"""What YAML 1.1 or programs read as something that its author may not mean."""


class Document:
    """A YAML mapping that knows on which line each of its values is."""

    def __init__(self, path: Path) -> None:
        """Reads a file, or an installed suite by name; raises a `SuiteError`, see `_Loader`."""
        path = suite_file(path)
        self.path, self.folder = path, absolute(path).parent
        try:
            self._root, self.data = _parsed(read_limited(path, SIZE_LIMIT_BYTES).decode())
        except OSError as error:
            raise SuiteError(f"{path}: cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise SuiteError(f"{path}: is not UTF-8 text: {error.reason}") from error
        except yaml.MarkedYAMLError as error:
            what = "" if isinstance(error, _Rejected) else "is not YAML: "
            what += error.problem or "cannot be read"
            raise self._at(error.problem_mark.line if error.problem_mark else 0, what) from error
        except yaml.YAMLError as error:
            raise SuiteError(f"{path}: is not YAML: {problem_in(error)}") from error
        if not isinstance(self.data, dict):
            raise self._at(0, "expected a mapping of keys to values")

    def validate(self, model: type[M]) -> M:
        """Returns the document as a model; raises a `SuiteError` that names the first problem."""
        try:
            return model.model_validate(self.data, context={"folder": self.folder})
        except ValidationError as error:
            raise self.error(*first_problem(error)) from error

    def error(self, location: Location, what: str) -> SuiteError:
        """Returns the error for what is wrong at a location."""
        node, line, named = self._root, 0, ""
        for part in location:
            child = _child(node, part)
            if child is None:
                # A missing key, or the name that pydantic gives to a variant of a union.
                if isinstance(part, str) and isinstance(node, yaml.MappingNode):
                    named += f".{part}" if part.replace("_", "").isalpha() else ""
                continue
            line, node = child
            named += f"[{part}]" if isinstance(part, int) else f".{part}"
        return self._at(line, f"{named.lstrip('.')}: {what}" if named else what)

    def place_of(self, text: str, within: Location) -> Location:
        """Returns the location of the first key or value within a location that is this text.

        If it is not there, it is the location itself.
        """
        value = self.data
        for part in within:
            value = value[part]
        return (*within, *next(_places(value, text), ()))

    def _at(self, line: int, what: str) -> SuiteError:
        return SuiteError(f"{self.path}:{line + 1}: {what}")


def _places(value: Any, text: str) -> Iterator[tuple[str | int, ...]]:
    """Yields the locations below a value of the keys and values that are a text."""
    if isinstance(value, dict | list):
        for part, below in value.items() if isinstance(value, dict) else enumerate(value):
            if text in (part, below):
                yield (part,)
            yield from ((part, *rest) for rest in _places(below, text))


def value_of(text: str) -> Any:
    """The value of a text on the command line, read like a suite; raises a `ValueError`."""
    try:
        return _parsed(text)[1]
    except yaml.MarkedYAMLError as error:
        raise ValueError(error.problem) from error
    except yaml.YAMLError as error:
        raise ValueError(problem_in(error)) from error


def name_and_options(text: str, what: str) -> tuple[str, dict[str, Any]]:
    """The name and the options of a text like `NAME` or `NAME:OPTION=VALUE,...`.

    `what` is what the `InputError` about another text calls the thing, such as `metric set`.
    """
    name, _, given = text.partition(":")
    options = {}
    for part in filter(None, given.split(",")):
        key, equals, value = part.partition("=")
        if not equals or not key.isidentifier():
            raise InputError(f"{what} '{text}': expected NAME:OPTION=VALUE, found '{part}'")
        if key in options:
            raise InputError(f"{what} '{text}': {key} is given twice")
        try:
            options[key] = value_of(value)
        except ValueError as error:
            raise InputError(f"{what} '{name}': {key}: cannot be read: {error}") from error
    return name, options


class _Rejected(yaml.MarkedYAMLError):
    """Valid YAML of a kind that no suite needs, at an event or a node."""

    def __init__(self, what: str, at: Any) -> None:
        super().__init__(problem=what, problem_mark=at.start_mark)


class _Loader(yaml.SafeLoader):
    """Loads only plain YAML, whose size in memory is bounded by its size as text.

    Rejects tags, which could make objects, and aliases, merged and repeated keys, deep nesting,
    numbers with many digits, and what versions of YAML read differently.
    """

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}  # type: ignore[misc]  # of PyYAML
    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: yaml.Event = self.peek_event()  # type: ignore[no-untyped-call]  # of PyYAML
        if isinstance(event, yaml.AliasEvent):
            raise _Rejected("aliases (*name) are not supported", event)
        if (
            isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent)
            and event.tag is not None
        ):
            raise _Rejected("tags (!name) are not supported", event)
        if self._depth == DEPTH_LIMIT:
            raise _Rejected(f"nested more than {DEPTH_LIMIT} deep", event)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        if isinstance(node, yaml.MappingNode):
            _check_keys(node)
        if isinstance(node, yaml.ScalarNode) and node.style is None:
            _check_plain(node)
        if node is not None and node.tag.endswith(":int") and len(node.value) > DIGITS_LIMIT:
            raise _Rejected(f"a number has more than {DIGITS_LIMIT} digits", event)
        return node


for _tag, (_pattern, _first) in _PLAIN.items():
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(rf"(?:{_pattern})\Z"), list(_first)
    )


def _check_plain(node: yaml.ScalarNode) -> None:
    for pattern, what in _AMBIGUOUS:
        if re.fullmatch(pattern, node.value):
            raise _Rejected(
                f"{node.value} is {what} in some versions of YAML; write the number without "
                f"leading zeros, true or false, or a text as '{node.value}' in quotes",
                node,
            )


def _parsed(text: str) -> tuple[yaml.Node | None, Any]:
    """Returns the root node of a YAML document and its value."""
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
        return root, None if root is None else loader.construct_document(root)
    except ValueError as error:  # for example in a date with a 99th month
        raise yaml.YAMLError(str(error)) from error


def _check_keys(node: yaml.MappingNode) -> None:
    seen: set[str] = set()
    for key, _ in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise _Rejected("a key must be a word, not a list or a mapping", key)
        if key.value == "<<":
            raise _Rejected("merge keys (<<) are not supported", key)
        if key.value in seen:
            raise _Rejected(f"the key '{key.value}' is given twice", key)
        seen.add(key.value)


def _child(node: yaml.Node | None, part: str | int) -> tuple[int, yaml.Node] | None:
    """Returns the line and the node of a key or an index."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if key.value == str(part):
                return key.start_mark.line, value
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
        return node.value[part].start_mark.line, node.value[part]
    return None

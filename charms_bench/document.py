"""YAML files from users -> validated models, with errors that name file, line and field."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError

from charms_bench.errors import SuiteError

M = TypeVar("M", bound=BaseModel)
Location = Sequence[str | int]
"""The keys and indices that lead to a value, as pydantic gives them."""

SIZE_LIMIT_BYTES = 2**20


class Document:
    """A YAML mapping that remembers where everything in it stands.

    Safe YAML only: no tags that make objects, no aliases, no key twice.

    Raises:
        SuiteError: The file cannot be read or is no such YAML.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            if path.stat().st_size > SIZE_LIMIT_BYTES:
                raise SuiteError(f"{path}: larger than {SIZE_LIMIT_BYTES:,} bytes; no suite is")
            self.text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise SuiteError(f"{path}: cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise SuiteError(f"{path}: is no UTF-8 text: {error.reason}") from error
        try:
            for event in yaml.parse(self.text, Loader=yaml.SafeLoader):
                if isinstance(event, yaml.AliasEvent) and event.start_mark:
                    raise self._at(event.start_mark.line, "aliases (*name) are not supported")
            self._root = yaml.compose(self.text, Loader=yaml.SafeLoader)
            self._refuse_repeated_keys(self._root)
            self.data = yaml.safe_load(self.text)
        except yaml.MarkedYAMLError as error:
            mark = error.problem_mark
            raise self._at(mark.line if mark else 0, f"is not YAML: {error.problem}") from error
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise SuiteError(f"{path}: is not YAML: {error}") from error
        if not isinstance(self.data, dict):
            raise self._at(0, "expected a mapping of keys to values")

    def validate(self, model: type[M]) -> M:
        """The document as a model.

        Raises:
            SuiteError: The first thing that is wrong, and how many more there are.
        """
        try:
            return model.model_validate(self.data, context={"folder": self.path.parent})
        except ValidationError as error:
            raise self.error(*first_problem(error)) from error

    def error(self, location: Location, what: str) -> SuiteError:
        """The error of what stands at a location."""
        node, line, named = self._root, 0, ""
        for part in location:
            child = _child(node, part)
            if child is None:
                # A missing key, or the name pydantic gives a variant of a union.
                if isinstance(part, str) and isinstance(node, yaml.MappingNode):
                    named += f".{part}" if part.replace("_", "").isalpha() else ""
                continue
            line, node = child
            named += f"[{part}]" if isinstance(part, int) else f".{part}"
        return self._at(line, f"{named.lstrip('.')}: {what}" if named else what)

    def _at(self, line: int, what: str) -> SuiteError:
        return SuiteError(f"{self.path}:{line + 1}: {what}")

    def _refuse_repeated_keys(self, node: yaml.Node | None) -> None:
        if isinstance(node, yaml.MappingNode):
            seen: set[str] = set()
            for key, value in node.value:
                if key.value in seen:
                    raise self._at(key.start_mark.line, f"the key '{key.value}' stands here twice")
                seen.add(key.value)
                self._refuse_repeated_keys(value)
        elif isinstance(node, yaml.SequenceNode):
            for value in node.value:
                self._refuse_repeated_keys(value)


def first_problem(error: ValidationError) -> tuple[Location, str]:
    """Where the first thing stands that a model finds wrong, and what to say of it."""
    problems = error.errors(include_url=False)
    first = problems[0]
    found = _shortened(first["input"])
    what = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        what = "unknown key"
    elif first["type"] != "missing":
        what = f"{what}, found {found}"
    more = f" ({len(problems) - 1} more)" if len(problems) > 1 else ""
    return first["loc"], what + more


def _child(node: yaml.Node | None, part: str | int) -> tuple[int, yaml.Node] | None:
    """The line and the node of a key or an index."""
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            if key.value == str(part):
                return key.start_mark.line, value
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
        return node.value[part].start_mark.line, node.value[part]
    return None


def _shortened(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."

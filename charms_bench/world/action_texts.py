"""Meta-actions as JSON and YAML: names of highway-env's, and objects with the fields of others."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from typing import Annotated, Any

from pydantic import BeforeValidator, PlainSerializer

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.files import json_of
from charms_bench.world.actions import (
    ACTIONS,
    DEFAULT_ACTIONS,
    FASTER,
    MetaAction,
    check_actions,
    with_speed_steps,
)

_FIELDS = {field.name: field.default for field in fields(MetaAction)}


def read_actions(given: Any) -> tuple[MetaAction, ...]:
    """The meta-actions in a list such as `["IDLE", {"name": "LEFT", "lanes": -1}]`.

    Raises:
        InputError: It is another value, or an entry is neither a name of highway-env's meta-actions
            nor the fields of a `MetaAction`.
    """
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise InputError(f"found {str(given)[:80]!r}; expected a list of meta-actions")
    actions = tuple(map(_read, given))
    try:
        check_actions(actions)
    except InputError as error:
        raise InputError(f"the list {error}") from error
    return actions


def _read(given: Any) -> MetaAction:
    if isinstance(given, MetaAction):
        return given
    if isinstance(given, str) and given in ACTIONS:
        return DEFAULT_ACTIONS[ACTIONS.index(given)]
    if not isinstance(given, Mapping) or "name" not in given:
        expected = f"{', '.join(ACTIONS)}, or an object with a name"
        raise InputError(f"found {str(given)[:80]!r}; expected {expected}")
    for key in given:
        if key not in _FIELDS:
            what = f"meta-action {str(given['name'])[:40]!r}: unknown key '{str(key)[:40]}'"
            raise InputError(f"{what}. {suggestion(str(key), _FIELDS)}")
    return MetaAction(**given)


def action_objects(actions: Sequence[MetaAction]) -> list[Any]:
    """What `read_actions` reads as these meta-actions."""
    return [
        action.name
        if action in DEFAULT_ACTIONS
        else {key: value for key, value in asdict(action).items() if value != _FIELDS[key]}
        for action in actions
    ]


def metadata_of(actions: Sequence[MetaAction]) -> dict[str, str]:
    """The keys of the metadata of an ONNX file that describe meta-actions."""
    steps = tuple(actions)[FASTER].speed_steps_mps if len(actions) > FASTER else ()
    if min(steps, default=0) > 0 and tuple(actions) == with_speed_steps(*steps):
        text = described_actions(DEFAULT_ACTIONS)
        return {"actions": text, "target_speed_steps_mps": json.dumps(steps)}
    return {"actions": described_actions(actions)}


def described_actions(actions: Sequence[MetaAction]) -> str:
    """Meta-actions as text."""
    is_default = tuple(actions) == DEFAULT_ACTIONS
    return ", ".join(ACTIONS) if is_default else json.dumps(action_objects(actions))


def actions_described(text: str) -> tuple[MetaAction, ...]:
    """The meta-actions that a text from `described_actions` describes; else an `InputError`."""
    if text in ("meta", ", ".join(ACTIONS)):
        return DEFAULT_ACTIONS
    try:
        given = json_of(text.encode())
    except ValueError as error:
        raise InputError(f"found {text[:80]!r}; expected a JSON list of meta-actions") from error
    return read_actions(given)


def _validated(given: Any) -> tuple[MetaAction, ...]:
    try:
        return read_actions(given)
    except InputError as error:
        raise ValueError(str(error)) from error


MetaActionsField = Annotated[
    tuple[MetaAction, ...], BeforeValidator(_validated), PlainSerializer(action_objects)
]
"""A field of a validated model."""

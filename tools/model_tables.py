"""Tables of Markdown that describe the models of suites and of road files in words."""

import ast
import inspect
import re
import textwrap
from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel

from charms_bench.humans.reference import ReferenceSpec
from charms_bench.maps import road_file
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.runs.suite import EgoEntry, Suite, TrafficEntry
from charms_bench.runs.suite_roads import RoadEntry
from charms_bench.world.recordings import RecordedMoments, Split
from charms_bench.world.scenario import Action, EgoStart, Parameter, PlacedVehicle, Scenario
from charms_bench.world.scene import Inflow, SceneSettings
from charms_bench.world.vehicle_types import Distribution, VehicleType

KINDS = {
    "integer": "whole number",
    "number": "number",
    "string": "text",
    "boolean": "true or false",
    "object": "mapping",
}


def table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [header, ("---",) * len(header), *rows]
    cells = ([re.sub(r"\s+", " ", each).replace("|", r"\|") for each in line] for line in lines)
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)


def sections(parts: Iterable[tuple[str, str]]) -> str:
    """Texts under their headings."""
    return "\n".join(f"### {heading}\n\n{text}" for heading, text in parts)


def meanings(model: type[BaseModel]) -> dict[str, str]:
    """The docstring below each field of a model and of the models that it extends."""
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if not issubclass(base, BaseModel) or base is BaseModel:
            continue
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        assert isinstance(body, ast.ClassDef)
        for field, below in zip(body.body, body.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                name, text = ast.unparse(field.target), ast.literal_eval(below.value)
                found[name] = inspect.cleandoc(text)
    return found


def bounds(schema: dict[str, Any]) -> str:
    """The limits of a number; limits that only keep a simulation finite are left out."""
    low, high = schema.get("minimum"), schema.get("maximum")
    if schema.get("type") == "integer" and "exclusiveMaximum" in schema:
        high = schema["exclusiveMaximum"] - 1
    high = None if high is None or high >= 1e9 else high
    if low == 1e-9 or schema.get("exclusiveMinimum") == 0:
        return " above 0" if high is None else f" above 0, up to {high:,.15g}"
    if low is None or low <= -1e9:
        return "" if high is None else f" up to {high:,.15g}"
    return f" from {low:,g}" + ("" if high is None else f" to {high:,.15g}")


def anchor(key: str) -> str:
    """The fragment of a heading, as the site and GitHub make it."""
    return re.sub(r"[^\w -]", "", key.lower()).replace(" ", "-")


def default(value: object) -> str:
    if isinstance(value, BaseModel):
        return "see below"
    if value is None or value in ((), {}, ""):
        return "none"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


SUITE_KEYS: dict[str, type[BaseModel]] = {
    "suite": Suite,
    "egos[]": EgoEntry,
    "roads[]": RoadEntry,
    "traffic_models[]": TrafficEntry,
    "egos[].agent": AgentSpec,
    "traffic_models[].traffic": TrafficSpec,
    "references[]": ReferenceSpec,
    "scene": SceneSettings,
    "scene.vehicle_types[]": VehicleType,
    "a distribution": Distribution,
    "scene.inflow": Inflow,
    "scene.recording": RecordedMoments,
    "scene.recording.split": Split,
    "scenario": Scenario,
    "scenario.parameters": Parameter,
    "scenario.ego": EgoStart,
    "scenario.vehicles[]": PlacedVehicle,
    "scenario.vehicles[].actions[]": Action,
}
"""The models of a suite, each by the key under which it stands in YAML."""
ROAD_KEYS: dict[str, type[BaseModel]] = {
    "file": road_file.RoadFile,
    "road": road_file.FileRoad,
    "straight lane": road_file.StraightFileLane,
    "sine lane": road_file.SineFileLane,
    "circular lane": road_file.CircularFileLane,
    "polyline lane": road_file.PolylineLane,
    "conflict": road_file.FileConflict,
    "signal": road_file.FileSignal,
    "gap": road_file.FileGap,
}
"""The models of a road file, each by what it describes."""
NAMED = {"Profile": "[profile](#profiles)", "LatinHypercube": "`{latin_hypercube: N}`"}
"""Models that stand nowhere else in the tables."""


def kind(schema: dict[str, Any]) -> str:
    """What a JSON schema allows, in words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        known = SUITE_KEYS | ROAD_KEYS
        keys = [key for key, model in known.items() if model.__name__ == name]
        return f"[`{keys[0]}`](#{anchor(keys[0])})" if keys else NAMED[name]
    if "const" in schema:
        return f"`{schema['const']}`"
    if "oneOf" in schema:
        return " or ".join(kind(each) for each in schema["oneOf"])
    if "anyOf" in schema:
        parts = [kind(each) for each in schema["anyOf"] if each.get("type") != "null"]
        if parts == ["number", "text"]:  # `charms_bench.foundation.formula`
            return "formula"
        return " or ".join(dict.fromkeys(parts))
    if "enum" in schema:
        return " or ".join(f"`{each}`" for each in schema["enum"])
    if schema.get("type") == "array":
        if "prefixItems" in schema:
            return "[" + ", ".join(kind(each) for each in schema["prefixItems"]) + "]"
        return f"list of {kind(schema['items'])}"
    return KINDS.get(schema.get("type", ""), "text") + bounds(schema)


def keys_of(model: type[BaseModel]) -> str:
    schema = model.model_json_schema()
    if "$ref" in schema:  # a model that refers to itself
        schema = schema["$defs"][model.__name__]
    said, required = meanings(model), schema.get("required", [])
    rows = []
    for name, field in model.model_fields.items():
        if field.exclude or name == "sha256":
            continue
        key = field.alias or name
        fallback = (
            "required" if key in required else default(field.get_default(call_default_factory=True))
        )
        if name == "profile":
            fallback = "`charms`"
        rows.append((f"`{key}`", kind(schema["properties"][key]), fallback, said.get(name, "")))
    return table(("key", "value", "default", "meaning"), rows)


def described(models: dict[str, type[BaseModel]], headings: Iterable[str]) -> str:
    """What each model is, and its keys, under its heading."""
    texts = (f"{inspect.getdoc(model)}\n\n{keys_of(model)}" for model in models.values())
    return sections(zip(headings, texts, strict=True))

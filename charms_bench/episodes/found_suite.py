"""Writes the failures that a search has found as a suite that runs."""

import os
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import yaml

from charms_bench.episodes.search import FOUND, Search
from charms_bench.foundation.files import write_bytes
from charms_bench.plugins.registry import is_network
from charms_bench.runs.document import Document
from charms_bench.runs.suite import Suite, load_suite
from charms_bench.runs.suite_roads import RoadEntry


def write_found(search: Search, document: Document, suite: Suite, path: Path) -> None:
    """Writes a suite whose episodes, or roads, are the failures, driven by all of their drivers.

    Its scene, and what has been searched, are those of the suite's document.
    """
    cell, found = search.cell, _roads(search, document, suite)
    if traffics := document.data.get("traffic_models"):
        entry = deepcopy(traffics[suite.traffics.index(cell.traffic)])
        if not search.varies_road:
            entry["traffic"]["scenario"]["points"] = search.failures
        found["traffic_models"] = [entry]
    egos = [search.cell.ego, *search.references]
    written: dict[str, Any] = {
        "suite": path.stem,
        "title": f"Failures of {search.cell.title}",
        "episodes": suite.episodes if search.varies_road else len(search.failures),
        "scene": document.data.get("scene", {}),
        "egos": [
            {
                "agent": each.agent.model_dump(mode="json", exclude_defaults=True),
                "label": each.title,
            }
            for each in egos
        ],
        **found,
        "columns": document.data.get("columns", []),
    }
    if "warm_up_s" in document.data:
        written["warm_up_s"] = document.data["warm_up_s"]
    if search.references:
        written["preventable_by"] = [each.title for each in search.references]
    moved = _moved(written, document.folder, path.parent)
    text = yaml.safe_dump(moved, sort_keys=False, allow_unicode=True, width=100)
    write_bytes(path, text.encode())


def _roads(search: Search, document: Document, suite: Suite) -> dict[str, Any]:
    """The road with each failure in its configuration, and the seeds; a scenario's road itself."""
    road = search.cell.road
    if road is None:
        return {}
    entry = deepcopy(document.data["roads"][suite.roads.index(road)])
    if road.file is not None:
        entry["file"] = os.path.relpath(road.file, search.path)
    if not search.varies_road:
        return {"roads": [entry]}
    return {
        "seed": suite.seed,
        "roads": [
            {**entry, "configuration": road.at(point).configuration, "label": f"{road.title} {k}"}
            for k, point in enumerate(search.failures)
        ],
    }


def found_in(folder: Path) -> tuple[Mapping[str, float], ...]:
    """The failures in the suite that a search has written into its folder; empty without one.

    Raises a `CharmsBenchError` if the suite cannot be used.
    """
    path = folder / FOUND
    if not path.exists():
        return ()
    suite = load_suite(path)
    scenarios = [entry.traffic.scenario for entry in suite.traffics]
    if not any(scenarios):
        return tuple({name: _value(each, name) for name in each.parameters} for each in suite.roads)
    points: Any = next((each.points for each in scenarios if each is not None), ())
    return tuple(points)


def _value(road: RoadEntry, name: str) -> float:
    """The value of a parameter in a road's configuration."""
    value: Any = (road.configuration or {})[name]
    return float(value)


def _moved(value: Any, old: Path, new: Path) -> Any:
    """A value in which the paths of networks start at another folder."""
    if isinstance(value, dict):
        return {key: _moved(each, old, new) for key, each in value.items()}
    if isinstance(value, list):
        return [_moved(each, old, new) for each in value]
    if isinstance(value, str) and is_network(value):
        return os.path.relpath(old / value, new)
    return value

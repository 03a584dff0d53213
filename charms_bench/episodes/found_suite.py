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
from charms_bench.runs.suite import load_suite


def write_found(search: Search, document: Document, traffic: int, path: Path) -> None:
    """Writes a suite whose episodes are the failures, driven by all drivers of the search.

    The scene, and the scenario at this index among the traffic models, are those of the document.
    """
    entry = deepcopy(document.data["traffic_models"][traffic])
    entry["traffic"]["scenario"]["points"] = search.failures
    egos = [search.cell.ego, *search.references]
    suite: dict[str, Any] = {
        "suite": path.stem,
        "title": f"Failures of {search.cell.title}",
        "episodes": len(search.failures),
        "scene": document.data.get("scene", {}),
        "egos": [
            {
                "agent": each.agent.model_dump(mode="json", exclude_defaults=True),
                "label": each.title,
            }
            for each in egos
        ],
        "traffic_models": [entry],
        "columns": document.data.get("columns", []),
    }
    if "warm_up_s" in document.data:
        suite["warm_up_s"] = document.data["warm_up_s"]
    if search.references:
        suite["preventable_by"] = [each.title for each in search.references]
    moved = _moved(suite, document.folder, path.parent)
    text = yaml.safe_dump(moved, sort_keys=False, allow_unicode=True, width=100)
    write_bytes(path, text.encode())


def found_in(folder: Path) -> tuple[Mapping[str, float], ...]:
    """The failures in the suite that a search has written into its folder; empty without one.

    Raises:
        CharmsBenchError: The suite cannot be used.
    """
    path = folder / FOUND
    traffics = load_suite(path).traffics if path.exists() else ()
    scenarios = (entry.traffic.scenario for entry in traffics)
    points: Any = next((each.points for each in scenarios if each is not None), ())
    return tuple(points)


def _moved(value: Any, old: Path, new: Path) -> Any:
    """A value in which the paths of networks start at another folder."""
    if isinstance(value, dict):
        return {key: _moved(each, old, new) for key, each in value.items()}
    if isinstance(value, list):
        return [_moved(each, old, new) for each in value]
    if isinstance(value, str) and is_network(value):
        return os.path.relpath(old / value, new)
    return value

"""Imports point one way, and nothing heavy is imported where it does not belong."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from charms_bench.code import ROW_MODULES

HARNESS = Path("charms_bench")
PLUGINS = (Path("baselines/charms_baselines"), Path("agents/charms_agents"))
TRAINING = Path("agents/charms_agents/training")
ONLY_FOR_TRAINING = {"torch", "stable_baselines3", "onnx", "tensorboard"}
LAYERS = (
    {"errors", "compiled", "profile", "code", "files", "onnx_file"},
    {"scene", "workers", "lock"},
    {"agent", "traffic"},
    {"registry", "kinematics", "document", "engine", "metrics", "following"},
    {"observation"},
    {"onnx_policy"},
    {"suite", "stats", "simulation", "criticality", "divergence", "scaffold"},
    {"recording", "testing", "vector_env", "paired", "highway_reward"},
    {"results"},
    {"figures"},
    {"human", "metric_sets", "ego_env"},
    {"report"},
    {"runner"},
    {"verify", "bench", "replay", "comparison", "cluster"},
    {"happenings", "animation"},
    {"edge_cases"},
    {"html_report"},
    {"cli"},
    {"__main__"},
)


def modules(*folders: Path) -> list[Path]:
    return [path for folder in folders for path in sorted(folder.rglob("*.py"))]


def imported(path: Path) -> Iterator[tuple[str, str]]:
    """Every imported module, and the name imported from it if any."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield from ((str(node.module), alias.name) for alias in node.names)


@pytest.mark.parametrize("path", modules(HARNESS), ids=str)
def test_the_harness_imports_no_plugin_and_no_training_library(path: Path) -> None:
    roots = {module.split(".")[0] for module, _ in imported(path)}
    assert not roots & {"charms_baselines", "charms_agents", *ONLY_FOR_TRAINING}


@pytest.mark.parametrize("path", modules(*PLUGINS), ids=str)
def test_torch_is_imported_by_the_training_alone(path: Path) -> None:
    roots = {module.split(".")[0] for module, _ in imported(path)}
    assert path.is_relative_to(TRAINING) or not roots & ONLY_FOR_TRAINING


@pytest.mark.parametrize("path", modules(*PLUGINS), ids=str)
def test_plugins_import_public_names_only(path: Path) -> None:
    for module, name in imported(path):
        if module.split(".")[0] == "charms_bench":
            private = [part for part in (*module.split("."), name) if part.startswith("_")]
            assert not private, f"{path} imports {module}.{name}"


def layer_of(module: str) -> int:
    name = module.split(".")[1] if "." in module else ""
    return next((level for level, names in enumerate(LAYERS) if name in names), -1)


@pytest.mark.parametrize("path", modules(HARNESS), ids=str)
def test_imports_within_the_harness_point_one_way(path: Path) -> None:
    own = ".".join(path.with_suffix("").parts)
    for module, _ in imported(path):
        if module.startswith("charms_bench.") and path.name != "__init__.py":
            same_package = module.split(".")[1] == own.split(".")[1]
            assert same_package or layer_of(module) < layer_of(own), f"{own} imports {module}"


@pytest.mark.parametrize("path", modules(HARNESS), ids=str)
def test_every_module_of_the_harness_has_its_layer(path: Path) -> None:
    own = ".".join(path.with_suffix("").parts)
    assert own == "charms_bench.__init__" or layer_of(own) >= 0


def test_the_code_that_decides_rows_is_part_of_every_shards_key() -> None:
    seen: set[str] = set()
    unseen = {"recording", "simulation", "onnx_policy"}
    while unseen:
        name = unseen.pop()
        seen.add(name)
        for path in modules(HARNESS / name) or [HARNESS / f"{name}.py"]:
            parts = [module.split(".") for module, _ in imported(path)]
            unseen |= {rest[0] for root, *rest in parts if root == HARNESS.name and rest} - seen
    only_read_or_refuse = {"errors", "document", "registry", "files", "onnx_file"}
    assert seen - only_read_or_refuse == set(ROW_MODULES)


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, charms_bench.cli; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    heavy = {"numba", "polars", "onnxruntime", "numpy", "pydantic", "highway_env", "torch"}
    assert not heavy & set(loaded)

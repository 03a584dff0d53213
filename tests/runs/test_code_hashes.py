"""Keys of shards: they follow the code that decides rows, and nothing else."""

import ast
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from charms_bench.runs.code_hashes import (
    ROADS,
    SOURCES,
    harness_sha256,
    imported_modules,
    module_blobs,
    row_modules,
)

HARNESS = SOURCES / "charms_bench"
UNRELATED = ("report", "cli", "statistics", "metrics", "episodes", "people", "envs", "testing")
SIMULATES = """\
import sys
from collections.abc import Iterator
from pathlib import Path
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.runs import shard
from charms_bench.world.scene import SceneSettings
for name in ("stackelberg", "charms", "imitation"):
    agent, traffic = AgentSpec(name=name), TrafficSpec(name="pch")
    task = shard.ShardTask(
        title="a", scene=SceneSettings(duration_s=1.0), ego=agent,
        traffic=traffic, networks={}, first_seed=0, episodes=2,
        software=shard.installed(agent, traffic, {}),
    )
    shard.simulate(task)
print(*(name for name in sys.modules if name.partition(".")[0] == "charms_bench"))
"""


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the package."""
    folder = tmp_path_factory.mktemp("sources")
    shutil.copytree(HARNESS, folder / "charms_bench", ignore=shutil.ignore_patterns("__pycache__"))
    return folder


def hashed_with_a_change(sources: Path, path: Path, without: str | None = None) -> str:
    """The hash while a comment is appended to a file."""
    before = path.read_bytes()
    path.write_bytes(before + b"#\n")
    try:
        return harness_sha256.__wrapped__(sources, without=without)
    finally:
        path.write_bytes(before)


def test_modules_are_named_as_a_manifest_names_them() -> None:
    assert row_modules().keys() <= module_blobs().keys()


def test_changing_any_module_that_decides_rows_changes_the_key(copied: Path) -> None:
    unchanged = harness_sha256.__wrapped__(copied)
    assert unchanged == harness_sha256()
    paths = random.Random(0).sample([*row_modules(copied).values()], 12)
    hashes = {hashed_with_a_change(copied, path) for path in paths}
    assert len(hashes | {unchanged}) == 13


def test_a_change_of_the_roads_leaves_the_rows_of_the_straight_road(copied: Path) -> None:
    package = copied / "charms_bench"
    straight = harness_sha256.__wrapped__(copied, without=ROADS)
    assert straight != harness_sha256()
    assert hashed_with_a_change(copied, package / "roads" / "stepping.py", ROADS) == straight
    assert hashed_with_a_change(copied, package / "roads" / "merge.py") != harness_sha256()
    assert hashed_with_a_change(copied, package / "engine" / "stepping.py", ROADS) != straight


def test_changing_everything_that_only_presents_rows_does_not_change_the_key(copied: Path) -> None:
    harness = copied / "charms_bench"
    paths = [path for room in UNRELATED for path in (harness / room).rglob("*.py")]
    paths += [harness / "runs" / f"{name}.py" for name in ("suite", "folder", "document", "runner")]
    assert len(paths) > 50
    for path in paths:
        path.write_bytes(b"")
    assert harness_sha256.__wrapped__(copied) == harness_sha256()


def test_the_modules_that_decide_rows_are_those_of_a_simulation() -> None:
    names = set(row_modules())
    assert names >= {
        "charms_bench.engine.stepping",
        "charms_bench.engine.batched",
        "charms_bench.recording.recording",
        "charms_bench.plugins.onnx_policy",
        "charms_bench.runs.shard",
        "charms_bench.world.scene",
    }
    assert not {name for name in names if name.split(".")[1:2] and name.split(".")[1] in UNRELATED}
    assert not names & {f"charms_bench.runs.{name}" for name in ("suite", "folder", "document")}


def test_a_worker_imports_no_other_module_of_the_package() -> None:
    """With the project's plugins, whose own imports the key has to cover as well."""
    ran = subprocess.run([sys.executable, "-c", SIMULATES], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    assert set(ran.stdout.split()) <= set(row_modules(without=ROADS))


@pytest.mark.parametrize("name", row_modules())
def test_every_import_in_a_row_module_is_one_that_can_be_followed(name: str) -> None:
    lazy_names = set(__import__("charms_bench").__all__) - {"__version__"}
    for node in ast.walk(ast.parse(row_modules()[name].read_bytes())):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, "a relative import"
            if node.module == "charms_bench":
                assert not lazy_names & {alias.name for alias in node.names}, "a lazy public name"


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("import charms_bench.a, json", {"charms_bench.a", "json"}),
        ("def f():\n    from charms_bench.a import b", {"charms_bench.a", "charms_bench.a.b"}),
        ("if TYPE_CHECKING:\n    import charms_bench.a", set()),
        ("if TYPE_CHECKING:\n    x\nelse:\n    import charms_bench.b", {"charms_bench.b"}),
    ],
)  # fmt: skip
def test_imports_are_found_wherever_they_stand(source: str, expected: set[str]) -> None:
    assert set(imported_modules(source)) == expected


def found_by_python(node: ast.AST) -> Iterator[str]:
    """The dotted names of this package in the import statements of a whole module."""
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    if isinstance(node, ast.ImportFrom):
        yield from (str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names))
    for child in ast.iter_child_nodes(node):
        yield from found_by_python(child)


def test_no_import_of_the_package_is_overlooked() -> None:
    for path in HARNESS.rglob("*.py"):
        expected = {
            name
            for name in found_by_python(ast.parse(path.read_bytes()))
            if name.partition(".")[0] == HARNESS.name
        }
        assert expected <= set(imported_modules(path.read_text())), path

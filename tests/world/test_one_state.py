"""Where positions, headings and speeds of vehicles stand: in the scene, or for a reason."""

import ast
from collections.abc import Iterator
from pathlib import Path

import charms_bench

PACKAGE = Path(charms_bench.__file__).parent
HELD = {"x", "heading", "speed"}
REASONS = {
    "world/scene_arrays.py: SceneArrays": "the state of a scene",
    "world/scene.py: _PER_VEHICLE": "the types of its arrays",
    "roads/fault.py: MOMENT": "what vehicles did before a collision, for which fault is judged",
    "roads/scenes.py: VEHICLE": "the same as a table, whose columns are the arrays of a scene",
    "engine/state.py: SceneState": "a copy of the state that was saved",
    "engine/motion.py: Turning": "the vehicles that turn in a step, side by side",
    "engine/stepping.py: Put": "where a step ends for vehicles that follow a recording",
    "recording/primitives.py: VEHICLE": "the vehicles at a decision, of which rows are made",
    "recording/columns.py: STEP": "the rows of decisions",
    "runs/shard_rows.py: _WITHOUT_NULL": "which of their columns are always there",
    "episodes/replay.py: TRAJECTORY_SCHEMA": "the rows of a replay",
    "world/recorded_moments.py: Tracks": "recorded vehicles",
    "maps/commonroad_scene.py: Problem": "a vehicle that a file describes without a recording",
    "world/tracks.py: Bodies": "what a replay keeps of all moments, and what a picture shows",
    "testing/map_parity.py: vehicle": "highway-env's vehicle that is compared",
}


def records(file: Path) -> Iterator[str]:
    """The classes and tables of a module that have all that is `HELD`."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef):
            names = {
                each.target.id
                for each in node.body
                if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name)
            }
            if names >= HELD:
                yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(
            node.value, ast.Call | ast.Dict
        ):
            texts = (each.value for each in ast.walk(node.value) if isinstance(each, ast.Constant))
            words = {word for text in texts if isinstance(text, str) for word in text.split()}
            if words >= HELD:
                yield ast.unparse(
                    node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
                )


def test_no_other_record_holds_where_vehicles_are() -> None:
    found = {
        f"{file.relative_to(PACKAGE).as_posix()}: {name}"
        for file in PACKAGE.rglob("*.py")
        for name in records(file)
    }
    assert found == set(REASONS)

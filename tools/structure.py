"""Counts what the source tree is made of: `python tools/structure.py [--arrows]`.

Lines are those of all Python files, docstrings included. A room is a module or a package on the
first level of a package, and `tools`; `charms_agents.training` is a room of its own. An arrow leads
from a room to another that it imports anywhere in a file, inside functions too. It is upward if it
leads to a room that stands higher in the layers that `pyproject.toml` gives import-linter.
"""

import ast
import sys
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = {
    "charms_bench": ROOT / "charms_bench",
    "charms_agents": ROOT / "agents" / "charms_agents",
    "charms_baselines": ROOT / "baselines" / "charms_baselines",
    "tools": ROOT / "tools",
}
TRAINING = "charms_agents.training"


def modules() -> Iterator[tuple[str, Path]]:
    """Every module by its dotted name."""
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            parts = path.relative_to(folder).with_suffix("").parts
            yield ".".join([package, *(part for part in parts if part != "__init__")]), path


def imported(path: Path) -> Iterator[str]:
    """The dotted names that a module imports, those of objects included."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def room_of(name: str) -> str:
    """The room of a module or an object; empty for a package's own `__init__` and `__main__`."""
    package, _, rest = name.partition(".")
    if package not in PACKAGES:
        return ""
    if package != "charms_bench":
        return TRAINING if f"{name}.".startswith(f"{TRAINING}.") else package
    room = rest.partition(".")[0]
    folder = PACKAGES[package]
    is_room = (folder / room).is_dir() or (folder / f"{room}.py").is_file()
    return f"{package}.{room}" if room and room != "__main__" and is_room else ""


def arrows() -> set[tuple[str, str]]:
    """From which room to which."""
    found = {
        (room_of(name), room_of(target)) for name, path in modules() for target in imported(path)
    }
    return {(start, end) for start, end in found if start and end and start != end}


def layers() -> list[str]:
    """The rooms of the layers' contract, from the top down; none without one."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        tool = tomllib.load(file)["tool"]
    contracts = tool.get("importlinter", {}).get("contracts", [])
    found = next((each["layers"] for each in contracts if each["type"] == "layers"), [])
    return [room.strip("() ") for layer in found for room in layer.replace("|", ":").split(":")]


def main(list_arrows: bool) -> None:
    """Prints the counts."""
    every = list(modules())
    lines = dict.fromkeys(PACKAGES, 0)
    for name, path in every:
        lines[name.partition(".")[0]] += len(path.read_text(encoding="utf-8").splitlines())
    rooms = {room for name, _ in every if (room := room_of(name))}
    found, order = arrows(), layers()
    upward = [
        (start, end)
        for start, end in found
        if start in order and end in order and order.index(end) < order.index(start)
    ]
    try:
        TopologicalSorter(
            {room: {end for start, end in found if start == room} for room in rooms}
        ).prepare()
        circle = "none"
    except CycleError as error:
        circle = " -> ".join(error.args[1])
    counted = ", ".join(f"{package} {count:,}" for package, count in lines.items())
    print(f"lines: {sum(lines.values()):,} ({counted})")
    first = sum(room.startswith("charms_bench.") for room in rooms)
    print(f"rooms: {len(rooms)}, of which {first} on the first level of charms_bench")
    print(f"arrows between rooms: {len(found)}")
    print(f"upward arrows: {len(upward) if order else 'no layers are declared'}")
    print(f"circles: {circle}")
    if list_arrows:
        print(*(f"{start} -> {end}" for start, end in sorted(found)), sep="\n")


if __name__ == "__main__":
    main("--arrows" in sys.argv)

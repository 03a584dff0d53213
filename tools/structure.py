"""Counts what the source tree is made of: `python tools/structure.py [--arrows]`.

Lines are those of all Python files, docstrings included. A room is a module or a package on the
first level of `charms_bench`, or one of the other `ROOMS`. An arrow leads from a room to another
that it imports anywhere in a file, inside functions too. It is upward if it leads to a room that
stands higher in the layers that `pyproject.toml` gives import-linter, whose `grimp` reads imports.
"""

import re
import sys
import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp

ROOT = Path(__file__).parent.parent
PACKAGES = {"charms_bench": ".", "charms_agents": "agents", "charms_baselines": "baselines"}
PACKAGES |= {"tools": "."}
ROOMS = re.compile(
    r"charms_bench\.(?!__main__)\w+|charms_agents\.training\b|charms_agents|charms_baselines|tools"
)


def lines_of(package: str) -> int:
    files = (ROOT / PACKAGES[package] / package).rglob("*.py")
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)


def layers() -> list[str]:
    """The rooms of the layers' contract, from the top down; none without one."""
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
    contracts = tool.get("importlinter", {}).get("contracts", [])
    found = next((each["layers"] for each in contracts if each["type"] == "layers"), [])
    return re.findall(r"[\w.]+", " ".join(found))


def main(list_arrows: bool) -> None:
    """Prints the counts."""
    sys.path[:0] = [str(ROOT / folder) for folder in PACKAGES.values()]
    graph = grimp.build_graph(*PACKAGES, cache_dir=None)
    room_of = {name: found[0] for name in graph.modules if (found := ROOMS.match(name))}
    imports = {room: set[str]() for room in room_of.values()}
    for name, room in room_of.items():
        targets = graph.find_modules_directly_imported_by(name) & room_of.keys()
        imports[room] |= {room_of[target] for target in targets} - {room}
    arrows = sorted((start, end) for start, ends in imports.items() for end in ends)
    place = {room: index for index, room in enumerate(layers())}
    upward = [arrow for arrow in arrows if place.keys() >= set(arrow)]
    upward = [(start, end) for start, end in upward if place[end] < place[start]]
    try:
        TopologicalSorter(imports).prepare()
        circle = "none"
    except CycleError as error:
        circle = " -> ".join(error.args[1])
    lines = {package: lines_of(package) for package in PACKAGES}
    counted = ", ".join(f"{package} {count:,}" for package, count in lines.items())
    print(f"lines: {sum(lines.values()):,} ({counted})")
    first = sum(room.startswith("charms_bench.") for room in imports)
    print(f"rooms: {len(imports)}, of which {first} on the first level of charms_bench")
    print(f"arrows between rooms: {len(arrows)}")
    print(f"upward arrows: {len(upward) if place else 'no layers are declared'}")
    print(f"circles: {circle}")
    if list_arrows:
        print(*(f"{start} -> {end}" for start, end in arrows), sep="\n")


if __name__ == "__main__":
    main("--arrows" in sys.argv)

"""Copies of suites of the package, to edit."""

from pathlib import Path

from charms_bench.errors import InputError, suggestion
from charms_bench.runs.document import Document
from charms_bench.runs.packaged import packaged_suites


def copy_suite(name: str) -> Path:
    """Copies a packaged suite, with the road files that it names, to the current folder.

    Raises an `InputError` if there is no such suite, or a file is there already or cannot be
    written.
    """
    found = packaged_suites()
    if name not in found:
        raise InputError(f"no suite named '{name}'. {suggestion(name, found)}")
    roads = Document(found[name]).data.get("roads", ())
    files = [road["file"] for road in roads if isinstance(road, dict) and "file" in road]
    sources = {Path(each): found[name].parent / each for each in files}
    copied = Path(found[name].name)
    for path, source in {**sources, copied: found[name]}.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path == copied or not path.is_file() or path.read_bytes() != source.read_bytes():
                with path.open("xb") as file:
                    file.write(source.read_bytes())
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    return copied

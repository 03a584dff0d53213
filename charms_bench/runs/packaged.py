"""The suites that are installed with the package, which commands accept by name."""

import os
from pathlib import Path

from charms_bench.errors import SuiteError, suggestion

_PACKAGE = Path(__file__).parents[1]
_IN_WHEEL, _IN_CHECKOUT = _PACKAGE / "suites", _PACKAGE.parent / "suites"


def packaged_suites() -> dict[str, Path]:
    """Returns the file of each suite by its name, such as `ego` and `transfer/lanes-2`."""
    folder = _IN_WHEEL if _IN_WHEEL.exists() else _IN_CHECKOUT
    files = {path.relative_to(folder).with_suffix("") for path in folder.rglob("*.yaml")}
    found = {name.as_posix(): folder / f"{name}.yaml" for name in files}
    return dict(sorted(found.items(), key=lambda each: ("/" in each[0], each[0])))


def suite_file(path: Path) -> Path:
    """The file that a user means by a path or a packaged suite's name; raises a `SuiteError`."""
    packaged, name = packaged_suites(), path.as_posix()
    if name in packaged and os.path.isfile(path):
        raise SuiteError(
            f"{name}: is both a suite of charms-bench and a file in the current folder; rename "
            "the file, or give its full path"
        )
    if name in packaged:
        return packaged[name]
    if os.path.lexists(path):
        return path
    known = name.removeprefix("suites/").removesuffix(".yaml")
    if known in packaged:
        raise SuiteError(f"{path}: no such file; the suite of charms-bench is called '{known}'")
    if path.suffix in (".yaml", ".yml"):
        raise SuiteError(f"{path}: no such file")
    raise SuiteError(f"{path}: is neither a file nor a suite. {suggestion(name, packaged)}")

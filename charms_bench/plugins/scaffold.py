"""Creates the distribution of a new agent from templates, as a start for plugin authors."""

import re
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path
from string import Template

from charms_bench.errors import InputError
from charms_bench.plugins.registry import AGENTS, TRAFFIC, plugins

TEMPLATES = Path(__file__).with_name("templates")
_NAME = re.compile(r"[a-z](?:[a-z0-9_]{0,48}[a-z0-9])?")
_OF_PYTEST = ("tests", "conftest")
"""Names with a special meaning to pytest, which runs the new agent's tests."""


def new_agent(name: str, folder: Path) -> tuple[Path, ...]:
    """Writes the distribution of an agent that can drive into a new folder; returns its files.

    Raises:
        InputError: The name is invalid or taken, or the folder is not empty or cannot be written.
    """
    _check_name(name)
    words = {"name": name, "policy": "".join(map(str.capitalize, name.split("_"))) + "Policy"}
    files = {
        folder / "README.md": "README.md",
        folder / "pyproject.toml": "pyproject.toml",
        folder / f"{name}.py": "policy.py",
        folder / "suite.yaml": "suite.yaml",
        folder / "tests" / f"test_{name}.py": "test_policy.py",
    }
    try:
        if folder.exists() and any(folder.iterdir()):
            raise InputError(f"{folder}: is not empty; give another folder with --folder")
        (folder / "tests").mkdir(parents=True, exist_ok=True)
        for path, template in files.items():
            text = (TEMPLATES / f"{template}.tmpl").read_text(encoding="utf-8")
            path.write_text(Template(text).substitute(words), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from error
    return tuple(files)


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name) or iskeyword(name):
        raise InputError(
            f"'{name}' cannot be the name of a module; expected up to 50 lower-case letters, "
            "digits and underscores, starting with a letter and not ending with an underscore"
        )
    if name in _OF_PYTEST:
        raise InputError(f"'{name}' has a special meaning to pytest; choose another name")
    for group in (AGENTS, TRAFFIC):
        if taken := plugins(group).get(name):
            raise InputError(
                f"{taken.distribution} already has the {taken.role} '{name}'; choose another name"
            )
    module = find_spec(name)
    if module is not None and module.origin is not None:  # None: only a folder of that name
        raise InputError(
            f"a module named '{name}' already exists, {module.origin}; choose another name"
        )

"""The distribution of a new agent, from templates: what a plugin author starts from."""

import re
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path
from string import Template

from charms_bench.errors import InputError
from charms_bench.plugins.registry import AGENTS, TRAFFIC, plugins

TEMPLATES = Path(__file__).with_name("templates")
_NAME = re.compile(r"[a-z](?:[a-z0-9_]{0,48}[a-z0-9])?")
"""What can be an agent, a module and a distribution."""
_OF_PYTEST = ("tests", "conftest")
"""Files of which pytest, which runs the tests that come with an agent, thinks otherwise."""


def new_agent(name: str, folder: Path) -> tuple[Path, ...]:
    """Writes the distribution of an agent that drives at once; returns its files.

    Args:
        name: The agent's, its module's and its distribution's.
        folder: Where to; it is made, or is there and empty.

    Raises:
        InputError: The name is none or is taken, or the folder is not empty or cannot be written.
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
            raise InputError(f"{folder}: is not empty; give another with --folder")
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
            "digits and _, the first a letter and the last no _"
        )
    if name in _OF_PYTEST:
        raise InputError(f"'{name}' is something else to pytest; choose another name")
    for group in (AGENTS, TRAFFIC):
        if taken := plugins(group).get(name):
            raise InputError(
                f"there is the {taken.role} '{name}' already, of {taken.distribution}; choose "
                "another name"
            )
    module = find_spec(name)
    if module is not None and module.origin is not None:  # none: just a folder of that name
        raise InputError(
            f"there is a module '{name}' already, {module.origin}; choose another name"
        )

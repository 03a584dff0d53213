"""Creates the distribution of a new plugin from templates, as a start for its authors."""

import re
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path
from string import Template
from typing import Literal

from charms_bench.errors import InputError
from charms_bench.plugins.registry import AGENTS, TRAFFIC, plugins

TEMPLATES = Path(__file__).with_name("templates")
Kind = Literal["policy", "planner", "memory", "driver-model", "traffic"]
_CLASSES: dict[Kind, str] = {
    "policy": "Policy",
    "planner": "Planner",
    "memory": "Policy",
    "driver-model": "Model",
    "traffic": "Traffic",
}
_NAME = re.compile(r"[a-z](?:[a-z0-9_]{0,48}[a-z0-9])?")
_OF_PYTEST = ("tests", "conftest")
"""Names with a special meaning to pytest, which runs the new agent's tests."""


def new_agent(name: str, folder: Path, kind: Kind = "policy") -> tuple[Path, ...]:
    """Writes the distribution of a plugin that works into a new folder; returns its files.

    Raises an `InputError` if the name is invalid or taken, or the folder is not empty or cannot be
    written.
    """
    _check_name(name)
    is_traffic, title = kind == "traffic", "".join(map(str.capitalize, name.split("_")))
    words = {
        "name": name,
        "policy": title.removesuffix(_CLASSES[kind]) + _CLASSES[kind],
        "group": TRAFFIC if is_traffic else AGENTS,
        "make": "make_traffic" if is_traffic else "make_agent",
        "rules": "traffic_rules" if is_traffic else "agent_rules",
        "run": f"charms-bench traffic {name}" if is_traffic else f"charms-bench watch {name}",
    }
    files = {
        folder / "README.md": "README.md",
        folder / "pyproject.toml": "pyproject.toml",
        folder / f"{name}.py": f"{kind}.py",
        folder / "suite.yaml": "traffic.yaml" if is_traffic else "suite.yaml",
        folder / "tests" / f"test_{name}.py": (
            "test_policy.py" if kind == "policy" else "test_rules.py"
        ),
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
        close = name.lower().replace("-", "_")
        like = f", such as '{close}'" if _NAME.fullmatch(close) and not iskeyword(close) else ""
        raise InputError(
            f"'{name}' cannot be the name of a module; expected up to 50 lower-case letters, "
            "digits and underscores, starting with a letter and not ending with an underscore"
            f"{like}"
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

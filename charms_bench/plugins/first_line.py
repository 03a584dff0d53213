"""The first line of what a plugin says about itself, read from its source without importing it."""

import ast
import inspect
import warnings
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import EntryPoint
from importlib.util import find_spec, resolve_name

from charms_bench.errors import PLUGIN_ERRORS


def first_line(entry_point: EntryPoint) -> str:
    """The first line of the docstring of what an entry point names, empty without one.

    Classes and functions have a docstring, and a name that is assigned may have one below it. A
    name that a module imports from another one has the docstring there.
    """
    try:
        found = _first_line(entry_point.module, entry_point.attr)
    except PLUGIN_ERRORS:  # a broken plugin is listed without it
        return ""
    return "".join(filter(str.isprintable, found))


def _first_line(module: str, name: str) -> str:
    spec = _spec(module)
    source = spec.loader.get_source(module)  # type: ignore[union-attr]  # most loaders have it
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the plugin's syntax
        body = ast.parse(source).body
    for statement, below in zip(body, [*body[1:], None], strict=True):
        match statement, below:
            case (ast.ClassDef(name=found) | ast.FunctionDef(name=found), _) if found == name:
                return (ast.get_docstring(statement) or "").partition("\n")[0]
            case (
                ast.Assign(targets=[ast.Name(id=found)]),
                ast.Expr(value=ast.Constant(value=str(text))),
            ) if found == name:
                return inspect.cleandoc(text).partition("\n")[0]
            case ast.ImportFrom(module=origin, names=imported, level=level), _:
                for each in imported:
                    if (each.asname or each.name) == name:
                        package = module if spec.submodule_search_locations else spec.parent
                        absolute = resolve_name("." * level + (origin or ""), package)
                        return _first_line(absolute, each.name)
    return ""


def _spec(module: str) -> ModuleSpec:
    """Where a module is; `find_spec` alone would import the packages above it."""
    path, *inner = module.split(".")
    spec = find_spec(path)
    for name in inner:
        path = f"{path}.{name}"
        spec = None if spec is None else PathFinder.find_spec(path, spec.submodule_search_locations)
    if spec is None:
        raise ModuleNotFoundError(module)
    return spec

"""The page: templates filled, with scripts and styles inside; it loads nothing from outside."""

import hashlib
from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from markupsafe import Markup

from charms_bench import __version__
from charms_bench.errors import InputError
from charms_bench.foundation.files import reject_foreign
from charms_bench.report.figures.timelines import LEFT, RIGHT
from charms_bench.report.html.sections import Section
from charms_bench.report.html.table import TEMPLATES, definition_ids, environment
from charms_bench.report.table import Column
from charms_bench.world.palette import AGENTS, VEHICLES

SCRIPTS = ("tables.js", "player.js", "controls.js")


def check_page(path: Path) -> None:
    """Raises an `InputError` for a name that does not end in `.html`, or a page of others."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{path}: expected a name that ends in .html")
    reject_foreign(path, '<meta name="generator" content="charms-bench')


def render(
    sections: Sequence[Section],
    title: str,
    replays: Sequence[dict[str, Any]],
    *,
    beside: Mapping[str, Any] = MappingProxyType({}),
    named: int = 0,
    has_ghosts: bool = False,
    provenance: Sequence[dict[str, Any]] = (),
) -> str:
    """The page; names are text, whatever they look like.

    Replays are from `for_page`; the first `named` of them were asked for. The replays in `beside`,
    by name, are only for the player. A report has the provenance of each run; no other page has.
    """
    tables = [table for section in sections for table in (*section.tables, *section.more)]
    ids = definition_ids(column for table in tables for column in table.columns)
    definitions: dict[str, Column] = {}
    groups: dict[str, dict[str, None]] = {}
    for column, place in ids.items():
        definitions.setdefault(place, column)
        groups.setdefault(place, {})[column.group] = None
    scripts = [(TEMPLATES / name).read_text(encoding="utf-8") for name in SCRIPTS]
    digests = [b64encode(hashlib.sha256(each.encode()).digest()).decode() for each in scripts]
    hashes = " ".join(f"'sha256-{digest}'" for digest in digests)
    template = environment().get_template("page.html")
    return template.render(
        sections=sections,
        title=title,
        replays=replays,
        packed={each["id"]: each["packed"] for each in replays} | dict(beside),
        named=named,
        is_report=bool(provenance),
        has_ghosts=has_ghosts,
        provenance=provenance,
        version=__version__,
        cursor_from=LEFT,
        cursor_to=RIGHT,
        ids=ids,
        definitions=definitions,
        groups={place: ", ".join(filter(None, found)) for place, found in groups.items()},
        scripts=[Markup(script) for script in scripts],
        style=Markup(_tones() + (TEMPLATES / "page.css").read_text(encoding="utf-8")),
        # If a name ever got past the escaping, the browser would still run our scripts alone.
        policy=f"default-src 'none'; style-src 'unsafe-inline'; script-src {hashes}; "
        "base-uri 'none'; form-action 'none'",
    )


def _tones() -> str:
    """The palette as variables of the style sheet."""
    named = {**VEHICLES, **{f"agent-{k}": tones for k, tones in enumerate(AGENTS)}}
    lines = [f"  --{name}: light-dark({light}, {dark});" for name, (light, dark) in named.items()]
    return "\n".join([":root {", *lines, "}\n"])

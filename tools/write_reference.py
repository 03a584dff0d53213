"""Writes the generated parts of the pages from the code: `python tools/write_reference.py`.

They are the tables between `<!-- generated: NAME -->` and `<!-- end of generated -->`, so that the
pages can be read without building the site. With `--check`, it writes nothing and names the pages
that would change.
"""

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import typer
from model_tables import ROAD_KEYS, SUITE_KEYS, described, kind, meanings, sections, table
from pydantic import BaseModel
from typer.cli import get_docs_for_click

from charms_bench.cli import app
from charms_bench.cli.terminal import EXITS
from charms_bench.metrics import METRIC_SETS, ROADS, SCENARIOS, Metric
from charms_bench.recording.columns import COUNT, DRIVER, EPISODE, STEP
from charms_bench.world.profile import PROFILES, IdmMobilConstants, Profile

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"(<!-- generated: ([a-z-]+) -->\n\n).*?(<!-- end of generated -->)", re.DOTALL)
INTERVALS = {
    "bootstrap": "bootstrap",
    "proportion": "Wilson, effective n",
    "rate": "Poisson score, effective n",
    "wilson": "Wilson",
    "garwood": "Garwood",
}
"""What `Metric.interval` is called on the page on statistics."""


def profiles() -> str:
    """The fields of a profile, and their values in each profile of the package."""

    def rows(model: type[BaseModel], prefix: str) -> Iterator[tuple[str, ...]]:
        said, schema = meanings(model), model.model_json_schema()["properties"]
        for name in model.model_fields:
            if name in ("name", "idm_mobil"):
                continue
            owners = (each.idm_mobil if prefix else each for each in PROFILES.values())
            values = (getattr(owner, name) for owner in owners)
            shown = (
                "–" if value in (None, ()) else f"{value:g}" if isinstance(value, float) else
                str(value).lower() if isinstance(value, bool) else
                ", ".join(f"{each:g}" for each in value) if isinstance(value, tuple) else str(value)
                for value in values
            )  # fmt: skip
            yield (f"`{prefix}{name}`", kind(schema[name]), *shown, said.get(name, ""))

    header = ("key", "value", *(f"`{name}`" for name in PROFILES), "meaning")
    return table(header, [*rows(Profile, ""), *rows(IdmMobilConstants, "idm_mobil.")])


def metrics() -> str:
    header = ("metric", "unit", "what it is", "n", "interval")

    def row(each: Metric) -> tuple[str, ...]:
        known = each.unit or "proportion", each.description, each.rests_on
        return (f"`{each.name}`", *known, INTERVALS[each.interval])

    sets = (*METRIC_SETS, ROADS, SCENARIOS)
    return sections((each.label, table(header, map(row, each.metrics))) for each in sets)


def columns() -> str:
    kinds = {"steps": STEP, "episodes": EPISODE, "drivers": DRIVER, "counts": COUNT}
    rows = {
        name: [(f"`{key}`", str(each.dtype), each.unit, each.meaning) for key, each in kind.items()]
        for name, kind in kinds.items()
    }
    header = ("column", "type", "unit", "meaning")
    return sections((name, table(header, each)) for name, each in rows.items())


def exit_codes() -> str:
    return table(("exit code", "meaning"), ((str(code), said) for code, said in EXITS.items()))


def commands() -> str:
    command = typer.main.get_command(app)
    context = typer.Context(command, info_name="charms-bench")
    text = get_docs_for_click(obj=command, ctx=context, name="charms-bench").partition("\n")[2]
    groups: dict[str, str] = {}
    for name, each in command.commands.items():  # type: ignore[attr-defined]  # of a group
        line = f"* `{name}`: {(each.help or '').partition(chr(10))[0]}\n"
        groups[each.rich_help_panel] = groups.get(each.rich_help_panel, "") + line
    listed = "\n".join(f"**{title}**:\n\n{lines}" for title, lines in groups.items())
    text = re.sub(r"\*\*Commands\*\*:\n\n(\* .*\n)+", lambda _: listed, text)
    return text.strip().replace("```console", "```text") + "\n"


WRITERS: dict[str, Callable[[], str]] = {
    "suite-keys": lambda: described(
        SUITE_KEYS, (f"`{key}`" if " " not in key else key.capitalize() for key in SUITE_KEYS)
    ),
    "road-file": lambda: described(ROAD_KEYS, map(str.capitalize, ROAD_KEYS)),
    "profiles": profiles,
    "metrics": metrics,
    "columns": columns,
    "exit-codes": exit_codes,
    "commands": commands,
}


def filled(text: str) -> str:
    """A page with what the code says now in its generated parts."""
    return BLOCK.sub(lambda found: f"{found[1]}{WRITERS[found[2]]()}\n{found[3]}", text)


def main() -> None:
    stale = []
    for page in sorted((ROOT / "docs").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        if (new := filled(text)) != text:
            stale.append(str(page.relative_to(ROOT)))
            if "--check" not in sys.argv[1:]:
                page.write_text(new, encoding="utf-8")
    print("changed:", ", ".join(stale) or "nothing")
    sys.exit(bool(stale) and "--check" in sys.argv[1:])


if __name__ == "__main__":
    main()

"""`agents`, `traffic`, `check`: what is installed, whom it gives vehicles, what it breaks."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from charms_bench.cli.terminal import Json, app, out, plain
from charms_bench.errors import InputError


@app.command()
def agents(as_json: Json = False) -> None:
    """List the installed agents and traffics, without importing them."""
    from rich.table import Table

    from charms_bench.plugins.registry import AGENTS, TRAFFIC, plugins

    found = [*plugins(AGENTS).values(), *plugins(TRAFFIC).values()]
    if as_json:
        keys = ("name", "role", "version", "distribution")
        print(
            json.dumps([{key: getattr(plugin, key) for key in keys} for plugin in found], indent=2)
        )
        return
    table = Table("name", "role", "version", "distribution", box=None)
    for plugin in found:
        table.add_row(plugin.name, plugin.role, plugin.version, plugin.distribution)
    out.print(table)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def traffic(
    context: typer.Context,
    name: Annotated[str, typer.Argument(help="A traffic; its own options follow, as --tau 1.5.")],
    figure: Annotated[
        Path | None, typer.Option(help="Draw the shares into this .png, .pdf or .svg.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say which agents a traffic gives the vehicles to, and how often."""
    from rich.progress_bar import ProgressBar
    from rich.table import Table

    from charms_bench.plugins.registry import make_traffic
    from charms_bench.report.figures.drawing import check_figure
    from charms_bench.report.figures.shares import SAMPLED, draw, shares

    if figure is not None:
        check_figure(figure)
    options = _options(context.args)
    found = shares(make_traffic(name, options))
    if figure is not None:
        words = ", ".join(f"{key} {value}" for key, value in options.items())
        draw(found, f"{name} {words}".strip(), figure)
    if as_json:
        print(json.dumps({"traffic": name, "options": options, "shares": found}, indent=2))
        return
    table = Table("agent", box=None)
    table.add_column("share", justify="right")
    table.add_column("")
    largest = max(found.values())
    for agent, share in found.items():
        table.add_row(plain(agent), f"{share:.1%}", ProgressBar(largest, share, width=30))
    out.print(table)
    out.print(f"Counted among {SAMPLED:,} vehicles.", highlight=False)
    if figure is not None:
        out.print(f"Figure: {plain(str(figure))}", highlight=False, soft_wrap=True)


def _options(words: list[str]) -> dict[str, Any]:
    """What `--name value --other value` says, values as YAML reads them."""
    from charms_bench.runs.document import value_of

    options = {}
    pairs = [word for each in words for word in (each.split("=", 1) if "--" in each else [each])]
    if len(pairs) % 2 or any(not word.startswith("--") for word in pairs[::2]):
        raise InputError(f"expected options as --name value, got {' '.join(words)}")
    for option, value in zip(pairs[::2], pairs[1::2], strict=True):
        try:
            options[option.removeprefix("--").replace("-", "_")] = value_of(value)
        except ValueError as error:
            raise InputError(f"{option}: {value} cannot be read: {error}") from error
    return options


@app.command()
def check(
    name: Annotated[str, typer.Argument(help="An agent or a traffic.")], as_json: Json = False
) -> None:
    """Hold a plugin against the contract; exit code 1 when it breaks a rule."""
    from charms_bench.plugins.registry import AGENTS, TRAFFIC, make_agent, make_traffic, plugins
    from charms_bench.testing import agent_rules, traffic_rules

    is_traffic = name in plugins(TRAFFIC) and name not in plugins(AGENTS)
    rules = traffic_rules(make_traffic(name)) if is_traffic else agent_rules(make_agent(name))
    results = []
    for rule in rules:
        try:
            rule()
            problem = ""
        except Exception as error:  # whatever a plugin does wrong is a finding
            problem = str(error) if isinstance(error, AssertionError) else repr(error)
        title = rule.__name__.replace("_", " ")
        results.append({"rule": title, "kept": not problem, "problem": problem})
        if not as_json:
            mark = "[red]broken[/]" if problem else "[green]kept[/]  "
            out.print(f"{mark} {title}{': ' * bool(problem)}{plain(problem)}", highlight=False)
    if as_json:
        print(json.dumps(results, indent=2))
    if any(result["problem"] for result in results):
        raise typer.Exit(1)

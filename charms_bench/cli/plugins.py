"""`agents` and `check`: what is installed, and whether it keeps the contract."""

import json
from typing import Annotated

import typer

from charms_bench.cli.terminal import Json, app, out, plain


@app.command()
def agents(as_json: Json = False) -> None:
    """List the installed agents and traffics, without importing them."""
    from rich.table import Table

    from charms_bench.registry import AGENTS, TRAFFIC, plugins

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


@app.command()
def check(
    name: Annotated[str, typer.Argument(help="An agent or a traffic.")], as_json: Json = False
) -> None:
    """Hold a plugin against the contract; exit code 1 when it breaks a rule."""
    from charms_bench.registry import AGENTS, TRAFFIC, make_agent, make_traffic, plugins
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

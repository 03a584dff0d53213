"""`new-agent`: something to start from for plugin authors."""

from pathlib import Path
from typing import Annotated

import typer

from charms_bench.cli.terminal import app, out, plain


@app.command()
def new_agent(
    name: Annotated[str, typer.Argument(help="What suites will call it.")],
    folder: Annotated[
        Path | None, typer.Option(help="Where to write it; by default a new folder of that name.")
    ] = None,
) -> None:
    """Write a small distribution with a new agent, its tests and a suite."""
    from charms_bench.plugins.scaffold import new_agent as write

    folder = folder or Path(name)
    for path in write(name, folder):
        out.print(plain(str(path)), highlight=False, soft_wrap=True)
    steps = f"cd {folder} && pip install . pytest && pytest && charms-bench run suite.yaml"
    out.print(f"Next: {plain(steps)}", highlight=False, soft_wrap=True)

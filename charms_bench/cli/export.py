"""`export`: networks trained elsewhere."""

import json
from pathlib import Path
from typing import Annotated

import typer

from charms_bench.cli.terminal import Json, app, out, plain
from charms_bench.errors import InputError


@app.command()
def export(
    checkpoint: Annotated[
        Path, typer.Argument(help="A DQN's or a PPO's zip, as Stable-Baselines3 saves it.")
    ],
    output: Annotated[Path, typer.Argument(metavar="OUT.onnx", help="The file to write.")],
    decision_hz: Annotated[
        float, typer.Option(min=0.001, max=1000, help="Decisions a second it was trained for.")
    ] = 3.0,
    style: Annotated[str, typer.Option(help="How it drives, in words, for the file.")] = "",
    as_json: Json = False,
) -> None:
    """Turn a trained network into an ONNX file, which drives in a suite as {onnx: OUT.onnx}."""
    from charms_bench.registry import EXPORTERS, load

    if output.suffix != ".onnx":
        raise InputError(f"{output}: expected a name that ends in .onnx")
    facts = {"decision_hz": f"{decision_hz:g}"} | ({"style": style} if style else {})
    made = load(EXPORTERS, "sb3")(checkpoint, output, facts)
    if as_json:
        print(json.dumps(made, indent=2))
        return
    sizes = " → ".join(map(str, made["sizes"]))
    out.print(
        f"{plain(str(output))}: {sizes}, {made['activation']}; acts as {plain(str(checkpoint))} "
        f"in {made['observations']:,} observations",
        highlight=False,
        soft_wrap=True,
    )

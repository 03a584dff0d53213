"""`export`: networks trained elsewhere."""

import json
from pathlib import Path
from typing import Annotated

import typer

from charms_bench.cli.terminal import Json, app, out, plain
from charms_bench.errors import InputError

DECISION_HZ = {"neighbours": 3.0, "Kinematics": 1.0}
"""What networks trained on an observation usually decide at: here, and in highway-env."""


@app.command()
def export(
    checkpoint: Annotated[
        Path, typer.Argument(help="A DQN's or a PPO's zip, as Stable-Baselines3 saves it.")
    ],
    output: Annotated[Path, typer.Argument(metavar="OUT.onnx", help="The file to write.")],
    observation: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="What it was trained on: neighbours, or highway-env's Kinematics, with options "
            "'{type: Kinematics, vehicles_count: 7}'.",
        ),
    ] = "neighbours",
    decision_hz: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            max=1000,
            help="Decisions a second it was trained for; by default 3, or highway-env's 1 with "
            "Kinematics.",
        ),
    ] = None,
    style: Annotated[str, typer.Option(help="How it drives, in words, for the file.")] = "",
    as_json: Json = False,
) -> None:
    """Turn a trained network into an ONNX file, which drives in a suite as {onnx: OUT.onnx}."""
    import yaml

    from charms_bench.plugins.registry import EXPORTERS, load
    from charms_bench.world.observations import named_observation

    if output.suffix != ".onnx":
        raise InputError(f"{output}: expected a name that ends in .onnx")
    try:
        seen = named_observation(yaml.safe_load(observation))
    except yaml.YAMLError as error:
        raise InputError(f"--observation {observation}: is not YAML") from error
    hz = decision_hz or DECISION_HZ[seen.name]
    facts = {"decision_hz": f"{hz:g}"} | ({"style": style} if style else {})
    made = load(EXPORTERS, "sb3")(checkpoint, output, facts, seen)
    made |= {"observation": seen.name, "decision_hz": hz}
    if as_json:
        print(json.dumps(made, indent=2))
        return
    sizes = " → ".join(map(str, made["sizes"]))
    out.print(
        f"{plain(str(output))}: {sizes}, {made['activation']}; acts as {plain(str(checkpoint))} "
        f"in {made['observations']:,} observations; sees {seen.name}, decides at {hz:g} Hz",
        highlight=False,
        soft_wrap=True,
    )

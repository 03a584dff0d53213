"""`data`: recordings of human driving."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charms_bench.cli.terminal import Json, app, out, plain, progress

if TYPE_CHECKING:
    from charms_bench.people.survey import Learnable


@app.command()
def data(
    folder: Annotated[Path, typer.Argument(help="Recordings in highD's format.")],
    figure: Annotated[
        Path | None, typer.Option(help="Draw them into this .png, .pdf or .svg.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Say what recordings of human driving hold, and what can be learnt from them."""
    from charms_bench.people.highd import find_trios
    from charms_bench.people.survey import survey
    from charms_bench.plugins.registry import SAMPLERS, load, plugins
    from charms_bench.report.figures.drawing import check_figure
    from charms_bench.report.figures.recordings import draw

    if figure is not None:
        check_figure(figure)
    samplers = {name: load(SAMPLERS, name)() for name in plugins(SAMPLERS)}
    with progress("recordings", len(find_trios(folder))) as bar:
        found, learnable = survey(folder, samplers, lambda count: bar("", count))
    if figure is not None:
        draw(found, learnable, figure)
    facts = found.facts()
    if as_json:
        samples = {name: asdict(each) for name, each in learnable.items()}
        print(json.dumps({**facts, "samplers": samples}, indent=2))
        return
    _print_facts(facts)
    for name, each in learnable.items():
        _print_learnable(name, each)
    if figure is not None:
        out.print(f"Figure: {plain(str(figure))}", highlight=False, soft_wrap=True)


def _print_facts(found: dict[str, Any]) -> None:
    def quantiles(values: dict[str, float | None]) -> str:
        return ", ".join(
            f"{float(q):.0%} {value:.1f}" for q, value in values.items() if value is not None
        )

    rates = ", ".join(f"{rate:g}" for rate in found["frame_rates_hz"])
    facts = {
        "recordings": f"{found['recordings']:,} at {rates} Hz, {found['recorded_h']:.2f} h",
        "vehicles": f"{found['cars']:,} cars, {found['trucks']:,} trucks, {found['rows']:,} rows",
        "carriageways": ", ".join(
            f"{n} with {lanes} lanes" for lanes, n in found["carriageways"].items()
        ),
        "lane changes": f"{found['lane_changes']:,}",
        "laneId against y": f"{found['lane_id_disagreements']:,} rows disagree",
        "speed, m/s": f"mean {found['speed_mean_mps']:.1f}; "
        + quantiles(found["speed_quantiles_mps"]),
        "lane offset, m": f"mean {found['offset_mean_m']:+.2f} to the right of the lane's centre",
        "following, m": quantiles(found["following_distance_m"]) or "no vehicle follows another",
        "decisions": f"{found['decisions']:,}",
    }
    _print_pairs(facts)


def _print_learnable(name: str, found: "Learnable") -> None:
    from rich.table import Table

    out.print(f"\n{plain(name)}: what can be learnt", style="bold", highlight=False)
    samples = f"{found.training:,} for training, {found.held_out:,} held out"
    two_actions = f"{found.two_actions:.1%} of the accepted decisions"
    _print_pairs(
        {"accepted": f"{found.accepted:,}", "two actions": two_actions, "samples": samples}
    )
    table = Table("label", box=None)
    for title in found.label_shares:
        table.add_column(plain(title), justify="right")
    for action in next(iter(found.label_shares.values()), {}):
        shares = (labels[action] for labels in found.label_shares.values())
        table.add_row(action, *(f"{share:.1%}" for share in shares))
    out.print(table)
    table = Table("rejected because", box=None)
    table.add_column("decisions", justify="right")
    for reason, count in found.rejected.items():
        if count:
            table.add_row(plain(reason), f"{count:,}")
    out.print(table)


def _print_pairs(facts: Mapping[str, str]) -> None:
    from rich.table import Table

    table = Table(box=None, show_header=False)
    for fact, value in facts.items():
        table.add_row(fact, value)
    out.print(table)

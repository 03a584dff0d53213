"""`data`: recordings of human driving."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from charms_bench.cli.terminal import Json, app, out, plain, progress


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
    from charms_bench.people.samples import collect
    from charms_bench.people.survey import survey
    from charms_bench.report.figures import check_figure
    from charms_bench.report.recordings import draw

    if figure is not None:
        check_figure(figure)
    with progress("recordings", len(find_trios(folder))) as bar:
        collected = collect(folder, tell=lambda count: bar("", count))
    found = survey(collected)
    if figure is not None:
        draw(collected, figure)
    if as_json:
        print(json.dumps(found, indent=2))
        return
    _print_survey(found)
    if figure is not None:
        out.print(f"Figure: {plain(str(figure))}", highlight=False, soft_wrap=True)


def _print_survey(found: dict[str, Any]) -> None:
    from rich.table import Table

    def quantiles(values: dict[str, float | None]) -> str:
        return ", ".join(
            f"{float(q):.0%} {value:.1f}" for q, value in values.items() if value is not None
        )

    rates = ", ".join(f"{rate:g}" for rate in found["frame_rates_hz"])
    lanes = ", ".join(f"{n} with {lanes} lanes" for lanes, n in found["carriageways"].items())
    sampled = found["sampled"]
    facts = {
        "recordings": f"{found['recordings']:,} at {rates} Hz, {found['recorded_h']:.2f} h",
        "vehicles": f"{found['cars']:,} cars, {found['trucks']:,} trucks, {found['rows']:,} rows",
        "carriageways": lanes,
        "lane changes": f"{found['lane_changes']:,}",
        "laneId against y": f"{found['lane_id_disagreements']:,} rows disagree",
        "speed, m/s": f"mean {found['speed_mean_mps']:.1f}; "
        + quantiles(found["speed_quantiles_mps"]),
        "lane offset, m": f"mean {found['offset_mean_m']:+.2f} to the right of the lane's centre",
        "following, m": quantiles(found["following_distance_m"]) or "nobody follows",
        "decisions": f"{found['decisions']:,}, of which {found['accepted']:,} are of use",
        "two intents": f"{found['two_intents']:.1%} of them",
        "samples": f"{sampled['training']:,} for training, {sampled['held_out']:,} held out",
    }
    table = Table(box=None, show_header=False)
    for fact, value in facts.items():
        table.add_row(fact, value)
    out.print(table)
    table = Table("label", box=None)
    table.add_column("all rows", justify="right")
    table.add_column("IDLE undersampled", justify="right")
    for action, share in found["label_shares"]["accepted"].items():
        table.add_row(action, f"{share:.1%}", f"{found['label_shares']['sampled'][action]:.1%}")
    out.print(table)
    table = Table("rejected because", box=None)
    table.add_column("rows", justify="right")
    for reason, count in found["rejected"].items():
        if count:
            table.add_row(reason, f"{count:,}")
    out.print(table)

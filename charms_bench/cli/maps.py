"""`road`: what is in a road map; `drive`: traffic on it."""

import json
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

import charms_bench
from charms_bench.cli import arguments
from charms_bench.cli.terminal import app, end_with_json, print_facts, say, shown
from charms_bench.errors import InputError
from charms_bench.foundation.files import absolute
from charms_bench.foundation.words import counted

MOST_GAPS = MOST_ROADS = 10
"""The gaps and the roads that are listed one by one; `--json` has all."""


@app.command(rich_help_panel=arguments.ROADS)
def road(
    file: Annotated[
        Path,
        Argument(
            metavar="FILE",
            help="OpenDRIVE file, SUMO network, CommonRoad scenario, or road file of charms-bench.",
        ),
    ],
    to: Annotated[
        Path | None,
        Option(callback=arguments.NEW_JSON, help="New file NAME.json for the roads, a road file."),
    ] = None,
    figure: arguments.FigurePath = None,
    around: Annotated[
        tuple[float, float] | None,
        Option(
            metavar="X Y",
            help="Keep only roads that come within --radius of this point of the map, m.",
        ),
    ] = None,
    radius: Annotated[
        float | None, Option(min=0.0, help="How far roads may be from --around, m.")
    ] = None,
    as_json: arguments.Json = False,
) -> None:
    """Describe a road map, and write it as a road file."""
    if (around is None) != (radius is None):
        raise InputError("--around and --radius belong together; expected both or neither")
    found = charms_bench.read_road(absolute(file), around=around, radius=radius)
    if to is not None:
        charms_bench.write_road(found, to)
    if figure is not None:
        from charms_bench.report.figures.drawing import save
        from charms_bench.report.figures.road_map import draw

        save(draw(found), figure)
    from charms_bench.maps.joining import joined  # both are slow to import
    from charms_bench.roads.recorded_scenes import facts_of

    named = [[each.start, each.end] for each in joined(found).roads if not each.junction]
    facts = {**found.facts(), "named_roads": named, "recorded": facts_of(absolute(file))}
    if as_json:
        end_with_json(facts)
    print_facts(_in_words(facts))
    gaps = facts["gaps"]
    for gap in gaps[:MOST_GAPS]:
        one, other = gap["lanes"]
        say(f"Gap of {gap['length_m']:.2f} m between lanes {one} and {other}, bridged")
    if len(gaps) > MOST_GAPS:
        say(f"and {len(gaps) - MOST_GAPS:,} more gaps")
    if back := facts["lanes_that_turn_back"]:
        more = f", and {len(back) - MOST_GAPS:,} more" if len(back) > MOST_GAPS else ""
        say(f"Lanes with a kink of more than 90 degrees: {', '.join(back[:MOST_GAPS])}{more}")
    if named:
        listed = ", ".join(json.dumps(each, ensure_ascii=False) for each in named[:MOST_ROADS])
        more = f", and {len(named) - MOST_ROADS:,} more" if len(named) > MOST_ROADS else ""
        say(f"Roads outside of junctions, by their nodes, for scenarios: {listed}{more}")
    for path in filter(None, (to, figure)):
        say(f"Written: {shown(path)}")


@app.command(rich_help_panel=arguments.ROADS)
def drive(
    file: Annotated[Path, Argument(metavar="FILE", help="Road file or map, as for `road`.")],
    vehicles: Annotated[int, Option(min=2, help="How many vehicles drive.")] = 100,
    hours: Annotated[float, Option(min=0.001, max=1000.0, help="For how long.")] = 1.0,
    seed: Annotated[int, Option(min=0, help="Decides where vehicles start and where they go.")] = 0,
    as_json: arguments.Json = False,
) -> None:
    """Let traffic drive on a road for hours, and count what goes wrong."""
    from charms_bench.roads.long_drive import long_drive  # slow to import

    found = long_drive(absolute(file), vehicles, hours, seed)
    facts = {**vars(found), "crashes_per_1000_km": found.crashes_per_1000_km}
    if as_json:
        end_with_json(facts)
    kinds = "; ".join(f"{count} {kind}" for kind, count in found.crashes.items())
    facts = {
        "driven": f"{found.km:,.1f} km in {found.hours:g} h by {found.vehicles} vehicles",
        "collisions": f"{sum(found.crashes.values())} ({kinds or 'none'})",
        "collisions in 1,000 km": f"{found.crashes_per_1000_km:.1f}",
        "left the road": counted(found.off_road, "time"),
        "stood for too long and were taken out": counted(found.freed, "vehicle"),
        "left at an end of the road": counted(found.left, "vehicle"),
        "time at standstill": f"{100 * found.stationary:.1f} %",
    }
    print_facts(facts)


def _in_words(facts: dict[str, Any]) -> dict[str, str]:
    """The facts of a map in words, by what they are about."""
    limits = ", ".join(f"{limit:.1f}" for limit in facts["speed_limits_mps"][:8])
    if len(facts["speed_limits_mps"]) > 8:
        limits += f", ... {facts['speed_limits_mps'][-1]:.1f}"
    unstated = facts["lanes_without_speed_limit"]
    conflicts = facts["crossing_conflicts"] + facts["merging_conflicts"]
    out = "; ".join(f"{count:,} {reason}" for reason, count in facts["left_out"].items())
    (x, right), (y, top) = facts["x_m"], facts["y_m"]
    recorded = facts["recorded"]
    return {
        "format": facts["format"] or "road file",
        "traffic": f"on the {'left' if facts['left_hand_traffic'] else 'right'}",
        "lanes": f"{facts['lanes']:,}, {facts['lane_km']:z.2f} lane-km",
        "roads": f"{facts['roads']:,} between {facts['nodes']:,} nodes",
        "junctions": f"{facts['junctions']:,}",
        "starts and ends": f"no lane leads to {counted(facts['starts'], 'lane')}, and none follows "
        f"{counted(facts['ends'], 'lane')}",
        "speed limits, m/s": "; ".join(
            filter(None, (limits, f"none stated for {unstated:,} lanes" if unstated else ""))
        ),
        "lane widths, m": "{:.2f} to {:.2f}".format(*facts["width_m"]),
        "conflicts": f"{facts['crossing_conflicts']:,} crossing and {facts['merging_conflicts']:,} "
        f"merging; right of way is known for {facts['conflicts_with_right_of_way']:,} of "
        f"{conflicts:,}",
        "lights and signs": f"{facts['lights']:,} and {facts['signs']:,}",
        "gaps bridged": f"{len(facts['gaps']):,}",
        "extent, m": f"x {x:.1f} to {right:.1f}, y {y:.1f} to {top:.1f}",
        "left out": out or "nothing",
        **({} if recorded is None else {"recorded vehicles": _recorded_in_words(recorded)}),
    }


def _recorded_in_words(facts: dict[str, Any]) -> str:
    """What is recorded on the road of a file."""
    beside = facts["states_beside_lanes"]
    listed = ", ".join(f"{name} ({count})" for name, count in beside.items())
    return (
        f"{facts['vehicles']:,} in {facts['duration_s']:g} s at {facts['rate_hz']:g} Hz; "
        f"{100 * facts['in_lane']:.1f} % of {facts['states']:,} states are in a lane"
        + f", and not those of {listed}" * bool(beside)
        + f"; {counted(facts['planning_problems'], 'planning problem')}"
        + "".join(f"; left out: {count} {reason}" for reason, count in facts["left_out"].items())
    )

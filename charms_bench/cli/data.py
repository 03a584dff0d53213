"""`data` and `dataset`: recordings of human driving, and episodes for other tools."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, Option

import charms_bench
from charms_bench.cli import arguments
from charms_bench.cli.terminal import (
    app,
    end_with_json,
    err,
    interruptible,
    print_facts,
    print_records,
    print_table,
    say,
    shown,
)
from charms_bench.errors import InputError
from charms_bench.foundation.files import absolute, write_bytes
from charms_bench.foundation.words import counted


@app.command(rich_help_panel=arguments.DATA)
def data(
    recordings: arguments.Recordings,
    figure: arguments.FigurePath = None,
    as_json: arguments.Json = False,
) -> None:
    """Summarise recordings of human driving."""
    from charms_bench.foundation.progress import progress
    from charms_bench.humans.survey import OFF_CENTRE_M, survey
    from charms_bench.plugins.registry import SAMPLERS, load, plugins
    from charms_bench.report.figures.drawing import save
    from charms_bench.report.figures.recordings import draw
    from charms_bench.world.recording_folder import find_trios

    folder = absolute(recordings)
    if folder.suffix == ".parquet":
        if figure is not None:
            raise InputError(f"{folder}: is a table of trips; --figure is for other recordings")
        _print_trips(folder, as_json)
        return
    samplers = {name: load(SAMPLERS, name)() for name in plugins(SAMPLERS)}
    with progress("recordings", len(find_trios(folder))) as tell:
        notes: list[str] = []
        found, learnable = survey(folder, samplers, lambda count: tell("", count), notes.append)
    if figure is not None:
        save(draw(found, learnable), figure)
    facts = found.facts()
    if as_json:
        samplers = {name: asdict(each) for name, each in learnable.items()}
        end_with_json({**facts, "samplers": samplers})
    print_facts(_facts(facts))
    if abs(facts["offset_mean_m"] or 0.0) > OFF_CENTRE_M:
        side = "right" if facts["offset_mean_m"] > 0 else "left"
        say(
            f"\nwarning: drivers are {abs(facts['offset_mean_m']):z.2f} m to the {side} of their "
            f"lanes' centres on average, which people are not; correct the lane markings, "
            f"or drifts and lane changes are labelled wrongly",
            err(),
        )
    for name, each in learnable.items():
        _print_learnable(name, each)
    for reason in notes:
        say(f"\n{reason}")
    if figure is not None:
        say(f"Figure: {shown(figure)}")


def _print_trips(path: Path, as_json: bool) -> None:
    """What `calibrate` reads in a table."""
    import numpy as np

    from charms_bench.humans.trips import RATE_HZ, read_trips
    from charms_bench.world.gaps import time_headway

    trips = read_trips(path)
    gap, speed = (np.concatenate([getattr(each, n) for each in trips]) for n in ("gap", "speed"))
    facts: dict[str, Any] = {
        "drivers": len({trip.driver for trip in trips}),
        "trips": len(trips),
        "following_h": gap.size / RATE_HZ / 3600,
        "speed_mean_mps": float(speed.mean()),
        "gap_mean_m": float(gap.mean()),
        "time_gap_mean_s": float(time_headway(gap, speed).mean()),
    }
    if as_json:
        end_with_json(facts)
    forms = dict.fromkeys(("drivers", "trips"), ",")
    forms |= dict.fromkeys(("speed_mean_mps", "gap_mean_m"), "z.1f")
    print_facts(
        {name.replace("_", " "): f"{n:{forms.get(name, 'z.2f')}}" for name, n in facts.items()}
    )


def _facts(found: dict[str, Any]) -> dict[str, str]:
    """The facts of a survey in words, by what they are about."""

    def quantiles(values: dict[str, float | None]) -> str:
        return ", ".join(
            f"{float(q):z.0%} {value:z.1f}" for q, value in values.items() if value is not None
        )

    rates = ", ".join(f"{rate:g}" for rate in found["frame_rates_hz"])
    lanes = ", ".join(
        f"{n} with {counted(int(lanes), 'lane')}" for lanes, n in found["carriageways"].items()
    )
    speeds = quantiles(found["speed_quantiles_mps"])
    return {
        "recordings": f"{found['recordings']:,} at {rates} Hz, {found['recorded_h']:z.2f} h",
        "vehicles": ", ".join(counted(found[f"{each}s"], each) for each in ("car", "truck", "row")),
        "carriageways": lanes,
        "lane changes": f"{found['lane_changes']:,}",
        "laneId against y": f"{found['lane_id_disagreements']:,} rows disagree",
        "speed, m/s": f"mean {found['speed_mean_mps']:z.1f}; {speeds}",
        "lane offset, m": f"mean {found['offset_mean_m']:+z.2f} to the right of the lane's centre",
        "following, m": quantiles(found["following_distance_m"]) or "no vehicle follows another",
        "decisions": f"{found['decisions']:,}",
    }


def _print_learnable(name: str, found: Any) -> None:
    say(
        f"\n{name}: {found.accepted:,} decisions are accepted, {found.two_actions:z.1%} of them "
        f"with two actions; {found.training:,} samples for training, {found.held_out:,} held out"
    )
    proportions = [
        {"label": action} | {title: each[action] for title, each in found.label_shares.items()}
        for action in next(iter(found.label_shares.values()), {})
    ]
    print_records("label", proportions, dict.fromkeys(found.label_shares, ".1%"))
    reason = "rejected because"
    rejected = [{reason: each, "decisions": n} for each, n in found.rejected.items() if n]
    print_records(reason, rejected, {"decisions": ",.0f"})


@app.command(rich_help_panel=arguments.DATA)
def calibrate(
    recordings: arguments.Recordings,
    to: Path | None = Option(
        None,
        callback=arguments.NEW_JSON,
        help="New file NAME.json for the population, from which the agent human draws drivers.",
    ),
    figure: arguments.FigurePath = None,
    as_json: arguments.Json = False,
) -> None:
    """Fit drivers to recordings, and predict held-out drivers."""
    from charms_bench.foundation.progress import note
    from charms_bench.humans.calibrated import calibrate as calibrated
    from charms_bench.humans.held_out import HORIZONS_S
    from charms_bench.humans.lane_choices import FEWEST_CHANGES, fit_choices, read_choices
    from charms_bench.humans.trips import read_trips
    from charms_bench.report.figures.drawing import save
    from charms_bench.report.figures.predictive import draw

    recordings = absolute(recordings)
    with interruptible():
        found = calibrated(read_trips(recordings), note)
        choices = read_choices(recordings, found.fit.point, found.held_out_drivers)
    name, origin = (to or recordings).stem, f"recordings in {recordings.name}"
    changes = fit_choices(choices)
    population = found.population(name, origin, "the terms of the recordings", changes)
    if to is not None:
        write_bytes(to, population.to_json().encode())
    if figure is not None:
        save(draw(found), figure)
    if as_json:
        end_with_json({"population": population.model_dump(), "held_out": found.records()})
    forms = dict.fromkeys(("median", "spread", "identified"), "")
    print_records("parameter", found.parameters(), forms)
    if changes is None:
        made = counted(int(choices.changed.sum()), "lane change")
        lane_changes = f"{made}, too few to fit: {FEWEST_CHANGES} are needed"
    else:
        lane_changes = f"fitted to {counted(changes.changes, 'lane change')}"
    say(
        f"Model {population.model}, lag {population.lag_s:g} s, noise {population.noise_mps2:z.2f} "
        f"m/s2 over {population.noise_s:z.1f} s; {population.drivers_at_bound} of "
        f"{population.drivers} drivers end at a bound if fitted alone; {lane_changes}"
    )
    forms = {name: "" for name in found.records()[0] if name != "predicted by"}
    print_records("predicted by", found.records(), forms)
    value, low, high = found.gap_ratio
    say(
        "Ratios; below 1, the fitted population is better:\n"
        "Gap error, to that of the better uncalibrated IDM: "
        f"{value:z.2f} [{low:z.2f}, {high:z.2f}]"
    )
    for horizon_s, (value, low, high) in zip(HORIZONS_S, found.energy_ratios, strict=True):
        say(
            f"Energy score after {horizon_s} s, to that of the pooled point: {value:z.2f} "
            f"[{low:z.2f}, {high:z.2f}]"
        )
    for path in filter(None, (to, figure)):
        say(f"Written: {shown(path)}")


@app.command(rich_help_panel=arguments.DATA)
def likeness(
    suite: Annotated[Path, Argument(metavar="SUITE", help="YAML file of the suite.")],
    recordings: Annotated[
        Path,
        Argument(
            metavar="RECORDINGS",
            help="Folder of recordings in highD's format, CSV table of NGSIM, the Parquet table of "
            "I-24 or I-75, or a folder of CommonRoad scenarios.",
        ),
    ],
    population: str | None = Option(
        None,
        help="Population that was fitted to these recordings: i24, i75, or a JSON file of "
        "`charms-bench calibrate`. Not for CommonRoad scenarios.",
    ),
    half: Literal["both", "selection", "test"] = Option(
        "both",
        help="Compare with the first, third, ... of the held-out drivers (selection), or with "
        "the others (test), to select an agent by some drivers and report it on others.",
    ),
    controls: bool = Option(
        False,
        "--controls",
        help="Also score drivers with known faults, such as copied accelerations, to see what "
        "the score tells apart on these recordings.",
    ),
    figure: arguments.FigurePath = None,
    as_json: arguments.Json = False,
) -> None:
    """Score how much egos and traffic drive like recorded drivers."""
    from charms_bench.foundation.progress import note
    from charms_bench.humans.in_scenes import scenes_in
    from charms_bench.humans.population import read_population
    from charms_bench.report.figures.drawing import save
    from charms_bench.report.figures.likeness import draw
    from charms_bench.report.likeness_table import basis_of, likeness_tables
    from charms_bench.runs import likeness as scoring
    from charms_bench.runs.suite import load_suite

    read, files, basis = load_suite(suite), scenes_in(absolute(recordings)), ""
    rows, of_controls = [], []
    if files and (population or controls or half != "both"):
        raise InputError("CommonRoad scenarios: give no --population, --half or --controls")
    with interruptible():
        if files:
            found = scoring.drive_scenes(read, files, note)
            rows, basis = [*scoring.likeness_in_scenes(found)], basis_of(found)
        elif population is None:
            raise InputError(
                f"{recordings}: no CommonRoad scenario is there, and other recordings need "
                "--population: i24, i75 or a file of `calibrate`"
            )
        else:
            fitted = read_population(population)
            against = scoring.standard(read, absolute(recordings), fitted, half)
            for each in scoring.likeness(read, against):
                note(f"{each.kind} {each.label}")
                rows.append(each)
            if controls:
                note("controls")
                of_controls = list(scoring.likeness_of_controls(read, against))
    if figure is not None:
        save(draw(rows), figure)
    if as_json:
        end_with_json([asdict(each) for each in (*rows, *of_controls)])
    for table in likeness_tables(rows, of_controls):
        print_table(table)
    if basis:
        say(basis)
    if figure is not None:
        say(f"Figure: {shown(figure)}")


@app.command(rich_help_panel=arguments.DATA)
def dataset(
    run: arguments.RunPath,
    kind: Literal["minari", "highd", "parquet"] = Option(
        ...,
        "--format",
        help="minari: observations, actions and rewards of the ego. highd: trajectories of all "
        "vehicles in highD's format. parquet: their states at every simulation step.",
    ),
    ego: arguments.EgoLabel = None,
    road: arguments.RoadLabel = None,
    traffic: arguments.TrafficLabel = None,
    episodes: int | None = Option(
        None, min=1, help="Number of episodes, from the first; the default is all."
    ),
    output: Path | None = Option(None, help="New folder; the default is one in the run folder."),
    suite_folder: arguments.SuiteFolder = Path(),
    as_json: arguments.Json = False,
) -> None:
    """Write the episodes of a run as a dataset for other tools."""
    opened = charms_bench.open_run(run, suite_folder)
    with interruptible():
        path = opened.dataset(kind, output, ego=ego, traffic=traffic, road=road, episodes=episodes)
    written = episodes or opened.suite.episodes
    if as_json:
        end_with_json({"format": kind, "episodes": written, "folder": str(path)})
    say(f"{counted(written, 'episode')}: {path}")
    if kind == "minari":
        say(f"minari.load_dataset('{path.name}') loads it if MINARI_DATASETS_PATH={path.parent}")
    elif kind == "highd":
        say(f"`charms-bench data {path}` summarises it")

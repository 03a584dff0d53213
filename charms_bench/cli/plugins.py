"""`agents`, `traffic`, `check`, `new-agent` and `export`: list, test and add agents."""

from pathlib import Path
from typing import Any, Literal

import typer
from typer import Argument, Option

import charms_bench
from charms_bench.cli import arguments
from charms_bench.cli.terminal import (
    FAIL,
    app,
    as_word,
    end_with_json,
    out,
    print_records,
    say,
    shown,
)
from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.files import absolute, is_same_file, reject_foreign
from charms_bench.foundation.words import counted


@app.command(rich_help_panel=arguments.AGENTS)
def agents(as_json: arguments.Json = False) -> None:
    """List the installed agents and traffic models.

    The plugins are not imported. Each is described by the first line of its docstring. A name that
    two distributions claim cannot be used.
    """
    from charms_bench.plugins.first_line import first_line
    from charms_bench.plugins.registry import AGENTS, TRAFFIC, plugins

    facts = ("role", "version", "distribution")
    found = [
        {"name": plugin.name, **{fact: getattr(plugin, fact) for fact in facts}}
        | ({"rival": plugin.rival} if plugin.rival else {})
        | {"summary": first_line(plugin.entry_point)}
        for group in (AGENTS, TRAFFIC)
        for plugin in plugins(group).values()
    ]
    if as_json:
        end_with_json(found)
    groups: dict[str, list[dict[str, str]]] = {}
    for record in found:
        source = f"{record['distribution']} {record['version']}"
        if "rival" in record:
            source += f" and {record['rival']}: unusable, uninstall one"
        name = {"agent": "Agents", "traffic": "Traffic models"}[record["role"]]
        groups.setdefault(f"{name} of {source}", []).append(record)
    for title, records in groups.items():
        say(title)
        print_records("name", records, {"summary": ""})


@app.command(
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True},
    rich_help_panel=arguments.AGENTS,
)
def traffic(
    context: typer.Context,
    name: str = Argument(help="Traffic model; its options follow, e.g. --tau 1.5."),
    figure: arguments.FigurePath = None,
    as_json: arguments.Json = False,
) -> None:
    """Print the proportions of agents in a traffic model."""
    from charms_bench.plugins.registry import make_traffic
    from charms_bench.plugins.traffic import SAMPLED, proportions
    from charms_bench.report.figures.composition import draw
    from charms_bench.report.figures.drawing import save
    from charms_bench.report.table import Column, Table
    from charms_bench.report.terminal import drawn

    options = _options(context.args)
    found = proportions(make_traffic(name, options))
    if figure is not None:
        words = ", ".join(f"{key} {value}" for key, value in options.items())
        save(draw(found, f"{name} {words}".strip()), figure)
    if as_json:
        end_with_json({"traffic": name, "options": options, "shares": found})
    records = [{"agent": agent, "proportion": each} for agent, each in found.items()]
    columns = (Column("proportion", form=".1%"),)
    table = Table.from_records(records, "composition", "", ("agent",), columns)
    out().print(drawn(table, out().width))
    say(f"Counted among {SAMPLED:,} vehicles.")
    if figure is not None:
        say(f"Figure: {shown(figure)}")


def _options(words: list[str]) -> dict[str, Any]:
    """The options in `--name value --other=value`, with values read as YAML."""
    from charms_bench.runs.document import value_of

    options = {}
    pairs = [word for each in words for word in (each.split("=", 1) if "--" in each else [each])]
    if len(pairs) % 2 or any(not word.startswith("--") for word in pairs[::2]):
        raise InputError(f"expected options as --name value, found {' '.join(words)}")
    for option, value in zip(pairs[::2], pairs[1::2], strict=True):
        try:
            options[option.removeprefix("--").replace("-", "_")] = value_of(value)
        except ValueError as error:
            raise InputError(f"{option}: {value} cannot be read: {error}") from error
    return options


@app.command(rich_help_panel=arguments.AGENTS)
def check(
    name: str = Argument(help="Agent or traffic model."), as_json: arguments.Json = False
) -> None:
    """Test whether a plugin follows the rules.

    The exit code is 1 if the plugin breaks a rule.
    """
    from charms_bench.foundation.threads import ONE_THREAD
    from charms_bench.foundation.workers import Pool
    from charms_bench.metrics.missing_lanes import MEANING
    from charms_bench.plugins.registry import is_network, make_agent
    from charms_bench.testing.check import Found
    from charms_bench.testing.check import check as in_worker

    charms_bench.warm_up()
    if is_network(name):
        make_agent(name)  # opens it under limits, which a worker does not set
    results = []

    def heard(found: Found) -> None:
        rule, problem = found
        results.append({"rule": rule, "pass": not problem, "problem": problem})
        if not as_json:
            out().print("[red]fail[/]" if problem else "[green]pass[/]", end=" ")
            say(f"{rule}: {problem}" if problem else rule)

    def title(name: str) -> str:
        return f"the check of '{name}', after {counted(len(results), 'rule')}"

    with Pool(in_worker, 1, title, environment=ONE_THREAD, told=heard, tries=1) as pool:
        pool.add([name])
        ((_, remark),) = pool.results()
    code = FAIL if any(each["problem"] for each in results) else 0
    if as_json:
        end_with_json(results, code)
    if remark:
        say(f"remark {remark}. {MEANING}")
    raise typer.Exit(code)


@app.command(rich_help_panel=arguments.AGENTS)
def new_agent(
    name: str = Argument(help="Name of the agent in suites."),
    folder: Path | None = Option(None, help="Folder to create; the default is the agent's name."),
    kind: Literal["policy", "planner", "memory", "driver-model", "traffic"] = Option(
        "policy",
        help="What to write: a policy, one that plans or that has memory, a driver model, or a "
        "traffic model.",
    ),
) -> None:
    """Write a package with a new agent or traffic model."""
    from charms_bench.plugins.scaffold import new_agent as write

    folder = folder or Path(name)
    for path in write(name, folder, kind):
        say(str(path))
    tried = "pip install . pytest && pytest && charms-bench run suite.yaml"
    say(f"Next: cd {as_word(folder)} && {tried}")


@app.command(rich_help_panel=arguments.AGENTS)
def export(
    files: list[Path] = Argument(
        metavar="CHECKPOINT... [OUT.onnx]",
        help="Zip file of a DQN, PPO, A2C, SAC, TD3 or DDPG of Stable-Baselines3 or a "
        "RecurrentPPO of sb3-contrib, and the ONNX file to write; with --to, any number of zip "
        "files.",
    ),
    to: Path | None = Option(
        None,
        metavar="FOLDER",
        help="Folder to write to; each ONNX file is named like its zip file.",
    ),
    observation: str | None = Option(
        None,
        metavar="NAME",
        help="Observation that the network was trained with: neighbours, paper_neighbours "
        "(networks of the paper's authors), or highway-env's Kinematics, with options such as "
        "'{type: Kinematics, vehicles_count: 7}'; the default is what the checkpoint states.",
    ),
    environment: str | None = Option(
        None,
        metavar="NAME",
        help="Environment of highway-env that the network was trained in, such as merge-v0, with "
        "other values than its defaults as '{name: merge-v0, configuration: {policy_frequency: "
        "5}}'; the default is what the checkpoint states.",
    ),
    normalise: Path | None = Option(
        None,
        metavar="FILE.npz",
        help="Mean, var and clip of the VecNormalize that the network was trained with; none "
        "if it normalised rewards only.",
    ),
    decision_hz: float | None = Option(
        None,
        min=0.001,
        max=1000,
        help="Decisions per second that the network was trained with; the default is what the "
        "checkpoint states, or 3, or 1 with Kinematics.",
    ),
    style: str = Option("", help="Description of how the network drives, stored in the file."),
    stochastic: bool = Option(
        False,
        "--stochastic",
        help="Draw the actions of a PPO, A2C or RecurrentPPO at random, as in training; by "
        "default, the network chooses the most probable action.",
    ),
    as_json: arguments.Json = False,
) -> None:
    """Convert trained networks to ONNX files for suites.

    In a suite, the path of an ONNX file is the name of an agent.
    """
    from charms_bench.plugins.registry import EXPORTERS, load
    from charms_bench.runs.document import value_of
    from charms_bench.world.observations import named_observation
    from charms_bench.world.scene import SceneSettings

    files, to = [absolute(file) for file in files], to and absolute(to)
    if to is not None:
        outputs = {checkpoint: to / f"{checkpoint.stem}.onnx" for checkpoint in files}
        if len(set(outputs.values())) < len(outputs):
            raise InputError("two checkpoints have the same name; export them to different folders")
    elif files[-1].suffix != ".onnx":
        raise InputError(f"{files[-1]}: expected a name that ends in .onnx, or --to FOLDER")
    elif len(files) != 2:
        raise InputError(f"expected one checkpoint before {files[-1]}; --to FOLDER takes several")
    else:
        outputs = {files[0]: files[1]}
    for checkpoint, output in outputs.items():
        if is_same_file(checkpoint, output):
            raise InputError(f"{checkpoint}: is also the file to write; choose another name")
        reject_foreign(output)
    try:
        seen = None if observation is None else named_observation(value_of(observation))
    except ValueError as error:
        raise InputError(f"--observation {observation}: is not YAML: {error}") from error
    where = None if environment is None else _environment(environment)
    facts = {"style": style} if style else {}
    if decision_hz is not None:
        facts["decision_hz"] = f"{decision_hz:g}"
    from charms_bench.plugins.onnx_policy import ASSUMED, NOT_STATED

    export_zip = load(EXPORTERS, "sb3")
    records = []
    for checkpoint, output in outputs.items():
        made = export_zip(checkpoint, output, facts, seen, stochastic, normalise, None, where)
        records.append(made)
        if not as_json:
            sizes = " → ".join(map(str, made["sizes"]))
            last = f", the last {made['history']} at once" if made["history"] > 1 else ""
            say(
                f"{shown(output)}: {sizes}, {made['activation']}; acts as {shown(checkpoint)} in "
                f"{made['observations']:,} observations; observes {made['observation']}{last}, "
                f"decides at {made['decision_hz']:g} Hz"
                f"{f'; {ASSUMED}' if made['trained_in'] == NOT_STATED else ''}"
            )
            hz, scene = made["decision_hz"], SceneSettings()
            rate = scene.simulation_hz_for(hz)
            if rate not in (None, scene.simulation_hz):
                say(f"At {hz:g} Hz, it drives in suites with `simulation_hz: {rate}` in `scene`.")
    if as_json:
        end_with_json(records[0] if to is None else records)


def _environment(text: str) -> dict[str, Any]:
    """What a checkpoint of charms-bench would state of an environment with highway-env's name."""
    from charms_bench.envs.road_episodes import described
    from charms_bench.roads import TASKS
    from charms_bench.roads.episodes import Episodes
    from charms_bench.runs.document import value_of
    from charms_bench.world.named_road import NamedRoad

    try:
        value = value_of(text)
        road = NamedRoad.model_validate({"name": value} if isinstance(value, str) else value)
        if road.name not in TASKS:
            known = suggestion(road.name, dict.fromkeys(TASKS))
            raise InputError(f"no environment named '{road.name}'. {known}")
        return described(Episodes(road.name, 1, road.configuration))
    except (InputError, ValueError) as error:
        raise InputError(f"--environment {text}: {error}") from error

"""Reads training suites from YAML, and names what is wrong in them with its place."""

from collections.abc import Collection
from graphlib import CycleError
from pathlib import Path

import numpy as np

from charms_agents.human.interface import DECISION_HZ, SIMULATION_HZ
from charms_agents.training.settings import Condition, TrainingSuite
from charms_bench.errors import InputError, RegistryError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import AGENTS, find, is_network
from charms_bench.plugins.specs import TrafficSpec
from charms_bench.runs.document import Document, Location
from charms_bench.runs.suite import check_placement
from charms_bench.world.observations import Neighbours
from charms_bench.world.scenario import PRESCRIBED

PLACED = 1_000
"""Points of a scenario that are tried before a network learns in it."""


def load_training(path: Path, seed: int | None = None, steps: int | None = None) -> TrainingSuite:
    """Reads a training suite; `seed` and `steps` replace those in the file.

    Raises:
        SuiteError: The file is invalid, or a name in it does not exist.
    """
    document = Document(path)
    _resolve_likeness(document)
    if seed is not None:
        document.data["seed"] = seed
    stages = document.data.get("stages")
    for stage in stages.values() if steps is not None and isinstance(stages, dict) else ():
        if isinstance(stage, dict):  # anything else is rejected below
            stage["steps"] = steps
    suite, placed = document.validate(TrainingSuite), set[str]()
    h = suite.hyperparameters
    for name, stage in suite.stages.items():
        at = ("stages", name)
        counts = [(stage.steps, (*at, "steps")), (suite.curve_steps, ("curve_steps",))]
        for steps, where in counts:
            if steps % h.scenes:
                raise document.error(where, f"{steps} is not a multiple of scenes {h.scenes}")
        for each in stage.conditions:
            _check_name(document, (*at, "conditions"), "conditions", each, suite.conditions)
        if h.scenes % (count := len(suite.conditions_of(stage))):
            what = f"scenes {h.scenes} is not a multiple of {count} conditions"
            raise document.error((*at, "conditions"), what)
        if h.scenes // count % len(stage.all_styles):
            what = f"{h.scenes // count} scenes a condition are not a multiple of them"
            raise document.error((*at, "styles"), what)
        if stage.prior is not None:
            _check_prior(document, suite, name)
        slowest = stage.scene.profile.target_speed_min_mps
        if stage.reward is not None and stage.reward.desired_speed_mps <= slowest:
            what = f"{stage.reward.desired_speed_mps:g}; expected more than {slowest:g} m/s"
            where = (*at, "reward", "desired_speed_mps")
            raise document.error(where, f"{what}, the lowest target speed of the profile")
        for label, style in stage.all_styles.items():
            of_style: Location = (*at, *(("styles", label) if label else ()), "weights")
            _check_name(document, of_style, "weights", style.weights, suite.weights)
        _check_traffic(document, suite, (*at, "traffic"), stage.traffic)
        _check_conditions(document, suite, name, placed)
    for name, human in suite.human_stages.items():
        place = ("human", "stages", name)
        if name in suite.stages:
            raise document.error(place, f"another stage is also named '{name}'")
        if human.fine_tunes is not None:
            key, under = (*place, "fine_tunes"), " under stages"
            _check_name(document, key, "stage", human.fine_tunes, suite.stages, under)
            if suite.stages[human.fine_tunes].styles:
                what = f"'{human.fine_tunes}' has several styles; expected a stage with one"
                raise document.error(key, what)
        if human.drivers == "recorded" and not isinstance(suite.observed, Neighbours):
            what = "recorded drivers are observed as neighbours or paper_neighbours"
            raise document.error(("observation",), f"{what}; found {suite.observed.name}")
        if human.drivers == "simulated":
            _check_simulated(document, suite, name)
    try:
        suite.order  # noqa: B018  # raises
    except CycleError as error:
        what = f"stages depend on each other: {' <- '.join(error.args[1])}"
        raise document.error(("stages",), what) from error
    return suite


def _check_name(
    document: Document, at: Location, kind: str, name: str, known: Collection[str], under: str = ""
) -> None:
    """Rejects a name that the suite does not have."""
    if name not in known:
        there = f"this file has: {', '.join(known) or 'none'}"
        raise document.error(at, f"no {kind} named '{name}'{under}; {there}")


def _check_traffic(
    document: Document, suite: TrainingSuite, at: Location, traffic: TrafficSpec
) -> None:
    """Rejects traffic whose drivers are neither stages nor installed nor networks."""
    if traffic.name in suite.names and traffic.options:
        raise document.error(at, f"'{traffic.name}' is a stage, which has no options: remove them")
    try:
        for driver in suite.traffic_of(traffic).agents:
            if is_network(driver):
                OnnxPolicy(document.path.parent / driver)
            elif driver not in suite.names and driver != PRESCRIBED:
                find(AGENTS, driver)
    except RegistryError as error:
        stages = f"Stages of this file: {', '.join((*suite.stages, *suite.human_stages))}."
        raise document.error(at, f"{error} {stages}") from error
    except InputError as error:
        raise document.error(at, str(error)) from error


def _check_conditions(
    document: Document, suite: TrainingSuite, name: str, placed: set[str]
) -> None:
    """Rejects other steps of the target speed, and scenarios that cannot be placed.

    `placed` has the scenarios and scenes of earlier stages, which are not placed again.
    """
    from charms_bench.roads.settings import egos_on  # slow to import

    stage = suite.stages[name]
    named: list[tuple[Location, Condition]] = [
        (("conditions", each, index), condition)
        for each in stage.conditions
        for index, condition in enumerate(suite.conditions[each])
    ]
    for at, condition in named or [(("stages", name), Condition())]:
        traffic = condition.traffic or stage.traffic
        if condition.traffic is not None:
            _check_traffic(document, suite, (*at, "traffic"), condition.traffic)
        for index, each in enumerate(condition.by_road):
            where: Location = (*at, "roads", index) if condition.roads else at
            try:
                scene = each.applied(stage.scene, traffic)
            except InputError as error:
                raise document.error(where, str(error)) from error
            if scene.network is not None and (egos := egos_on(scene)) > 1:
                raise document.error(where, f"has {egos} egos; expected a road with one")
            steps, expected = (one.profile.target_speed_steps_mps for one in (scene, stage.scene))
            if steps != expected:
                what = f"{[*steps]}; expected those of the stage '{name}', {[*expected]}"
                where = (*at, "profile")
                raise document.error(where, f"target_speed_steps_mps: found {what}")
            key = scene.model_dump_json()
            if traffic.scenario is not None and key not in placed:
                placed.add(key)
                first = suite.first_episode_seed
                numbers = np.arange(first, first + PLACED)
                where = (*at, "traffic", "scenario")
                check_placement(document, where, traffic.scenario, scene, numbers)


def _check_prior(document: Document, suite: TrainingSuite, name: str) -> None:
    """Rejects a stage whose prior cannot regularise it."""
    stage = suite.stages[name]
    at, h = ("stages", name, "prior"), suite.hyperparameters
    _check_name(document, at, "stage", str(stage.prior), suite.human_stages, " under human.stages")
    prior = suite.human_stages[str(stage.prior)]
    if not h.prior_weight or not h.standardised:
        raise document.error(at, "needs hyperparameters with a prior_weight, and standardised")
    layers = prior.hidden_layers or h.hidden_layers
    if len(layers) != len(h.hidden_layers):
        what = f"has {len(layers)} hidden layers; expected as many as the stage has"
        raise document.error(at, f"{what}, {len(h.hidden_layers)}")


def _check_simulated(document: Document, suite: TrainingSuite, name: str) -> None:
    """Rejects a stage that cannot learn from simulated drivers."""
    assert suite.human is not None
    if suite.human_stages[name].fine_tunes is not None:
        what = "a stage that fine-tunes learns from recorded drivers; expected no fine_tunes"
        raise document.error(("human", "stages", name, "drivers"), what)
    if (simulated := suite.human.simulated) is None:
        raise document.error(("human",), "a stage learns from `simulated` drivers: none given")
    at = ("human", "simulated")
    for each in simulated.conditions:
        _check_name(document, (*at, "conditions"), "conditions", each, suite.conditions)
    rates = simulated.scene.simulation_hz, simulated.scene.decision_hz
    if rates != (SIMULATION_HZ, DECISION_HZ):
        what = f"expected simulation_hz {SIMULATION_HZ} and decision_hz {DECISION_HZ}"
        raise document.error((*at, "scene"), f"{what}, found {rates[0]} and {rates[1]}")
    key = "agents"
    try:
        for agent in simulated.agents:
            if not is_network(agent.name):
                find(AGENTS, agent.name)
        key = "traffic"
        for driver in suite.drivers_of(simulated):
            if driver in suite.names:
                raise RegistryError(f"'{driver}' is a stage; expected installed agents or networks")
            if not is_network(driver):
                find(AGENTS, driver)
    except RegistryError as error:
        raise document.error((*at, key), str(error)) from error


def _resolve_likeness(document: Document) -> None:
    """Copies missing settings into each stage that is `like` another stage."""
    stages = document.data.get("stages")
    if not isinstance(stages, dict):
        return
    said = dict(stages)
    for name, stage in said.items():
        if not isinstance(stage, dict) or "like" not in stage:
            continue
        model = said.get(stage["like"]) if isinstance(stage["like"], str) else None
        if not isinstance(model, dict) or "like" in model:
            what = f"no stage named '{stage['like']}' that is not itself like another"
            raise document.error(("stages", name, "like"), what)
        stages[name] = model | {key: value for key, value in stage.items() if key != "like"}

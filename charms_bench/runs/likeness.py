"""The likeness of every ego and traffic of a suite to recorded drivers."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from charms_bench.errors import InputError
from charms_bench.people.behind import REPETITIONS, count_lanes, drive_behind, fitting
from charms_bench.people.calibration import ou_noise, own_parameters
from charms_bench.people.car_following import IDM, MODELS, drive
from charms_bench.people.controls import CALIBRATED, controls
from charms_bench.people.driven import Driven, conduct, recorded
from charms_bench.people.held_out import SEED, profile_idm, scales_of, starts
from charms_bench.people.lane_choices import read_lane_counts
from charms_bench.people.likeness import Score, Yardstick
from charms_bench.people.population import Population
from charms_bench.people.trips import RATE_HZ, Trip, read_trips, split
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.specs import AgentSpec, drivers_of, networks_of
from charms_bench.plugins.traffic import Traffic
from charms_bench.runs.suite import Suite
from charms_bench.world.profile import CHARMS
from charms_bench.world.scene import Floats

SITUATIONS_LIMIT = 1000
"""Most recorded situations; more are drawn from."""


@dataclass(frozen=True, eq=False)
class Standard:
    """The held-out drivers of recordings, in the situations that a suite's profile allows."""

    yardstick: Yardstick
    parts: tuple[Trip, ...]
    population: Population
    human: Driven
    others: Driven
    """Those whom the population was fitted to, in their own situations."""
    constant: Driven
    spawn_only: Driven
    own: Driven


@dataclass(frozen=True)
class Likeness:
    """The scores of an ego or a traffic, or of a row that they are read against."""

    kind: str
    label: str
    scores: dict[str, Score]
    conduct: dict[str, float | None]
    """What the driver did, in numbers; see `people.driven`."""
    differences: dict[str, Score] | None = None
    """How much higher a control scores than the calibrated driver."""


Half = Literal["both", "selection", "test"]
"""Of the held-out drivers in their order: all, the first, third, ..., or the second, fourth, ..."""


def standard(
    suite: Suite, recordings: Path, population: Population, half: Half = "both"
) -> Standard:
    """What the scores of a suite are measured against.

    What is chosen by the drivers of one `half` can be reported on those of the other.

    Raises:
        InputError: A traffic model of the suite is a road or a scenario, or the scene has
            recordings or an inflow.
        DataError: The recordings cannot be used, or hold no situation that the profile allows.
    """
    for cell in suite.cells:
        cell.scene.check_straight("likeness is measured on")
    scene, traffics = suite.scene, suite.traffics
    if scene.recording or scene.inflow or any(each.traffic.scenario for each in traffics):
        raise InputError(
            "likeness places the vehicles itself; expected a suite without scene.recording, "
            "scene.inflow and scenarios"
        )
    fitted, held_out = split(read_trips(recordings))
    held_out = of_half(held_out, half)
    parts = _some(fitting(starts(held_out), suite.scene.profile))
    others = _some(fitting(starts(fitted), suite.scene.profile))
    lanes = read_lane_counts(recordings)
    human = recorded(parts, lanes)
    rng = np.random.default_rng(SEED)
    own = own_parameters(population, held_out)

    def constant(part: Trip) -> tuple[Floats, Floats]:
        time_s = np.arange(part.gap.size) / RATE_HZ
        return (
            (part.leader_x - part.speed[0] * time_s)[None],
            np.full((1, time_s.size), part.speed[0]),
        )

    def spawn_only(part: Trip) -> tuple[Floats, Floats]:
        p = profile_idm(CHARMS.idm_mobil.time_headway_s)
        p[0] = max(part.speed[0], 1.0)
        return drive(IDM, part, p[None])

    def own_fit(part: Trip) -> tuple[Floats, Floats]:
        p = np.tile(own[part.driver], (REPETITIONS, 1))
        noise = ou_noise(rng, (len(p), part.gap.size), population.noise_mps2, population.noise_s)
        return drive(MODELS[population.model], part, p, population.lag_s, noise)

    # None of them changes lanes, on as many kilometres as were recorded.
    still = lanes * [1.0, 0.0, 0.0]
    at_constant = _driven(human, parts, constant, still)
    at_spawn = _driven(human, parts, spawn_only, still)
    fitted_own = _driven(human, parts, own_fit, lanes)
    yardstick = Yardstick(human, at_constant, at_spawn, fitted_own, scales_of(fitted))
    of_others = recorded(others, lanes)
    drivers = human, of_others, at_constant, at_spawn, fitted_own
    return Standard(yardstick, tuple(parts), population, *drivers)


def of_half(trips: list[Trip], half: Half) -> list[Trip]:
    """The trips of the drivers in a half."""
    drivers = sorted({trip.driver for trip in trips})
    chosen = drivers if half == "both" else drivers[half == "test" :: 2]
    return [trip for trip in trips if trip.driver in chosen]


def likeness(suite: Suite, against: Standard) -> Iterator[Likeness]:
    """The scores of the floor and the ceiling, then of each ego and each traffic of a suite.

    Lane changes of an ego are those among the first traffic, and those of a traffic are of the
    vehicles around the first ego, in the suite's episodes.
    """
    yardstick = against.yardstick
    halves = yardstick.ceiling()
    yield Likeness("reference", "half of the drivers", halves, conduct(against.human))
    of_others = yardstick.of_others(against.others)
    yield Likeness("reference", "drivers of the other half", of_others, conduct(against.others))
    for label, driven in (
        ("IDM, own fit and noise", against.own),
        ("constant velocity", against.constant),
        ("IDM, speed of the spawn", against.spawn_only),
    ):
        yield Likeness("reference", label, yardstick.scores(driven), conduct(driven))
    first_ego, first_traffic = suite.egos[0].agent, suite.traffics[0].traffic
    for ego in suite.egos:
        traffic = first_traffic.make()
        agents = _agents(suite, ego.agent, traffic)
        lanes = _lanes(suite, against, ego.agent.key, ego.agent.key, traffic, agents)
        driven = drive_behind(against.parts, suite.scene, ego.agent.key, agents, lanes)
        yield Likeness("ego", ego.title, yardstick.scores(driven), conduct(driven))
    for entry in suite.traffics:
        traffic = entry.traffic.make()
        agents = _agents(suite, first_ego, traffic)
        lanes = _lanes(suite, against, traffic, first_ego.key, traffic, agents)
        driven = drive_behind(against.parts, suite.scene, traffic, agents, lanes)
        yield Likeness("traffic", entry.title, yardstick.scores(driven), conduct(driven))


def likeness_of_controls(against: Standard) -> Iterator[Likeness]:
    """The scores of drivers with known faults, and what they differ by from a calibrated driver."""
    driven = controls(against.parts, against.human, against.population)
    for label, each in driven.items():
        apart = None
        if label != CALIBRATED:
            apart = against.yardstick.differences(driven[CALIBRATED], each)
        yield Likeness("control", label, against.yardstick.scores(each), conduct(each), apart)


def _some(parts: list[Trip]) -> list[Trip]:
    chosen = np.random.default_rng(SEED).permutation(len(parts))[:SITUATIONS_LIMIT]
    return [parts[k] for k in np.sort(chosen)]


def _agents(suite: Suite, ego: AgentSpec, traffic: Traffic) -> dict[str, Agent]:
    networks = networks_of(ego, traffic, suite.folder)
    return {driver.key: driver.make(networks) for driver in drivers_of(ego, traffic)}


def _lanes(
    suite: Suite,
    against: Standard,
    driver: str | Traffic,
    ego: str,
    traffic: Traffic,
    agents: Mapping[str, Agent],
) -> Floats:
    if not against.human.lanes.size:
        return against.human.lanes
    return count_lanes(suite.scene, driver, ego, traffic, agents, suite.episodes)


def _driven(
    human: Driven,
    parts: list[Trip],
    driver: Callable[[Trip], tuple[Floats, Floats]],
    lanes: Floats,
) -> Driven:
    """What a driver does who needs no engine, at 1 Hz."""
    every = slice(None, None, RATE_HZ)
    gaps, speeds = zip(*(driver(part) for part in parts), strict=True)
    of_seconds = [np.array(each)[..., every] for each in (gaps, speeds)]
    return Driven(human.driver, of_seconds[0], of_seconds[1], human.leader_speed, lanes)

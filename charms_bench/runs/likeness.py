"""The likeness of every ego and traffic of a suite to recorded drivers."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from charms_bench.errors import DataError, InputError
from charms_bench.foundation.words import counted
from charms_bench.humans.blind_lanes import BlindLanes
from charms_bench.humans.calibration import ou_noise, own_parameters
from charms_bench.humans.car_following import IDM, MODELS, drive
from charms_bench.humans.driven_situations import Driven, conduct, in_place, recorded
from charms_bench.humans.faulty_drivers import CALIBRATED, controls
from charms_bench.humans.held_out import SEED, profile_idm, scales_of, starts
from charms_bench.humans.in_scenes import (
    AsRecorded,
    ConstantSpeed,
    SceneYardstick,
    drive_in_scene,
    in_scenes,
)
from charms_bench.humans.lane_choices import read_lane_counts
from charms_bench.humans.likeness import Score, Yardstick
from charms_bench.humans.population import Population
from charms_bench.humans.resimulation import (
    FEWEST_DRIVERS,
    count_lanes,
    drive_behind,
    fitting,
    speeds_of,
)
from charms_bench.humans.simple_models import REPETITIONS, constant_time_gap, nearest_neighbours
from charms_bench.humans.trips import RATE_HZ, Trip, read_trips, split
from charms_bench.humans.unseen_situations import unseen
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.specs import agents_of
from charms_bench.plugins.traffic import OneAgent, Traffic
from charms_bench.runs.suite import Suite
from charms_bench.world.named_road import RECORDED, NamedRoad
from charms_bench.world.profile import CHARMS
from charms_bench.world.scene import Floats

SITUATIONS_LIMIT = 1000
"""Most recorded situations; more are drawn from."""
RECORDED_DRIVER = "reference", "recorded driver"
CONSTANT_SPEED = "reference", "constant speed"
"""The kinds and labels of the ceiling and the floor in recorded scenes."""


@dataclass(frozen=True, eq=False)
class Standard:
    """The held-out drivers of recordings, in the situations that a suite's profile allows."""

    yardstick: Yardstick
    parts: tuple[Trip, ...]
    """Their S situations, and then S that no recording has."""
    population: Population
    human: Driven
    others: Driven
    """Those whom the population was fitted to, in their own situations."""
    references: dict[str, Driven]
    """What the scores are read against, by name: what simple drivers do in the 2 S situations."""


@dataclass(frozen=True)
class Likeness:
    """The scores of an ego or a traffic, or of a row that they are read against."""

    kind: str
    label: str
    scores: dict[str, Score]
    conduct: dict[str, float | None]
    """What the driver did, in numbers; see `humans.driven_situations`."""
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
    profile = suite.scene.profile
    parts = _some(fitting(starts(held_out), profile))
    others = _some(fitting(starts(fitted), profile))
    lanes = read_lane_counts(recordings, held_out)
    human = recorded(parts, lanes)
    parts += unseen(parts, speeds_of(profile))
    own = own_parameters(population, held_out)

    def constant(part: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        time_s = np.arange(part.gap.size) / RATE_HZ
        return (
            (part.leader_x - part.speed[0] * time_s)[None],
            np.full((1, time_s.size), part.speed[0]),
        )

    def spawn_only(part: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        p = profile_idm(CHARMS.idm_mobil.time_headway_s)
        p[0] = max(part.speed[0], 1.0)
        return drive(IDM, part, p[None])

    def own_fit(part: Trip, rng: np.random.Generator) -> tuple[Floats, Floats]:
        p = np.tile(own[part.driver], (REPETITIONS, 1))
        noise = ou_noise(rng, (len(p), part.gap.size), population.noise_mps2, population.noise_s)
        return drive(MODELS[population.model], part, p, population.lag_s, noise)

    # Those that define 0 do not change lanes, on as many kilometres as were recorded.
    still = lanes * [1.0, 0.0, 0.0, 0.0]
    at_constant, at_spawn = (in_place(parts, still, each) for each in (constant, spawn_only))
    fitted_own = in_place(parts, lanes, own_fit)
    yardstick = Yardstick(human, at_constant, at_spawn, fitted_own, scales_of(fitted))
    references = {
        "IDM, own fit and noise": fitted_own,
        "constant time gap": in_place(parts, lanes, constant_time_gap(population)),
        "nearest neighbours": in_place(parts, lanes, nearest_neighbours(fitted, population)),
        "constant velocity": at_constant,
        "IDM, speed of the spawn": at_spawn,
    }
    of_others = recorded(others, read_lane_counts(recordings, fitted))
    return Standard(yardstick, tuple(parts), population, human, of_others, references)


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
    for label, driven in against.references.items():
        yield _scored("reference", label, against, driven)
    first_ego, first_traffic = suite.egos[0].agent, suite.traffics[0].traffic
    asked = [("ego", each.title, each.agent, first_traffic) for each in suite.egos]
    asked += [("traffic", each.title, first_ego, each.traffic) for each in suite.traffics]
    for kind, label, ego, spec in asked:
        traffic = spec.make()
        agents = agents_of(ego, traffic, suite.folder)
        driver = ego.key if kind == "ego" else traffic
        lanes = count_lanes(suite.scene, driver, ego.key, traffic, agents, suite.episodes)
        driven = drive_behind(against.parts, suite.scene, driver, agents, lanes)
        yield _scored(kind, label, against, driven)


def likeness_of_controls(suite: Suite, against: Standard) -> Iterator[Likeness]:
    """The scores of drivers with known faults, and what they differ by from a calibrated driver."""
    driven = controls(against.parts, against.human, against.population)
    km, changes, *_ = against.human.lanes.sum(axis=0)
    if np.isfinite(changes):
        traffic = suite.traffics[0].traffic.make()
        agents = agents_of(suite.egos[0].agent, traffic, suite.folder)
        agents["blind"] = BlindLanes(changes / km, suite.scene.lanes)
        lanes = count_lanes(suite.scene, "blind", "blind", traffic, agents, suite.episodes)
        kept = against.references["constant time gap"]
        driven["constant time gap, blind lane changes"] = replace(kept, lanes=lanes)
    for label, each in driven.items():
        apart = None
        if label != CALIBRATED:
            apart = against.yardstick.differences(driven[CALIBRATED], each)
        yield replace(_scored("control", label, against, each), differences=apart)


@dataclass(frozen=True, eq=False)
class InScenes:
    """The recorded drivers of scenes on their own roads, and what a suite's egos do there."""

    yardstick: SceneYardstick
    driven: dict[tuple[str, str], Driven]
    """By kind and label: the recorded driver, a vehicle at constant speed, then each ego."""
    left_out: tuple[str, ...]
    """Why scenes are left out."""


def drive_scenes(
    suite: Suite, files: Sequence[Path], progress: Callable[[str], None] = lambda done: None
) -> InScenes:
    """Lets a suite's egos drive in CommonRoad scenarios, among its first traffic model.

    Raises:
        InputError: The suite has roads, its scene says where vehicles are, or its profile has a
            lowest speed, at which no vehicle can stop on streets.
        MapError: A file cannot be read.
        DataError: Egos can take the place of recorded vehicles in too few of the files.
    """
    from charms_bench.roads.settings import on_road  # slow to import

    if suite.roads:
        raise InputError("likeness in recorded scenes has their roads; expected a suite without")
    low, high = speeds_of(profile := suite.scene.profile)
    if low > 0:
        raise InputError(
            f"scene.profile: '{profile.name}' has speeds of {low:g} to {high:g} m/s, so no vehicle "
            "can stop in a scene; expected a profile from 0 m/s on, such as 'roads'"
        )
    traffic = suite.traffics[0].traffic.make()
    first = agents_of(suite.egos[0].agent, traffic, suite.folder)
    drivers: dict[tuple[str, str], tuple[str, Traffic, dict[str, Agent], int]] = {
        RECORDED_DRIVER: ("recorded", OneAgent("recorded"), {"recorded": AsRecorded()}, 1),
        CONSTANT_SPEED: ("constant", traffic, first | {"constant": ConstantSpeed()}, 1),
    }
    for ego in suite.egos:
        agents = agents_of(ego.agent, traffic, suite.folder)
        drivers["ego", ego.title] = ego.agent.key, traffic, agents, REPETITIONS
    parts: dict[tuple[str, str], list[Floats]] = {key: [] for key in drivers}
    left_out = []
    for file in files:
        given = {"file": file, "configuration": {"start": RECORDED}}
        try:
            settings = on_road(suite.scene, NamedRoad.model_validate(given))
        except InputError as error:
            left_out.append(f"{file.name}: {error}")
            continue
        for key, driver in drivers.items():
            parts[key].append(drive_in_scene(settings, *driver))
        progress(file.name)
    count = len(files) - len(left_out)
    if count < FEWEST_DRIVERS:
        raise DataError(
            f"egos can drive in {count} of {counted(len(files), 'CommonRoad scenario')}; expected "
            f"{FEWEST_DRIVERS} or more, of which halves are compared"
            + "".join(f"; {each}" for each in left_out[:1])
        )
    driven = {key: in_scenes(each) for key, each in parts.items()}
    yardstick = SceneYardstick(driven[RECORDED_DRIVER], driven[CONSTANT_SPEED])
    return InScenes(yardstick, driven, tuple(left_out))


def likeness_in_scenes(found: InScenes) -> Iterator[Likeness]:
    """The scores of the ceiling, the floor and each ego."""
    yardstick = found.yardstick
    for (kind, label), driven in found.driven.items():
        is_ceiling = (kind, label) == RECORDED_DRIVER
        scores = yardstick.ceiling() if is_ceiling else yardstick.scores(driven)
        yield Likeness(kind, label, scores, conduct(driven))


def _scored(kind: str, label: str, against: Standard, driven: Driven) -> Likeness:
    """Conduct is that in the situations that no recording has, as most of the score."""
    seen = len(against.human.driver)
    scores = against.yardstick.scores(driven)
    return Likeness(kind, label, scores, conduct(driven.of(slice(seen, None))))


def _some(parts: list[Trip]) -> list[Trip]:
    chosen = np.random.default_rng(SEED).permutation(len(parts))[:SITUATIONS_LIMIT]
    return [parts[k] for k in np.sort(chosen)]

"""Compares `human` in traffic with recorded drivers: `python tools/human_in_traffic.py DATA`.

DATA is a folder that holds `i24_car_following.parquet` and `i75_lane_trajectories.parquet`. In the
simulation, `human` drives all vehicles on three lanes of the profile `naturalistic` at density 1.
Accelerations are changes of speed over a decision, a third of a second. An acceleration reverses if
its sign differs from that of the last one beyond 0.3 m/s2. Intervals are percentiles over recorded
drivers and over simulated episodes.
"""

import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
from charms_agents.human.interface import DECISION_HZ
from make_populations import FILES
from recorded_through_interface import at_decisions

from charms_bench.engine.simulation import Simulation
from charms_bench.people.behind import count_lanes
from charms_bench.people.trips import CAR_LENGTH_M, read_trips
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.gaps import time_headway
from charms_bench.world.scene import Floats, SceneSettings

EPISODES = 400
FASTER_THAN_MPS = (0.0, 22.0)
REVERSAL_MPS2, STRONG_MPS2, HEADWAY_S, FURTHEST_M = 0.3, 1.1, 1.0, 100.0
COLUMNS = (
    "acceleration std, m/s²",
    "above 1.1 m/s²",
    "reversals per minute",
    "headway, median, s",
    "below 1 s, centre to centre",
    "lane changes per km",
    "undone within 5 s",
)


def sums(speed: Floats, gap: Floats) -> Floats:
    """(8,) decisions, a, a^2, strong ones, reversals, gaps, short ones, and the median headway.

    Speeds (D + 1,) and gaps (D + 1,), not a number without a leader, of a driver at decisions.
    """
    acceleration = np.diff(speed) * DECISION_HZ
    signs = np.sign(acceleration) * (np.abs(acceleration) > REVERSAL_MPS2)
    signs = signs[signs != 0]
    seen = gap < FURTHEST_M
    headway = time_headway(gap[seen], speed[seen])
    short = time_headway(gap[seen] + CAR_LENGTH_M, speed[seen]) < HEADWAY_S
    strong = np.abs(acceleration) > STRONG_MPS2
    of_speed = acceleration.size, acceleration.sum(), (acceleration**2).sum(), strong.sum()
    median = np.median(headway) if headway.size else np.nan
    return np.array(
        [*of_speed, (signs[1:] != signs[:-1]).sum(), seen.sum(), short.sum(), median], dtype=float
    )


def rates(units: Floats) -> Floats:
    """(7,) the columns, of the sums (U, 8) of drivers and their kilometres and changes (U, 3)."""
    decisions, a, squares, strong, reversals, gaps, short, _, km, changes, undone = units.sum(
        axis=0
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.array(
            [
                np.sqrt(squares / decisions - (a / decisions) ** 2),
                strong / decisions,
                reversals / decisions * DECISION_HZ * 60,
                np.nanmedian(units[:, 7]) if gaps else np.nan,
                short / gaps,
                changes / km,
                undone / changes,
            ]
        )


def row(name: str, units: Floats) -> str:
    """A line of the table."""
    rng, value = np.random.default_rng(29), rates(units)
    again = [rates(units[rng.integers(len(units), size=len(units))]) for _ in range(500)]
    bounds, cells = np.quantile(again, [0.025, 0.975], axis=0), []
    for k, each in enumerate(value):
        scale, form = (100, ".1f") if k in (1, 4, 6) else (1, ".2f")
        low, high = (format(scale * bound, form) for bound in bounds[:, k])
        unit = " %" if scale == 100 else ""
        shown = f"{scale * each:{form}}{unit} [{low}, {high}]"
        cells.append(shown if np.isfinite(each) else "–")
    return f"| {name} | {' | '.join(cells)} |"


def recorded(path: Path, faster_than_mps: float) -> Floats:
    """(U, 11) sums of the recorded drivers that are never slower; nothing of their lanes."""
    found: dict[int, list[Floats]] = defaultdict(list)
    for trip in read_trips(path):
        if trip.speed.min() < faster_than_mps:
            continue
        found[trip.driver].append(sums(at_decisions(trip.speed), at_decisions(trip.gap)))
    return np.array([[*_together(np.array(each)), 0.0, 0.0, 0.0] for each in found.values()])


def simulated(population: str) -> Floats:
    """(U, 11) sums of the episodes."""
    settings = SceneSettings.model_validate({"profile": "naturalistic", "traffic_vehicles": 20})
    agents = {"human": make_agent("human", {"population": population})}
    traffic = OneAgent("human")
    simulation = Simulation(settings, EPISODES, "human", traffic, agents)
    simulation.reset(np.arange(EPISODES, dtype=np.uint64))
    scene = simulation.scene
    every = np.nonzero(scene.present)
    speeds, gaps = [], []
    for k in range(settings.decisions + 1):
        if k:
            simulation.step()
        leader, present = scene.leader(every, scene.lane[every])
        gap = scene.x[every[0], leader] - scene.x[every] - settings.profile.vehicle_length_m
        speeds.append(scene.speed[every])
        gaps.append(np.where(present, gap, np.nan))
    vehicles = [sums(*both) for both in zip(np.array(speeds).T, np.array(gaps).T, strict=True)]
    found = [_together(np.array(vehicles)[every[0] == episode]) for episode in range(EPISODES)]
    of_ego, of_traffic = (
        count_lanes(settings, driver, "human", traffic, agents, EPISODES)
        for driver in ("human", traffic)
    )
    return np.hstack([found, (of_ego + of_traffic)[:, :3]])


def _together(stacked: Floats) -> list[float]:
    """The sums (P, 8) of several stretches; their median headway is the median of theirs."""
    medians = stacked[stacked[:, 5] > 0, 7]
    return [*stacked[:, :7].sum(axis=0), float(np.median(medians)) if medians.size else np.nan]


def main(data: Path) -> None:
    """Prints the table."""
    print(f"| drivers | {' | '.join(COLUMNS)} |")
    print(f"|---|{'---:|' * len(COLUMNS)}")
    for road, file in FILES.items():
        name = road.upper().replace("I", "I-")
        for speed in FASTER_THAN_MPS:
            title = f"recorded on {name}, {f'above {speed:g} m/s' if speed else 'all'}"
            print(row(title, recorded(data / file, speed)))
        print(row(f"`human` from `{road}`", simulated(road)))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/human_in_traffic.py DATA")
    main(Path(sys.argv[1]))

"""Measures what the simulated traffic does as a flow: `python tools/stop_and_go.py`.

- The density from which on stop-and-go waves grow, on a ring of one lane (`rings`): open boundaries
  would carry the waves away before they have grown. The limit of linear theory stands beside it.
- The fundamental diagram, the flow over the density, on an open road of 5 km with 4 lanes, without
  and with a bottleneck at 3.5 km.
- The speed of the shock wave that the bottleneck sends upstream, and the speed that the flows and
  the densities on its two sides give (Rankine and Hugoniot).
- The time that an hour of this road takes at 2,000 vehicles per hour and lane.

It draws docs/open-road.webp and prints the tables of docs/results.md.
"""

import argparse
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rings import LARGE_M, NO_LANE_CHANGES, critical_density, equilibrium, growth_rate, ring

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.report.figures.drawing import EDGE, SERIES, panels, save
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import Floats, SceneSettings

SECTION_M = (2000.0, 3000.0)
BOTTLENECK_M = (3000.0, 3500.0)
"""Where desired speeds begin to fall, and where they have fallen."""
CELL_M, FRONT_MPS = 100.0, 15.0
"""A jam begins with the first cell in which vehicles are slower than that."""
FRONTS = "front", "Rankine-Hugoniot"
DRIVERS = {"highway-env": 30.0, "naturalistic": 33.3}
"""The profiles whose IDM drives on the ring, and the desired speed there, m/s."""


class Flow(NamedTuple):
    """What a section of the open road shows; all per lane."""

    density_per_km: float
    flow_per_h: float
    entered_per_h: float
    crashed: int
    cells: Floats
    """(T, cells, 2) the vehicles in each cell of the road, and the sum of their speeds, m/s, at
    each second."""


def open_road(
    flow: float, minutes: float, bottleneck_mps: float | None = None, changes_lanes: bool = True
) -> Flow:
    """Simulates an open road of 5 km with 4 lanes, empty at first and with no ego.

    The section is measured in the last third. The bottleneck, a highest desired speed beyond
    3.5 km, begins after the first third.
    """
    profile = {"name": "naturalistic", "road_length_m": 5000.0, "offroad_terminal": False}
    idm_mobil = {"time_headway_s": 1.0} | ({} if changes_lanes else NO_LANE_CHANGES)
    desired = {"normal": [30.0, 2.0], "range": [25, 35]}
    settings = SceneSettings.model_validate(
        {
            "profile": {**profile, "idm_mobil": idm_mobil},
            "lanes": 4,
            "traffic_vehicles": 0,
            "ego_slots": 1,
            "duration_s": 60 * minutes,
            "vehicle_types": [{"name": "car", "proportion": 1.0, "desired_speed_mps": desired}],
            "inflow": {"vehicles_per_hour_and_lane": flow, "capacity": 3000},
        }
    )
    agents = {"idm_mobil": make_agent("idm_mobil")}
    made = Simulation(settings, 1, "idm_mobil", OneAgent("idm_mobil"), agents)
    made.reset(np.zeros(1, dtype=np.uint64))
    state = made.state()
    made.restore(state.with_arrays({"present": state.present & False}))
    scene, inside, speeds, seconds = made.scene, 0, 0.0, []
    cells = np.arange(0, 5000 + CELL_M, CELL_M)
    while scene.active.any():
        if bottleneck_mps is not None and made.steps[0] >= settings.decisions / 3:
            limit = np.interp(scene.x, BOTTLENECK_M, (36.0, bottleneck_mps))
            scene.target_speed[:] = np.minimum(scene.target_speed, limit)
        made.step()
        if made.steps[0] % settings.decision_hz:
            continue
        x, speed = scene.x[scene.present], scene.speed[scene.present]
        weights = (np.ones(x.size), speed)
        seconds.append(np.stack([np.histogram(x, cells, weights=w)[0] for w in weights], axis=1))
        if made.steps[0] >= settings.decisions * 2 / 3:
            is_inside = (x >= SECTION_M[0]) & (x < SECTION_M[1])
            inside, speeds = inside + int(is_inside.sum()), speeds + float(speed[is_inside].sum())
    lane_km_seconds = settings.duration_s / 3 * 4 * (SECTION_M[1] - SECTION_M[0]) / 1000
    entered = scene.entry.max() + 1 - settings.vehicles
    return Flow(
        inside / lane_km_seconds,
        speeds * 3.6 / lane_km_seconds,
        entered / 4 / minutes * 60,
        int(scene.crashed.sum()),
        np.array(seconds),
    )


def shock_speeds(jammed: Flow) -> tuple[float, float]:
    """The speed of a jam's upstream front, km/h, while it passes the section.

    It is measured, and computed from the flows and the densities of up to 500 m on both sides of
    the front (Rankine and Hugoniot), leaving out 200 m in between.
    """
    counts, sums = jammed.cells[:, :, 0], jammed.cells[:, :, 1]
    is_slow = (counts > 0) & (sums < FRONT_MPS * counts)
    front = np.where(is_slow.any(axis=1), is_slow.argmax(axis=1), 0)
    passes = np.nonzero((front * CELL_M >= SECTION_M[0]) & (front * CELL_M < SECTION_M[1]))[0]
    measured = float(np.polyfit(passes, front[passes] * CELL_M, 1)[0]) * 3.6
    free, jam = (
        np.mean([jammed.cells[t, front[t] + a : front[t] + b].mean(axis=0) for t in passes], axis=0)
        for a, b in ((-5, -1), (1, 5))
    )
    return measured, float((jam[1] - free[1]) / (jam[0] - free[0])) * 3.6


def main(minutes: float, seconds: float, figure: Path) -> None:
    drawn, axes = panels(3, 4.2, 3.4)
    rows: list[dict[str, Any]] = []
    for k, (profile, desired) in enumerate(DRIVERS.items()):
        p = PROFILES[profile].idm_mobil
        limit = critical_density(p, desired)
        densities = limit * np.linspace(0.8, 1.2, 17)
        rates, _ = ring(profile, desired, densities, seconds)
        found = float(np.interp(0.0, rates, densities))
        theory = [growth_rate(density, p, desired) for density in densities]
        row = {"profile": profile, "limit of linear theory": limit, "on the ring": found}
        rows.append({**row, "difference": found / limit - 1})
        axes[0].plot(densities / limit, 1000 * np.array(theory), color=SERIES[k], label=profile)
        axes[0].plot(densities / limit, 1000 * rates, "o", color=SERIES[k], ms=4)
    # With highway-env's constants, vehicles reverse in such waves and collide.
    dense = np.linspace(0.8, 1.8, 21)
    _, speeds = ring(profile, desired, limit * dense, 2 * seconds, LARGE_M)
    for extreme, label in ((speeds.max(axis=1), "fastest"), (speeds.min(axis=1), "slowest")):
        axes[1].plot(dense, extreme, color=SERIES[k], ls="-" if label == "fastest" else "--")
        axes[1].text(dense[-1], extreme[-1], label, ha="right", va="bottom")
    axes[0].axhline(0, color=EDGE, lw=0.8)
    axes[0].set(xlabel="density / critical density", ylabel="growth of a wave, 1/1000 s")
    axes[0].legend(frameon=False)
    axes[1].set(xlabel="density / critical density", ylabel="speeds after an hour, m/s")
    columns = {"limit of linear theory": ".2f", "on the ring": ".2f", "difference": "+.1%"}
    print(markdown(Table.plain(rows, ("profile",), columns)), end="\n\n")

    began = time.process_time()
    flows = {flow: open_road(flow, minutes) for flow in (500.0, 1000.0, 1500.0, 2000.0)}
    each_s = (time.process_time() - began) / len(flows)
    began = time.process_time()
    busiest = open_road(2000.0, 60.0)
    hour_s = time.process_time() - began
    jams = {
        speed: open_road(2000.0, minutes, speed, changes_lanes=False) for speed in (2.0, 3.0, 4.0)
    }
    roads = {(f"{flow:.0f}", "none"): each for flow, each in flows.items()}
    roads |= {("2000", f"{speed:.0f} m/s"): each for speed, each in jams.items()}
    names = ("density", "flow", "entered", "crashed")
    rows = [
        {"inflow": inflow, "bottleneck": bottleneck, **dict(zip(names, each, strict=False))}
        for (inflow, bottleneck), each in roads.items()
    ]
    shocks = [
        {"bottleneck": f"{speed:.0f} m/s", **dict(zip(FRONTS, shock_speeds(each), strict=True))}
        for speed, each in jams.items()
    ]
    columns = dict.fromkeys(("entered", "density", "flow"), ".1f") | {"crashed": ".0f"}
    print(markdown(Table.plain(rows, ("inflow", "bottleneck"), columns)), end="\n\n")
    of_fronts = dict.fromkeys(FRONTS, ".1f")
    print(markdown(Table.plain(shocks, ("bottleneck",), of_fronts)), end="\n\n")
    print(
        f"An hour of 5 km, 4 lanes and 2,000 vehicles per hour and lane: {hour_s:.1f} s of one "
        f"core, {busiest.crashed} of {busiest.entered_per_h * 4:.0f} vehicles crashed.\n"
        f"Each of the other flows took {each_s:.1f} s."
    )
    for k, group in enumerate((flows, jams)):
        points = np.array([(each.density_per_km, each.flow_per_h) for each in group.values()])
        axes[2].plot(*points.T, "os"[k], color=SERIES[k], label=("free", "bottleneck")[k])
    p = PROFILES["naturalistic"].idm_mobil.model_copy(update={"time_headway_s": 1.0})
    densities = np.linspace(5, 130, 100)
    flow = [density * equilibrium(density, p, 30.0) * 3.6 for density in densities]
    axes[2].plot(densities, flow, color=EDGE, lw=0.8, label="equilibrium of IDM")
    axes[2].set(xlabel="density, vehicles per km and lane", ylabel="flow, vehicles per h and lane")
    axes[2].legend(frameon=False)
    save(drawn, figure)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=20.0, help="of each open road")
    parser.add_argument("--seconds", type=float, default=1800.0, help="of each ring")
    parser.add_argument("--figure", type=Path, default=Path("docs/open-road.webp"))
    arguments = parser.parse_args()
    main(arguments.minutes, arguments.seconds, arguments.figure)

"""How many collisions with hazards BRAKE avoids: `python tools/plan_brake.py RUNS OUTPUT`.

RUNS is the folder of `tools/plan.py`. The collisions are those of the CHARMS that ships. Until some
decisions before the collision, the ego repeats its actions; from then on, it only brakes. OUTPUT
gets `plan-brake.md`.
"""

import argparse
from pathlib import Path

import numpy as np

from charms_bench.episodes.avoidability import collisions
from charms_bench.episodes.recorded_cell import RecordedCell, find_cells
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import open_finished

EGO = "CHARMS, seed 3012"
CELLS = (("sealed-r157", "Deceleration"), ("sealed-hazards", None))
BEFORE = (2, 4, 6, 8, 10)
"""Decisions before the collision, of a third of a second each."""
AFTERWARDS = 6
"""Decisions that are simulated after the moment of the collision."""


def avoided(cell: RecordedCell) -> dict[str, int | str]:
    """How many collisions of a cell do not happen if the ego brakes in time."""
    seeds = np.array(collisions(cell), dtype=np.uint64)
    record: dict[str, int | str] = {"scenario": cell.cell.traffic.title, "collisions": seeds.size}
    if not seeds.size:
        return record
    simulation = cell.simulation(seeds.size)
    simulation.reset(seeds)
    taken = []
    while simulation.scene.active.any():
        simulation.step()
        taken.append(simulation.action[simulation.ego_vehicles].copy())
    ends = simulation.steps.copy()
    moments = {f"{each} decisions before": each for each in BEFORE}
    for name, before in (moments | {"from the start": ends.max()}).items():
        again = cell.simulation(seeds.size, is_ego_outside=True)
        again.reset(seeds)
        brake = again.action_names.index("BRAKE")
        for step in range(ends.max() + AFTERWARDS):
            if again.scene.active.any():
                same = taken[min(step, len(taken) - 1)]
                again.step(np.where(step >= ends - before, brake, same))
        record[name] = int((~again.failed).sum())
    return record


def main() -> None:
    """Writes the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("runs", type=Path)
    parser.add_argument("output", type=Path)
    given = parser.parse_args()
    records = [
        avoided(cell)
        for folder, traffic in CELLS
        for cell in find_cells(open_finished(given.runs / folder), Path(), EGO, traffic)
    ]
    forms = {name: ".0f" for record in records for name in record if name != "scenario"}
    text = markdown(Table.plain(records, ("scenario",), forms))
    (given.output / "plan-brake.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()

"""The table of two futures of one episode."""

from dataclasses import asdict

from charms_bench.episodes.what_if import WhatIf
from charms_bench.foundation.names import shown_agent
from charms_bench.report.table import Column, Table

COLUMNS = (
    Column("ending", definition="How the episode ended for the vehicle, and when"),
    Column(
        "lasted_s", "s", "Time from the decision until the vehicle crashed or the episode ended",
        form=".1f",
    ),
    Column(
        "ttc_min_s", "s", "Smallest time to collision with the leader, bumper to bumper", form=".2f"
    ),
    Column("gap_min_m", "m", "Smallest gap to the leader, bumper to bumper", form=".1f"),
    Column("speed_mps", "m/s", "Mean speed", form=".1f"),
    Column("lane_changes", "", "Changes of the nearest lane", form=".0f"),
    Column("hard_braking_s", "s", "How long it braked harder than 2.5 m/s²", form=".1f"),
    Column("braking_max_mps2", "m/s²", "Its strongest braking", form=".1f"),
)  # fmt: skip


def what_if_table(found: WhatIf) -> Table:
    """One row per vehicle and future; measures are taken from the decision on."""

    def who(vehicle: int, ego: str) -> str:
        return ego if vehicle == found.recorded.ego else f"vehicle {vehicle}"

    records = [
        {
            **asdict(future),
            "vehicle": who(future.vehicle, "ego"),
            "future": name,
            "driver": shown_agent(future.agent),
        }
        for pair in found.futures()
        for name, future in zip(("recorded", "what if"), pair, strict=True)
    ]
    driver, seated = shown_agent(found.agent), who(found.vehicle, "the ego")
    since_s = found.recorded.t_s[found.start]
    return Table.from_records(
        records,
        "what-if",
        f"Episode {found.recorded.episode}: {driver} drives {seated} from decision {found.step} on",
        ("vehicle", "future", "driver"),
        COLUMNS,
        note=f"Measured from decision {found.step}, at t = {since_s:z.1f} s, until the "
        "vehicle crashed or the episode ended.",
    )

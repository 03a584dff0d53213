"""What drivers do to other vehicles and what other vehicles do to them: conflicts, gaps, PET, RSS.

The events are counted during the simulation, for every vehicle (`columns.DRIVER`), as
`recording.rss`, `recording.conflict_onsets`, `recording.encroachment` and `recording.lane_changes`
define them. So their thresholds cannot be changed afterwards.
"""

from collections.abc import Callable

import polars as pl

from charms_bench.metrics.metric import Metric
from charms_bench.recording.columns import DRIVER_SUMS, keys_of

_PER_1000KM = {
    "gaps_lost": "lane changes aborted because another vehicle took the gap",
    "gaps_taken": "gaps taken from vehicles that then aborted their lane changes",
    "conflicts_to": "conflicts (TTC below 1.5 s) caused by another vehicle",
    "conflicts_by": "conflicts caused (TTC below 1.5 s)",
    "near_misses_to": "near misses (TTC below 1.5 s or DRAC above 3.35 m/s², and no collision) "
    "caused by another vehicle",
    "near_misses_by": "near misses caused (TTC below 1.5 s or DRAC above 3.35 m/s², and no "
    "collision)",
    "hard_braking_to": "times of braking by more than 2 m/s² within 2 s after another vehicle's "
    "lane change",
    "hard_braking_by": "lane changes after which the new follower brakes by more than 2 m/s² "
    "within 2 s",
}
"""The events of a driver, by the column that counts them."""
Sums = Callable[[str], pl.Expr]
"""The expression of a column of `columns.DRIVER`."""


def conduct_of(drivers: pl.DataFrame) -> pl.DataFrame:
    """The driver rows as one row per ego and episode: `*_of_ego` and `*_of_traffic`."""
    return drivers.group_by(keys_of(drivers)).agg(
        pl.col(name).filter(is_it).sum().cast(pl.Float64).alias(f"{name}_of_{who}")
        for who, is_it in (("ego", pl.col("is_ego")), ("traffic", ~pl.col("is_ego")))
        for name in DRIVER_SUMS
    )


def _rate(of: Sums, name: str, what: str, who: str, prefix: str = "", km: int = 1000) -> Metric:
    short, distance = ("km", "km") if km == 1 else (f"{km}km", f"{km:,} km")
    return Metric(
        name=f"{prefix}{name}_per_{short}",
        unit=f"1/{distance}",
        description=f"{what}, per {distance} driven by {who}",
        rests_on="vehicles",
        sums=(of("vehicles"), of("distance_m") / (1e3 * km), of(name)),
        interval="rate",
    )


def conduct_metrics(of: Sums, who: str, prefix: str = "") -> tuple[Metric, ...]:
    """The metrics of vehicles, `who` in words, from the sums of their driver rows."""
    rates = (_rate(of, name, what, who, prefix) for name, what in _PER_1000KM.items())
    encroachments = (
        Metric(
            name=f"{prefix}pet_below_2s_{side}",
            unit="",
            description="proportion of the post-encroachment times of at most 5 s that are below "
            f"2 s, {when} {who}",
            rests_on="encroachments",
            sums=(of(f"pet_{side}"), of(f"pet_below_2s_{side}")),
            interval="proportion",
        )
        for side, when in (
            ("to", "after other vehicles change lanes ahead of"),
            ("by", "after lane changes of"),
        )
    )
    dangerous = (
        Metric(
            name=f"{prefix}rss_{side}",
            unit="",
            description=f"proportion of the driving time of {who} in which {what} by RSS",
            rests_on="vehicles",
            sums=(of("vehicles"), of("time_s"), of(f"rss_{side}_s")),
        )
        for side, what in (
            ("by", "a vehicle ahead is too close"),
            ("to", "a vehicle behind is too close"),
        )
    )
    return (*rates, *encroachments, *dangerous)


def _per_vehicle_time(name: str, unit: str, column: str, description: str) -> Metric:
    sums = (pl.col("vehicles"), pl.col("time_s"), pl.col(column))
    return Metric(name, unit, description, "vehicles", sums)


EGO_CONDUCT = conduct_metrics(lambda name: pl.first(f"{name}_of_ego"), "the ego")
TRAFFIC_CONDUCT = conduct_metrics(
    lambda name: pl.first(f"{name}_of_traffic"), "the traffic", "traffic_"
)
_VEHICLES = "the driver's vehicles"
OF_DRIVERS = (
    *(
        Metric(
            name=name,
            unit="",
            description=f"proportion of {_VEHICLES} that {what}",
            rests_on="vehicles",
            sums=(pl.col("vehicles"), pl.col(column)),
            interval="proportion",
        )
        for name, column, what in (
            ("crashed", "crashed", "collide or leave the road within an episode"),
            ("crashed_at_fault", "at_fault", "crash within an episode and are at fault"),
        )
    ),
    _rate(pl.col, "rear_end_striking", "collisions with the rear of another vehicle", _VEHICLES),
    _rate(pl.col, "rear_end_struck", "collisions with the front of another vehicle", _VEHICLES),
    _rate(pl.col, "side", "side collisions", _VEHICLES),
    *conduct_metrics(pl.col, _VEHICLES),
    _per_vehicle_time(
        "speed_mean", "m/s", "distance_m", f"distance of {_VEHICLES} divided by their time"
    ),
    _per_vehicle_time(
        "harsh", "", "harsh_s", "proportion of time accelerating or braking by more than 2.5 m/s²"
    ),
    _rate(pl.col, "lane_changes", "lane changes", _VEHICLES, km=1),
)
"""The metrics of one driver in an episode, from its driver row alone."""

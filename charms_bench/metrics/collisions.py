"""How often the ego, or the traffic around it, collides or leaves the road."""

import polars as pl

from charms_bench.metrics.metric import EPISODES, Metric, per_episode, proportion_of_episodes

ENDING = pl.first("ending")
STRUCK = pl.first("struck")
AT_FAULT = pl.coalesce(pl.first("at_fault"), pl.first("at_fault_on_road"))
"""On the straight road and on others; null if the ego did not crash, or it is undecided."""
ENDED_BADLY = ENDING.is_in(["rear_end", "side", "off_road"])


def _per_1000km(kind: str, what: str, happened: pl.Expr) -> Metric:
    return Metric(
        name=f"{kind}_per_1000km",
        unit="1/1,000 km",
        description=f"{what}, per 1,000 km driven by the ego",
        rests_on="episodes",
        sums=(EPISODES, pl.first("distance_m") / 1e6, happened),
        interval="garwood",
    )


OF_EGO = (
    proportion_of_episodes(
        "crashed_episodes",
        ENDED_BADLY,
        "proportion of episodes in which the ego collides or leaves the road",
    ),
    proportion_of_episodes(
        "crashed_at_fault",
        AT_FAULT,
        "proportion of episodes in which the ego crashes and is at fault: it leaves the road, "
        "strikes a vehicle ahead, cuts in, or began last to move out of its lane",
    ),
    _per_1000km("crashes", "collisions of the ego and departures from the road", ENDED_BADLY),
    _per_1000km("rear_end", "rear-end collisions of the ego", ENDING == "rear_end"),
    _per_1000km(
        "rear_end_striking", "rear-end collisions in which the ego struck its leader", ~STRUCK
    ),
    _per_1000km(
        "rear_end_struck", "rear-end collisions in which the ego was struck by its follower", STRUCK
    ),
    proportion_of_episodes(
        "rear_end_striking",
        ~STRUCK,
        "proportion of the ego's rear-end collisions in which the ego struck its leader",
        rests_on="rear-end collisions",
        counts=STRUCK.is_not_null(),
    ),
    _per_1000km("side", "side collisions of the ego", ENDING == "side"),
    _per_1000km("off_road", "departures of the ego from the road", ENDING == "off_road"),
)
OF_TRAFFIC = (
    per_episode(
        "traffic_crashed",
        "",
        pl.first("traffic_crashed"),
        "proportion of the other vehicles that collide or leave the road within an episode",
        rests_on="vehicles",
        counts=pl.first("traffic_vehicles"),
        interval="proportion",
    ),
    Metric(
        name="traffic_crashes_per_1000km",
        unit="1/1,000 km",
        description="other vehicles that collide or leave the road, per 1,000 km driven by them",
        rests_on="vehicles",
        sums=(
            pl.first("traffic_vehicles"),
            pl.first("traffic_distance_m") / 1e6,
            pl.first("traffic_crashed"),
        ),
        interval="rate",
    ),
)

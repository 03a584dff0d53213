"""What one of highway-env's roads adds: the ego's goal, and how a vehicle enters.

The entering vehicle is the one that leaves the ramp of a merge, and the ego in a roundabout; see
`roads.entries`. The post-encroachment time is that of Allen, Shin & Cooper (1978).
"""

import polars as pl

from charms_bench.metrics.collisions import AT_FAULT, ENDED_BADLY, ENDING
from charms_bench.metrics.metric import Metric, MetricSet, per_episode, proportion_of_episodes

REACHED = ENDING == "goal"
IS_UNDECIDABLE = ENDED_BADLY & pl.first("has_goal").is_not_null()
"""A crash on one of highway-env's roads: on the straight one, fault is always decided."""


def _of_entry(column: str, name: str, unit: str, description: str, rests_on: str) -> Metric:
    """The mean of a column of episodes, over those that have it."""
    value = pl.first(column)
    return per_episode(name, unit, value, description, rests_on, value.is_not_null())


ROADS = MetricSet(
    name="roads",
    version=1,
    metrics=(
        proportion_of_episodes(
            "goal_reached",
            REACHED,
            "proportion of episodes in which the ego reaches the goal of its road, if it has one",
            counts=pl.first("has_goal").fill_null(value=False),
        ),
        per_episode(
            "time_to_goal",
            "s",
            pl.when(REACHED).then(pl.first("duration_s")),
            "time in which the ego reaches the goal of its road",
            rests_on="episodes with the goal reached",
            counts=REACHED,
        ),
        proportion_of_episodes(
            "fault_undecided",
            AT_FAULT.is_null() & IS_UNDECIDABLE,
            "proportion of the ego's crashes in which nobody is found to be at fault or not",
            rests_on="crashes",
            counts=IS_UNDECIDABLE,
        ),
        _of_entry(
            "entry_lead_gap_m",
            "entry_lead_gap",
            "m",
            "gap to the leader when the entering vehicle comes to the main road, up to 100 m",
            "entries behind a leader",
        ),
        _of_entry(
            "entry_lag_gap_m",
            "entry_lag_gap",
            "m",
            "gap to the follower when the entering vehicle comes to the main road, up to 100 m",
            "entries ahead of a follower",
        ),
        _of_entry(
            "entry_braking_mps2",
            "entry_imposed_braking",
            "m/s²",
            "strongest braking of that follower within 2 s, 0 if it does not brake",
            "entries ahead of a follower",
        ),
        _of_entry(
            "entry_pet_s",
            "entry_pet",
            "s",
            "post-encroachment time of the entering vehicle and that follower, up to 5 s",
            "entries with a PET of at most 5 s",
        ),
    ),
)

"""How often an ego commands a lane that does not exist, from its recorded decisions."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import polars as pl

from charms_bench.recording.columns import keys_of
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction

NOTABLE = 0.05
"""The proportion from which an ego's decisions are worth a remark."""
MEANING = "A change to a lane that does not exist has no effect; an action mask rules it out."


class MissingLanes(NamedTuple):
    """Decisions of an ego, and how many of them commanded a lane that does not exist."""

    decisions: int
    left: int
    """`LANE_LEFT`, or another change to the left, on the leftmost lane."""
    right: int
    """`LANE_RIGHT`, or another change to the right, on the rightmost lane."""

    def remark(self) -> str:
        """A sentence without its subject; empty if the proportion is not notable."""
        if self.left + self.right < NOTABLE * self.decisions or not self.decisions:
            return ""
        proportions = (self.left + self.right, self.left, self.right)
        both, left, right = (
            f"{each / self.decisions:.0%}".replace("%", " %") for each in proportions
        )
        return (
            f"chose a lane that does not exist in {both} of its decisions "
            f"(LANE_LEFT {left}, LANE_RIGHT {right})"
        )


def missing_lanes(
    parts: Iterable[pl.DataFrame],
    lanes: int | None,
    actions: Sequence[MetaAction] = DEFAULT_ACTIONS,
) -> MissingLanes:
    """Counts the decisions of an ego with the step rows `parts` on a road with `lanes` lanes.

    The actions are the ego's meta-actions. Where the number of `lanes` differs from place to place,
    it is None, and a lane does not exist if the command to it has not changed the target lane.

    A decision counts from the second of its episode on, because a row has the state after its
    decision. A policy that decides more rarely than there are rows repeats its action in the rows
    between; these are left out, as far as its changes of action tell. The rule for a lane that does
    not exist is that of `world.action_mask`. An ego without meta-actions has no decisions.
    """
    before = pl.col("lane", "target_lane", "action").shift()
    rows = pl.concat(
        [
            part.select(
                "step", "action", "target_lane", before.over(keys_of(part)).name.prefix("last_")
            )
            for part in parts
        ]
    ).drop_nulls()
    changes = rows.filter(pl.col("action") != pl.col("last_action"))["step"].unique()
    period = math.gcd(*(changes - 1).to_list()) or 1
    rows = rows.filter((pl.col("step") - 1) % period == 0)

    def count(side: int, edge: int) -> int:
        changing = [k for k, action in enumerate(actions) if action.lanes == side]
        at = pl.col("target_lane") if lanes is None else pl.lit(edge)
        on_edge = (pl.col("last_lane") == at) & (pl.col("last_target_lane") == at)
        return rows.filter(pl.col("action").is_in(changing) & on_edge).height

    return MissingLanes(rows.height, count(-1, 0), count(1, (lanes or 0) - 1))

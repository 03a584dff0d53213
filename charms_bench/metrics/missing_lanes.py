"""How often an ego commands a lane that does not exist, from its recorded decisions."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import polars as pl

from charms_bench.world.actions import LANE_LEFT, LANE_RIGHT

NOTABLE = 0.05
"""The proportion from which an ego's decisions are worth a remark."""
MEANING = "A change to a lane that does not exist has no effect; an action mask rules it out."


class MissingLanes(NamedTuple):
    """Decisions of an ego, and how many of them commanded a lane that does not exist."""

    decisions: int
    left: int
    """`LANE_LEFT` on the leftmost lane."""
    right: int
    """`LANE_RIGHT` on the rightmost lane."""

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


def missing_lanes(parts: Iterable[pl.DataFrame], lanes: int) -> MissingLanes:
    """Counts the decisions of an ego whose step rows are `parts`, on a road of so many lanes.

    A decision counts from the second of its episode on, because a row has the state after its
    decision. A policy that decides more rarely than there are rows repeats its action in the rows
    between; these are left out, as far as its changes of action tell. The rule for a lane that does
    not exist is that of `world.action_mask`. An ego without meta-actions has no decisions.
    """
    before = [pl.col(name).shift().over("episode") for name in ("lane", "target_lane", "action")]
    rows = pl.concat(
        [
            part.select("step", "action", *(each.name.prefix("last_") for each in before))
            for part in parts
        ]
    ).drop_nulls()
    changes = rows.filter(pl.col("action") != pl.col("last_action"))["step"].unique()
    period = math.gcd(*(changes - 1).to_list()) or 1
    rows = rows.filter((pl.col("step") - 1) % period == 0)

    def count(action: int, edge: int) -> int:
        on_edge = (pl.col("last_lane") == edge) & (pl.col("last_target_lane") == edge)
        return rows.filter((pl.col("action") == action) & on_edge).height

    return MissingLanes(rows.height, count(LANE_LEFT, 0), count(LANE_RIGHT, lanes - 1))

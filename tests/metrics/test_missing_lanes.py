"""Commands to lanes that do not exist are counted from the rows of decisions."""

import polars as pl

from charms_bench.metrics.missing_lanes import MissingLanes, missing_lanes
from charms_bench.world.actions import FASTER, IDLE, LANE_LEFT, LANE_RIGHT, MetaAction


def rows(*decisions: tuple[int | None, int, int], episode: int = 0) -> pl.DataFrame:
    """Step rows of an episode: the action, and the lane and the target lane after it."""
    action, lane, target = zip(*decisions, strict=True)
    columns = {"action": action, "lane": lane, "target_lane": target}
    steps = range(1, len(decisions) + 1)
    return pl.DataFrame({"episode": [episode] * len(steps), "step": steps, **columns})


def test_what_counts_is_the_lane_before_the_decision() -> None:
    arriving = rows((IDLE, 1, 1), (LANE_LEFT, 1, 0), (LANE_LEFT, 0, 0), (LANE_LEFT, 0, 0))
    turning_back = rows((IDLE, 2, 1), (LANE_RIGHT, 2, 2), (LANE_RIGHT, 2, 2), episode=1)
    assert missing_lanes([arriving, turning_back], lanes=3) == MissingLanes(5, 1, 1)


def test_a_policy_that_decides_every_third_row_is_not_counted_in_between() -> None:
    held = [(LANE_LEFT, 0, 0)] * 3
    steps = rows(*[(IDLE, 1, 1)] * 3, (LANE_LEFT, 1, 0), *held[:2], *held, *[(FASTER, 0, 0)] * 3)
    assert missing_lanes([steps], lanes=3) == MissingLanes(3, 1, 0)


def test_an_ego_without_meta_actions_has_no_decisions_and_no_remark() -> None:
    found = missing_lanes([rows((None, 0, 0), (None, 0, 0))], lanes=3)
    assert (found, found.remark()) == (MissingLanes(0, 0, 0), "")


def test_only_a_notable_proportion_is_worth_a_remark() -> None:
    assert MissingLanes(100, 2, 2).remark() == ""
    said = (
        "chose a lane that does not exist in 14 % of its decisions (LANE_LEFT 9 %, LANE_RIGHT 5 %)"
    )
    assert MissingLanes(100, 9, 5).remark() == said


def test_the_lane_changes_are_those_of_the_policys_own_actions() -> None:
    actions = MetaAction("STAY"), MetaAction("GO RIGHT AND FAST", lanes=1, profile_step=1)
    steps = rows((0, 1, 1), (1, 1, 2), (1, 2, 2), (1, 2, 2))
    assert missing_lanes([steps], 3, actions) == MissingLanes(3, 0, 1)


def test_where_lanes_end_a_command_that_does_not_change_the_target_lane_counts() -> None:
    changing = (LANE_RIGHT, 0, 1), (LANE_RIGHT, 1, 1), (IDLE, 1, 1)
    steps = rows((IDLE, 0, 0), *changing, (LANE_RIGHT, 1, 1), (LANE_LEFT, 1, 0), (LANE_LEFT, 0, 0))
    assert missing_lanes([steps], lanes=None) == MissingLanes(6, 0, 1)

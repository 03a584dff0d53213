"""The names of metrics in the headings of tables and figures, in every view.

Stored tables keep the names of metrics; a heading follows from the name alone.
"""

import re
from functools import cache

LABELS = {
    "collision_rate": "Crashes per decision",
    "crashed_episodes": "Crashed episodes",
    "crashed_at_fault": "Crashed at fault",
    "crashed": "Crashed",
    "crashes_per_1000km": "Crashes per 1,000 km",
    "rear_end_per_1000km": "Rear-end collisions per 1,000 km",
    "rear_end_striking_per_1000km": "Rear-end collisions, striking, per 1,000 km",
    "rear_end_struck_per_1000km": "Rear-end collisions, struck, per 1,000 km",
    "rear_end_striking": "Rear-end collisions in which the ego strikes",
    "side_per_1000km": "Side collisions per 1,000 km",
    "off_road_per_1000km": "Departures from the road per 1,000 km",
    "scenarios_left_out": "Scenarios left out",
    "strongest_braking": "Strongest braking",
    "goal_reached": "Goal reached",
    "time_to_goal": "Time to the goal",
    "traffic_crashed": "Crashed vehicles in traffic",
    "traffic_crashes_per_1000km": "Crashes in traffic per 1,000 km",
    "conflict_episodes": "Episodes with a conflict",
    "conflicts_per_1000km": "Conflicts per 1,000 km",
    "conflicts_by_ego": "Conflicts after the ego’s lane change",
    "conflicts_by_another": "Conflicts after another vehicle’s lane change",
    "conflicts_by_closing_in": "Conflicts by closing in",
    "planar_conflict_episodes": "Episodes with a planar conflict",
    "planar_conflicts_per_1000km": "Planar conflicts per 1,000 km",
    "planar_ttc_min": "Smallest planar TTC",
    "ttc_min": "Smallest TTC",
    "ttc_below_{}s": "TTC below {} s",
    "ttc_below_{}s_closing": "TTC below {} s while closing in",
    "rear_ttc_below_{}s": "Follower’s TTC below {} s",
    "tet": "Time exposed TTC (TET)",
    "tit": "Time integrated TTC (TIT)",
    "drac_max": "Largest DRAC",
    "drac_above_{}": "DRAC above {} m/s²",
    "time_headway_mean": "Mean time headway",
    "time_headway_below_{}s": "Time headway below {} s",
    "centre_headway_below_{}s": "Headway between centres below {} s",
    "closing_speed_below_{}s_mean": "Mean closing speed as the headway falls below {} s",
    "dhw_mean": "Mean distance headway",
    "dhw_std": "Distance headway, std",
    "speed_mean": "Mean speed",
    "speed_std": "Speed, std",
    "traffic_speed_mean": "Mean speed of the traffic",
    "acc_mean": "Mean positive acceleration",
    "acc_std": "Acceleration, std",
    "harsh_acc_rate": "Harsh acceleration",
    "harsh_acc_rate_all_steps": "Harsh acceleration, all decisions",
    "harsh": "Harsh acceleration",
    "mean_acceleration_std": "Mean acceleration, std",
    "strong_acceleration_rate": "Strong acceleration",
    "acceleration_reversals_per_min": "Reversals of the acceleration per minute",
    "jerk_rms": "Jerk, RMS",
    "yaw_std": "Steering angle, std",
    "yaw_rate_rms": "Yaw rate, RMS",
    "lane_changes_per_km": "Lane changes per km",
    "lane_changes_undone": "Lane changes undone",
    "lane_change_duration_mean": "Mean duration of lane changes",
    "lead_gap_mean": "Mean accepted lead gap",
    "lag_gap_mean": "Mean accepted lag gap",
    "imposed_braking_mean": "Mean imposed braking",
    "imposed_braking_above_{}": "Imposed braking above {} m/s²",
    "interaction_density": "Interaction density",
    "gaps_lost_per_1000km": "Aborted lane changes per 1,000 km",
    "gaps_taken_per_1000km": "Lane changes of others made to abort per 1,000 km",
    "conflicts_to_per_1000km": "Conflicts caused by others per 1,000 km",
    "conflicts_by_per_1000km": "Conflicts caused per 1,000 km",
    "near_misses_to_per_1000km": "Near misses caused by others per 1,000 km",
    "near_misses_by_per_1000km": "Near misses caused per 1,000 km",
    "hard_braking_to_per_1000km": "Hard braking caused by others per 1,000 km",
    "hard_braking_by_per_1000km": "Hard braking caused per 1,000 km",
    "pet_below_2s_to": "PET below 2 s after others’ lane changes",
    "pet_below_2s_by": "PET below 2 s after own lane changes",
    "rss_by": "Too close to the vehicle ahead (RSS)",
    "rss_to": "Vehicle behind too close (RSS)",
}
"""By name of the metric; `{}` stands for a threshold."""
NEAR_LEADER = {
    "ttc_below_3s": "TTC below 3 s near a leader",
    "speed_mean": "Mean speed near a leader",
    "acc_std": "Acceleration near a leader, std",
    "harsh_acc_rate": "Harsh acceleration near a leader",
}
"""Metrics that the set `paper` measures only with a leader within 50 m, and `standard` always."""
SETS = {
    "paper": "Metrics of the paper",
    "standard": "Standard metrics",
    "roads": "Metrics of roads",
    "scenarios": "Metrics of scenarios",
}
KEYS = {
    "traffic": "traffic model",
    "ego \\ traffic": "ego \\ traffic model",
    "metric_set": "metric set",
    "dhw": "headway",
}
"""By name of a key, which is what the labels of rows are, or of a quantity."""
_THRESHOLD = r"(\d+(?:_\d+)?)"


@cache
def label_of(metric: str, metric_set: str = "") -> str:
    """The heading of a metric of a set; one without a label keeps the words of its name."""
    if metric in NEAR_LEADER and metric_set.startswith("paper-"):
        return NEAR_LEADER[metric]
    for name, label in LABELS.items():
        if found := re.fullmatch(name.replace("{}", _THRESHOLD), metric):
            return label.format(*(each.replace("_", ".") for each in found.groups()))
    if metric.startswith("traffic_") and (of := label_of(whose := metric[8:])) != in_words(whose):
        return f"Traffic: {of[0].lower() if of[1].islower() else of[0]}{of[1:]}"
    return in_words(metric)


def key_label_of(key: str) -> str:
    """The heading of a key or a quantity."""
    return KEYS.get(key, key)


def set_label_of(label: str) -> str:
    """The heading of a metric set: `Standard metrics (ttc_s=2)` for `standard-5(ttc_s=2)`.

    A set without a heading keeps its label.
    """
    found = re.fullmatch(r"(.+?)-\d+(?:\((.*)\))?", label)
    if found is None or found[1] not in SETS:
        return label
    return SETS[found[1]] + f" ({found[2]})" * bool(found[2])


def in_words(name: str) -> str:
    """The words of a name without the unit, which headings add."""
    return re.sub(r"_(s|m|mps|mps2)$", "", name).replace("_", " ")

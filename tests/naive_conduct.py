"""A plain version of `recording.driver_sums`: it reads whole trajectories and keeps no state."""

from collections import Counter
from typing import Any

import numpy as np

from charms_bench.world.road import Straight

History = dict[str, np.ndarray]
"""Arrays [T + 1, N] of one scene: the beginning and every decision."""
NAMES = (
    "x", "y", "speed", "direction_x", "direction_y", "acceleration", "lane", "target_lane",
    "crashed", "collision", "length", "width",
)  # fmt: skip


def ahead(h: History, t: int, i: int, lane: int, road: Straight, sign: int = 1) -> int:
    """The nearest vehicle ahead of i on a lane, or behind it if sign is -1; -1 for none."""
    best = -1
    for j in range(h["x"].shape[1]):
        x, y = h["x"][t, j], h["y"][t, j]
        distance = sign * (x - h["x"][t, i])
        on_road = -5.0 <= x < road.road_length + 5.0
        on_lane = on_road and abs(y - lane * road.lane_width) <= road.lane_width / 2 + 1
        if j == i or not on_lane or distance <= 0:
            continue
        if best < 0 or distance < sign * (h["x"][t, best] - h["x"][t, i]):
            best = j
    return best


def bumper_gap(h: History, t: int, i: int, j: int) -> float:
    """From the front of i to the rear of j."""
    return h["x"][t, j] - h["length"][t, j] / 2 - (h["x"][t, i] + h["length"][t, i] / 2)


def lost_at(h: History, i: int, road: Straight) -> int:
    """The first decision at which i has collided or left the road; T + 1 if it never has."""
    centre = h["lane"][1:, i] * road.lane_width
    off_road = abs(h["y"][1:, i] - centre) > road.lane_width / 2
    off_road |= (h["x"][1:, i] < -5.0) | (h["x"][1:, i] >= road.road_length + 5.0)
    gone = off_road | h["crashed"][1:, i]
    return int(gone.argmax()) + 1 if gone.any() else len(gone) + 1


def last_change(h: History, t: int, i: int, name: str, since: int) -> int:
    """The last decision up to t at which a lane of i changed; `since` if it never did."""
    changed = np.nonzero(np.diff(h[name][: t + 1, i]))[0]
    return int(changed[-1]) + 1 if changed.size else since


def conduct(h: History, dt: float, road: Straight, at_fault: list[bool]) -> list[Counter[str]]:
    """What each vehicle of a scene did, by column; `at_fault` says it of those that collide."""
    decisions, vehicles = h["x"].shape[0] - 1, h["x"].shape[1]
    lost = [lost_at(h, i, road) for i in range(vehicles)]
    sums: list[Counter[str]] = [Counter() for _ in range(vehicles)]
    for i in range(vehicles):
        driving = range(1, lost[i])
        _driving(h, i, lost[i], dt, sums[i])
        if lost[i] < len(h["x"]):
            sums[i]["at_fault"] = int(at_fault[i] or not h["crashed"][lost[i], i])
        for t in driving:
            _lane_change(h, t, i, lost, dt, road, sums)
            _abandoned(h, t, i, lost, sums)
        _conflicts(h, i, driving, dt, road, sums)
    for t in range(1, decisions + 1):
        _rss(h, t, lost, dt, road, sums)
    return sums


def _driving(h: History, i: int, lost: int, dt: float, mine: Counter[str]) -> None:
    mine["distance_m"] += h["x"][lost - 1, i] - h["x"][0, i]
    mine["time_s"] += (lost - 1) * dt
    mine["harsh_s"] += int((abs(h["acceleration"][1:lost, i]) > 2.5).sum()) * dt
    if lost == len(h["x"]):
        return
    mine["crashed"] += 1
    if h["crashed"][lost, i]:
        kind = ("rear_end_striking", "rear_end_struck", "side")[h["collision"][lost, i] - 1]
        mine[kind] += 1


def _lane_change(
    h: History, t: int, i: int, lost: list[int], dt: float, road: Straight, sums: Any
) -> None:
    lane = h["lane"][t, i]
    if lane == h["lane"][t - 1, i]:
        return
    sums[i]["lane_changes"] += 1
    f, rear = ahead(h, t, i, lane, road, -1), h["x"][t, i] - h["length"][t, i] / 2
    window = [s for s in range(t, t + round(2 / dt)) if s < min(lost[i], len(h["x"]))]
    if f >= 0 and any(not h["crashed"][s, f] and h["acceleration"][s, f] < -2 for s in window):
        sums[i]["hard_braking_by"] += 1
        sums[f]["hard_braking_to"] += 1
    if f < 0 or h["lane"][t, f] != lane or lost[f] <= t:
        return
    front = h["x"][:, f] + h["length"][:, f] / 2
    if front[t] >= rear:
        return
    for s in range(t + 1, len(h["x"])):
        if s >= lost[f] or h["lane"][s, f] != lane:
            return
        if front[s] >= rear:
            pet = (s - 1 - t + (rear - front[s - 1]) / (front[s] - front[s - 1])) * dt
            if pet <= 5:
                for v, side in ((i, "by"), (f, "to")):
                    sums[v][f"pet_{side}"] += 1
                    sums[v][f"pet_{side}_sum_s"] += pet
                    sums[v][f"pet_below_2s_{side}"] += int(pet < 2)
            return
        others = (j for j in range(h["x"].shape[1]) if j != f)
        if any(_cuts_in(h, s, j, f, lost, road) for j in others):
            return


def _cuts_in(h: History, t: int, j: int, f: int, lost: list[int], road: Straight) -> bool:
    lane = h["lane"][t, j]
    return bool(
        t < lost[j]
        and lane != h["lane"][t - 1, j]
        and lane == h["lane"][t, f]
        and ahead(h, t, j, lane, road, -1) == f
    )


def _abandoned(h: History, t: int, i: int, lost: list[int], sums: Any) -> None:
    lane, target = h["lane"][:, i], h["target_lane"][:, i]
    wanted = target[t - 1]
    if wanted == lane[t - 1] or lane[t] != lane[t - 1] or target[t] == wanted:
        return
    sums[i]["abandoned"] += 1
    began = last_change(h, t - 1, i, "target_lane", 0)
    bound = (h["lane"][t] == wanted) | (h["target_lane"][t] == wanted)
    distance = h["x"][t] - h["x"][t, i]
    takers = []
    for side in (distance >= 0, distance < 0):
        there = [j for j in np.nonzero(bound & side)[0] if j != i]
        if there:
            j = min(there, key=lambda j: abs(distance[j]))
            arrived = last_change(h, t, j, "lane", -(10**6))
            came = h["lane"][t, j] != wanted or arrived > began
            heading = h["target_lane"][t, j] == wanted
            if came and heading and lost[j] > t and abs(distance[j]) <= 50:
                takers.append(j)
    if takers and t - began >= 2:
        sums[i]["gaps_lost"] += 1
        sums[min(takers, key=lambda j: abs(distance[j]))]["gaps_taken"] += 1


def _conflicts(h: History, i: int, driving: range, dt: float, road: Straight, sums: Any) -> None:
    events: list[list[Any]] = []  # leader, began, ended, whether it was a conflict
    for t in driving:
        leader = ahead(h, t, i, h["lane"][t, i], road)
        gap = bumper_gap(h, t, i, leader)
        closing = h["speed"][t, i] - h["speed"][t, leader]
        if leader < 0 or gap <= 0 or closing <= 0:
            continue
        conflict, drac = gap / closing < 1.5, closing**2 / (2 * gap)
        if not conflict and drac <= 3.35:
            continue
        if not (events and events[-1][0] == leader and events[-1][2] == t - 1):
            events.append([leader, t, t, False])
        events[-1][2] = t
        events[-1][3] |= conflict
    for leader, began, ended, conflict in events:
        own = last_change(h, began, i, "lane", -(10**6))
        other = last_change(h, began, leader, "lane", -(10**6))
        lane = h["lane"][began, i]
        if h["lane"][began, leader] != lane and h["target_lane"][began, leader] == lane:
            other = began
        if max(own, other) >= began - round(2 / dt):
            leader_began = other > own
        else:
            leader_began = h["acceleration"][began, leader] < -2
        by, to = (leader, i) if leader_began else (i, leader)
        if conflict:
            sums[by]["conflicts_by"] += 1
            sums[to]["conflicts_to"] += 1
        if ended + 1 in driving or ended == len(h["x"]) - 1:
            sums[by]["near_misses_by"] += 1
            sums[to]["near_misses_to"] += 1


def _rss(h: History, t: int, lost: list[int], dt: float, road: Straight, sums: Any) -> None:
    pressed = set()
    for i in range(h["x"].shape[1]):
        if t >= lost[i]:
            continue
        lanes = (h["lane"][t, i] + k for k in (-1, 0, 1))
        fronts = {ahead(h, t, i, lane, road) for lane in lanes if 0 <= lane < road.lanes} - {-1}
        close = {j for j in fronts if is_dangerous(h, t, i, j, road)}
        pressed |= close
        sums[i]["rss_by_s"] += dt * bool(close)
    for j in pressed:
        if t < lost[j]:
            sums[j]["rss_to_s"] += dt


def is_dangerous(h: History, t: int, rear: int, front: int, road: Straight) -> bool:
    """[arXiv 1708.06374, definitions 1 and 6, with the constants of ad-rss-lib]"""
    v = h["speed"][t] * h["direction_x"][t]
    after = v[rear] + 3.5
    safe = v[rear] + 3.5 / 2 + after**2 / (2 * 4) - v[front] ** 2 / (2 * 8)
    gap = bumper_gap(h, t, rear, front)
    left, right = sorted((rear, front), key=lambda j: (h["y"][t, j], j == rear))
    aside = h["speed"][t] * h["direction_y"][t]
    drift = 0.0
    for towards in (aside[left], -aside[right]):
        after = towards + 0.2
        drift += towards + 0.1 + (after**2 / 1.6 if after > 0 else 0)
    side_gap = h["y"][t, right] - h["y"][t, left] - (h["width"][t, right] + h["width"][t, left]) / 2
    return bool(gap < max(safe, 0) and side_gap < 0.1 + max(drift, 0))

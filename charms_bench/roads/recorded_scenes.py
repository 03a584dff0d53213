"""Recorded scenes on their own roads: the vehicles of a CommonRoad scenario on its lanelets.

Each recorded vehicle that can be the ego is a moment, or each planning problem, whose vehicle is
not recorded. A recorded ego is recorded for the whole episode, is in a lane in every frame,
overlaps no other vehicle, and its goal is at least `LEAST_M` away.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from charms_bench.engine.collision_detection import fill_polygon, polygons_intersect
from charms_bench.errors import InputError
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes, wrap_to_pi
from charms_bench.maps.commonroad_scene import Area, RecordedScene, read_scene, tracks_of
from charms_bench.roads.goal_states import GoalStates, goal_states
from charms_bench.roads.layout import Layout
from charms_bench.roads.locating import forget
from charms_bench.roads.map_lanes import driven_lanes, map_of
from charms_bench.roads.routes import Routes, plan_way
from charms_bench.roads.scenes import COMMANDED, IDM, NOTHING, Scenes, here_of, list_by_place, place
from charms_bench.roads.task import draw_behaviour
from charms_bench.world.named_road import PLANNING_PROBLEM, hash_of
from charms_bench.world.recorded_moments import Moments, Tracks, in_order, order_of
from charms_bench.world.road import closest_lane, heading_at, local_coordinates, width_at
from charms_bench.world.road_network import Network
from charms_bench.world.scene import Vehicles

LEAST_M = 2.0
"""The least distance from a recorded ego's start to its goal."""
GOAL_AT = 0.8
"""The goal of a recorded ego is where it is recorded after this proportion of the episode."""


class Goals(NamedTuple):
    """Where the vehicles of V tracks go, and the egos of M moments; lanes are -1 for none."""

    lane: Ints
    """(V,) where they are recorded last."""
    ego_lane: Ints
    """(M,)"""
    ego_s: Floats
    """(M,) how far along its road, m."""


class OnRoad(NamedTuple):
    """A recorded scene on its road."""

    moments: Moments
    goals: Goals
    duration: float
    """Of its episodes, at most, s."""
    states: GoalStates | None = None
    """What the egos of planning problems should meet, in the order of the moments."""


@lru_cache(maxsize=2)
def scene_of(path: Path, sha256: str) -> RecordedScene | None:
    """The recorded scene in a file with this content, if it has one."""
    road = map_of(path, sha256)
    return read_scene(path, road.origin) if road.format.startswith("CommonRoad") else None


def facts_of(path: Path) -> dict[str, Any] | None:
    """What a file says about recorded vehicles, as numbers and texts; None if it has none."""
    sha256 = hash_of(path)
    scene = scene_of(path, sha256)
    if scene is None:
        return None
    tracks = scene.tracks
    is_in_lane = in_lanes(Layout(driven_lanes(map_of(path, sha256))).network, tracks)
    beside = np.add.reduceat(~is_in_lane, tracks.row, dtype=np.int64).tolist()
    return {
        "vehicles": len(scene.ids),
        "states": tracks.x.size,
        "rate_hz": scene.rate_hz,
        "duration_s": float(tracks.last.max() - tracks.first.min()) / scene.rate_hz,
        "in_lane": float(is_in_lane.mean()),
        "states_beside_lanes": {
            name: count for name, count in zip(scene.ids, beside, strict=True) if count
        },
        "planning_problems": len(scene.problems),
        "left_out": dict(scene.left_out),
    }


def recorded_on(
    scene: RecordedScene, road: Network, start: str, duration: float, links: Sequence[Sequence[int]]
) -> OnRoad:
    """The moments of a scene for episodes of a duration, or of as long as the scene lasts.

    Raises an `InputError` if there is none.
    """
    if start == PLANNING_PROBLEM:
        return _at_problems(scene, road, duration, links)
    tracks, rate, frame = scene.tracks, scene.rate_hz, int(scene.tracks.first.min())
    lasting = _lasting(road, tracks, frame)
    duration = min(duration, float(lasting.max(initial=0)) / rate)
    span = math.ceil(duration * rate - 1e-9)
    egos = np.nonzero(lasting >= max(span, 1))[0]
    rows = tracks.row[egos] + frame - tracks.first[egos]
    goals = rows + math.ceil(GOAL_AT * span)
    way = tracks.x[goals] - tracks.x[rows], tracks.y[goals] - tracks.y[rows]
    can_go = np.hypot(*way) >= LEAST_M
    if not can_go.any():
        raise InputError(
            f"config.start: no vehicle is in a lane, overlaps no other and drives {LEAST_M:g} m "
            f"within {duration:g} s; give another duration_s, or 'planning_problem'"
        )
    egos, goals = egos[can_go], goals[can_go]
    names = [f"vehicle {scene.ids[ego]}" for ego in egos]
    moments = _moments(tracks, egos, np.full(egos.size, frame), rate, names)
    lanes, s = _places(road, tracks, goals[order_of(names)])
    return OnRoad(moments, Goals(_last_lanes(road, scene), lanes, s), duration)


def _at_problems(
    scene: RecordedScene, road: Network, duration: float, links: Sequence[Sequence[int]]
) -> OnRoad:
    """As `on_road`, with the vehicles of planning problems, which want to drive at the limit."""
    if not scene.problems:
        raise InputError("config.start: the file has no planning problem; expected 'recorded'")
    of_egos = tracks_of(
        (np.array([[each.x, each.y, each.heading, each.speed]]), each.frame, math.nan, math.nan)
        for each in scene.problems
    )
    starts, _ = _places(road, of_egos, of_egos.row)
    fastest = np.maximum(of_egos.fastest, road.lanes["speed_limit"][starts])
    of_egos = of_egos._replace(row=of_egos.row + scene.tracks.x.size, fastest=fastest)
    both = zip(scene.tracks, of_egos, strict=True)
    tracks = Tracks(*(np.concatenate(each) for each in both))
    names = [f"planning problem {each.id}" for each in scene.problems]
    egos = np.arange(len(scene.ids), tracks.row.size)
    moments = _moments(tracks, egos, of_egos.first, scene.rate_hz, names)
    ends = [each.last or int(scene.tracks.last.max()) for each in scene.problems]
    lasting = min(end - each.frame for end, each in zip(ends, scene.problems, strict=True))
    goals, order = (np.full(egos.size, -1), np.zeros(egos.size)), order_of(names)
    for k, m in enumerate(order):
        areas = [area for state in scene.problems[m].goals for area in state.areas]
        goals[0][k], goals[1][k] = _goal(areas, road, int(starts[m]), links)
    states = goal_states([scene.problems[m] for m in order])
    lanes = np.append(_last_lanes(road, scene), np.full(egos.size, -1))
    duration = min(duration, lasting / scene.rate_hz)
    return OnRoad(moments, Goals(lanes, *goals), duration, states)


def _moments(
    tracks: Tracks, egos: Ints, frames: Ints, rate_hz: float, names: Sequence[str]
) -> Moments:
    """A moment for each ego, in the order of `order_of`."""
    every = np.argsort(tracks.first, kind="stable")
    every = every[np.isfinite(tracks.length[every])]  # which those of planning problems are not
    vehicles = [np.array([ego, *every[every != ego]]) for ego in egos]
    return in_order(tracks, vehicles, frames, np.full(egos.size, rate_hz), names)


def _last_lanes(road: Network, scene: RecordedScene) -> Ints:
    """(V,) the lanes where vehicles are recorded last."""
    tracks = scene.tracks
    return _places(road, tracks, tracks.row + tracks.last - tracks.first)[0]


@compiled
def _places(road: Network, tracks: Tracks, rows: Ints) -> tuple[Ints, Floats]:
    """The nearest lanes in some rows of tracks (R,), and how far along them vehicles are, m."""
    lanes, along = np.empty(rows.size, dtype=np.int64), np.empty(rows.size)
    for n in range(rows.size):
        x, y = tracks.x[rows[n]], tracks.y[rows[n]]
        lanes[n] = closest_lane(road, x, y, tracks.heading[rows[n]])
        along[n] = local_coordinates(road, lanes[n], x, y)[0]
    return lanes, along


def _goal(
    areas: Sequence[Area], road: Network, start: int, links: Sequence[Sequence[int]]
) -> tuple[int, float]:
    """The lane of the nearest area, and how far along it is; -1 if there is no area."""
    steps, found = _steps_from(start, links), [(math.inf, math.inf, -1)]
    for each in areas:
        lane = int(closest_lane(road, each.x, each.y, each.heading))
        s = float(local_coordinates(road, lane, each.x, each.y)[0]) - each.before
        found.append((steps.get(lane, len(links)), max(s, 0.0), lane))
    _, s, lane = min(found)
    return lane, 0.0 if lane < 0 else s


def _steps_from(lane: int, links: Sequence[Sequence[int]]) -> dict[int, int]:
    """How many links lead from a lane to each lane that can be reached without lane changes."""
    found, waiting = {lane: 0}, [lane]
    for each in waiting:
        for after in links[each]:
            if after not in found:
                found[after] = found[each] + 1
                waiting.append(after)
    return found


@compiled
def in_lanes(road: Network, tracks: Tracks) -> Bools:
    """(K,) whether the centre of a vehicle is in a lane of its direction, in each row of tracks."""
    found = np.zeros(tracks.x.size, dtype=np.bool_)
    for k in range(found.size):
        x, y = tracks.x[k], tracks.y[k]
        for lane in range(road.lanes.size):
            s, r = local_coordinates(road, lane, x, y)
            if not 0.0 <= s <= road.lanes[lane].length or abs(r) > width_at(road, lane, s) / 2:
                continue
            if abs(wrap_to_pi(tracks.heading[k] - heading_at(road, lane, s))) < math.pi / 2:
                found[k] = True
                break
    return found


@compiled
def _lasting(road: Network, tracks: Tracks, frame: int) -> Ints:
    """(V,) for how many frames from one on vehicles are in lanes without overlap; -1 for none."""
    inside = in_lanes(road, tracks)
    found = np.full(tracks.row.size, -1)
    corners = np.empty((2, 4, 2))
    for v in range(found.size):
        for at in range(frame, tracks.last[v] + 1):
            if tracks.first[v] > frame or not inside[tracks.row[v] + at - tracks.first[v]]:
                break
            overlaps = False
            for other in range(found.size):
                if other == v or not tracks.first[other] <= at <= tracks.last[other]:
                    continue
                overlaps = overlaps or do_overlap(tracks, v, other, at, corners)
            if overlaps:
                break
            found[v] = at - frame
    return found


@compiled
def do_overlap(tracks: Tracks, v: int, other: int, at: int, corners: Floats) -> bool:
    """Whether two recorded vehicles overlap in a frame."""
    k, m = tracks.row[v] + at - tracks.first[v], tracks.row[other] + at - tracks.first[other]
    reach = (tracks.length[v] + tracks.width[v] + tracks.length[other] + tracks.width[other]) / 2
    dx, dy = tracks.x[m] - tracks.x[k], tracks.y[m] - tracks.y[k]
    if dx * dx + dy * dy > reach * reach:
        return False
    for n, vehicle, row in ((0, v, k), (1, other, m)):
        sine, cosine = maths.sin_cos(tracks.heading[row])
        size = tracks.length[vehicle], tracks.width[vehicle]
        fill_polygon(tracks.x[row], tracks.y[row], cosine, sine, size[0], size[1], corners[n])
    return bool(polygons_intersect(corners[0], corners[1], 0.0, 0.0)[0])


def put_recorded(scenes: Scenes, rows: Ints, numbers: Ints, scene: OnRoad, routes: Routes) -> None:
    """Places the vehicles of the moments `numbers` (R,) in the scenes `rows` (R,)."""
    _put(scenes, rows, numbers, _starts_of(scenes, scene, routes))


def enter(scenes: Scenes, vehicles: Vehicles, numbers: Ints, scene: OnRoad, routes: Routes) -> None:
    """Completes M vehicles that appear after the start of the moments `numbers` (M,)."""
    rows, places = vehicles
    _enter(scenes, rows, places, numbers, _starts_of(scenes, scene, routes))


class _Starts(NamedTuple):
    """What places the vehicles of moments."""

    tracks: Tracks
    frames: Ints
    vehicles: Ints
    goals: Goals
    """Their lanes are indices of `Routes.goals`."""
    routes: Routes


def _starts_of(scenes: Scenes, scene: OnRoad, routes: Routes) -> _Starts:
    table, goals = scenes.road.lanes, scene.goals
    goal_of = np.full(table.size + 1, -1)  # the last is that of no lane
    for goal, first in enumerate(routes.goals.tolist()):
        goal_of[first : first + table["lanes"][first]] = goal
    goals = Goals(goal_of[goals.lane], goal_of[goals.ego_lane], goals.ego_s)
    moments = scene.moments
    return _Starts(moments.tracks, moments.frame, moments.vehicles, goals, routes)


@compiled_of_scenes
def _put(scenes: Scenes, rows: Ints, numbers: Ints, starts: _Starts) -> None:
    """See `put_recorded`."""
    tracks, frames, vehicles = starts.tracks, starts.frames, starts.vehicles
    for r in range(rows.size):
        b, m = rows[r], numbers[r]
        here = here_of(scenes, b)
        scenes.steps[b] = 0
        for i in range(here.places):
            scenes.vehicles[b, i].kind = NOTHING
            forget(here, i)
            v = vehicles[m, i]
            if v < 0 or not tracks.first[v] <= frames[m] <= tracks.last[v]:
                continue
            k = tracks.row[v] + frames[m] - tracks.first[v]
            vehicle = scenes.vehicles[b, i]
            vehicle.x, vehicle.y, vehicle.heading = tracks.x[k], tracks.y[k], tracks.heading[k]
            vehicle.speed, vehicle.target_speed = tracks.speed[k], tracks.fastest[v]
            complete(scenes, b, i, m, starts)
        list_by_place(scenes, b)


@compiled_of_scenes
def _enter(scenes: Scenes, rows: Ints, places: Ints, numbers: Ints, starts: _Starts) -> None:
    """See `enter`."""
    for n in range(rows.size):
        complete(scenes, rows[n], places[n], numbers[n], starts)


@compiled
def complete(scenes: Scenes, b: int, i: int, m: int, starts: _Starts) -> None:
    """Gives vehicle i of moment m, which is at its place, all that follows from it."""
    tracks, goals = starts.tracks, starts.goals
    vehicle, v = scenes.vehicles[b, i], starts.vehicles[m, i]
    x, y, wanted = vehicle.x, vehicle.y, vehicle.target_speed
    place(scenes, b, i, COMMANDED if i == 0 else IDM, x, y, vehicle.heading, vehicle.speed)
    if not math.isnan(tracks.length[v]):
        vehicle.length, vehicle.width = tracks.length[v], tracks.width[v]
    vehicle.speed_min, vehicle.target_speed = 0.0, wanted
    vehicle.goal = goals.lane[v] if i > 0 else goals.ego_lane[m]
    if i == 0:
        vehicle.goal_s = goals.ego_s[m]
    else:
        draw_behaviour(scenes, b, i)
    plan_way(vehicle, scenes.road, starts.routes, vehicle.lane, True)

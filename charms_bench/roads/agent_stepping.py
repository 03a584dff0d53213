"""What agents answer is carried out on a network, compiled.

Each vehicle that an agent drives sees the scene straightened along its own way (`straightened`);
here, scenes are shown so, and what the views then want is done by the vehicles on the network.
"""

from typing import Any

from charms_bench.engine.stepping import Put
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Ints
from charms_bench.foundation.compiled import compiled, compiled_of_scenes
from charms_bench.roads.driving import act, is_reachable
from charms_bench.roads.locating import forget, locate
from charms_bench.roads.looking_ahead import look_ahead
from charms_bench.roads.regulated_road import enforce
from charms_bench.roads.safe_gap import is_safe
from charms_bench.roads.scenes import Here, Row, Scenes, here_of, lane_of, vehicle_of, way_of
from charms_bench.roads.stepping import collide, move_all
from charms_bench.roads.straightened import find_way, has_left_way, straighten
from charms_bench.world.scene import Scene

BY_ENVIRONMENT, BY_TARGETS, BY_MODEL, BY_CONTROLS, BY_CONFIGURATION = range(5)
"""What drives a vehicle: highway-env's environment, target speeds and lanes, a driver model,
continuous actions, or actions that highway-env's environment carries out."""


@compiled_of_scenes
def show(scenes: Scenes, shown: Any, rows: Ints) -> None:
    """Straightens the scenes `rows` as their egos see them."""
    for b in rows:
        here = here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
        straighten(scenes.road, here, 0, shown.scene, b)


@compiled_of_scenes
def show_each(scenes: Scenes, shown: Any, views: Any, rows: Ints, places: Ints) -> None:
    """Straightens scenes as each of M vehicles sees them."""
    scene, view, last = shown.scene, views.scene, -1
    for m in range(rows.size):
        b, v = rows[m], rows[m] * scene.x.shape[1] + places[m]
        here = here_of(scenes, b)
        for i in range(here.places):
            if b != last:
                forget(here, i)
            view.temperament[v, i] = scene.temperament[b, i]
            view.repeats[v, i] = scene.repeats[b, i]
            view.entry[v, i] = scene.entry[b, i]
            for k in range(scene.parameters.shape[2]):
                view.parameters[v, i, k] = scene.parameters[b, i, k]
            for k in range(scene.memory.shape[2]):
                view.memory[v, i, k] = scene.memory[b, i, k]
        straighten(scenes.road, here, places[m], view, v)
        last = b


@compiled_of_scenes
def carry_out(scenes: Scenes, shown: Any, views: Any, rows: Ints, places: Ints) -> None:
    """Has M vehicles do what their views say."""
    scene, view, last = shown.scene, views.scene, -1
    for m in range(rows.size):
        b, i, v = rows[m], places[m], rows[m] * scene.x.shape[1] + places[m]
        here = here_of(scenes, b)
        for j in range(here.places if b != last else 0):
            forget(here, j)
        take(here, i, view, v)
        last = b


@compiled
def take(here: Here, i: int, scene: Scene, v: int) -> None:
    """Has vehicle i want what scene v says, in which the agent sees it.

    Where the route decides the lane, the agent does not.
    """
    vehicle = vehicle_of(here, i)
    vehicle.target_speed, vehicle.timer_s = scene.target_speed[v, i], scene.timer_s[v, i]
    if decides_lane(here, vehicle) or scene.target_lane[v, i] == way_of(here, i).target:
        return
    row = lane_of(here, vehicle.lane)
    lane = row.first + scene.target_lane[v, i]
    if scene.target_lane[v, i] < row.lanes and is_reachable(here, i, lane):
        vehicle.target_lane = lane


@compiled
def decides_lane(here: Here, vehicle: Row) -> bool:
    """Whether a vehicle has to change its lane: its route says so, or its lane is a ramp."""
    is_on_route = vehicle.route_step < vehicle.route_end
    if is_on_route and vehicle.route_numbers[vehicle.route_step] >= 0:
        return True
    row = lane_of(here, vehicle.lane)
    return bool(row.forbidden and row.lanes > 1)


@compiled_of_scenes
def advance(
    scenes: Scenes,
    shown: Any,
    views: Any,
    rows: Ints,
    told: Bools,
    kinds: Ints,
    put: Put | None,
) -> None:
    """One simulation step of the scenes `rows`, after the agents have answered.

    `shown` has them as their egos see them, with the answers, and `views` as each vehicle does,
    with the accelerations of driver models. Where `told` (R,) says that `shown` is not the present
    moment, the ego goes on as it did. `kinds` (B, N) are what drives the vehicles, and `put` is
    where the step ends for those that follow a recording.
    """
    profile = shown.scene.constants
    can_reverse = profile.can_reverse and profile.speed_min < 0.0
    for r in range(rows.size):
        b, scene = rows[r], shown.scene
        here = here_of(scenes, b)
        for i in range(here.places):
            forget(here, i)
        ego = vehicle_of(here, 0)
        acceleration, steering = ego.acceleration, ego.steering
        if told[r] and kinds[b, 0] != BY_CONFIGURATION:
            acceleration, steering = scene.acceleration[b, 0], scene.steering[b, 0]
            take(here, 0, scene, b)
        for i in range(here.places):
            as_there = kinds[b, i] in (BY_ENVIRONMENT, BY_CONFIGURATION)
            if not as_there and decides_lane(here, vehicle_of(here, i)):
                change_to_route(here, i)
        if here.constants.looks_ahead:
            look_ahead(here)
        act(scenes.road, here)
        for i in range(here.places):
            kind, vehicle = kinds[b, i], vehicle_of(here, i)
            if kind == BY_MODEL and i > 0:
                vehicle.acceleration = views.scene.acceleration[b * here.places + i, i]
            elif i == 0 and kind not in (BY_TARGETS, BY_CONFIGURATION):
                vehicle.acceleration = acceleration
            if kind == BY_CONTROLS:
                vehicle.steering = steering if i == 0 else vehicle.steering
                vehicle.target_lane = vehicle.lane
        if here.constants.regulation_steps:
            scenes.steps[b] += 1
            if scenes.steps[b] % here.constants.regulation_steps == 0:
                enforce(scenes.road, here)
        move_all(here)
        if put is not None:
            put_vehicles(here, b, put)
        for i in range(here.places):
            vehicle = vehicle_of(here, i)
            if kinds[b, i] == BY_ENVIRONMENT:
                continue
            if vehicle.speed < 0.0 and not (can_reverse or kinds[b, i] == BY_CONFIGURATION):
                vehicle.acceleration -= vehicle.speed / here.constants.dt
                vehicle.speed = 0.0
            vehicle.timer_s += here.constants.dt
            if has_left_way(here, i):
                find_way(scenes.road, here, i)
        collide(here)


@compiled
def put_vehicles(here: Here, b: int, put: Put) -> None:
    """Puts the vehicles of scene b that follow a recording where they are to be."""
    for i in range(here.places):
        if put.moves[b, i]:
            vehicle = vehicle_of(here, i)
            vehicle.x, vehicle.y, vehicle.heading = put.x[b, i], put.y[b, i], put.heading[b, i]
            vehicle.speed, vehicle.acceleration = put.speed[b, i], put.acceleration[b, i]
            vehicle.direction_y, vehicle.direction_x = maths.sin_cos(vehicle.heading)
            vehicle.steering = 0.0
            locate(here, i)
            vehicle.target_lane = vehicle.lane


@compiled
def change_to_route(here: Here, i: int) -> None:
    """Has vehicle i change to the lane of its route, or leave a ramp, where `is_safe` says so.

    It changes lane by lane. highway-env forbids others to change to the lanes of a ramp.
    """
    vehicle = vehicle_of(here, i)
    row = lane_of(here, vehicle.lane)
    if vehicle.crashed:
        return
    if vehicle.lane != vehicle.target_lane:
        is_aside = row.first == lane_of(here, vehicle.target_lane).first
        if is_aside and not is_safe(here, i, vehicle.target_lane):
            vehicle.target_lane = vehicle.lane
        return
    if row.forbidden:
        side = max(row.left, row.right)
    else:
        wanted = row.first + vehicle.route_numbers[vehicle.route_step]
        side = row.right if wanted > vehicle.lane else row.left if wanted < vehicle.lane else -1
    if side >= 0 and is_reachable(here, i, side) and is_safe(here, i, side):
        vehicle.target_lane = side

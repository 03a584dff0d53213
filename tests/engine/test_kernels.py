"""The compiled road, vehicle and collision rules, against plain versions and highway-env."""

import math

import naive
import numpy as np
import pytest
from highway_env import utils
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.controller import ControlledVehicle
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import scene_of, scenes

from charms_bench.engine.collision_detection import collide
from charms_bench.engine.motion import follow_no_lane, move, room_to_turn
from charms_bench.engine.neighbours import locate
from charms_bench.foundation.compiled import wrap_to_pi
from charms_bench.world.candidate_lanes import LEFT, OWN, RIGHT, TARGET, neighbours_on
from charms_bench.world.road import Straight, closest_lane, is_reachable
from charms_bench.world.scene import Scene

DT = 1 / 15
ROW = np.array([0])


def road_of(scene: Scene, vehicle_class: type = Vehicle) -> Road:
    """highway-env's road with the vehicles of a scene."""
    c, network = scene.road, RoadNetwork()
    for lane in range(c.lanes):
        ends = np.array([[0.0, lane * c.lane_width], [c.road_length, lane * c.lane_width]])
        network.add_lane("0", "1", StraightLane(*ends, width=c.lane_width, speed_limit=30))
    road = Road(network)
    state = zip(scene.x[0], scene.y[0], scene.heading[0], scene.speed[0], strict=True)
    for x, y, heading, speed in state:
        place = len(road.vehicles)
        sizes = {"LENGTH": scene.length[0, place], "WIDTH": scene.width[0, place]}
        own_class = type(vehicle_class.__name__, (vehicle_class,), sizes)
        road.vehicles.append(own_class(road, np.array([x, y]), heading, speed))
    for vehicle, crashed in zip(road.vehicles, scene.crashed[0], strict=True):
        vehicle.crashed = bool(crashed)
    return road


def moved(scene: Scene, modelled: bool) -> None:
    vehicles = scene.x.shape[1]
    room = room_to_turn(vehicles)
    nobody = np.zeros((1, vehicles), dtype=np.bool_)
    move(scene, 0, 1, np.full((1, vehicles), modelled), nobody, room)


def on_lane(scene: Scene, i: int, lane: int) -> tuple[int, int]:
    """The leader and the follower of a vehicle on any lane."""
    leader, follower = neighbours_on(scene, ROW, np.array([i]), np.array([lane]))[:, 0]
    return leader, follower


@settings(derandomize=True, deadline=None)
@given(scenes())
def test_neighbours_are_those_of_the_plain_search(scene: Scene) -> None:
    for i in range(scene.x.shape[1]):
        for lane in range(scene.road.lanes):
            assert on_lane(scene, i, lane) == naive.neighbours(scene, i, lane)
        lane, target_lane = scene.lane[0, i], scene.target_lane[0, i]
        for candidate, on in {
            OWN: lane,
            LEFT: lane - 1,
            RIGHT: lane + 1,
            TARGET: target_lane,
        }.items():
            exists = 0 <= on < scene.road.lanes
            found = scene.leaders[0, i, candidate], scene.followers[0, i, candidate]
            assert found == (naive.neighbours(scene, i, on) if exists else (-1, -1))


@settings(derandomize=True, deadline=None)
@given(scenes())
def test_neighbours_are_those_of_highway_env(scene: Scene) -> None:
    vehicles = (road := road_of(scene)).vehicles
    for i, vehicle in enumerate(vehicles):
        for lane in range(scene.road.lanes):
            places = [
                -1 if other is None else [v is other for v in vehicles].index(True)
                for other in road.neighbour_vehicles(vehicle, ("0", "1", lane))
            ]
            assert on_lane(scene, i, lane) == tuple(places)


def test_of_vehicles_at_one_x_the_last_spawned_leads_and_the_first_spawned_follows() -> None:
    scene = scene_of(x=[50.0, 20.0, 20.0, 20.0, 5.0], y=[0.0] * 5)
    assert scene.followers[0, 0, OWN] == 1
    assert scene.leaders[0, 4, OWN] == 3
    assert [scene.leaders[0, i, OWN] for i in (1, 2, 3)] == [3, 3, 2]
    assert [scene.followers[0, i, OWN] for i in (1, 2, 3)] == [4, 4, 4]


def test_a_vehicle_between_two_lanes_is_a_neighbour_on_both() -> None:
    scene = scene_of(x=[10.0, 30.0], y=[0.0, 2.5])
    assert [on_lane(scene, 0, lane)[0] for lane in range(3)] == [1, 1, -1]


def test_a_vehicle_beside_the_road_is_nobodys_neighbour() -> None:
    scene = scene_of(x=[10.0, 30.0, -6.0], y=[0.0, -3.1, 0.0])
    assert (scene.leaders[0, 0] == -1).all()
    assert (scene.followers[0, 0] == -1).all()


@pytest.mark.parametrize("length", [3.0, 18.0])
def test_the_road_reaches_5_m_beyond_its_ends_whatever_the_length_of_vehicles(
    length: float,
) -> None:
    scene = scene_of(
        x=[50.0, -5.1, -5.0, 104.9, 105.0],
        y=[0.0] * 5,
        sizes={"length": length, "road_length": 100.0},
    )
    assert (scene.leaders[0, 0, OWN], scene.followers[0, 0, OWN]) == (3, 2)
    x = np.array([-0.1, 0.0, 104.9, 105.0])
    assert list(is_reachable(scene.road, 1, x, 0.0)) == [False, True, True, False]


@settings(derandomize=True, deadline=None)
@given(scenes())
def test_order_runs_from_the_rear_and_rank_is_its_inverse(scene: Scene) -> None:
    order, rank = scene.order[0], scene.rank[0]
    assert (np.diff(scene.x[0, order]) >= 0).all()
    assert (order[rank] == np.arange(order.size)).all()


@settings(derandomize=True, deadline=None)
@given(st.floats(-10.0, 40.0), st.integers(2, 8), st.sampled_from([3.5, 4.0]))
def test_the_closest_lane_is_the_first_nearest(y: float, lanes: int, width: float) -> None:
    assert closest_lane(Straight(lanes, width, 100.0, 30.0), 0.0, y, 0.0) == naive.closest_lane(
        y, lanes, width
    )


@settings(derandomize=True, deadline=None)
@given(
    st.floats(-1e4, 3e4),
    st.one_of(st.floats(-50.0, 50.0), st.sampled_from([np.nextafter(2.0, 3.0), 2.0 + 1e-13])),
    st.floats(-300.0, 300.0),
)
def test_without_a_target_the_lane_is_highway_envs_at_any_heading(
    x: float, y: float, heading: float
) -> None:
    scene = scene_of(x=[x], y=[y], heading=[heading], speed=[20.0])
    network = road_of(scene).network
    follow_no_lane(scene, np.ones((1, 1), dtype=np.bool_))
    expected = network.get_closest_lane_index(np.array([x, y]), heading)[2]
    assert scene.lane[0, 0] == scene.target_lane[0, 0] == expected


@pytest.mark.parametrize(("y", "lane"), [(-9.0, 0), (1.9, 0), (2.0, 0), (2.1, 1), (30.0, 2)])
def test_on_three_lanes_of_4_m_the_border_belongs_to_the_left(y: float, lane: int) -> None:
    assert closest_lane(Straight(3, 4.0, 100.0, 30.0), 0.0, y, 0.0) == lane


@settings(derandomize=True, deadline=None)
@given(st.floats(-400.0, 400.0))
def test_angles_wrap_as_in_highway_env(angle: float) -> None:
    assert wrap_to_pi(angle) == utils.wrap_to_pi(angle)


@settings(derandomize=True, deadline=None)
@given(scenes(most_vehicles=3, profiles=("highway-env",)))
def test_steering_and_motion_are_those_of_highway_env(scene: Scene) -> None:
    road = road_of(scene, ControlledVehicle)
    for i, vehicle in enumerate(road.vehicles):
        vehicle.target_lane_index = ("0", "1", int(scene.target_lane[0, i]))
        vehicle.target_speed = scene.target_speed[0, i]
        vehicle.act()
        vehicle.step(DT)
    moved(scene, modelled=False)
    for name in ("heading", "speed"):
        expected = [getattr(vehicle, name) for vehicle in road.vehicles]
        np.testing.assert_allclose(getattr(scene, name)[0], expected, rtol=0, atol=1e-12)
    places = [vehicle.position for vehicle in road.vehicles]
    np.testing.assert_allclose(np.c_[scene.x[0], scene.y[0]], places, rtol=0, atol=1e-12)
    assert list(scene.lane[0]) == [vehicle.lane_index[2] for vehicle in road.vehicles]


def test_a_vehicle_on_its_lane_moves_by_its_speed_and_accelerates_to_its_target() -> None:
    scene = scene_of(x=[100.0], y=[4.0], speed=[20.0], target_speed=[23.0])
    moved(scene, modelled=False)
    assert scene.x[0, 0] == pytest.approx(100 + 20 / 15)
    assert scene.acceleration[0, 0] == pytest.approx(3 / 0.6)
    assert scene.speed[0, 0] == pytest.approx(20 + 5 / 15)
    assert (scene.y[0, 0], scene.steering[0, 0]) == (4.0, 0.0)


def test_a_crashed_vehicle_brakes_by_its_speed_a_second() -> None:
    scene = scene_of(x=[0.0], y=[0.0], speed=[30.0], target_lane=[1], crashed=[True])
    moved(scene, modelled=True)
    assert scene.acceleration[0, 0] == -30.0
    assert scene.steering[0, 0] == 0.0


def test_an_impact_displaces_a_vehicle_once_and_leaves_it_crashed() -> None:
    scene = scene_of(x=[0.0], y=[0.0], impact=[True], impact_x=[0.5], impact_y=[3.0])
    moved(scene, modelled=True)
    assert (scene.x[0, 0], scene.y[0, 0], scene.lane[0, 0]) == (0.5, 3.0, 1)
    assert scene.crashed[0, 0]
    assert not scene.impact[0, 0]


@settings(derandomize=True, deadline=None, max_examples=100)
@given(scenes(most_vehicles=5))
def test_collisions_are_those_of_highway_env(scene: Scene) -> None:
    scene.x[0] = scene.x[0] % 15 + 0.1 * np.arange(scene.x.shape[1])
    locate(scene, ROW)
    road = road_of(scene)
    for i, vehicle in enumerate(road.vehicles):
        for other in road.vehicles[i + 1 :]:
            vehicle.handle_collisions(other, DT)
    collide(scene, 0, 1)
    assert list(scene.crashed[0]) == [vehicle.crashed for vehicle in road.vehicles]
    assert list(scene.impact[0]) == [vehicle.impact is not None for vehicle in road.vehicles]
    for i, vehicle in enumerate(road.vehicles):
        if vehicle.impact is not None:
            impact = np.array([scene.impact_x[0, i], scene.impact_y[0, i]])
            if are_level(scene, i, vehicle.impact):
                impact *= np.sign(impact @ vehicle.impact)
            np.testing.assert_allclose(impact, vehicle.impact, rtol=0, atol=1e-9)


def are_level(scene: Scene, i: int, impact: np.ndarray) -> bool:
    """Whether rounding decides to which side an impact parts vehicle i from another vehicle."""
    centres = np.stack([scene.x[0], scene.y[0]], axis=1)
    along = (centres - centres[i]) @ impact / max(np.linalg.norm(impact), 1e-9)
    return bool((np.abs(np.delete(along, i)) < 1e-9).any())


def test_overlapping_vehicles_are_parted_along_the_axis_of_least_overlap() -> None:
    scene = scene_of(x=[100.0, 104.0], y=[0.0, 0.0], speed=[20.0, 20.0])
    collide(scene, 0, 1)
    assert list(scene.crashed[0]) == [True, True]
    np.testing.assert_allclose(scene.impact_x[0], [-0.5, 0.5])  # they overlap by 1 m
    np.testing.assert_allclose(scene.impact_y[0], 0.0)


def test_vehicles_side_by_side_on_two_lanes_do_not_collide() -> None:
    scene = scene_of(x=[100.0, 100.0], y=[0.0, 4.0], speed=[20.0, 30.0])
    collide(scene, 0, 1)
    assert not scene.crashed.any()
    assert not scene.impact.any()


def test_vehicles_that_touch_side_by_side_collide_as_rounding_says() -> None:
    sizes = {"width": 1.65, "lane_width": 1.65}
    scene = scene_of(lanes=5, sizes=sizes, x=[100.0, 100.0], y=[3 * 1.65, 4 * 1.65])
    first, other = road_of(scene).vehicles
    first.handle_collisions(other, DT)
    collide(scene, 0, 1)
    assert list(scene.crashed[0]) == [first.crashed, other.crashed] == [True, True]


def test_directions_are_the_cosine_and_sine_of_headings() -> None:
    scene = scene_of(x=[0.0, 20.0], y=[0.0, 4.0], heading=[math.pi / 6, 0.0])
    np.testing.assert_allclose(scene.direction_x[0], [math.sqrt(3) / 2, 1.0])
    np.testing.assert_allclose(scene.direction_y[0], [0.5, 0.0], atol=1e-15)

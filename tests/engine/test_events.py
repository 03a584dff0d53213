"""How close an episode comes to an event, by hand, by plain code, and for episodes that end."""

import numpy as np
import pytest
from highway_env.utils import are_polygons_intersecting
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import scene_of, scenes

from charms_bench.engine.events import (
    HARMLESS_S2_PER_M,
    HORIZON_S,
    TOUCHING_S2_PER_M,
    Crash,
    TimeToCollision,
    closest,
    closest_on_network,
    lowest_levels,
)
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import AgentError, InputError
from charms_bench.plugins.event import Event
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings

ROW = np.array([0])


def closeness(scene: Scene) -> tuple[float, float]:
    times, inverse_decelerations = closest(scene, ROW)
    return times[0], inverse_decelerations[0]


def test_a_leader_15_m_ahead_and_5_mps_slower_is_reached_after_2_s() -> None:
    # 15 m between centres less 5 m of length; DRAC is 5**2 / (2 * 10) = 1.25 m/s².
    scene = scene_of(x=[100.0, 115.0], y=[0.0, 0.0], speed=[30.0, 25.0])
    assert closeness(scene) == pytest.approx((2.0, 1 / 1.25))


def test_a_faster_follower_is_as_close_as_a_slower_leader() -> None:
    scene = scene_of(x=[100.0, 85.0], y=[0.0, 0.0], speed=[25.0, 30.0])
    assert closeness(scene) == pytest.approx((2.0, 1 / 1.25))


def test_a_vehicle_that_closes_in_from_the_side_touches_after_its_lateral_gap() -> None:
    # Lateral gap 4 - 2 = 2 m at 25 sin(0.04) = 0.99973 m/s; DRAC is 0.99973**2 / (2 * 2).
    scene = scene_of(x=[100.0, 100.0], y=[0.0, 4.0], speed=[25.0, 25.0], heading=[0.0, -0.04])
    speed = 25 * np.sin(0.04)
    assert closeness(scene) == pytest.approx((2 / speed, 2 * 2 / speed**2))


def test_vehicles_on_parallel_lanes_never_touch() -> None:
    scene = scene_of(x=[100.0, 110.0], y=[0.0, 4.0], speed=[30.0, 20.0])
    assert closeness(scene) == (HORIZON_S, HARMLESS_S2_PER_M)


def test_vehicles_that_overlap_touch_now() -> None:
    scene = scene_of(x=[100.0, 103.0], y=[0.0, 1.0], speed=[30.0, 20.0])
    assert closeness(scene) == (0.0, 0.0)
    assert Crash().level(scene, ROW) == TOUCHING_S2_PER_M
    assert TimeToCollision(0.5).level(scene, ROW) == -0.5


@settings(deadline=None)
@given(scenes(), st.integers(1, 4000))
def test_the_time_is_that_at_which_moved_rectangles_first_overlap(scene: Scene, k: int) -> None:
    time, _ = closeness(scene)
    at = k / 1000  # s
    ego, length, width = scene.ego[0], scene.length[0], scene.width[0]
    x = scene.x[0] + at * scene.speed[0] * np.cos(scene.heading[0])
    y = scene.y[0] + at * scene.speed[0] * np.sin(scene.heading[0])
    along = abs(x - x[ego]) - (length + length[ego]) / 2
    across = abs(y - y[ego]) - (width + width[ego]) / 2
    overlaps = np.delete((along < -1e-6) & (across < -1e-6), ego)
    if overlaps.any():
        assert time <= at


def rectangle(x: float, y: float, moved_m: float, heading: float, margin: float) -> Floats:
    """The closed polygon (5, 2) of a vehicle of 5 x 2 m, enlarged by a margin."""
    along = np.array([np.cos(heading), np.sin(heading)])
    half_length, half_width = 2.5 + margin, 1.0 + margin
    signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]])
    across = np.array([-along[1], along[0]])
    sides = np.array([half_length * along, half_width * across])
    return np.array([x, y]) + moved_m * along + signs @ sides


@settings(deadline=None)
@given(
    st.lists(st.floats(-20.0, 20.0), min_size=2, max_size=2),
    st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=2),
    st.lists(st.floats(0.0, 15.0), min_size=2, max_size=2),
)
def test_vehicles_of_any_direction_touch_when_highway_env_says_so(
    away: list[float], heading: list[float], speed: list[float]
) -> None:
    scene = scene_of(x=[0.0, away[0]], y=[0.0, away[1]], speed=speed, heading=heading)
    (time,), _ = closest_on_network(scene, ROW)

    def intersects(at: float, margin: float) -> bool:
        corners = (
            rectangle(scene.x[0, i], scene.y[0, i], speed[i] * at, heading[i], margin)
            for i in (0, 1)
        )
        return bool(are_polygons_intersecting(*corners, np.zeros(2), np.zeros(2))[0])

    if time < HORIZON_S:
        assert intersects(time, 1e-6)
    for at in np.linspace(0.0, 0.999 * min(time, 5.0), 20):
        assert time == 0.0 or not intersects(at, -1e-6)


class Slowest(Event):
    """The ego's speed falls to 22.5 m/s."""

    definition = "the ego's speed falls to 22.5 m/s"

    def level(self, scene: Scene, rows: Ints) -> Floats:
        return scene.speed[rows, scene.ego[rows]] - 22.5


class Misshapen(Slowest):
    """Returns one level too many."""

    def level(self, scene: Scene, rows: Ints) -> Floats:
        return np.zeros(rows.size + 1)


class Undefined(Slowest):
    """Returns NaN."""

    def level(self, scene: Scene, rows: Ints) -> Floats:
        return np.full(rows.size, np.nan)


def simulation(density: float) -> Simulation:
    scene = SceneSettings(density=density, duration_s=6.0)
    agents = {"idm_mobil": make_agent("idm_mobil")}
    made = Simulation(scene, 40, "idm_mobil", OneAgent("idm_mobil"), agents)
    made.reset(np.arange(40, dtype=np.uint64))
    return made


def test_levels_of_a_crash_are_negative_where_the_episode_ends_by_one() -> None:
    crowded = simulation(density=3.5)
    levels = lowest_levels(crowded, Crash())
    assert 0 < crowded.failed.sum() < 40
    np.testing.assert_array_equal(levels <= 0, crowded.failed)


def test_the_lowest_level_is_that_of_any_simulation_step() -> None:
    stepped, whole = simulation(1.0), simulation(1.0)
    lowest = np.full(40, np.inf)
    while stepped.scene.active.any():
        for _ in range(5):
            stepped.advance()
            lowest = np.minimum(lowest, stepped.scene.speed[stepped.ego_vehicles] - 22.5)
        stepped.finish_step()
    np.testing.assert_array_equal(lowest_levels(whole, Slowest()), lowest)


@pytest.mark.parametrize("event", [Misshapen(), Undefined()])
def test_unusable_levels_are_an_error_that_names_the_event(event: Event) -> None:
    with pytest.raises(AgentError, match=type(event).__name__):
        lowest_levels(simulation(1.0), event)


@pytest.mark.parametrize("below_s", [0, -1.0, 100.0, "1", True, float("nan")])
def test_a_threshold_that_is_no_time_is_rejected(below_s: float) -> None:
    with pytest.raises(InputError, match="below_s"):
        TimeToCollision(below_s)

"""What a policy sees."""

import naive
import numpy as np
from hypothesis import given, settings
from scenes import all_vehicles, scene_of, scenes

from charms_bench.world.observations import EGO, FRONT, LEFT_FRONT, REAR, RIGHT_REAR, neighbours
from charms_bench.world.scene import Scene


@settings(derandomize=True, deadline=None)
@given(scenes())
def test_observations_are_those_of_the_plain_version(scene: Scene) -> None:
    seen = neighbours(scene, all_vehicles(scene))
    expected = [naive.neighbours_observation(scene, i) for i in range(scene.x.shape[1])]
    np.testing.assert_allclose(seen, expected, rtol=0, atol=1e-6)


def test_the_first_row_is_the_vehicle_and_the_others_are_relative_to_it() -> None:
    scene = scene_of(x=[100.0, 133.0, 50.5], y=[4.0, 4.0, 8.0], speed=[33.0, 22.0, 33.0])
    seen = neighbours(scene, (np.array([0]), np.array([0])))[0]
    np.testing.assert_allclose(seen[EGO], [1, 1, 4 / 12, 0.5, 0], atol=1e-7)
    np.testing.assert_allclose(seen[FRONT], [1, 33 / 165, 0, -11 / 66, 0], atol=1e-7)
    np.testing.assert_allclose(seen[RIGHT_REAR], [1, -49.5 / 165, 4 / 12, 0, 0], atol=1e-7)
    assert not np.delete(seen, [EGO, FRONT, RIGHT_REAR], axis=0).any()


def test_a_neighbour_at_99_m_is_seen_and_one_beyond_is_not() -> None:
    scene = scene_of(x=[100.0, 199.0, 0.9], y=[4.0, 4.0, 4.0])
    seen = neighbours(scene, (np.array([0]), np.array([0])))[0]
    assert seen[FRONT, 0] == 1.0
    assert not seen[REAR].any()


def test_there_is_nobody_beyond_the_leftmost_lane() -> None:
    scene = scene_of(x=[100.0, 110.0], y=[0.0, 4.0])
    seen = neighbours(scene, (np.array([0]), np.array([0])))[0]
    assert not seen[LEFT_FRONT : LEFT_FRONT + 2].any()


def test_differences_of_velocity_are_clipped_at_66_m_per_s() -> None:
    scene = scene_of(x=[100.0, 110.0], y=[4.0, 4.0], speed=[40.0, -40.0])
    seen = neighbours(scene, (np.array([0]), np.array([0])))[0]
    assert seen[FRONT, 3] == -1.0

"""What a policy sees."""

from typing import Any

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from scenes import all_vehicles, scene_of, scenes

from charms_bench.engine import MakeEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.traffic import OneAgent
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.action_mask import action_masks
from charms_bench.world.actions import FASTER, LANE_LEFT, SLOWER
from charms_bench.world.observations import (
    ACTION_MASK,
    COMMANDS,
    EGO,
    FRONT,
    LEFT_FRONT,
    LEFT_REAR,
    REAR,
    RIGHT_FRONT,
    RIGHT_REAR,
    Neighbours,
    described,
    neighbours,
    observation_described,
    paper_neighbours,
)
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import Scene, SceneSettings


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


@settings(derandomize=True, deadline=None)
@given(scenes())
def test_the_papers_observations_are_those_of_the_plain_version(scene: Scene) -> None:
    everybody = np.arange(scene.x.shape[1])
    vehicles = everybody[[_has_no_rival(scene, i) for i in everybody]]
    seen = paper_neighbours(scene, (np.zeros_like(vehicles), vehicles))
    expected = [naive.paper_observation(scene, i) for i in vehicles]
    np.testing.assert_allclose(seen, np.reshape(expected, (-1, 7, 5)), rtol=0, atol=1e-6)


def _has_no_rival(scene: Scene, i: int) -> bool:
    """Whether no two other vehicles on a lane are equally far ahead, so that one is nearest."""
    ahead = scene.x[0] - scene.x[0, i]
    others = np.delete(np.stack([ahead, scene.lane[0]], axis=1), i, axis=0)
    return len(np.unique(others, axis=0)) == len(others)


def first_seen(observation: Neighbours, **fields: list[float]) -> np.ndarray:
    return observation(scene_of(**fields), (np.array([0]), np.array([0])))[0]


def test_in_the_paper_a_vehicle_between_two_lanes_is_shown_on_the_nearest_one() -> None:
    fields = {"x": [100.0, 133.0], "y": [0.0, 2.1]}
    shown = first_seen(neighbours, **fields)[:, 0]
    assert shown[FRONT] == shown[RIGHT_FRONT] == 1
    shown = first_seen(paper_neighbours, **fields)[:, 0]
    assert (shown[FRONT], shown[RIGHT_FRONT]) == (0, 1)


def test_in_the_paper_the_own_x_grows_until_165_m() -> None:
    assert first_seen(paper_neighbours, x=[66.0], y=[4.0])[EGO, 1] == np.float32(0.4)
    assert first_seen(paper_neighbours, x=[500.0], y=[4.0])[EGO, 1] == 1
    assert first_seen(neighbours, x=[66.0], y=[4.0])[EGO, 1] == 1


def test_in_the_paper_the_range_is_between_centres() -> None:
    # 98.95 m along the road and 4 m across are sqrt(98.95^2 + 4^2) = 99.03 m.
    fields = {"x": [200.0, 298.95, 101.05], "y": [4.0, 8.0, 4.0]}
    assert first_seen(neighbours, **fields)[RIGHT_FRONT, 0] == 1
    shown = first_seen(paper_neighbours, **fields)[:, 0]
    assert (shown[RIGHT_FRONT], shown[REAR]) == (0, 1)


def test_in_the_paper_a_vehicle_level_with_the_observer_is_behind() -> None:
    shown = first_seen(paper_neighbours, x=[100.0, 100.0], y=[4.0, 0.0])[:, 0]
    assert (shown[LEFT_FRONT], shown[LEFT_REAR]) == (0, 1)


def test_the_two_observations_have_texts_that_tell_them_apart() -> None:
    for observation in (neighbours, paper_neighbours):
        assert observation_described(described(observation)) == observation
    # In the files of the package, which have to keep their bytes.
    assert described(neighbours) == (
        "neighbours: (7, 5) float32, rows self, left front, left rear, front, rear, right front, "
        "right rear; columns presence, x / 165 m, y / 12 m, vx / 66 m/s, vy / 66 m/s"
    )
    assert described(paper_neighbours).startswith("paper_neighbours: (7, 5) float32")


@pytest.mark.parametrize("engine", ENGINES)
def test_observed_commands_are_those_that_have_been_given(engine: MakeEngine) -> None:
    steps = {"target_speed_steps_mps": (0.25, 0.5, 1.0, 2.0)}
    settings = SceneSettings(
        profile=PROFILES["charms"].model_copy(update=steps), traffic_vehicles=0, ego_slots=1
    )
    made = Simulation(settings, 1, None, OneAgent(""), {}, engine)
    seed = next(seed for seed in range(9) if starts_beside_a_left_lane(made, seed))
    made.reset(np.array([seed], dtype=np.uint64))
    # The acceleration is (target - speed) / 0.8 s, kept for 1/3 s: 5/12 of the difference.
    expected = [
        (30.0, 30.0, 0, 0, 0.0),
        (30.25, 30.1041667, 1, 0, 0.3125),
        (30.75, 30.3732639, 2, 0, 0.8072917),
        (30.5, 30.4260706, -1, 0, 0.1584201),
        (30.5, 30.4568745, 0, -1, 0.0924118),
    ]
    for k, (target, speed, repeats, lane, acceleration) in enumerate(expected):
        if k:
            made.step(np.array([(FASTER, FASTER, SLOWER, LANE_LEFT)[k - 1]]))
        row = Neighbours(commands=True)(made.scene, made.ego_vehicles)[0, COMMANDS]
        wanted = [(target - speed) / 10, repeats / 4, lane, acceleration / 10, 0.0]
        np.testing.assert_allclose(row, wanted, atol=1e-6)


def starts_beside_a_left_lane(made: Simulation, seed: int) -> bool:
    made.reset(np.array([seed], dtype=np.uint64))
    return bool(made.scene.lane[0, 0] > 0)


@pytest.mark.parametrize("kind", [neighbours, paper_neighbours])
def test_options_add_rows_and_change_no_other(kind: Neighbours) -> None:
    scene = scene_of(x=[100.0, 133.0], y=[4.0, 8.0], target_lane=[0, 2], repeats=[2, 0])
    both = type(kind)(commands=True, action_mask=True)
    everybody: Any = all_vehicles(scene)
    seen = both(scene, everybody)
    assert seen.shape == (2, *both.shape) == (2, 9, 5)
    np.testing.assert_array_equal(seen[:, :COMMANDS], kind(scene, everybody))
    np.testing.assert_array_equal(seen[:, ACTION_MASK], action_masks(scene, everybody))
    np.testing.assert_allclose(seen[:, COMMANDS], [[0, 0.5, -1, 0, 0], [0, 0, 0, 0, 0]])
    masked = type(kind)(action_mask=True)(scene, everybody)
    np.testing.assert_array_equal(masked, seen[:, [*range(7), 8]])


@pytest.mark.parametrize("kind", [Neighbours, type(paper_neighbours)])
def test_an_observation_with_options_has_a_text_of_its_own(kind: type[Neighbours]) -> None:
    texts = set()
    for options in ({}, {"commands": True}, {"action_mask": True}):
        observation = kind.model_validate(options)
        texts.add(described(observation))
        assert observation_described(described(observation)) == observation
    assert len(texts) == 3

"""An action mask closes the lane changes that have no effect because the lane does not exist."""

import numpy as np
from hypothesis import given
from scenes import all_vehicles, scene_of, scenes

from charms_bench.engine import Cast
from charms_bench.engine.batched import BatchedEngine
from charms_bench.world.action_mask import action_masks
from charms_bench.world.actions import IDLE, LANE_LEFT, LANE_RIGHT
from charms_bench.world.observations import ACTION_MASK, Neighbours, PaperNeighbours
from charms_bench.world.scene import Scene, SceneSettings


def test_the_outermost_lanes_close_one_action_each() -> None:
    scene = scene_of(x=[10.0, 50.0, 90.0], y=[0.0, 4.0, 8.0], speed=[25.0] * 3)
    masks = action_masks(scene, all_vehicles(scene))
    assert masks.dtype == np.int8  # which Gymnasium's spaces sample with
    assert masks.tolist() == [[0, 1, 1, 1, 1], [1, 1, 1, 1, 1], [1, 1, 0, 1, 1]]


def test_a_vehicle_on_its_way_to_another_lane_may_turn_back() -> None:
    scene = scene_of(x=[10.0, 50.0], y=[0.5, 7.5], speed=[25.0] * 2, target_lane=[1, 1])
    assert action_masks(scene, all_vehicles(scene)).all()


def test_an_observation_can_end_with_the_mask() -> None:
    scene = scene_of(x=[10.0, 50.0], y=[0.0, 8.0], speed=[25.0] * 2)
    for kind in (Neighbours, PaperNeighbours):
        plain, masked = kind(), kind(action_mask=True)
        seen = masked(scene, all_vehicles(scene))
        assert (plain.shape, masked.shape) == ((7, 5), (8, 5))
        assert seen[:, ACTION_MASK].tolist() == [[0, 1, 1, 1, 1], [1, 1, 0, 1, 1]]
        assert (seen[:, :ACTION_MASK] == plain(scene, all_vehicles(scene))).all()


def target_lanes(profile: str, scene: Scene, action: int) -> np.ndarray:
    """The target lanes after a command to all vehicles of a scene, by the engine."""
    vehicles, lanes = scene.x.shape[1], scene.road.lanes
    settings = SceneSettings(
        profile=profile, lanes=lanes, traffic_vehicles=vehicles - 1, ego_slots=1
    )
    engine = BatchedEngine(settings, 1, Cast())
    for name in ("x", "y", "speed", "lane", "target_lane"):
        getattr(engine.scene, name)[:] = getattr(scene, name)
    engine.command(all_vehicles(scene), np.full(vehicles, action))
    return engine.scene.target_lane[0]


@given(scenes())
def test_a_masked_command_leaves_the_target_lane_as_idle_does(scene: Scene) -> None:
    scene.target_lane[:] = scene.lane
    closed = action_masks(scene, all_vehicles(scene)) == 0
    for profile in ("charms", "highway-env"):
        idle = target_lanes(profile, scene, IDLE)
        for action in (LANE_LEFT, LANE_RIGHT):
            assert (target_lanes(profile, scene, action) == idle)[closed[:, action]].all()

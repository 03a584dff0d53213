"""`Kinematics` is highway-env's own, number for number."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from highway_env.envs.common.observation import KinematicObservation
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scenes import all_vehicles, scene_of

from charms_bench.engine import Cast
from charms_bench.errors import InputError
from charms_bench.testing.reference_engine import HighwayEnvEngine
from charms_bench.world.actions import ACTIONS
from charms_bench.world.kinematics_observation import FEATURES, Kinematics
from charms_bench.world.observations import observation_of
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import SceneSettings


def engine_after(seconds: int, seed: int, profile: str, **settings: Any) -> HighwayEnvEngine:
    """highway-env's road after an ego has driven as it liked."""
    given = SceneSettings(profile=PROFILES[profile], **settings)
    engine = HighwayEnvEngine(given, 1, Cast({1: IdmMobil()}))
    agents = np.minimum(np.arange(given.vehicles), 1)[None]
    engine.reset(np.array([0]), np.array([seed], dtype=np.uint64), agents)
    rng = np.random.default_rng(seed)
    for _ in range(seconds):
        engine.command((np.array([0]), engine.scene.ego), rng.integers(len(ACTIONS), size=1))
        for _ in range(given.simulation_hz):
            engine.advance()
    return engine


def highway_envs(engine: HighwayEnvEngine, options: dict[str, Any]) -> np.ndarray:
    """What every vehicle of a road sees by highway-env's class."""
    road = engine.roads[0]
    environment = SimpleNamespace(road=road, PERCEPTION_DISTANCE=200.0)
    seen = []
    for vehicle in road.vehicles:
        observation = KinematicObservation(environment, **options)
        observation.observer_vehicle = vehicle
        seen.append(observation.observe())
    return np.array(seen)


options_of_highway_env = st.fixed_dictionaries(
    {},
    optional={
        "vehicles_count": st.integers(2, 25),
        "features": st.lists(st.sampled_from([*FEATURES]), min_size=1, unique=True),
        "features_range": st.dictionaries(
            st.sampled_from([*FEATURES]),
            st.tuples(st.integers(-100, 0), st.integers(1, 100)).map(list),
        ),
        "absolute": st.booleans(),
        "order": st.just("sorted"),
        "normalize": st.booleans(),
        "clip": st.booleans(),
        "see_behind": st.booleans(),
        "observe_intentions": st.booleans(),
        "include_obstacles": st.booleans(),
    },
)
SCENES = {
    "stock": lambda: engine_after(5, 0, "highway-env", lanes=4, traffic_vehicles=15, ego_slots=1),
    "dense": lambda: engine_after(8, 1, "charms", traffic_vehicles=12, density=3.0),
    "sparse": lambda: engine_after(3, 2, "charms", traffic_vehicles=3, density=0.2, ego_slots=1),
}


@pytest.fixture(scope="module", params=SCENES)
def engine(request: pytest.FixtureRequest) -> HighwayEnvEngine:
    return SCENES[request.param]()


@hypothesis_settings(derandomize=True, deadline=None, max_examples=15)
@given(options=options_of_highway_env)
def test_every_option_is_highway_envs_to_the_last_bit(
    engine: HighwayEnvEngine, options: dict[str, Any]
) -> None:
    seen = Kinematics(**options)(engine.scene, all_vehicles(engine.scene))
    np.testing.assert_array_equal(seen, highway_envs(engine, options))
    assert seen.dtype == np.float32


def test_nobody_further_back_than_two_lengths_is_seen_unless_asked_for() -> None:
    scene = scene_of(x=[100.0, 90.5, 89.5, 299.0, 301.0], y=[4.0] * 5)
    front = Kinematics()(scene, (np.array([0]), np.array([0])))[0]
    np.testing.assert_allclose(front[:4, 1], [0.5, -9.5 / 200, 199 / 200, 0.0], atol=1e-7)
    around = Kinematics(see_behind=True)(scene, (np.array([0]), np.array([0])))[0]
    np.testing.assert_allclose(around[1:4, 1], [-9.5 / 200, -10.5 / 200, 199 / 200], atol=1e-7)


def test_more_lanes_make_the_range_across_wider() -> None:
    for lanes in (2, 5):
        scene = scene_of(x=[100.0], y=[4.0], lanes=lanes)
        seen = Kinematics()(scene, all_vehicles(scene))
        assert seen[0, 0, 2] == np.float32(1 / lanes)


def test_it_has_a_name_and_takes_highway_envs_configuration() -> None:
    config = {"type": "Kinematics", "vehicles_count": 15, "features": ["x", "vx"], "clip": False}
    assert observation_of("Kinematics") == Kinematics()
    made = observation_of(config)
    assert made == Kinematics(vehicles_count=15, features=("x", "vx"), clip=False)
    assert made.shape == (15, 2)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"type": "OccupancyGrid"}, "no observation named 'OccupancyGrid'. Known: neigh"),
        ({"type": "Kinematics", "order": "shuffled"}, "Kinematics: order: .* 'sorted'"),
        ({"type": "Kinematics", "vehicle_count": 5}, "Kinematics: vehicle_count: unknown key"),
        ({"type": "Kinematics", "vehicles_count": 1}, "vehicles_count: .* found 1"),
        ({"type": "Kinematics", "features": ["vz"]}, r"no feature named 'vz'\. Known: presence, x"),
        ({"type": "Kinematics", "features": ["x", "x"]}, "a feature is listed twice"),
        (
            {"type": "Kinematics", "features_range": {"x": [5, 5]}},
            "of x is 5.0 to 5.0; expected low < high",
        ),
        ({"type": "neighbours", "clip": True}, "neighbours: clip: unknown key"),
        ({"vehicles_count": 5}, "no observation named 'None'"),
        (3, "no observation named '3'"),
    ],
)
def test_what_is_no_observation_is_one_message(config: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        observation_of(config)

"""Both engines move alike, step by step; and the compiled one moves as stock highway-v0.

`tests/golden` compares with what the reference did when it was recorded.
"""

import gymnasium
import highway_env  # noqa: F401  # registers highway-v0
import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.stackelberg import Stackelberg

from charms_bench.engine import ENGINES, Engine, make_engine
from charms_bench.world.actions import ACTIONS
from charms_bench.world.profile import PROFILES
from charms_bench.world.scene import SceneSettings

pytestmark = pytest.mark.slow

MODELS = {
    "idm_mobil": {0: IdmMobil()},
    "stackelberg": {0: Stackelberg(), 1: IdmMobil()},
    "commands": {1: IdmMobil()},
}
"""The driver models by agent; here, 0 drives the ego and the last one the traffic."""


def reset(engine: Engine, settings: SceneSettings, ego: str, seeds: list[int]) -> None:
    agents = np.full((len(seeds), settings.vehicles), max(MODELS[ego]))
    agents[:, 0] = 0
    engine.reset(np.arange(len(seeds)), np.array(seeds, dtype=np.uint64), agents)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize(
    ("profile", "lanes", "traffic", "density", "ego"),
    [
        ("highway-env", 4, 20, 1.0, "commands"),
        ("highway-env", 3, 20, 3.0, "commands"),
        ("highway-env", 2, 6, 2.0, "idm_mobil"),
        ("charms", 3, 20, 1.0, "idm_mobil"),
        ("charms", 3, 20, 3.0, "commands"),
        ("charms", 2, 10, 1.0, "stackelberg"),
        ("charms", 5, 24, 3.0, "stackelberg"),
    ],
)
def test_both_engines_move_alike(
    profile: str, lanes: int, traffic: int, density: float, ego: str, held: bool
) -> None:
    settings = SceneSettings(
        profile=PROFILES[profile], lanes=lanes, traffic_vehicles=traffic, density=density
    )
    engines = [make_engine(name, settings, 2, MODELS[ego]) for name in ENGINES]
    for engine in engines:
        reset(engine, settings, ego, seeds=[0, 1])
    ours, theirs = (engine.scene for engine in engines)
    rng = np.random.default_rng(0)
    for step in range(100):
        if ego == "commands" and step % 5 == 0:
            actions = rng.integers(len(ACTIONS), size=2)
            for engine in engines:
                engine.command((np.arange(2), engine.scene.ego), actions)
        for engine in engines:
            engine.advance(hold_egos=held and step % settings.steps_per_decision != 0)
        for name in ("x", "y", "acceleration", "steering"):
            np.testing.assert_allclose(
                getattr(ours, name), getattr(theirs, name), rtol=0, atol=1e-6, err_msg=f"{step}"
            )
        for name in ("lane", "target_lane", "crashed", "timer_s", "leaders", "followers"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), f"{step}")
    if ego == "commands":  # at random, so that wrecks are compared too
        assert ours.crashed.any()


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(("lanes", "vehicles", "density"), [(4, 30, 1.0), (3, 20, 2.0)])
def test_a_scene_is_that_of_stock_highway_v0(
    seed: int, lanes: int, vehicles: int, density: float
) -> None:
    config = {"lanes_count": lanes, "vehicles_count": vehicles, "vehicles_density": density}
    environment = gymnasium.make("highway-v0", config=config).unwrapped
    environment.reset(seed=seed)
    settings = SceneSettings(
        profile=PROFILES["highway-env"],
        lanes=lanes,
        traffic_vehicles=vehicles,
        density=density,
        ego_slots=1,
    )
    engine = make_engine("batched", settings, 1, MODELS["commands"])
    reset(engine, settings, "commands", [seed])
    rng = np.random.default_rng(seed)
    for decision in range(11):
        stock = environment.road.vehicles
        places = np.array([vehicle.position for vehicle in stock])
        ours = np.c_[engine.scene.x[0], engine.scene.y[0]]
        np.testing.assert_allclose(ours, places, rtol=0, atol=1e-6, err_msg=f"{decision}")
        speeds = [vehicle.speed for vehicle in stock]
        np.testing.assert_allclose(engine.scene.speed[0], speeds, rtol=0, atol=1e-6)
        assert list(engine.scene.crashed[0]) == [vehicle.crashed for vehicle in stock]
        action = rng.integers(len(ACTIONS), size=1)
        environment.step(int(action[0]))
        engine.command((np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)), action)
        for _ in range(settings.simulation_hz):
            engine.advance()

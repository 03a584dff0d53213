"""A vector of uniform numbers gives the same scene, to the last bit, as the seed that draws it."""

import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.stackelberg import Stackelberg
from hypothesis import given, settings
from hypothesis import strategies as st

from charms_bench.engine import Cast, MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.draws import LANE, SPEED, ReplayedDraws, draws_of
from charms_bench.foundation.generator import seeded
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.scene import ARRAYS, Scene, SceneSettings

MODELS = {0: Stackelberg(), 1: IdmMobil()}
SETTINGS = SceneSettings(lanes=4, traffic_vehicles=12, density=2.0)
SEEDS = np.arange(40, dtype=np.uint64)


def spawned(
    engine: MakeEngine, scene: SceneSettings, seeds: np.ndarray, draws: np.ndarray | None = None
) -> Scene:
    made = engine(scene, seeds.size, Cast(MODELS))
    rows, agents = np.arange(seeds.size), np.minimum(np.arange(scene.vehicles), 1)
    made.reset(rows, seeds, np.tile(agents, (seeds.size, 1)), draws)
    return made.scene


def assert_same(one: Scene, other: Scene) -> None:
    for name in set(ARRAYS) - {"generator"}:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


@pytest.mark.parametrize("ego_slots", [1, 6])
@pytest.mark.parametrize("engine", ENGINES)
def test_the_draws_of_a_seed_give_the_scene_of_the_seed(engine: MakeEngine, ego_slots: int) -> None:
    scene = SETTINGS.model_copy(update={"ego_slots": ego_slots})
    draws = draws_of(seeded(SEEDS), scene)
    assert draws.shape == (40, 4 * 13 + 1)
    assert_same(spawned(engine, scene, SEEDS, draws), spawned(engine, scene, SEEDS))


@pytest.mark.parametrize("ego_slots", [1, 6])
def test_the_generator_is_numpys_after_highway_envs_draws(ego_slots: int) -> None:
    scene = SETTINGS.model_copy(update={"ego_slots": ego_slots})
    ours, theirs = (spawned(engine, scene, SEEDS).generator for engine in ENGINES)
    np.testing.assert_array_equal(ours, theirs)


def test_both_engines_place_any_draws_alike() -> None:
    draws = np.random.default_rng(5).random((40, 4 * 13 + 1))
    ours, theirs = (spawned(engine, SETTINGS, SEEDS, draws) for engine in ENGINES)
    for name in ("ego", "x", "y", "speed", "lane", "timer_s"):
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-12)
    np.testing.assert_allclose(ours.temperament, theirs.temperament, atol=1e-12)


def test_draws_at_a_quarter_and_a_half_place_vehicles_as_computed_by_hand() -> None:
    # Half of 6 slots is slot 3, a quarter of 4 lanes is lane 1, and 33 (0.7 + 0.1 / 2) is 24.75.
    draws = np.full((1, 4 * 13 + 1), 0.5)
    draws[0, LANE::4] = 0.25
    scene = spawned(BatchedEngine, SETTINGS, SEEDS[:1], draws)
    assert scene.ego[0] == 3
    assert (scene.lane[0] == 1).all()
    np.testing.assert_allclose(np.delete(scene.speed[0], 3), 24.75)
    # (12 + 24.75) exp(-5/40 4) / 2 is 11.14505...; the first vehicle starts at 4 times that.
    assert scene.x[0, 0] == pytest.approx(44.5801, abs=1e-3)
    assert scene.temperament[0, 3] == 0.5


def test_the_number_for_the_egos_speed_has_no_effect() -> None:
    draws = draws_of(seeded(SEEDS), SETTINGS)
    changed = draws.copy()
    egos = (draws[:, 0] * SETTINGS.ego_slots).astype(int)
    changed[np.arange(40), SPEED + 4 * egos] = 0.9
    for engine in ENGINES:
        one, other = (spawned(engine, SETTINGS, SEEDS, each) for each in (draws, changed))
        assert_same(one, other)


@settings(deadline=None)
@given(st.integers(0, 2**64 - 1), st.integers(1, 2000), st.integers(2, 8))
def test_integers_are_those_of_numpys_generator(seed: int, slots: int, lanes: int) -> None:
    scene = SceneSettings(traffic_vehicles=2000, ego_slots=slots, lanes=lanes)
    (draws,) = draws_of(seeded(np.array([seed], dtype=np.uint64)), scene)
    rng = np.random.default_rng(seed)
    assert int(draws[0] * slots) == rng.integers(slots)
    assert int(draws[LANE] * lanes) == rng.choice(lanes)


def test_replayed_draws_are_used_up_by_a_scene() -> None:
    replayed = ReplayedDraws(draws_of(seeded(SEEDS[:1]), SETTINGS)[0], SETTINGS)
    replayed.integers(0, 6)
    for _ in range(4 * 13 - 1):
        replayed.random()
    with pytest.raises(IndexError):
        replayed.random()

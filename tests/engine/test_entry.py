"""A vehicle is its number in the order of entry, wherever its place; places can be empty."""

from typing import Any

import numpy as np
import pytest
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.varied_idm import VariedIdmMobil

from charms_bench import DriverModel, Policy, load_state, save_state
from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import OF_SCENES, SceneState
from charms_bench.errors import InputError
from charms_bench.plugins.traffic import Mixture
from charms_bench.recording.recording import Recording
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.actions import Actions
from charms_bench.world.kinematics_observation import Kinematics
from charms_bench.world.scene import Floats, Ints, Observations, Scene, SceneSettings, Vehicles

TYPES = [
    {"name": "truck", "proportion": 0.3, "length_m": 16.0, "desired_speed_mps": [22, 25]},
    {"name": "car", "proportion": 0.7},
]
SCENES = 6


class Wanderer(Policy):
    """Acts by a random number, by what it remembers, and by what it sees."""

    observation = Kinematics(vehicles_count=4)
    memory_width = 1
    noise_draws = 1

    def decide(
        self, observations: Observations, memory: Floats, noise: Floats
    ) -> tuple[Actions, Floats]:
        memory = memory * 0.5 + noise + np.abs(observations).sum(axis=(1, 2))[:, None]
        return (memory[:, 0] * 1e4).astype(np.int64) % 5, memory


class Shy(DriverModel):
    """Steers to the lane that the fewest vehicles before it in its scene steer to."""

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        number = np.arange(vehicles[0].size) - np.searchsorted(vehicles[0], vehicles[0])
        return np.where(number % 2 == 0, 0.5, -0.5), (scene.lane[vehicles] + number) % 3


MIXTURE = {"idm_mobil": 0.4, "varied": 0.3, "wanderer": 0.2, "shy": 0.1}


def simulation(
    engine: MakeEngine,
    vehicles: int = 10,
    ego: str = "wanderer",
    traffic: dict[str, float] = MIXTURE,
) -> Simulation:
    fields = {"duration_s": 6.0, "traffic_vehicles": vehicles - 1, "density": 3.0}
    settings = SceneSettings.model_validate({**fields, "vehicle_types": TYPES})
    agents: dict[str, Any] = {"wanderer": Wanderer(), "shy": Shy()}
    agents |= {"varied": VariedIdmMobil(), "idm_mobil": IdmMobil()}
    return Simulation(settings, SCENES, ego, Mixture(traffic), agents, engine)


def started(engine: MakeEngine, **others: Any) -> Simulation:
    made = simulation(engine, **others)
    made.reset(np.arange(SCENES, dtype=np.uint64))
    for _ in range(2):
        made.step()
    return made


def moved(state: SceneState, order: Ints) -> SceneState:
    """The same vehicles at other places: at place k stands the vehicle of place `order[k]`."""
    arrays = {
        name: array if name in OF_SCENES else array[:, order]
        for name, array in state.arrays().items()
    }
    return state.with_arrays({**arrays, "ego": np.argsort(order)[state.ego]})


def level(state: SceneState) -> SceneState:
    """The same scenes, in which each second vehicle is beside the one before it."""
    x, y, length = state.x.copy(), state.y.copy(), state.length.copy()
    x[:, 1::2], length[:] = x[:, ::2], state.length[:, :1]
    y[:, ::2], y[:, 1::2] = 0.0, 8.0
    return state.with_arrays(
        {"x": x, "y": y, "heading": x * 0.0, "target_lane": (y / 4).astype(int)}
    )


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("change", [lambda state: state, level])
def test_nothing_depends_on_the_places_of_vehicles(engine: MakeEngine, change: Any) -> None:
    made, other = started(engine), simulation(engine)
    start = change(made.state())
    order = np.random.default_rng(5).permutation(10)
    made.restore(start)
    other.restore(moved(start, order))
    collided = 0
    for _ in range(10):
        made.step()
        other.step()
        assert other.state() == moved(made.state(), order)
        np.testing.assert_array_equal(other.scene.parameters, made.scene.parameters[:, order])
        collided += made.scene.crashed.sum()
    assert collided > 0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_scene_that_a_vehicle_has_left_is_one_in_which_it_is_not(engine: MakeEngine) -> None:
    made, smaller = started(engine), simulation(engine, vehicles=9)
    state = made.state()
    gone = (state.ego + 3) % 10
    made.restore(state.without(gone))
    kept = np.arange(10) != gone[:, None]

    def rest(state: SceneState) -> SceneState:
        """Without the column of the vehicle that has left."""
        arrays = {
            name: array if name in OF_SCENES else array[kept].reshape(SCENES, 9, *array.shape[2:])
            for name, array in state.arrays().items()
        }
        ego = state.ego - (gone < state.ego)
        return SceneState(smaller.settings, state.agents, state.phase, **{**arrays, "ego": ego})

    smaller.restore(rest(state))
    for _ in range(10):
        made.step()
        smaller.step()
        assert smaller.state() == rest(made.state())


def test_nothing_is_recorded_of_an_empty_place() -> None:
    made, smaller = started(BatchedEngine), simulation(BatchedEngine, vehicles=9)
    state = made.state()
    state = state.without(np.full(SCENES, 9))  # the ego is one of the first six
    made.restore(state)
    arrays = {
        name: array if name in OF_SCENES else array[:, :9] for name, array in state.arrays().items()
    }
    smaller.restore(SceneState(smaller.settings, state.agents, state.phase, **arrays))
    recordings = [Recording(made), Recording(smaller)]
    for _ in range(18):
        for running, recording in zip((made, smaller), recordings, strict=True):
            if running.scene.active.any():
                running.step()
                recording.note()
    for rows in ("steps", "episodes", "drivers", "counts"):
        found, expected = (getattr(recording, rows)() for recording in recordings)
        if rows == "episodes":
            time_s = found.drop_in_place("traffic_time_s")
            before_s = state.steps / made.settings.decision_hz
            np.testing.assert_allclose(time_s, 8 * (found["duration_s"] - before_s))
        assert found.equals(expected), rows


def test_both_engines_agree_while_vehicles_come_and_go() -> None:
    traffic = {"idm_mobil": 0.5, "varied": 0.5}
    one, other = (started(engine, ego="idm_mobil", traffic=traffic) for engine in ENGINES)
    for round_ in range(3):
        for made in (one, other):
            state = made.state()
            place = (state.ego + 1 + round_) % 10
            state = state.without(place)
            made.restore(state)
            made.step()
            state = made.state()
            x = state.x[np.arange(SCENES), state.ego] - 30.0
            lane = np.full(SCENES, round_)
            made.restore(state.joined_by("idm_mobil", lane, x, np.full(SCENES, 30.0)))
            made.step()
        for name, array in one.state().arrays().items():
            np.testing.assert_allclose(getattr(other.state(), name), array, atol=1e-9, rtol=0)
    assert one.scene.entry.max(axis=1).tolist() == [12] * SCENES
    assert (np.sort(one.scene.entry, axis=1)[:, -3:] == [10, 11, 12]).all()


def test_a_newcomer_is_a_vehicle_of_the_profiles_size_that_remembers_nothing() -> None:
    state = started(BatchedEngine).state()
    place = (state.ego + 1) % 10
    speed, at = np.full(SCENES, 28.0), (np.arange(SCENES), place)
    x = np.full(SCENES, 1000.0)
    joined = state.without(place).joined_by("wanderer", np.full(SCENES, 2), x, speed)
    assert joined.present.all()
    assert (joined.x[at] == 1000.0).all()
    assert (joined.y[at] == 8.0).all()
    assert (joined.speed[at] == 28.0).all()
    assert (joined.target_speed[at] == 28.0).all()
    assert (joined.length[at] == 5.0).all()
    assert not joined.memory[at].any()


def test_a_full_scene_the_ego_and_an_empty_place_are_rejected() -> None:
    state = started(BatchedEngine).state()
    values = np.zeros(SCENES, dtype=int), np.full(SCENES, 100.0), np.full(SCENES, 30.0)
    with pytest.raises(InputError, match="scene 0 is full: it has 10 vehicles already"):
        state.joined_by("idm_mobil", *values)
    with pytest.raises(InputError, match=r"scene 0: vehicle \d is the ego"):
        state.without(state.ego)
    place = (state.ego + 1) % 10
    with pytest.raises(InputError, match=r"scene 0: vehicle \d has left already"):
        state.without(place).without(place)


def test_a_state_file_keeps_empty_places_and_numbers(tmp_path: Any) -> None:
    state = started(BatchedEngine).state()
    state = state.without((state.ego + 1) % 10)
    save_state(state, tmp_path / "state.json")
    assert load_state(tmp_path / "state.json") == state
    twice = state.entry.copy()
    twice[3, 1] = twice[3, 0]
    save_state(state.with_arrays({"entry": twice}), tmp_path / "state.json")
    with pytest.raises(InputError, match="entry: two vehicles of a scene have the same number"):
        load_state(tmp_path / "state.json")

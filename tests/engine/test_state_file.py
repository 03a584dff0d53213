"""States as files: all bits are kept, and files that are not states are rejected by field."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from charms_bench import load_state, save_state
from charms_bench.engine.simulation import Simulation
from charms_bench.envs.ego_env import EgoEnv, ego_vector_env
from charms_bench.errors import InputError
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.scene import SceneSettings


@pytest.fixture(scope="module")
def running() -> Simulation:
    agents = {"idm_mobil": make_agent("idm_mobil")}
    settings = SceneSettings(traffic_vehicles=4, ego_slots=1)
    made = Simulation(settings, 2, "idm_mobil", OneAgent("idm_mobil"), agents)
    made.reset(np.array([3, 2**63 + 1], dtype=np.uint64))
    made.step()
    made.advance()
    return made


@pytest.fixture
def file(running: Simulation, tmp_path: Path) -> Path:
    save_state(running.state(), tmp_path / "state.json")
    return tmp_path / "state.json"


def test_a_file_keeps_all_bits(running: Simulation, file: Path) -> None:
    assert load_state(file) == running.state()
    assert load_state(file).seeds.dtype == np.uint64
    assert file.stat().st_size < 10_000


def edited(change: Callable[[dict[str, Any]], object]) -> Callable[[str], str]:
    """An edit that also corrects the checksum, so that only the fields themselves are wrong."""

    def edit(text: str) -> str:
        fields = json.loads(text)
        change(fields)
        head = {name: fields.pop(name) for name in ("format", "version", "sha256")}
        body = json.dumps(fields)[1:] + "\n"
        head["sha256"] = hashlib.sha256(body.encode()).hexdigest()
        return json.dumps(head)[:-1] + ",\n" + body

    return edit


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[:-20], "is not a complete state file: .*save the state again"),
        (lambda text: "", "is not a complete state file"),
        (lambda text: "[" * 100_000, "is not a complete state file"),
        (lambda text: "[1]", "is not a state file; expected the format 'charms-bench scene state'"),
        (edited(lambda f: f.update(version=2)), "version: found 2, expected 6"),
        (edited(lambda f: f.pop("speed")), "speed: is missing"),
        (edited(lambda f: f.update(colour=1)), "colour: unknown field"),
        (edited(lambda f: f["settings"].update(lanes=1)), r"settings\.lanes: .*found 1"),
        (edited(lambda f: f["x"][0].__setitem__(0, float("nan"))), "found the number NaN"),
        (edited(lambda f: f["x"][0].append(1e200)), "x: rows have different lengths"),
        (edited(lambda f: f["x"][0].__setitem__(0, 1e300)), r"x: found 1e\+300, expected -"),
        (edited(lambda f: f["heading"][0].__setitem__(0, 1e9)), r"heading: found 1000000000\.0, "),
        (edited(lambda f: f["speed"][0].__setitem__(0, 70.0)), r"speed: found 70\.0, .* -66 to 66"),
        (edited(lambda f: f["steering"][0].__setitem__(0, 1.6)), r"steering: found 1\.6, expected"),
        (edited(lambda f: f["impact_y"][1].__setitem__(0, 99.0)), r"impact_y: found 99\.0, expect"),
        (edited(lambda f: f["speed"].pop()), r"speed: found the shape \(1, 5\), expected \(2, 5\)"),
        (edited(lambda f: f["ego"].__setitem__(0, 5)), "ego: found 5, expected 0 to 4"),
        (edited(lambda f: f["ego"].__setitem__(0, 0.5)), "ego: expected integers"),
        (edited(lambda f: f["drivers"][0].__setitem__(0, 1)), "drivers: found 1, expected 0 to 0"),
        (
            edited(lambda f: f["repeats"][0].__setitem__(0, 101)),
            "repeats: found 101, .*-100 to 100",
        ),
        (edited(lambda f: f["crashed"][0].__setitem__(0, 2)), "crashed: expected true or false"),
        (
            edited(lambda f: f["seeds"].__setitem__(0, "3")),
            "seeds: expected integers from 0",
        ),
        (edited(lambda f: f.update(seeds=[-1, 3])), "seeds: expected int"),
        (edited(lambda f: f["generator"][0].append(1)), "generator: rows have different lengths"),
        (edited(lambda f: f["generator"][1].__setitem__(2, 0.5)), "generator: expected integers"),
        (
            edited(lambda f: f.update(generator=[1, 2])),
            r"generator: found the shape \(2,\), expect",
        ),
        (edited(lambda f: f.update(agents=["idm_mobil"] * 2)), "agents: a name occurs twice"),
        (edited(lambda f: f.update(agents=3)), "agents: expected a list of names"),
        (edited(lambda f: f.update(phase=9)), "phase: found 9, expected 0 to 5"),
        (edited(lambda f: f.update(phase="1")), "phase: found '1', expected an integer"),
    ],
)
def test_a_file_that_is_not_a_state_is_rejected(
    change: Callable[[str], str], message: str, file: Path
) -> None:
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError, match=rf"state\.json: .*{message}"):
        load_state(file)


def test_a_file_of_which_a_digit_was_edited_or_that_was_written_again_says_so(file: Path) -> None:
    text, rng = file.read_text(), np.random.default_rng(0)
    edits = [json.dumps(json.loads(text)), text + "\n", text.replace('"idm_mobil"', '"level_0"')]
    places = [k for k, letter in enumerate(text) if letter.isdigit()]
    for place in rng.choice(places, 60, replace=False):
        digit = (int(text[place]) + rng.integers(1, 10)) % 10
        edits.append(f"{text[:place]}{digit}{text[place + 1 :]}")
    for changed in edits:
        file.write_text(changed)
        with pytest.raises(InputError, match=r"sha256: .*has been edited or damaged; save the sta"):
            load_state(file)


def test_what_is_not_a_state_of_scenes_is_named(tmp_path: Path) -> None:
    env = ego_vector_env(2)
    env.reset(seed=3)
    state: Any = env.get_state()
    with pytest.raises(InputError, match=r"found EpisodesState, expected a SceneState; save the"):
        save_state(state, tmp_path / "state.json")
    save_state(state.scenes, tmp_path / "state.json")
    restored = load_state(tmp_path / "state.json")
    assert restored == state.scenes
    observations, _ = env.reset(options={"state": restored})
    np.testing.assert_array_equal(observations, env.set_state(state))
    with pytest.raises(InputError, match=r"found SceneState, expected an EpisodesState; a Scene"):
        env.set_state(state.scenes)
    with pytest.raises(InputError, match="found EpisodesState, expected a SceneState"):
        EgoEnv().set_state(state)


def test_a_vehicle_that_spins_off_the_road_is_a_state(tmp_path: Path) -> None:
    env = ego_vector_env(
        1, actions="continuous", profile="highway-env", traffic_vehicles=0, ego_slots=1
    )
    env.reset(seed=3)
    for _ in range(40):
        _, _, crashed, *_ = env.step(np.array([[1.0, 1.0]]))
        assert not crashed
    state = env.get_state().scenes
    assert np.abs(state.heading).max() > 40
    save_state(state, tmp_path / "state.json")
    assert load_state(tmp_path / "state.json") == state


def test_a_file_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.json: cannot be read: No such file"):
        load_state(tmp_path / "nothing.json")

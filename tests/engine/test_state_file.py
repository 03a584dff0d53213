"""States as files: all bits are kept, and files that are not states are refused by field."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from charms_bench import load_state, save_state
from charms_bench.engine.simulation import Simulation
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
    def edit(text: str) -> str:
        fields = json.loads(text)
        change(fields)
        return json.dumps(fields)

    return edit


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[:-20], "is not a complete state file: .*save the state again"),
        (lambda text: "", "is not a complete state file"),
        (lambda text: "[" * 100_000, "is not a complete state file"),
        (lambda text: "[1]", "is not a state file; expected the format 'charms-bench scene state'"),
        (edited(lambda f: f.update(version=2)), "version: found 2, expected 1"),
        (edited(lambda f: f.pop("speed")), "speed: is missing"),
        (edited(lambda f: f.update(colour=1)), "colour: unknown field"),
        (edited(lambda f: f["settings"].update(lanes=1)), r"settings\.lanes: .*found 1"),
        (edited(lambda f: f["x"][0].__setitem__(0, float("nan"))), "found the number NaN"),
        (lambda text: text.replace('"x": [[', '"x": [[1e999, '), "x: rows have different lengths"),
        (edited(lambda f: f["x"][0].__setitem__(0, 1e300)), r"x: found 1e\+300, expected -1e\+09"),
        (edited(lambda f: f["speed"].pop()), r"speed: found the shape \(1, 5\), expected \(2, 5\)"),
        (edited(lambda f: f["ego"].__setitem__(0, 5)), "ego: found 5, expected 0 to 4"),
        (edited(lambda f: f["ego"].__setitem__(0, 0.5)), "ego: expected integers"),
        (edited(lambda f: f["drivers"][0].__setitem__(0, 1)), "drivers: found 1, expected 0 to 0"),
        (edited(lambda f: f["crashed"][0].__setitem__(0, 2)), "crashed: expected true or false"),
        (
            edited(lambda f: f["seeds"].__setitem__(0, "3")),
            "seeds: expected a list of integers from 0",
        ),
        (edited(lambda f: f.update(seeds=[-1, 3])), "seeds: expected a list of int"),
        (edited(lambda f: f.update(agents=["idm_mobil"] * 2)), "agents: a name occurs twice"),
        (edited(lambda f: f.update(agents=3)), "agents: expected a list of names"),
        (edited(lambda f: f.update(phase=9)), "phase: found 9, expected 0 to 5"),
        (edited(lambda f: f.update(phase="1")), "phase: found '1', expected an integer"),
    ],
)
def test_a_file_that_is_not_a_state_is_refused(
    change: Callable[[str], str], message: str, file: Path
) -> None:
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError, match=rf"state\.json: .*{message}"):
        load_state(file)


def test_a_file_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nothing\.json: cannot be read: No such file"):
        load_state(tmp_path / "nothing.json")

"""States: restored scenes continue as if never interrupted, and misfits are rejected."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from interrupted import Whims, moments

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import InputError
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import Mixture
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.actions import IDLE, LANE_RIGHT
from charms_bench.world.scene import SceneSettings

SMALL = SceneSettings(duration_s=4.0, traffic_vehicles=7, density=3.0)
MIXTURE = {"idm_mobil": 0.4, "outside_model": 0.2, "whims": 0.4}
TOOL = Path(__file__).parents[2] / "tools" / "check_states.py"


def simulation(
    scenes: int,
    engine: MakeEngine = BatchedEngine,
    ego: str | None = "whims",
    settings: SceneSettings = SMALL,
    traffic: dict[str, float] = MIXTURE,
) -> Simulation:
    names = {*traffic, *([ego] if ego else [])}
    agents = {name: Whims() if name == "whims" else make_agent(name) for name in names}
    return Simulation(settings, scenes, ego, Mixture(traffic), agents, engine)


def started(scenes: int = 3, **arguments: object) -> Simulation:
    made = simulation(scenes, **arguments)  # type: ignore[arg-type]
    made.reset(np.arange(scenes, dtype=np.uint64))
    return made


@pytest.mark.parametrize("engine", ENGINES)
def test_restored_scenes_continue_to_the_last_bit_as_if_never_interrupted(
    engine: MakeEngine,
) -> None:
    original = started(engine=engine)
    kept = [original.state(), *moments(original)]
    assert any(state.crashed.any() and state.active.all() for state in kept)
    later = simulation(3, engine)
    rows = np.array([2, 0, 1])
    for start in range(0, len(kept) - 1, 5 if engine is BatchedEngine else 17):
        later.restore(kept[start].take(rows))
        for expected, found in zip(kept[start + 1 :], moments(later), strict=False):
            assert found == expected.take(rows), start


@pytest.mark.slow
def test_states_of_either_engine_continue_in_the_other_to_the_last_bit() -> None:
    asked = ["--batched", "0", "--reference", "0", "--across", "16"]
    command = [sys.executable, str(TOOL), *asked]
    subprocess.run(command, check=True)


@pytest.mark.parametrize("engines", [ENGINES, ENGINES[::-1]])
def test_a_state_of_one_engine_continues_in_the_other(engines: tuple[MakeEngine, ...]) -> None:
    saved, continued = started(engine=engines[0]), simulation(3, engines[1])
    for _ in range(4):
        saved.step()
    saved.advance()
    continued.restore(saved.state())
    for expected, found in zip(moments(saved), moments(continued), strict=True):
        np.testing.assert_allclose(found.x, expected.x, rtol=0, atol=1e-6)
        for name in ("target_lane", "crashed", "ending", "action", "collision"):
            assert (getattr(found, name) == getattr(expected, name)).all(), name


def test_only_the_rows_asked_for_are_restored() -> None:
    running = started()
    running.step()
    state = running.state(np.array([1]))
    running.step()
    before = running.state()
    running.restore(state, np.array([2]))
    after = running.state()
    assert after.take(np.arange(2)) == before.take(np.arange(2))
    assert after.take(np.array([2])) == state


def test_a_seated_agent_drives_from_then_on() -> None:
    running = started(ego="idm_mobil", traffic={"idm_mobil": 1.0, "level_0": 0.0})
    running.step()
    places = np.where(running.scene.ego == 1, 2, 1)
    seated = running.state().seated(places, "level_0")
    running.restore(seated)
    running.step()
    assert (running.drivers[np.arange(3), places] == "level_0").all()
    assert running.has_action.sum() == 3
    assert running.has_action[np.arange(3), places].all()


def test_the_ego_of_a_restored_scene_may_be_driven_from_outside() -> None:
    running = started()
    running.step()
    outside = simulation(3, ego=None)
    outside.restore(running.state().seated(running.scene.ego, ""))
    outside.step(np.array([LANE_RIGHT, IDLE, IDLE]))
    assert outside.action[outside.ego_vehicles].tolist() == [LANE_RIGHT, IDLE, IDLE]


def test_values_that_mean_nothing_are_the_same_in_every_state() -> None:
    running = started()
    first = running.state()
    for _ in range(12):
        running.step()
    running.reset(np.arange(3, dtype=np.uint64))
    assert running.state() == first


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"settings": SceneSettings(duration_s=4.0, traffic_vehicles=7)},
            r"of another scene: density is 3\.0, and here it is 1\.0",
        ),
        (
            {
                "settings": SceneSettings.model_validate(
                    {
                        **SMALL.model_dump(),
                        "profile": {"name": "charms", "idm_mobil": {"politeness": 0.1}},
                    }
                )
            },
            r"profile\.idm_mobil\.politeness is 0\.0, and here it is 0\.1",
        ),
        ({"scenes": 2}, "a state of 3 scenes cannot continue in 2 scenes"),
        ({"ego": "idm_mobil", "traffic": {"idm_mobil": 1.0}}, "agent 'whims' drives a vehicle"),
        (
            {"traffic": {"outside_model": 0.3, "idm_mobil": 0.4, "whims": 0.3}},
            "driver models act in the order idm_mobil, outside_model; here, in the order outside",
        ),
    ],
)
def test_a_state_that_does_not_fit_is_rejected_and_nothing_changes(
    arguments: dict[str, object], message: str
) -> None:
    state = started().state()
    other = started(**arguments)  # type: ignore[arg-type]
    before = other.state()
    with pytest.raises(InputError, match=message):
        other.restore(state)
    assert other.state() == before


def test_all_scenes_decide_together() -> None:
    running = started()
    state = running.state(np.array([0]))
    running.advance()
    with pytest.raises(InputError, match="0 simulation steps after a decision; the other scenes"):
        running.restore(state, np.array([0]))
    running.restore(running.state(np.array([1])), np.array([0]))

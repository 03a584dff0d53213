"""Speed commands that grow when they are repeated."""

import numpy as np
import pytest

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.actions import FASTER, IDLE, LANE_LEFT, LANE_RIGHT, SLOWER
from charms_bench.world.scene import SceneSettings

STEPS = {"name": "charms", "target_speed_steps_mps": [0.25, 0.5, 1.0, 2.0], "ego_speed_mps": 25.0}


def driven_from_outside(engine: MakeEngine) -> Simulation:
    settings = SceneSettings.model_validate({"profile": STEPS, "ego_slots": 1})
    agents = {"idm_mobil": make_agent("idm_mobil")}
    made = Simulation(settings, 1, None, OneAgent("idm_mobil"), agents, engine)
    made.reset(np.zeros(1, dtype=np.uint64))
    return made


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("commands", "changes"),
    [
        ([FASTER] * 6, [0.25, 0.5, 1.0, 2.0, 2.0, 2.0]),
        ([SLOWER] * 2, [-0.25, -0.5]),
        ([FASTER, FASTER, SLOWER, SLOWER, FASTER], [0.25, 0.5, -0.25, -0.5, 0.25]),
        ([SLOWER, SLOWER, IDLE, SLOWER], [-0.25, -0.5, 0.0, -0.25]),
        ([FASTER, LANE_LEFT, FASTER, LANE_RIGHT], [0.25, 0.0, 0.25, 0.0]),
    ],
)
def test_repeated_commands_change_the_target_speed_by_growing_steps(
    engine: MakeEngine, commands: list[int], changes: list[float]
) -> None:
    made, targets = driven_from_outside(engine), [25.0]
    for command in commands:
        made.step(np.array([command]))
        targets.append(float(made.scene.target_speed[made.ego_vehicles][0]))
    np.testing.assert_array_equal(np.diff(targets), changes)


def test_a_new_driver_begins_with_the_smallest_step() -> None:
    made = driven_from_outside(BatchedEngine)
    made.step(np.array([FASTER]))
    state = made.state()
    everyone = np.ones(state.drivers.shape, dtype=np.bool_)
    assert state.repeats.any()
    assert not state.driven_by("idm_mobil", everyone).repeats.any()


def test_a_scene_without_such_steps_is_described_as_before() -> None:
    assert "target_speed_steps_mps" not in SceneSettings().model_dump()["profile"]
    assert SceneSettings.model_validate({"profile": STEPS}).model_dump()["profile"][
        "target_speed_steps_mps"
    ] == (0.25, 0.5, 1.0, 2.0)

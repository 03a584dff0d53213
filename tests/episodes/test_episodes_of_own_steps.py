"""Episodes of a policy with speed steps of its own, looked at again."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from charms_bench.episodes.avoidability import avoidability, collisions
from charms_bench.episodes.minari_dataset import check_policy
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import replay
from charms_bench.episodes.what_if import what_if
from charms_bench.errors import InputError
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite
from charms_bench.world.actions import FASTER, SLOWER

SCENE = {"duration_s": 6.0, "traffic_vehicles": 9, "density": 1.5, "ego_slots": 3}
EPISODES = 12


@pytest.fixture
def cell(network_file: Callable[..., Path], tmp_path: Path) -> RecordedCell:
    """Its ego always speeds up, by 0.5 m/s and then by 3 m/s."""
    onnx = pytest.importorskip("onnx")
    weights = np.zeros((35, 5))
    weights[0, FASTER] = 1.0  # the first number that a vehicle observes is 1
    path = network_file(weights, name="hasty.onnx")
    model = onnx.load(path)
    onnx.helper.set_model_props(model, {"target_speed_steps_mps": "[0.5, 3.0]"})
    onnx.save(model, path)
    suite = {
        "suite": "small",
        "episodes": EPISODES,
        "seed": 900_000_000,
        "scene": SCENE,
        "egos": [{"agent": str(path), "label": "hasty"}, {"agent": "level_0"}],
        "traffics": [{"traffic": {"mixture": {"idm_mobil": 0.5, "level_0": 0.5}}}],
    }
    return RecordedCell(run(Suite.model_validate(suite), tmp_path / "run", workers=1), 0, Path())


def test_episodes_repeat_and_can_be_taken_over(cell: RecordedCell) -> None:
    ended, going = collisions(cell)[0], 900_000_000
    assert len(replay(cell, [ended, going])) == 2
    own = cell.cell.ego.agent.key
    same = what_if(cell, going, 2, own, None)
    assert np.array_equal(same.recorded.x, same.other.x)
    place = next(k for k, name in enumerate(same.recorded.agents) if name == "level_0")
    taken = what_if(cell, going, 2, own, place).other
    assert taken.agents[place] == own
    assert taken.action[taken.frame_of(2), place] == FASTER


def test_other_actions_of_the_ego_have_its_steps(cell: RecordedCell) -> None:
    outside = cell.simulation(2, is_ego_outside=True)
    outside.reset(np.array([900_000_000, 900_000_001], dtype=np.uint64))
    before = outside.scene.target_speed[outside.ego_vehicles]
    outside.step(np.array([FASTER, SLOWER]))
    outside.step(np.array([SLOWER, SLOWER]))
    after = outside.scene.target_speed[outside.ego_vehicles]
    np.testing.assert_array_equal(after - before, [0.0, -3.5])
    found = avoidability(cell, collisions(cell)[:3], agents=["idm_mobil"])
    replaced = [each for each in found if each.replacement and each.replacement.is_ego]
    assert replaced
    for each in replaced:
        assert each.replacement is not None
        assert (each.last_step or 0) >= each.replacement.step


def test_no_environment_has_the_actions_of_its_dataset(cell: RecordedCell) -> None:
    with pytest.raises(InputError, match=r"hasty has speed steps of its own, \[0\.5, 3\.0\] m/s"):
        check_policy(cell)
    check_policy(RecordedCell(cell.run, 1, Path()))

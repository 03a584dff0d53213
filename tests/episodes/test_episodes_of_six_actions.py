"""A network with six outputs is run, replayed, branched, searched and compared as it says."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from linear_network import linear_network

from charms_bench.api.results import open_run
from charms_bench.episodes.animation import moment_of
from charms_bench.episodes.avoidability import avoidability, collisions
from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.minari_dataset import check_policy, environment_of
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import replay
from charms_bench.episodes.what_if import what_if
from charms_bench.errors import ModelError
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.report.html.packed import pack
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite
from charms_bench.world.actions import DEFAULT_ACTIONS, FASTER, MetaAction
from charms_bench.world.observations import FRONT
from charms_bench.world.picture import status_of

BRAKE = 5
SIX = (*DEFAULT_ACTIONS, MetaAction("BRAKE", speed_from_present_mps=-6.0))
LISTED = ["LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER"]
TEXT = json.dumps([*LISTED, {"name": "BRAKE", "speed_from_present_mps": -6.0}])
SCENE = {"duration_s": 6.0, "traffic_vehicles": 9, "density": 1.5, "ego_slots": 3}


def braking(folder: Path, count: int = 6, text: str = TEXT, **more: str) -> Path:
    """Brakes behind a slower leader in sight, and speeds up otherwise."""
    weights = np.zeros((35, count))
    weights[0, FASTER], weights[0, count - 1] = 0.5, 0.0  # the first number is 1
    weights[5 * FRONT + 3, count - 1] = -20.0  # the relative speed of the leader
    return linear_network(folder / "braking.onnx", weights, metadata={"actions": text, **more})


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> RecordedCell:
    folder = tmp_path_factory.mktemp("braking")
    suite = {
        "suite": "small",
        "episodes": 30,
        "seed": 900_000_000,
        "scene": SCENE,
        "egos": [{"agent": str(braking(folder)), "label": "braking"}, {"agent": "level_0"}],
        "traffic_models": [{"traffic": {"mixture": {"idm_mobil": 0.5, "level_0": 0.5}}}],
    }
    return RecordedCell(run(Suite.model_validate(suite), folder / "run", workers=1), 0, Path())


def test_a_run_is_replayed_with_the_names_of_its_actions(cell: RecordedCell) -> None:
    rows = cell.rows.steps
    braked = rows.filter(pl.col("action") == BRAKE)
    assert 0 < braked.height < rows.height
    assert rows["acceleration"].min() >= -7.5
    (again,) = replay(cell, [int(braked["episode"][0])])
    frame = again.frame_of(int(braked["step"][0]))
    assert again.action_names == (*LISTED, "BRAKE")
    view = ego_view(again)
    assert status_of(moment_of(again, view, frame))["action"] == "brake"
    assert pack(again, view)["actions"][BRAKE] == "brake"


def test_a_run_folder_says_which_actions_its_rows_have(cell: RecordedCell) -> None:
    opened = open_run(cell.run.folder.path)
    (said,) = [each["actions"] for each in opened.manifest["agents"].values() if "actions" in each]
    assert said == TEXT
    (interface,) = opened.interfaces()
    assert interface.endswith(f"chooses the meta-actions {', '.join(LISTED)}, BRAKE at 3 Hz")


def test_a_vehicle_can_be_taken_over_by_it_and_from_it(cell: RecordedCell) -> None:
    own, episode = cell.cell.ego.agent.key, 900_000_000
    same = what_if(cell, episode, 2, own, None)
    assert np.array_equal(same.recorded.x, same.other.x)
    place = next(k for k, name in enumerate(same.recorded.agents) if name == "level_0")
    taken = what_if(cell, episode, 2, own, place).other
    assert taken.action[taken.frame_of(2), place] in (FASTER, BRAKE)
    assert what_if(cell, episode, 2, "level_0", None).other.agents[taken.ego] == "level_0"


def test_searches_try_every_action_of_the_driver(cell: RecordedCell) -> None:
    outside = cell.simulation(2, is_ego_outside=True)
    assert outside.meta_actions[outside.agents.index("")] == SIX
    cells = (cell, RecordedCell(cell.run, 1, Path()))
    crashed = [(each, episode) for each in cells for episode in collisions(each)]
    for where, episode in crashed[:2]:
        (found,) = avoidability(where, [episode], agents=[], budget=20_000)
        if found.replacement is not None:
            assert {found.replacement.was, found.replacement.instead} <= {*LISTED, "BRAKE"}
    assert crashed


def test_a_dataset_has_its_space_and_its_environment(cell: RecordedCell) -> None:
    policy = check_policy(cell)
    assert policy.actions == SIX
    spec = environment_of(cell.cell, policy)
    assert spec is not None
    assert json.dumps(spec.kwargs["actions"]) == TEXT
    environment = spec.make()
    assert environment.action_space.n == 6  # type: ignore[attr-defined]
    assert environment.reset(seed=900_000_000)[1]["action_mask"].shape == (6,)


@pytest.mark.parametrize(
    ("count", "text", "what"),
    [
        (6, "meta", r"expected .* \(batch, 5\), or .* a JSON list of A meta-actions as the metada"),
        (5, TEXT, r"expected .* one float32 output \(batch, 6\)"),
        (6, TEXT.replace("BRAKE", "IDLE"), "metadata: actions: the list has two meta-actions name"),
        (6, TEXT.replace("speed_from", "from"), "meta-action 'BRAKE': unknown key 'from_present"),
        (6, "[" + TEXT, "metadata: actions: found .* expected a JSON list of meta-actions"),
    ],
)
def test_a_file_of_another_width_or_with_impossible_actions_says_what_was_expected(
    tmp_path: Path, count: int, text: str, what: str
) -> None:
    with pytest.raises(ModelError, match=what):
        OnnxPolicy(braking(tmp_path, count, text))


def test_speed_steps_are_given_once(tmp_path: Path) -> None:
    path = braking(tmp_path, target_speed_steps_mps="[1]")
    with pytest.raises(ModelError, match="steps are part of the meta-actions in the list"):
        OnnxPolicy(path)

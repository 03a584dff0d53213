"""Episodes of a policy with speed steps of its own, looked at again."""

from pathlib import Path

import numpy as np
import pytest
from linear_network import linear_network

from charms_bench.episodes.avoidability import _Always, avoidability, collisions
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import replay
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite
from charms_bench.world.actions import (
    ACTIONS,
    DEFAULT_ACTIONS,
    FASTER,
    SLOWER,
    Actions,
    with_speed_steps,
)
from charms_bench.world.scene import Observations

SCENE = {"duration_s": 6.0, "traffic_vehicles": 9, "density": 1.5, "ego_slots": 3}
EPISODES = 30


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> RecordedCell:
    """Its ego always speeds up, by 4 m/s and then by 3 m/s, to 33 m/s."""
    weights, folder = np.zeros((35, 5)), tmp_path_factory.mktemp("hasty")
    weights[0, FASTER] = 1.0  # the first number that a vehicle observes is 1
    steps = {"target_speed_steps_mps": "[4.0, 3.0]"}
    path = linear_network(folder / "hasty.onnx", weights, metadata=steps)
    suite = {
        "suite": "small",
        "episodes": EPISODES,
        "seed": 900_000_000,
        "scene": SCENE,
        "egos": [{"agent": str(path), "label": "hasty"}, {"agent": "level_0"}],
        "traffic_models": [{"traffic": {"mixture": {"idm_mobil": 0.5, "level_0": 0.5}}}],
    }
    return RecordedCell(run(Suite.model_validate(suite), folder / "run", workers=1), 0, Path())


def test_other_actions_of_the_ego_have_its_steps(cell: RecordedCell) -> None:
    outside = cell.simulation(2, is_ego_outside=True)
    outside.reset(np.array([900_000_000, 900_000_001], dtype=np.uint64))
    before = outside.scene.target_speed[outside.ego_vehicles]
    outside.step(np.array([FASTER, SLOWER]))
    outside.step(np.array([SLOWER, SLOWER]))
    after = outside.scene.target_speed[outside.ego_vehicles]
    # From 30 m/s to 33 m/s, the fastest, and 4 m/s back; and down by 4 and by 3 m/s.
    np.testing.assert_array_equal(after - before, [-1.0, -7.0])


def test_a_replaced_action_of_the_ego_has_its_steps(cell: RecordedCell) -> None:
    """The latest single action that avoids a collision, by plain simulation from the seed."""
    scene = cell.run.suite.scene
    settings = scene.model_copy(update={"duration_s": scene.duration_s + 3.0})
    compared = 0
    for each in avoidability(cell, collisions(cell), agents=[]):
        if each.replacement is None or not each.replacement.is_ego:
            continue
        (episode,) = replay(cell, [each.episode])
        until = -(-(int(episode.crashed[:, episode.ego].argmax()) + 30) // 5)
        others = [action for action in range(len(ACTIONS)) if action != FASTER]
        tried = [(step, action) for step in range(1, each.step + 1) for action in others]
        plain = cell.simulation(len(tried), settings=settings, is_ego_outside=True)
        plain.reset(np.full(len(tried), each.episode, dtype=np.uint64))
        for decision in range(1, until + 1):
            plain.step(np.array([a if step == decision else FASTER for step, a in tried]))
        avoids = [tried[k] for k in np.nonzero(~plain.failed)[0]]
        latest = max(step for step, _ in avoids)
        first = next(action for step, action in avoids if step == latest)
        found = each.replacement
        assert (found.step, found.instead) == (latest, ACTIONS[first])
        compared += 1
    assert compared > 2


def test_a_replaced_action_is_carried_out_with_the_steps_of_its_driver(
    cell: RecordedCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    decide, asked = _Always.decide, set()

    def noted(policy: _Always, observations: Observations) -> Actions:
        asked.add(policy.actions)
        return decide(policy, observations)

    monkeypatch.setattr(_Always, "decide", noted)
    avoidability(cell, collisions(cell)[:3], agents=[])
    assert asked == {
        with_speed_steps(4.0, 3.0),
        DEFAULT_ACTIONS,
    }  # of the ego, and of level_0 in the traffic

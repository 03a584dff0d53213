"""Lane changes and undone ones are counted alike for likeness and as metrics."""

import numpy as np
import pytest

from charms_bench.engine.simulation import Simulation
from charms_bench.metrics import standard, sums_by_episode
from charms_bench.people.behind import count_lanes
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.recording.recording import Recording
from charms_bench.world.scene import SceneSettings

EPISODES = 60


@pytest.mark.parametrize("hz", [3, 5])
def test_the_likeness_and_the_metrics_count_the_same_lane_changes(hz: int) -> None:
    settings = SceneSettings(decision_hz=hz, lanes=5)  # with many lanes, many changes are undone
    agents = {name: make_agent(name) for name in ("stackelberg", "idm_mobil")}
    traffic = OneAgent("idm_mobil")
    counted = count_lanes(settings, "stackelberg", "stackelberg", traffic, agents, EPISODES)
    simulation = Simulation(settings, EPISODES, "stackelberg", traffic, agents)
    simulation.reset(np.arange(EPISODES, dtype=np.uint64))
    recording = Recording(simulation)
    while simulation.scene.active.any():
        simulation.step()
        recording.note()
    (metric,) = (m for m in standard(0.0).metrics if m.name == "lane_changes_undone")
    (sums,) = sums_by_episode([metric], recording.episodes(), recording.steps(), settings)
    whole = ~simulation.failed  # the step of a collision counts for the likeness only
    assert whole.sum() > EPISODES / 2
    assert sums[whole, 1].sum() > 5
    np.testing.assert_array_equal(counted[whole, 1:], sums[whole])

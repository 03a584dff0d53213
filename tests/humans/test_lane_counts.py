"""Lane changes and undone ones are counted alike for likeness and as metrics."""

import numpy as np
import pytest

from charms_bench.engine.simulation import Simulation
from charms_bench.humans.blind_lanes import BlindLanes
from charms_bench.humans.resimulation import count_lanes
from charms_bench.metrics import standard, sums_by_episode
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
    recording = Recording.of(simulation)
    (metric,) = (m for m in standard(0.0).metrics if m.name == "lane_changes_undone")
    (sums,) = sums_by_episode([metric], recording.episodes(), recording.steps(), settings)
    whole = ~simulation.failed  # the step of a collision counts for the likeness only
    assert whole.sum() > EPISODES / 2
    assert sums[whole, 1].sum() > 5
    assert counted[:, 3].sum() == simulation.scene.crashed[:, 0].sum()
    np.testing.assert_array_equal(counted[whole, 1:3], sums[whole])


def test_the_blind_driver_changes_lanes_as_often_as_it_is_told_and_collides() -> None:
    agents = {"blind": BlindLanes(2.0, 3), "idm_mobil": make_agent("idm_mobil")}
    settings = SceneSettings(traffic_vehicles=20)
    counted = count_lanes(settings, "blind", "blind", OneAgent("idm_mobil"), agents, EPISODES)
    km, changes, _, collisions = counted.sum(axis=0)
    assert changes / km == pytest.approx(2.0, rel=0.3)
    assert collisions > 0

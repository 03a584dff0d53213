"""What vehicles do while they follow, against a count vehicle by vehicle."""

from collections import Counter

import numpy as np
from charms_baselines.idm_mobil import IdmMobil

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.traffic import OneAgent
from charms_bench.recording.columns import COUNT_SCHEMA
from charms_bench.recording.recording import Recording
from charms_bench.world.scene import Scene, SceneSettings

Counts = Counter[tuple[int, str, int]]


def simulation(settings: SceneSettings, ego: str | None = "idm_mobil") -> Simulation:
    made = Simulation(settings, 12, ego, OneAgent("idm_mobil"), {"idm_mobil": IdmMobil()})
    made.reset(np.arange(100, 112, dtype=np.uint64))
    return made


def headway(scene: Scene, b: int, i: int) -> float:
    """To the nearest vehicle ahead whose centre is within half a lane and 1 m of i's lane."""
    centre = 4.0 * scene.lane[b, i]
    ahead = [
        scene.x[b, j] - scene.x[b, i]
        for j in range(scene.x.shape[1])
        if j != i and scene.x[b, j] >= scene.x[b, i] and abs(scene.y[b, j] - centre) <= 3.0
    ]
    return min(ahead, default=np.inf)


def count(made: Simulation, target_before: np.ndarray, was_running: np.ndarray) -> Counts:
    scene, found = made.scene, Counts()
    for b in np.nonzero(was_running)[0]:
        for i in range(scene.x.shape[1]):
            on_road = abs(scene.y[b, i] - 4.0 * scene.lane[b, i]) <= 2.0
            if scene.crashed[b, i] or not on_road or headway(scene, b, i) > 50.0:
                continue
            found[100 + b, "speed", int(scene.speed[b, i] // 0.5)] += 1
            target = scene.target_lane[b, i]
            if target not in (target_before[b, i], scene.lane[b, i]):
                found[100 + b, "dhw", min(int(headway(scene, b, i) // 0.5), 99)] += 1
    return found


def test_counts_are_those_of_each_vehicle_at_each_decision() -> None:
    made = simulation(SceneSettings(duration_s=10.0, density=1.8))
    recording, expected = Recording(made), Counts()
    while made.scene.active.any():
        before, running = made.scene.target_lane.copy(), made.scene.active.copy()
        made.step()
        recording.note()
        expected += count(made, before, running)
    table = recording.counts()
    assert table.schema == COUNT_SCHEMA
    found = Counts({(e, q, b): n for e, q, b, n in table.iter_rows()})
    assert found == expected
    assert sum(n for (_, quantity, _), n in found.items() if quantity == "dhw") > 10


def test_wrecks_and_those_beside_the_road_are_not_drivers() -> None:
    left = 0
    made = simulation(SceneSettings(duration_s=8.0, density=1.5), ego=None)
    recording, expected = Recording(made), Counts()
    while made.scene.active.any():
        before, running = made.scene.target_lane.copy(), made.scene.active.copy()
        made.step(np.full(12, left))
        made.scene.crashed[:, 3] = True
        recording.note()
        expected += count(made, before, running)
    found = Counts({(e, q, b): n for e, q, b, n in recording.counts().iter_rows()})
    assert found == expected

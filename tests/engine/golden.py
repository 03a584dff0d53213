"""Hashes of whole episodes: `python tests/engine/golden.py` prints them as JSON.

An episode's hash covers the state of all its vehicles after every decision, to the last bit.
"""

import json
import sys
from hashlib import sha256

import numpy as np

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.scene import SceneSettings

EPISODES = 40
CASES = {
    "idm_mobil in idm_mobil, charms": ("idm_mobil", "idm_mobil", {"profile": "charms"}),
    "idm_mobil in idm_mobil, charms, control in every step": (
        "idm_mobil",
        "idm_mobil",
        {"profile": {"name": "charms", "ego_control_rate": "simulation"}},
    ),
    "stackelberg in idm_mobil, charms": (
        "stackelberg",
        "idm_mobil",
        {"profile": "charms", "lanes": 4, "traffic_vehicles": 30, "density": 2.0},
    ),
    "idm_mobil in stackelberg, charms": (
        "idm_mobil",
        "stackelberg",
        {"profile": "charms", "lanes": 5, "traffic_vehicles": 24, "density": 3.0},
    ),
    "idm_mobil in idm_mobil, highway-env": (
        "idm_mobil",
        "idm_mobil",
        {"profile": "highway-env", "density": 3.0},
    ),
}
"""The ego, the traffic and the scene of each case; the dense ones have wrecks."""
STATE = ("x", "y", "heading", "speed", "acceleration", "steering", "timer_s")
EVENTS = ("lane", "target_lane", "crashed")


def hashes(case: str) -> list[str]:
    """The hash of each episode of a case."""
    ego, traffic, scene = CASES[case]
    settings = SceneSettings.model_validate(scene)
    agents = {name: make_agent(name) for name in {ego, traffic}}
    simulation = Simulation(settings, EPISODES, ego, OneAgent(traffic), agents)
    simulation.reset(np.arange(EPISODES, dtype=np.uint64))
    digests = [sha256() for _ in range(EPISODES)]
    while (active := simulation.scene.active.copy()).any():
        simulation.step()
        for row in np.nonzero(active)[0]:
            for name in STATE:
                digests[row].update(getattr(simulation.scene, name)[row].astype("<f8").tobytes())
            for name in EVENTS:
                digests[row].update(getattr(simulation.scene, name)[row].astype("<i8").tobytes())
    return [digest.hexdigest()[:16] for digest in digests]


if __name__ == "__main__":
    json.dump({case: hashes(case) for case in CASES}, sys.stdout, indent=1)

"""Simulates agents and traffic models in place of recorded drivers."""

from collections.abc import Mapping, Sequence

import numpy as np

from charms_bench.engine.neighbours import locate
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import DataError
from charms_bench.humans.driven_situations import Driven
from charms_bench.humans.trips import RATE_HZ, Trip
from charms_bench.metrics.rows import UNDONE_WITHIN_S
from charms_bench.plugins.agent import Agent, DriverModel
from charms_bench.plugins.traffic import OneAgent, Traffic
from charms_bench.world.profile import Profile
from charms_bench.world.road import position
from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings, Vehicles

LEADER = "recorded leader"
REPETITIONS = 8
"""Simulations of each situation, with different seeds."""
SECONDS = 30
FEWEST_DRIVERS = 12
"""Fewer drivers cannot be halved: strata would be empty."""
START_X_M = 500.0


class _Leader(DriverModel):
    """Drives at the recorded speeds (scenes, n) at 10 Hz."""

    memory_width = 1

    def __init__(self, speeds: Floats, period_s: float) -> None:
        self._speeds, self._period_s = speeds, period_s

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        time_s = scene.memory[vehicles][:, 0] + self._period_s
        scene.memory[(*vehicles, np.zeros(vehicles[0].size, dtype=np.int64))] = time_s
        at = np.minimum(time_s * RATE_HZ, self._speeds.shape[1] - 1.001)
        before, fraction = at.astype(np.int64), at % 1
        speeds, row = self._speeds, vehicles[0]
        speed = (1 - fraction) * speeds[row, before] + fraction * speeds[row, before + 1]
        acceleration = (speed - scene.speed[vehicles]) / self._period_s
        return np.clip(acceleration, -20.0, 20.0), scene.lane[vehicles]


def speeds_of(profile: Profile) -> tuple[float, float]:
    """The lowest and the highest recorded speed that a profile allows."""
    return profile.speed_min_mps, min(profile.speed_max_mps, profile.speed_limit_mps)


def fitting(parts: Sequence[Trip], profile: Profile) -> list[Trip]:
    """The situations whose recorded speeds the profile allows.

    Raises a `DataError` if they are of fewer than `FEWEST_DRIVERS` drivers.
    """
    low, high = speeds_of(profile)
    found = [
        part
        for part in parts
        if min(part.speed.min(), part.leader_speed.min()) >= low
        and max(part.speed.max(), part.leader_speed.max()) <= high
    ]
    drivers = len({part.driver for part in found})
    if drivers < FEWEST_DRIVERS:
        raise DataError(
            f"{drivers} held-out drivers keep to the profile's speeds, {low:g} to {high:g} m/s, "
            f"for {SECONDS} s; expected {FEWEST_DRIVERS} or more, so choose a profile with a wider "
            "range of speeds, or recordings of more drivers"
        )
    return found


def drive_behind(
    parts: Sequence[Trip],
    settings: SceneSettings,
    driver: str | Traffic,
    agents: Mapping[str, Agent],
    lanes: Floats,
) -> Driven:
    """Simulates an ego's agent, given by name, or a traffic model behind recorded leaders.

    The driver stays in its lane, as the recorded driver did: lane commands have no effect.
    """
    profile = settings.profile
    changes = {"traffic_vehicles": 1, "ego_slots": 1, "duration_s": SECONDS + 1.0}
    settings = settings.model_copy(update={**changes, "vehicle_types": (), "ego_type": None})
    count = len(parts) * REPETITIONS
    is_ego = isinstance(driver, str)
    holds = not is_ego and profile.ego_control_rate == "decision"
    period_s = 1 / (settings.decision_hz if holds else settings.simulation_hz)
    every = [part for part in parts for _ in range(REPETITIONS)]
    leader = _Leader(np.array([part.leader_speed for part in every]), period_s)
    ego = driver if isinstance(driver, str) else LEADER
    traffic = OneAgent(LEADER) if isinstance(driver, str) else driver
    simulation = Simulation(settings, count, ego, traffic, {**agents, LEADER: leader})
    simulation.reset(np.arange(count, dtype=np.uint64))
    scene, rows = simulation.scene, np.arange(count)
    own = scene.ego if is_ego else 1 - scene.ego
    other = 1 - own
    lane = settings.lanes // 2
    gap = np.array([part.gap[0] for part in every])
    for place, x, speed in (
        (own, np.full(count, START_X_M), np.array([part.speed[0] for part in every])),
        (other, START_X_M + gap + profile.vehicle_length_m, leader._speeds[:, 0]),
    ):
        scene.x[rows, place], scene.speed[rows, place] = x, speed
        low, high = profile.target_speed_min_mps, profile.target_speed_max_mps
        scene.target_speed[rows, place] = np.clip(speed, low, high)
    home = position(scene.road, lane, 0.0, 0.0)[1]
    gaps, speeds = np.empty((count, SECONDS + 1)), np.empty((count, SECONDS + 1))
    for k in range(SECONDS * settings.simulation_hz + 1):
        for array, value in ((scene.y, home), (scene.heading, 0.0), (scene.target_lane, lane)):
            array[rows, own] = array[rows, other] = value
        locate(scene, rows)
        if k % settings.simulation_hz == 0:
            second = k // settings.simulation_hz
            apart = scene.x[rows, other] - scene.x[rows, own] - profile.vehicle_length_m
            gaps[:, second] = np.where(scene.crashed[rows, own], np.minimum(apart, 0.0), apart)
            speeds[:, second] = scene.speed[rows, own]
        simulation.advance()
        if simulation.phase == settings.steps_per_decision:
            simulation.finish_step()
    shape = (len(parts), REPETITIONS, SECONDS + 1)
    return Driven(
        np.array([part.driver for part in parts]),
        gaps.reshape(shape),
        speeds.reshape(shape),
        np.array([part.leader_speed[::RATE_HZ] for part in every]).reshape(shape),
        lanes,
    )


def count_lanes(
    settings: SceneSettings,
    driver: str | Traffic,
    ego: str,
    traffic: Traffic,
    agents: Mapping[str, Agent],
    episodes: int,
) -> Floats:
    """(episodes, 4) kilometres, lane changes, undone ones and collided vehicles.

    They are those of the egos or of the traffic.
    """
    simulation = Simulation(settings, episodes, ego, traffic, agents)
    simulation.reset(np.arange(episodes, dtype=np.uint64))
    scene, rows = simulation.scene, np.arange(episodes)
    counted = np.zeros(scene.x.shape, dtype=np.bool_)
    counted[rows, scene.ego] = True
    if not isinstance(driver, str):
        counted = ~counted
    start, lane = scene.x.copy(), scene.lane.copy()
    left, since = np.full(lane.shape, -1), np.zeros(lane.shape, dtype=np.int64)
    within = round(UNDONE_WITHIN_S * settings.decision_hz)
    found = np.zeros((episodes, 4))
    for _ in range(settings.decisions):
        simulation.step()
        since += 1
        changed = scene.lane != lane
        undone = changed & (scene.lane == left) & (since <= within)
        found[:, 1] += (changed & counted).sum(axis=1)
        found[:, 2] += (undone & counted).sum(axis=1)
        left, since = np.where(changed, lane, left), np.where(changed, 0, since)
        lane = scene.lane.copy()
    found[:, 0] = ((scene.x - start) * counted).sum(axis=1) / 1000
    found[:, 3] = (scene.crashed & counted).sum(axis=1)
    return found

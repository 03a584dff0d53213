"""Episodes of recorded scenes: where vehicles are, how they come and go, and what drives them."""

import re
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from trios import Row, driven, flowing_road, write_trio

from charms_bench.engine import MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.endings import ENDINGS
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state_file import save_state
from charms_bench.errors import InputError
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.recording.recording import Recording
from charms_bench.testing.parity import compare
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.testing.straight_parity import StraightCase
from charms_bench.world import recorded_moments
from charms_bench.world.recorded_moments import moments_of
from charms_bench.world.scene import SceneSettings

US101 = Path(__file__).parents[3] / "shared" / "data" / "us101_corrected"
SLOW = {"name": "charms", "speed_min_mps": 0.0, "target_speed_min_mps": 0.0}
UNTIL = "recorded_until_deviation"


def scene_of(folder: Path, rows: Iterable[Row], rate: float = 10, **fields: Any) -> SceneSettings:
    write_trio(folder, rows, rate=rate)
    given = {"profile": SLOW, "simulation_hz": 30, "duration_s": 2.0, "recording": str(folder)}
    return recorded_moments.scene_of(given | fields)


def simulation_of(
    settings: SceneSettings,
    ego: str = "recorded",
    traffic: str = "recorded",
    scenes: int | None = None,
    engine: MakeEngine = BatchedEngine,
) -> Simulation:
    """All moments of a scene, or the first ones."""
    made = TrafficSpec(name=traffic).make()
    agents = {name: make_agent(name) for name in {ego, *made.agents}}
    count = len(moments_of(settings)) if scenes is None else scenes
    simulation = Simulation(settings, count, ego, made, agents, engine)
    simulation.reset(np.arange(count, dtype=np.uint64))
    return simulation


def recorded(rows: Iterable[Row]) -> dict[tuple[int, int], tuple[float, ...]]:
    """Each vehicle's centre, length and width in each frame, in the frame of a scene.

    The lanes' markings are at y 30, 34, 38 and 42, so the centre of the left lane is at y 32.
    """
    rows = list(rows)
    rearmost = min(row.x + row.length / 2 for row in rows)
    return {
        (row.vehicle, row.frame): (
            row.x + row.length / 2 - rearmost, row.y + row.width / 2 - 32.0, row.length, row.width
        )
        for row in rows
    }  # fmt: skip


@pytest.mark.parametrize(("rate", "hz"), [(10, 30), (25, 75)])
def test_every_vehicle_is_where_the_recording_says_at_every_frame(
    tmp_path: Path, rate: int, hz: int
) -> None:
    rows = flowing_road(rate)
    said: dict[int, list[tuple[float, ...]]] = defaultdict(list)
    for (_, frame), place in recorded(rows).items():
        said[frame].append(place)
    settings = scene_of(tmp_path, rows, rate, simulation_hz=hz)
    simulation, compared = simulation_of(settings), 0
    starts = [int(name.split()[-1]) for name in moments_of(settings).names]
    for step in range(2 * hz + 1):
        if step % (hz // rate) == 0:
            for b, start in enumerate(starts):
                frame = start + step * rate // hz
                here = simulation.scene.present[b]
                found = np.stack([getattr(simulation.scene, name)[b, here]
                                  for name in ("x", "y", "length", "width")], axis=1)  # fmt: skip
                expected = sorted(said[frame])
                np.testing.assert_allclose(sorted(map(tuple, found)), expected, rtol=0, atol=1e-9)
                compared += len(expected)
        if step < 2 * hz:
            simulation.advance()
            if simulation.phase == settings.steps_per_decision:
                simulation.finish_step()
    assert simulation.truncated.all()
    assert compared > 26 * 20 * 10


@pytest.mark.skipif(not US101.is_dir(), reason="needs ../shared/data, human recordings")
@pytest.mark.parametrize("lanes", [5, 6])
def test_every_vehicle_of_us101_is_where_the_recording_says(lanes: int) -> None:
    bounds = {"name": "naturalistic", "speed_max_mps": 60.0, "target_speed_max_mps": 60.0}
    fields = {"profile": bounds, "simulation_hz": 30, "duration_s": 1.0, "lanes": lanes}
    settings = recorded_moments.scene_of({**fields, "recording": str(US101)})
    said, frames = {}, set()
    for path in US101.glob("*_tracks.csv"):
        rows = pl.read_csv(path)
        marking = path.with_name(path.name.replace("tracks", "recordingMeta"))
        left, right = map(float, pl.read_csv(marking)["lowerLaneMarkings"][0].split(";")[:2])
        x, y = rows["x"] + rows["width"] / 2, rows["y"] + rows["height"] / 2
        places = np.stack([x - x.min(), y - (left + right) / 2, rows["width"], rows["height"]], 1)
        for frame in rows["frame"].unique():
            said[int(path.name[:2]), frame] = places[rows["frame"] == frame]
    simulation = simulation_of(settings)
    starts = [re.findall(r"\d+", name) for name in moments_of(settings).names]
    for step in range(31):
        for b, (number, _, _, start) in enumerate(starts if step % 3 == 0 else ()):
            at = int(number), int(start) + step // 3
            here = simulation.scene.present[b]
            found = np.stack([getattr(simulation.scene, name)[b, here]
                              for name in ("x", "y", "length", "width")], axis=1)  # fmt: skip
            one, other = (each[np.lexsort(each.round(6).T)] for each in (found, said[at]))
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
            frames.add(at)
        if step < 30:
            simulation.advance()
            if simulation.phase == settings.steps_per_decision:
                simulation.finish_step()
    of_recordings = {number for number, _ in frames}
    assert len(of_recordings) == {5: 11, 6: 20}[lanes]
    assert len(frames) > 0.95 * sum(number in of_recordings for number, _ in said)


def test_between_two_frames_vehicles_are_between_their_positions(tmp_path: Path) -> None:
    # At 15 Hz, the step at 1/15 s is two thirds of the way from the first frame to the second.
    rows = [Row(frame=k + 1, x=100.0 + k * k, vx=10.0) for k in range(21)]
    simulation = simulation_of(scene_of(tmp_path, rows, simulation_hz=15), scenes=1)
    simulation.advance()
    assert simulation.scene.x[0, 0] == pytest.approx(2 / 3, abs=1e-9)
    simulation.advance()
    assert simulation.scene.x[0, 0] == pytest.approx(1 + (4 - 1) / 3, abs=1e-9)
    simulation.advance()
    assert simulation.scene.x[0, 0] == pytest.approx(4.0, abs=1e-9)


def test_a_heading_is_that_of_the_velocity(tmp_path: Path) -> None:
    rows = [replace(row, vy=1.0) for row in driven(Row(vx=20.0), 21, rate=10)]
    scene = simulation_of(scene_of(tmp_path, rows), scenes=1).scene
    assert scene.heading[0, 0] == pytest.approx(np.arctan2(1.0, 20.0))
    assert scene.speed[0, 0] * scene.direction_x[0, 0] == pytest.approx(20.0)


CASES = [
    ("recorded", "recorded"),
    ("idm_mobil", "recorded"),
    ("idm_mobil", UNTIL),
    ("recorded", "idm_mobil_varied"),
    ("imitation", "stackelberg"),
    (None, "recorded"),
]


def test_both_engines_agree_on_a_vehicle_that_is_recorded_rolling_back(tmp_path: Path) -> None:
    stationary = [Row(frame=k + 1, x=100.0, vx=-0.001) for k in range(21)]
    driving = driven(Row(vehicle=2, x=120.0, vx=20.0), 21, rate=10)
    settings = scene_of(tmp_path, stationary + driving, profile="naturalistic")
    same = {"ego": AgentSpec(name="recorded"), "traffic": TrafficSpec(name="recorded")}
    found = compare(StraightCase(scene=settings, **same), range(1))
    assert (found.differences, found.largest) == ([], 0.0)
    assert -0.001 in simulation_of(settings, scenes=1).scene.speed


def touching(simulation: Simulation) -> int:
    """Pairs of vehicles whose boxes along the road overlap."""
    scene, found = simulation.scene, 0
    for b in range(simulation.seeds.size):
        for i, j in combinations(np.nonzero(scene.present[b])[0], 2):
            length, width = scene.length[b, [i, j]].mean(), scene.width[b, [i, j]].mean()
            along, across = scene.x[b, i] - scene.x[b, j], scene.y[b, i] - scene.y[b, j]
            found += abs(along) < length and abs(across) < width
    return found


def test_no_reactive_vehicle_appears_in_another(tmp_path: Path) -> None:
    simulation = simulation_of(scene_of(tmp_path, flowing_road(10)), "idm_mobil", "idm_mobil")
    before = simulation.scene.present.copy()
    appeared = 0
    while simulation.scene.active.any():
        for _ in range(simulation.settings.steps_per_decision):
            simulation.advance()
            new = simulation.scene.present & ~before
            appeared += int(new.sum())
            assert not new.any() or touching(simulation) == 0
            before = simulation.scene.present.copy()
        simulation.finish_step()
    assert appeared > 20


def test_a_vehicle_stays_out_if_its_place_is_taken(tmp_path: Path) -> None:
    # Vehicle 2 appears behind the ego after 1 s, closing in with 25 m/s over 15 m.
    ego = driven(Row(x=100.0, vx=5.0), 21, rate=10)
    late = [Row(vehicle=2, frame=11 + k, x=85.0 + 0.5 * k, vx=30.0) for k in range(11)]
    beside = driven(Row(vehicle=3, frame=11, x=85.0, y=39.0, lane_id=8), 11, rate=10)
    settings = scene_of(tmp_path, ego + late + beside)
    reactive = simulation_of(settings, "idm_mobil", "idm_mobil", scenes=1)
    replayed = simulation_of(settings, scenes=1)
    for _ in range(3):
        assert reactive.scene.present.tolist() == [[True, False, False]]
        reactive.step()
        replayed.step()
    assert reactive.scene.present.tolist() == [[True, False, True]]
    assert replayed.scene.present.tolist() == [[True, True, True]]


def test_replayed_vehicles_leave_and_reactive_ones_drive_on(tmp_path: Path) -> None:
    rows = driven(Row(x=100.0), 21, rate=10) + driven(Row(vehicle=2, x=200.0), 11, rate=10)
    settings = scene_of(tmp_path, rows)
    kept = {}
    for traffic in ("recorded", "idm_mobil"):
        simulation = simulation_of(settings, traffic=traffic, scenes=1)
        for _ in range(3):
            simulation.step()
        assert simulation.scene.present.all()  # the last frame is 1 s after the first
        simulation.step()
        kept[traffic] = bool(simulation.scene.present[0, 1])
    assert kept == {"recorded": False, "idm_mobil": True}


def test_replayed_vehicles_pass_through_each_other_as_recorded(tmp_path: Path) -> None:
    slow = driven(Row(vehicle=2, x=200.0, vx=20.0), 21, rate=10)
    fast = driven(Row(vehicle=3, x=190.0, vx=30.0), 21, rate=10)
    settings = scene_of(tmp_path, driven(Row(), 21, rate=10) + slow + fast)
    simulation = simulation_of(settings, scenes=1)
    for _ in range(6):
        simulation.step()
    assert simulation.truncated.all()
    assert not simulation.scene.crashed.any()


def test_an_ego_collides_with_a_replayed_vehicle(tmp_path: Path) -> None:
    # The ego keeps the speed at which it starts, 30 m/s; its vehicle was recorded braking.
    braking = [Row(frame=k + 1, x=100.0 + 3.0 * k - 0.05 * k * k, vx=30.0 - k) for k in range(21)]
    leader = [replace(row, vehicle=2, x=row.x + 10.0) for row in braking]
    settings = scene_of(tmp_path, braking + leader)
    for engine in ENGINES:
        simulation = simulation_of(settings, "level_0", scenes=1, engine=engine)
        while simulation.scene.active.any():
            simulation.step()
        assert ENDINGS[simulation.ending[0]] == "rear_end"
        assert simulation.scene.crashed.all()


def test_others_take_over_once_the_ego_deviates(tmp_path: Path) -> None:
    # IDM brakes 15 m behind its leader, or passes it; the recorded driver did neither.
    ego = driven(Row(x=100.0, vx=20.0), 21, rate=10)
    leader = driven(Row(vehicle=2, x=120.0, vx=20.0), 21, rate=10)
    settings = scene_of(tmp_path, ego + leader)
    simulation = simulation_of(settings, "idm_mobil", UNTIL, scenes=1)
    at_start, has_deviated = simulation.scene.x[0, 0], False
    while simulation.scene.active.any():
        simulation.advance()
        time_s = (simulation.steps[0] * 10 + simulation.phase) / 30
        ahead = simulation.scene.x[0, 0] - at_start - 20.0 * time_s
        has_deviated |= bool(np.hypot(ahead, simulation.scene.y[0, 0] - 4.0) > 2.0)
        assert simulation.drivers[0, 1] == ("idm_mobil" if has_deviated else "recorded")
        if simulation.phase == 10:
            simulation.finish_step()
    assert simulation.drivers[0, 1] == "idm_mobil"
    follower = simulation_of(settings, "recorded", UNTIL, scenes=1)
    while follower.scene.active.any():
        follower.step()
    assert follower.drivers[0, 1] == "recorded"


def test_a_state_of_a_recording_is_not_written_to_a_file(tmp_path: Path) -> None:
    state = simulation_of(scene_of(tmp_path, flowing_road(10)), scenes=1).state()
    with pytest.raises(InputError, match="a state of a recorded scene stays in memory"):
        save_state(state, tmp_path / "state.json")


def test_a_planner_looks_ahead_in_a_recorded_scene(tmp_path: Path) -> None:
    settings = scene_of(tmp_path, flowing_road(10), duration_s=1.0)
    simulation = simulation_of(settings, "mpc", "recorded", scenes=2)
    while simulation.scene.active.any():
        simulation.step()
    assert simulation.truncated.all()


def test_rows_count_vehicles_while_they_are_there(tmp_path: Path) -> None:
    # At 3 decisions a second: vehicle 2 is recorded from 0 to 1 s, vehicle 3 from 0.5 to 2 s.
    ego = driven(Row(x=100.0, vx=20.0), 21, rate=10)
    leaves = driven(Row(vehicle=2, x=200.0, vx=30.0), 11, rate=10)
    comes = driven(Row(vehicle=3, frame=6, x=20.0, y=31.0, lane_id=6, vx=24.0), 16, rate=10)
    simulation = simulation_of(scene_of(tmp_path, ego + leaves + comes), scenes=1)
    recording = Recording.of(simulation)
    (episode,) = recording.episodes().to_dicts()
    assert (episode["traffic_vehicles"], episode["traffic_crashed"]) == (2, 0)
    # Vehicle 2 drives 30 m until it leaves, and vehicle 3 is seen from 2/3 s on.
    assert episode["traffic_distance_m"] == pytest.approx(30.0 + 24.0 * 4 / 3)
    others = recording.drivers().filter(~recording.drivers()["is_ego"]).to_dicts()[0]
    assert (others["vehicles"], others["crashed"], others["lane_changes"]) == (2, 0, 0)
    assert others["time_s"] == pytest.approx(1.0 + 4 / 3)
    assert others["distance_m"] == pytest.approx(30.0 + 24.0 * 4 / 3)

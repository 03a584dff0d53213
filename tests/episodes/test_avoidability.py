"""Avoidability: held against a plain search from the seed, and against scenes with one answer."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from command_line import charms_bench

from charms_bench.engine.neighbours import locate
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.episodes.avoidability import Avoidability, avoidability, collisions
from charms_bench.episodes.escape import EscapeSearch
from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import replay
from charms_bench.episodes.what_happened import what_happened
from charms_bench.errors import InputError
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.report.avoidability_table import avoidability_table, rescuers_table
from charms_bench.runs.finished_run import FinishedRun
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite
from charms_bench.world.actions import ACTIONS
from charms_bench.world.scene import SceneSettings

SUITE = {
    "suite": "small",
    "episodes": 30,
    "seed": 900_000_000,
    "scene": {"duration_s": 6.0, "traffic_vehicles": 9, "density": 1.5, "ego_slots": 3},
    "egos": [{"agent": "imitation"}],
    "traffic_models": [{"traffic": {"mixture": {"idm_mobil": 0.5, "level_0": 0.5}}}],
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    return run(Suite.model_validate(SUITE), tmp_path_factory.mktemp("run") / "small", workers=1)


@pytest.fixture(scope="module")
def cell(finished: FinishedRun) -> RecordedCell:
    return RecordedCell(finished, 0, Path())


@pytest.fixture(scope="module")
def found(cell: RecordedCell) -> list[Avoidability]:
    return avoidability(cell, collisions(cell)[:6], agents=["idm_mobil", "imitation"])


def longer(finished: FinishedRun) -> SceneSettings:
    scene = finished.suite.scene
    return scene.model_copy(update={"duration_s": scene.duration_s + 3.0})


def test_from_the_decision_after_the_last_one_every_plain_sequence_collides(
    finished: FinishedRun, cell: RecordedCell, found: list[Avoidability]
) -> None:
    checked = 0
    for each in found:
        first = (each.last_step or 0) + 1
        if (length := each.step - first + 1) == 0 or length > 4:
            continue  # the slow check in tools/ covers longer ones
        (episode,) = replay(cell, [each.episode])
        recorded = episode.action[1 :: episode.frame_of(1), episode.ego][: first - 1]
        sequences = np.array(list(product(range(len(ACTIONS)), repeat=length)))
        settings = longer(finished)
        plain = cell.simulation(len(sequences), settings=settings, is_ego_outside=True)
        plain.reset(np.full(len(sequences), each.episode, dtype=np.uint64))
        for action in recorded:
            plain.step(np.full(len(sequences), action))
        for actions in sequences.T:
            plain.step(actions)
        survivors = np.nonzero(~plain.failed)[0]
        frame = int(episode.crashed[:, episode.ego].argmax())
        until = -(-(frame + 30) // 5)
        search = EscapeSearch(plain, until, 10**6)
        states = [plain.state(np.array([row])) for row in survivors]
        assert not any(search.finds(state) for state in states)
        checked += 1
    assert checked >= 2


def test_the_recorded_agent_collides_again_and_a_replacement_does_not(
    finished: FinishedRun, found: list[Avoidability]
) -> None:
    assert len(found) == 6
    replaced = 0
    for each in found:
        assert "imitation" not in each.avoided_by
        assert each.replacement is None or each.replacement.step <= each.step
        if each.last_step is not None:
            assert set(each.avoided_by) | set(each.hit_by) == {"idm_mobil", "imitation"}
        if each.replacement is not None and each.replacement.is_ego:
            # An action of the ego that avoids the collision is one of the sequences.
            assert (each.last_step or 0) >= each.replacement.step
            replaced += 1
    assert replaced > 0


def test_a_collision_has_one_time(cell: RecordedCell) -> None:
    seed = collisions(cell)[0]
    (found,) = avoidability(cell, [seed], budget=1, agents=())
    (replayed,) = replay(cell, [seed])
    assert what_happened(replayed).endswith(f"at t = {found.collided_s:.1f} s")
    hz = cell.cell.scene.decision_hz
    assert (found.step - 1) / hz < found.collided_s <= found.step / hz


def test_a_budget_that_ends_leaves_an_unknown(cell: RecordedCell) -> None:
    (each,) = avoidability(cell, collisions(cell)[:1], budget=4, agents=[])
    assert (each.verdict, each.last_step, each.nodes) == ("unknown", None, 0)


def test_an_episode_without_a_collision_is_rejected(cell: RecordedCell) -> None:
    seeds = range(SUITE["seed"], SUITE["seed"] + 30)  # type: ignore[operator, arg-type]
    other = next(seed for seed in seeds if seed not in collisions(cell))
    with pytest.raises(InputError, match=f"episode {other} does not end with a collision"):
        avoidability(cell, [other], agents=[])


def test_the_tables_count_verdicts_and_agents(
    finished: FinishedRun, found: list[Avoidability]
) -> None:
    table = avoidability_table(found, finished.suite.scene)
    assert len(table.rows) == 6
    assert table.note.startswith("6 collisions of the ego: ")
    rescuers = rescuers_table(found)
    assert {row.labels[0] for row in rescuers.rows} == {"idm_mobil", "imitation"}


def test_the_command_says_which_collisions_could_have_been_avoided(finished: FinishedRun) -> None:
    folder = finished.folder.path
    shown = charms_bench("edge-cases", folder, "--avoidable", "--top", 2, columns=160)
    assert shown.returncode == 0, shown.stderr
    assert "2 collisions of the ego: " in shown.stdout
    said = charms_bench("edge-cases", folder, "--avoidable", "--kind", "near-miss")
    assert said.returncode == 2
    assert "--avoidable is about collisions, not --kind near-miss" in said.stderr


def behind_a_leader(gap_m: float) -> tuple[Simulation, SceneState]:
    """An ego at 30 m/s behind a vehicle at 22 m/s, between two that it cannot get past."""
    settings = SceneSettings(traffic_vehicles=3, ego_slots=1)
    traffic = {"level_0": make_agent("level_0")}
    simulation = Simulation(settings, 500, None, OneAgent("level_0"), traffic)
    simulation.reset(np.zeros(500, dtype=np.uint64))
    scene = simulation.scene
    scene.x[:] = (100.0, 105.0 + gap_m, 104.0, 104.0)
    scene.y[:] = (4.0, 4.0, 0.0, 8.0)
    scene.speed[:] = scene.target_speed[:] = (30.0, 22.0, 30.0, 30.0)
    scene.heading[:] = 0.0
    locate(scene, np.arange(500))
    scene.target_lane[:] = scene.lane
    return simulation, simulation.state(np.array([0]))


@pytest.mark.parametrize(("gap_m", "escapes"), [(1.0, False), (300.0, True)])
def test_a_gap_of_1_m_at_8_mps_is_too_short_and_300_m_are_not(gap_m: float, escapes: bool) -> None:
    """At most 33 - 22 m/s are closed; 1 m takes 0.125 s, less than a decision, 300 m over 27 s."""
    simulation, state = behind_a_leader(gap_m)
    search = EscapeSearch(simulation, until=7, budget=10_000)
    assert search.finds(state) is escapes


def test_what_is_ruled_out_is_not_searched_again() -> None:
    simulation, state = behind_a_leader(8.0)
    search = EscapeSearch(simulation, 7, 100_000)
    assert search.finds(state) is False
    nodes = search.nodes
    assert search.finds(state) is False
    assert search.nodes == min(nodes, 2 * len(ACTIONS)) or search.nodes == nodes + len(ACTIONS)

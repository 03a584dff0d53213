"""What if: the prefix repeats exactly, and with the same agent the whole episode does."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import charms_bench
from handmade_replay import replay_of

from charms_bench.episodes.recorded_cell import RecordedCell
from charms_bench.episodes.replay import Replay, Seat, replay, simulate
from charms_bench.episodes.what_if import WhatIf, future_of, what_if
from charms_bench.errors import InputError
from charms_bench.report.html.single import write_what_if
from charms_bench.report.what_if_table import what_if_table
from charms_bench.runs.finished_run import FinishedRun
from charms_bench.runs.runner import run
from charms_bench.runs.suite import Suite

SUITE = {
    "suite": "small",
    "episodes": 4,
    "seed": 10,
    "scene": {"duration_s": 5.0, "traffic_vehicles": 8, "density": 1.5},
    "egos": [{"agent": "outside_policy"}],
    "traffic_models": [{"traffic": {"mixture": {"idm_mobil": 0.5, "outside_policy": 0.5}}}],
}
ARRAYS = (
    "x", "y", "heading", "speed", "acceleration", "lane", "target_lane", "crashed",
)  # fmt: skip


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> FinishedRun:
    return run(Suite.model_validate(SUITE), tmp_path_factory.mktemp("run") / "small", workers=1)


def asked(
    finished: FinishedRun, step: int, agent: str, vehicle: int | None = None, episode: int = 12
) -> WhatIf:
    return what_if(RecordedCell(finished, 0, Path()), episode, step, agent, vehicle)


def same_until(one: Replay, other: Replay, frame: int) -> bool:
    return all(
        np.array_equal(getattr(one, name)[: frame + 1], getattr(other, name)[: frame + 1])
        for name in ARRAYS
    )


@pytest.mark.parametrize("vehicle", [None, 5])
@pytest.mark.parametrize("agent", ["level_0", "stackelberg", "idm_mobil"])
@pytest.mark.parametrize("step", [1, 6])
def test_the_futures_part_at_the_decision_and_not_before(
    finished: FinishedRun, step: int, agent: str, vehicle: int | None
) -> None:
    found = asked(finished, step, agent, vehicle)
    assert found.start == (step - 1) * 5
    assert same_until(found.recorded, found.other, found.start)
    before = found.recorded.steps.filter(step=step - 1)
    assert found.other.steps.filter(step=step - 1).equals(before)
    assert found.other.agents[found.vehicle] == agent


def test_another_agent_changes_what_follows(finished: FinishedRun) -> None:
    found = asked(finished, 6, "stackelberg")
    assert not same_until(found.recorded, found.other, len(found.recorded.t_s) - 1)


@pytest.mark.parametrize("step", [1, 4, 15])
@pytest.mark.parametrize("agent", ["idm_mobil", "outside_policy"])
def test_with_the_same_agent_the_whole_episode_repeats(
    finished: FinishedRun, step: int, agent: str
) -> None:
    cell, episodes = RecordedCell(finished, 0, Path()), range(10, 14)
    recorded = replay(cell, episodes)
    for vehicle in range(len(recorded[0].agents)):
        others = simulate(cell, episodes, Seat(step, vehicle, agent))
        for one, other in zip(recorded, others, strict=True):
            if one.agents[vehicle] == agent:
                assert same_until(one, other, len(one.t_s))
                assert other.steps.equals(one.steps)
                assert other.episodes.equals(one.episodes)


def test_the_table_compares_the_futures_of_the_ego_and_of_the_vehicle(
    finished: FinishedRun,
) -> None:
    found = asked(finished, 4, "level_0", 5)
    table = what_if_table(found)
    assert [row.labels for row in table.rows] == [
        ("ego", "recorded", "outside_policy"),
        ("ego", "what if", "outside_policy"),
        ("vehicle 5", "recorded", found.recorded.agents[5]),
        ("vehicle 5", "what if", "level_0"),
    ]
    driven = found.recorded.speed[found.start :, found.recorded.ego]
    crashed = found.recorded.crashed[:, found.recorded.ego]
    assert not crashed.any()
    at = [column.name for column in table.columns].index("speed_mps")
    assert table.rows[0].numbers[at].value == pytest.approx(driven.mean(), rel=0.01)
    assert table.rows[0].cells[0] == "time over at 5.0 s"


@pytest.mark.parametrize("step", [6, 12])
def test_the_sentences_tell_nothing_before_the_decision(finished: FinishedRun, step: int) -> None:
    for agent in ("level_0", "idm_mobil"):
        found = asked(finished, step, agent)
        for sentence in found.sentences():
            at = re.search(r"at t = ([0-9.]+) s$", sentence)
            assert at is None or float(at[1]) > (step - 1) / 3


def test_a_future_has_only_what_follows_its_first_frame() -> None:
    acceleration = np.zeros((31, 1))
    acceleration[:11], acceleration[11] = -9.0, -4.0  # frame 10 ends the step before
    replayed = replay_of("time", [{}] * 6, x=np.zeros((31, 1)), acceleration=acceleration)
    future = future_of(replayed, 0, 10)
    assert future.braking_max_mps2 == 4.0
    assert future.hard_braking_s == pytest.approx(1 / 15)
    assert future.lasted_s == pytest.approx(20 / 15)


def test_a_vehicle_that_has_crashed_before_gets_no_driver(
    finished: FinishedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = RecordedCell(finished, 0, Path())
    (recorded,) = replay(cell, [12])
    recorded.crashed[25:, 5] = True
    monkeypatch.setattr("charms_bench.episodes.what_if.replay", lambda *_: [recorded])
    with pytest.raises(InputError, match="vehicle 5 has crashed before decision 6 of episode 12"):
        what_if(cell, 12, 6, "level_0", 5)


def test_the_page_has_both_futures(finished: FinishedRun, tmp_path: Path) -> None:
    write_what_if(asked(finished, 4, "level_0"), tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "level_0 drives the ego from decision 4 on" in page
    assert '"ghosts": {' in page


def test_the_command_prints_both_futures_and_writes_a_page(
    finished: FinishedRun, tmp_path: Path
) -> None:
    folder, asked_for = finished.folder.path, ("--at", 4, "--agent", "stackelberg")
    page = tmp_path / "page.html"
    shown = charms_bench("what-if", folder, 12, *asked_for, "--output", page, columns=160)
    assert shown.returncode == 0, shown.stderr
    assert "Episode 12: stackelberg drives the ego from decision 4 on" in shown.stdout
    assert page.exists()
    found = json.loads(charms_bench("what-if", folder, 12, *asked_for, "--json").stdout)
    assert (found["step"], found["agent"]) == (4, "stackelberg")
    assert found["futures"][0]["what_if"]["agent"] == "stackelberg"
    assert Path(found["page"]).parent == folder / "replays"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("12 --at 16 --agent level_0", "episode 12 has the decisions 1 to 15, not 16"),
        ("12 --at 4 --agent level_0 --vehicle 9", "episode 12 has the vehicles 0 to 8, not 9"),
        ("12 --at 4 --agent level_9", "no agent named 'level_9'. Did you mean 'level_0'"),
        ("99 --at 4 --agent level_0", "holds the episodes 10 to 13, not 99"),
        ("12 --at 4 --agent level_0 --ego CHARMS", "no ego called 'CHARMS'"),
        ("12 --at 4 --agent level_0 --output x.gif", "x.gif: expected a name that ends in .html"),
    ],
)
def test_a_mistake_is_one_message(finished: FinishedRun, words: str, message: str) -> None:
    said = charms_bench("what-if", finished.folder.path, *words.split(), columns=300)
    assert said.returncode == 2
    assert message in said.stderr


def test_a_report_shows_the_other_future_of_an_episode(
    finished: FinishedRun, tmp_path: Path
) -> None:
    folder, output = finished.folder.path, tmp_path / "report.html"
    assert charms_bench("rescore", folder).returncode == 0  # it writes the tables
    shared = ("--output", output, "--top", 0)
    other = ("--episode", 12, "--what-if", "4:level_0:5")
    made = charms_bench("report", folder, *shared, *other)
    assert made.returncode == 0, made.stderr
    assert "level_0 drives vehicle 5 from decision 4 on" in output.read_text()
    for wrong, message in (
        (("--what-if", "4:level_0"), "needs the episodes that --episode names"),
        (("--episode", 12, "--what-if", "level_0"), "expected STEP:AGENT[:VEHICLE]"),
    ):
        said = charms_bench("report", folder, *shared, *wrong)
        assert said.returncode == 2
        assert message in said.stderr


def test_a_page_has_the_ending_of_a_page(finished: FinishedRun, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"page\.gif: expected a name that ends in \.html"):
        write_what_if(asked(finished, 4, "level_0"), tmp_path / "page.gif")

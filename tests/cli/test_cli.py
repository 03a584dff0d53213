"""The command line as a newcomer meets it."""

import json
import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import charms_agents
import pytest
import typer
from command_line import charms_bench

from charms_bench import __version__
from charms_bench.cli import terminal
from charms_bench.foundation.progress import progress

FOR_TERMINALS = {"FORCE_COLOR", "PY_COLORS", "TTY_COMPATIBLE", "TTY_INTERACTIVE"}
SUITE = """\
suite: small
title: A [bold]small[/] suite
episodes: 6
scene: {duration_s: 2.0, traffic_vehicles: 5}
egos:
  - {agent: idm_mobil, label: IDM, paper: {speed_mean: 23.67}}
  - {agent: EGO}
traffic_models:
  - traffic: idm_mobil
"""


def in_a_process(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Calls the command line as CI does: output goes into a file, workers are processes."""
    environment = {key: value for key, value in os.environ.items() if key not in FOR_TERMINALS}
    finished = subprocess.run(
        [sys.executable, "-m", "charms_bench", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        env={**environment, "COLUMNS": "100", "GITHUB_ACTIONS": "true"},
    )
    found = re.findall(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", finished.stdout + finished.stderr)
    assert not found, "no control codes outside a terminal"
    return finished


@pytest.fixture
def suite_file(tmp_path: Path) -> Path:
    return write(tmp_path, "stackelberg")


def write(folder: Path, ego: str) -> Path:
    path = folder / "suite.yaml"
    path.write_text(SUITE.replace("EGO", ego))
    return path


@pytest.fixture(scope="module")
def finished_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    suite = write(folder, "stackelberg")
    result = charms_bench("run", suite, "--workers", 1, "--output", folder / "run")
    assert result.returncode == 0, result.stderr
    return folder / "run"


@pytest.fixture
def copied_run(finished_run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished_run, tmp_path / "run"))


def test_a_suite_with_references_prints_the_distance_from_human_driving(suite_file: Path) -> None:
    text = suite_file.read_text().replace("  - {agent: stackelberg}\n", "")
    suite_file.write_text(text + "references: [i24, us101]\n")
    output = suite_file.parent / "run"
    result = charms_bench("run", suite_file, "--workers", 1, "--output", output)
    assert result.returncode == 0, result.stderr
    assert "Distance from human driving" in result.stdout
    assert f"charms-bench show {output}" in result.stdout
    for name in ("tables/small-realism.md", "figures/small-speed.png", "figures/small-dhw.png"):
        assert (output / name).exists()


def test_json_is_all_there_is_on_standard_output(suite_file: Path, copied_run: Path) -> None:
    result = charms_bench("run", suite_file, "--json", "--output", copied_run)
    rows = json.loads(result.stdout)
    assert list(rows[0]) == [
        "agent", "traffic", "metric_set", "metric", "value", "low", "high", "n", "paper"
    ]  # fmt: skip
    speed = next(row for row in rows if row["metric"] == "speed_mean")
    assert (speed["agent"], speed["paper"]) == ("IDM", 23.67)


def test_other_episodes_are_options(suite_file: Path) -> None:
    output = suite_file.parent / "run"
    options = ["--episodes", 1, "--seed", 5, "--workers", 1]
    result = charms_bench("run", suite_file, *options, "--output", output)
    assert result.returncode == 0, result.stderr
    manifest = json.loads((output / "manifest.json").read_text())
    assert (manifest["episodes"], manifest["suite"]["seed"]) == (1, 5)


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["--version"], 0, f"charms-bench {__version__}"),
        ([], 2, "Usage:"),
        (["--"], 2, "Missing command"),
    ],
)
def test_without_a_command_only_the_version_is_a_success(
    arguments: list[str], code: int, said: str, tmp_path: Path
) -> None:
    finished = charms_bench(*arguments, cwd=tmp_path)
    assert finished.returncode == code
    assert said in finished.stdout + finished.stderr


@pytest.mark.parametrize(
    ("ego", "message"),
    [
        ("idm_mobl", "suite.yaml:7: egos[1]: no agent named 'idm_mobl'"),
        ("{onnx: none.onnx}", "none.onnx: cannot be read: No such file or directory"),
        ("outside_broken", "agent 'outside_broken' of outside-plugin 1.2.3 cannot be imported"),
        ("outside_out_of_range", "decide returned action 7; expected 0 to 4"),
        (
            "{name: stackelberg, options: {gian: 1}}",
            "suite.yaml:7: egos[1].agent.options.gian: agent 'stackelberg' of",
        ),
        ("stackelberg, paper: {speed: 1}", "suite.yaml:7: egos[1].paper.speed: no metric named"),
    ],
)
def test_a_mistake_is_one_message_and_exit_code_2(tmp_path: Path, ego: str, message: str) -> None:
    suite = write(tmp_path, ego)
    result = charms_bench("run", suite, "--workers", 1, "--output", tmp_path / "run")
    assert result.returncode == 2
    assert "Traceback" not in result.stderr
    assert message in result.stderr
    assert result.stdout == ""


def test_what_fails_in_a_worker_is_one_message_and_exit_code_2(tmp_path: Path) -> None:
    suite = write(tmp_path, "outside_raising")
    result = in_a_process("run", suite, "--workers", 1, cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert "agent 'outside_raising', episode 0, step 0: raised ValueError" in result.stderr
    assert "Traceback" not in result.stderr


def test_an_export_of_several_checkpoints_needs_a_folder(tmp_path: Path) -> None:
    result = charms_bench("export", "one.zip", "two.zip", tmp_path / "model.onnx")
    assert result.returncode == 2
    assert "model.onnx; --to FOLDER takes several" in result.stderr


def test_agents_are_listed_by_distribution_with_what_they_do() -> None:
    rows = json.loads(charms_bench("agents", "--json").stdout)
    expected = {"role": "agent", "version": "1.2.3", "distribution": "outside-plugin"}
    assert {"name": "outside_broken", **expected, "summary": ""} in rows
    listed = charms_bench("agents").stdout
    assert re.search(r"Agents of outside-plugin 1\.2\.3\n[^:]* outside_broken +\n", listed)
    assert re.search(r" outside_policy +Slows down behind others, and moves right", listed)
    assert re.search(r" outside_traffic +Each of the two with the same probability\.", listed)


def test_help_lists_every_command_in_one_of_six_groups_on_one_line() -> None:
    listed = charms_bench("--help").stdout.partition("-h, --help")[2].partition("  Exit codes")[0]
    known = typer.main.get_command(terminal.app).commands  # type: ignore[attr-defined]  # of a group
    assert sorted(re.findall(r"^  ([a-z-]+) +\S", listed, re.MULTILINE)) == sorted(known)
    assert len(re.findall(r"^[A-Z].*:$", listed, re.MULTILINE)) == 6
    assert "..." not in listed


@pytest.mark.parametrize(
    ("name", "code", "messages"),
    [
        ("outside_policy", 0, ("pass policy decides for each vehicle independently\n"
                               "remark chose a lane that does not exist in ")),
        ("outside_model", 0, "pass model does not change the scene"),
        ("outside_traffic", 0, "pass traffic follows its rng"),
        ("outside_misshapen", 1, "fail policy returns one action per vehicle: for row 0 of 336"),
        ("outside_raising", 1, "raised ValueError: out of petrol"),
    ],
)  # fmt: skip
def test_check_holds_a_plugin_against_the_contract(name: str, code: int, messages: str) -> None:
    result = charms_bench("check", name)
    assert result.returncode == code, result.stderr
    assert [each for each in messages.splitlines() if each not in result.stdout] == []


def test_a_new_agent_is_written_with_what_to_do_next(tmp_path: Path) -> None:
    result = charms_bench("new-agent", "tailgater", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "Next: cd tailgater && pip install . pytest && pytest && charms-b" in result.stdout
    assert (tmp_path / "tailgater" / "tests" / "test_tailgater.py").exists()
    result = charms_bench("new-agent", "tailgater", cwd=tmp_path)
    assert (result.returncode, result.stdout) == (2, "")
    assert "error: tailgater: is not empty" in result.stderr


def test_a_traffic_says_whom_it_gives_vehicles(tmp_path: Path) -> None:
    figure = tmp_path / "pch.svg"
    result = charms_bench("traffic", "pch", "--tau=0", "--beta", "0.25", "--figure", figure)
    assert result.returncode == 0, result.stderr
    assert re.search(r"charms-efficient-competitive\s+25\.\d %", result.stdout)
    assert re.search(r"charms-safe-competitive\s+7[45]\.\d %", result.stdout)
    assert figure.read_text().startswith("<?xml")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tau"], "expected options as --name value, found --tau"),
        (["--gamma", "1"], "has no option 'gamma'"),
        (["--tau", "["], "--tau: [ cannot be read"),
    ],
)
def test_what_a_traffic_cannot_be_asked_is_one_message(arguments: list[str], message: str) -> None:
    result = charms_bench("traffic", "pch", *arguments)
    assert result.returncode == 2
    assert message in " ".join(result.stderr.split())
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("show", "A [bold]small[/] suite\n2 × 1 cells of 6 episodes, seeds from 0"),
        ("compare", "differences are separated from 0"),
        ("edge-cases", "what happened"),
    ],
)
def test_what_is_printed_of_a_run_can_go_into_a_file(
    finished_run: Path, command: str, says: str
) -> None:
    options = ["--egos", "IDM", "stackelberg"] if command == "compare" else []
    result = charms_bench(command, finished_run, *options)
    assert (result.returncode, result.stderr) == (0, "")
    assert says in result.stdout


def test_show_prints_the_tables_as_json_or_those_of_a_metric(finished_run: Path) -> None:
    everything = json.loads(charms_bench("show", finished_run, "--json").stdout)
    stored = (finished_run / "tables" / "small.csv").read_text()
    assert len(everything["tables"]["small"]) == stored.count("\n") - 1
    speed = json.loads(charms_bench("show", finished_run, "--metric=tet", "--json").stdout)
    assert [row["metric"] for row in speed["tables"]["small"]] == ["tet", "tet"]


def test_a_current_folder_that_has_been_deleted_is_named(tmp_path: Path) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    script = "import os, sys; os.rmdir(os.getcwd()); from charms_bench.cli import main; main()"
    command = [sys.executable, "-c", script, "run", "ego", "--episodes", "1"]
    called = subprocess.run(command, cwd=gone, capture_output=True, text=True)
    assert called.returncode == 2
    assert "the current folder has been deleted; change to another folder" in called.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["RUN", "--metric", "sped_mean"], "no metric named 'sped_mean'"),
        (["EMPTY"], "holds no evaluation (manifest.json) and no finished training (stages.csv)"),
        (["NOWHERE", "--all"], "NOWHERE: no such folder"),
        (["EMPTY", "--all"], "is not an evaluation; --metric and --all are for those"),
    ],
)
def test_what_cannot_be_shown_is_one_message(
    finished_run: Path, tmp_path: Path, options: list[str], message: str
) -> None:
    places = {"RUN": finished_run, "EMPTY": tmp_path}
    result = charms_bench("show", *(places.get(option, option) for option in options))
    assert (result.returncode, result.stdout) == (2, "")
    assert message in result.stderr


def test_colours_asked_for_in_a_file_bring_no_bar_that_moves(
    suite_file: Path, copied_run: Path
) -> None:
    words = ["run", "suite.yaml", "--workers", "1", "--output", str(copied_run)]
    result = subprocess.run(
        [sys.executable, "-m", "charms_bench", *words],
        capture_output=True,
        text=True,
        check=True,
        cwd=suite_file.parent,
        env={**os.environ, "FORCE_COLOR": "1"},
    )
    assert result.stderr.splitlines() == ["6 of 12 episodes", "12 of 12 episodes"]
    assert not re.search(r"\r|\x1b\[\?|\x1b\[\d*[A-K]", result.stdout)


def test_a_log_in_ascii_has_question_marks_and_no_traceback(finished_run: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "charms_bench", "show", str(finished_run)],
        capture_output=True,
        check=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )
    assert b"2 ? 1 cells" in result.stdout


def test_many_episodes_are_a_line_every_tenth(capsys: pytest.CaptureFixture[str]) -> None:
    with progress("episodes", 100_000) as tell:
        for _ in range(100_000):
            tell("[bold]an ego[/]", 1)
    lines = capsys.readouterr().err.splitlines()
    assert (len(lines), lines[0]) == (10, "10,000 of 100,000 episodes")


def test_bench_prints_ratios() -> None:
    result = charms_bench("bench", "--seconds", "0.1", "--rounds", "1", "--json")
    rows = json.loads(result.stdout)
    assert "batched, 21 vehicles, 1 thread" in result.stderr.splitlines()
    assert "Traceback" not in result.stderr
    assert {"batched", "highway-env engine", "highway-env"} <= {row["name"] for row in rows}
    reference = next(row for row in rows if row["name"] == "highway-env")
    assert reference["times_highway_env"] == 1.0


def test_verify_and_bench_take_a_road_of_highway_env() -> None:
    words = ("verify", "--workers", 1, "--road")
    result = charms_bench(*words, "merge-v1", "--episodes", 2, "--json")
    assert result.returncode == 0, result.stdout + result.stderr
    assert [row["differences"] for row in json.loads(result.stdout)] == [[]]
    file = Path(__file__).parents[2] / "suites" / "places" / "roundabout.json"
    result = charms_bench(*words, file, "--episodes", 1)
    assert "1 episode: the engines agree." in result.stdout
    result = charms_bench(*words, "merge-v1", "--starts", "--json")
    assert [(row["episodes"], row["steps"]) for row in json.loads(result.stdout)] == [(20, 0)]
    result = charms_bench("bench", "--road", "merge-v1", "--seconds", 0.1, "--rounds", 1, "--json")
    rows = json.loads(result.stdout)
    assert [row["name"] for row in rows] == ["charms_bench/merge-v1", "highway-env"]
    result = charms_bench("bench", "--road", "merge-v1", "--vehicles", 50)
    assert (result.returncode, result.stderr) == (2, "error: --road excludes --vehicles\n")
    result = charms_bench(*words, "merg-v1")
    assert result.returncode == 2
    assert "no file and no environment named 'merg-v1'" in result.stderr


def test_ctrl_c_says_what_is_left_and_exits_130(suite_file: Path) -> None:
    output = suite_file.parent / "run"
    command = [sys.executable, "-m", "charms_bench", "run", str(suite_file)]
    running = subprocess.Popen(
        [*command, "--episodes", "20000", "--output", str(output)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A background job starts with Ctrl-C ignored, and so would what it starts.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    while not list(output.glob("checksums/*")):
        time.sleep(0.05)
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130
    assert f"interrupted; finished shards are in {output}" in said.replace("\n", "")
    assert "Traceback" not in said


def test_a_terminal_gets_a_progress_bar(suite_file: Path, copied_run: Path) -> None:
    primary, secondary = pty.openpty()
    command = [sys.executable, "-m", "charms_bench", "run", str(suite_file)]
    running = subprocess.Popen(
        [*command, "--workers", "1", "--output", str(copied_run)],
        stdout=subprocess.DEVNULL,
        stderr=secondary,
        env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "120"},
    )
    os.close(secondary)
    seen = b""
    while True:
        try:
            seen += os.read(primary, 65536)
        except OSError:  # the other end is closed
            break
    assert running.wait() == 0
    assert b"episodes" in seen
    assert "━".encode() in seen


def test_a_bug_of_ours_has_its_own_exit_code_and_a_traceback(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("charms_bench.runs.copied_suite.copy_suite", lambda _: 1 / 0)
    called = charms_bench("suites", "--copy", "ego", cwd=tmp_path)
    assert called.returncode == 70
    assert "ZeroDivisionError" in called.stderr
    assert "This is a bug of charms-bench. Please report it" in called.stderr


def test_quiet_leaves_out_progress_and_verbose_says_where_an_error_was_raised(
    suite_file: Path, tmp_path: Path
) -> None:
    words = ("run", suite_file, "--workers", 1, "--output", tmp_path / "run")
    assert charms_bench(*words, "--quiet").stderr == ""
    assert "6 episodes" not in charms_bench("--quiet", *words).stderr
    assert "Traceback" not in charms_bench("run", tmp_path / "none.yaml").stderr
    told = charms_bench("run", tmp_path / "none.yaml", "--verbose").stderr
    assert "none.yaml: no such file" in told
    assert "in suite_file" in told


def test_a_run_prints_its_table_and_draws_figures_whatever_the_style_and_the_backend_are(
    suite_file: Path, finished_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = suite_file.parent
    (folder / "matplotlibrc").write_text("text.usetex: True\nfont.size: 40\n")
    monkeypatch.setenv("MPLBACKEND", "nonsense")
    ran = in_a_process("run", "suite.yaml", cwd=folder)
    assert ran.returncode == 0, ran.stderr
    assert "A [bold]small[/] suite" in ran.stdout
    assert re.search(r"IDM\s+\d+\.\d+", ran.stdout)
    assert "paper 23.67" in ran.stdout
    run, figure = folder / "runs" / "small", Path("figures", "small-tradeoff.png")
    assert (run / "tables" / "small.csv").exists()
    assert (run / figure).read_bytes() == (finished_run / figure).read_bytes()


def test_a_style_that_cannot_be_read_is_named(suite_file: Path) -> None:
    folder = suite_file.parent
    (folder / "matplotlibrc").write_bytes(b"\xff\xfe: [\n")
    ran = in_a_process("run", "suite.yaml", "--workers", 1, "--output", "styled", cwd=folder)
    assert ran.returncode == 2
    assert "error: matplotlibrc: matplotlib cannot read this file" in ran.stderr


def test_an_export_does_not_overwrite_its_checkpoint(tmp_path: Path) -> None:
    (tmp_path / "policy.onnx").write_bytes(b"a checkpoint")
    result = charms_bench("export", "policy.onnx", "./policy.onnx", cwd=tmp_path)
    assert result.returncode == 2
    assert "is also the file to write; choose another name" in result.stderr
    assert (tmp_path / "policy.onnx").read_bytes() == b"a checkpoint"


@pytest.mark.parametrize(
    ("name", "value"),
    [("NUMBA_NUM_THREADS", "0"), ("POLARS_MAX_THREADS", "abc"), ("SOURCE_DATE_EPOCH", "-1")],
)
def test_a_variable_that_a_library_would_fail_at_is_named(
    name: str, value: str, copied_run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, value)
    answer = charms_bench("show", copied_run, columns=200)
    assert answer.returncode == 2
    assert answer.stderr.startswith(f"error: {name} is '{value}'; expected a whole number from ")
    assert len(answer.stderr.splitlines()) == 1


def test_a_reader_that_leaves_ends_a_command_with_its_own_exit_code(copied_run: Path) -> None:
    command = [sys.executable, "-m", "charms_bench", "show", str(copied_run), "--all"]
    reading, writing = os.pipe()
    os.close(reading)
    answer = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True)
    os.close(writing)
    assert (answer.returncode, answer.stderr) == (141, "")


def test_numbas_file_in_the_current_folder_is_named(copied_run: Path) -> None:
    (copied_run.parent / ".numba_config.yaml").write_text("[[[")
    answer = charms_bench("show", copied_run, cwd=copied_run.parent, columns=200)
    assert answer.returncode == 2
    assert answer.stderr.startswith("error: .numba_config.yaml: numba would read this file")


def test_no_width_hides_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal.out.cache_clear()
    monkeypatch.setenv("COLUMNS", "0")
    assert terminal.out().width == 120
    terminal.out.cache_clear()


def test_a_network_that_has_changed_is_named_before_its_shards_are_replaced(
    suite_file: Path, tmp_path: Path
) -> None:
    policies = Path(charms_agents.__file__).parent / "policies"
    words = ("run", suite_file, "--agent", "mine.onnx", "--workers", 1, "--output", "run")
    said = []
    for name in ("charms_safe_prosocial", "charms_efficient_egoistic"):
        shutil.copy(policies / f"{name}.onnx", tmp_path / "mine.onnx")
        answer = charms_bench(*words, cwd=tmp_path)
        assert answer.returncode == 0, answer.stderr
        said.append(answer.stderr)
    assert ["mine: 1 finished shard replaced" in each for each in said] == [False, True]


def test_more_episodes_are_not_a_change_of_the_agent(suite_file: Path, tmp_path: Path) -> None:
    words = ("run", suite_file, "--workers", 1, "--output", "run", "--episodes")
    for episodes in (2, 3):
        answer = charms_bench(*words, episodes, cwd=tmp_path)
        assert answer.returncode == 0, answer.stderr
        assert "replaced" not in answer.stderr

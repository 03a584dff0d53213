"""Every command of every page runs, shortened, in a copy of the project."""

import re
import shutil
from pathlib import Path

import pytest
from trios import busy_road, write_trio
from written import PAGES, ROOT, blocks, commands, run, scripts

pytestmark = pytest.mark.slow

CONTROL_CODES = r"[\x00-\x08\x0b-\x1f\x7f-\x9f]"
"""Output to a file must not contain these."""
ELSEWHERE = {
    "your-policy.md": "tests/agents/test_your_policy.py",
    "plugins.md": "tests/docs/test_plugin_guide.py",
    "bring-your-own-road.md": "tests/docs/test_own_road_page.py",
    "environments.md": "tests/agents/test_self_play.py",
    "running.md": "tests/runs/test_cluster.py",
    "reproduction.md": "tests/runs/test_released_suites.py",
    "training-libraries.md": "tests/docs/test_training_libraries.py",
}
"""Pages whose examples depend on one another, and the test that runs all of them."""
CODE_OF = {
    "README.md": "tests/docs/test_python_page.py",
    "python.md": "tests/docs/test_python_page.py",
    "recordings.md": "tests/docs/test_recordings_page.py",
    "maps.md": "tests/docs/test_maps_page.py",
    "highway-env-roads.md": "tests/docs/test_python_page.py",
    "train-on-roads.md": "tests/docs/test_python_page.py",
    "run-folders.md": "tests/docs/test_data_out_page.py",
    **ELSEWHERE,
}
"""Pages with Python code, and the test that runs it."""
NOT_RUN = {
    "pip install .": "the package is installed in the environment of this test",
    "pip install '.[train]'": "the extra is installed in the environment of this test",
    "pip install torch --index-url https://download.pytorch.org/whl/cpu": "torch is installed, too",
    "pip install '.[dataset]'": "the extra is installed in the environment of this test",
    "python -m venv d3rlpy-env": "tox -e data makes this environment",
    "d3rlpy-env/bin/pip install torch d3rlpy 'minari[hdf5]' pillow": "tox -e data runs it",
    "pip install tox": "tox runs this test",
    "tox": "tox runs this test",
    "charms-bench calibrate FOLDER --to my-road.json --figure my-road.png": "takes minutes, and "
    "recordings that are not public",
    "charms-bench likeness suites/likeness.yaml RECORDINGS --population my-road.json "
    "--figure likeness.png": "takes minutes, and recordings that are not public",
    "charms-bench likeness my-egos.yaml SCENES": "takes minutes, and scenes that are not "
    "in the project",
    "python mine.py": "tests/agents/test_your_policy.py trains it",
    "charms-bench export mine.zip mine.onnx": "it is not trained here",
    **dict.fromkeys(
        (
            "charms-bench export model.zip roundabout.onnx",
            "charms-bench export model.zip roundabout.onnx --environment roundabout-v0",
            (
                "charms-bench export model.zip slow.onnx --environment "
                "'{name: merge-v0, configuration: {policy_frequency: 5}}'"
            ),
        ),
        "tests/agents/test_trained_in_highway_env.py trains and exports such a network",
    ),
}
"""Commands that are not run here, with the reason."""
SHORTENED = [
    # 1,800 episodes take minutes.
    (r"charms-bench run suites/(?!train)\S+( --(rows|output) \S+)?", r"\g<0> --episodes 2"),
    (r"charms-bench rare \S+.*", r"\g<0> --runs 5 --samples 100"),
    # An hour, and recordings that are not public: see `short_training` and `recordings`.
    (
        r"(charms-bench run suites/train.yaml) --recordings FOLDER",
        r"\1 --recordings recordings --only charms_efficient_egoistic",
    ),
    (r"charms-bench data FOLDER", "charms-bench data recordings"),
    # The built-in cases are 1,026 episodes of highway-env.
    (r"charms-bench verify", r"\g<0> --suite suites/ego.yaml --episodes 1"),
    (r"charms-bench bench( --road \S+)?", r"\g<0> --seconds 0.1 --rounds 1"),
    (r"(charms-bench verify --road \S+) --episodes \d+( --starts)?", r"\1 --episodes 2\2"),
    (r"python tools/roads_against_stock.py FOLDER.*", r"\g<0> --episodes 2 --starts 2"),
    (r"python tools/train_on_roads.py \S+( --simulator \S+)?", r"\g<0> --steps 200"),
    # 20 repetitions take minutes.
    (r"python tools/search_against_sobol.py .*", r"\g<0> --repetitions 1"),
    (r"(python tools/rare_comparison.py \S+ \S+) \d+ \d+", r"\1 1000 0"),
    # The shortened run has only two episodes.
    (r"(charms-bench replay \S+) \d+ (.*)", r"\1 0 \2"),
    (r"(charms-bench dataset .*) --episodes \d+(.*)", r"\1\2"),
    (r"(charms-bench what-if \S+) \d+ (.*) --at \d+ (.*)", r"\1 0 \2 --at 2 \3"),
    (r"(charms-bench report .* --episode) \d+(.* --what-if) \d+(.*)", r"\1 0\2 2\3"),
]
"""The pattern of a whole command, and the command to run instead."""


def short_training(suites: Path) -> None:
    """Shortens the trainings to a few hundred decisions and one epoch."""
    for path in suites.glob("train*.yaml"):
        text = path.read_text(encoding="utf-8")
        for key, value in {"steps": 400, "learning_starts": 200, "curve_steps": 100, "epochs": 1,
                           "replay_buffer": 500, "scenes": 25, "episodes": 2,
                           "steps_per_gradient_step": 5}.items():  # fmt: skip
            text = re.sub(rf"\b{key}: [\d_]+", f"{key}: {value}", text)
        path.write_text(text, encoding="utf-8")


def recordings(folder: Path) -> None:
    """Writes invented recordings of human driving."""
    folder.mkdir()
    for number in range(1, 5):
        write_trio(folder, busy_road(), number)


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A folder with the files that the commands name."""
    for name in ("suites", "tools", "docs", "networks"):
        shutil.copytree(ROOT / name, tmp_path / name)
    shutil.copy(ROOT / "README.md", tmp_path)
    short_training(tmp_path / "suites")
    recordings(tmp_path / "recordings")
    return tmp_path


def shortened(command: str) -> str:
    for pattern, instead in SHORTENED:
        if re.fullmatch(pattern, command):
            return re.sub(pattern, instead, command)
    return command


def test_every_command_of_every_page_succeeds(project: Path) -> None:
    done: set[str] = set(NOT_RUN)
    failed = []
    for page in (page for page in PAGES if page.name not in ELSEWHERE):
        for block in blocks(page):
            for command in (each for each in commands(block) if each not in done):
                done.add(command)
                finished = run(shortened(command), project)
                said = finished.stdout + finished.stderr
                if finished.returncode or re.search(f"Traceback|{CONTROL_CODES}", said):
                    failed.append(f"{page.name}:{block.line}: {command}\n{said}")
    assert len(done) > 2 * len(NOT_RUN)
    assert not failed, "\n".join(failed)


def test_commands_that_are_not_run_here_are_on_a_page_or_run_by_the_named_test() -> None:
    written = {command for page in PAGES for block in blocks(page) for command in commands(block)}
    assert set(NOT_RUN) <= written
    for page, test in CODE_OF.items():
        assert page in (ROOT / test).read_text(encoding="utf-8")


def test_a_test_runs_the_python_code_of_every_page() -> None:
    assert {page.name for page in PAGES if scripts(page)} <= set(CODE_OF)

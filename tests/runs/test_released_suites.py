"""The suites of docs/reproduction.md run with the authors' networks, if they are here."""

from pathlib import Path

import pytest
import yaml
from command_line import charms_bench

from charms_bench.world.scene import SceneSettings

PROJECT = Path(__file__).parents[2]
SUITES = PROJECT / "suites"
RELEASED = PROJECT.parent / "shared" / "released"
NAMES = ("ego", "styles", "environment")
FINE_TUNED = "CHARMS (PCH), fine-tuned"
"""The traffic that only the released environment has."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the suites and the converted networks."""
    if not RELEASED.is_dir():
        pytest.skip("needs ../shared/released, the networks of the paper's authors")
    pytest.importorskip("torch", reason="needs the extra 'train'")
    made = tmp_path_factory.mktemp("released")
    for name in NAMES:
        (made / f"{name}.yaml").write_bytes((SUITES / "released" / f"{name}.yaml").read_bytes())
    zips = sorted(RELEASED.rglob("*.zip"))
    paper = ("--observation", "paper_neighbours")
    for to, options in (("networks", ()), ("networks/traffic", ("--decision-hz", 15))):
        exported = charms_bench("export", *zips, "--to", made / to, *paper, *options)
        assert exported.returncode == 0, exported.stderr
        assert len(exported.stdout.splitlines()) == len(zips) == 17
    return made


@pytest.mark.parametrize("name", NAMES)
def test_a_suite_runs_with_the_authors_networks(name: str, folder: Path) -> None:
    options = ("--episodes", 2, "--workers", 1, "--output", folder / name)
    called = charms_bench("run", folder / f"{name}.yaml", *options)
    assert called.returncode == 0, called.stderr
    assert (folder / name / "tables" / f"released-{name}.csv").exists()


@pytest.mark.parametrize("name", NAMES)
def test_a_suite_differs_from_its_counterpart_in_its_networks_and_seeds(name: str) -> None:
    theirs, ours = (
        yaml.safe_load((SUITES / part / f"{name}.yaml").read_text()) for part in ("released", "")
    )
    assert theirs["suite"] == f"released-{name}"
    assert (theirs["seed"], theirs["episodes"]) == (5_000_000, ours["episodes"])
    assert theirs["columns"] == ours["columns"]
    own = ("CHARMS", "CHARMS best response") if name == "ego" else ()
    ours["egos"] = [each for each in ours["egos"] if each["label"] not in own]
    theirs["traffic_models"] = [
        each for each in theirs["traffic_models"] if each["label"] != FINE_TUNED
    ]
    for entries in ("egos", "traffic_models"):
        for one, other in zip(theirs[entries], ours[entries], strict=True):
            assert one["label"] == other["label"].removesuffix(" by the paper")
            assert one.get("paper") == other.get("paper")


@pytest.mark.parametrize("name", NAMES)
def test_a_suite_without_its_networks_says_how_to_make_them(name: str, tmp_path: Path) -> None:
    suite = tmp_path / "suite.yaml"
    suite.write_bytes((SUITES / "released" / f"{name}.yaml").read_bytes())
    called = charms_bench("run", suite, "--output", tmp_path / "run")
    assert called.returncode == 2
    assert f".zip --to {tmp_path}/networks" in called.stderr
    assert "makes it from a checkpoint" in called.stderr


@pytest.mark.parametrize("name", [*NAMES, "transfer"])
def test_episodes_last_61_decisions(name: str) -> None:
    text = yaml.safe_load((SUITES / "released" / f"{name}.yaml").read_text())
    assert SceneSettings.model_validate(text["scene"]).decisions == 61


def test_the_networks_stay_out_of_the_project() -> None:
    assert "/suites/released/networks/\n" in (PROJECT / ".gitignore").read_text()
    assert '"/suites/released/networks"' in (PROJECT / "pyproject.toml").read_text()

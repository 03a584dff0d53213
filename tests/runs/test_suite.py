"""Suites: profiles with overrides, agents by name or path, cells and fingerprints."""

import re
from pathlib import Path
from typing import Any

import pytest

from charms_bench.errors import SuiteError
from charms_bench.plugins.specs import AgentSpec
from charms_bench.runs.suite import Suite, load_suite

MINIMAL = {
    "suite": "small",
    "episodes": 4,
    "egos": [{"agent": "idm_mobil"}],
    "traffic_models": [{"traffic": "idm_mobil"}],
}

VALIDATION_SEEDS = 900_000_000
"""Networks and settings are chosen on episodes with seeds from here on (docs/training.md)."""


def test_a_plain_text_is_an_ego_or_a_traffic_model() -> None:
    short = {"egos": ["idm_mobil"], "traffic_models": ["idm_mobil"]}
    assert Suite.model_validate(MINIMAL | short) == Suite.model_validate(MINIMAL)


def test_a_profile_is_a_name_with_overrides() -> None:
    profile = {"name": "charms", "tau_heading_s": 0.4, "idm_mobil": {"time_headway_s": 1.2}}
    suite = Suite.model_validate({**MINIMAL, "scene": {"profile": profile}})
    assert suite.scene.profile.tau_heading_s == 0.4
    assert suite.scene.profile.idm_mobil.time_headway_s == 1.2
    assert suite.scene.profile.idm_mobil.jam_distance_m == 10.0  # REFERENCE: s0, untouched


def test_the_profiles_have_the_constants_of_the_release_and_of_highway_env() -> None:
    from highway_env.vehicle.behavior import IDMVehicle
    from highway_env.vehicle.controller import ControlledVehicle
    from highway_env.vehicle.kinematics import Vehicle

    stock = Suite.model_validate({**MINIMAL, "scene": {"profile": "highway-env"}}).scene.profile
    assert (stock.speed_min_mps, stock.speed_max_mps) == (Vehicle.MIN_SPEED, Vehicle.MAX_SPEED)
    assert stock.tau_acceleration_s == ControlledVehicle.TAU_ACC
    assert stock.tau_heading_s == ControlledVehicle.TAU_HEADING
    assert stock.tau_lateral_s == ControlledVehicle.TAU_LATERAL
    assert stock.idm_mobil.time_headway_s == IDMVehicle.TIME_WANTED
    assert stock.idm_mobil.jam_distance_m == IDMVehicle.DISTANCE_WANTED


def test_every_ego_meets_every_traffic() -> None:
    egos = [{"agent": "idm_mobil"}, {"agent": "stackelberg"}]
    traffics = [{"traffic": "idm_mobil"}, {"traffic": {"mixture": {"level_0": 1.0}}}]
    suite = Suite.model_validate({**MINIMAL, "egos": egos, "traffic_models": traffics})
    assert [(cell.ego.title, cell.traffic.title) for cell in suite.cells] == [
        ("idm_mobil", "idm_mobil"),
        ("idm_mobil", "level_0"),
        ("stackelberg", "idm_mobil"),
        ("stackelberg", "level_0"),
    ]


def test_the_fingerprint_ignores_the_number_of_episodes_and_nothing_else_that_counts() -> None:
    base = Suite.model_validate(MINIMAL)
    longer = Suite.model_validate({**MINIMAL, "episodes": 5})
    denser = Suite.model_validate({**MINIMAL, "scene": {"density": 1.5}})
    assert base.fingerprint() == longer.fingerprint() != denser.fingerprint()


SCENARIO = {
    "ego": {"lane": 1, "speed_mps": 30},
    "vehicles": [{"name": "one", "lane": 0, "ahead_of": "ego", "gap_m": 9, "speed_mps": 25}],
}


@pytest.mark.parametrize(
    ("fields", "label"),
    [
        ({}, "standard-5"),
        ({"traffic_models": [{"traffic": {"scenario": SCENARIO}}]}, "standard-5(warm_up_s=0)"),
        ({"roads": ["merge-v0"]}, "standard-5(warm_up_s=0)"),
        ({"warm_up_s": 1.5}, "standard-5(warm_up_s=1.5)"),
    ],
)
def test_what_is_left_out_at_the_start_is_the_suites(fields: dict[str, Any], label: str) -> None:
    suite = Suite.model_validate(MINIMAL | fields)
    assert suite.metric_sets[1].label == label


def test_a_warm_up_that_leaves_nothing_is_rejected() -> None:
    with pytest.raises(ValueError, match="warm_up_s: 20 s leave nothing of an episode of 20 s"):
        Suite.model_validate(MINIMAL | {"warm_up_s": 20})


def test_the_fingerprint_ignores_what_only_changes_the_presentation() -> None:
    dressed = {"title": "A", "columns": ["speed_mean"], "references": ["i24"], "warm_up_s": 0}
    base = Suite.model_validate(MINIMAL)
    assert base.fingerprint() == Suite.model_validate({**MINIMAL, **dressed}).fingerprint()


@pytest.mark.parametrize(
    ("references", "message"),
    [
        (
            ["i42"],
            "no reference named 'i42'; .* Did you mean 'i24'. Known: i24, i75, us101, us101_c",
        ),
        ([{"name": "i24", "recordings": "highd"}], "give a name, or a folder of recordings"),
        (["i24", "us101", "i24"], "a reference is given twice"),
    ],
)
def test_a_reference_is_a_shipped_name_or_a_folder(references: list[object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Suite.model_validate({**MINIMAL, "references": references})


def test_references_are_for_one_ego() -> None:
    egos = [{"agent": "idm_mobil"}, {"agent": "stackelberg"}]
    with pytest.raises(
        ValueError, match="references are compared with traffic models; expected one ego"
    ):
        Suite.model_validate({**MINIMAL, "egos": egos, "references": ["i24"]})


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({"name": "a", "onnx": "b.onnx"}, "expected a path that ends in .onnx, and no name"),
        ({"onnx": "b.pt"}, "expected a path that ends in .onnx, and no name"),
        ({}, "Field required"),
        ({"name": "a", "decision_hz": 3}, "decision_hz is for networks"),
        ({"name": "b.onnx", "options": {"gain": 1}}, "options are for installed agents"),
        ("a" * 81, "expected 1 to 80 characters"),
        ("a" * 1000 + ".onnx", "at most 1000 characters"),
        ("a\x1b.onnx", "characters that can be printed"),
    ],
)
def test_an_agent_is_a_name_or_a_network(spec: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AgentSpec.model_validate(spec)


def test_the_two_ways_to_write_a_network_mean_the_same() -> None:
    assert AgentSpec.model_validate({"onnx": "b.onnx"}) == AgentSpec.model_validate("b.onnx")
    slow = AgentSpec.model_validate({"onnx": "b.onnx", "decision_hz": 1})
    assert (slow.name, slow.decision_hz) == ("b.onnx", 1.0)


def test_an_agent_that_is_not_installed_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "suite.yaml"
    path.write_text(
        "suite: small\nepisodes: 1\negos:\n- agent: idm_mobl\n"
        "traffic_models:\n- traffic: idm_mobil\n"
    )
    expected = r"suite\.yaml:4: egos\[0\]: no agent named 'idm_mobl'\. .*Did you mean 'idm_mobil'"
    with pytest.raises(SuiteError, match=expected):
        load_suite(path)


def test_a_vehicle_types_parameter_that_no_driver_has_is_named_with_its_line(
    tmp_path: Path,
) -> None:
    path = tmp_path / "suite.yaml"
    path.write_text(
        "suite: small\nepisodes: 1\negos:\n- agent: idm_mobil\ntraffic_models:\n"
        "- traffic: idm_mobil_varied\nscene:\n  vehicle_types:\n  - name: truck\n"
        "    proportion: 1\n"
        "    driver_parameters:\n      time_headway: [1, 2]\n"
    )
    expected = r"suite\.yaml:12: scene.vehicle_types\[0\].driver_parameters.time_headway: no driver"
    with pytest.raises(SuiteError, match=expected):
        load_suite(path)


def skip_without_data(path: Path) -> None:
    """Skips a suite whose recordings or maps are not here; they are not part of the project."""
    for name in re.findall(r"{(?:folder|file): (\.\./[^,}]*)", path.read_text()):
        if not (path.parent / name).exists():
            pytest.skip(f"no data in {path.parent / name}")


@pytest.mark.parametrize("path", sorted(Path("suites").glob("*.yaml")), ids=lambda path: path.stem)
def test_the_suites_of_the_project_are_valid(path: Path) -> None:
    if "pipeline:" in path.read_text():
        pytest.skip("a training; its pipeline validates it")
    skip_without_data(path)
    assert load_suite(path).suite == path.stem


@pytest.mark.parametrize("path", sorted(Path("suites").rglob("*.yaml")), ids=lambda path: path.stem)
def test_no_suite_that_reports_uses_episodes_on_which_networks_were_trained_or_chosen(
    path: Path,
) -> None:
    if "pipeline:" in path.read_text():
        pytest.skip("a training; its seeds begin at 2^40")
    skip_without_data(path)
    suite = load_suite(path)
    if path.name == "pch.yaml":  # by which tau and beta are chosen
        assert suite.seed >= VALIDATION_SEEDS
    else:
        assert suite.seed + suite.episodes <= VALIDATION_SEEDS

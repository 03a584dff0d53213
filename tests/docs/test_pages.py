"""The pages describe what exists."""

import re
import shlex
from collections import Counter
from pathlib import Path

import pytest
import typer
import yaml
from trios import busy_road, write_trio
from write_reference import filled
from written import PAGES, ROOT, blocks, spans

from charms_bench import __version__
from charms_bench.cli import app
from charms_bench.metrics import METRIC_SETS
from charms_bench.plugins.registry import AGENTS, TRAFFIC, plugins
from charms_bench.runs.suite import Suite

SMALL = {
    "suite": "small",
    "episodes": 1,
    "egos": [{"agent": "idm_mobil"}],
    "traffic_models": [{"traffic": "idm_mobil"}],
}
"""What an example that shows a part of a suite leaves out."""
KNOWN = typer.main.get_command(app).commands  # type: ignore[attr-defined]  # of a group


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_block_names_its_language(page: Path) -> None:
    unnamed = [block.line for block in blocks(page) if not block.language]
    assert not unnamed, "a block of commands is ```sh, and what they print is ```text"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_sentences_exist_with_their_options(page: Path) -> None:
    for span in spans(page):
        if not re.match(r"charms-bench [a-z]", span):
            continue
        _, name, *arguments = shlex.split(span)
        assert name in KNOWN, span
        options = {option for parameter in KNOWN[name].params for option in parameter.opts}
        asked = {word.partition("=")[0] for word in arguments if word.startswith("--")}
        takes_any = KNOWN[name].context_settings.get("ignore_unknown_options")
        assert takes_any or asked <= {*options, "--help"}, span


def test_every_metric_is_explained() -> None:
    explained = set(spans(ROOT / "docs" / "metrics.md"))
    formulas = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    explained |= set(re.findall(r"\\text\{(\w+)\}", formulas))
    names = {metric.name for metric_set in METRIC_SETS for metric in metric_set.metrics}
    # What drivers do to each other: a concept, after whose it is and before by or to whom.
    conduct = re.compile(r"(?:traffic_)?(\w+?)(?:_by|_to)?(?:_per_1000km)?")
    missing = {name for name in names - explained if conduct.fullmatch(name)[1] not in explained}
    assert not missing


def test_every_suite_is_described() -> None:
    named = set(spans(ROOT / "docs" / "suites.md"))
    assert {suite.stem for suite in (ROOT / "suites").glob("*.yaml")} <= named


def test_every_agent_and_traffic_model_of_the_package_is_described() -> None:
    named = set(spans(ROOT / "docs" / "agents.md"))
    ours = {
        name
        for group in (AGENTS, TRAFFIC)
        for name, each in plugins(group).items()
        if each.distribution == "charms-bench"
    }
    assert ours <= named


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_file_of_the_project_that_a_page_names_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = set(re.findall(r"\b(?:tools|tests|suites)/[\w/.-]+\.(?:py|yaml)\b", text))
    assert [name for name in named if not (ROOT / name).is_file()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_example_of_a_suite_is_valid(page: Path, tmp_path: Path) -> None:
    write_trio(tmp_path, busy_road())
    for block in (block for block in blocks(page) if block.language == "yaml"):
        example = yaml.safe_load(block.text)
        if "vehicle_types" in example:
            example = {"scene": example}
        if "recording" in example.get("scene", {}):
            example["scene"]["recording"] |= {"folder": str(tmp_path), "main_lanes": 1}
            example["scene"]["duration_s"] = 0.5
        for road in (each for each in example.get("roads", ()) if "file" in each):
            ours = ROOT / "suites" / road["file"]
            road["file"] = str(ours if ours.exists() else ROOT / "docs" / "ramp.xodr")
            if not ours.exists():  # the reader's own scene, of which only the rest is checked
                road.pop("configuration", None)
        Suite.model_validate({**SMALL, **example})


def test_every_page_is_two_clicks_from_the_readme() -> None:
    readme, start = (ROOT / name for name in ("README.md", "docs/index.md"))
    linked = re.findall(r"\]\(docs/([a-z0-9.-]+\.md)", readme.read_text(encoding="utf-8"))
    linked += re.findall(r"\]\(([a-z0-9.-]+\.md)", start.read_text(encoding="utf-8"))
    assert {page.name for page in (ROOT / "docs").glob("*.md")} <= set(linked)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_generated_part_of_a_page_is_what_the_code_says(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert filled(text) == text, "python tools/write_reference.py"


def test_no_table_of_results_stands_in_more_than_two_places() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    places = Counter(re.findall("<!-- results: (.*?) -->", text))
    assert max(places.values()) <= 2, places


def test_the_citation_names_the_version_of_the_package() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__

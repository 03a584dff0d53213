"""The page as text: nothing of a name is markup, and nothing comes from outside."""

import hashlib
import json
import re
from base64 import b64encode
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from report_runs import DOLLARS, IMAGE, SCRIPT, charms_bench, make_run, make_training

from charms_bench.errors import InputError
from charms_bench.report.html.report import write_report


class Page(HTMLParser):
    """Elements, ids, links and scripts of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.words: list[str] = []
        self.scripts: list[str] = []
        self.policy = ""
        self._script = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.append(tag)
        self.ids += [found["id"]] if found.get("id") else []
        self.links += [found[key] or "" for key in ("href", "src", "xlink:href") if key in found]
        self._script = tag == "script" and "type" not in found
        if found.get("http-equiv") == "Content-Security-Policy":
            self.policy = found["content"] or ""

    def handle_endtag(self, tag: str) -> None:
        self._script = False

    def handle_data(self, data: str) -> None:
        (self.scripts if self._script else self.words).append(data)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    runs = [make_run(folder, "egos"), make_training(folder)]
    made = write_report(runs, folder / "report.html", top=2, episodes=[], suite_folder=Path())
    (folder / "made.json").write_text(json.dumps(made))
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    return Page((folder / "report.html").read_text(encoding="utf-8"))


def test_names_and_titles_are_text(page: Page) -> None:
    words = "".join(page.words)
    for name in (SCRIPT, IMAGE, DOLLARS, "<b>first</b>"):
        assert name in words
    assert page.tags.count("script") == 4, "ours, and the replays' data"
    assert not {"img", "b"} & set(page.tags)


def test_it_asks_nothing_of_a_network(page: Page) -> None:
    assert page.links
    assert [link for link in page.links if not link.startswith("#")] == []
    assert page.policy.startswith("default-src 'none'")


def test_only_its_own_scripts_may_run(page: Page) -> None:
    assert len(page.scripts) == 3
    for script in page.scripts:
        digest = b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in page.policy
    assert "unsafe-eval" not in page.policy
    assert "script-src 'unsafe-inline'" not in page.policy


def test_every_link_leads_somewhere(page: Page) -> None:
    assert len(page.ids) == len(set(page.ids))
    targets = {link.removeprefix("#") for link in page.links if not link.startswith("#replay=")}
    assert targets <= set(page.ids)


def test_it_says_what_is_in_it(folder: Path) -> None:
    made = json.loads((folder / "made.json").read_text())
    assert made["bytes"] == (folder / "report.html").stat().st_size < 8e6
    assert len(made["replays"]) == 2
    assert all(re.fullmatch(r"egos-[01]-[0-5]", replay) for replay in made["replays"])
    assert not list(folder.glob(".*"))


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"episodes": ["egos:nine"]}, "EPISODE a number; found 'nine'"),
        (
            {"episodes": ["3"]},
            "choose one with --episode egos:3:EGO:TRAFFIC",
        ),
        ({"episodes": ["3:nobody"]}, "no ego called 'nobody'"),
        ({"episodes": [f"99:{DOLLARS}"]}, "holds the episodes 0 to 5, not 99"),
        ({"output": Path("report.pdf")}, "expected a name that ends in .html"),
    ],
)
def test_a_mistake_is_a_sentence(folder: Path, options: dict[str, Any], problem: str) -> None:
    given = {"output": folder / "other.html", "top": 0, "episodes": [], "suite_folder": Path()}
    with pytest.raises(InputError, match=re.escape(problem)):
        write_report([folder / "egos"], **(given | options))
    assert not (folder / "other.html").exists()


def test_a_folder_that_is_no_run_is_named(tmp_path: Path) -> None:
    failed = charms_bench("report", tmp_path)
    assert failed.returncode == 2
    assert "neither an evaluation (manifest.json) nor a training (curves.csv)" in failed.stderr
    assert "Traceback" not in failed.stderr

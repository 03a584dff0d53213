"""The report as a browser shows it: `apt-get install chromium`, then `tox -e browser`."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from report_runs import DOLLARS, IMAGE, SCRIPT, SUITES, charms_bench, make_run, make_training

playwright = pytest.importorskip("playwright.sync_api", reason="is run by `tox -e browser`")
axe = pytest.importorskip("axe_playwright_python.sync_playwright")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="needs Chromium: apt-get install chromium, or your system's package"
)
OPTIONS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
REPLAY = "egos-1-3"
HZ = 15
PATIENCE_MS = 120_000


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The address of a report of small runs of every kind."""
    folder = tmp_path_factory.mktemp("report")
    runs = [make_run(folder, name) for name in SUITES] + [make_training(folder)]
    output = folder / "report.html"
    named = ["--episode", f"egos:3:{DOLLARS}:{SCRIPT}"]
    made = charms_bench("report", *runs, "--output", output, "--top", "3", *named)
    assert made.returncode == 0, made.stderr
    return output.as_uri()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=OPTIONS)
        yield browser
        browser.close()


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """An empty page that fails the test if anything is complained of, or asked of a network."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: complaints.append(request.url))
    yield page
    context.close()
    assert [each for each in complaints if not each.startswith("file://")] == []


def seconds(page: Any) -> float:
    """What the player's clock says."""
    return float(page.locator("#clock").inner_text().split("/")[0])


def opened(page: Any, address: str) -> Any:
    page.goto(address)
    page.locator("#player").wait_for(state="visible")
    return page


def test_a_column_sorts_both_ways_by_its_numbers(page: Any, report: str) -> None:
    table = opened(page, report).locator("section").first.locator("table").first
    header = table.locator("th", has_text="Mean speed")
    column = "cells => cells.map(row => Number(row.cells[1].dataset.value))"
    for ascending in (True, False):
        header.get_by_role("button").click()
        values = table.locator("tbody tr").evaluate_all(column)
        assert values == sorted(values, reverse=not ascending)
        assert header.get_attribute("aria-sort") == ("ascending" if ascending else "descending")


def test_a_number_says_on_a_click_what_it_is(page: Any, report: str) -> None:
    opened(page, report).locator("a.number").first.click()
    card = page.locator("#card")
    assert "95 % interval" in card.inner_text()
    assert "mean of the ego's speed" in card.inner_text().lower() or "speed" in card.inner_text()
    page.keyboard.press("Escape")
    assert not card.is_visible()


def test_a_replay_plays_and_pauses(page: Any, report: str) -> None:
    opened(page, report).locator("#play").click()
    still_near_the_start = re.compile(r"^0\.[0-4]")
    playwright.expect(page.locator("#clock")).not_to_have_text(
        still_near_the_start, timeout=PATIENCE_MS
    )
    page.locator("#play").click()
    stopped = seconds(page)
    page.wait_for_timeout(300)
    assert seconds(page) == stopped
    assert page.locator("#play").inner_text() == "Play"


def test_keys_scrub_frame_by_frame_and_second_by_second(page: Any, report: str) -> None:
    opened(page, report).locator("#road").focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    assert seconds(page) == round(3 / HZ, 1)
    page.keyboard.press("Shift+ArrowRight")
    assert seconds(page) == round(1 + 3 / HZ, 1)
    page.keyboard.press("ArrowLeft")
    assert seconds(page) == round(1 + 2 / HZ, 1)
    page.keyboard.press("Home")
    assert seconds(page) == 0
    page.locator("#scrub").focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#scrub").input_value() == "1"
    assert "speed" in page.locator("#said").text_content()


def test_the_timelines_scrub_by_mouse(page: Any, report: str) -> None:
    timelines = opened(page, report).locator(".timelines:visible")
    width = timelines.bounding_box()["width"]
    timelines.click(position={"x": 0.98 * width, "y": 40})
    last = float(page.locator("#clock").inner_text().split("/")[1].removesuffix("s"))
    assert seconds(page) == pytest.approx(last, abs=0.02 * last + 0.1)


def test_a_link_opens_its_replay_at_its_moment(page: Any, report: str) -> None:
    opened(page, f"{report}#replay={REPLAY}&t=1.2")
    assert page.locator("#player-title").inner_text() == f"{DOLLARS} in {SCRIPT}"
    assert seconds(page) == 1.2
    page.locator("#road").focus()
    page.keyboard.press("ArrowRight")
    assert page.url.endswith(f"#replay={REPLAY}&t={19 / HZ:.2f}")


def test_what_users_wrote_is_text(page: Any, report: str) -> None:
    opened(page, report)
    assert page.evaluate("window.broken") is None
    assert page.locator("h2").first.inner_text() == SCRIPT
    assert IMAGE in page.locator("tbody th").all_inner_texts()
    assert any(SCRIPT in text for text in page.locator("svg text").all_text_contents()) or any(
        IMAGE in text for text in page.locator("svg text").all_text_contents()
    )
    assert any("$x^2$" in text for text in page.locator("svg text").all_text_contents())


@pytest.mark.parametrize("width", [1280, 390])
def test_a_page_is_never_wider_than_its_window(page: Any, report: str, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    opened(page, report).locator("details").evaluate_all("all => all.forEach(e => e.open = true)")
    assert page.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_everybody_can_use_it(page: Any, report: str, scheme: str, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
    opened(page, report).locator("details").evaluate_all("all => all.forEach(e => e.open = true)")
    found = axe.Axe().run(page).response["violations"]
    grave = [each for each in found if each["impact"] in ("serious", "critical")]
    assert [(each["id"], each["nodes"][0]["html"]) for each in grave] == []


def test_it_prints_as_a_document(page: Any, report: str, tmp_path: Path) -> None:
    opened(page, report).pdf(path=tmp_path / "report.pdf", prefer_css_page_size=True)
    pages = re.findall(rb"/Type\s*/Page\b", (tmp_path / "report.pdf").read_bytes())
    assert len(pages) > 2


def test_its_light_can_be_chosen(page: Any, report: str) -> None:
    opened(page, report).locator("#theme").click()
    assert page.evaluate("getComputedStyle(document.body).colorScheme") == "dark"

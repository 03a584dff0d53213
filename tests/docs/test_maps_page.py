"""`docs/maps.md`: its Python code runs, and its road file is one."""

import json
import shutil
from pathlib import Path

import pytest
from written import ROOT, blocks, execute

from charms_bench.maps.reading import read_road
from charms_bench.roads.layout import Layout

PAGE = ROOT / "docs" / "maps.md"


def test_the_code_of_the_page_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "docs").mkdir()
    shutil.copy(ROOT / "docs" / "ramp.xodr", tmp_path / "docs")
    monkeypatch.chdir(tmp_path)
    execute(PAGE)
    assert (tmp_path / "copy.json").exists()
    printed = capsys.readouterr().out.splitlines()
    # The ramp's lane follows the reference line, which is 160 m long, at 1.75 m to its right.
    (ramp,) = (line for line in printed if line.startswith("ramp.0.-1"))
    assert ramp == "ramp.0.-1 159.1 20.0 ('on.0.-3',)"


def test_the_road_file_of_the_page_turns_right(tmp_path: Path) -> None:
    (text,) = (block.text for block in blocks(PAGE) if block.language == "json")
    (tmp_path / "road.json").write_text(text, encoding="utf-8")
    road = read_road(tmp_path / "road.json")
    assert set(json.loads(text)) == {"charms_bench_road", "name", "roads"}
    outside, inside = road.roads[1].lanes
    assert outside.points[-1, :2] == pytest.approx((130, 30), abs=1e-3)
    assert outside.length > inside.length
    assert len(Layout(road.edges()).network.lanes) == 5

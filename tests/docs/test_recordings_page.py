"""The package of calibrated drivers on `docs/recordings.md` works as the page says."""

import shutil
import sys
from pathlib import Path

import pytest
from charms_baselines.human import Human
from plugin_folder import installed
from written import ROOT, blocks

from charms_bench.humans.population import POPULATIONS
from charms_bench.plugins.registry import make_agent, make_traffic


def test_calibrated_drivers_are_traffic_by_a_name_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for block in blocks(ROOT / "docs" / "recordings.md"):
        if file := {"python": "my_road.py", "toml": "pyproject.toml"}.get(block.language):
            (tmp_path / file).write_text(block.text, encoding="utf-8")
    shutil.copy(POPULATIONS / "i24.json", tmp_path / "my-road.json")
    installed(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    try:
        assert make_traffic("my_road").agents == ("my_road",)
        made = make_agent("my_road")
    finally:
        sys.modules.pop("my_road", None)
    assert isinstance(made, Human)
    assert made.files_sha256 == Human("i24").files_sha256 != Human().files_sha256

"""`docs/bring-your-own-road.md`: a map becomes a table and a film with the page alone."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image
from written import ROOT, blocks, commands

PAGE = ROOT / "docs" / "bring-your-own-road.md"


def test_the_page_leads_from_a_map_to_a_table_and_a_film(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "docs").mkdir()
    shutil.copy(ROOT / "docs" / "ramp.xodr", tmp_path / "docs")
    suite, _ = (block.text for block in blocks(PAGE) if block.language == "yaml")
    (tmp_path / "my-road.yaml").write_text(suite, encoding="utf-8")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = {**os.environ, "PATH": path, "COLUMNS": "100"}
    said = {}
    for block in blocks(PAGE):
        for command in commands(block):
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
            )
            said[command] = done.stdout + done.stderr
            assert done.returncode == 0, said[command]
    assert "collisions in 1,000 km" in next(text for key, text in said.items() if " drive " in key)
    assert "IDM+MOBIL" in said["charms-bench run my-road.yaml"]
    film = tmp_path / "runs" / "my-road" / "replays" / "idm-mobil-in-ramp-3.gif"
    assert film.name in PAGE.read_text(encoding="utf-8")
    with Image.open(film) as pictures:
        assert getattr(pictures, "n_frames", 1) > 10
    code = [block.text for block in blocks(PAGE) if block.language == "python"]
    monkeypatch.chdir(tmp_path)
    exec(compile("\n".join(code), PAGE.name, "exec"), {"__name__": "page"})

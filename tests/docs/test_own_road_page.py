"""`docs/bring-your-own-road.md`: a map becomes a table and a film with the page alone."""

import shlex
import shutil
from pathlib import Path

import pytest
from command_line import charms_bench
from PIL import Image
from written import ROOT, blocks, commands, execute

PAGE = ROOT / "docs" / "bring-your-own-road.md"


def test_the_page_leads_from_a_map_to_a_table_and_a_film(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "docs").mkdir()
    shutil.copy(ROOT / "docs" / "ramp.xodr", tmp_path / "docs")
    suite, _ = (block.text for block in blocks(PAGE) if block.language == "yaml")
    (tmp_path / "my-road.yaml").write_text(suite, encoding="utf-8")
    said = {}
    for block in blocks(PAGE):
        for command in commands(block):
            words = shlex.split(command)[1:]
            few = ("--episodes", 4, "--workers", 1) if words[0] == "run" else ()
            done = charms_bench(*words, *few, cwd=tmp_path)
            said[command] = done.stdout + done.stderr
            assert done.returncode == 0, said[command]
    assert "collisions in 1,000 km" in next(text for key, text in said.items() if " drive " in key)
    assert "IDM+MOBIL" in said["charms-bench run my-road.yaml"]
    film = tmp_path / "runs" / "my-road" / "replays" / "idm-mobil-in-ramp-3.gif"
    assert film.name in PAGE.read_text(encoding="utf-8")
    with Image.open(film) as pictures:
        assert getattr(pictures, "n_frames", 1) > 10
    monkeypatch.chdir(tmp_path)
    execute(PAGE)

"""`charms-bench road` describes, draws and writes road maps."""

import json
from pathlib import Path

from command_line import charms_bench

RAMP = Path(__file__).parents[2] / "docs" / "ramp.xodr"


def test_a_map_is_described_drawn_and_written(tmp_path: Path) -> None:
    done = charms_bench("road", RAMP, "--to", "ramp.json", "--figure", "ramp.png", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    # Two lanes of 300 m, three of 200 m, two of 150 m, and the ramp.
    assert "8, 1.66 lane-km" in done.stdout
    assert "1 of type 'shoulder'" in done.stdout
    assert "0 crossing and 1 merging" in done.stdout
    assert 'by their nodes, for scenarios: ["0", "1"], ["2", "1"], ["1", "3"], ' in done.stdout
    assert done.stdout.endswith("Written: ramp.json\nWritten: ramp.png\n")
    assert (tmp_path / "ramp.png").read_bytes().startswith(b"\x89PNG")
    of_map, of_file = (
        json.loads(charms_bench("road", path, "--json", cwd=tmp_path).stdout)
        for path in (RAMP, "ramp.json")
    )
    assert of_map == of_file
    assert of_map["speed_limits_mps"] == [20.0, 30.0]


def test_a_map_is_cut_around_a_point() -> None:
    done = charms_bench("road", RAMP, "--around", 150, "-46", "--radius", 10, "--json")
    assert json.loads(done.stdout)["lanes"] == 1


def test_mistakes_are_one_line(tmp_path: Path) -> None:
    broken = tmp_path / "broken.xodr"
    broken.write_text(RAMP.read_text(encoding="utf-8").replace('from="-2"', 'from="-9"'))
    exists = tmp_path / "exists.json"
    exists.touch()
    for arguments, what in (
        ((broken,), "leads to lane -9 at the end of road 'main', which does not have it"),
        ((RAMP, "--around", 0, 0), "--around and --radius belong together"),
        ((RAMP, "--around", "nan", 0, "--radius", 1), "expected a point and a distance"),
        ((RAMP, "--to", exists), "exists already"),
        ((RAMP, "--to", "ramp.xml"), "expected a name that ends in .json"),
        ((RAMP, "--around", 0, 9000, "--radius", 1), "no lane is within 1 m of (0, 9000)"),
        ((tmp_path / "none.xodr",), "none.xodr: cannot be read: No such file"),
    ):
        done = charms_bench("road", *arguments)
        assert done.returncode == 2
        assert what in done.stderr.replace("\n", " ")
        assert done.stderr.startswith("error: ")
        assert done.stdout == ""

"""Bad arguments on the command line."""

from collections.abc import Sequence
from pathlib import Path

from bad_input import BadInput

SUITE = """\
suite: small
episodes: 2
scene: {duration_s: 2.0, traffic_vehicles: 5}
egos: [{agent: idm_mobil}]
traffic_models: [{traffic: idm_mobil}]
"""
LONG = "x" * 5000
WORDS: tuple[Sequence[str], ...] = (
    ("nothing-of-the-kind",),
    ("run",),
    ("run", ""),
    ("run", "nowhere.yaml"),
    ("run", LONG),
    ("run", "/dev/zero"),
    ("run", "/proc/self/mem"),
    ("run", "suite.yaml", "two.yaml"),
    ("run", "suite.yaml", "--episodes", "0"),
    ("run", "suite.yaml", "--episodes", "many"),
    ("run", "suite.yaml", "--episodes", "9" * 30),
    ("run", "suite.yaml", "--episodes", "9" * 5000),
    ("run", "suite.yaml", "--seed", "999999999"),
    ("run", "suite.yaml", "--seed", "9" * 30),
    ("run", "suite.yaml", "--workers", "1000000000"),
    ("run", "suite.yaml", "--engine", "steam"),
    ("run", "suite.yaml", "--output", "suite.yaml"),
    ("run", "suite.yaml", "--output", "suite.yaml/run"),
    ("run", "suite.yaml", "--output", "."),
    ("run", "suite.yaml", "--output", LONG),
    ("run", "suite.yaml", "--output", "/proc/run"),
    ("run", "suite.yaml", "--rows", "nowhere", "--output", "run"),
    ("run", "suite.yaml", "--only", "x"),
    ("run", "suite.yaml", "--recordings", "x"),
    ("run", "suite.yaml", "--sudo"),
    ("rare", "suite.yaml", "--event", ""),
    ("rare", "suite.yaml", "--event", "ttc:below_s="),
    ("rare", "suite.yaml", "--event", "ttc:below_s=.nan"),
    ("rare", "suite.yaml", "--runs", "0"),
    ("rare", "suite.yaml", "--samples", "-10"),
    ("rare", "suite.yaml", "--output", "."),
    ("agents", "more"),
    ("check", ""),
    ("check", "../idm_mobil"),
    ("check", LONG),
    ("traffic", ""),
    ("traffic", "pch", "--tau"),
    ("traffic", "pch", "--tau", "-1"),
    ("traffic", "pch", "--tau", ".nan"),
    ("traffic", "pch", "--tau", ".inf"),
    ("traffic", "pch", "--tau", "1.0e+308"),
    ("traffic", "pch", "--tau", "9" * 5000),
    ("traffic", "pch", "--tau", "0x" + "f" * 5000),
    ("traffic", "pch", "--tau", "2001-99-99"),
    ("traffic", "pch", "--tau", "["),
    ("traffic", "pch", "--tau", "[" * 50_000),
    ("traffic", "pch", "--tau", "[1, &a 2, *a]"),
    ("traffic", "pch", "--tau", "!!python/object/apply:os.mkdir [canary]"),
    ("traffic", "pch", "--tau", "!!int ''"),
    ("traffic", "pch", "--tau", "{[1]: 2}"),
    ("traffic", "pch", "--tau", "\x00"),
    ("traffic", "pch", "--beta", "2"),
    ("traffic", "pch", "--__class__", "1"),
    ("traffic", "pch", "--figure", "x.exe"),
    ("traffic", "pch", "--figure", "suite.yaml/x.png"),
    ("traffic", "idm_mobil", "--tau", "1"),
    ("new-agent", ""),
    ("new-agent", "os"),
    ("new-agent", "numpy"),
    ("new-agent", "tests"),
    ("new-agent", "idm_mobil"),
    ("new-agent", "pch"),
    ("new-agent", "'; import os; os.mkdir('canary'); '"),
    ("new-agent", "fine", "--folder", "."),
    ("new-agent", "fine", "--folder", LONG),
    ("bench", "--traffic", "outside_no_agent"),
    ("edge-cases", "nowhere"),
    ("edge-cases", "."),
    ("edge-cases", ".", "--kind", "boring"),
    ("watch", "missing.onnx"),
    ("what-if", ".", "0", "--at", "1"),
    ("replay", ".", "-1"),
    ("replay", ".", "0", "--commonroad", "scenario.txt"),
    ("dataset", ".", "--format", "minary"),
    ("dataset", "."),
    ("show", ""),
    ("show", "a\x00b"),
    ("show", LONG),
    ("show", ".", "."),
    ("show", ".", "--all"),
    ("show", ".", "--metric"),
    ("report", ""),
    ("report", ".", "--output", "suite.yaml"),
    ("compare", ".", "--egos", "one"),
    ("data", "nowhere"),
    ("data", "suite.yaml"),
    ("data", "/dev/zero"),
    ("data", LONG),
    ("export", "suite.yaml", "out.onnx"),
    ("export", "suite.yaml", "out.pt"),
)  # fmt: skip


def _bad(words: Sequence[str]) -> BadInput:
    def make(folder: Path) -> Sequence[str]:
        (folder / "suite.yaml").write_text(SUITE)
        return words

    return BadInput(" ".join(words)[:60], make)


CASES = tuple(map(_bad, WORDS))

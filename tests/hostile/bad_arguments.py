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
    ("run", "suite.yaml", "two.yaml"),
    ("run", "suite.yaml", "--episodes", "0"),
    ("run", "suite.yaml", "--episodes", "many"),
    ("run", "suite.yaml", "--episodes", "9" * 5000),
    ("run", "suite.yaml", "--seed", "999999999"),
    ("run", "suite.yaml", "--workers", "1000000000"),
    ("run", "suite.yaml", "--output", "suite.yaml"),
    ("run", "suite.yaml", "--output", "."),
    ("run", "suite.yaml", "--output", LONG),
    ("run", "suite.yaml", "--rows", "nowhere", "--output", "run"),
    ("run", "suite.yaml", "--only", "x"),
    ("run", "suite.yaml", "--recordings", "x"),
    ("run", "suite.yaml", "--sudo"),
    ("rare", "suite.yaml", "--event", ""),
    ("rare", "suite.yaml", "--event", "ttc:below_s=.nan"),
    ("rare", "suite.yaml", "--runs", "0"),
    ("rare", "suite.yaml", "--samples", "-10"),
    ("agents", "more"),
    ("check", ""),
    ("check", "../idm_mobil"),
    ("traffic", ""),
    ("traffic", "pch", "--tau"),
    ("traffic", "pch", "--tau", "-1"),
    ("traffic", "pch", "--tau", ".nan"),
    ("traffic", "pch", "--tau", "1.0e+308"),
    ("traffic", "pch", "--tau", "9" * 5000),
    ("traffic", "pch", "--tau", "2001-99-99"),
    ("traffic", "pch", "--tau", "!!python/object/apply:os.mkdir [canary]"),
    ("traffic", "pch", "--tau", "\x00"),
    ("traffic", "pch", "--beta", "2"),
    ("traffic", "pch", "--__class__", "1"),
    ("traffic", "pch", "--figure", "x.exe"),
    ("traffic", "pch", "--figure", "suite.yaml/x.png"),
    ("traffic", "idm_mobil", "--tau", "1"),
    ("new-agent", ""),
    ("new-agent", "os"),
    ("new-agent", "numpy"),
    ("new-agent", "idm_mobil"),
    ("new-agent", "'; import os; os.mkdir('canary'); '"),
    ("new-agent", "fine", "--folder", "."),
    ("new-agent", "fine", "--folder", LONG),
    ("bench", "--traffic", "outside_no_agent"),
    ("edge-cases", "nowhere"),
    ("edge-cases", ".", "--kind", "boring"),
    ("watch", "missing.onnx"),
    ("what-if", ".", "0", "--at", "1"),
    ("replay", ".", "-1"),
    ("replay", ".", "0", "--commonroad", "scenario.txt"),
    ("dataset", ".", "--format", "minary"),
    ("dataset", "."),
    ("show", ""),
    ("show", "a\x00b"),
    ("show", ".", "--all"),
    ("show", ".", "--metric"),
    ("report", ""),
    ("report", ".", "--output", "suite.yaml"),
    ("compare", ".", "--egos", "one"),
    ("data", "nowhere"),
    ("data", "/dev/zero"),
    ("export", "suite.yaml", "out.onnx"),
    ("export", "suite.yaml", "out.pt"),
)  # fmt: skip


def _bad(words: Sequence[str]) -> BadInput:
    def make(folder: Path) -> Sequence[str]:
        (folder / "suite.yaml").write_text(SUITE)
        return words

    return BadInput(" ".join(words)[:60], make)


CASES = tuple(map(_bad, WORDS))

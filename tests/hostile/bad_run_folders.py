"""Run folders that somebody has altered, and bad arguments for intact ones."""

import json
import os
import shutil
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import polars as pl
from bad_arguments import LONG, SUITE
from bad_input import BadInput
from command_line import charms_bench
from run_folders import sign


@cache
def _whole() -> Path:
    """Returns the folder of a finished run, unaltered."""
    folder = Path(mkdtemp(prefix="charms-bench-"))
    (folder / "suite.yaml").write_text(SUITE)
    answer = charms_bench("run", "suite.yaml", "--workers", 1, "--output", "run", cwd=folder)
    assert answer.returncode == 0, answer.stderr
    return folder / "run"


def _manifest(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], object]:
    def make(run: Path) -> None:
        path = run / "manifest.json"
        manifest = json.loads(path.read_text())
        change(manifest)
        path.write_text(json.dumps(manifest))

    return make


def _text(text: str) -> Callable[[Path], object]:
    return lambda run: (run / "manifest.json").write_text(text)


def _suite(**fields: Any) -> Callable[[Path], object]:
    return _manifest(lambda manifest: manifest["suite"].update(fields))


def _shard(kind: str) -> Callable[[Path], Path]:
    return lambda run: next((run / kind).iterdir())


def _instead(kind: str, make_file: Callable[[Path], object]) -> Callable[[Path], object]:
    """Replaces one file of a shard."""

    def make(run: Path) -> None:
        path = _shard(kind)(run)
        path.unlink()
        make_file(path)

    return make


def _many_rows(path: Path) -> None:
    pl.DataFrame({"episode": pl.repeat(0, 10_000_000, eager=True)}).write_parquet(path)


def signed(kind: str, change: Callable[[pl.DataFrame], pl.DataFrame]) -> Callable[[Path], object]:
    """Changes rows of a shard, and its checksums with them."""

    def make(run: Path) -> None:
        path = _shard(kind)(run)
        change(pl.read_parquet(path)).write_parquet(path)
        sign(run, path.stem)

    return make


def forged(name: str) -> Callable[[Path], object]:
    """Adds a shard of this name with step rows and without episodes."""

    def make(run: Path) -> None:
        for kind in ("steps", "counts", "drivers", "episodes"):
            rows = pl.read_parquet(_shard(kind)(run))
            rows = rows.clear() if kind == "episodes" else rows
            rows.write_parquet(run / kind / f"{name}.parquet")
        sign(run, name)

    return make


def _twice(run: Path) -> None:
    path = run / "manifest.json"
    path.write_text(path.read_text().replace('"episodes": 2', '"episodes": 1, "episodes": 2', 1))


def _instead_of_manifest(make_file: Callable[[Path], object]) -> Callable[[Path], object]:
    def make(run: Path) -> None:
        (run / "manifest.json").unlink()
        make_file(run / "manifest.json")

    return make


FOLDERS: dict[str, Callable[[Path], object]] = {
    "no manifest": _instead_of_manifest(lambda path: None),
    "a manifest that is a list": _text("[]"),
    "a manifest nested without end": _text("[" * 100_000),
    "a manifest without a format": _text("{}"),
    "a manifest of a later format": _manifest(lambda manifest: manifest.update(format=5)),
    "a format that is a text": _manifest(lambda manifest: manifest.update(format="\x1b[2J")),
    "a manifest without a suite": _text('{"format": 4}'),
    "a manifest with a pickle": _text("cos\nmkdir\n(S'canary'\ntR."),
    "a suite called ../../x": _suite(suite="../../x"),
    "a suite of another seed": _suite(seed=10**12),
    "a suite without egos": _suite(egos=[]),
    "a suite of unknown egos": _suite(egos=[{"agent": {"name": "nobody"}}] * 2),
    "a suite with a duration of 10^308": _suite(scene={"duration_s": 1.7e308}),
    "a suite with an unknown key": _suite(surprise=1),
    "a title that clears the screen": _manifest(lambda manifest: manifest.update(title="\x1b[2J")),
    "10^7 episodes announced": _manifest(lambda manifest: manifest.update(episodes=10**7)),
    "episodes that are a text": _manifest(lambda manifest: manifest.update(episodes="2")),
    "a manifest with a field twice": _twice,
    "an agent that is a number": _manifest(lambda manifest: manifest["agents"].update(idm_mobil=1)),
    "a forged shard of later episodes": forged(f"000-000000150-{'0' * 16}"),
    "a forged shard of the same episodes": forged(f"000-000000000-{'0' * 16}"),
    "a speed that is not a number": signed(
        "steps", lambda rows: rows.with_columns(speed=pl.lit(float("nan"), pl.Float32))
    ),
    "steps of other episodes": signed(
        "steps", lambda rows: rows.with_columns(pl.col("episode") + 2)
    ),
    "a step twice": signed("steps", lambda rows: pl.concat([rows, rows.tail(1)])),
    "rows cut short": lambda run: os.truncate(_shard("steps")(run), 100),
    "rows of another kind": _instead("steps", _many_rows),
    "rows that are a folder": _instead("episodes", Path.mkdir),
    "rows that are missing": _instead("steps", lambda path: None),
    "a shard by another name": lambda run: _shard("checksums")(run).rename(
        run / "checksums" / "0-0-.sha256"
    ),
    "checksums of something else": _instead(
        "checksums", lambda path: path.write_text(f"{'0' * 64}  steps/x.parquet\n")
    ),
}  # fmt: skip
COMMANDS: tuple[Sequence[object], ...] = (
    ("rescore", "run"),
    ("edge-cases", "run"),
    ("replay", "run", 0),
    ("compare", "run", "run"),
)
"""Each folder is read by one of these commands, in turn."""

WHOLE: tuple[Sequence[object], ...] = (
    ("show", "run", "run"),
    ("show", "run/manifest.json"),
    ("show", "run", "--metric", ""),
    ("show", "run", "--metric", LONG),
    ("report", "run", "run"),
    ("report", "run", "--output", "run"),
    ("report", "run", "--output", "suite.yaml/x.html"),
    ("report", "run", "--output", "a\x00b.html"),
    ("report", "run", "--output", f"{LONG}.html"),
    ("report", "run", "--output", "folder.html"),
    ("report", "run", "--episode", ""),
    ("report", "run", "--episode", "run:first"),
    ("report", "run", "--episode", "run:-1"),
    ("report", "run", "--episode", "run:²"),
    ("report", "run", "--episode", f"run:{'9' * 5000}"),
    ("report", "run", "--episode", "run:0:nobody"),
    ("report", "run", "--episode", "elsewhere:0"),
    ("report", "run", "--episode", "0", "--top", "-1"),
)
"""Bad arguments for an intact run."""


def _bad_words(words: Sequence[object]) -> BadInput:
    def make(folder: Path) -> Sequence[object]:
        shutil.copytree(_whole(), folder / "run")
        (folder / "suite.yaml").write_text(SUITE)
        (folder / "folder.html").mkdir()
        return words

    return BadInput(" ".join(map(str, words))[:60], make)


def _bad(title: str, change: Callable[[Path], object], command: Sequence[object]) -> BadInput:
    def make(folder: Path) -> Sequence[object]:
        shutil.copytree(_whole(), folder / "run")
        change(folder / "run")
        return command

    return BadInput(f"{command[0]}: {title}", make)


CASES = (
    *map(_bad_words, WHOLE),
    *(
        _bad(title, change, COMMANDS[k % len(COMMANDS)])
        for k, (title, change) in enumerate(FOLDERS.items())
    ),
)

"""What a run folder holds, and checksums for shards that a test has changed."""

import hashlib
from pathlib import Path

from charms_bench.runs.resumable_folder import KINDS


def files(folder: Path) -> dict[str, str]:
    """The hash of each file, by its path in the folder."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def sign(run: Path, name: str) -> None:
    """Writes the checksums of a shard, as somebody would who hides a change."""
    paths = (f"{kind}/{name}.parquet" for kind in KINDS)
    lines = [f"{hashlib.sha256((run / each).read_bytes()).hexdigest()}  {each}\n" for each in paths]
    (run / "checksums" / f"{name}.sha256").write_text("".join(lines))

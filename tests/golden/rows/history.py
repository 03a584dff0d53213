"""Networks that the repository had until a commit, for rows that were recorded with them."""

import subprocess
from pathlib import Path

PROJECT = Path(__file__).parents[3]
COMMIT = "4ce70c32e3ca878a492f5124bd7c6d47aece0601"
"""The last one that has them; docs/results/networks.csv lists them."""


def missing() -> str:
    """Returns why the networks cannot be read here; empty if they can."""
    found = subprocess.run(
        ["git", "cat-file", "-e", f"{COMMIT}:networks"], cwd=PROJECT, capture_output=True
    )
    return f"needs commit {COMMIT[:8]}: git fetch --unshallow" if found.returncode else ""


def earlier_networks(folder: Path) -> Path:
    """Writes the folder `networks` of that commit into a folder; returns its path."""
    packed = subprocess.run(
        ["git", "archive", COMMIT, "networks"], cwd=PROJECT, check=True, stdout=subprocess.PIPE
    )
    subprocess.run(["tar", "--extract", "--directory", folder], input=packed.stdout, check=True)
    return folder / "networks"

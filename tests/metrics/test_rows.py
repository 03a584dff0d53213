"""The columns that look back over decisions, against a plain loop over random rows."""

from itertools import groupby
from typing import Any

import numpy as np
import pytest
from handmade_rows import SCENE, Episode, frames

from charms_bench.metrics.rows import ANOTHER, EGO, join_rows

WINDOW = 6
"""2 s at 3 Hz."""
NOBODY = 0


def random_episode(rng: np.random.Generator) -> Episode:
    """An episode in which lanes, leaders and lateral movements change often."""
    steps = int(rng.integers(1, 30))
    lanes = np.clip(np.cumsum(rng.choice([-1, 0, 1], steps, p=[0.1, 0.8, 0.1])), 0, 2)
    rows = [
        {
            "lane": int(lane),
            "leader": None if rng.random() < 0.1 else int(rng.integers(1, 3)),
            "heading": float(rng.choice([0.0, 0.05, -0.05])),
        }
        for lane in lanes
    ]
    return {"ending": str(rng.choice(["time", "side", "off_road"]))}, rows


def plain(rows: list[dict[str, Any]]) -> list[tuple[int, tuple[float, int] | None]]:
    """Per row of an episode, whose lane change gave the leader, and the movement that ended."""
    found = []
    last, by, started, changes = -WINDOW, NOBODY, None, 0
    for k, row in enumerate(rows):
        changed = k > 0 and row["lane"] != rows[k - 1]["lane"]
        if changed:
            last, by = k, EGO
        elif k > 0 and row["leader"] != rows[k - 1]["leader"]:
            last, by = k, ANOTHER
        collided = row["ending"] == "side" and k == len(rows) - 1
        moves = not collided and abs(row["speed"] * np.sin(row["heading"])) > 0.1
        ended = None
        if moves and started is None:
            started, changes = k, 0
        changes += changed
        if not moves and started is not None:
            ended = ((k - started) / 3, changes) if changes and not collided else None
            started = None
        found.append((by if k - last < WINDOW else NOBODY, ended))
    return found


def test_columns_over_several_decisions_are_those_of_a_plain_loop() -> None:
    rng = np.random.default_rng(0)
    rows = join_rows(*frames(*(random_episode(rng) for _ in range(60))), SCENE).to_dicts()
    ended = []
    for _, group in groupby(rows, key=lambda row: row["episode"]):
        episode = list(group)
        for row, (changer, movement) in zip(episode, plain(episode), strict=True):
            assert row["changer"] == changer
            duration_s, changes = movement or (None, None)
            assert row["movement_s"] == (duration_s and pytest.approx(duration_s))
            assert row["movement_changes"] == changes
            ended += [movement] if movement else []
    assert len(ended) > 20
    assert any(changes > 1 for _, changes in ended)

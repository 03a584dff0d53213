"""The tables of `charms-bench likeness`: scores, what drivers did, and controls."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from charms_bench.foundation.words import counted
from charms_bench.humans.likeness import COMPONENTS, SMALLEST_STRATUM_S, Score
from charms_bench.report.table import Table
from charms_bench.runs.likeness import RECORDED_DRIVER, InScenes, Likeness

CONDUCT = {
    "acceleration_std_mps2": ("acceleration std, m/s²", ".2f"),
    "strong_acceleration": ("above 1.1 m/s²", ".1%"),
    "reversals_per_minute": ("reversals per minute", ".1f"),
    "hard_braking_per_h": ("hard braking, s per hour", ".1f"),
    "time_gap_median_s": ("time gap, median, s", ".2f"),
    "short_headway": ("below 1 s", ".1%"),
    "collided": ("hits the leader", ".1%"),
    "collisions_per_1000km": ("collisions per 1,000 km in traffic", ",.0f"),
    "lane_changes_per_km": ("lane changes per km", ".2f"),
    "undone_lane_changes": ("undone within 5 s", ".1%"),
}
"""The heading and the format of each number of `humans.driven_situations.conduct`."""
_SCORES = {name: name.replace("_", " ") for name in (*COMPONENTS, "total")}


def likeness_tables(rows: Sequence[Likeness], controls: Sequence[Likeness]) -> Iterator[Table]:
    """The scores, what the drivers did, and the controls if there are any."""
    keys, named = ("driver", "kind"), [{"driver": each.label, "kind": each.kind} for each in rows]
    scores = [known | _shown(each.scores) for known, each in zip(named, rows, strict=True)]
    yield Table.plain(scores, keys, dict.fromkeys(_SCORES.values(), ""))
    conduct = [
        known | {title: each.conduct[name] for name, (title, _) in CONDUCT.items()}
        for known, each in zip(named, rows, strict=True)
    ]
    yield Table.plain(conduct, keys, dict(CONDUCT.values()))
    if controls:
        yield controls_table(controls)


def basis_of(found: InScenes) -> str:
    """What scores in recorded scenes rest on, in sentences."""
    human = found.driven[RECORDED_DRIVER]
    known = np.isfinite(human.speed[:, 0])
    scenes, seconds = np.unique(human.driver).size, known[:, 1:].sum()
    lasts = known.sum(axis=1) - 1
    horizons = ", ".join(map(str, found.yardstick.horizons_s))
    text = (
        f"Rests on {seconds:,} s of {counted(human.driver.size, 'recorded driver')} in "
        f"{counted(scenes, 'scene')} of {lasts.min()} to {lasts.max()} s.\n"
        f"closed loop: place and speed after {horizons} s.\n"
        "Not computed, because scenes are too short: gap and speed after 10, 20 and 30 s; lane "
        "changes, undone lane changes and collisions per km."
    )
    if "given_scene" not in found.yardstick.ceiling():
        text += (
            f"\ngiven scene and total: not computed, because no stratum of speed, time gap and "
            f"closing speed has {SMALLEST_STRATUM_S} s in each half of the scenes."
        )
    return "\n".join([text, *(f"Left out: {each}" for each in found.left_out)])


def controls_table(controls: Sequence[Likeness]) -> Table:
    """The scores of the calibrated driver, and the differences of the other drivers from it."""
    records = [
        {"driver": each.label} | _shown(each.scores if k == 0 else each.differences or {})
        for k, each in enumerate(controls)
    ]
    return Table.plain(records, ("driver",), dict.fromkeys(_SCORES.values(), ""))


def _shown(scores: Mapping[str, Score]) -> dict[str, str]:
    return {
        title: f"{scores[name].value:z.2f} [{scores[name].low:z.2f}, {scores[name].high:z.2f}]"
        if name in scores
        else ""
        for name, title in _SCORES.items()
    }

"""What a folder of recordings holds, and what installed samplers can learn from it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import polars as pl

from charms_bench.errors import DataError
from charms_bench.humans.following_samples import DECISION_HZ
from charms_bench.humans.situations import situations
from charms_bench.world.recording_folder import find_trios, read_recording
from charms_bench.world.scene import Observations
from charms_bench.world.trajectories import LANE_WIDTH_M, Recording

OFF_CENTRE_M = 0.25
"""If drivers are further than this from their lanes' centres on average, the markings are wrong."""
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True)
class Learnable:
    """What a sampler can learn from recordings; counts are of drivers at decisions."""

    accepted: int
    rejected: dict[str, int]
    """Decisions that cannot be learnt from, by reason."""
    two_actions: float
    """Proportion of the accepted decisions whose label gives two actions a probability."""
    label_shares: dict[str, dict[str, float]]
    """Proportion of each action in the labels of all `accepted` decisions and of the `sampled`
    ones."""
    training: int
    """Samples to train on."""
    held_out: int
    """Samples to measure on."""
    fingerprint: str
    """Hash of everything that the samples depend on."""


class Sampler(Protocol):
    """Samples human decisions; made by an entry point of the group `charms_bench.samplers`."""

    def add(self, recording: Recording, rows: pl.DataFrame, observations: Observations) -> None:
        """Takes the decisions of a recording, as `situations` returns them."""

    def learnable(self) -> Learnable:
        """What can be learnt from the recordings that were added."""


@dataclass(frozen=True)
class Survey:
    """What a folder of recordings holds."""

    recordings: pl.DataFrame
    """One row per recording: frame_rate_hz, duration_s, rows, cars, trucks, lanes (one number per
    carriageway with traffic), lane_changes, lane_id_disagreements."""
    decisions: pl.DataFrame
    """One row per vehicle and decision: speed (m/s), offset (position to the right of the lane's
    centre, m), leader_distance (centre to centre, m; null without a leader within 50 m)."""

    def facts(self) -> dict[str, Any]:
        """The numbers, ready for JSON.

        Units are SI; quantities of vehicles are taken at each decision, 3 times a second.

        carriageways: The number of carriageways, by their number of lanes.
        offset_mean_m: If it is far from 0, the lane markings are not where drivers see them.
        following_distance_m: Quantiles of the distance to a leader within 50 m.
        """
        recordings, decisions = self.recordings, self.decisions
        lanes = recordings["lanes"].explode().value_counts().sort("lanes")
        return {
            "recordings": recordings.height,
            "frame_rates_hz": recordings["frame_rate_hz"].unique().sort().to_list(),
            "recorded_h": float(recordings["duration_s"].sum()) / 3600,
            **{name: recordings[name].sum() for name in ("rows", "cars", "trucks")},
            "carriageways": {str(count): number for count, number in lanes.iter_rows()},
            **{name: recordings[name].sum() for name in ("lane_changes", "lane_id_disagreements")},
            "decisions": decisions.height,
            "speed_mean_mps": decisions["speed"].mean(),
            "speed_quantiles_mps": _quantiles(decisions["speed"]),
            "offset_mean_m": decisions["offset"].mean(),
            "following_distance_m": _quantiles(decisions["leader_distance"].drop_nulls()),
        }


def survey(
    folder: Path,
    samplers: Mapping[str, Sampler],
    tell: Callable[[int], object] = lambda recordings: None,
    note: Callable[[str], object] = lambda problem: None,
) -> tuple[Survey, dict[str, Learnable]]:
    """The survey of a folder, and what each sampler can learn from it.

    `note` is called with the reason why a sampler can learn nothing.

    Only one recording is in memory at a time; `tell` is called with 1 after each. Raises a
    `DataError` if the recordings cannot be used.
    """
    recordings, decisions = [], []
    for trio in find_trios(folder):
        recording = read_recording(trio)
        rows, observations = situations(recording, DECISION_HZ)
        for sampler in samplers.values():
            sampler.add(recording, rows, observations)
        recordings.append(_row(recording))
        offset = pl.col("y") - LANE_WIDTH_M * pl.col("lane")
        decisions.append(rows.select("speed", offset.alias("offset"), "leader_distance"))
        tell(1)
    found = Survey(pl.DataFrame(recordings), pl.concat(decisions))
    learnable = {}
    for name, sampler in samplers.items():
        try:
            learnable[name] = sampler.learnable()
        except DataError as error:
            note(f"{name}: {str(error).removeprefix(f'{folder}: ')}")
    return found, learnable


def _row(recording: Recording) -> dict[str, object]:
    tracks = recording.tracks
    frames = tracks["frame"].to_numpy()
    cars = tracks.unique("vehicle")["car"]
    return {
        "frame_rate_hz": recording.frame_rate_hz,
        "duration_s": float(frames.max() - frames.min() + 1) / recording.frame_rate_hz,
        "rows": tracks.height,
        "cars": cars.sum(),
        "trucks": (~cars).sum(),
        "lanes": list(recording.lanes.values()),
        "lane_changes": recording.lane_changes.height,
        "lane_id_disagreements": recording.lane_id_disagreements,
    }


def _quantiles(values: pl.Series) -> dict[str, float | None]:
    return {f"{q:g}": values.quantile(q, "linear") for q in QUANTILES}

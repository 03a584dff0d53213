"""What a folder of recordings holds, in numbers."""

from typing import Any

import numpy as np
import polars as pl

from charms_bench.people.samples import REASONS, Collected
from charms_bench.world.actions import ACTIONS

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def survey(collected: Collected) -> dict[str, Any]:
    """What was found, ready for JSON; SI units, every vehicle at the decision rate.

    carriageways: How many carriageways have how many lanes.
    offset_mean_m: Mean position right of the lane's centre. Far from 0, the markings are not where
        drivers see them, and drifts away from the centre lean to one side.
    following_distance_m: Quantiles of the distance to a leader within 50 m, centre to centre.
    label_shares: Share of each action in the labels, before and after undersampling.
    two_intents: Share of rows, before undersampling, with a lane change and a change of speed.
    """
    recordings, decisions = collected.recordings, collected.decisions
    lanes = recordings["lanes"].explode().value_counts().sort("lanes")
    accepted = decisions.filter(pl.col("rejected").is_null())
    reasons = decisions["rejected"].cast(pl.String)
    held_out = collected.samples.held_out
    return {
        "recordings": recordings.height,
        "frame_rates_hz": recordings["frame_rate_hz"].unique().sort().to_list(),
        "recorded_h": float(recordings["duration_s"].sum()) / 3600,
        "rows": recordings["rows"].sum(),
        "cars": recordings["cars"].sum(),
        "trucks": recordings["trucks"].sum(),
        "carriageways": {str(count): number for count, number in lanes.iter_rows()},
        "lane_changes": recordings["lane_changes"].sum(),
        "lane_id_disagreements": recordings["lane_id_disagreements"].sum(),
        "decisions": decisions.height,
        "speed_mean_mps": decisions["speed"].mean(),
        "speed_quantiles_mps": _quantiles(decisions["speed"]),
        "offset_mean_m": decisions["offset"].mean(),
        "following_distance_m": _quantiles(decisions["leader_distance"].drop_nulls()),
        "rejected": {reason: int((reasons == reason).sum()) for reason in REASONS},
        "accepted": accepted.height,
        "two_intents": float(
            ((accepted["longitudinal"] != 0) & (accepted["lateral"] != 0)).to_numpy().mean()
        ),
        "label_shares": {
            "accepted": _shares(accepted["label"].to_numpy()),
            "sampled": _shares(collected.samples.labels),
        },
        "sampled": {"training": int((~held_out).sum()), "held_out": int(held_out.sum())},
        "fingerprint": collected.samples.fingerprint,
    }


def _quantiles(values: pl.Series) -> dict[str, float | None]:
    return {f"{q:g}": values.quantile(q, "linear") for q in QUANTILES}


def _shares(labels: np.ndarray[Any, Any]) -> dict[str, float]:
    return dict(zip(ACTIONS, labels.mean(axis=0, dtype=np.float64).tolist(), strict=True))

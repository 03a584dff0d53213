"""What a folder of recordings holds, in numbers and as a figure."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from charms_bench.agent import ACTIONS
from charms_bench.figures import BLUE, GREY, panels, save
from charms_bench.following import FOLLOWING_RANGE_M
from charms_bench.human.samples import REASONS, Collected

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


def draw(collected: Collected, path: Path) -> None:
    """Draws speeds, distances while following, and the labels' shares.

    Raises:
        InputError: The file's ending is not a format's, or it cannot be written.
    """
    found = survey(collected)
    figure, (speeds, distances, labels) = panels(3, 3.7, 3.6)
    speed = collected.decisions["speed"].to_numpy()
    speeds.hist(speed, bins=np.arange(np.floor(speed.min()), speed.max() + 1), color=BLUE)
    speeds.axvline(found["speed_mean_mps"], color="black", linewidth=1)
    speeds.set(
        title=f"Speed, mean {found['speed_mean_mps']:.1f} m/s",
        xlabel="m/s",
        ylabel="vehicles at a decision",
    )
    following = collected.decisions["leader_distance"].drop_nulls().to_numpy()
    distances.hist(following, bins=40, range=(0, FOLLOWING_RANGE_M), color=BLUE)
    distances.set(
        title="Headway while following",
        xlabel=f"m to a leader within {FOLLOWING_RANGE_M:g} m, centre to centre",
    )
    before, after = found["label_shares"].values()
    places = np.arange(len(ACTIONS))
    labels.barh(places - 0.2, before.values(), 0.38, color=GREY, label="all rows")
    labels.barh(places + 0.2, after.values(), 0.38, color=BLUE, label="IDLE undersampled")
    labels.set_yticks(places, [action.replace("_", " ").lower() for action in ACTIONS])
    labels.invert_yaxis()
    labels.xaxis.set_major_formatter(lambda share, _: f"{share:.0%}")
    labels.set(title="Labels")
    labels.legend(frameon=False, fontsize=9)
    save(figure, path)

"""Makes the references of human driving in the package: `python tools/make_references.py DATA`.

DATA is a folder that holds `us101_corrected/`, `us101_highd_format/`, `i24_car_following.parquet`
and `i75_lane_trajectories.parquet`.
"""

import sys
from pathlib import Path

import polars as pl

from charms_bench.humans.following_samples import DECISION_HZ
from charms_bench.humans.reference import (
    DHW,
    REFERENCES,
    SPEED,
    Reference,
    from_recordings,
    histograms,
)
from charms_bench.humans.situations import nearest_to_decisions
from charms_bench.world.following_bins import FOLLOWING_RANGE_M
from charms_bench.world.trajectories import STAY_S

RATE_HZ = 10
"""Frames per second of the recordings on I-24 and I-75."""
CAR_LENGTH_M = 5.0
I75_LANES = (1, 2)
I75_FRAMES_A_ROW = 3
I75_START_S = 2.0
"""Time from the start of a lane change until the vehicle is in the new lane."""


def us101(data: Path, folder: str, name: str, markings: str) -> Reference:
    """US-101: congested. `markings` says where the lanes' markings are in the folder."""
    return from_recordings(
        data / folder,
        name=name,
        origin="NGSIM US-101, Los Angeles, 15 June 2005, 07:50: congested, five lanes and an "
        "auxiliary lane; 32 scenes of 3 to 17 s, straightened and smoothed. Scenes overlap: a "
        "fifth of the rows, and some of the lane changes, are in more than one scene."
        f"{markings}",
        terms="U.S. Department of Transportation, Federal Highway Administration (FHWA): Next "
        "Generation Simulation (NGSIM), US-101; CC BY-SA",
    )


def i24(data: Path) -> Reference:
    """I-24: mostly free flow."""
    rows = pl.read_parquet(data / "i24_car_following.parquet")
    frame = (pl.col("t_s") * RATE_HZ).round().cast(pl.Int64)
    decided = nearest_to_decisions(rows.select(frame)["t_s"].to_numpy(), RATE_HZ / DECISION_HZ)
    follows = pl.col("gap_m").cast(pl.Float64) + CAR_LENGTH_M <= FOLLOWING_RANGE_M
    following = rows.filter(decided).filter(follows)
    speed = following["speed_mps"].to_numpy()
    return Reference(
        name="i24",
        origin="CIRCLES, I-24, Nashville: one instrumented car in 60 runs, mostly in free flow "
        f"({(speed < 15).mean():.0%} of the speeds are below 15 m/s). Its lanes are unknown.",
        terms="CIRCLES consortium, DOI 10.5281/zenodo.6366761",
        speed_is=f"{SPEED}; centres are assumed {CAR_LENGTH_M:g} m further apart than bumpers",
        dhw_is="not recorded",
        vehicles=1,
        lane_changes=None,
        unit="run",
        speed=histograms(speed, following["run"].to_numpy()),
        dhw=(),
    )


def i75(data: Path) -> Reference:
    """The fast lanes of I-75: free flow."""
    rows = pl.read_parquet(data / "i75_lane_trajectories.parquet").sort("vehicle", "frame")
    frame = (rows["frame"] - rows["frame"].min()) // I75_FRAMES_A_ROW
    decided = nearest_to_decisions(frame.to_numpy(), RATE_HZ / DECISION_HZ)
    fast, follows = pl.col("lane").is_in(I75_LANES), pl.col("dhw") <= FOLLOWING_RANGE_M
    following = rows.filter(decided).filter(fast, follows)
    changes = _i75_lane_changes(rows)
    behind = changes.filter(follows)
    return Reference(
        name="i75",
        origin="HIGH-SIM, I-75, Florida: 88 vehicles over 1 to 2 km. Only lanes 1 and 2 are used, "
        "which are in free flow. Not every vehicle was tracked, so a leader may have been nearer. "
        f"{behind.height} lane changes with a leader are too few for a distribution.",
        terms="FHWA: HIGH-SIM; CC BY-SA 4.0 according to its README, which links to CC BY-NC 4.0",
        speed_is=f"{SPEED}; in lanes 1 and 2",
        dhw_is=f"{DHW} from or to lanes 1 and 2; the recording has no lateral position, so the "
        f"start is taken as {I75_START_S:g} s before the vehicle is in the new lane",
        vehicles=rows.filter(fast)["vehicle"].n_unique(),
        lane_changes=changes.height,
        unit="vehicle",
        speed=histograms(following["v"].to_numpy(), following["vehicle"].to_numpy()),
        dhw=histograms(behind["dhw"].to_numpy(), behind["vehicle"].to_numpy()),
    )


def _i75_lane_changes(rows: pl.DataFrame) -> pl.DataFrame:
    """The vehicle and the headway, null without a leader, of lane changes from or to a fast lane.

    As in `Recording.lane_changes`, the vehicle stays in both lanes for `STAY_S`.
    """
    rows = rows.with_row_index("row").cast({"row": pl.Int64})
    after = pl.col("lane", "row").shift(-1).over("vehicle").name.prefix("next_")
    changes = (
        rows.group_by("vehicle", pl.col("lane").rle_id().alias("stay"))
        .agg(pl.len(), pl.first("lane", "row"))
        .filter(pl.col("len") >= STAY_S * RATE_HZ)
        .sort("row")
        .with_columns(after)
        .filter(pl.col("lane") != pl.col("next_lane"))
        .filter(pl.any_horizontal(pl.col("lane", "next_lane").is_in(I75_LANES)))
        .with_columns(row=pl.col("next_row") - round(I75_START_S * RATE_HZ))
    )
    return changes.join(rows, on=["vehicle", "row", "lane"]).select("vehicle", "dhw")


def main(data: Path, output: Path) -> None:
    """Writes all references into a folder."""
    output.mkdir(parents=True, exist_ok=True)
    of_drivers = " The lanes' markings are where the drivers' lanes are."
    made = (
        us101(data, "us101_highd_format", "us101", ""),
        us101(data, "us101_corrected", "us101_corrected", of_drivers),
        i24(data),
        i75(data),
    )
    for reference in made:
        path = output / f"{reference.name}.json"
        path.write_text(reference.to_json(), encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python tools/make_references.py DATA")
    main(Path(sys.argv[1]), REFERENCES)

"""A folder of recordings -> what a policy is fine-tuned on.

A row is a driver at a decision: the observation `neighbours` and the label of CHARMS eq. 9 and 10.
A row is rejected for the first of `REASONS` that holds. Of what is left, IDLE rows are drawn at
random until there are at most `idle_ratio` of them for each other row of their recording. Whole
recordings are held out, so that no driver is on both sides.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import polars as pl
from pydantic import Field

from charms_bench import __version__
from charms_bench.errors import DataError
from charms_bench.people.highd import LANE_WIDTH_M, Recording, Trio, find_trios, read_recording
from charms_bench.people.labels import Labels, lateral_intents, longitudinal_intents, soft_labels
from charms_bench.people.situations import LANES, situations
from charms_bench.world.fields import FrozenModel, NonNegative
from charms_bench.world.files import write_atomically
from charms_bench.world.scene import Bools, Observations

REASONS = (
    "truck",
    "carriageway of fewer than three lanes",
    "outside the lane markings",
    "drifts to a side without a lane",
    "neighbours may be beyond the recorded section",
    "too few neighbours",
)
"""Why a row is rejected, in the order in which they are asked."""

_SAMPLES = pl.Schema(
    {
        "recording": pl.Int64(),
        "direction": pl.Int8(),
        "vehicle": pl.Int64(),
        "frame": pl.Int64(),
        "held_out": pl.Boolean(),
        "observation": pl.Array(pl.Float32, 35),
        "label": pl.Array(pl.Float32, 5),
    }
)


class SampleSettings(FrozenModel):
    """What the samples depend on besides the recordings."""

    decision_hz: Annotated[int, Field(ge=1, le=1000)] = 3
    cars_only: bool = True
    min_neighbours: Annotated[int, Field(ge=0, le=6)] = 1
    """A row with fewer vehicles in its observation is rejected."""
    idle_ratio: NonNegative = 0.25
    """IDLE rows for each other row, at most; 0.25 makes IDLE a fifth, one action of five."""
    held_out: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.2
    """Share of the recordings with samples, rounded; at least one unless it is 0 or the only."""
    seed: Annotated[int, Field(ge=0)] = 0


@dataclass(frozen=True)
class Samples:
    """M rows, by recording, direction, frame and position."""

    observations: Observations
    """(M, 7, 5) the observation `neighbours`."""
    labels: Labels
    """(M, 5) probabilities of the actions."""
    held_out: Bools
    """(M,) whether the row's recording is kept from training."""
    rows: pl.DataFrame
    """Where each row is from: recording, direction, vehicle, frame."""
    fingerprint: str
    """SHA-256 of the recordings, the settings and this project's version."""


@dataclass(frozen=True)
class Collected:
    """Samples, and all there was to take them from."""

    samples: Samples
    recordings: pl.DataFrame
    """A row a recording: recording, frame_rate_hz, duration_s, rows, cars, trucks, lanes (of each
    carriageway driven on), lane_changes, lane_id_disagreements."""
    decisions: pl.DataFrame
    """A row a vehicle and decision: recording, direction, vehicle, frame, lane, offset (y from the
    lane's centre), speed, leader_distance (null beyond 50 m), rejected (a reason or null),
    longitudinal, lateral (the intents), sampled, label (null where rejected)."""


def load_samples(folder: Path, cache: Path, settings: SampleSettings | None = None) -> Samples:
    """The samples of a folder of recordings, kept in `cache` as `samples-FINGERPRINT.parquet`.

    Raises:
        DataError: The recordings, or the file in the cache, cannot be used.
        RunFolderError: The cache cannot be written to.
    """
    settings = settings or SampleSettings()
    key = fingerprint(find_trios(folder), settings)
    path = cache / f"samples-{key[:16]}.parquet"
    if not path.exists():
        table = _table(collect(folder, settings).samples)
        write_atomically(path, table.write_parquet)
    try:
        table = pl.read_parquet(path, glob=False)
        if table.schema != _SAMPLES:
            raise DataError(f"{path}: holds other columns; delete it and try again")
        return _from_table(table, key)
    except (OSError, pl.exceptions.PolarsError) as error:
        reason = str(error).partition("\n")[0]
        raise DataError(f"{path}: cannot be read: {reason}; delete it and try again") from error


def fingerprint(trios: Sequence[Trio], settings: SampleSettings) -> str:
    """SHA-256 of everything the samples depend on.

    Raises:
        DataError: A file cannot be read.
    """
    digest = hashlib.sha256(f"{__version__} {settings.model_dump_json()}".encode())
    for trio in trios:
        for path in trio.paths:
            try:
                with path.open("rb") as file:
                    content = hashlib.file_digest(file, "sha256").hexdigest()
            except OSError as error:
                raise DataError(f"{path}: cannot be read: {error.strerror}") from error
            digest.update(f" {trio.number} {content}".encode())
    return digest.hexdigest()


def collect(
    folder: Path,
    settings: SampleSettings | None = None,
    tell: Callable[[int], object] = lambda recordings: None,
) -> Collected:
    """The samples of a folder of recordings; one recording is in memory at a time.

    The means that normalise magnitudes are taken over all rows that are not rejected.

    Raises:
        DataError: The recordings cannot be used, or nothing is left of them.
    """
    settings = settings or SampleSettings()
    trios = find_trios(folder)
    recordings, decisions, observed = [], [], []
    for trio in trios:
        recording = read_recording(trio)
        rows, observations = situations(recording, settings.decision_hz)
        rows = _judged(rows, observations, settings)
        sampled = _undersampled(rows, np.random.default_rng([settings.seed, trio.number]), settings)
        recordings.append(_facts(recording))
        decisions.append(
            rows.select(
                pl.lit(trio.number, dtype=pl.Int64).alias("recording"),
                *("direction", "vehicle", "frame", "lane", "offset", "speed", "leader_distance"),
                *("rejected", "longitudinal", "lateral", "acceleration", "lateral_speed"),
                pl.Series("sampled", sampled),
            )
        )
        observed.append(observations[sampled])
        tell(1)
    table = _labelled(pl.concat(decisions))
    chosen = table.filter("sampled")
    if chosen.is_empty():
        counts = table["rejected"].drop_nulls().value_counts(sort=True).rows()
        found = ", ".join(f"{reason} {count:,}" for reason, count in counts) or "none"
        raise DataError(f"{folder}: no row to learn from; rejected: {found}")
    samples = Samples(
        observations=np.concatenate(observed),
        labels=chosen["label"].to_numpy(),
        held_out=_held_out(chosen["recording"], settings),
        rows=chosen.select("recording", "direction", "vehicle", "frame"),
        fingerprint=fingerprint(trios, settings),
    )
    return Collected(samples, pl.DataFrame(recordings), table)


def _judged(
    rows: pl.DataFrame, observations: Observations, settings: SampleSettings
) -> pl.DataFrame:
    """The rows with their intents and, where they are rejected, why."""
    lane = rows["lane"].to_numpy()
    offset = rows["y"].to_numpy() - LANE_WIDTH_M * lane
    lateral = lateral_intents(rows["lateral_speed"].to_numpy(), offset)
    aimed_at = lane + lateral
    holds = (
        ~rows["car"].to_numpy() & settings.cars_only,
        rows["lanes"].to_numpy() < LANES,
        ~rows["on_road"].to_numpy(),
        (aimed_at < 0) | (aimed_at >= rows["lanes"].to_numpy()),
        rows["view_cut"].to_numpy(),
        observations[:, 1:, 0].sum(axis=1) < settings.min_neighbours,
    )
    rejected = np.select(holds, range(len(REASONS)), -1)
    names = np.array([*REASONS, None], dtype=object)[rejected]
    return rows.with_columns(
        offset=offset,
        longitudinal=longitudinal_intents(rows["acceleration"].to_numpy()),
        lateral=lateral,
        rejected=pl.Series(names, dtype=pl.Enum(REASONS)),
    )


def _undersampled(rows: pl.DataFrame, rng: np.random.Generator, settings: SampleSettings) -> Bools:
    """Which rows are taken: all that are not rejected, but not all of IDLE."""
    accepted = rows["rejected"].is_null().to_numpy()
    idle = accepted & ((rows["longitudinal"] == 0) & (rows["lateral"] == 0)).to_numpy()
    sampled = accepted & ~idle
    places = np.flatnonzero(idle)
    wanted = min(places.size, int(settings.idle_ratio * sampled.sum()))
    sampled[rng.choice(places, wanted, replace=False)] = True
    return np.asarray(sampled)


def _facts(recording: Recording) -> dict[str, object]:
    tracks = recording.tracks
    frames = tracks["frame"].to_numpy()
    cars = tracks.unique("vehicle")["car"]
    return {
        "recording": recording.trio.number,
        "frame_rate_hz": recording.frame_rate_hz,
        "duration_s": float(frames.max() - frames.min() + 1) / recording.frame_rate_hz,
        "rows": tracks.height,
        "cars": cars.sum(),
        "trucks": (~cars).sum(),
        "lanes": list(recording.lanes.values()),
        "lane_changes": recording.lane_changes.height,
        "lane_id_disagreements": recording.lane_id_disagreements,
    }


def _labelled(decisions: pl.DataFrame) -> pl.DataFrame:
    accepted = decisions["rejected"].is_null()
    rows = decisions.filter(accepted)
    acceleration = rows["acceleration"].to_numpy()
    lateral_speed = rows["lateral_speed"].to_numpy()
    labels = np.zeros((decisions.height, 5), dtype=np.float32)
    labels[accepted.to_numpy()] = soft_labels(
        rows["longitudinal"].to_numpy(), rows["lateral"].to_numpy(), acceleration, lateral_speed
    )
    return decisions.drop("acceleration", "lateral_speed").with_columns(
        label=pl.when(accepted).then(pl.Series(labels, dtype=_SAMPLES["label"]))
    )


def _held_out(recording: pl.Series, settings: SampleSettings) -> Bools:
    numbers = recording.unique().sort().to_numpy()
    wanted = round(settings.held_out * numbers.size)
    if settings.held_out > 0:
        wanted = min(max(wanted, 1), numbers.size - 1)
    drawn = np.random.default_rng(settings.seed).permutation(numbers)[:wanted]
    return np.isin(recording.to_numpy(), drawn)


def _table(samples: Samples) -> pl.DataFrame:
    flat = samples.observations.reshape(len(samples.observations), -1)
    return samples.rows.with_columns(
        pl.Series("held_out", samples.held_out),
        pl.Series("observation", flat, dtype=_SAMPLES["observation"]),
        pl.Series("label", samples.labels, dtype=_SAMPLES["label"]),
    )


def _from_table(table: pl.DataFrame, key: str) -> Samples:
    return Samples(
        observations=table["observation"].to_numpy().reshape(-1, 7, 5),
        labels=table["label"].to_numpy(),
        held_out=table["held_out"].to_numpy(),
        rows=table.select("recording", "direction", "vehicle", "frame"),
        fingerprint=key,
    )

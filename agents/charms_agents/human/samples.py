"""Samples of human driving for fine-tuning a policy, from recordings in highD's format.

Each sample is one driver at one decision: the driver's observation and a soft label. A
decision is rejected for the first of `REASONS` that applies. Of the accepted decisions, IDLE ones
are drawn at random until their recording has at most `idle_ratio` of them for each other one.
Whole drivers are held out, with their samples of all recordings; see `drivers`.
"""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
import polars as pl
from pydantic import Field, model_validator

from charms_agents.human.drivers import drivers, moments
from charms_agents.human.manoeuvres import manoeuvres
from charms_agents.human.soft_labels import (
    Labels,
    brakings,
    lateral_intents,
    longitudinal_intents,
    soft_labels,
    step_labels,
)
from charms_bench.errors import DataError
from charms_bench.foundation.fields import UNLESS_EMPTY, FrozenModel, NonNegative, Positive
from charms_bench.foundation.files import read_limited, write_bytes
from charms_bench.humans.situations import LANES, situations
from charms_bench.humans.survey import Learnable
from charms_bench.world.action_texts import described_actions
from charms_bench.world.actions import DEFAULT_ACTIONS, MetaAction
from charms_bench.world.csv_table import ROW_LIMIT, SIZE_LIMIT_BYTES
from charms_bench.world.observations import COMMANDS, Neighbours, neighbours
from charms_bench.world.recording_folder import find_trios, read_folder
from charms_bench.world.scene import Bools, Observations, SceneSettings
from charms_bench.world.trajectories import LANE_WIDTH_M, Recording, Trio

REASONS = (
    "truck",
    "carriageway of fewer than three lanes",
    "outside the lane markings",
    "drifts to a side without a lane",
    "neighbours may be beyond the recorded section",
    "too few neighbours",
    "already in an earlier recording",
)
"""Why a decision is rejected, in the order in which the reasons are checked."""

_REVISION = 2
"""Grows when the same recordings and settings give other samples."""
_SOURCE = ("recording", "direction", "vehicle", "frame", "driver")
_DRIVER = {
    "recording": pl.Int64(),
    "direction": pl.Int8(),
    "vehicle": pl.Int64(),
    "frame": pl.Int64(),
    "driver": pl.Int64(),
    "held_out": pl.Boolean(),
}


class Interface(NamedTuple):
    """What labels are probabilities of."""

    actions: tuple[MetaAction, ...] = DEFAULT_ACTIONS
    scene: SceneSettings = SceneSettings()
    """Where they are carried out; decides how hard an action brakes that sets the target speed."""

    @property
    def label(self) -> pl.Array:
        """The type of labels."""
        return pl.Array(pl.Float32, len(self.actions))


DEFAULT_INTERFACE = Interface()


class SampleSettings(FrozenModel):
    """How samples are taken from recordings; those of the paper's labels keep their fingerprint."""

    labels: Annotated[
        Literal["moment", "manoeuvre"], Field(exclude_if=lambda labels: labels == "moment")
    ] = "moment"
    """What labels follow from: the acceleration and the drift at the moment of a decision, as in
    the paper, or what the driver goes on to do; see `manoeuvres`."""
    step_mps: Annotated[Positive | None, UNLESS_EMPTY] = None
    """If given, with `labels: manoeuvre`, FASTER and SLOWER have the probability with which steps
    of this size, one per decision at most, give the driver's mean acceleration. Without it, as in
    the paper, they are certain above 0.2 m/s2; a policy that follows such labels
    accelerates far more than human drivers."""
    decision_hz: Annotated[int, Field(ge=1, le=1000)] = 3
    cars_only: bool = True
    min_neighbours: Annotated[int, Field(ge=0, le=6)] = 1
    """A decision with fewer vehicles in its observation is rejected."""
    idle_ratio: NonNegative = 0.25
    """IDLE samples for each other sample, at most; 0.25 makes IDLE a fifth, one action of five."""
    held_out: Annotated[float, Field(ge=0, lt=1, allow_inf_nan=False)] = 0.2
    """Proportion of the drivers to hold out, rounded to whole drivers; at least one, unless it is 0
    or there is only one driver."""
    seed: Annotated[int, Field(ge=0)] = 0

    @model_validator(mode="after")
    def _steps_have_manoeuvres(self) -> "SampleSettings":
        if self.step_mps is not None and self.labels != "manoeuvre":
            raise ValueError("step_mps is for labels: manoeuvre")
        return self


@dataclass(frozen=True)
class Samples:
    """M samples, sorted by recording, direction, frame and position."""

    observations: Observations
    """(M, 7, 5)"""
    labels: Labels
    """(M, A) probabilities of the actions."""
    held_out: Bools
    """(M,) whether the sample is kept from training."""
    rows: pl.DataFrame
    """Where each sample comes from: recording, direction, vehicle, frame, driver."""


@dataclass(frozen=True)
class SampleStore:
    """The samples of a folder of recordings, in `cache/samples-FINGERPRINT.parquet`."""

    recordings: Path
    cache: Path
    settings: SampleSettings
    observation: Neighbours = neighbours
    interface: Interface = DEFAULT_INTERFACE

    @cached_property
    def fingerprint(self) -> str:
        """Hash of the recordings, the settings and this project's version; see `fingerprint`."""
        trios = find_trios(self.recordings)
        return fingerprint(trios, self.settings, self.observation, self.interface)

    @property
    def path(self) -> Path:
        """The Parquet file."""
        return self.cache / f"samples-{self.fingerprint[:16]}.parquet"

    def load(self) -> Samples:
        """Reads the samples, and first collects them if the file does not exist.

        Raises:
            DataError: The recordings or the Parquet file cannot be used.
            RunFolderError: The Parquet file cannot be written.
        """
        path, observed = self.path, pl.Array(pl.Float32, math.prod(self.observation.shape))
        types = {"observation": observed, "label": self.interface.label}
        if not path.exists():
            samples = collect(self.recordings, self.settings, self.observation, self.interface)
            flat, written = samples.observations.reshape(len(samples.labels), -1), BytesIO()
            samples.rows.with_columns(
                pl.Series("held_out", samples.held_out),
                pl.Series("observation", flat, dtype=types["observation"]),
                pl.Series("label", samples.labels, dtype=types["label"]),
            ).write_parquet(written)
            write_bytes(path, written.getvalue())
        try:
            content = BytesIO(read_limited(path, SIZE_LIMIT_BYTES))
            table = pl.scan_parquet(content).head(ROW_LIMIT + 1).collect()
            if table.schema != pl.Schema({**_DRIVER, **types}) or table.height > ROW_LIMIT:
                raise DataError(
                    f"{path}: holds other columns or too many rows; delete it and try again"
                )
            return Samples(
                observations=table["observation"].to_numpy().reshape(-1, *self.observation.shape),
                labels=table["label"].to_numpy(),
                held_out=table["held_out"].to_numpy(),
                rows=table.select(_SOURCE),
            )
        except (OSError, pl.exceptions.PolarsError) as error:
            reason = str(error).partition("\n")[0]
            raise DataError(f"{path}: cannot be read: {reason}; delete it and try again") from error


def fingerprint(
    trios: Sequence[Trio],
    settings: SampleSettings,
    observation: Neighbours = neighbours,
    interface: Interface = DEFAULT_INTERFACE,
) -> str:
    """SHA-256 of everything that the samples depend on; raises a `DataError`."""
    told = f"{version('charms-bench')} {_REVISION} {settings.model_dump_json()}"
    if observation != neighbours:
        told += f" {observation.name}"
    if interface.actions != DEFAULT_ACTIONS:
        braking = brakings(*interface, settings.decision_hz)
        told += f" {described_actions(interface.actions)} {braking}"
    digest = hashlib.sha256(told.encode())
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
    observation: Neighbours = neighbours,
    interface: Interface = DEFAULT_INTERFACE,
) -> Samples:
    """The samples of a folder of recordings, of which one is in memory; raises a `DataError`."""
    sampler = CharmsSampler(settings, interface)
    for recording in read_folder(folder):
        sampler.add(recording, *situations(recording, sampler.settings.decision_hz, observation))
    return sampler.samples(sampler.decisions())


class CharmsSampler:
    """Takes samples from recordings, one after another; by default as `charms-bench data` does."""

    def __init__(
        self, settings: SampleSettings | None = None, interface: Interface = DEFAULT_INTERFACE
    ) -> None:
        self.settings, self._interface = settings or SampleSettings(), interface
        self._trios: list[Trio] = []
        self._decisions: list[pl.DataFrame] = []
        self._observations: list[Observations] = []
        self._vehicles: list[pl.DataFrame] = []
        self._taken = pl.Series(dtype=pl.UInt64)

    def add(self, recording: Recording, rows: pl.DataFrame, observations: Observations) -> None:
        """Takes the decisions of a recording and what the drivers saw (M, 7, 5)."""
        trio = recording.trio
        number = pl.lit(trio.number, dtype=pl.Int64).alias("recording")
        tracks, moment = recording.tracks, moments(recording, recording.tracks)
        self._vehicles.append(tracks.select(number, "vehicle", moment))
        moment = moments(recording, rows)
        repeated = moment.is_in(self._taken.implode()).fill_null(False).to_numpy()
        if self.settings.labels == "manoeuvre":
            place = ["direction", "vehicle", "frame"]
            rows = rows.join(manoeuvres(recording), on=place, how="left", maintain_order="left")
            rows = rows.with_columns(acceleration="mean_acceleration")
        rows = _judged(rows, observations, repeated, self.settings)
        self._taken.append(moment.filter(rows["rejected"].is_null()).drop_nulls())
        rng = np.random.default_rng([self.settings.seed, trio.number])
        sampled = _undersampled(rows, rng, self.settings)
        self._trios.append(trio)
        self._observations.append(observations[sampled])
        self._decisions.append(
            rows.select(
                number,
                *("direction", "vehicle", "frame", "rejected", "longitudinal", "lateral"),
                *("acceleration", "lateral_speed"),
                pl.Series("sampled", sampled),
            )
        )

    def decisions(self) -> pl.DataFrame:
        """All decisions, one row per driver and decision.

        Columns recording, direction, vehicle, frame, driver, rejected (a reason or null),
        longitudinal and lateral (the intents), acceleration, lateral_speed, sampled, and label
        (null where rejected). Magnitudes are normalised by means over all accepted decisions.
        """
        decisions = pl.concat(self._decisions).join(
            drivers(self._vehicles), on=["recording", "vehicle"], how="left", maintain_order="left"
        )
        accepted = decisions["rejected"].is_null()
        rows = decisions.filter(accepted)
        actions = self._interface.actions
        labels = np.zeros((decisions.height, len(actions)), dtype=np.float32)
        if self.settings.step_mps is None:
            measured = ("longitudinal", "lateral", "acceleration", "lateral_speed")
            columns = {name: rows[name].to_numpy() for name in measured}
            found = soft_labels(**columns, actions=actions)
        else:
            strongest = self.settings.step_mps * self.settings.decision_hz
            lateral, acceleration = (rows[name].to_numpy() for name in ("lateral", "acceleration"))
            braking = brakings(*self._interface, self.settings.decision_hz)
            found = step_labels(lateral, acceleration, strongest, actions, braking)
        labels[accepted.to_numpy()] = found
        label = pl.Series(labels, dtype=self._interface.label)
        return decisions.with_columns(label=pl.when(accepted).then(label))

    def samples(self, decisions: pl.DataFrame) -> Samples:
        """The samples among what `decisions` returned; raises a `DataError` if there are none."""
        chosen = decisions.filter("sampled")
        if chosen.is_empty():
            counts = decisions["rejected"].drop_nulls().value_counts(sort=True).rows()
            found = ", ".join(f"{reason} {count:,}" for reason, count in counts) or "none"
            folder = self._trios[0].tracks.parent
            raise DataError(f"{folder}: no row to learn from; rejected: {found}")
        return Samples(
            observations=np.concatenate(self._observations),
            labels=chosen["label"].to_numpy(),
            held_out=_held_out(chosen["driver"], self.settings),
            rows=chosen.select(_SOURCE),
        )

    def learnable(self) -> Learnable:
        """What `charms-bench data` reports; raises a `DataError` if every decision is rejected."""
        decisions = self.decisions()
        samples = self.samples(decisions)
        accepted = decisions.filter(pl.col("rejected").is_null())
        reasons = decisions["rejected"].cast(pl.String)
        two_intents = (accepted["longitudinal"] != 0) & (accepted["lateral"] != 0)
        labelled = {"accepted": accepted["label"].to_numpy(), "sampled": samples.labels}
        held_out = int(samples.held_out.sum())
        names = [action.name for action in self._interface.actions]
        return Learnable(
            accepted=accepted.height,
            rejected={reason: int((reasons == reason).sum()) for reason in REASONS},
            two_actions=float(two_intents.to_numpy().mean()),
            label_shares={
                name: dict(zip(names, labels.mean(0, np.float64).tolist(), strict=True))
                for name, labels in labelled.items()
            },
            training=len(samples.labels) - held_out,
            held_out=held_out,
            fingerprint=fingerprint(self._trios, self.settings, interface=self._interface),
        )


def manoeuvre_sampler() -> CharmsSampler:
    """Takes samples as `charms-bench data` does, labelled by what drivers go on to do."""
    return CharmsSampler(SampleSettings(labels="manoeuvre"))


def _judged(
    rows: pl.DataFrame, observations: Observations, repeated: Bools, settings: SampleSettings
) -> pl.DataFrame:
    """Adds the intents and, for a rejected decision, the reason."""
    lane = rows["lane"].to_numpy()
    offset = rows["y"].to_numpy() - LANE_WIDTH_M * lane
    if settings.labels == "manoeuvre":
        lateral = rows["movement"].to_numpy()
    else:
        lateral = lateral_intents(rows["lateral_speed"].to_numpy(), offset)
    aimed_at = lane + lateral
    applies = (
        ~rows["car"].to_numpy() & settings.cars_only,
        rows["lanes"].to_numpy() < LANES,
        ~rows["on_road"].to_numpy(),
        (aimed_at < 0) | (aimed_at >= rows["lanes"].to_numpy()),
        rows["view_cut"].to_numpy(),
        observations[:, 1:COMMANDS, 0].sum(axis=1) < settings.min_neighbours,
        repeated,
    )
    rejected = np.select(applies, range(len(REASONS)), -1)
    names = np.array([*REASONS, None], dtype=object)[rejected]
    return rows.with_columns(
        longitudinal=longitudinal_intents(rows["acceleration"].to_numpy()),
        lateral=lateral,
        rejected=pl.Series(names, dtype=pl.Enum(REASONS)),
    )


def _undersampled(rows: pl.DataFrame, rng: np.random.Generator, settings: SampleSettings) -> Bools:
    """Which decisions become samples: all accepted ones, except most IDLE ones."""
    accepted = rows["rejected"].is_null().to_numpy()
    idle = accepted & ((rows["longitudinal"] == 0) & (rows["lateral"] == 0)).to_numpy()
    sampled = accepted & ~idle
    places = np.flatnonzero(idle)
    wanted = min(places.size, int(settings.idle_ratio * sampled.sum()))
    sampled[rng.choice(places, wanted, replace=False)] = True
    return np.asarray(sampled)


def _held_out(driver: pl.Series, settings: SampleSettings) -> Bools:
    numbers = driver.unique().sort().to_numpy()
    wanted = round(settings.held_out * numbers.size)
    if settings.held_out > 0:
        wanted = min(max(wanted, 1), numbers.size - 1)
    drawn = np.random.default_rng(settings.seed).permutation(numbers)[:wanted]
    return np.isin(driver.to_numpy(), drawn)

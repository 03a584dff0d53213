"""Moments of recordings at which episodes start, and the tracks of the vehicles around the ego.

A moment is a recorded vehicle, which becomes the ego, and a frame. From this frame on, the vehicle
is recorded for at least an episode, is on the road and overlaps no other vehicle; at this frame, no
two vehicles of its carriageway overlap. The episodes of one vehicle do not overlap in time.

Along the road, positions are the recorded ones from the rearmost position of the recording. Across
it, each lane is stretched from its width to the scene's lane width, which is the mean of the lanes.
"""

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, TypeAdapter, ValidationError, ValidationInfo
from pydantic_core import InitErrorDetails, PydanticCustomError

from charms_bench.errors import DataError
from charms_bench.foundation import maths
from charms_bench.foundation.arrays import Bools, Floats, Ints
from charms_bench.foundation.compiled import compiled
from charms_bench.foundation.files import absolute
from charms_bench.world.csv_table import header_of
from charms_bench.world.profile import PROFILES
from charms_bench.world.recording_folder import find_trios, read_recording
from charms_bench.world.recordings import Split
from charms_bench.world.scene import SceneSettings
from charms_bench.world.trajectories import LANE_WIDTH_M, Recording
from charms_bench.world.vehicle_types import LENGTHS_M, WIDTHS_M

TEST_PART = 0.2
STEADY_MPS = 5.0
"""A heading is that of the velocity, with at least this speed along the road: the lateral speed of
a slow vehicle is mostly noise."""
WIDTH_TOLERANCE = 0.15
"""Lanes may be wider or narrower than their mean by this proportion."""


class Tracks(NamedTuple):
    """V tracks with K rows. A vehicle that is not recorded for some frames has several tracks."""

    x: Floats
    """(K,) m, as all positions in the frame of the scene."""
    y: Floats
    heading: Floats
    speed: Floats
    """(K,) m/s, along the heading; its part along the road is the recorded speed."""
    row: Ints
    """(V,) the first row."""
    first: Ints
    """(V,) the first frame."""
    last: Ints
    """(V,) the last frame."""
    length: Floats
    width: Floats
    fastest: Floats
    """(V,) the highest speed of the track, m/s."""


@dataclass(frozen=True)
class Moments:
    """M moments, in the order of the episodes."""

    tracks: Tracks
    vehicles: Ints
    """[M, N] the tracks of the vehicles, -1 for none: the ego, then the others as they appear."""
    frame: Ints
    """(M,)"""
    rate_hz: Floats
    """(M,) frames per second."""
    names: tuple[str, ...]
    """M descriptions."""

    def __len__(self) -> int:
        return self.frame.size

    def numbers_of(self, seeds: NDArray[np.uint64]) -> Ints:
        """The numbers (R,) of the moments at which the episodes of seeds (R,) start."""
        return (seeds % np.uint64(len(self))).astype(np.int64)


def order_of(names: Sequence[str]) -> Ints:
    """The order of the episodes, in which neighbours are about as alike as any two."""
    return np.argsort([crc32(name.encode()) for name in names], kind="stable")


def in_order(
    tracks: Tracks, vehicles: Sequence[Ints], frames: Ints, rates_hz: Floats, names: Sequence[str]
) -> Moments:
    """Moments from the vehicles of each, its frame, its rate and its name, in their order."""
    table, order = np.full((len(names), max(map(len, vehicles))), -1), order_of(names)
    for row, each in zip(table, vehicles, strict=True):
        row[: each.size] = each
    of_names = tuple(names[k] for k in order)
    return Moments(tracks, table[order], frames[order], rates_hz[order], of_names)


class _Carriageway(NamedTuple):
    """One direction of a recording."""

    recording: Recording
    direction: int
    rows: Any
    """Its rows of `Recording.tracks`."""

    @property
    def lanes(self) -> int:
        return self.recording.lanes[self.direction]

    @property
    def widths_m(self) -> Floats:
        return self.recording.lane_widths_m[self.direction]

    def __str__(self) -> str:
        return f"recording {self.recording.trio.number}, direction {self.direction}"


def content_of(folder: Path) -> str:
    """The hash of the recordings of a folder. Raises a `DataError` if they cannot be read."""
    paths = [path for trio in find_trios(folder) for path in trio.paths]
    try:
        stamps = [path.stat() for path in paths]
        return _content(tuple(paths), tuple((each.st_size, each.st_mtime_ns) for each in stamps))
    except OSError as error:
        raise DataError(f"{folder}: cannot be read: {error.strerror}") from error


@lru_cache(maxsize=2)
def _content(paths: tuple[Path, ...], stamps: tuple[tuple[int, int], ...]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        header_of(path)
    for path in paths:
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()


@lru_cache(maxsize=1)
def _carriageways(folder: Path, content: str) -> tuple[_Carriageway, ...]:
    """The carriageways of a folder with this content."""
    found = []
    for trio in find_trios(folder):
        recording = read_recording(trio)
        for direction in recording.lanes:
            rows = recording.tracks.filter(direction=direction)
            found.append(_Carriageway(recording, direction, rows))
    return tuple(found)


def _as_recorded(settings: SceneSettings, info: ValidationInfo) -> SceneSettings:
    """The settings with what their recordings decide, if they have not been read before."""
    source = settings.recording
    if source is None or source.sha256:
        return settings
    given = {name: getattr(settings, name) for name in settings.model_fields_set}
    folder = absolute((info.context or {}).get("folder", Path()) / source.folder)
    given["recording"] = source.model_copy(update={"folder": folder})
    try:
        found = _decided(settings.model_copy(update=given))
    except DataError as error:
        kind = PydanticCustomError("recording", "{what}", {"what": str(error)})
        where = InitErrorDetails(type=kind, loc=("recording",), input=str(source.folder))
        raise ValidationError.from_exception_data("SceneSettings", [where]) from error
    return SceneSettings.model_validate(given | found)


RecordedScene = Annotated[SceneSettings, AfterValidator(_as_recorded)]
"""Settings with their recordings read, relative to the `folder` of the context."""
_RECORDED_SCENE: TypeAdapter[SceneSettings] = TypeAdapter(RecordedScene)


def scene_of(fields: Any) -> SceneSettings:
    """The settings of a scene from the keys of a suite's `scene`; its recordings are read.

    Raises:
        ValidationError: A key or a value is wrong, or recordings cannot be used.
    """
    return _RECORDED_SCENE.validate_python(fields)


def _decided(settings: SceneSettings) -> dict[str, Any]:
    """The fields of a scene that its recordings decide.

    Raises a `DataError` if they cannot be used, and a `ValueError` if the settings give such a
    field themselves.
    """
    source = settings.recording
    assert source is not None
    decided = ("traffic_vehicles", "ego_slots", "density", "vehicle_types", "ego_type", "inflow")
    for name in decided:
        if name in settings.model_fields_set:
            raise ValueError(f"{name}: the recordings decide this; remove it")
    known = PROFILES.get(settings.profile.name)
    if known is not None and settings.profile.lane_width_m != known.lane_width_m:
        raise ValueError("profile.lane_width_m: the recordings decide this; remove it")
    folder = source.folder
    content = content_of(folder)
    ways = _carriageways(folder, content)
    lanes = settings.lanes
    if "lanes" not in settings.model_fields_set:
        vehicles: Counter[int] = Counter()
        for way in ways:
            vehicles[way.lanes] += way.rows["vehicle"].n_unique()
        ((lanes, _),) = vehicles.most_common(1)
    widths = np.concatenate([each.widths_m for each in _with_lanes(folder, ways, lanes)])
    profile = settings.profile.model_copy(update={"lane_width_m": round(float(widths.mean()), 3)})
    found: dict[str, Any] = {
        "recording": source.model_copy(update={"sha256": content}),
        "lanes": lanes,
        "profile": profile,
        "ego_slots": 1,
    }
    moments = moments_of(settings.model_copy(update=found))
    return found | {"traffic_vehicles": moments.vehicles.shape[1] - 1}


def moments_of(settings: SceneSettings) -> Moments:
    """The moments of a scene's recordings, which are read once per process.

    Raises:
        DataError: The recordings cannot be read, have changed or have no such moment.
    """
    source, profile = settings.recording, settings.profile
    assert source is not None
    if not source.sha256:
        what = "have not been read; charms_bench.world.recorded_moments.scene_of reads them"
        raise DataError(f"{source.folder}: the recordings {what}")
    if content_of(source.folder) != source.sha256:
        raise DataError(
            f"{source.folder}: the recordings have changed since the settings were made; expected "
            f"files with the hash {source.sha256[:12]}"
        )
    return _moments(
        source.folder,
        source.sha256,
        settings.lanes,
        profile.lane_width_m,
        settings.decisions / settings.decision_hz,
        source.main_lanes,
        source.split,
        (profile.speed_min_mps, profile.speed_max_mps),
    )


def _with_lanes(folder: Path, ways: tuple[_Carriageway, ...], lanes: int) -> list[_Carriageway]:
    """The carriageways with `lanes` lanes, which are about equally wide."""
    found = [each for each in ways if each.lanes == lanes]
    if not found:
        counts = ", ".join(map(str, sorted({each.lanes for each in ways})))
        raise DataError(f"{folder}: no carriageway has {lanes} lanes; expected lanes: {counts}")
    mean = np.concatenate([each.widths_m for each in found]).mean()
    for each in found:
        if (abs(each.widths_m / mean - 1) > WIDTH_TOLERANCE).any():
            widths = ", ".join(f"{width:.2f}" for width in each.widths_m)
            raise DataError(
                f"{each.recording.trio.recording_meta}: line 2: lanes of {widths} m in direction "
                f"{each.direction}; expected at most {WIDTH_TOLERANCE:.0%} from the mean of the "
                f"folder, {mean:.2f} m, because the lanes of a scene are equally wide; remove this "
                "recording"
            )
    return found


@lru_cache(maxsize=2)
def _moments(
    folder: Path,
    content: str,
    lanes: int,
    lane_width_m: float,
    duration_s: float,
    main_lanes: int | None,
    split: Split | None,
    speeds_mps: tuple[float, float],
) -> Moments:
    ways = _with_lanes(folder, _carriageways(folder, content), lanes)
    parts, vehicles, frames, rates, names = [], [], [], [], []
    tracks_before = rows_before = 0
    tested = _places_tested(folder, ways, split)
    for way in ways:
        tracks, slope = _tracks_of(way, lane_width_m, speeds_mps)
        can_start, goes_on = _fitness(way, tracks, slope, main_lanes or lanes)
        rate = way.recording.frame_rate_hz
        span = int(np.ceil(duration_s * rate - 1e-9))
        number = way.rows["vehicle"].to_numpy()
        if split is not None:
            can_start &= _in_part(way, split, tested, span)
        for ego, frame in _starts(tracks, can_start, goes_on, span):
            is_here = (tracks.first <= frame + span) & (tracks.last >= frame)
            is_here[ego] = False
            others = np.nonzero(is_here)[0]
            appears = np.maximum(tracks.first[others], frame)
            others = others[np.argsort(appears, kind="stable")]
            vehicles.append(np.array([ego, *others]) + tracks_before)
            frames.append(frame)
            rates.append(rate)
            names.append(f"{way}, vehicle {number[tracks.row[ego]]}, frame {frame}")
        parts.append(tracks._replace(row=tracks.row + rows_before))
        tracks_before += tracks.row.size
        rows_before += tracks.x.size
    if not frames:
        part = f" in the {split.part} part by {split.by}" if split is not None else ""
        raise DataError(
            f"{folder}: no moment{part} is followed by {duration_s:g} s of a vehicle that is "
            f"recorded, on one of {lanes} lanes and free of others; give a shorter duration_s"
        )
    tracks = Tracks(*map(np.concatenate, zip(*parts, strict=True)))
    return in_order(tracks, vehicles, np.array(frames), np.array(rates), names)


def _tracks_of(
    way: _Carriageway, lane_width_m: float, speeds_mps: tuple[float, float]
) -> tuple[Tracks, Floats]:
    """The vehicles of a carriageway in a scene, and the tangents of their headings (K,)."""
    rows, path = way.rows, way.recording.trio.tracks
    vehicle, frame = rows["vehicle"].to_numpy(), rows["frame"].to_numpy()
    begins = (np.diff(vehicle, prepend=-1) != 0) | (np.diff(frame, prepend=-1) != 1)
    row = np.nonzero(begins)[0]
    last_row = np.append(row[1:], vehicle.size) - 1
    length, width = rows["length"].to_numpy()[row], rows["width"].to_numpy()[row]
    for name, found, (low, high) in (("width", length, LENGTHS_M), ("height", width, WIDTHS_M)):
        if (wrong := (found < low) | (found > high)).any():
            at = int(wrong.argmax())
            raise DataError(
                f"{path}: vehicle {vehicle[row[at]]}: {name} {found[at]:g} m; expected {low:g} to "
                f"{high:g} m in a scene"
            )
    along = rows["speed"].to_numpy()
    low, high = max(0.0, along.min()), along.max()
    if low < speeds_mps[0] or high > speeds_mps[1]:
        raise DataError(
            f"{path}: speeds from {low:.1f} to {high:.1f} m/s are outside the profile's, "
            f"{speeds_mps[0]:g} to {speeds_mps[1]:g} m/s; give another speed_min_mps or "
            "speed_max_mps in scene.profile"
        )
    lane = rows["lane"].to_numpy()
    aside = rows["lateral_speed"].to_numpy() * lane_width_m / way.widths_m[lane]
    slope = aside / np.maximum(along, STEADY_MPS)
    speed = along * np.sqrt(1 + slope**2)
    x = rows["x"].to_numpy()
    tracks = Tracks(
        x=x - x.min(),
        y=rows["y"].to_numpy() * (lane_width_m / LANE_WIDTH_M),
        heading=_arctangents(slope),
        speed=speed,
        row=row,
        first=frame[row],
        last=frame[last_row],
        length=length,
        width=width,
        fastest=np.maximum.reduceat(speed, row),
    )
    return tracks, slope


@compiled
def _arctangents(slopes: Floats) -> Floats:
    """Angles, rad, the same on every machine."""
    angles = np.empty(slopes.size)
    for k in range(slopes.size):
        angles[k] = maths.atan(slopes[k])
    return angles


def _fitness(
    way: _Carriageway, tracks: Tracks, slope: Floats, main_lanes: int
) -> tuple[Bools, Bools]:
    """Whether an ego can start in each row (K,), and drive on in it."""
    frame = way.rows["frame"].to_numpy()
    overlapping = _overlapping(tracks, np.abs(slope), frame)
    goes_on = way.rows["on_road"].to_numpy().copy()
    goes_on[overlapping] = False
    is_clear = ~np.isin(frame, frame[overlapping])
    return goes_on & is_clear & (way.rows["lane"].to_numpy() < main_lanes), goes_on


def _overlapping(tracks: Tracks, slope: Floats, frame: Ints) -> Ints:
    """The rows in which vehicles, turned to their headings, overlap another one of the frame.

    A turned vehicle counts as the smallest rectangle along the road that encloses it.
    """
    size = np.diff(np.append(tracks.row, frame.size))
    length, width = np.repeat(tracks.length, size), np.repeat(tracks.width, size)
    cosine = 1 / np.sqrt(1 + slope**2)
    along = (length + width * slope) * cosine / 2
    across = (width + length * slope) * cosine / 2
    order = np.lexsort((tracks.x, frame))
    reach = 2 * along.max(initial=0.0)
    found = [np.zeros(0, dtype=np.int64)]
    for shift in range(1, order.size):
        a, b = order[:-shift], order[shift:]
        is_near = (frame[a] == frame[b]) & (tracks.x[b] - tracks.x[a] < reach)
        if not is_near.any():
            break
        a, b = a[is_near], b[is_near]
        meets = tracks.x[b] - tracks.x[a] < along[a] + along[b]
        meets &= np.abs(tracks.y[b] - tracks.y[a]) < across[a] + across[b]
        found += [a[meets], b[meets]]
    return np.concatenate(found)


def _starts(
    tracks: Tracks, can_start: Bools, goes_on: Bools, span: int
) -> Iterator[tuple[int, int]]:
    """The egos and the frames at which episodes of `span` frames can start."""
    stops = np.concatenate([[0], np.cumsum(~goes_on)])
    for ego, (row, first, last) in enumerate(
        zip(tracks.row, tracks.first, tracks.last, strict=True)
    ):
        begins = row + np.arange(last - first - span + 1)
        usable = can_start[begins] & (stops[begins + span + 1] == stops[begins])
        frame = 0
        for start in np.nonzero(usable)[0]:
            if start >= frame:
                yield ego, int(first + start)
                frame = int(start) + span


def _places_tested(folder: Path, ways: list[_Carriageway], split: Split | None) -> list[str]:
    """The places of the test part of a split by place; raises a `DataError` without a split."""
    recordings = {each.recording.trio.number: each.recording for each in ways}
    if split is None:
        return []
    if split.by == "place":
        places = sorted({each.location for each in recordings.values()})
        if len(places) < 2:
            raise DataError(
                f"{folder}: all recordings have the locationId '{places[0]}'; a split by place "
                "needs two locations"
            )
        return places[-max(1, int(len(places) * TEST_PART)) :]
    numbers: dict[str, int] = {}
    for number, recording in recordings.items():
        if recording.occasion in numbers:
            raise DataError(
                f"{folder}: recordings {numbers[recording.occasion]} and {number} state the same "
                f"place and time ('{recording.occasion}'), so they may show the same drivers; a "
                f"split by {split.by} needs recordings of different times"
            )
        numbers[recording.occasion] = number
    return []


def _in_part(way: _Carriageway, split: Split, places: list[str], span: int) -> Bools:
    """Whether the episodes of `span` frames that start in each row (K,) belong to the part."""
    frame, vehicle = way.rows["frame"].to_numpy(), way.rows["vehicle"].to_numpy()
    if split.by == "time":
        every = way.recording.tracks["frame"].to_numpy()
        border = every.max() - TEST_PART * (every.max() - every.min())
        return np.asarray(frame > border if split.part == "test" else frame + span <= border)
    if split.by == "driver":
        names, which = np.unique(vehicle, return_inverse=True)
        number = way.recording.trio.number
        draws = np.array([crc32(f"{number} {name}".encode()) for name in names])
        is_tested = (draws % round(1 / TEST_PART) == 0)[which]
    else:
        is_tested = np.full(frame.size, way.recording.location in places)
    return np.asarray(is_tested == (split.part == "test"))

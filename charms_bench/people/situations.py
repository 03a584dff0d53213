"""A recording -> what each of its drivers saw at each decision.

The simulation has three lanes. A driver on a wider carriageway is given the three that hold his
own lane in the middle, or at the edge where his is the outermost: he has a lane on his left and
on his right exactly where the recorded driver had. A vehicle elsewhere is on no lane of his.
"""

import numpy as np
import polars as pl

from charms_bench.engine.following import FOLLOWING_RANGE_M
from charms_bench.engine.kernels import locate
from charms_bench.errors import DataError
from charms_bench.people.highd import LANE_WIDTH_M, Recording
from charms_bench.world.observations import RANGE_M, neighbours
from charms_bench.world.profile import CHARMS
from charms_bench.world.scene import Bools, Floats, Ints, Observations, Scene, SceneSettings

LANES = 3
"""Lanes of the simulation."""
VEHICLES_LIMIT = 501
"""Vehicles of a carriageway at one time, as many as a scene may have."""
_CHUNK = 200_000
"""Vehicles in memory as scenes at a time, so about 50 MB."""


def situations(recording: Recording, decision_hz: int) -> tuple[pl.DataFrame, Observations]:
    """The rows of a recording nearest in time to each decision, and their observations.

    Decision k is at k / `decision_hz` after the recording's first frame; a frame rate that is no
    multiple of the decision rate gives intervals that differ by a frame.

    Returns:
        Rows of `Recording.tracks` by direction, frame and x, with these columns, and observations
        (M, 7, 5), zeros where a carriageway has fewer than three lanes.

        lanes: Lanes of the carriageway.
        view_cut: Whether a row of the observation is empty that may only look so, because the
            recorded section ends within the observation's range.
        leader_distance: To the leader on the own lane within 50 m, centre to centre, m, or null.

    Raises:
        DataError: There are fewer frames than decisions, or too many vehicles at once.
    """
    rows = recording.tracks.filter(at_decisions(recording, decision_hz))
    rows = rows.sort("direction", "frame", "x", "vehicle")
    tables, observed = [], []
    for direction, lanes in recording.lanes.items():
        part = rows.filter(pl.col("direction") == direction)
        if lanes >= LANES:
            section = recording.tracks.filter(pl.col("direction") == direction)["x"].to_numpy()
            ends = float(section.min()), float(section.max())
            observations, distance, cut = _seen(recording, part, lanes, ends)
        else:
            observations = np.zeros((part.height, 7, 5), dtype=np.float32)
            distance, cut = np.full(part.height, np.nan), np.zeros(part.height, dtype=np.bool_)
        observed.append(observations)
        tables.append(
            part.with_columns(
                pl.lit(lanes).alias("lanes"),
                pl.Series("view_cut", cut),
                pl.Series("leader_distance", distance, nan_to_null=True),
            )
        )
    return pl.concat(tables), np.concatenate(observed)


def at_decisions(recording: Recording, decision_hz: int) -> Bools:
    """Which rows of a recording are nearest in time to a decision; see `situations`.

    Raises:
        DataError: There are fewer frames than decisions.
    """
    if recording.frame_rate_hz < decision_hz:
        raise DataError(
            f"{recording.trio.recording_meta}: line 2: column 'frameRate': "
            f"{recording.frame_rate_hz:g} Hz; expected at least the {decision_hz} Hz of decisions"
        )
    frame = recording.tracks["frame"].to_numpy()
    return nearest_to_decisions(frame - frame.min(), recording.frame_rate_hz / decision_hz)


def nearest_to_decisions(frame: Ints, frames_a_decision: float) -> Bools:
    """Whether each frame, counted from 0, is the one nearest to a decision."""
    decision = np.rint(frame / frames_a_decision)
    return np.asarray(np.floor(decision * frames_a_decision + 0.5) == frame)


def _seen(
    recording: Recording, rows: pl.DataFrame, lanes: int, section: tuple[float, float]
) -> tuple[Observations, Floats, Bools]:
    """Observations, distances to leaders (nan for none) and `view_cut` of a carriageway's rows."""
    starts = np.flatnonzero(np.diff(rows["frame"].to_numpy(), prepend=-1))
    counts = np.diff(starts, append=rows.height)
    if counts.size and counts.max() > VEHICLES_LIMIT:
        frame = rows["frame"][int(starts[counts.argmax()])]
        raise DataError(
            f"{recording.trio.tracks}: frame {frame}: {counts.max():,} vehicles in one direction; "
            f"expected at most {VEHICLES_LIMIT}"
        )
    x, y = rows["x"].to_numpy() - section[0], rows["y"].to_numpy()
    speed, lateral_speed = rows["speed"].to_numpy(), rows["lateral_speed"].to_numpy()
    window = np.clip(rows["lane"].to_numpy() - 1, 0, lanes - LANES)
    observations = np.zeros((rows.height, 7, 5), dtype=np.float32)
    distance = np.full(rows.height, np.nan)
    frames = max(1, _CHUNK // int(counts.max(initial=1)))
    for first in range(0, counts.size, frames):
        chunk = counts[first : first + frames]
        own = slice(starts[first], starts[first] + chunk.sum())
        b = np.repeat(np.arange(chunk.size), chunk)
        i = np.arange(chunk.sum()) - np.repeat(np.cumsum(chunk) - chunk, chunk)
        scene = _empty_scene(chunk.size, int(chunk.max()), section[1] - section[0])
        scene.x[b, i] = x[own]
        scene.speed[b, i] = np.hypot(speed[own], lateral_speed[own])
        scene.heading[b, i] = np.arctan2(lateral_speed[own], speed[own])
        for begin in np.unique(window[own]):
            scene.y[b, i] = y[own] - LANE_WIDTH_M * begin
            locate(scene, np.arange(chunk.size))
            drivers = np.flatnonzero(window[own] == begin)
            vehicles = b[drivers], i[drivers]
            leader, present = scene.leader(vehicles, scene.lane[vehicles])
            ahead = scene.x[vehicles[0], leader] - scene.x[vehicles]
            following = present & (ahead <= FOLLOWING_RANGE_M)
            observations[own.start + drivers] = neighbours(scene, vehicles)
            distance[own.start + drivers] = np.where(following, ahead, np.nan)
    empty = observations[:, 1:, 0].reshape(-1, 3, 2) == 0
    lane_in_window = rows["lane"].to_numpy() - window
    side_lane = lane_in_window[:, None] + np.arange(-1, 2)
    exists = (side_lane >= 0) & (side_lane < LANES)
    ends_near = np.stack([x > section[1] - section[0] - RANGE_M, x < RANGE_M], axis=1)
    cut = (empty & exists[:, :, None] & ends_near[:, None, :]).any(axis=(1, 2))
    return observations, distance, cut


def _empty_scene(scenes: int, vehicles: int, length_m: float) -> Scene:
    """Scenes on a road of that length whose vehicles all lie beyond its end, on no lane."""
    profile = CHARMS.model_copy(update={"road_length_m": length_m + 1.0})
    settings = SceneSettings(
        profile=profile, lanes=LANES, traffic_vehicles=vehicles - 1, ego_slots=1
    )
    scene = Scene.empty(settings, scenes)
    # Apart from each other, since vehicles at one x are compared pair by pair.
    scene.x[...] = length_m + 100.0 + np.arange(vehicles)
    return scene

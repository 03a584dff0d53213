"""Observations of recorded drivers: what each driver saw at each decision.

Observations have three lanes. On a wider carriageway, a driver is given a window of three lanes
with the driver's own lane in the middle, or at the edge if it is an outermost lane. So there is a
lane to the left and to the right exactly where the recorded driver had one. Vehicles outside the
window are not observed.
"""

import numpy as np
import polars as pl

from charms_bench.engine.neighbours import locate
from charms_bench.errors import DataError
from charms_bench.world.following_bins import FOLLOWING_RANGE_M
from charms_bench.world.observations import COMMANDS, EGO, RANGE_M, Neighbours, neighbours
from charms_bench.world.profile import CHARMS
from charms_bench.world.scene import Bools, Floats, Ints, Observations, Scene, SceneSettings
from charms_bench.world.trajectories import LANE_WIDTH_M, Recording

LANES = 3
"""Lanes of an observation."""
VEHICLES_LIMIT = 501
"""Most vehicles on a carriageway at one time, as in a scene of the simulation."""
_CHUNK = 200_000
"""Vehicles that are in memory as scenes at one time; they need about 50 MB."""


def situations(
    recording: Recording, decision_hz: int, observation: Neighbours = neighbours
) -> tuple[pl.DataFrame, Observations]:
    """The frames of a recording at which drivers decide, and what the drivers see there.

    Decision k is made k / `decision_hz` seconds after the recording's first frame, and the nearest
    frame stands for it. Intervals differ by one frame if the rates are not multiples.

    Returns:
        The M rows of `Recording.tracks` at decisions, sorted by direction, frame and x, and their
        observations (M, 7, 5). Observations are zeros on a carriageway of fewer than three lanes.
        With the option `commands`, drivers are shown the commands that would move them as they
        move: the target speed at which the speed controller accelerates as they do.
        The rows have these further columns:

        lanes: Number of lanes of the carriageway.
        view_cut: Whether the observation may lack a neighbour because the recorded section ends
            within the observation's range.
        leader_distance: Distance to a leader within 50 m in the lane, centre to centre, m, or null.

    Raises a `DataError` if the frame rate is below the decision rate, or there are too many
    vehicles at one time.
    """
    rows = recording.tracks.filter(at_decisions(recording, decision_hz))
    rows = rows.sort("direction", "frame", "x", "vehicle")
    tables, observed = [], []
    for direction, lanes in recording.lanes.items():
        part = rows.filter(pl.col("direction") == direction)
        if lanes >= LANES:
            section = recording.tracks.filter(pl.col("direction") == direction)["x"].to_numpy()
            ends = float(section.min()), float(section.max())
            observations, distance, cut = _seen(recording, part, lanes, ends, observation)
        else:
            observations = np.zeros((part.height, *observation.shape), dtype=np.float32)
            distance, cut = np.full(part.height, np.nan), np.zeros(part.height, dtype=np.bool_)
        observed.append(observations)
        found = (
            pl.Series("view_cut", cut),
            pl.Series("leader_distance", distance, nan_to_null=True),
        )
        tables.append(part.with_columns(pl.lit(lanes).alias("lanes"), *found))
    return pl.concat(tables), np.concatenate(observed)


def at_decisions(recording: Recording, decision_hz: int) -> Bools:
    """Which rows of a recording are at decisions; see `situations`.

    Raises a `DataError` if the frame rate is below the decision rate.
    """
    if recording.frame_rate_hz < decision_hz:
        raise DataError(
            f"{recording.trio.recording_meta}: line 2: column 'frameRate': "
            f"{recording.frame_rate_hz:g} Hz; expected at least the {decision_hz} Hz of decisions"
        )
    frame = recording.tracks["frame"].to_numpy()
    return nearest_to_decisions(frame - frame.min(), recording.frame_rate_hz / decision_hz)


def nearest_to_decisions(frame: Ints, frames_per_decision: float) -> Bools:
    """Whether each frame, counted from 0, is the frame nearest to a decision."""
    decision = np.rint(frame / frames_per_decision)
    return np.asarray(np.floor(decision * frames_per_decision + 0.5) == frame)


def _seen(
    recording: Recording,
    rows: pl.DataFrame,
    lanes: int,
    section: tuple[float, float],
    observation: Neighbours,
) -> tuple[Observations, Floats, Bools]:
    """Observations, leader distances (NaN without a leader) and `view_cut` of a carriageway."""
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
    acceleration = rows["acceleration"].to_numpy()
    window = np.clip(rows["lane"].to_numpy() - 1, 0, lanes - LANES)
    observations = np.zeros((rows.height, *observation.shape), dtype=np.float32)
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
        scene.acceleration[b, i] = acceleration[own]
        scene.target_speed[b, i] = scene.speed[b, i] + CHARMS.tau_acceleration_s * acceleration[own]
        for begin in np.unique(window[own]):
            scene.y[b, i] = y[own] - LANE_WIDTH_M * begin
            locate(scene, np.arange(chunk.size))
            scene.target_lane[...] = scene.lane
            drivers = np.flatnonzero(window[own] == begin)
            vehicles = b[drivers], i[drivers]
            leader, present = scene.leader(vehicles, scene.lane[vehicles])
            ahead = scene.x[vehicles[0], leader] - scene.x[vehicles]
            following = present & (ahead <= FOLLOWING_RANGE_M)
            observations[own.start + drivers] = observation(scene, vehicles)
            distance[own.start + drivers] = np.where(following, ahead, np.nan)
    observations[:, EGO, 1] = 1.0  # the road begins long before the recorded section
    empty = observations[:, 1:COMMANDS, 0].reshape(-1, 3, 2) == 0
    lane_in_window = rows["lane"].to_numpy() - window
    side_lane = lane_in_window[:, None] + np.arange(-1, 2)
    exists = (side_lane >= 0) & (side_lane < LANES)
    ends_near = np.stack([x > section[1] - section[0] - RANGE_M, x < RANGE_M], axis=1)
    cut = (empty & exists[:, :, None] & ends_near[:, None, :]).any(axis=(1, 2))
    return observations, distance, cut


def _empty_scene(scenes: int, vehicles: int, length_m: float) -> Scene:
    """Scenes on a road of that length, with all vehicles beyond the end of the road."""
    profile = CHARMS.model_copy(update={"road_length_m": length_m + 1.0})
    settings = SceneSettings(
        profile=profile, lanes=LANES, traffic_vehicles=vehicles - 1, ego_slots=1
    )
    scene = Scene.empty(settings, scenes)
    # Spread out, because vehicles at the same x are compared pair by pair.
    scene.x[...] = length_m + 100.0 + np.arange(vehicles)
    return scene

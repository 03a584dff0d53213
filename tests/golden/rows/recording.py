"""A recording in highD's format: two carriageways of three lanes, with cars and trucks."""

from pathlib import Path

RATE_HZ, SECONDS, SECTION_M = 10, 20, 320.0
MARKINGS = (0.0, 3.8, 7.4, 11.2)
"""Of a carriageway, in m from its left edge."""
LEFT_EDGES = {1: 22.0, 2: 30.0}
"""Image y of the left edge by direction; direction 1 drives towards smaller x."""
TRACKS = "frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,laneId"
TRACKS_META = "id,initialFrame,finalFrame,numFrames,class,drivingDirection"
META = "frameRate,numVehicles,upperLaneMarkings,lowerLaneMarkings"


def write_recording(folder: Path) -> None:
    """Writes the three files of the recording."""
    tracks, tracks_meta = [], []
    for number in range(132):
        rows = track_of(number)
        if not rows:
            continue
        tracks += rows
        first, last = (row.split(",")[0] for row in (rows[0], rows[-1]))
        kind = "Truck" if number % 7 == 3 else "Car"
        tracks_meta.append(f"{number + 1},{first},{last},{len(rows)},{kind},{number % 2 + 1}")
    upper = ";".join(f"{LEFT_EDGES[1] - each:.1f}" for each in reversed(MARKINGS))
    lower = ";".join(f"{LEFT_EDGES[2] + each:.1f}" for each in MARKINGS)
    meta = [f"{RATE_HZ},{len(tracks_meta)},{upper},{lower}"]
    for name, header, lines in (
        ("tracks", TRACKS, tracks),
        ("tracksMeta", TRACKS_META, tracks_meta),
        ("recordingMeta", META, meta),
    ):
        (folder / f"01_{name}.csv").write_text("\n".join([header, *lines]) + "\n")


def track_of(number: int) -> list[str]:
    """Returns the lines of a vehicle while its centre is on the section.

    Lanes have different speeds, most vehicles brake and accelerate, and some change lanes.
    """
    lane, place = number // 2 % 3, number // 6
    length, width = (12.0, 2.5) if number % 7 == 3 else (4.0 + 0.1 * (number % 9), 1.8)
    start = 290.0 - 32.0 * place - 10.0 * lane - 3.0 * (number % 4)
    mean, swing = 22.0 - 1.5 * lane, 0.4 * (number % 5)
    step, at_s = (0, 0.0)
    if number % 11 == 4:
        step, at_s = (1 if lane < 2 else -1), 4.0 + place % 9
    lines = []
    for k in range(RATE_HZ * SECONDS):
        t = k / RATE_HZ
        phase = (t + number % 6) % 6.0 - 3.0  # a parabola of speed every 6 s
        speed = mean + swing * (phase * phase / 3.0 - 1.0)
        x = start + mean * t + swing * ((phase**3 + 27.0) / 9.0 - (phase + 3.0))
        done = min(max((t - at_s) / 4.0, 0.0), 1.0) if step else 0.0
        across = lateral(lane) + (lateral(lane + step) - lateral(lane)) * done
        sideways = (lateral(lane + step) - lateral(lane)) / 4.0 if 0.0 < done < 1.0 else 0.0
        if not 0.0 <= x <= SECTION_M:
            continue
        now = sum(across > edge for edge in MARKINGS[1:-1])
        direction = number % 2 + 1
        sign = 1 if direction == 2 else -1
        along = x if sign == 1 else SECTION_M - x
        y = LEFT_EDGES[direction] + sign * across
        values = (along - length / 2, y - width / 2, length, width, sign * speed, sign * sideways)
        told = ",".join(f"{each:.3f}" for each in (*values, sign * swing * phase * 2.0 / 3.0))
        lines.append(f"{k + 1},{number + 1},{told},{6 + now if sign == 1 else 4 - now}")
    return lines


def lateral(lane: int) -> float:
    """Returns the distance from the left edge to the centre of a lane."""
    return (MARKINGS[lane] + MARKINGS[lane + 1]) / 2

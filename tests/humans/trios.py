"""Recordings in highD's format, written by hand: three lanes of 4 m each way, image coordinates.

Upper lanes have the ids 2, 3 and 4, lower ones 6, 7 and 8, with centres at y 12, 16, 20 and
32, 36, 40. Vehicles are 5 m long and 2 m wide, and `x` and `y` are their upper left corners.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

UPPER_MARKINGS, LOWER_MARKINGS = "10;14;18;22", "30;34;38;42"
HEADER = "frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration,laneId"


@dataclass(frozen=True)
class Row:
    """A vehicle in a frame; by default on the lower carriageway's middle lane."""

    vehicle: int = 1
    frame: int = 1
    x: float = 100.0
    y: float = 35.0
    vx: float = 30.0
    vy: float = 0.0
    ax: float = 0.0
    lane_id: int = 7
    direction: int = 2
    kind: str = "Car"
    length: float = 5.0
    width: float = 2.0


def driven(row: Row, frames: int, rate: float = 25.0) -> list[Row]:
    """A vehicle over some frames, at constant velocity along the road."""
    return [replace(row, frame=row.frame + k, x=row.x + k * row.vx / rate) for k in range(frames)]


def write_trio(
    folder: Path,
    rows: Iterable[Row],
    number: int = 1,
    rate: float = 25,
    upper: str = UPPER_MARKINGS,
    lower: str = LOWER_MARKINGS,
    start: str = "",
    place: str = "",
) -> Path:
    """Writes the three files and returns their folder; by default, each number starts later."""
    rows = list(rows)
    lines = [
        f"{r.frame},{r.vehicle},{r.x!r},{r.y!r},{r.length},{r.width},{r.vx!r},{r.vy!r},{r.ax!r},0,{r.lane_id}"
        for r in rows
    ]
    write(folder / f"{number:02}_tracks.csv", HEADER, lines)
    frames: dict[int, list[Row]] = {}
    for row in rows:
        frames.setdefault(row.vehicle, []).append(row)
    lines = [
        f"{v},{rs[0].frame},{rs[-1].frame},{len(rs)},{rs[0].kind},{rs[0].direction}"
        for v, rs in frames.items()
    ]
    header = "id,initialFrame,finalFrame,numFrames,class,drivingDirection"
    write(folder / f"{number:02}_tracksMeta.csv", header, lines)
    header = "id,frameRate,numVehicles,startTime,upperLaneMarkings,lowerLaneMarkings,locationId"
    line = f"{number},{rate},{len(frames)},{start or f'08:{number:02}'},{upper},{lower},{place}"
    write(folder / f"{number:02}_recordingMeta.csv", header, [line])
    return folder


def flowing_road(rate: float, seconds: float = 6.0) -> list[Row]:
    """Vehicles of many sizes on the lower carriageway that come, change lanes and go.

    They drive with 12, 13 and 14 m/s on the three lanes, and leave 25 m between their centres. The
    section is 100 m long: vehicles appear at its beginning and are lost at its end.
    """
    rows = []
    for number in range(24):
        lane, place = number % 3, number // 3
        start = 100.0 - 25.0 * place - 12.0 * lane
        truck = number % 5 == 4
        row = Row(
            vehicle=number + 1,
            vx=13.0 if number == 9 else 12.0 + lane,
            lane_id=6 + lane,
            kind="Truck" if truck else "Car",
            length=10.0 if truck else 4.0 + 0.1 * (number % 4),
            width=2.5 if truck else 1.8,
        )
        for k in range(round(seconds * rate) + 1):
            x, aside = start + k * row.vx / rate, 0.0
            if number == 9:  # from the left lane into the gap to its right
                aside = 4.0 * min(max((k / rate - 0.5) / 3.0, 0.0), 1.0)
            if 0.0 <= x <= 100.0:
                y = 32.0 + 4 * lane + aside - row.width / 2
                is_moving = number == 9 and 0.0 < aside < 4.0
                rows.append(
                    replace(row, frame=k + 1, x=x - row.length / 2, y=y,
                            vy=4 / 3 if is_moving else 0.0,
                            lane_id=6 + lane + (aside > 2.0))
                )  # fmt: skip
    return rows


def write(path: Path, header: str, lines: list[str]) -> None:
    path.write_text("\n".join([header, *lines]) + "\n")


def busy_road(frames: int = 26) -> list[Row]:
    """Three full lanes over 300 m, a truck in every lane; most drivers do something.

    Every neighbour that could be within 99 m is there, but at the section's ends.
    """
    rows = []
    for lane in range(3):
        for place in range(11):
            number = 11 * lane + place
            row = Row(
                vehicle=number + 1,
                x=30.0 * place,
                y=31.3 + 4 * lane,  # 0.3 m right of the lane's centre
                vy=(0.0, 0.0, 0.1)[number % 3],
                ax=(0.5, -0.8, 0.0, 0.0)[number % 4],
                lane_id=6 + lane,
                kind="Truck" if place == 5 else "Car",
            )
            rows += driven(row, frames)
    return rows

"""A moment of an episode as text: the road around the ego, seen from above."""

from itertools import groupby

import numpy as np
from rich.text import Text

from charms_bench.world.picture import AHEAD_M, BEHIND_M, BRAKE_LIGHT_MPS2, Moment, status_of

EDGE, LINE = "═", "─"
DASH_M, DASH_EVERY_M, MARK_EVERY_M = 6, 18, 20
VEHICLE = 5
"""Characters of a vehicle of the profile's length, which are about that length."""
EGO, OTHER, WRECK = "bold white on #b83a06", "white on #1f5f9e", "bold white on #c2122d"


def road(moment: Moment, width: int = 100) -> Text:
    """The road as lines of text of a width in characters, and the ego's state below it.

    Each lane has one line, and the line between two lanes shows vehicles on their way from one to
    the other. The vehicles drive to the right. `[ego>` is the ego, and the other vehicles have
    their number in the order of spawning. `<` at a vehicle's rear means that it brakes, and `x`
    marks a vehicle that has crashed.
    """
    lanes, lane_m = moment.settings.lanes, moment.settings.profile.lane_width_m
    start, per_m = moment.x[moment.ego] - BEHIND_M, width / (BEHIND_M + AHEAD_M)
    rows = [_line(row, 2 * lanes, start, per_m, width) for row in range(2 * lanes + 1)]
    order = [k for k in range(len(moment.agents)) if k != moment.ego]
    for vehicle in (*order, moment.ego):
        # Lane 0 is row 1, and each further lane is two rows below.
        row = round(float(np.clip(1 + 2 * moment.y[vehicle] / lane_m, 0, 2 * lanes)))
        text, style = _vehicle(moment, vehicle)
        left = round((moment.x[vehicle] - start) * per_m) - len(text) // 2
        shown = range(max(0, -left), min(len(text), width - left))
        for place in shown:
            rows[row][left + place] = (text[place], style)
    status = "   ".join(f"{what} {value}" for what, value in status_of(moment).items())
    head = f"{moment.title}, episode {moment.episode}, {moment.t_s:z.1f} s"
    body = Text("\n").join(map(_merged, rows))
    return Text("\n").join([Text(head, "bold"), body, _marks(start, per_m, width), Text(status)])


def _line(row: int, last: int, start: float, per_m: float, width: int) -> list[tuple[str, str]]:
    """The characters of an empty row: an edge of the road, a dashed line, or a lane."""
    if row in (0, last):
        return [(EDGE, "dim")] * width
    along = start + np.arange(width) / per_m
    painted = (along % DASH_EVERY_M < DASH_M) & (row % 2 == 0)
    return [(LINE if each else " ", "dim") for each in painted]


def _merged(row: list[tuple[str, str]]) -> Text:
    """The characters of a row, in as few runs of the same style as possible."""
    runs = [(style, [*run]) for style, run in groupby(row, key=lambda each: each[1])]
    return Text.assemble(*(("".join(text for text, _ in run), style) for style, run in runs))


def _vehicle(moment: Moment, vehicle: int) -> tuple[str, str]:
    """The characters of a vehicle and their style."""
    is_ego, crashed = vehicle == moment.ego, moment.crashed[vehicle]
    label = "ego" if is_ego else str(vehicle)
    longer = moment.length[vehicle] / moment.settings.profile.vehicle_length_m
    room = max(3, round(VEHICLE * longer) - 2)
    rear = "<" if moment.acceleration[vehicle] < -BRAKE_LIGHT_MPS2 else "["
    front = "x" if crashed else ">"
    style = WRECK if crashed else EGO if is_ego else OTHER
    return f"{'x' if crashed else rear}{label[:3]:^{room}}{front}", style


def _marks(start: float, per_m: float, width: int) -> Text:
    """The positions along the road, below it."""
    line = [" "] * width
    first = int(np.ceil(start / MARK_EVERY_M)) * MARK_EVERY_M
    for mark in range(first, int(start + width / per_m), MARK_EVERY_M):
        left, text = round((mark - start) * per_m), f"|{mark} m"
        if left + len(text) <= width:
            line[left : left + len(text)] = text
    return Text("".join(line), "dim")

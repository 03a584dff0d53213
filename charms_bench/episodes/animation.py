"""Draws a replayed episode as an animated GIF: the road around the ego, and the ego's state."""

from functools import lru_cache, partial
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from charms_bench.episodes import palette
from charms_bench.episodes.ego_view import EgoView, ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.errors import InputError
from charms_bench.world.actions import ACTIONS
from charms_bench.world.files import write_atomically
from charms_bench.world.scene import Floats

WIDTH = 800
BEHIND_M = 38.0
AHEAD_M = 62.0
SCALE = WIDTH / (BEHIND_M + AHEAD_M)
"""Pixels per metre, along and across the road."""
HEADER, SHOULDER_M, MARKS, STATUS = 38, 1.0, 20, 46
LINE, MARGIN, LEGEND_COLUMNS = 22, 16, 3
FINE = 2
"""Pictures are drawn this many times larger and then reduced, so that edges are smooth."""
HOLD_S = 2.0
"""How long the last picture is shown."""
BRAKE_LIGHT_MPS2 = 0.5
"""Deceleration above which the brake lights are on."""
TTC_SHOWN_S = 100.0
"""A time to collision from here on is not shown."""
COLOURS = 96
"""Size of the GIF's palette, which limits the size of the file."""

INK, PALE, PAPER = "#20242a", "#737b86", "#ffffff"
EGO, WRECK, BRAKE, INDICATOR, ASPHALT, PAINT = (
    palette.VEHICLES[name][0] for name in ("ego", "wreck", "brake", "indicator", "asphalt", "paint")
)
AGENTS = [light for light, _ in palette.AGENTS]
"""Colours of the agents in the traffic, in alphabetical order of the agents."""


def check_animation(path: Path) -> None:
    """Refuses a file name that is not a GIF's.

    Raises:
        InputError: The name does not end in `.gif`.
    """
    if path.suffix.lower() != ".gif":
        raise InputError(f"{path}: expected a name that ends in .gif")


def animate(replay: Replay, path: Path, caption: str = "") -> None:
    """Writes an episode as a GIF that plays in real time, one picture per simulation step.

    A vehicle's colour is that of its agent; the ego has its own colour. The number on a vehicle is
    its index in the order of spawning. Red lights mean braking, amber lights a lane change, and a
    cross a vehicle that has crashed.

    Args:
        replay: The episode.
        path: The file.
        caption: One line of text below the road.

    Raises:
        InputError: The file's name does not end in `.gif`, or the file cannot be written.
    """
    check_animation(path)
    frames = range(len(replay.t_s))
    view = ego_view(replay)
    sample = [*frames[:: max(1, len(frames) // 7)], frames[-1]]
    shared = _palette([picture(replay, view, frame, caption) for frame in sample])
    pictures = (
        picture(replay, view, frame, caption).quantize(palette=shared, dither=Image.Dither.NONE)
        for frame in frames
    )
    # A GIF counts in hundredths of a second; rounding times instead of steps adds up no error.
    moments = np.round(replay.t_s * 100).astype(int) * 10
    durations = [*np.diff(moments).tolist(), round(HOLD_S * 1000)]
    save = partial(next(pictures).save, format="GIF", save_all=True, append_images=pictures)
    write_atomically(path, partial(save, duration=durations, loop=0))


def _palette(pictures: list[Image.Image]) -> Image.Image:
    """Returns an image whose palette suits all pictures and holds the colours of rare marks."""
    width, height = pictures[0].size
    sheet = Image.new("RGB", (width, height * len(pictures) + height))
    for k, each in enumerate(pictures):
        sheet.paste(each, (0, k * height))
    for k, colour in enumerate((WRECK, BRAKE, INDICATOR)):
        left, top = k * width // 3, len(pictures) * height
        sheet.paste(colour, (left, top, left + width // 3, top + height))
    return sheet.quantize(COLOURS)


def picture(replay: Replay, view: EgoView, frame: int, caption: str = "") -> Image.Image:
    """Returns the picture of one simulation step; step 0 is the start of the episode."""
    settings, colours = replay.settings, _colours(replay)
    road = round((settings.lanes * settings.profile.lane_width_m + 2 * SHOULDER_M) * SCALE)
    status = HEADER + road + MARKS
    caption_at = status + STATUS
    legend = caption_at + (LINE if caption else 0)
    canvas = _Canvas(legend + LINE * (1 + len(colours) // LEGEND_COLUMNS) + 6)
    _draw_road(canvas, replay, frame)
    for vehicle, agent in enumerate(replay.agents):
        colour = EGO if vehicle == replay.ego else colours[agent]
        _draw_vehicle(canvas, replay, frame, vehicle, colour)
    _draw_header(canvas, replay, frame)
    _draw_status(canvas, _status(replay, view, frame), status)
    canvas.text(MARGIN, caption_at + 11, caption[:1].upper() + caption[1:], 13, bold=True)
    _draw_legend(canvas, replay, colours, legend + 11)
    return canvas.image.reduce(FINE)


def _colours(replay: Replay) -> dict[str, str]:
    """Returns the colour of each agent in the traffic."""
    names = sorted({name for k, name in enumerate(replay.agents) if k != replay.ego})
    return {name: AGENTS[k % len(AGENTS)] for k, name in enumerate(names)}


class _Canvas:
    """A picture with coordinates in final pixels, drawn on a finer grid."""

    def __init__(self, height: int) -> None:
        self.image = Image.new("RGB", (WIDTH * FINE, height * FINE), PAPER)
        self._draw = ImageDraw.Draw(self.image)

    def polygon(self, points: Floats, fill: str) -> None:
        """Fills a polygon of points (K, 2)."""
        self._draw.polygon((points * FINE).ravel().tolist(), fill=fill)

    def line(self, points: Floats, colour: str, width: float) -> None:
        """Draws a line through points (K, 2)."""
        self._draw.line((points * FINE).ravel().tolist(), fill=colour, width=round(width * FINE))

    def box(self, left: float, top: float, right: float, bottom: float, fill: str) -> None:
        """Fills an upright rectangle."""
        self._draw.rectangle([left * FINE, top * FINE, right * FINE, bottom * FINE], fill=fill)

    def text(
        self,
        x: float,
        y: float,
        text: str,
        size: float,
        colour: str = INK,
        bold: bool = False,
        anchor: str = "lm",
    ) -> float:
        """Writes text, anchored at its left and middle by default; returns the x of its end."""
        font = _font(bold, size)
        self._draw.text((x * FINE, y * FINE), text, fill=colour, font=font, anchor=anchor)
        return x + font.getlength(text) / FINE


@lru_cache
def _font(bold: bool, size: float) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name
    return ImageFont.truetype(path, size * FINE)


def _place(replay: Replay, frame: int, x: Floats, y: Floats) -> Floats:
    """Returns where points of the road (K,) are in the picture (K, 2)."""
    start = replay.x[frame, replay.ego] - BEHIND_M
    edge = -replay.settings.profile.lane_width_m / 2 - SHOULDER_M
    return np.stack([(x - start) * SCALE, HEADER + (y - edge) * SCALE], axis=-1)


def _draw_road(canvas: _Canvas, replay: Replay, frame: int) -> None:
    width, lanes = replay.settings.profile.lane_width_m, replay.settings.lanes
    start = replay.x[frame, replay.ego] - BEHIND_M
    end = start + BEHIND_M + AHEAD_M
    borders = np.arange(lanes + 1) * width - width / 2
    sides = np.array([borders[0] - SHOULDER_M, borders[-1] + SHOULDER_M])
    (left, top), (right, bottom) = _place(replay, frame, np.array([start, end]), sides).tolist()
    canvas.box(left, top, right, bottom, ASPHALT)
    for border in borders:
        solid = border in (borders[0], borders[-1])
        # Dashes of 6 m and gaps of 12 m, as on a motorway.
        dashes = np.array([start]) if solid else np.arange(np.floor(start / 18) * 18, end, 18)
        for dash in dashes:
            length = end - start if solid else 6.0
            ends = np.array([dash, dash + length])
            canvas.line(_place(replay, frame, ends, np.full(2, border)), PAINT, 2)
    for mark in np.arange(np.ceil(start / 20) * 20, end, 20):
        ((x, _),) = _place(replay, frame, np.array([mark]), sides[:1]).tolist()
        canvas.line(np.array([[x, bottom], [x, bottom + 4]]), PALE, 1)
        canvas.text(x, bottom + 11, f"{mark:,.0f} m", 10, PALE, anchor="mm")


def _draw_vehicle(canvas: _Canvas, replay: Replay, frame: int, vehicle: int, colour: str) -> None:
    x, y = replay.x[frame, vehicle], replay.y[frame, vehicle]
    if not -10 < x - replay.x[frame, replay.ego] + BEHIND_M < BEHIND_M + AHEAD_M + 10:
        return
    profile, heading = replay.settings.profile, replay.heading[frame, vehicle]
    ahead = np.array([np.cos(heading), np.sin(heading)])
    aside = np.array([-ahead[1], ahead[0]])
    half_length, half_width = profile.vehicle_length_m / 2, profile.vehicle_width_m / 2

    def shape(corners: list[tuple[float, float]]) -> Floats:
        """Returns a shape whose corners are given in halves of the vehicle's length and width."""
        along, across = (np.array(corners) * (half_length, half_width)).T[..., None]
        away = along * ahead + across * aside
        return _place(replay, frame, x + away[:, 0], y + away[:, 1])

    crashed = replay.crashed[frame, vehicle]
    body = [(-1.0, -1.0), (0.9, -1.0), (1.0, -0.6), (1.0, 0.6), (0.9, 1.0), (-1.0, 1.0)]
    canvas.polygon(shape(body), colour)
    if replay.acceleration[frame, vehicle] < -BRAKE_LIGHT_MPS2:
        for side in (-1.0, 1.0):
            light = [(-1.0, side), (-0.8, side), (-0.8, side * 0.3), (-1.0, side * 0.3)]
            canvas.polygon(shape(light), BRAKE)
    aim = replay.target_lane[frame, vehicle] * profile.lane_width_m - y
    if abs(aim) > 0.2 * profile.lane_width_m and not crashed:
        side = float(np.sign(aim))
        for end in (-1.0, 0.6):
            light = [(end, side * 1.4), (end + 0.4, side * 1.4), (end + 0.4, side), (end, side)]
            canvas.polygon(shape(light), INDICATOR)
    if crashed:
        for cross in ([(-1.1, -1.3), (1.1, 1.3)], [(-1.1, 1.3), (1.1, -1.3)]):
            canvas.line(shape(cross), WRECK, 3)
    middle_x, middle_y = shape([(0.0, 0.0)])[0]
    label = "ego" if vehicle == replay.ego else str(vehicle)
    canvas.text(middle_x, middle_y, label, 10.5, PAPER, bold=True, anchor="mm")


def _draw_header(canvas: _Canvas, replay: Replay, frame: int) -> None:
    ego, traffic = replay.cell.ego.title, replay.cell.traffic.title
    end = canvas.text(MARGIN, HEADER / 2, f"{ego} in {traffic}", 15, bold=True)
    canvas.text(end + 12, HEADER / 2 + 1, f"episode {replay.episode}", 13, PALE)
    time = f"{replay.t_s[frame]:.1f} s"
    canvas.text(WIDTH - MARGIN, HEADER / 2, time, 17, bold=True, anchor="rm")


def _draw_status(canvas: _Canvas, status: dict[str, str], top: int) -> None:
    for k, (what, value) in enumerate(status.items()):
        x = MARGIN + k * (WIDTH - 2 * MARGIN) / len(status)
        canvas.text(x, top + 10, what, 11, PALE)
        canvas.text(x, top + 29, value, 16)


def _status(replay: Replay, view: EgoView, frame: int) -> dict[str, str]:
    """Returns the ego's state, each quantity with its unit."""
    ego = replay.ego
    aside = int(replay.target_lane[frame, ego] - replay.lane[frame, ego])
    if replay.crashed[frame, ego]:
        doing = "crashed"
    elif replay.has_action[frame, ego]:
        doing = ACTIONS[replay.action[frame, ego]].replace("_", " ").lower()
    else:  # before the first decision, and under a driver model, which takes no meta-actions
        doing = f"to the {'right' if aside > 0 else 'left'}" if aside else "keeps its lane"
    gap, ttc = view.gap_ahead[frame], view.ttc[frame]
    return {
        "ego's speed": f"{replay.speed[frame, ego]:.1f} m/s",
        "acceleration": f"{replay.acceleration[frame, ego]:+.1f} m/s²",
        "action": doing,
        "gap ahead": "–" if np.isnan(gap) else f"{gap:.1f} m",
        "TTC": f"{ttc:.1f} s" if ttc < TTC_SHOWN_S else "–",
    }


def _draw_legend(canvas: _Canvas, replay: Replay, colours: dict[str, str], middle: float) -> None:
    entries = [(f"ego, {replay.agents[replay.ego]}", EGO), *colours.items()]
    for k, (name, colour) in enumerate(entries):
        x = MARGIN + k % LEGEND_COLUMNS * (WIDTH - 2 * MARGIN) / LEGEND_COLUMNS
        y = middle + k // LEGEND_COLUMNS * LINE
        canvas.box(x, y - 5, x + 16, y + 5, colour)
        canvas.text(x + 22, y, name, 12, PALE)

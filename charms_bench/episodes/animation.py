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

FINE = 2
"""Pictures are drawn this many times larger and then reduced, so that edges are smooth."""
WIDTH = 800 * FINE
BEHIND_M = 38.0
AHEAD_M = 62.0
SCALE = WIDTH / (BEHIND_M + AHEAD_M)
"""Pixels per metre, along and across the road; all lengths are before the reduction."""
HEADER, SHOULDER_M, MARKS, STATUS = 76, 1.0, 40, 92
LINE, MARGIN, LEGEND_COLUMNS = 44, 32, 3
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
    """Writes an episode as a GIF; see `Replay.animate`."""
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
    settings = replay.settings
    names = sorted({name for k, name in enumerate(replay.agents) if k != replay.ego})
    colours = {name: AGENTS[k % len(AGENTS)] for k, name in enumerate(names)}
    road = round((settings.lanes * settings.profile.lane_width_m + 2 * SHOULDER_M) * SCALE)
    status = HEADER + road + MARKS
    caption_at = status + STATUS
    legend = caption_at + (LINE if caption else 0)
    height = legend + LINE * (1 + len(colours) // LEGEND_COLUMNS) + 12
    image = Image.new("RGB", (WIDTH, height), PAPER)
    draw = ImageDraw.Draw(image)
    _draw_road(draw, replay, frame)
    for vehicle, agent in enumerate(replay.agents):
        colour = EGO if vehicle == replay.ego else colours[agent]
        _draw_vehicle(draw, replay, frame, vehicle, colour)
    _draw_header(draw, replay, frame)
    _draw_status(draw, replay, view, frame, status)
    sentence = caption[:1].upper() + caption[1:]
    draw.text((MARGIN, caption_at + 22), sentence, INK, _font(26, "-Bold"), "lm")
    entries = [(f"ego, {replay.agents[replay.ego]}", EGO), *colours.items()]
    for k, (name, colour) in enumerate(entries):
        x = MARGIN + k % LEGEND_COLUMNS * (WIDTH - 2 * MARGIN) / LEGEND_COLUMNS
        y = legend + 22 + k // LEGEND_COLUMNS * LINE
        draw.rectangle([x, y - 10, x + 32, y + 10], colour)
        draw.text((x + 44, y), name, PALE, _font(24), "lm")
    return image.reduce(FINE)


@lru_cache
def _font(size: int, weight: str = "") -> ImageFont.FreeTypeFont:
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / f"DejaVuSans{weight}.ttf"
    return ImageFont.truetype(path, size)


def _place(replay: Replay, frame: int, x: Floats, y: Floats) -> list[float]:
    """Returns where points of the road (K,) are in the picture, as x, y, x, y and so on."""
    start = replay.x[frame, replay.ego] - BEHIND_M
    edge = -replay.settings.profile.lane_width_m / 2 - SHOULDER_M
    places = np.stack([(x - start) * SCALE, HEADER + (y - edge) * SCALE], axis=-1)
    return list(places.ravel().tolist())


def _draw_road(draw: ImageDraw.ImageDraw, replay: Replay, frame: int) -> None:
    width, lanes = replay.settings.profile.lane_width_m, replay.settings.lanes
    start = replay.x[frame, replay.ego] - BEHIND_M
    end = start + BEHIND_M + AHEAD_M
    borders = np.arange(lanes + 1) * width - width / 2
    sides = np.array([borders[0] - SHOULDER_M, borders[-1] + SHOULDER_M])
    road = _place(replay, frame, np.array([start, end]), sides)
    draw.rectangle(road, ASPHALT)
    for border in borders:
        solid = border in (borders[0], borders[-1])
        # Dashes of 6 m and gaps of 12 m, as on a motorway.
        dashes = np.array([start]) if solid else np.arange(np.floor(start / 18) * 18, end, 18)
        for dash in dashes:
            ends = np.array([dash, end if solid else dash + 6.0])
            draw.line(_place(replay, frame, ends, np.full(2, border)), PAINT, 4)
    for mark in np.arange(np.ceil(start / 20) * 20, end, 20):
        x, bottom = _place(replay, frame, np.array([mark]), sides[1:])
        draw.line([x, bottom, x, bottom + 8], PALE, 2)
        draw.text((x, bottom + 22), f"{mark:,.0f} m", PALE, _font(20), "mm")


def _draw_vehicle(
    draw: ImageDraw.ImageDraw, replay: Replay, frame: int, vehicle: int, colour: str
) -> None:
    x, y = replay.x[frame, vehicle], replay.y[frame, vehicle]
    if not -10 < x - replay.x[frame, replay.ego] + BEHIND_M < BEHIND_M + AHEAD_M + 10:
        return
    profile, heading = replay.settings.profile, replay.heading[frame, vehicle]
    ahead = np.array([np.cos(heading), np.sin(heading)])
    aside = np.array([-ahead[1], ahead[0]])
    half_length, half_width = profile.vehicle_length_m / 2, profile.vehicle_width_m / 2

    def shape(*corners: tuple[float, float]) -> list[float]:
        """Returns a shape whose corners are given in halves of the vehicle's length and width."""
        along, across = (np.array(corners) * (half_length, half_width)).T[..., None]
        away = along * ahead + across * aside
        return _place(replay, frame, x + away[:, 0], y + away[:, 1])

    crashed = replay.crashed[frame, vehicle]
    body = [(-1.0, -1.0), (0.9, -1.0), (1.0, -0.6), (1.0, 0.6), (0.9, 1.0), (-1.0, 1.0)]
    draw.polygon(shape(*body), colour)
    if replay.acceleration[frame, vehicle] < -BRAKE_LIGHT_MPS2:
        for side in (-1.0, 1.0):
            light = [(-1.0, side), (-0.8, side), (-0.8, side * 0.3), (-1.0, side * 0.3)]
            draw.polygon(shape(*light), BRAKE)
    aim = replay.target_lane[frame, vehicle] * profile.lane_width_m - y
    if abs(aim) > 0.2 * profile.lane_width_m and not crashed:
        side = float(np.sign(aim))
        for end in (-1.0, 0.6):
            light = [(end, side * 1.4), (end + 0.4, side * 1.4), (end + 0.4, side), (end, side)]
            draw.polygon(shape(*light), INDICATOR)
    if crashed:
        draw.line(shape((-1.1, -1.3), (1.1, 1.3)), WRECK, 6)
        draw.line(shape((-1.1, 1.3), (1.1, -1.3)), WRECK, 6)
    label = "ego" if vehicle == replay.ego else str(vehicle)
    middle_x, middle_y = shape((0.0, 0.0))
    draw.text((middle_x, middle_y), label, PAPER, _font(21, "-Bold"), "mm")


def _draw_header(draw: ImageDraw.ImageDraw, replay: Replay, frame: int) -> None:
    title, font = f"{replay.cell.ego.title} in {replay.cell.traffic.title}", _font(30, "-Bold")
    draw.text((MARGIN, HEADER / 2), title, INK, font, "lm")
    end = MARGIN + font.getlength(title)
    draw.text((end + 24, HEADER / 2 + 2), f"episode {replay.episode}", PALE, _font(26), "lm")
    time = f"{replay.t_s[frame]:.1f} s"
    draw.text((WIDTH - MARGIN, HEADER / 2), time, INK, _font(34, "-Bold"), "rm")


def _draw_status(
    draw: ImageDraw.ImageDraw, replay: Replay, view: EgoView, frame: int, top: int
) -> None:
    """Draws the ego's state, each quantity with its unit."""
    ego = replay.ego
    aside = int(replay.target_lane[frame, ego] - replay.lane[frame, ego])
    if replay.crashed[frame, ego]:
        doing = "crashed"
    elif replay.has_action[frame, ego]:
        doing = ACTIONS[replay.action[frame, ego]].replace("_", " ").lower()
    else:  # before the first decision, and under a driver model, which takes no meta-actions
        doing = f"to the {'right' if aside > 0 else 'left'}" if aside else "keeps its lane"
    gap, ttc = view.gap_ahead[frame], view.ttc[frame]
    status = {
        "ego's speed": f"{replay.speed[frame, ego]:.1f} m/s",
        "acceleration": f"{replay.acceleration[frame, ego]:+.1f} m/s²",
        "action": doing,
        "gap ahead": "–" if np.isnan(gap) else f"{gap:.1f} m",
        "TTC": f"{ttc:.1f} s" if ttc < TTC_SHOWN_S else "–",
    }
    for k, (what, value) in enumerate(status.items()):
        x = MARGIN + k * (WIDTH - 2 * MARGIN) / len(status)
        draw.text((x, top + 20), what, PALE, _font(22), "lm")
        draw.text((x, top + 58), value, INK, _font(32), "lm")

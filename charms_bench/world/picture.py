"""Draws one moment of an episode: the road around the ego, and the ego's state."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from charms_bench.world import palette
from charms_bench.world.actions import ACTIONS
from charms_bench.world.plan_view import Plan
from charms_bench.world.scene import Floats, SceneSettings
from charms_bench.world.tracks import Motion

FINE = 2
"""Pictures are drawn this many times larger and then reduced, so that edges are smooth."""
WIDTH = 800 * FINE
BEHIND_M = 38.0
AHEAD_M = 62.0
PLAN_M = 112.0, 60.0
"""The length and the height of the part of a network that a picture shows."""
HEADER, SHOULDER_M, MARKS, STATUS = 76, 1.0, 40, 92
LINE, MARGIN, LEGEND_COLUMNS = 44, 32, 3
BRAKE_LIGHT_MPS2 = 0.5
"""Deceleration above which the brake lights are on."""
SMALLEST = 16
"""The size of the smallest letters, before the reduction."""
TTC_SHOWN_S = 100.0
"""A time to collision from here on is not shown."""

INK, PALE, PAPER = "#20242a", "#737b86", "#ffffff"
EGO, WRECK, BRAKE, INDICATOR, ASPHALT, PAINT = (
    palette.VEHICLES[name][0] for name in ("ego", "wreck", "brake", "indicator", "asphalt", "paint")
)
AGENTS = [light for light, _ in palette.AGENTS]
"""Colours of the agents in the traffic, in the order of `Moment.traffic`."""


@dataclass(frozen=True, kw_only=True)
class Moment(Motion):
    """One moment of an episode with N vehicles; its arrays are [N]."""

    settings: SceneSettings
    title: str
    episode: int | None
    """Seed of the episode; None if it has none of its own."""
    t_s: float
    """Time since the start."""
    ego: int
    """Index of the ego in the order of spawning."""
    agents: Sequence[str]
    """N names of agents; the ego's is empty if it is driven from outside."""
    traffic: Sequence[str]
    """The names of the agents that the legend lists after the ego's."""
    gap_ahead: float
    """m, from the ego's front to its leader's rear; NaN if there is no leader."""
    ttc: float
    """s, to the leader at constant speeds; NaN unless the ego closes in."""
    ahead_m: float = AHEAD_M
    """How far ahead of the ego a straight road is drawn."""
    action_names: Sequence[str] = ACTIONS
    """What `action` is an index into."""
    plan: Plan | None = None
    """Where the vehicles are on a network; without one, the road is straight."""


def picture(moment: Moment, caption: str = "") -> Image.Image:
    """Returns the picture of a moment, with a line of text below the road if there is a caption.

    A vehicle's colour is that of its agent; the ego has its own colour. The number on a vehicle is
    its index in the order of spawning. Red lights mean braking, amber lights a lane change, and a
    cross a vehicle that has crashed.
    """
    settings, plan = moment.settings, moment.plan
    colours = {name: AGENTS[k % len(AGENTS)] for k, name in enumerate(moment.traffic)}
    road = round((settings.lanes * settings.profile.lane_width_m + 2 * SHOULDER_M) * _scale(moment))
    status = HEADER + road + MARKS
    if plan is not None:
        status = HEADER + round(PLAN_M[1] * _scale(moment)) + MARKS // 2
    caption_at = status + STATUS
    legend = caption_at + (LINE if caption else 0)
    height = legend + LINE * (1 + len(colours) // LEGEND_COLUMNS) + 12
    image = Image.new("RGB", (WIDTH, height), PAPER)
    draw = ImageDraw.Draw(image)
    if plan is None:
        _draw_road(draw, moment)
    else:
        _draw_network(draw, moment, plan)
    present = moment.present if plan is None else plan.present
    for vehicle, agent in enumerate(moment.agents):
        colour = EGO if vehicle == moment.ego else colours[agent]
        if plan is not None and plan.is_obstacle[vehicle]:
            colour = INK
        if present[vehicle]:
            _draw_vehicle(draw, moment, vehicle, colour)
    if plan is not None:  # what lies outside the part that is shown
        draw.rectangle([0, 0, WIDTH, HEADER], PAPER)
        draw.rectangle([0, status - MARKS // 2, WIDTH, height], PAPER)
    _draw_header(draw, moment)
    _draw_status(draw, moment, status)
    sentence = caption[:1].upper() + caption[1:]
    font = _fitting(sentence, WIDTH - 2 * MARGIN, 26, "-Bold")
    draw.text((MARGIN, caption_at + 22), sentence, INK, font, "lm")
    driver = moment.agents[moment.ego]
    entries = [(f"ego, {driver}" if driver else "ego", EGO), *colours.items()]
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


def _fitting(text: str, width: float, size: int, weight: str = "") -> ImageFont.FreeTypeFont:
    """The font of a size, or a smaller one in which the text is no wider than a width."""
    needed = _font(size, weight).getlength(text)
    return _font(size if needed <= width else max(SMALLEST, int(size * width / needed)), weight)


def _place(moment: Moment, x: Floats, y: Floats) -> list[float]:
    """Returns where points of the road (K,) are in the picture, as x, y, x, y and so on."""
    if moment.plan is None:
        start = moment.x[moment.ego] - BEHIND_M
        edge = -moment.settings.profile.lane_width_m / 2 - SHOULDER_M
    else:
        start = moment.plan.x[moment.ego] - PLAN_M[0] / 2
        edge = moment.plan.y[moment.ego] - PLAN_M[1] / 2
    scale = _scale(moment)
    places = np.stack([(x - start) * scale, HEADER + (y - edge) * scale], axis=-1)
    return list(places.ravel().tolist())


def _scale(moment: Moment) -> float:
    """Pixels per metre, along and across the road, before the reduction."""
    return WIDTH / (BEHIND_M + moment.ahead_m if moment.plan is None else PLAN_M[0])


def _draw_network(draw: ImageDraw.ImageDraw, moment: Moment, plan: Plan) -> None:
    def placed(points: Floats) -> list[float]:
        return _place(moment, points[:, 0], points[:, 1])

    for surface in plan.lines.surfaces:
        draw.polygon(placed(surface), ASPHALT)
    for line in plan.lines.continuous:
        draw.line(placed(line), PAINT, 4)
    for line in plan.lines.striped:
        for k in range(0, len(line) - 1, 4):
            draw.line(placed(line[k : k + 2]), PAINT, 4)


def _draw_road(draw: ImageDraw.ImageDraw, moment: Moment) -> None:
    width, lanes = moment.settings.profile.lane_width_m, moment.settings.lanes
    start = moment.x[moment.ego] - BEHIND_M
    end = start + BEHIND_M + moment.ahead_m
    borders = np.arange(lanes + 1) * width - width / 2
    sides = np.array([borders[0] - SHOULDER_M, borders[-1] + SHOULDER_M])
    road = _place(moment, np.array([start, end]), sides)
    draw.rectangle(road, ASPHALT)
    for border in borders:
        solid = border in (borders[0], borders[-1])
        # Dashes of 6 m and gaps of 12 m, as on a motorway.
        dashes = np.array([start]) if solid else np.arange(np.floor(start / 18) * 18, end, 18)
        for dash in dashes:
            ends = np.array([dash, end if solid else dash + 6.0])
            draw.line(_place(moment, ends, np.full(2, border)), PAINT, 4)
    for mark in np.arange(np.ceil(start / 20) * 20, end, 20):
        x, bottom = _place(moment, np.array([mark]), sides[1:])
        draw.line([x, bottom, x, bottom + 8], PALE, 2)
        draw.text((x, bottom + 22), f"{mark:,.0f} m", PALE, _font(20), "mm")


def _draw_vehicle(draw: ImageDraw.ImageDraw, moment: Moment, vehicle: int, colour: str) -> None:
    where: Moment | Plan = moment.plan or moment
    x, y, heading = where.x[vehicle], where.y[vehicle], where.heading[vehicle]
    margin = max(10, moment.length[vehicle])
    shown = (BEHIND_M, moment.ahead_m) if moment.plan is None else (PLAN_M[0] / 2, PLAN_M[0] / 2)
    if not -margin < x - where.x[moment.ego] + shown[0] < sum(shown) + margin:
        return
    profile = moment.settings.profile
    ahead = np.array([np.cos(heading), np.sin(heading)])
    aside = np.array([-ahead[1], ahead[0]])
    half_length, half_width = moment.length[vehicle] / 2, moment.width[vehicle] / 2

    def shape(*corners: tuple[float, float]) -> list[float]:
        """Returns a shape whose corners are given in halves of the vehicle's length and width."""
        along, across = (np.array(corners) * (half_length, half_width)).T[..., None]
        away = along * ahead + across * aside
        return _place(moment, x + away[:, 0], y + away[:, 1])

    crashed = moment.crashed[vehicle]
    body = [(-1.0, -1.0), (0.9, -1.0), (1.0, -0.6), (1.0, 0.6), (0.9, 1.0), (-1.0, 1.0)]
    draw.polygon(shape(*body), colour)
    if moment.acceleration[vehicle] < -BRAKE_LIGHT_MPS2:
        for side in (-1.0, 1.0):
            light = [(-1.0, side), (-0.8, side), (-0.8, side * 0.3), (-1.0, side * 0.3)]
            draw.polygon(shape(*light), BRAKE)
    aim = moment.target_lane[vehicle] * profile.lane_width_m - moment.y[vehicle]
    if moment.present[vehicle] and abs(aim) > 0.2 * profile.lane_width_m and not crashed:
        side = float(np.sign(aim))
        for end in (-1.0, 0.6):
            light = [(end, side * 1.4), (end + 0.4, side * 1.4), (end + 0.4, side), (end, side)]
            draw.polygon(shape(*light), INDICATOR)
    if crashed:
        draw.line(shape((-1.1, -1.3), (1.1, 1.3)), WRECK, 6)
        draw.line(shape((-1.1, 1.3), (1.1, -1.3)), WRECK, 6)
    label = "ego" if vehicle == moment.ego else str(vehicle)
    middle_x, middle_y = shape((0.0, 0.0))
    extent = np.abs(ahead[0]) * 2 * half_length + np.abs(aside[0]) * 2 * half_width
    font = _fitting(label, float(extent) * _scale(moment), 21, "-Bold")
    draw.text((middle_x, middle_y), label, PAPER, font, "mm")


def _draw_header(draw: ImageDraw.ImageDraw, moment: Moment) -> None:
    episode = "" if moment.episode is None else f"episode {moment.episode}"
    time, large, small = f"{moment.t_s:.1f} s", _font(34, "-Bold"), _font(26)
    room = WIDTH - 2 * MARGIN - 72 - small.getlength(episode) - large.getlength(time)
    font = _fitting(moment.title, room, 30, "-Bold")
    draw.text((MARGIN, HEADER / 2), moment.title, INK, font, "lm")
    end = MARGIN + font.getlength(moment.title)
    draw.text((end + 24, HEADER / 2 + 2), episode, PALE, small, "lm")
    draw.text((WIDTH - MARGIN, HEADER / 2), time, INK, large, "rm")


def status_of(moment: Moment) -> dict[str, str]:
    """The ego's state in words, each quantity with its unit."""
    ego = moment.ego
    aside = int(moment.target_lane[ego] - moment.lane[ego])
    if moment.crashed[ego]:
        doing = "crashed"
    elif moment.has_action[ego]:
        doing = moment.action_names[moment.action[ego]].replace("_", " ").lower()
    else:  # before the first decision, and under a driver model, which takes no meta-actions
        doing = f"to the {'right' if aside > 0 else 'left'}" if aside else "keeps its lane"
    gap, ttc = moment.gap_ahead, moment.ttc
    return {
        "ego's speed": f"{moment.speed[ego]:z.1f} m/s",
        "acceleration": f"{moment.acceleration[ego]:+z.1f} m/s²",
        "action": doing,
        "gap ahead": "–" if np.isnan(gap) else f"{gap:.1f} m",
        "TTC": f"{ttc:.1f} s" if ttc < TTC_SHOWN_S else "–",
    }


def _draw_status(draw: ImageDraw.ImageDraw, moment: Moment, top: int) -> None:
    """Draws the ego's state."""
    status = status_of(moment)
    for k, (what, value) in enumerate(status.items()):
        x = MARGIN + k * (WIDTH - 2 * MARGIN) / len(status)
        draw.text((x, top + 20), what, PALE, _font(22), "lm")
        draw.text((x, top + 58), value, INK, _font(32), "lm")

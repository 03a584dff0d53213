"""Draws a replayed episode as an animated GIF."""

from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from charms_bench.episodes.ego_view import EgoView, ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.foundation.files import MARK, check_ending, write_atomically
from charms_bench.world.picture import AHEAD_M, BRAKE, INDICATOR, WRECK, Moment, picture
from charms_bench.world.tracks import Motion

ENDING = ".gif"
HOLD_S = 2.0
COLOURS = 96
"""Size of the GIF's palette, which limits the size of the file."""


def animate(replay: Replay, path: Path, caption: str = "") -> None:
    """Writes an episode as a GIF; see `Replay.animate`."""
    check_ending(path, ENDING)
    frames = range(len(replay.t_s))
    view = ego_view(replay)

    def drawn(frame: int) -> Image.Image:
        return picture(moment_of(replay, view, frame), caption)

    shared = _palette(
        [drawn(frame) for frame in (*frames[:: max(1, len(frames) // 7)], frames[-1])]
    )
    pictures = (drawn(frame).quantize(palette=shared, dither=Image.Dither.NONE) for frame in frames)
    # A GIF counts in hundredths of a second; rounding times instead of steps adds up no error.
    moments = np.round(replay.t_s * 100).astype(int) * 10
    durations = [*np.diff(moments).tolist(), round(HOLD_S * 1000)]
    save = partial(next(pictures).save, format="GIF", save_all=True, append_images=pictures)
    write_atomically(path, partial(save, duration=durations, loop=0, comment=MARK))


def moment_of(replay: Replay, view: EgoView, frame: int) -> Moment:
    """Returns one simulation step of a replay; step 0 is the start of the episode."""
    return Moment(
        settings=replay.settings,
        title=replay.title,
        episode=replay.episode,
        t_s=replay.t_s[frame],
        ego=replay.ego,
        agents=replay.agents,
        action_names=replay.action_names,
        traffic=sorted({name for k, name in enumerate(replay.agents) if k != replay.ego}),
        gap_ahead=view.gap_ahead[frame],
        ttc=view.ttc[frame],
        ahead_m=max(AHEAD_M, view.reach_m),
        plan=replay.plan and replay.plan.at(frame),
        **{field.name: getattr(replay, field.name)[frame] for field in fields(Motion)},
    )


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

"""`watch`: an episode, shown while it is simulated."""

import os
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from typer import Argument, Option

import charms_bench
from charms_bench.cli import arguments
from charms_bench.cli.terminal import app, interruptible, out, say
from charms_bench.errors import InputError

if TYPE_CHECKING:
    from charms_bench.envs.watched_episode import Watched
    from charms_bench.envs.window import Window

WIDEST = 120
"""Most characters of the road in a terminal."""


@app.command(rich_help_panel=arguments.FAILURES)
def watch(
    agent: str = Argument(help="Ego: an installed agent, or the path of an ONNX file."),
    traffic: str | None = Option(
        None,
        help="Traffic model, or an agent that drives all other vehicles; the default is "
        "idm_mobil. With --suite, the label of one of its traffic models.",
    ),
    road: str | None = Option(
        None, help="With --suite, the label of one of its roads; the default is its only one."
    ),
    suite: Path | None = Option(
        None, help="Suite whose scene and traffic models to use: a YAML file or a name."
    ),
    seed: int | None = Option(
        None,
        min=0,
        max=2**64 - 1,
        help="Seed of the episode; the default is 0, or the suite's first one.",
    ),
    text: bool = Option(False, "--text", help="Draw in the terminal even if there is a display."),
) -> None:
    """Watch an agent drive an episode, in a window or in the terminal.

    The episode runs in real time. Without a display, the road is drawn with characters. If the
    output is not a terminal, it has one picture per second of the episode.
    """
    from charms_bench.api.evaluation import cell_of
    from charms_bench.envs.watched_episode import Watched, plain

    charms_bench.warm_up()
    if suite is not None:
        simulation, title, first = cell_of(suite, agent, traffic, road)
    elif road is not None:
        raise InputError("--road needs --suite, a suite with `roads`")
    else:
        around = traffic or "idm_mobil"
        simulation, title, first = plain(agent, around), f"{agent} in {around}", 0
    seed = first if seed is None else seed
    watched = Watched(simulation, seed, title)
    with interruptible():
        window = None if text else _window(title)
        if window is not None:
            _in_window(watched, window)
        elif sys.stdout.isatty():
            _in_terminal(watched)
        else:
            _in_file(watched)
    say(f"{title}, episode {seed}: {ENDED[watched.ending]}")


ENDED = {
    "time": "drove until the time was over",
    "rear_end": "ended with a rear-end collision",
    "side": "ended with a side collision",
    "off_road": "left the road",
    "goal": "reached its goal",
}


def _window(title: str) -> "Window | None":
    """A window, or None if there is no display."""
    from charms_bench.envs.window import Window

    displays = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    if sys.platform == "linux" and not any(map(os.environ.get, displays)):
        return None  # asked for a display all the same, SDL prints an error of its own
    try:
        return Window(title)
    except InputError:
        return None


def _in_window(watched: "Watched", window: "Window") -> None:
    import numpy as np

    from charms_bench.world.picture import picture

    with closing(window):
        for moment in watched.moments():
            window.show(np.asarray(picture(moment)), watched.settings.simulation_hz)


def _in_terminal(watched: "Watched") -> None:
    from rich.live import Live

    from charms_bench.report.road import road

    with Live(console=out(), auto_refresh=False) as live:
        due = time.monotonic()
        for moment in watched.moments():
            live.update(road(moment, min(out().width, WIDEST)), refresh=True)
            due += 1 / watched.settings.simulation_hz
            time.sleep(max(0.0, due - time.monotonic()))


def _in_file(watched: "Watched") -> None:
    from charms_bench.report.road import road

    for frame, moment in enumerate(watched.moments()):
        if frame % watched.settings.simulation_hz == 0:
            out().print(road(moment, min(out().width, WIDEST)), "\n", soft_wrap=True)

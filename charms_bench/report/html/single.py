"""Pages of a single episode: a replay in a frame of a notebook, and two futures in a file."""

from base64 import b64encode
from pathlib import Path

from charms_bench.episodes.replay import Replay
from charms_bench.episodes.what_if import WhatIf
from charms_bench.foundation.files import check_ending, reject_foreign, write_bytes
from charms_bench.report.html.episode import for_page
from charms_bench.report.html.page import ENDINGS, render
from charms_bench.report.html.sections import what_if_section

HEIGHT_PX = 1000
ALONE = """
.top, nav, h1, .episodes, #definitions, #link { display: none !important; }
.frame, .replays { display: block; padding: 0; max-width: none; }
section { padding-top: 0; }
"""
"""Hides what a page of a single replay does not need."""


def replay_in_frame(replay: Replay, ghosts: Replay | None = None, since: int = 1) -> str:
    """A replay as HTML that needs nothing around it; another future is drawn as ghosts.

    The page is in the frame's address, because its scripts and styles must not meet those of the
    notebook.
    """
    shown = for_page(f"episode-{replay.episode}", replay, ghosts, since)
    title = f"{replay.title}, episode {replay.episode}"
    page = render([], title, [shown], has_ghosts=ghosts is not None)
    page = page.replace("</head>", f"<style>{ALONE}</style>\n</head>", 1)
    address = f"data:text/html;charset=utf-8;base64,{b64encode(page.encode()).decode()}"
    return (
        f'<iframe src="{address}" title="Replay" width="100%" height="{HEIGHT_PX}" '
        'style="border: 0"></iframe>'
    )


def write_what_if(found: WhatIf, path: Path) -> None:
    """Writes the table of two futures, and a replay with ghosts, into one HTML file."""
    check_ending(path, *ENDINGS)
    reject_foreign(path)
    section = what_if_section(found, "futures")
    shown = for_page(f"what-if-{found.recorded.episode}", found.recorded, found.other, found.step)
    write_bytes(path, render([section], section.title, [shown], has_ghosts=True).encode())

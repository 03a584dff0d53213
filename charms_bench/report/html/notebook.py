"""A replay in a notebook: the page with the player, in a frame of its own."""

from base64 import b64encode

from charms_bench.episodes.replay import Replay
from charms_bench.report.html.episode import for_page
from charms_bench.report.html.page import render

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
    page = render(
        [],
        title=f"{replay.cell.title}, episode {replay.episode}",
        replays=[shown],
        packed={shown["id"]: shown.pop("packed")},
        named=1,
        is_report=False,
        has_ghosts=ghosts is not None,
        provenance=[],
    )
    page = page.replace("</head>", f"<style>{ALONE}</style>\n</head>", 1)
    address = f"data:text/html;charset=utf-8;base64,{b64encode(page.encode()).decode()}"
    return (
        f'<iframe src="{address}" title="Replay" width="100%" height="{HEIGHT_PX}" '
        'style="border: 0"></iframe>'
    )

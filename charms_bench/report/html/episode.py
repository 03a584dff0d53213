"""One episode for a page: what its templates and its player need."""

from typing import Any

from charms_bench.episodes.criticality import criticality
from charms_bench.episodes.ego_view import ego_view
from charms_bench.episodes.replay import Replay
from charms_bench.episodes.what_happened import critical_time_s, what_happened
from charms_bench.report.figures.timelines import draw_timelines
from charms_bench.report.html.packed import pack
from charms_bench.report.html.svg import in_page

BEFORE_S = 3.0
"""A replay opens this long before its critical moment."""


def for_page(
    name: str, replay: Replay, ghosts: Replay | None = None, since: int = 1
) -> dict[str, Any]:
    """An episode for the page's templates and player; another future is drawn as ghosts.

    Its sentence and its criticality are those of the decisions from `since` on.
    """
    view = ego_view(replay)
    measured = criticality(replay.episodes, replay.steps, replay.settings, since)
    label = (
        "Over time: gaps ahead and behind, time to collision, speed and reward of "
        f"{replay.title}, episode {replay.episode}"
    )
    return {
        "id": name,
        "ego": replay.cell.ego.title,
        "surroundings": replay.cell.surroundings.title,
        "episode": replay.episode,
        "criticality": f"{measured['criticality'].item():z.2f}",
        "what": what_happened(replay, since=since),
        "start": f"{max(0.0, critical_time_s(replay, since) - BEFORE_S):z.1f}",
        "seconds": f"{replay.t_s[-1]:z.1f}",
        "timelines": in_page(draw_timelines(replay, view, ghosts), f"replay-{name}", label),
        "packed": pack(replay, view, ghosts),
    }

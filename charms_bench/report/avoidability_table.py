"""The table of avoidability: one row per collision of the ego."""

from collections import Counter
from collections.abc import Sequence

from charms_bench.episodes.avoidability import Avoidability
from charms_bench.foundation.words import counted
from charms_bench.report.table import Column, Table
from charms_bench.world.scene import SceneSettings

COLUMNS = (
    Column("collided_s", "s", "When the ego collided, since the start", form=".1f"),
    Column(
        "escape",
        "",
        "The last decision from which some sequence of the ego's meta-actions keeps it free of "
        "collisions until 2 s after the recorded one; `spawn`: none does from the first decision "
        "on; `unknown`: the budget of the search ended",
    ),
    Column("before_s", "s", "Time from that decision to the collision", form=".1f"),
    Column("avoided_by", "", "How many of the agents avoid the collision from that decision on"),
    Column(
        "single_action",
        "",
        "The latest meta-action of one vehicle within 50 m of the ego whose replacement avoids the "
        "collision: its decision, its vehicle, what it was and what avoids the collision",
    ),
)  # fmt: skip


def avoidability_table(found: Sequence[Avoidability], settings: SceneSettings) -> Table:
    """The table, with counts of the verdicts in its note."""
    road = ("road",) if any(each.road for each in found) else ()
    which = ("ego_index",) if any(each.ego_index is not None for each in found) else ()
    return Table.from_records(
        [_record(each, settings) for each in found],
        "avoidability",
        "Which collisions could have been avoided",
        ("agent", *road, "traffic", *which, "episode"),
        COLUMNS,
        note=in_words(found),
    )


def rescuers_table(found: Sequence[Avoidability], references: Sequence[str] = ()) -> Table:
    """How many of the avoidable collisions each agent avoids from the last decision on.

    `references` are the suite's drivers by which collisions are preventable.
    """
    avoided = Counter(name for each in found for name in each.avoided_by)
    tried = avoided + Counter(name for each in found for name in each.hit_by)
    records = [
        {"agent": name, "avoided": avoided[name], "of": tried[name]}
        for name in sorted(tried, key=lambda name: (-avoided[name], name))
    ]
    columns = (
        Column("avoided", "", "Collisions that the agent avoids", form=".0f"),
        Column("of", "", "Collisions that it was tried on", form=".0f"),
    )
    title = "Who avoids them, driving the ego from the last decision with an escape"
    avoid = "avoid" if len(references) > 1 else "avoids"
    note = bool(references) * (
        f"A collision is preventable, in contrast, if {' and '.join(references)} {avoid} it when "
        "driving the ego from the start of the episode."
    )
    name = "avoidability-agents"
    return Table.from_records(records, name, title, ("agent",), columns, note)


def in_words(found: Sequence[Avoidability]) -> str:
    """How many collisions have each verdict."""
    count = Counter(each.verdict for each in found)
    ended = " (the search ended; give it a larger --budget)" * bool(count["unknown"])
    single = sum(each.replacement is not None for each in found)
    return (
        f"{counted(len(found), 'collision')} of the ego: {count['avoidable']} avoidable by its "
        f"meta-actions, {count['spawn']} unavoidable from the first decision on (the spawn), "
        f"{count['unknown']} unknown{ended}. In {single}, replacing a single meta-action of one "
        "vehicle avoids the collision."
    )


def _record(each: Avoidability, settings: SceneSettings) -> dict[str, object]:
    record: dict[str, object] = {
        "agent": each.ego,
        "road": each.road,
        "traffic": each.traffic,
        "ego_index": each.ego_index,
        "episode": each.episode,
        "collided_s": each.collided_s,
        "escape": each.verdict,
        "avoided_by": "–",
        "single_action": "–",
    }
    if each.last_step is not None:
        tried = len(each.avoided_by) + len(each.hit_by)
        record["escape"] = f"decision {each.last_step}"
        record["before_s"] = each.collided_s - (each.last_step - 1) / settings.decision_hz
        record["avoided_by"] = f"{len(each.avoided_by)} of {tried}"
    if each.verdict == "unknown":
        record["escape"] = f"unknown after {counted(each.nodes, 'decision')}"
    if (r := each.replacement) is not None:
        who = "ego" if r.is_ego else f"vehicle {r.vehicle}"
        was, instead = (action.replace("_", " ").lower() for action in (r.was, r.instead))
        record["single_action"] = f"decision {r.step}, {who}: {instead} instead of {was}"
    return record

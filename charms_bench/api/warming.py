"""Compiles the engine ahead of its first use."""

from typing import TYPE_CHECKING

from charms_bench.foundation.progress import ENGINE, ENGINE_OF_ROADS, note, note_compiling, progress

if TYPE_CHECKING:
    from charms_bench.runs.suite import Suite


def warm_up() -> bool:
    """Compiles the engine, unless that has been done; returns whether it was necessary.

    Every installation does it once, for the processor that it runs on. The functions of this module
    that simulate, and the commands, begin with it.
    """
    from charms_bench.runs import warm_up as engine

    if engine.is_warm():
        return False
    note(f"compiling {ENGINE}")
    with progress("parts", len(engine.PARTS)) as tell:
        engine.compile_parts(tell)
    return True


def note_roads(suite: "Suite") -> None:
    """Says that a suite's first run on highway-env's roads compiles, if it does."""
    if suite.roads:
        from charms_bench.roads.agent_stepping import advance

        note_compiling(advance, ENGINE_OF_ROADS)

"""Compiles the engine ahead of its first use."""

from charms_bench.report.progress import note, progress


def warm_up() -> bool:
    """Compiles the engine, unless that has been done; returns whether it was necessary.

    Every installation does it once, for the processor that it runs on. The functions of this module
    that simulate, and the commands, begin with it.
    """
    from charms_bench.runs import warm_up as engine

    if engine.is_warm():
        return False
    note("compiling the engine (once, about half a minute)")
    with progress("parts", len(engine.PARTS)) as tell:
        engine.compile_parts(tell)
    return True

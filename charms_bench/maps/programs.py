"""Programs of traffic lights: how long a light is green or red."""

from collections.abc import Iterable

from charms_bench.maps.road_map import Program


def program_of(phases: Iterable[tuple[float, bool]], begins_s: float) -> Program:
    """The program of phases that follow each other, each with its duration, s, and whether it is
    green; the first one begins at a time after the start of an episode, s, and again each cycle.

    At least one duration is above 0.
    """
    every = [(duration, is_green) for duration, is_green in phases if duration > 0]
    since = -begins_s % sum(duration for duration, _ in every)
    found: list[tuple[float, str]] = []
    before = 0.0
    for duration, is_green in (*every, *every):
        # What lies behind the start of the episode, up to the same place in the next cycle.
        low = max(before, since)
        before += duration
        high = min(before, since + sum(seconds for seconds, _ in every))
        if high <= low:
            continue
        colour = "green" if is_green else "red"
        if found and found[-1][1] == colour:
            low -= found.pop()[0]
        found.append((round(high - low, 6), colour))
    return tuple(found)

"""The events that are built in, and the lowest level of each episode of a simulation."""

import numpy as np

from charms_bench.engine.simulation import Simulation
from charms_bench.errors import PLUGIN_ERRORS, AgentError, BrokenWordError, InputError, raised
from charms_bench.foundation.compiled import compiled
from charms_bench.plugins.consistency import CheckedEvent
from charms_bench.plugins.event import Event
from charms_bench.world.gaps import overlap
from charms_bench.world.road_network import Network
from charms_bench.world.scene import Floats, Ints, Scene

HORIZON_S = 100.0
"""A longer time to collision counts as this; also the cap of the metric `ttc_min`."""
HARMLESS_S2_PER_M = 100.0
"""The level of a crash if hardly any deceleration is needed, and the largest one."""
TOUCHING_S2_PER_M = 1e-9
"""Its level if vehicles touch; the engine decides whether they collide."""


class Crash(Event):
    """The ego collides or leaves the road, which ends an episode as in `crashed_episodes`.

    The level is 1 over the deceleration that avoids a collision, as in DRAC (Archer 2005): unlike
    TTC, it tells a fast approach, which a driver may not be able to stop, from a slow one.
    """

    definition = "the ego collides or leaves the road"
    includes_failure = True
    sees_network = True

    def level(self, scene: Scene, rows: Ints) -> Floats:
        _, inverse_decelerations = _closest(scene, rows)
        return np.maximum(inverse_decelerations, TOUCHING_S2_PER_M)


class TimeToCollision(Event):
    """The ego's time to collision falls to a threshold.

    Args:
        below_s: The threshold, s.

    Raises:
        InputError: The threshold is not a time above 0 and below the horizon.
    """

    includes_failure = True
    sees_network = True

    def __init__(self, below_s: float = 1.0) -> None:
        if isinstance(below_s, bool) or not isinstance(below_s, int | float):
            raise InputError(f"event 'ttc': below_s is {below_s!r}; expected a number of seconds")
        if not 0 < below_s < HORIZON_S:
            raise InputError(
                f"event 'ttc': below_s is {below_s}; expected more than 0 and less than "
                f"{HORIZON_S:g} seconds"
            )
        self.definition = (
            f"the ego's TTC falls to {below_s:g} s or less: its rectangle touches that of another "
            "vehicle within this time if both keep their velocities; or it collides or leaves the "
            "road"
        )
        self._below_s = below_s

    def level(self, scene: Scene, rows: Ints) -> Floats:
        times, _ = _closest(scene, rows)
        return np.asarray(times - self._below_s)


def lowest_levels(simulation: Simulation, event: Event) -> Floats:
    """Runs all episodes of a simulation to their ends and returns the lowest level (B,) of each.

    The level of an episode in which an event happens that includes failures is at most 0.

    Raises:
        AgentError: An agent fails, or the event's levels are unusable.
    """
    lowest = np.full(simulation.seeds.size, np.inf)
    on_network, shown = simulation.settings.network is not None, simulation.scene.read_only()
    while (rows := np.nonzero(simulation.scene.active)[0]).size:
        for _ in range(simulation.settings.steps_per_decision):
            simulation.advance()
            if on_network:  # where the ego's view is made when it is asked for
                seen = simulation.engine.state if event.sees_network else simulation.scene
                shown = seen.read_only()
            lowest[rows] = np.minimum(lowest[rows], _checked(event, shown, rows))
        simulation.finish_step()
    if event.includes_failure:
        lowest[simulation.failed] = np.minimum(lowest[simulation.failed], -1.0)
    return lowest


def _closest(scene: Scene, rows: Ints) -> tuple[Floats, Floats]:
    return (closest_on_network if isinstance(scene.road, Network) else closest)(scene, rows)


def _checked(event: Event, scene: Scene, rows: Ints) -> Floats:
    name = type(event.plugin if isinstance(event, CheckedEvent) else event).__name__
    try:
        levels = np.asarray(event.level(scene, rows), dtype=np.float64)
    except BrokenWordError as error:
        raise AgentError(f"event '{name}': {error}") from error
    except PLUGIN_ERRORS as error:
        what = raised(error)
    else:
        if levels.shape == rows.shape and not np.isnan(levels).any():
            return levels
        what = f"returned shape {levels.shape}, or NaN; expected {rows.shape} numbers"
    raise AgentError(f"event '{name}': level {what}")


@compiled
def beside(
    scene: Scene, speed: Floats, b: int, i: int, j: int
) -> tuple[float, float, float, float, float, float]:
    """How far vehicle j is ahead of vehicle i and beside it, m, and its relative velocity, m/s.

    The last two numbers are the sums of the lengths and of the widths, m, where vehicle j is the
    rectangle along vehicle i that contains it. `speed` [B, N] is that of the vehicles.
    """
    cos, sin = scene.direction_x[b, i], scene.direction_y[b, i]
    dx, dy = scene.x[b, j] - scene.x[b, i], scene.y[b, j] - scene.y[b, i]
    own_x, own_y = scene.direction_x[b, j], scene.direction_y[b, j]
    forward, sideward = own_x * cos + own_y * sin, own_y * cos - own_x * sin
    long, wide = scene.length[b, j], scene.width[b, j]
    return (
        dx * cos + dy * sin,
        dy * cos - dx * sin,
        speed[b, j] * forward - speed[b, i],
        speed[b, j] * sideward,
        scene.length[b, i] + long * abs(forward) + wide * abs(sideward),
        scene.width[b, i] + long * abs(sideward) + wide * abs(forward),
    )


@compiled
def overlapping(
    ahead: float, aside: float, along: float, across: float, length: float, width: float
) -> tuple[float, float, float]:
    """When two rectangles begin and cease to overlap, s, and how fast they then close in, m/s.

    They overlap along the sides of the first, in both directions; if they never do, they begin
    after they cease. The arguments are what `beside` returns.
    """
    begin, end = overlap(ahead, along, length / 2)
    start, stop = overlap(aside, across, width / 2)
    return max(begin, start), min(end, stop), abs(along) if begin >= start else abs(across)


@compiled
def closest_on_network(scene: Scene, rows: Ints) -> tuple[Floats, Floats]:
    """As `closest`, among vehicles of any direction.

    Two rectangles touch where they overlap along the sides of both.
    """
    times = np.full(rows.size, HORIZON_S)
    inverse_decelerations = np.full(rows.size, HARMLESS_S2_PER_M)
    for r in range(rows.size):
        b = rows[r]
        ego = scene.ego[b]
        for i in range(scene.x.shape[1]):
            if i == ego or not scene.present[b, i]:
                continue
            begin, end, closing = overlapping(*beside(scene, scene.speed, b, ego, i))
            start, stop, closing_there = overlapping(*beside(scene, scene.speed, b, i, ego))
            time = max(begin, start, 0.0)
            if time > min(end, stop):
                continue
            closing = closing if begin >= start else closing_there
            times[r] = min(times[r], time)
            if 2 * time < inverse_decelerations[r] * closing:
                inverse_decelerations[r] = 2 * time / closing
    return times, inverse_decelerations


@compiled
def closest(scene: Scene, rows: Ints) -> tuple[Floats, Floats]:
    """How close each ego is to touching another vehicle, if all keep their velocities.

    Vehicles are rectangles along the road. They touch once they overlap both along the road and
    across it; a deceleration in the direction in which they overlap last avoids that. Returns the
    least time (R,) until the ego touches a vehicle, s, at most `HORIZON_S`; and 1 over the largest
    deceleration (R,) needed, s²/m, at most `HARMLESS_S2_PER_M`.
    """
    times = np.full(rows.size, HORIZON_S)
    inverse_decelerations = np.full(rows.size, HARMLESS_S2_PER_M)
    for r in range(rows.size):
        b = rows[r]
        ego = scene.ego[b]
        ahead = scene.speed[b, ego] * scene.direction_x[b, ego]
        aside = scene.speed[b, ego] * scene.direction_y[b, ego]
        for i in range(scene.x.shape[1]):
            if i == ego:
                continue
            begin, end, closing = overlapping(
                scene.x[b, i] - scene.x[b, ego],
                scene.y[b, i] - scene.y[b, ego],
                scene.speed[b, i] * scene.direction_x[b, i] - ahead,
                scene.speed[b, i] * scene.direction_y[b, i] - aside,
                scene.length[b, i] + scene.length[b, ego],
                scene.width[b, i] + scene.width[b, ego],
            )
            time = max(begin, 0.0)
            if time > end:
                continue
            times[r] = min(times[r], time)
            if 2 * time < inverse_decelerations[r] * closing:
                inverse_decelerations[r] = 2 * time / closing
    return times, inverse_decelerations

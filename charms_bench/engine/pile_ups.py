"""Which concrete scenarios are none: those in which prescribed vehicles collide with one another.

A prescribed vehicle moves as the scenario says, whatever the ego does. If two of them collide, the
scenario prescribes what cannot happen, and an ego that meets the wreck did not fail.
"""

import numpy as np

from charms_bench.engine import Cast, MakeEngine
from charms_bench.engine.batched import BatchedEngine
from charms_bench.engine.prescribed import Script
from charms_bench.engine.seats import vacate
from charms_bench.world.scene import Bools, Ints, SceneSettings

AT_ONCE = 2**14
"""Vehicles that are moved together."""


def pile_ups(settings: SceneSettings, numbers: Ints, engine: MakeEngine = BatchedEngine) -> Bools:
    """(R,) whether prescribed vehicles collide at the points (R,) of the settings' scenario.

    They move without the ego and without the vehicles of agents, until the end of an episode. On a
    road with obstacles, a collision with one of them counts, too.
    """
    found = np.zeros(numbers.size, dtype=np.bool_)
    scenario = settings.scenario
    if scenario is None or sum(each.agent is None for each in scenario.vehicles) < 2:
        return found
    is_there = np.array([False, *(each.agent is None for each in scenario.vehicles)])
    at_once = max(1, AT_ONCE // is_there.size)
    for first in range(0, numbers.size, at_once):
        part = numbers[first : first + at_once]
        found[first : first + at_once] = _collide(settings, part, is_there, engine)
    return found


def _collide(
    settings: SceneSettings, numbers: Ints, is_there: Bools, make_engine: MakeEngine
) -> Bools:
    assert settings.scenario is not None
    engine = make_engine(settings, numbers.size, Cast(prescribed=[0]))
    rows, seeds = np.arange(numbers.size), numbers.astype(np.uint64)
    scene, before_move = engine.state, None
    if settings.network is None:
        script = Script(settings.scenario, settings, numbers.size)
        script.place(scene, rows, numbers)
        scene.present[:], scene.entry[:] = is_there, np.arange(is_there.size)
        vacate(scene, rows)
        engine.restore(rows, seeds)
        is_prescribed = np.ones(scene.x.shape, dtype=np.bool_)

        def before_move() -> None:
            script.prescribe(scene, rows, is_prescribed)

    else:
        engine.reset(rows, seeds, np.zeros(scene.x.shape, dtype=np.int64))
        scene.present[:, np.nonzero(~is_there)[0]] = False
        engine.settle(rows, seeds)
    for _ in range(settings.decisions * settings.steps_per_decision):
        engine.advance(before_move=before_move)
    return np.asarray(scene.crashed[:, : is_there.size].any(axis=1))

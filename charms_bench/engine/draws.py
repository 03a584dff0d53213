"""The random draws of a scene, apart from the placement of its vehicles.

A scene of N vehicles follows from 4 N + 1 numbers in [0, 1), which are independent and uniform: one
for the ego's place, then four per vehicle in the order of spawning, for its lane, its speed, its
distance to the furthest vehicle before it, and its temperament. The ego's speed is fixed, so its
number has no effect. An integer from 0 to n - 1 is the integer part of n times its number.

On a road of highway-env, how many numbers an episode draws depends on the numbers: vehicles also
come while it lasts. Its generator draws the given ones in their order, and more from its seed.
"""

import numpy as np

from charms_bench.foundation.compiled import compiled
from charms_bench.foundation.generator import State, random, uniform_for_integers
from charms_bench.world.scene import Floats, SceneSettings

PER_VEHICLE = 8
"""How many numbers of an episode on a road are given: this, times the places for vehicles. Few
roads draw more for a vehicle, at an intersection 7: whether and where it comes, its place, its
speed, and how it drives."""
LANE, SPEED, DISTANCE, TEMPERAMENT = range(1, 5)
"""The columns of the first vehicle's draws; column 0 is the ego's place."""


def count_of(settings: SceneSettings) -> int:
    """D, the number of draws of an episode that can be given."""
    is_straight = settings.network is None
    return 4 * settings.vehicles + 1 if is_straight else PER_VEHICLE * settings.vehicles


def draws_of(generators: State, settings: SceneSettings) -> Floats:
    """Takes the draws (R, 4 N + 1) of R scenes from their generators (R, 6)."""
    return _draw(generators, settings.vehicles, settings.ego_slots, settings.lanes)


@compiled
def _draw(states: State, vehicles: int, ego_slots: int, lanes: int) -> Floats:
    """The draws of `Vehicle.create_random` in `HighwayEnv._create_vehicles`, vehicle by vehicle.

    The ego's temperament is drawn last, so that with one slot the draws are the same as in
    `highway-v0`.
    """
    draws = np.zeros((len(states), 1 + 4 * vehicles))
    for r in range(len(states)):
        state = states[r]
        draws[r, 0] = uniform_for_integers(state, ego_slots)
        ego = int(draws[r, 0] * ego_slots)
        for i in range(vehicles):
            draws[r, LANE + 4 * i] = uniform_for_integers(state, lanes)
            if i != ego:
                draws[r, SPEED + 4 * i] = random(state)
            draws[r, DISTANCE + 4 * i] = random(state)
            if i != ego:
                draws[r, TEMPERAMENT + 4 * i] = random(state)
        draws[r, TEMPERAMENT + 4 * ego] = random(state)
    return draws


class ReplayedDraws:
    """Gives a scene's draws to highway-env in the order in which it asks its random generator."""

    def __init__(self, draws: Floats, settings: SceneSettings) -> None:
        ego = int(draws[0] * settings.ego_slots)
        is_drawn = np.ones(draws.size, dtype=np.bool_)
        is_drawn[[SPEED + 4 * ego, TEMPERAMENT + 4 * ego]] = False
        left = [*draws[is_drawn].tolist(), float(draws[TEMPERAMENT + 4 * ego])]
        self._left: list[float] = left[::-1]

    def integers(self, low: int, high: int) -> int:
        """Returns an integer from `low` to `high` - 1."""
        return low + int(self._left.pop() * (high - low))

    def choice(self, options: int | list[str]) -> int | str:
        """Returns an integer below a number, or the only element of a list, which takes no draw."""
        if isinstance(options, int):
            return self.integers(0, options)
        (only,) = options
        return only

    def uniform(self, low: float, high: float) -> float:
        """Returns a number from `low` to `high`."""
        return low + (high - low) * self._left.pop()

    def random(self) -> float:
        """Returns a number in [0, 1)."""
        return self._left.pop()

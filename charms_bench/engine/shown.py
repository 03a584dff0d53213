"""What plugins see of the scenes of an engine."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.seats import vacate
from charms_bench.engine.views import Views
from charms_bench.world.moments import Moments
from charms_bench.world.plan import Plan
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles


class Shown:
    """Has the read-only views of a scene's arrays, which a copy of the engine makes anew.

    Copies of views would be arrays of their own, in which nothing ever happens.
    """

    scene: Scene
    restore: Any
    has_goal = False
    renewal_steps = arrivals = 0
    egos = 1
    ego_index = 0
    moments: Moments | None = None

    def renew(self, rows: Ints, agents: Ints, times_s: Floats) -> Vehicles:
        """None, since no road lets vehicles enter."""
        return rows[:0], rows[:0]

    def settle(self, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        vacate(self.scene, rows)
        self.restore(rows, seeds)

    def check(self, state: Any) -> None:
        """Nothing is wrong, since the file of a state was checked."""

    def views(self) -> Views:
        """None: along the straight road, all vehicles see the same."""
        raise NotImplementedError

    def plan(self, row: int) -> Plan | None:
        """None, since the road is straight."""
        return None

    @cached_property
    def _shown(self) -> Scene:
        return self.scene.read_only()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_shown"}

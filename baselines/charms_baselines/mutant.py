"""IDM+MOBIL with one fault of a known size, to measure how well traffic finds faults."""

import numpy as np

from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.yielding_idm_mobil import YieldingIdmMobil
from charms_bench import DriverModel
from charms_bench.errors import InputError
from charms_bench.world.candidate_lanes import LEFT, RIGHT
from charms_bench.world.scene import Floats, Ints, Scene, Vehicles

LONGEST_DELAY = 8


class Mutant(DriverModel):
    """IDM+MOBIL with a fault; without options, it is IDM+MOBIL.

    Within the values of one option, a larger fault is a worse driver. Between options, nothing is
    known of the order.

    Args:
        headway: The desired time headway, as a proportion of the profile's.
        delay: By how many of its decisions its accelerations are late. An ego decides once per
            decision interval if the profile's `ego_control_rate` says so.
        blind_m: It does not see a follower on a side lane, up to this far behind, centre to centre.
        imposes_mps2: The limit on the braking that a lane change imposes on the new follower; by
            default, the profile's.
        critical: It gives way, with critical headways of this proportion of the Highway Capacity
            Manual's; by default, it does not give way. See `yielding_idm_mobil`.

    Raises:
        InputError: An option is out of range.
    """

    def __init__(
        self,
        headway: float = 1.0,
        delay: int = 0,
        blind_m: float = 0.0,
        imposes_mps2: float | None = None,
        critical: float | None = None,
    ) -> None:
        limits = (
            ("headway", headway, 0.0, 10.0),
            ("delay", delay, 0, LONGEST_DELAY),
            ("blind_m", blind_m, 0.0, 1e4),
            ("imposes_mps2", imposes_mps2 or 0.0, 0.0, 100.0),
            ("critical", critical or 0.0, 0.0, 10.0),
        )
        for name, value, low, high in limits:
            if not low <= value <= high:
                raise InputError(f"mutant: {name} is {value}; expected {low} to {high}")
        if delay != int(delay):
            raise InputError(f"mutant: delay is {delay}; expected a whole number of decisions")
        self._headway, self._delay, self._blind_m = headway, int(delay), blind_m
        self._imposes = imposes_mps2
        self._driver: DriverModel = IdmMobil()
        if critical is not None:
            self._driver = YieldingIdmMobil(critical)
        self.memory_width = self._delay

    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        p = scene.constants.idm_mobil
        p = p._replace(time_headway_s=self._headway * p.time_headway_s)
        if self._imposes is not None:
            p = p._replace(imposed_braking_mps2=self._imposes)
        seen = scene if self._blind_m == 0 else self._unseeing(scene, vehicles)
        seen = seen._replace(constants=scene.constants._replace(idm_mobil=p))
        acceleration, target_lane = self._driver.drive(seen, vehicles)
        for k in range(self._delay):
            at = (*vehicles, np.full(vehicles[0].size, k))
            earlier = scene.memory[at]
            scene.memory[at] = acceleration
            acceleration = earlier
        return acceleration, target_lane

    def _unseeing(self, scene: Scene, vehicles: Vehicles) -> Scene:
        """The scene without the followers that the drivers do not see."""
        followers = scene.followers.copy()
        for candidate in (LEFT, RIGHT):
            at = (*vehicles, np.full(vehicles[0].size, candidate))
            behind = followers[at]
            apart = scene.x[vehicles] - scene.x[vehicles[0], np.maximum(behind, 0)]
            followers[at] = np.where((behind >= 0) & (apart <= self._blind_m), -1, behind)
        return scene._replace(followers=followers)

"""Where drawn vehicles start [`Vehicle.create_random`, `HighwayEnv._create_vehicles`]."""

import math
from typing import NamedTuple

from charms_bench.engine.draws import DISTANCE, LANE, SPEED, TEMPERAMENT
from charms_bench.engine.neighbours import locate
from charms_bench.foundation import maths
from charms_bench.foundation.compiled import compiled_of_scenes
from charms_bench.world.gaps import overhang
from charms_bench.world.road import position
from charms_bench.world.scene import Floats, Ints, Scene, SceneSettings


class SpawnRule(NamedTuple):
    """How `spawn` draws vehicles; SI units."""

    lanes: int
    ego_speed: float
    ego_spacing: float
    spacing: float
    crowding: float
    """highway-env's factor for all distances; it falls with the number of lanes."""
    speed_low: float
    speed_high: float


def spawn_rule(settings: SceneSettings) -> SpawnRule:
    """[`HighwayEnv._create_vehicles` and `Vehicle.create_random`]"""
    profile, spacing = settings.profile, 1 / settings.density
    return SpawnRule(
        lanes=settings.lanes,
        ego_speed=profile.ego_speed_mps,
        ego_spacing=profile.ego_spacing or spacing,
        spacing=spacing,
        crowding=maths.exp(-5 / 40 * settings.lanes),
        speed_low=profile.spawn_speed_low * profile.speed_limit_mps,
        speed_high=profile.spawn_speed_high * profile.speed_limit_mps,
    )


@compiled_of_scenes
def spawn(scene: Scene, rows: Ints, draws: Floats, rule: SpawnRule) -> None:
    """Places new vehicles in the scenes `rows` (R,) by their draws (R, 4 N + 1); see `draws`.

    The rule is that of `Vehicle.create_random` in `HighwayEnv._create_vehicles`. The scenes have
    their egos and the sizes of their vehicles already.
    """
    x, speed, lane, temperament = scene.x, scene.speed, scene.lane, scene.temperament
    length, standard = scene.length, scene.constants.length
    for r in range(rows.size):
        b, drawn = rows[r], draws[r]
        ego = scene.ego[b]
        furthest, last = 0.0, -1
        for i in range(x.shape[1]):
            lane[b, i] = int(drawn[LANE + 4 * i] * rule.lanes)
            if i == ego:
                speed[b, i], spacing = rule.ego_speed, rule.ego_spacing
            else:
                span = rule.speed_high - rule.speed_low
                speed[b, i] = rule.speed_low + span * drawn[SPEED + 4 * i]
                spacing = rule.spacing
            offset = spacing * (12 + 1.0 * speed[b, i]) * rule.crowding
            x[b, i] = 3 * offset if i == 0 else furthest
            x[b, i] += offset * (0.9 + (1.1 - 0.9) * drawn[DISTANCE + 4 * i])
            if i > 0:  # as far apart as two vehicles of the profile's length, bumper to bumper
                own, other = overhang(length[b, i], standard), overhang(length[b, last], standard)
                x[b, i] += own + other
            if x[b, i] > furthest:
                furthest, last = x[b, i], i
            temperament[b, i] = drawn[TEMPERAMENT + 4 * i]
            scene.order[b, i] = scene.rank[b, i] = i
        for i in range(x.shape[1]):
            _, scene.y[b, i] = position(scene.road, lane[b, i], x[b, i], 0.0)
            scene.target_lane[b, i] = lane[b, i]
            phase = (x[b, i] + scene.y[b, i]) * math.pi  # as IDMVehicle.__init__
            scene.timer_s[b, i] = phase % scene.constants.idm_mobil.lane_change_period_s
            scene.heading[b, i] = scene.acceleration[b, i] = scene.steering[b, i] = 0.0
            scene.crashed[b, i] = scene.impact[b, i] = False
        scene.active[b] = True
    locate(scene, rows)

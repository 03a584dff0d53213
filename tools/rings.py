"""Rings of one lane: when waves grow on them, by simulation and by linear theory.

A ring is a row of vehicles whose first one follows an image of the last one, one circumference
ahead. Linear theory: Wilson & Ward 2011; Treiber & Kesting 2013, section 15.4.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from charms_bench.engine import Cast
from charms_bench.engine.batched import BatchedEngine
from charms_bench.plugins.agent import DriverModel
from charms_bench.plugins.registry import make_agent
from charms_bench.world.idm_mobil import equilibrium_gap
from charms_bench.world.profile import PROFILES, IdmMobilConstants
from charms_bench.world.scene import Floats, SceneSettings

RING_VEHICLES = 100
SMALL_M, LARGE_M = 1e-3, 5.0
"""Displacements: one whose wave stays linear, and one whose wave becomes as large as it can."""
NO_LANE_CHANGES = {"lane_change_gain_mps2": 1e3}


def exponent(p: IdmMobilConstants) -> float:
    """The mean exponent of the drivers."""
    return (p.exponent_low + p.exponent_high) / 2


class Slopes(NamedTuple):
    """The derivatives of IDM's acceleration in equilibrium."""

    gap: float
    speed: float
    leader_faster: float
    """By the leader's speed minus the own speed."""


def equilibrium(density_per_km: float, p: IdmMobilConstants, desired: float) -> float:
    """The speed at which IDM keeps a density, m/s; its gap is centre to centre, 1 / density."""
    gap = 1000 / density_per_km

    def excess(speed: float) -> float:
        return 1 - (speed / desired) ** exponent(p) - (equilibrium_gap(speed, p) / gap) ** 2

    return float(brentq(excess, 0.0, desired))


def slopes(density_per_km: float, p: IdmMobilConstants, desired: float) -> Slopes:
    """The derivatives of IDM's acceleration at the equilibrium of a density."""
    gap, speed = 1000 / density_per_km, equilibrium(density_per_km, p, desired)
    delta, a, b = exponent(p), p.acceleration_mps2, p.deceleration_mps2
    wanted = equilibrium_gap(speed, p)
    free = delta * speed ** (delta - 1) / desired**delta
    return Slopes(
        gap=2 * a * wanted**2 / gap**3,
        speed=-a * (free + 2 * p.time_headway_s * wanted / gap**2),
        leader_faster=speed * wanted * np.sqrt(a / b) / gap**2,
    )


def critical_density(p: IdmMobilConstants, desired: float) -> float:
    """The density per km from which on long waves grow (Wilson & Ward 2011)."""

    def stability(density: float) -> float:
        f = slopes(density, p, desired)
        return f.speed**2 / 2 - f.leader_faster * f.speed - f.gap

    return float(brentq(stability, 12.0, 45.0))


def growth_rate(density_per_km: float, p: IdmMobilConstants, desired: float) -> float:
    """The rate 1/s at which the longest wave of the ring grows by linear theory."""
    f = slopes(density_per_km, p, desired)
    ahead = np.exp(2j * np.pi / RING_VEHICLES) - 1
    return float(np.roots([1, -f.speed - f.leader_faster * ahead, -f.gap * ahead]).real.max())


def ring(
    profile: str, desired: float, densities: Floats, seconds: float, displacement_m: float = SMALL_M
) -> tuple[Floats, Floats]:
    """What becomes of a displacement, a sine of one period, on rings of several densities.

    The growth rates (D,) of the longest wave, 1/s, and the vehicles' speeds (D, N) at the end.
    """
    length = desired * seconds + 2e5 / densities.min()
    settings = SceneSettings.model_validate(
        {
            "profile": {"name": profile, "road_length_m": length, "idm_mobil": NO_LANE_CHANGES},
            "lanes": 2,
            "traffic_vehicles": RING_VEHICLES,
            "ego_slots": 1,
        }
    )
    rows, idm = np.arange(densities.size), make_agent("idm_mobil")
    assert isinstance(idm, DriverModel)
    engine = BatchedEngine(settings, densities.size, Cast({1: idm}))
    seeds = np.zeros(densities.size, dtype=np.uint64)
    engine.reset(rows, seeds, np.repeat([[0] + [1] * RING_VEHICLES], densities.size, axis=0))
    scene, gap = engine.scene, 1000 / densities[:, None]
    number = np.arange(1, RING_VEHICLES + 1)
    p = PROFILES[profile].idm_mobil
    scene.x[:, 1:] = number * gap + displacement_m * np.sin(2 * np.pi * number / RING_VEHICLES)
    scene.x[:, 0] = (RING_VEHICLES + 1) * gap[:, 0]
    scene.speed[:] = [[equilibrium(density, p, desired)] for density in densities]
    for name, value in {"y": 0.0, "target_lane": 0, "temperament": 0.5}.items():
        getattr(scene, name)[:] = value
    scene.target_speed[:] = desired
    engine.restore(rows, seeds)
    wave, steps = np.exp(2j * np.pi * number / RING_VEHICLES), round(seconds * 15)
    sizes = []
    for _ in range(steps):
        scene.x[:, 0] = scene.x[:, 1] + RING_VEHICLES * gap[:, 0]
        scene.speed[:, 0] = scene.speed[:, 1]
        engine.advance()
        sizes.append(np.abs(scene.speed[:, 1:] @ wave))
    # The wave has its own shape after some time, and must not have grown large.
    first, last = steps // 10, steps // 3
    rates = (np.log(sizes[last]) - np.log(sizes[first])) * 15 / (last - first)
    return rates, scene.speed[:, 1:].copy()

"""IDM+MOBIL drivers with their own parameters, against IDM+MOBIL with these constants."""

import numpy as np
from charms_baselines.idm_mobil import IdmMobil
from charms_baselines.varied_idm import VariedIdmMobil
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import all_vehicles, scene_of, scenes

from charms_bench.world.scene import Scene

RANGES = VariedIdmMobil.parameters


@settings(derandomize=True, deadline=None, max_examples=50)
@given(scenes(), st.tuples(*(st.floats(*bounds) for bounds in RANGES.values())))
def test_a_driver_is_idm_mobil_with_its_parameters(
    scene: Scene, parameters: tuple[float, ...]
) -> None:
    own = scene._replace(parameters=np.tile(np.array(parameters), (*scene.x.shape, 1)))
    constants = scene.constants.idm_mobil._replace(**dict(zip(RANGES, parameters, strict=True)))
    same = scene._replace(
        constants=scene.constants._replace(idm_mobil=constants), timer_s=scene.timer_s.copy()
    )
    found = VariedIdmMobil().drive(own.read_only(), all_vehicles(own))
    expected = IdmMobil().drive(same.read_only(), all_vehicles(same))
    np.testing.assert_array_equal(found, expected)


def test_two_drivers_in_the_same_place_differ_by_their_parameters() -> None:
    # (s* / gap)^2 of s* = 10 + 20 T, 40 m behind a leader of 20 m/s: 22 / 40 and 50 / 40.
    calm, hasty = ([1.0, 5.0, 10.0, headway, 0.0, 0.2, 2.0] for headway in (2.0, 0.6))
    scene = scene_of(
        x=[0.0, 40.0, 0.0, 40.0],
        y=[0.0, 0.0, 8.0, 8.0],
        speed=[20.0] * 4,
        parameters=[hasty, hasty, calm, calm],
    )
    found = VariedIdmMobil().drive(scene.read_only(), all_vehicles(scene))[0]
    np.testing.assert_allclose(found[[0, 2]], [-((22 / 40) ** 2), -((50 / 40) ** 2)])

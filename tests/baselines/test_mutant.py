"""IDM+MOBIL with a fault, against IDM+MOBIL and by hand."""

import naive
import numpy as np
import pytest
from charms_baselines.mutant import Mutant
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import all_vehicles, scene_of, scenes

from charms_bench.errors import InputError
from charms_bench.world.scene import Scene


@settings(derandomize=True, deadline=None, max_examples=50)
@given(scenes(), st.sampled_from([1.0, 0.4]), st.sampled_from([None, 6.0]))
def test_headway_and_imposed_braking_are_those_of_the_model(
    scene: Scene, headway: float, imposes: float | None
) -> None:
    p = scene.constants.idm_mobil
    p = p._replace(
        time_headway_s=headway * p.time_headway_s,
        imposed_braking_mps2=imposes or p.imposed_braking_mps2,
    )
    same = scene._replace(
        constants=scene.constants._replace(idm_mobil=p), timer_s=scene.timer_s.copy()
    )
    accelerations, targets = naive.idm_mobil(same)
    found = Mutant(headway=headway, imposes_mps2=imposes).drive(
        scene.read_only(), all_vehicles(scene)
    )
    assert list(found[1]) == targets
    np.testing.assert_allclose(found[0], accelerations, rtol=0, atol=1e-9)


def test_with_a_delay_accelerations_are_those_of_earlier_decisions() -> None:
    scene = scene_of(x=[0.0], y=[4.0], speed=[0.0], target_speed=[30.0], temperament=[0.5])
    scene = scene._replace(memory=np.zeros((1, 1, 2)))
    late, found = Mutant(delay=2), []
    assert late.memory_width == 2
    for speed in (0.0, 15.0, 30.0, 30.0):
        scene.speed[:] = speed
        found.append(late.drive(scene.read_only(), all_vehicles(scene))[0][0])
    # On a free road, a (1 - (v / v0)^4) with a = 3; before, nothing.
    assert found == pytest.approx([0.0, 0.0, 3.0, 3 * (1 - 0.5**4)])


@pytest.mark.parametrize(("blind_m", "lane"), [(0.0, 0), (1.9, 0), (2.0, 1)])
def test_a_vehicle_beside_it_is_not_seen_up_to_the_length_of_the_blind_spot(
    blind_m: float, lane: int
) -> None:
    scene = scene_of(
        lanes=2,
        x=[100.0, 130.0, 98.0],
        y=[0.0, 0.0, 4.0],
        speed=[25.0, 15.0, 25.0],
        target_speed=[30.0, 15.0, 30.0],
        timer_s=[2.0, 0.0, 0.0],
    )
    assert Mutant(blind_m=blind_m).drive(scene.read_only(), all_vehicles(scene))[1][0] == lane


@pytest.mark.parametrize(
    "options", [{"headway": -0.1}, {"delay": 9}, {"delay": 1.5}, {"blind_m": -1.0}]
)
def test_an_option_out_of_range_is_an_error(options: dict[str, float]) -> None:
    with pytest.raises(InputError, match=f"mutant: {next(iter(options))} is"):
        Mutant(**options)  # type: ignore[arg-type]

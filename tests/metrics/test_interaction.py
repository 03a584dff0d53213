from handmade_rows import measure

from charms_bench.metrics.interaction import INTERACTION_DENSITY

NEAR = {"leader_distance": 30.0, "leader_speed": 25.0}


def test_interaction_density_is_taken_in_logged_steps() -> None:
    steps = [{"vehicles_near": 4, **NEAR}, {"vehicles_near": 1, **NEAR}, {"vehicles_near": 9}]
    assert measure(INTERACTION_DENSITY, ({}, steps)) == 2.5

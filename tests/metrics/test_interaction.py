from handmade_rows import measure, of_paper

NEAR = {"leader_distance": 30.0, "leader_speed": 25.0}


def test_interaction_density_is_taken_in_logged_steps() -> None:
    steps = [{"vehicles_near": 4, **NEAR}, {"vehicles_near": 1, **NEAR}, {"vehicles_near": 9}]
    assert measure(of_paper("interaction_density"), ({}, steps)) == 2.5

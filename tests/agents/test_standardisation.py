"""Standardised observations, by hand."""

import numpy as np
import torch
from charms_agents.training.network import layers_of, untrained
from charms_agents.training.standardisation import FACTORS, folded, standardise, unfolded
from handmade_scene import simulation_of

from charms_bench.world.observations import COMMANDS, Neighbours, neighbours


def seen(*vehicles: tuple[float, int, float]) -> np.ndarray:
    """What the first vehicle (x, lane, speed) sees, standardised."""
    scene = simulation_of(*vehicles).scene
    observations = torch.from_numpy(neighbours(scene, (np.array([0]), np.array([0]))))
    rows: np.ndarray = standardise(observations.flatten(1)).numpy().reshape(7, 5)
    return rows


def test_an_ego_in_the_middle_at_28_mps_sees_itself_as_zeros() -> None:
    np.testing.assert_allclose(seen((500.0, 1, 28.0)), 0.0, atol=1e-6)


def test_the_ego_sees_its_lane_and_its_speed() -> None:
    np.testing.assert_allclose(seen((500.0, 2, 31.0))[0], [0, 0, 1, 3 / 6, 0], atol=1e-5)


def test_a_neighbour_is_seen_in_lanes_and_in_tens_of_metres() -> None:
    rows = seen((500.0, 1, 28.0), (520.0, 0, 25.0))  # left front: 20 m ahead, 3 m/s slower
    np.testing.assert_allclose(rows[1], [1, 20 / 40, -1, -3 / 6, 0], atol=1e-5)
    np.testing.assert_allclose(rows[2:], 0.0, atol=1e-6)


def test_unfolding_undoes_folding_except_for_inputs_without_effect() -> None:
    network = untrained((8,), 0)
    (weight, bias), *_ = layers_of(network)
    (found, found_bias), *_ = layers_of(unfolded(folded(network)))
    has_effect = FACTORS[:35].numpy() != 0
    np.testing.assert_allclose(found[:, has_effect], weight[:, has_effect], rtol=1e-6)
    np.testing.assert_array_equal(found[:, ~has_effect], 0.0)
    np.testing.assert_allclose(found_bias, bias, rtol=1e-5, atol=1e-6)


def test_commands_are_seen_in_metres_per_second_and_lanes() -> None:
    made = simulation_of((500.0, 1, 28.0), target_lane=0)
    scene, ego = made.scene, (np.array([0]), np.array([0]))
    scene.target_speed[0, 0], scene.acceleration[0, 0], scene.repeats[0, 0] = 30.0, -1.5, 2
    observed = torch.from_numpy(Neighbours(commands=True)(scene, ego)).flatten(1)
    row = standardise(observed).numpy().reshape(8, 5)[COMMANDS]
    np.testing.assert_allclose(row, [2.0, 2 / 4, -1.0, -0.5, 0.0], atol=1e-5)

"""Learning from human driving: the loss by hand, what is measured, and its determinism."""

import math
from typing import Any

import numpy as np
import polars as pl
import pytest
import torch
from charms_agents.human.samples import Samples
from charms_agents.training import rehearsal
from charms_agents.training.curve import Epoch
from charms_agents.training.hyperparameters import Supervised
from charms_agents.training.network import layers_of, network_of, untrained
from charms_agents.training.standardisation import folded
from charms_agents.training.supervised import (
    Fit,
    agreement,
    divergence,
    spread,
    squared_distance,
)
from handmade_scene import Idle

from charms_bench.plugins.traffic import OneAgent
from charms_bench.world.actions import IDLE
from charms_bench.world.observations import EGO, Neighbours
from charms_bench.world.scene import SceneSettings

THIRD = math.log(3)
"""Its softmax beside four zeros is 3/7, and theirs 1/7."""


def samples(count: int = 40, held_out: int = 10) -> Samples:
    """Drivers who go faster when the first number of what they see is positive, else slower."""
    rng = np.random.default_rng(0)
    observations = rng.normal(size=(count, 7, 5)).astype(np.float32)
    labels = np.zeros((count, 5), dtype=np.float32)
    labels[np.arange(count), np.where(observations[:, 0, 0] > 0, 3, 4)] = 1.0
    kept = np.arange(count) >= count - held_out
    return Samples(observations, labels, kept, pl.DataFrame())


def fitted(seed: int = 0, start: int = 0, data: Samples | None = None, **settings: Any) -> Fit:
    fit = Fit(untrained((8,), start), data or samples(), Supervised(**settings), seed)
    fit.learn()
    return fit


def test_the_divergence_is_that_of_the_network_from_the_label() -> None:
    values = torch.tensor([[THIRD, 0.0, 0.0, 0.0, 0.0]])
    labels = torch.tensor([[1.0, 0.0, 0.0, 0.0, 0.0]])
    # The label becomes (0.96, 0.01, 0.01, 0.01, 0.01).
    expected = 3 / 7 * math.log(3 / 7 / 0.96) + 4 / 7 * math.log(1 / 7 / 0.01)
    assert float(divergence(values, labels, floor=0.01)) == pytest.approx(expected, rel=1e-6)


def test_a_network_that_says_what_the_label_says_does_not_diverge() -> None:
    labels = torch.tensor([[0.5, 0.2, 0.1, 0.1, 0.1]])
    floored = labels * 0.9 + 0.02
    assert float(divergence(floored.log() + 7.0, labels, 0.02)) == pytest.approx(0.0, abs=1e-6)


def test_l2_anchoring_is_the_squared_distance_over_all_weights() -> None:
    now = [torch.tensor([[1.0, 2.0]]), torch.tensor([3.0])]
    before = [torch.tensor([[0.0, 4.0]]), torch.tensor([0.0])]
    assert float(squared_distance(now, before)) == 1.0 + 4.0 + 9.0


@pytest.mark.parametrize(
    ("values", "label", "agrees"),
    [
        ([1.0, 2.0, 0.0, 0.0, 0.0], [0.0, 0.7, 0.0, 0.3, 0.0], 1.0),
        ([1.0, 2.0, 0.0, 0.0, 0.0], [0.7, 0.3, 0.0, 0.0, 0.0], 0.0),
        # Two actions are equally probable by the label: either will do.
        ([0.0, 0.0, 0.0, 2.0, 0.0], [0.5, 0.0, 0.0, 0.5, 0.0], 1.0),
        # Two actions are worth the same to the network: it takes the first.
        ([0.0, 2.0, 0.0, 2.0, 0.0], [0.0, 0.0, 0.0, 1.0, 0.0], 0.0),
    ],
)
def test_agreement_is_taking_a_most_probable_action(
    values: list[float], label: list[float], agrees: float
) -> None:
    assert agreement(np.array([values], np.float32), np.array([label], np.float32)) == agrees


def test_the_first_point_of_the_curve_is_before_any_learning() -> None:
    fit = fitted(epochs=3, learning_rate=0.01)
    assert [point.epoch for point in fit.curve] == [0, 1, 2, 3]
    before = Fit(untrained((8,), 0), samples(), Supervised(), 0).curve
    assert fit.curve[0] == before[0]


def test_what_is_learnt_holds_for_held_out_drivers() -> None:
    fit = fitted(epochs=8, learning_rate=0.01, batch_size=8, pull=0.0, data=samples(400, 100))
    first, last = fit.curve[0], fit.curve[-1]
    assert last.loss < first.loss
    assert last.agreement is not None
    assert last.agreement > 0.8


def test_strong_l2_anchoring_keeps_the_network_where_it_started() -> None:
    start = layers_of(untrained((8,), 0))

    def moved(anchoring: float) -> float:
        layers = layers_of(fitted(epochs=20, learning_rate=0.01, pull=anchoring).network)
        pairs = zip(layers, start, strict=True)
        return float(sum(((w - v) ** 2).sum() + ((b - c) ** 2).sum() for (w, b), (v, c) in pairs))

    assert moved(anchoring=10.0) < 0.1 * moved(anchoring=0.0)


def test_the_first_step_follows_the_slope_of_the_whole_loss() -> None:
    # Adam's first step has the size of the learning rate, against the sign of the gradient; where
    # it starts L2 anchoring has none. With all values equal, p = 1/5 and the gradient of the
    # divergence with respect to a bias is p (log(p / y) - mean of log(p / y)): positive for the
    # labels' zeros, negative for their one.
    network = network_of([(np.zeros((5, 35), np.float32), np.zeros(5, np.float32))])
    data = samples(count=2, held_out=1)
    data.labels[:] = np.eye(5, dtype=np.float32)[2]
    fit = Fit(network, data, Supervised(learning_rate=0.001, pull=0.2), 0)
    fit.step()
    bias = layers_of(fit.network)[0][1]
    np.testing.assert_allclose(bias, [-0.001, -0.001, 0.001, -0.001, -0.001], rtol=1e-4)


def test_the_same_seed_gives_the_same_weights_and_another_seed_others() -> None:
    settings: dict[str, Any] = {"epochs": 3, "learning_rate": 0.01, "batch_size": 8}
    first, again, other = (layers_of(fitted(seed, **settings).network) for seed in (1, 1, 2))
    for (weight, bias), (same_weight, same_bias) in zip(first, again, strict=True):
        np.testing.assert_array_equal(weight, same_weight)
        np.testing.assert_array_equal(bias, same_bias)
    assert (first[0][0] != other[0][0]).any()


def test_an_interrupted_fit_goes_on_to_the_same_weights() -> None:
    settings: dict[str, Any] = {"epochs": 4, "learning_rate": 0.01, "batch_size": 8}
    whole = fitted(**settings)
    stopped = Fit(untrained((8,), 0), samples(), Supervised(**settings), 0)
    stopped.step()
    stored = {name: array.copy() for name, array in stopped.arrays().items()}
    resumed = Fit(untrained((8,), 0), samples(), Supervised(**settings), 0)
    resumed.load_arrays(stored)
    resumed.learn()
    assert resumed.curve == whole.curve
    for name, array in whole.arrays().items():
        np.testing.assert_array_equal(resumed.arrays()[name], array)


def test_without_held_out_samples_there_is_only_a_loss() -> None:
    (point,) = Fit(untrained((8,), 0), samples(held_out=0), Supervised(), 0).curve
    assert point == Epoch(0, point.loss, point.temperature, None, None)


def test_an_untrained_network_depends_on_its_seed_alone() -> None:
    before = torch.random.get_rng_state()
    first, again, other = (layers_of(untrained((8,), seed))[0][0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert torch.equal(torch.random.get_rng_state(), before)


def test_the_spread_is_the_standard_deviation_over_actions_but_at_least_1() -> None:
    # Deviations from the mean 4 are 4, 1, 1, 1 and 1, so the variance is 20 / 4.
    values = torch.tensor([[8.0, 3.0, 3.0, 3.0, 3.0]])
    assert spread(values) == pytest.approx(math.sqrt(5))
    assert spread(values / 100) == 1.0


def test_the_held_out_samples_do_not_decide_on_the_temperature() -> None:
    first, second = samples(), samples()
    second.labels[-10:] = 0.2
    curves = [Fit(untrained((8,), 0), data, Supervised(), 0).curve for data in (first, second)]
    assert curves[0][0].temperature == curves[1][0].temperature
    assert curves[0][0].log_likelihood != curves[1][0].log_likelihood


def test_l2_anchoring_is_on_the_weights_for_standardised_observations() -> None:
    start = folded(untrained((8,), 0))
    fit = Fit(start, samples(), Supervised(learning_rate=0.01, pull=0.3), 0, standardised=True)
    without_anchoring = Supervised(learning_rate=0.01, pull=0.0)
    without = Fit(start, samples(), without_anchoring, 0, standardised=True)
    for weights in (fit, without):
        with torch.no_grad():
            weights._parameters[0].add_(0.5)  # of 8 x 35 weights
    anchoring = fit._measured(0).loss - without._measured(0).loss
    assert anchoring == pytest.approx(0.3 * 8 * 35 * 0.25, rel=1e-3)


def test_what_is_rehearsed_changes_less() -> None:
    data, start = samples(200), untrained((8,), 0)
    own = np.random.default_rng(1).normal(2.0, 1.0, size=(300, 7, 5)).astype(np.float32)
    seen = torch.from_numpy(own.reshape(-1, 35))

    def change(rehearsal: float) -> float:
        settings = Supervised(learning_rate=0.01, epochs=20, pull=0.0, rehearsal=rehearsal)
        fit = Fit(start, data, settings, 0, own_driving=own)
        fit.learn()
        with torch.no_grad():
            return float((fit.network(seen) - start(seen)).var(dim=1).mean())

    assert change(rehearsal=10.0) < 0.1 * change(rehearsal=0.0)


def test_the_learning_rate_falls_over_the_last_epochs() -> None:
    falling = Supervised(learning_rate=0.8, epochs=4, learning_rate_decay=0.5)
    assert [falling.learning_rate_at(epoch) for epoch in (1, 2, 3, 4)] == [0.8, 0.8, 0.8, 0.4]
    constant = Supervised(learning_rate=0.8, epochs=4)
    assert [constant.learning_rate_at(epoch) for epoch in (1, 4)] == [0.8, 0.8]


def test_the_cross_entropy_is_that_of_the_label_and_smallest_at_its_probabilities() -> None:
    label = np.array([0.5, 0.2, 0.1, 0.1, 0.1], dtype=np.float32)
    data = samples(count=2, held_out=1)
    data.labels[:] = label

    def loss(probabilities: np.ndarray) -> float:
        layers = [(np.zeros((5, 35), np.float32), np.log(probabilities).astype(np.float32))]
        settings = Supervised(loss="cross_entropy", pull=0.0)
        return Fit(network_of(layers), data, settings, 0).curve[0].loss

    uniform = np.full(5, 0.2)
    assert loss(uniform) == pytest.approx(math.log(5))
    assert loss(label) == pytest.approx(-sum(p * math.log(p) for p in label.tolist()), rel=1e-6)
    for nearby in (0.98 * label + 0.02 * uniform, 1.02 * label - 0.02 * uniform):
        assert loss(nearby) > loss(label)


def test_own_driving_has_equally_many_episodes_in_each_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(rehearsal, "EPISODES", 20)
    alone = SceneSettings(traffic_vehicles=0, ego_slots=1, duration_s=1.0)
    longer = alone.model_copy(update={"duration_s": 2.0, "lanes": 5})
    places = [(alone, OneAgent("idle")), (longer, OneAgent("idle"))]
    drivers, seen = {"idle": Idle()}, Neighbours(commands=True)
    stays = network_of([(np.zeros((5, 40), np.float32), np.eye(5, dtype=np.float32)[IDLE])])
    found = rehearsal.own_driving(stays, places, drivers, 0, seen)
    # Ten episodes of 3 decisions, then ten of 6 decisions.
    assert found.shape == (10 * 3 + 10 * 6, 8, 5)
    lanes = np.rint(found[:, EGO, 2] * 12 / 4)
    assert lanes[:30].max() < 3 <= lanes[30:].max()

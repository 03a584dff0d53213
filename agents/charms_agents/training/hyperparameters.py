"""Hyperparameters: how a network learns by reinforcement, and how from samples.

Options that the paper lacks are written only where they are used, so that stages without them keep
their keys.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from charms_bench.foundation.fields import UNLESS_EMPTY, FrozenModel, NonNegative, Positive

Count = Annotated[int, Field(ge=1, le=10**9)]
Width = Annotated[int, Field(ge=1, le=4096)]
"""Number of neurons in a layer."""
Proportion = Annotated[float, Field(ge=0, le=1)]
UNLESS_1 = Field(exclude_if=lambda value: value == 1)


class Hyperparameters(FrozenModel):
    """Hyperparameters of Double DQN; a step is one decision of one ego."""

    learning_rate: Positive = 1e-4
    batch_size: Annotated[int, Field(ge=1, le=100_000)] = 32
    discount: Proportion = 0.99
    replay_buffer: Annotated[int, Field(ge=1, le=10_000_000)] = 50_000
    """Number of steps that are kept."""
    learning_starts: Annotated[int, Field(ge=0, le=10**9)] = 10_000
    """Steps before the first gradient step; their actions are random."""
    steps_per_gradient_step: Count = 2
    target_update_steps: Count = 500
    """Steps between two copies of the network to the target network."""
    exploration_initial: Proportion = 1.0
    exploration_final: Proportion = 0.05
    exploration_share: Annotated[Proportion, Field(alias="exploration_fraction")] = 0.1
    """Proportion of all steps over which exploration falls from initial to final."""
    max_gradient_norm: Positive = 10.0
    hidden_layers: Annotated[tuple[Width, ...], Field(strict=False, max_length=8)] = (256, 256)
    scenes: Annotated[int, Field(ge=1, le=1000)] = 10
    """Number of episodes simulated at the same time."""
    return_steps: Annotated[Count, UNLESS_1] = 1
    """Number of rewards in a target before the value (n-step returns)."""
    target_update_rate: Annotated[float, Field(gt=0, le=1), UNLESS_1] = 1.0
    """Weight of the network in an update of the target network; 1 copies it."""
    learning_rate_decay: Annotated[Proportion, UNLESS_EMPTY] = 0.0
    """Proportion of all steps, at the end, over which the learning rate falls to 0."""
    standardised: Annotated[bool, UNLESS_EMPTY] = False
    """Whether the network takes standardised observations, of order 1."""
    prior_weight: Annotated[NonNegative, UNLESS_EMPTY] = 0.0
    """Lambda: what a stage with a `prior` pays per nat that its policy departs from the prior."""
    starts_at_mean_reward: Annotated[bool, UNLESS_EMPTY] = False
    """Whether the untrained network's values are raised to the mean reward of the first, random
    steps divided by 1 - discount. From 0, values rise slowly, because each target has the value of
    the next step."""

    @model_validator(mode="after")
    def _rates_fit(self) -> "Hyperparameters":
        """Checks the counts: they are in steps, and `scenes` steps are taken at once."""
        if self.scenes % self.steps_per_gradient_step:
            raise ValueError(
                f"scenes {self.scenes} is not a multiple of "
                f"steps_per_gradient_step {self.steps_per_gradient_step}"
            )
        for name in ("replay_buffer", "target_update_steps"):
            if getattr(self, name) % self.scenes:
                raise ValueError(
                    f"{name} {getattr(self, name)} is not a multiple of scenes {self.scenes}"
                )
        return self

    def learning_rate_at(self, remaining: float) -> float:
        """The learning rate when a proportion `remaining` of all steps remains."""
        if not self.learning_rate_decay:
            return self.learning_rate
        return self.learning_rate * min(remaining / self.learning_rate_decay, 1.0)

    def exploration_at(self, remaining: float) -> float:
        """The probability of a random action when a proportion `remaining` of all steps remains."""
        if 1 - remaining > self.exploration_share:
            return self.exploration_final
        fall = (1 - remaining) * (self.exploration_final - self.exploration_initial)
        return self.exploration_initial + fall / self.exploration_share


class Supervised(FrozenModel):
    """Settings of learning from human driving; the defaults are the paper's fine-tuning."""

    learning_rate: Positive = 1e-6
    batch_size: Annotated[int, Field(ge=1, le=100_000)] = 128
    epochs: Count = 8
    pull: Annotated[NonNegative, Field(alias="l2_anchoring")] = 0.2
    """Lambda of eq. 11: weight of the squared distance of the network from its start."""
    label_floor: Annotated[float, Field(gt=0, le=0.1)] = 0.01
    """Smallest probability of an action in a label; at 0, eq. 11 would be infinite."""
    rehearsal: NonNegative = 0.0
    """Weight of the change of Q in the network's own driving; 0 in the paper."""
    learning_rate_decay: Proportion = 0.0
    """Proportion of all epochs, at the end, over which the learning rate falls to 0; 0 in the
    paper."""
    loss: Annotated[
        Literal["divergence", "cross_entropy"],
        Field(exclude_if=lambda loss: loss == "divergence"),
    ] = "divergence"
    """The divergence of the policy from the labels, as in eq. 11, or the cross-entropy, which is
    smallest where the policy has the labels' probabilities."""

    def learning_rate_at(self, epoch: int) -> float:
        """The learning rate of an epoch; epochs are counted from 1."""
        remaining = 1 - (epoch - 1) / self.epochs
        return self.learning_rate * min(1.0, remaining / (self.learning_rate_decay or remaining))

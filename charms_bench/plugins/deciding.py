"""What a policy is asked and what it answers, whatever it declares."""

from math import prod
from typing import Any, NamedTuple

import numpy as np

from charms_bench.errors import BrokenWordError, InputError
from charms_bench.plugins.agent import Agent, Policy
from charms_bench.world.actions import Actions, check_actions, meta_actions_of
from charms_bench.world.highway_env_observation import STRAIGHT, HighwayEnv
from charms_bench.world.interaction_observation import Interaction
from charms_bench.world.observations import Observation, observation_of
from charms_bench.world.scene import Floats, Ints, Observations

Question = tuple[Any, ...]
"""The arguments of `Policy.decide`; each has one entry for each of M vehicles."""
WIDEST = 100_000
"""Most numbers that a policy can remember of a vehicle."""


class Asked(NamedTuple):
    """A question about M vehicles."""

    observations: Observations
    """(M, ...) what they see now."""
    kept: Floats
    """(M, `kept_width`) their memory, and after it their earlier observations."""
    noise: Floats
    """(M, W) random numbers."""
    rollouts: Any = None
    """For a planner; see `engine.rollouts`."""


def delay_of(like: Observation) -> int:
    """How many decisions an observation of other vehicles is late."""
    return like.delay_decisions if isinstance(like, Interaction) else 0


def kept_width(policy: Policy) -> int:
    """How many numbers the harness keeps of each vehicle between two decisions."""
    like = observation_of(policy.observation)
    earlier = policy.history_length - 1 + delay_of(like)
    return policy.memory_width + (earlier * prod(like.shape) if earlier else 0)


def shown_of(like: Observation, seen: Observations, earlier: Floats) -> Observations:
    """The last observations (M, T - D, ...) as a policy is shown them, whose delay is D.

    Args:
        like: The observation.
        seen: (M, ...) the present one.
        earlier: (M, W) the last T - 1 before it, the oldest first.
    """
    shape = (len(seen), -1, *seen.shape[1:])
    frames = np.concatenate([earlier.reshape(shape).astype(seen.dtype), seen[:, None]], axis=1)
    return like.delayed(frames) if isinstance(like, Interaction) and delay_of(like) else frames


def kept_of(seen: Observations, earlier: Floats) -> Floats:
    """What will be `earlier` at the next decision; see `shown_of`."""
    latest = seen.reshape(len(seen), -1).astype(np.float64)
    return np.concatenate([earlier, latest], axis=1)[:, latest.shape[1] :]


def decide(policy: Policy, asked: Asked) -> tuple[Actions, Floats]:
    """The policy's actions, and what is kept for its next decision (M, `kept_width`).

    Raises a `BrokenWordError` if the policy declares memory, and what it returns as memory is
    missing, not finite or of another shape.
    """
    question, earlier = question_of(policy, asked), asked.kept[:, policy.memory_width :]
    if earlier.shape[1]:
        earlier = kept_of(asked.observations, earlier)
    actions, memory = answer_of(policy, question, policy.decide(*question))
    return actions, np.concatenate([memory, earlier], axis=1) if earlier.shape[1] else memory


def question_of(policy: Policy, asked: Asked) -> Question:
    """The arguments of `policy.decide`."""
    seen, memory = asked.observations, asked.kept[:, : policy.memory_width]
    earlier = asked.kept[:, policy.memory_width :]
    if earlier.shape[1]:
        frames = shown_of(observation_of(policy.observation), seen, earlier)
        seen = frames if policy.history_length > 1 else frames[:, 0]
    seen = seen.view()
    seen.flags.writeable = False  # of the view: a plugin's own observation may write to its array
    if policy.rollouts_with:
        return seen, memory, asked.noise, asked.rollouts
    return (seen, memory, asked.noise) if policy.memory_width or policy.noise_draws else (seen,)


def answer_of(policy: Policy, question: Question, answer: Any) -> tuple[Actions, Floats]:
    """The actions and the new memory (M, Q) in what `policy.decide` has returned.

    Raises:
        BrokenWordError: As for `decide`.
    """
    shape = (len(question[0]), policy.memory_width)
    if not policy.memory_width:
        return np.asarray(answer), np.zeros(shape)
    if not isinstance(answer, tuple) or len(answer) != 2:
        found = type(answer).__name__
        raise BrokenWordError(f"decide returned {found}; expected (actions, memory)")
    new = np.asarray(answer[1])
    if new.shape != shape or new.dtype.kind not in "fiu":
        found = f"{new.dtype} of shape {new.shape}"
        raise BrokenWordError(f"decide returned memory {found}; expected floats of shape {shape}")
    if not (finite := np.isfinite(new).all(axis=1)).all():
        raise BrokenWordError("decide returned memory that is not finite", int(finite.argmin()))
    return np.asarray(answer[0]), new.astype(np.float64)


def part_of(question: Question, some: Ints) -> Question:
    """The same question about some of the vehicles; what can be changed is a copy."""
    return tuple(each[some] for each in question)


def check_declared(agent: Agent) -> None:
    """Checks what an agent declares of itself, but for its rates and ranges of parameters.

    Raises an `InputError` if an attribute has a value that is not possible.
    """
    least = {"memory_width": 0}
    if isinstance(agent, Policy):
        like = observation_of(agent.observation)
        try:
            check_actions(agent.actions)
            if isinstance(like, HighwayEnv) and (
                meta_actions_of(agent.actions) != meta_actions_of(like.actions)
            ):
                raise InputError("are not those of its observation highway_env")
        except InputError as error:
            raise InputError(f"its attribute `actions` {error}") from error
        if hasattr(agent, "target_speed_steps_mps"):
            raise InputError(
                "its attribute `target_speed_steps_mps` has no effect; expected `actions = "
                "with_speed_steps(...)`, with the function of charms_bench"
            )
        least = {"history_length": 1, "memory_width": 0, "noise_draws": 0}
    for name, lowest in least.items():
        found = getattr(agent, name)
        if type(found) is not int or not lowest <= found <= WIDEST:
            raise _impossible(name, found, f"an integer from {lowest} to {WIDEST:,}")
    if isinstance(agent, Policy) and type(agent.rollouts_with) is not str:
        raise _impossible("rollouts_with", agent.rollouts_with, "the name of an agent")


def check_road(policy: Policy, has_name: bool) -> None:
    """Checks that a policy with the observation `highway_env` is on a road with a name.

    Raises an `InputError` if it is on the straight road.
    """
    if isinstance(observation_of(policy.observation), HighwayEnv) and not has_name:
        raise InputError(STRAIGHT)


def _impossible(name: str, found: Any, expected: str) -> InputError:
    return InputError(f"its attribute `{name}` is {str(found)[:80]!r}; expected {expected}")

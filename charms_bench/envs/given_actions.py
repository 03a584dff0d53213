"""The actions that a program gives to an environment."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.roads.configuration import meta_actions
from charms_bench.world.action_texts import read_actions
from charms_bench.world.actions import (
    ACTION_KINDS,
    CONTROLS,
    DEFAULT_ACTIONS,
    ActionKind,
    Actions,
    ActionsLike,
    MetaAction,
    meta_actions_of,
)

GivenLike = ActionKind | Sequence[MetaAction | str | Mapping[str, Any]]
"""What an environment takes as its actions."""
MetaLike = Literal["meta"] | Sequence[MetaAction | str | Mapping[str, Any]]
"""What an environment with meta-actions only takes."""


def array_of(actions: Any) -> NDArray[Any]:
    """The array of actions, which may be lists or tensors.

    Raises:
        InputError: They have no common shape.
    """
    try:
        return np.asarray(actions)
    except (RuntimeError, TypeError, ValueError) as error:
        raise InputError(f"step: actions {actions!r:.80}: {error}") from error


class GivenActions:
    """The actions of learners, with or without the lateral and the longitudinal ones.

    Args:
        like: `meta`, `continuous`, or a list of meta-actions; see `world.action_texts`.
        longitudinal: Whether they change the speed.
        lateral: Whether they change the lane, or steer [`DiscreteMetaAction`, `ContinuousAction`].
        title: The environment's name, for messages.

    Raises:
        InputError: There are no such actions, or no action is left.
    """

    def __init__(self, like: GivenLike, longitudinal: bool, lateral: bool, title: str) -> None:
        if isinstance(like, str) and like not in ACTION_KINDS:
            raise InputError(f"{title}: actions: '{like}'; expected {' or '.join(ACTION_KINDS)}")
        if not (longitudinal or lateral):
            raise InputError(f"{title}: neither longitudinal nor lateral; expected one of them")
        try:
            self.like: ActionsLike = "continuous" if like == "continuous" else "meta"
            if not isinstance(like, str):
                self.like = read_actions(like)
            """All actions, including those that are left out."""
        except InputError as error:
            raise InputError(f"{title}: actions: {error}") from error
        own = meta_actions_of(self.like)
        self.kind: ActionKind = "meta" if own else "continuous"
        self.space: gymnasium.spaces.Discrete | gymnasium.spaces.Box
        """Of one learner."""
        if own:
            which = {"longitudinal": longitudinal, "lateral": lateral}
            if own == DEFAULT_ACTIONS:  # in highway-env's order
                found = meta_actions({"action": {"type": "DiscreteMetaAction", **which}})
                self.meaning = found.meaning
            else:
                left_out = [
                    (each.changes_speed and not longitudinal) or (each.lanes and not lateral)
                    for each in own
                ]
                self.meaning = np.flatnonzero(np.logical_not(left_out))
            if not self.meaning.size:
                raise InputError(f"{title}: no meta-action is longitudinal or lateral alone")
            self.names = tuple(own[k].name for k in self.meaning)
            self.space = gymnasium.spaces.Discrete(len(self.names))
        else:
            self.meaning = np.flatnonzero([longitudinal, lateral])
            self.names = tuple(CONTROLS[k] for k in self.meaning)
            self.space = gymnasium.spaces.Box(-1.0, 1.0, (len(self.names),), np.float32)

    def __call__(self, actions: Any, learners: str, count: int) -> Actions:
        """The meta-actions (M,) or the continuous actions (M, 2) of M learners.

        Continuous actions are clipped to [-1, 1], as in highway-env; what is left out is `IDLE`,
        or 0.

        Raises:
            InputError: They have another shape or type, or one is not an action.
        """
        given, is_meta = array_of(actions), self.kind == "meta"
        shape = count, *(self.space.shape or ())
        if given.shape != shape or given.dtype.kind not in ("iu" if is_meta else "iuf"):
            found = f"{given.dtype} of shape {given.shape}"
            expected = f"{'integers' if is_meta else 'numbers'} of shape {shape}"
            raise InputError(f"step: {found}; expected {expected}: {', '.join(self.names)}")
        if is_meta:
            wrong, expected = (
                (given < 0) | (given >= len(self.names)),
                f"0 to {len(self.names) - 1}",
            )
        else:
            wrong, expected = np.isnan(given).any(axis=1), "numbers"
        if wrong.any():
            first = int(wrong.argmax())
            said = f"action {given[first]}; expected {expected}: {', '.join(self.names)}"
            raise InputError(f"step: {learners} {first}: {said}")
        if is_meta:
            return np.asarray(self.meaning[given])
        kind = given.dtype if given.dtype.kind == "f" else np.float64
        both = np.zeros((count, len(CONTROLS)), dtype=kind)
        both[:, self.meaning] = np.clip(given, -1, 1)
        return both

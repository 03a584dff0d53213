"""The actions by which a policy drives: meta-actions, or continuous ones."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Real
from sys import float_info
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from charms_bench.errors import InputError
from charms_bench.foundation.compiled import compiled

STEPS_LIMIT = 100
"""Most steps by which repeated speed commands grow."""
ACTIONS_LIMIT = 100
"""Most meta-actions of a policy."""
OWN_STEPS = f"1 to {STEPS_LIMIT} positive finite numbers"
SPEED_STEPS = f"1 to {STEPS_LIMIT} finite numbers, all above or all below 0"


@dataclass(frozen=True)
class MetaAction:
    """What a command does to the target lane and to the target speed of a vehicle.

    At most one of the last three fields is given. Target speeds stay within the profile's bounds.
    """

    name: str
    lanes: int = 0
    """-1 changes to the lane to the left, 1 to the lane to the right."""
    profile_step: int = 0
    """1 raises the target speed and -1 lowers it, as the profile says: by its step, by one of its
    growing steps, or to the next of its target speeds."""
    speed_steps_mps: tuple[float, ...] = ()
    """What the action adds to the target speed: the first step and, while actions that change the
    target speed in this direction follow each other, the second one and so on to the last."""
    speed_from_present_mps: float | None = None
    """The target speed becomes the present speed plus this."""

    def __post_init__(self) -> None:
        steps, present = self.speed_steps_mps, self.speed_from_present_mps
        is_name = type(self.name) is str and self.name.isprintable() and 1 <= len(self.name) <= 40
        for field, fits, expected in (
            ("name", is_name, "1 to 40 characters that can be printed"),
            ("lanes", self.lanes in (-1, 0, 1), "-1, 0 or 1"),
            ("profile_step", self.profile_step in (-1, 0, 1), "-1, 0 or 1"),
            ("speed_steps_mps", steps == () or _are_steps(steps), SPEED_STEPS),
            ("speed_from_present_mps", present is None or _is_number(present), "a finite number"),
        ):
            if not fits:
                found = str(getattr(self, field))[:80]
                what = f"meta-action {str(self.name)[:40]!r}"
                raise InputError(f"{what}: {field} is {found!r}; expected {expected}")
        if (self.profile_step != 0) + bool(steps) + (present is not None) > 1:
            raise InputError(
                f"meta-action '{self.name}': expected one of profile_step, speed_steps_mps and "
                "speed_from_present_mps"
            )
        object.__setattr__(self, "speed_steps_mps", tuple(map(float, steps)))

    @property
    def changes_speed(self) -> bool:
        """Whether it has an effect on the target speed."""
        return bool(
            self.profile_step or self.speed_steps_mps or self.speed_from_present_mps is not None
        )


def _is_number(found: Any) -> bool:
    is_real = isinstance(found, Real) and not isinstance(found, bool)
    return is_real and -float_info.max <= found <= float_info.max


def _are_steps(found: Any) -> bool:
    if not isinstance(found, tuple | list) or not 1 <= len(found) <= STEPS_LIMIT:
        return False
    return all(map(_is_number, found)) and (min(found) > 0 or max(found) < 0)


DEFAULT_ACTIONS: tuple[MetaAction, ...] = (
    MetaAction("LANE_LEFT", lanes=-1),
    MetaAction("IDLE"),
    MetaAction("LANE_RIGHT", lanes=1),
    MetaAction("FASTER", profile_step=1),
    MetaAction("SLOWER", profile_step=-1),
)
"""highway-env's meta-actions; an action is an index into a policy's tuple of them."""
ACTIONS = tuple(action.name for action in DEFAULT_ACTIONS)
"""Their names."""
LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER = range(len(DEFAULT_ACTIONS))
NAMES_BY_AXES = {
    (True, True): ACTIONS,
    (True, False): ("SLOWER", "IDLE", "FASTER"),
    (False, True): ("LANE_LEFT", "IDLE", "LANE_RIGHT"),
}
"""The meta-actions by whether they are longitudinal and lateral [`DiscreteMetaAction`]."""
ActionKind = Literal["meta", "continuous"]
"""`meta`: `DEFAULT_ACTIONS`. `continuous`: an acceleration and a steering angle per vehicle, each
scaled from its range to -1 to 1 [highway-env's `ContinuousAction`]."""
ACTION_KINDS: tuple[ActionKind, ...] = get_args(ActionKind)
ActionsLike = ActionKind | tuple[MetaAction, ...]
"""The actions of a policy: meta-actions, or a kind of actions."""
CONTROLS = ("acceleration", "steering")
"""The columns of continuous actions."""
Actions = NDArray[np.integer | np.floating]
"""Meta-actions (M,), or continuous actions (M, 2)."""

_ACCELERATION_RANGE_MPS2 = (-5, 5.0)
_STEERING_RANGE_RAD = (-math.pi / 4, math.pi / 4)


def controls_of(actions: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The accelerations, m/s², and the steering angles, rad, of continuous actions (M, 2).

    They have the type of the actions, in which highway-env computes them too: for float32, their
    last bits differ from those for float64 [`ContinuousAction.get_action`, `utils.lmap`].
    """
    scaled, ranges = np.clip(actions, -1, 1).T, (_ACCELERATION_RANGE_MPS2, _STEERING_RANGE_RAD)
    acceleration, steering = (
        low + (value + 1) * (high - low) / 2
        for value, (low, high) in zip(scaled, ranges, strict=True)
    )
    return acceleration, steering


def meta_actions_of(like: ActionsLike) -> tuple[MetaAction, ...]:
    """The meta-actions of a policy; none if its actions are continuous."""
    if isinstance(like, str):
        return () if like == "continuous" else DEFAULT_ACTIONS
    return tuple(like)


def with_speed_steps(
    *steps_mps: float, actions: Sequence[MetaAction] = DEFAULT_ACTIONS
) -> tuple[MetaAction, ...]:
    """Meta-actions with steps of their own, all above 0, in place of the profile's.

    By default, these are highway-env's; FASTER and SLOWER have steps.
    """
    if not (_are_steps(steps_mps) and steps_mps[0] > 0):
        raise InputError(f"speed steps {str(steps_mps)[:80]}; expected {OWN_STEPS}")
    return tuple(
        replace(action, profile_step=0, speed_steps_mps=tuple(sign * k for k in steps_mps))
        if (sign := action.profile_step)
        else action
        for action in actions
    )


def check_actions(found: Any) -> None:
    """Checks what a policy declares as its actions.

    Raises:
        InputError: It is neither a kind of actions nor a tuple of meta-actions.
    """
    if isinstance(found, str) and found in ACTION_KINDS:
        return
    what = f"is {str(found)[:80]!r}; expected {' or '.join(ACTION_KINDS)}, or meta-actions"
    if not isinstance(found, tuple | list) or not 1 <= len(found) <= ACTIONS_LIMIT:
        raise InputError(what)
    for action in found:
        if not isinstance(action, MetaAction):
            raise InputError(f"has {str(action)[:80]!r}; expected a MetaAction of charms_bench")
    names = [action.name for action in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"has two meta-actions named '{name}'; expected different names")


def follows_profile(actions: Sequence[MetaAction]) -> bool:
    """Whether a profile's target speeds are those of vehicles with these meta-actions."""
    return any(action.profile_step for action in actions)


def outputs_of(like: ActionsLike) -> int:
    """The numbers that a network returns per vehicle."""
    return len(meta_actions_of(like)) or len(CONTROLS)


def problem_of(actions: NDArray[Any], like: ActionsLike, vehicles: int) -> tuple[str, int]:
    """What is wrong with the actions of M vehicles, and the first vehicle for which it is.

    The text is empty if nothing is wrong.
    """
    count = len(meta_actions_of(like))
    expected_shape = (vehicles,) if count else (vehicles, len(CONTROLS))
    is_type = actions.dtype.kind in ("iu" if count else "f")
    if actions.shape != expected_shape or not is_type:
        types = "integers" if count else "floats"
        found = f"{actions.dtype} of shape {actions.shape}"
        return f"{found}; expected {types} of shape {expected_shape}", 0
    if count:
        first = _first_unknown(actions.astype(np.int64, copy=False), count)
        expected = f"0 to {count - 1}"
    else:
        wrong = ~(np.abs(actions) <= 1).all(axis=1)
        first = int(wrong.argmax()) if wrong.any() else -1
        expected = "an acceleration and a steering angle from -1 to 1"
    return (f"action {actions[first]}; expected {expected}", first) if first >= 0 else ("", 0)


@compiled
def _first_unknown(actions: NDArray[np.int64], count: int) -> int:
    """The index of the first of the meta-actions (M,) that is not below the count, or -1."""
    for m in range(actions.size):
        if not 0 <= actions[m] < count:
            return m
    return -1

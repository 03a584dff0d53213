"""The actions by which a policy drives: meta-actions, or continuous ones."""

import math
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from charms_bench.foundation.compiled import compiled

ActionKind = Literal["meta", "continuous"]
"""`meta`: one index into `ACTIONS` per vehicle. `continuous`: an acceleration and a steering angle
per vehicle, each as a share of its range, from -1 to 1 [highway-env's `ContinuousAction`]."""
ACTION_KINDS: tuple[ActionKind, ...] = get_args(ActionKind)
ACTIONS = ("LANE_LEFT", "IDLE", "LANE_RIGHT", "FASTER", "SLOWER")
"""The meta-actions; an action is an index into this tuple."""
LANE_LEFT, IDLE, LANE_RIGHT, FASTER, SLOWER = range(len(ACTIONS))
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
    clipped = np.clip(actions, -1, 1)
    acceleration, steering = (
        low + (share + 1) * (high - low) / 2
        for share, (low, high) in zip(
            (clipped[:, 0], clipped[:, 1]),
            (_ACCELERATION_RANGE_MPS2, _STEERING_RANGE_RAD),
            strict=True,
        )
    )
    return acceleration, steering


def outputs_of(kind: ActionKind) -> int:
    """The numbers that a network returns per vehicle."""
    return len(ACTIONS) if kind == "meta" else len(CONTROLS)


def problem_of(actions: NDArray[Any], kind: ActionKind, vehicles: int) -> tuple[str, int]:
    """What is wrong with the actions of M vehicles, and the first vehicle for which it is.

    The text is empty if nothing is wrong.
    """
    expected_shape = (vehicles,) if kind == "meta" else (vehicles, len(CONTROLS))
    is_type = actions.dtype.kind in ("iu" if kind == "meta" else "f")
    if actions.shape != expected_shape or not is_type:
        types = "integers" if kind == "meta" else "floats"
        found = f"{actions.dtype} of shape {actions.shape}"
        return f"{found}; expected {types} of shape {expected_shape}", 0
    if kind == "meta":
        first = _first_unknown(actions.astype(np.int64, copy=False))
        expected = f"0 to {len(ACTIONS) - 1}"
    else:
        wrong = ~(np.abs(actions) <= 1).all(axis=1)
        first = int(wrong.argmax()) if wrong.any() else -1
        expected = "an acceleration and a steering angle from -1 to 1"
    return (f"action {actions[first]}; expected {expected}", first) if first >= 0 else ("", 0)


@compiled
def _first_unknown(actions: NDArray[np.int64]) -> int:
    """The index of the first of the meta-actions (M,) that does not exist, or -1."""
    for m in range(actions.size):
        if not 0 <= actions[m] < len(ACTIONS):
            return m
    return -1

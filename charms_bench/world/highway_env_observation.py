"""The observation and the actions of a configuration of highway-env, on a road with a name.

A policy with this observation observes its road, and acts on it, as the ego of highway-env's
environments: its positions are those on the network, not those along its way, and its meta-actions
choose between the target speeds of the configuration.
"""

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, field_validator

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.fields import FrozenModel
from charms_bench.world.actions import CONTROLS, DEFAULT_ACTIONS, NAMES_BY_AXES, ActionsLike
from charms_bench.world.scene import Observations, Scene, Vehicles

STRAIGHT = (
    "observes and acts as in an environment of highway-env; expected a road with a name, such as "
    "`roads: [merge-v0]`"
)
"""What is wrong with the straight road."""
_TYPES = ("DiscreteMetaAction", "ContinuousAction")


class HighwayEnv(FrozenModel):
    """The observation `highway_env`."""

    name: ClassVar[str] = "highway_env"

    observation: dict[str, Any]
    """highway-env's configuration of an observation, such as `{type: Kinematics}`."""
    action: dict[str, Any]
    """highway-env's configuration of a `DiscreteMetaAction` or a `ContinuousAction`."""
    shape: Annotated[
        tuple[Annotated[int, Field(ge=1, le=100_000)], ...],
        Field(strict=False, min_length=1, max_length=3),
    ]
    """That of one vehicle's observation."""

    @field_validator("action")
    @classmethod
    def _is_known(cls, value: dict[str, Any]) -> dict[str, Any]:
        if value.get("type") not in _TYPES:
            known = suggestion(str(value.get("type")), dict.fromkeys(_TYPES))
            raise ValueError(f"type: no agent has actions of '{value.get('type')}'. {known}")
        if not any(value.get(axis, True) for axis in ("longitudinal", "lateral")):
            raise ValueError("neither longitudinal nor lateral; expected one of them")
        return value

    @property
    def _axes(self) -> tuple[bool, bool]:
        return bool(self.action.get("longitudinal", True)), bool(self.action.get("lateral", True))

    @property
    def actions(self) -> ActionsLike:
        """The actions of a policy."""
        if self.action["type"] == "ContinuousAction":
            return "continuous"
        by_name = {each.name: each for each in DEFAULT_ACTIONS}
        return tuple(by_name[name] for name in NAMES_BY_AXES[self._axes])

    @property
    def controls(self) -> list[int]:
        """The columns of continuous actions that have an effect, as indices of `CONTROLS`."""
        return [k for k in range(len(CONTROLS)) if self._axes[k]]

    def __call__(self, scene: Scene, vehicles: Vehicles) -> Observations:
        """The observations of M vehicles, (M, *shape).

        Raises:
            InputError: The road is the straight one.
        """
        if scene.junctions is None:
            raise InputError(STRAIGHT)
        return np.asarray(scene.junctions.observe(vehicles), dtype=np.float32)


def any_observations(shape: tuple[int, ...], count: int, seed: int) -> Observations:
    """Numbers of a normal distribution in the place of M observations, (M, *shape)."""
    return np.random.default_rng(seed).standard_normal((count, *shape), dtype=np.float32)

"""One of highway-env's roads, by its name and its configuration."""

import json
from typing import Annotated

from pydantic import JsonValue

from charms_bench.foundation.fields import UNLESS_EMPTY, FrozenModel, Name

ENVIRONMENT = "environment"
"""The traffic model of the vehicles that an environment of highway-env has itself."""


class NamedRoad(FrozenModel):
    """The road, the vehicles and the goal of one of highway-env's environments."""

    name: Name
    """highway-env's name of the environment, such as `merge-v1`."""
    configuration: Annotated[dict[str, JsonValue] | None, UNLESS_EMPTY] = None
    """Keys of highway-env's configuration, such as `{lanes_count: 3}`."""

    def __str__(self) -> str:
        return self.name

    def __hash__(self) -> int:
        return hash((self.name, json.dumps(self.configuration, sort_keys=True)))

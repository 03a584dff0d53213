"""Agents and traffics as a suite describes them."""

import json
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from charms_bench.plugins.agent import Agent
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent, make_traffic
from charms_bench.plugins.traffic import Mixture, Traffic
from charms_bench.world.fields import FilePath, FrozenModel, Name


class _Spec(FrozenModel):
    """A plugin by its name; a plain string is the name."""

    name: Name | None = None
    options: dict[str, Any] = Field(default={})

    @model_validator(mode="before")
    @classmethod
    def _from_name(cls, value: object) -> object:
        return {"name": value} if isinstance(value, str) else value


class AgentSpec(_Spec):
    """An agent by its name, or a network by the path of its ONNX file."""

    onnx: FilePath | None = None
    decision_hz: Annotated[float, Field(gt=0, le=1000)] | None = None

    @model_validator(mode="after")
    def _one_of_two(self) -> "AgentSpec":
        if (self.name is None) == (self.onnx is None):
            raise ValueError("give a name, or the path of an ONNX file as {onnx: path}")
        if self.onnx is None and self.decision_hz is not None:
            raise ValueError("decision_hz is for networks given by path")
        if self.onnx is not None and self.options:
            raise ValueError("options are for agents given by name")
        return self

    @property
    def key(self) -> str:
        """Identifies the agent: its name if it has no options, else all of this as JSON."""
        if self.name is not None and not self.options:
            return self.name
        return json.dumps(self.model_dump(mode="json", exclude_defaults=True), sort_keys=True)

    def make(self, folder: Path) -> Agent:
        """The agent; a relative path starts at `folder`."""
        if self.onnx is None:
            return make_agent(str(self.name), self.options)
        return OnnxPolicy(folder / self.onnx, self.decision_hz)


class TrafficSpec(_Spec):
    """A traffic or an agent by its name, or a mixture of agents with shares."""

    mixture: dict[Name, Annotated[float, Field(ge=0, le=1)]] = Field(default={})

    @model_validator(mode="after")
    def _one_of_two(self) -> "TrafficSpec":
        if (self.name is None) == (not self.mixture):
            raise ValueError("give a name, or shares of agents as {mixture: {agent: share}}")
        return self

    def make(self) -> Traffic:
        """The traffic."""
        if self.name is not None:
            return make_traffic(self.name, self.options)
        return Mixture(self.mixture)

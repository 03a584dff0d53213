"""Agents and traffics as a suite describes them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, model_validator

from charms_bench.foundation.fields import FrozenModel, Line
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import is_network, make_agent, make_traffic
from charms_bench.plugins.traffic import Mixture, Placed, Traffic
from charms_bench.world.named_road import ENVIRONMENT
from charms_bench.world.scenario import PRESCRIBED, Scenario


def _short(name: str) -> str:
    """Rejects an empty name and one that is too long; a path may be as long as a line."""
    if not name or (len(name) > 80 and not is_network(name)):
        raise ValueError("expected 1 to 80 characters")
    return name


AgentName = Annotated[Line, AfterValidator(_short)]
"""The name of an installed agent, or the path of a network; see `registry.is_network`."""


class _Spec(FrozenModel):
    """A plugin by its name; a plain string is the name, and `{onnx: path}` means `{name: path}`."""

    name: AgentName | None = None
    """The name of an installed plugin, or the path of a network (`.onnx`)."""
    options: dict[str, Any] = Field(default={})
    """Arguments of the plugin's class."""

    @model_validator(mode="before")
    @classmethod
    def _from_name(cls, value: object) -> object:
        if isinstance(value, str):
            return {"name": value}
        if not isinstance(value, dict) or value.get("onnx") is None:
            return value
        path, others = value["onnx"], {key: value[key] for key in value if key != "onnx"}
        if others.get("name") is not None or not isinstance(path, str) or not is_network(path):
            raise ValueError("onnx: expected a path that ends in .onnx, and no name beside it")
        return {**others, "name": path}


class AgentSpec(_Spec):
    """An agent by its name; a network may be given its decision rate and style."""

    name: AgentName
    """The name of an installed agent, or the path of a network (`.onnx`)."""
    decision_hz: Annotated[float, Field(gt=0, le=1000)] | None = None
    """By default, the rate in the network's file."""
    style: Line | None = None
    """The style of a network that is given one; by default, the first in its file."""

    @model_validator(mode="after")
    def _fits(self) -> "AgentSpec":
        if is_network(self.name) and self.options:
            what = "a network has decision_hz and style"
            raise ValueError(f"options are for installed agents; {what}")
        for key in ("decision_hz", "style"):
            if not is_network(self.name) and getattr(self, key) is not None:
                raise ValueError(f"{key} is for networks given by path")
        return self

    @property
    def key(self) -> str:
        """Identifies the agent: its name if it has nothing else, or all of this as JSON."""
        if not self.options and self.decision_hz is None and self.style is None:
            return self.name
        return json.dumps(self.model_dump(mode="json", exclude_defaults=True), sort_keys=True)

    @property
    def origin(self) -> str:
        """What its version belongs to: the path of a network, or else its `key`."""
        return self.name if is_network(self.name) else self.key

    def make(self, networks: Mapping[str, Path]) -> Agent:
        """The agent; `networks` has the file of each network, see `networks_of`."""
        if is_network(self.name):
            return OnnxPolicy(networks[self.name], self.decision_hz, self.style)
        return make_agent(self.name, self.options)


class TrafficSpec(_Spec):
    """A traffic model or an agent by its name, a mixture of agents, or a scenario."""

    mixture: dict[AgentName, Annotated[float, Field(ge=0, le=1)]] = Field(default={})
    """The probability of each agent; each vehicle draws one. They sum to 1."""
    scenario: Scenario | None = None
    """Vehicles that are placed and prescribed, instead of a traffic model."""

    @model_validator(mode="before")
    @classmethod
    def _without_road(cls, value: object) -> object:
        if isinstance(value, dict) and "road" in value:
            raise ValueError("a road is no traffic model; a suite has `roads`")
        return value

    @model_validator(mode="after")
    def _one_of_three(self) -> "TrafficSpec":
        given = self.name, self.mixture or None, self.scenario
        if sum(each is not None for each in given) != 1:
            raise ValueError(
                "give a name, probabilities as {mixture: {agent: probability}}, or a scenario"
            )
        return self

    @property
    def is_environment(self) -> bool:
        """Whether these are the vehicles that a road of highway-env has itself."""
        return self.name == ENVIRONMENT

    def make(self) -> Traffic:
        """The traffic."""
        if self.name is not None:
            return make_traffic(self.name, self.options)
        if self.scenario is not None:
            return Placed(self.scenario.agents)
        return Mixture(self.mixture)


def drivers_of(ego: AgentSpec, traffic: Traffic) -> tuple[AgentSpec, ...]:
    """The agents that drive in a cell: the ego's, then the others of the traffic."""
    others = (name for name in traffic.agents if name not in (ego.key, PRESCRIBED))
    return (ego, *(AgentSpec(name=name) for name in others))


def networks_of(ego: AgentSpec, traffic: Traffic, folder: Path) -> dict[str, Path]:
    """The file of each network in a cell, by its name; relative paths start at `folder`."""
    names = (driver.name for driver in drivers_of(ego, traffic))
    return {name: folder / name for name in names if is_network(name)}


def agents_of(ego: AgentSpec, traffic: Traffic, folder: Path) -> dict[str, Agent]:
    """The agents that drive in a cell, by their keys; for `folder`, see `networks_of`."""
    networks = networks_of(ego, traffic, folder)
    return {driver.key: driver.make(networks) for driver in drivers_of(ego, traffic)}


def by_content(value: Any, contents: Mapping[str, str]) -> Any:
    """The JSON value with the name of each network replaced by what `contents` has for it."""
    if isinstance(value, str):
        return contents.get(value, value)
    if isinstance(value, Mapping):
        return {contents.get(key, key): by_content(each, contents) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [by_content(each, contents) for each in value]
    return value

"""Finds plugins by name among the installed entry points; an agent can also be a network's file.

Listing reads metadata only. A plugin is imported when it is asked for, so a broken plugin does not
affect the others.
"""

import os
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from inspect import signature
from types import MappingProxyType
from typing import Any, TypeVar, cast

from charms_bench.errors import (
    PLUGIN_ERRORS,
    CharmsBenchError,
    InputError,
    RegistryError,
    suggestion,
)
from charms_bench.plugins.agent import Agent, DriverModel, Policy
from charms_bench.plugins.event import Event
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.traffic import OneAgent, Traffic
from charms_bench.world.named_road import ENVIRONMENT
from charms_bench.world.scenario import PRESCRIBED

T = TypeVar("T")
AGENTS = "charms_bench.agents"
TRAFFIC = "charms_bench.traffic"
PIPELINES = "charms_bench.pipelines"
EXPORTERS = "charms_bench.exporters"
METRICS = "charms_bench.metrics"
SAMPLERS = "charms_bench.samplers"
EVENTS = "charms_bench.events"
_ROLES = {
    AGENTS: "agent",
    TRAFFIC: "traffic",
    PIPELINES: "pipeline",
    EXPORTERS: "exporter",
    METRICS: "metric set",
    SAMPLERS: "sampler",
    EVENTS: "event",
}


_TEXTS: Mapping[type, tuple[str, ...]] = {
    Policy: ("weights_sha256",),
    DriverModel: ("highway_env_class", "files_sha256"),
    Traffic: ("after_deviation",),
    Event: ("definition",),
}
"""The attributes of plugins that are texts."""
_MISSING = object()


def is_network(name: str) -> bool:
    """Whether an agent's name is the path of a network: it ends in `.onnx`."""
    return name.endswith(".onnx")


@dataclass(frozen=True)
class Plugin:
    """An installed plugin, which is not imported yet."""

    name: str
    role: str
    """`agent`, `traffic`, `pipeline`, `exporter`, `metric set`, `sampler` or `event`."""
    distribution: str
    version: str
    entry_point: EntryPoint
    rival: str = ""
    """Another distribution that claims the name, so that the name cannot be used."""


def plugins(group: str) -> Mapping[str, Plugin]:
    """The installed plugins of an entry-point group by name, sorted by name.

    A name that two distributions claim is among them, but cannot be used; see `Plugin.rival`.
    """
    return _plugins(group, tuple((folder, _modified_ns(folder)) for folder in sys.path))


def _modified_ns(folder: str) -> int:
    """When a distribution was last installed in a folder or removed from it; 0 if unknown."""
    try:
        return os.stat(folder or os.curdir).st_mtime_ns
    except OSError:
        return 0


@lru_cache
def _plugins(group: str, path: tuple[tuple[str, int], ...]) -> Mapping[str, Plugin]:
    """The plugins in the folders of `path`, which are read again only when they have changed."""
    found: dict[str, Plugin] = {}
    for entry_point in entry_points(group=group):
        source = entry_point.dist
        origin = (source.name, source.version) if source else ("unknown", "unknown")
        plugin = Plugin(entry_point.name, _ROLES[group], *origin, entry_point)
        rival = found.setdefault(plugin.name, plugin)
        if rival.distribution != plugin.distribution:
            found[plugin.name] = replace(rival, rival=plugin.distribution)
    return MappingProxyType(dict(sorted(found.items())))


def find(group: str, name: str) -> Plugin:
    """The plugin of that name; raises a `RegistryError` if it is missing or claimed twice."""
    installed = plugins(group)
    if name in installed:
        return _unrivalled(installed[name])
    raise RegistryError(_unknown(_ROLES[group], name, installed))


def _unrivalled(plugin: Plugin) -> Plugin:
    if plugin.rival:
        raise RegistryError(
            f"the {plugin.role} '{plugin.name}' is claimed by two distributions, "
            f"{plugin.distribution} and {plugin.rival}; uninstall one of them"
        )
    return plugin


def _unknown(role: str, name: str, known: Mapping[str, object]) -> str:
    drives = role in ("agent", "traffic")
    looks_like_path = "/" in name or "." in name
    path = " The path of a network ends in .onnx, in small letters." * (drives and looks_like_path)
    if drives and name.endswith(".zip"):
        to = name.removesuffix(".zip")
        path += f" `charms-bench export {name} {to}.onnx` makes one from this file."
    return f"no {role} named '{name}'. {suggestion(name, known)}{path}"


def make_agent(name: str, options: Mapping[str, Any] | None = None) -> Agent:
    """The agent of that name, made with `options`; a name that ends in `.onnx` is a network's path.

    Raises:
        RegistryError: It is not installed, cannot be imported, does not accept the options, or is
            not an agent.
        ModelError: The network cannot be used.
    """
    if is_network(name):
        if options:
            raise RegistryError(f"the network {name} takes no options, got {', '.join(options)}")
        return OnnxPolicy(name)
    return cast(Agent, _make(find(AGENTS, name), options, Policy, DriverModel))


def others_of(planner: Policy) -> Agent:
    """The agent that drives the other vehicles in a planner's rollouts.

    Raises:
        InputError: It is a planner too, so that rollouts would need rollouts without an end.
        CharmsBenchError: It cannot be made.
    """
    agent = make_agent(planner.rollouts_with)
    if isinstance(agent, Policy) and agent.rollouts_with:
        raise InputError(
            f"its attribute `rollouts_with` is '{planner.rollouts_with}', a planner; expected an "
            "agent without rollouts of its own"
        )
    return agent


def make_traffic(name: str, options: Mapping[str, Any] | None = None) -> Traffic:
    """The traffic of that name; an agent's name is the traffic in which it drives all vehicles.

    `environment` is the traffic of the vehicles that a road of highway-env has itself.
    """
    if name == ENVIRONMENT and not options:
        return OneAgent(PRESCRIBED)
    installed, agents = plugins(TRAFFIC), plugins(AGENTS)
    if name in installed:
        plugin, agent = _unrivalled(installed[name]), agents.get(name)
        if agent is not None and agent.distribution != plugin.distribution:
            _unrivalled(replace(plugin, rival=agent.distribution))  # an agent is a traffic, too
        return cast(Traffic, _make(plugin, options, Traffic))
    if not is_network(name) and name not in agents:
        raise RegistryError(_unknown("traffic", name, {**installed, **agents}))
    if options:
        raise RegistryError(
            f"'{name}' is an agent; as a traffic, it takes no options. A plugin can give it a name "
            "of its own with these options: subclass it, as docs/recordings.md shows"
        )
    if not is_network(name):
        _unrivalled(agents[name])
    return OneAgent(name)


def make(group: str, name: str, options: Mapping[str, Any] | None, kind: type[T]) -> T:
    """As `make_agent`, of any group; what is made is of the class `kind`."""
    return cast(T, _make(find(group, name), options, kind))


def load(group: str, name: str) -> Any:
    """The object that the entry point of that name refers to; raises a `RegistryError`."""
    return _load(find(group, name))


def _load(plugin: Plugin) -> Any:
    try:
        with _kept_apart():
            return plugin.entry_point.load()
    except PLUGIN_ERRORS as error:
        remedy = _remedy(plugin, error) if isinstance(error, ImportError) else ""
        raise RegistryError(
            f"{_whose(plugin)} cannot be imported: {type(error).__name__}: {error}{remedy}"
        ) from error


@contextmanager
def _kept_apart() -> Iterator[None]:
    """Keeps what a plugin prints off standard output, and the current folder as it is."""
    try:
        before = os.getcwd()
    except OSError:  # it has been deleted
        before = ""
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        if before:
            os.chdir(before)


def _remedy(plugin: Plugin, error: ImportError) -> str:
    """How to install the missing library, if an extra of the plugin's distribution has it."""
    library = (error.name or "").partition(".")[0].replace("_", "-")
    distribution = plugin.entry_point.dist
    for requirement in (distribution.requires or []) if distribution and library else []:
        match = re.match(r"([\w.-]+).*extra == ['\"]([\w.-]+)['\"]", requirement)
        if match and match[1].replace("_", "-").lower() == library:
            return f"; pip install '{plugin.distribution}[{match[2]}]'"
    return ""


def _make(plugin: Plugin, options: Mapping[str, Any] | None, *kinds: type) -> Any:
    """What a plugin makes with options, which is of one of these kinds."""
    factory = _load(plugin)
    try:
        with _kept_apart():
            made = factory(**(options or {}))
            problem = _problem_of(made, *kinds)
    except CharmsBenchError:
        raise
    except PLUGIN_ERRORS as error:
        if unknown := _unknown_option(factory, options or {}):
            raise RegistryError(f"{_whose(plugin)} {unknown}") from error
        given = ", ".join(options or ()) or "none"
        raise RegistryError(
            f"{_whose(plugin)} cannot be made (options: {given}): {type(error).__name__}: {error}"
        ) from error
    if problem:
        raise RegistryError(f"{plugin.role} '{plugin.name}' {problem}")
    return made


def _unknown_option(factory: Any, options: Mapping[str, Any]) -> str:
    """What is wrong with an option that a plugin's factory does not have; empty if it has all."""
    try:
        parameters = signature(factory).parameters
    except (TypeError, ValueError):
        return ""
    if any(each.kind is each.VAR_KEYWORD for each in parameters.values()):
        return ""
    unknown = next((name for name in options if name not in parameters), None)
    return (
        "" if unknown is None else f"has no option '{unknown}'. {suggestion(unknown, parameters)}"
    )


def _problem_of(made: object, *kinds: type) -> str:
    """Why what a plugin has made cannot be used as one of these kinds; empty if it can."""
    is_one = [isinstance(made, kind) for kind in kinds]
    if sum(is_one) != 1:
        expected = " or a ".join(kind.__name__ for kind in kinds)
        found = "both" if any(is_one) else f"a {type(made).__name__}"
        return f"is {found}, not a {expected}"
    if isinstance(made, Policy):
        # Properties may raise here.
        _ = made.observation, made.actions, made.decision_hz
    for kind, texts in _TEXTS.items():
        for text in texts * isinstance(made, kind):
            value = getattr(made, text, _MISSING)
            if not isinstance(value, str):
                has = f"no `{text}`" if value is _MISSING else f"{text} {value!r}"
                return f"has {has}; expected a text"
    if isinstance(made, Traffic):
        listed = made.agents
        if not isinstance(listed, tuple | list) or not all(type(name) is str for name in listed):
            return f"has agents {listed!r}; expected a tuple of names"
        if not listed:
            return "has no agents; expected at least one name"
        if not all(listed):
            return f"has agents {listed!r}; a name is empty"
    return ""


def _whose(plugin: Plugin) -> str:
    return f"{plugin.role} '{plugin.name}' of {plugin.distribution} {plugin.version}"

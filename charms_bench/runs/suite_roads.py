"""The roads of a suite: highway-env's and files, with their configurations and durations."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import yaml
from pydantic import Field, ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from charms_bench.foundation.fields import UNLESS_EMPTY, Duration, Name
from charms_bench.world.named_road import ENVIRONMENT, NamedRoad
from charms_bench.world.profile import ROADS
from charms_bench.world.scenario import Parameter


class RoadEntry(NamedRoad):
    """A road of the suite; a plain text is its name."""

    plain_text = "name"
    duration_s: Annotated[Duration | None, UNLESS_EMPTY] = None
    """Duration of an episode, unless it ends before. By default, it is `scene.duration_s`; without
    that, the duration of the environment; and 45 s where it has none."""
    label: Name | None = None
    """Its name in tables; by default highway-env's, or that of the file."""
    parameters: Annotated[dict[Name, Parameter], UNLESS_EMPTY] = Field(default={})
    """Numbers of the configuration that `charms-bench search` varies, and their ranges. All other
    commands use those of `configuration`."""

    @property
    def title(self) -> str:
        """Its name in tables."""
        return self.label or self.name

    @property
    def road(self) -> NamedRoad:
        """The road itself."""
        return NamedRoad(**{name: getattr(self, name) for name in NamedRoad.model_fields})

    def at(self, point: Mapping[str, float]) -> "RoadEntry":
        """The road with the values of a point in its configuration."""
        return self.model_copy(update={"configuration": {**(self.configuration or {}), **point}})

    @property
    def bounds(self) -> tuple["RoadEntry", ...]:
        """The road with the lowest, and with the highest values of its parameters."""
        from charms_bench.roads.configuration import whole  # which other suites do not need

        ends = ({name: each.range[k] for name, each in self.parameters.items()} for k in (0, 1))
        return tuple(self.at(whole(point)) for point in ends)


def with_defaults_of_roads(suite: dict[str, Any], roads: Sequence[Any]) -> dict[str, Any]:
    """A suite as a file gives it, with its roads' durations and the profile of roads."""
    from charms_bench.roads.defaults import duration_of  # which suites without roads do not need

    scene = suite.get("scene") or {}
    if not isinstance(scene, dict):
        return suite
    entries = [{"name": each} if isinstance(each, str) else each for each in roads]
    if "duration_s" not in scene:
        entries = [
            {"duration_s": duration_of(each), **each} if isinstance(each, dict) else each
            for each in entries
        ]
    return {**suite, "scene": {"profile": ROADS.name, **scene}, "roads": entries}


def reject_roads_of_traffic(model: str, key: str, entries: Any) -> None:
    """Raises a `ValidationError` if traffic models are roads; it says how roads are written.

    `entries` are those of the `key` of a `model`.
    """
    listed = [each if isinstance(each, dict) else {} for each in entries or ()]
    found = [each.get("traffic") for each in listed]
    specs = [each if isinstance(each, dict) else {} for each in found]
    old = [k for k, spec in enumerate(specs) if "road" in spec]
    if not old:
        return
    roads, traffics = [], []
    for entry, spec in ((listed[k], specs[k]) for k in old):
        names = "label" in entry and "drivers" not in spec
        roads.append({"name": spec["road"], "label": entry["label"]} if names else spec["road"])
        traffics.append({"traffic": spec.get("drivers", ENVIRONMENT)})
    roads, traffics = _distinct(roads), _distinct(traffics)
    what = f"a road is no traffic model; write instead\nroads: {_in_yaml(roads)}"
    what += f"\ntraffic_models: {_in_yaml(traffics)}"
    if len(roads) * len(traffics) > len(old):
        what += "\nwhich is every road in every traffic model; use several suites for fewer cells"
    kind = PydanticCustomError("unknown_key", "{what}", {"what": what})
    at = (key, old[0], "traffic", "road")
    problem = InitErrorDetails(type=kind, loc=at, input=specs[old[0]])
    raise ValidationError.from_exception_data(model, [problem])


def _distinct(values: Sequence[Any]) -> list[Any]:
    """The values without those that came before."""
    return [each for k, each in enumerate(values) if each not in values[:k]]


def _in_yaml(value: Any) -> str:
    """The value on a line of YAML."""
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000).strip()

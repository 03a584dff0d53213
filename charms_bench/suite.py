"""Suites: what is evaluated, from YAML."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, model_validator

from charms_bench.agent import Agent
from charms_bench.document import Document, Location
from charms_bench.errors import InputError
from charms_bench.metrics import METRIC_SETS, PAPER, MetricSet
from charms_bench.profile import PROFILES, Finite, FrozenModel, Profile
from charms_bench.registry import AGENTS, find, make_agent, make_traffic, suggestion
from charms_bench.scene import SceneSettings
from charms_bench.traffic import Mixture, Traffic


def _printable(text: str) -> str:
    """Refuses what would move a terminal's cursor or turn the direction of writing."""
    if not text.isprintable():
        raise ValueError("expected characters that can be printed, on one line")
    return text


def _path(value: object) -> object:
    if isinstance(value, str) and (len(value) > 1000 or not value.isprintable()):
        raise ValueError("expected a path of up to 1,000 characters that can be printed")
    return value


Line = Annotated[str, Field(max_length=1000), AfterValidator(_printable)]
Name = Annotated[str, Field(min_length=1, max_length=80), AfterValidator(_printable)]
FilePath = Annotated[Path, Field(strict=False), BeforeValidator(_path)]
EPISODES_LIMIT = 10_000_000
"""Of a suite, in all cells."""
ENTRIES_LIMIT = 100
"""Egos of a suite, and traffics."""
EVALUATION_SEEDS = 1_000_000_000
"""Episodes of evaluations have seeds below this, those of trainings above."""
REFERENCES = Path(__file__).with_name("human") / "references"
"""Human driving that is shipped, as histograms: `NAME.json`."""
PRESENTATION = ("title", "columns", "pairs", "references")
"""Fields of a suite that decide no row, only what is made of the rows."""


class AgentSpec(FrozenModel):
    """An agent by its name, or a network by the path of its ONNX file."""

    name: Name | None = None
    options: dict[str, Any] = Field(default={})
    onnx: FilePath | None = None
    decision_hz: Annotated[float, Field(gt=0, le=1000)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_name(cls, value: object) -> object:
        return {"name": value} if isinstance(value, str) else value

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
        """Tells agents apart: the plain name of one without options."""
        if self.name is not None and not self.options:
            return self.name
        return json.dumps(self.model_dump(mode="json", exclude_defaults=True), sort_keys=True)

    def make(self, folder: Path) -> Agent:
        """The agent; a relative path starts at `folder`."""
        if self.onnx is None:
            return make_agent(str(self.name), self.options)
        from charms_bench.onnx_policy import OnnxPolicy

        return OnnxPolicy(folder / self.onnx, self.decision_hz)


class TrafficSpec(FrozenModel):
    """A traffic or an agent by its name, or shares of agents."""

    name: Name | None = None
    options: dict[str, Any] = Field(default={})
    mixture: dict[Name, Annotated[float, Field(ge=0, le=1)]] = Field(default={})

    @model_validator(mode="before")
    @classmethod
    def _from_name(cls, value: object) -> object:
        return {"name": value} if isinstance(value, str) else value

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


class ReferenceSpec(FrozenModel):
    """Human driving: shipped histograms by name, or a folder of recordings in highD's format."""

    name: Name | None = None
    recordings: FilePath | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_name(cls, value: object) -> object:
        return {"name": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _one_of_two(self) -> "ReferenceSpec":
        if (self.name is None) == (self.recordings is None):
            raise ValueError("give a name, or a folder of recordings as {recordings: path}")
        known = {path.stem: path for path in sorted(REFERENCES.glob("*.json"))}
        if self.name is not None and self.name not in known:
            raise ValueError(
                f"no reference named '{self.name}'; a folder of recordings is "
                f"{{recordings: path}}. {suggestion(self.name, known)}"
            )
        return self

    @property
    def title(self) -> str:
        """What tables call it."""
        return self.name or str(self.recordings)


class EgoEntry(FrozenModel):
    """An ego of the suite."""

    agent: AgentSpec
    label: Name | None = None
    paper: dict[str, Finite] = Field(default={})
    """What the paper reports of it, by metric."""

    @property
    def title(self) -> str:
        """What tables call it."""
        return self.label or self.agent.name or str(self.agent.onnx)


class TrafficEntry(FrozenModel):
    """A traffic of the suite."""

    traffic: TrafficSpec
    label: Name | None = None
    paper: dict[str, Finite] = Field(default={})

    @property
    def title(self) -> str:
        """What tables call it."""
        return self.label or self.traffic.name or " + ".join(self.traffic.mixture)


def _with_overrides(value: object) -> object:
    """A profile by name, or by name with other values for some of its fields."""
    name = value.get("name") if isinstance(value, dict) else value
    if isinstance(value, Profile) or not isinstance(name, str):
        return value
    if name not in PROFILES:
        raise ValueError(f"no profile named '{name}'. {suggestion(name, PROFILES)}")
    merged = PROFILES[name].model_dump()
    for key, override in (value if isinstance(value, dict) else {}).items():
        if isinstance(override, dict) and isinstance(merged.get(key), dict):
            merged[key] = {**merged[key], **override}
        else:
            merged[key] = override
    return merged


class SuiteScene(SceneSettings):
    """Scene settings whose profile is given by name."""

    profile: Annotated[Profile, BeforeValidator(_with_overrides)] = PROFILES["charms"]


class Cell(FrozenModel):
    """An ego in a traffic."""

    ego: EgoEntry
    traffic: TrafficEntry

    @property
    def paper(self) -> dict[str, float]:
        """What the paper reports of it, by metric."""
        return {**self.traffic.paper, **self.ego.paper}


class Suite(FrozenModel):
    """An evaluation: every ego in every traffic, on the same episodes."""

    suite: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
    """Its name, which is also that of its tables."""
    title: Line = ""
    episodes: Annotated[int, Field(ge=1, le=EPISODES_LIMIT)]
    seed: Annotated[int, Field(ge=0, lt=EVALUATION_SEEDS)] = 0
    """The first episode's seed; the others follow."""
    scene: SuiteScene = SuiteScene()
    egos: Annotated[
        tuple[EgoEntry, ...], Field(min_length=1, max_length=ENTRIES_LIMIT, strict=False)
    ]
    traffics: Annotated[
        tuple[TrafficEntry, ...], Field(min_length=1, max_length=ENTRIES_LIMIT, strict=False)
    ]
    columns: Annotated[tuple[Name, ...], Field(max_length=1000, strict=False)] = ()
    """Metrics of the printed table; none: all that the paper reports."""
    pairs: bool = False
    """Whether tables also say how far the egos are apart, pair by pair."""
    references: Annotated[
        tuple[ReferenceSpec, ...], Field(max_length=ENTRIES_LIMIT, strict=False)
    ] = ()
    """Human driving that each traffic is held against."""
    folder: Path = Field(default=Path(), exclude=True, strict=False)
    """Where relative paths start: the suite file's folder."""

    @model_validator(mode="before")
    @classmethod
    def _remember_folder(cls, value: object, info: ValidationInfo) -> object:
        if isinstance(value, dict) and info.context:
            if "folder" in value:
                raise ValueError("folder: unknown key")
            return {**value, "folder": info.context["folder"]}
        return value

    @model_validator(mode="after")
    def _labels_differ(self) -> "Suite":
        for what, entries in (("egos", self.egos), ("traffics", self.traffics)):
            titles = [entry.title for entry in entries]
            for title in titles:
                if titles.count(title) > 1:
                    raise ValueError(f"two {what} are called '{title}'; give them labels")
        if self.pairs and (len(self.egos) < 2 or len(self.traffics) > 1):
            raise ValueError("pairs compares two egos or more in one traffic")
        if self.references and len(self.egos) > 1:
            raise ValueError("references are for traffics; give one ego")
        if len({reference.title for reference in self.references}) < len(self.references):
            raise ValueError("a reference stands here twice")
        return self

    @model_validator(mode="after")
    def _is_bounded(self) -> "Suite":
        total = self.episodes * len(self.egos) * len(self.traffics)
        if total > EPISODES_LIMIT:
            raise ValueError(
                f"{total:,} episodes in all cells; expected {EPISODES_LIMIT:,} at most"
            )
        return self

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Every ego with every traffic."""
        return tuple(
            Cell(ego=ego, traffic=traffic) for ego in self.egos for traffic in self.traffics
        )

    def fingerprint(self) -> str:
        """Hash of everything that decides its results but the number of episodes."""
        fields = self.model_dump(mode="json", exclude={"episodes", *PRESENTATION})
        return hashlib.sha256(json.dumps(fields, sort_keys=True).encode()).hexdigest()


def load_suite(path: Path) -> Suite:
    """The suite of a YAML file.

    Raises:
        SuiteError: Something in it is wrong, or an agent or traffic is not installed.
    """
    return suite_of(Document(path))


def suite_of(document: Document) -> Suite:
    """The suite of a document; see `load_suite`."""
    suite = document.validate(Suite)
    both: dict[str, Sequence[EgoEntry | TrafficEntry]]
    both = {"egos": suite.egos, "traffics": suite.traffics}
    for what, entries in both.items():
        for index, entry in enumerate(entries):
            try:
                _check_names(entry)
            except InputError as error:
                raise document.error((what, index), str(error)) from error
        for index, entry in enumerate(entries):
            for metric in entry.paper:
                _check_metric(document, (what, index, "paper", metric), metric, (PAPER,))
    for index, metric in enumerate(suite.columns):
        _check_metric(document, ("columns", index), metric, METRIC_SETS)
    return suite


def _check_metric(
    document: Document, location: Location, name: str, sets: tuple[MetricSet, ...]
) -> None:
    known = {metric.name: metric for metric_set in sets for metric in metric_set.metrics}
    if name not in known:
        raise document.error(location, f"no metric named '{name}'. {suggestion(name, known)}")


def _check_names(entry: EgoEntry | TrafficEntry) -> None:
    if isinstance(entry, EgoEntry):
        if entry.agent.name is not None:
            find(AGENTS, entry.agent.name)
        return
    for agent in entry.traffic.make().agents:
        find(AGENTS, agent)

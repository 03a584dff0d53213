"""The cases that `charms-bench verify` compares."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from charms_bench.errors import InputError, suggestion
from charms_bench.foundation.fields import FrozenModel
from charms_bench.foundation.files import absolute
from charms_bench.plugins.specs import AgentSpec, TrafficSpec
from charms_bench.roads import TASKS
from charms_bench.runs.document import Document
from charms_bench.runs.suite import Suite
from charms_bench.testing.map_parity import MapCase
from charms_bench.testing.parity import Case
from charms_bench.testing.road_parity import RoadCase
from charms_bench.testing.straight_parity import StraightCase
from charms_bench.world.scene import SceneSettings


class _Cell(FrozenModel):
    scene: SceneSettings
    traffic: TrafficSpec


class _DefaultCases(FrozenModel):
    episodes: Annotated[int, Field(ge=1)]
    continuous_episodes: Annotated[int, Field(ge=1)]
    scenes: tuple[SceneSettings, ...] = Field(strict=False)
    egos: tuple[AgentSpec, ...] = Field(strict=False)
    traffic: TrafficSpec
    """Drives in all `scenes`."""
    cells: tuple[_Cell, ...] = Field(strict=False)


def default_cases(continuous: bool = False) -> tuple[list[StraightCase], int]:
    """The cases that are compared if no suite is given, and the episodes of each.

    If `continuous`, random accelerations and steering angles drive the egos.
    """
    cases = Document(Path(__file__).with_name("verify.yaml")).validate(_DefaultCases)
    egos = (None,) if continuous else cases.egos
    cells = [(scene, cases.traffic) for scene in cases.scenes]
    for cell in cases.cells:
        cells.append((cell.scene.of_scenario(cell.traffic.scenario), cell.traffic))
    return [
        StraightCase(scene=scene, ego=ego, traffic=traffic)
        for ego in egos
        for scene, traffic in cells
    ], cases.continuous_episodes if continuous else cases.episodes


def cases_of(suite: Suite) -> list[Case]:
    """The cells of a suite, and each of its roads once, where highway-env cannot ask the agents.

    highway-env's roads have the suite's simulation rate.
    """
    rate = {"simulation_frequency": suite.scene.simulation_hz}
    cases: list[Case] = []
    for cell in suite.cells:
        case: Case
        network = cell.scene.network
        if network is None or cell.road is None:
            case = StraightCase(
                scene=cell.scene,
                ego=cell.ego.agent,
                traffic=cell.traffic.traffic,
                folder=suite.folder,
            )
        elif network.file is None:
            case = RoadCase(network.name, (network.configuration or {}) | rate, cell.road.title)
        else:
            case = MapCase(network.file, label=cell.road.title)
        if case not in cases:
            cases.append(case)
    return cases


def case_on(road: str) -> Case:
    """highway-env's road of this name, or the one in this file; raises an `InputError`."""
    if road in TASKS:
        return RoadCase(road)
    if Path(road).is_file():
        return MapCase(absolute(road))
    raise InputError(
        f"--road: no file and no environment named '{road}'. {suggestion(road, TASKS)}"
    )

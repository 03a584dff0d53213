"""Episodes on the straight road, which the reference engine drives, too."""

from pathlib import Path

import numpy as np

from charms_bench.engine.simulation import Simulation
from charms_bench.foundation.fields import FrozenModel
from charms_bench.plugins.specs import AgentSpec, TrafficSpec, drivers_of, networks_of
from charms_bench.testing.parity import Values
from charms_bench.testing.reference_engine import ENGINES
from charms_bench.world.actions import ActionKind, Actions
from charms_bench.world.scene import Floats, SceneSettings

QUANTITIES = (
    *("x", "y", "heading", "speed"),
    *("present", "entry", "lane", "target_lane", "crashed", "timer_s"),
)
"""What is compared of the vehicles."""


class StraightCase(FrozenModel):
    """An ego in a traffic model in a kind of scene."""

    scene: SceneSettings
    ego: AgentSpec | None
    """If None, random accelerations and steering angles drive the ego; see `random_controls`."""
    traffic: TrafficSpec
    folder: Path = Path()

    @property
    def title(self) -> str:
        """A description in one line."""
        scene, ego = self.scene, self.ego.name if self.ego else "continuous actions"
        around = f"density {scene.density:g}"
        if scene.recording is not None:
            around = "recorded"
        elif scene.inflow is not None:
            around = "open boundaries"
        return (
            f"{ego}, {scene.profile.name}: {scene.lanes} lanes, {scene.vehicles} vehicles, {around}"
        )

    def episode(self) -> "StraightEpisode":
        """One in both engines."""
        return StraightEpisode(self)


class StraightEpisode:
    """The same scene in the compiled engine and in the reference engine."""

    step_name = "simulation step"

    def __init__(self, case: StraightCase) -> None:
        traffic, ego = case.traffic.make(), case.ego
        kind: ActionKind = "meta" if ego else "continuous"
        networks = networks_of(ego, traffic, case.folder) if ego else {}
        drivers = drivers_of(ego, traffic) if ego else map(AgentSpec.model_validate, traffic.agents)
        agents = {driver.key: driver.make(networks) for driver in drivers}
        key = ego.key if ego else None
        self._ours, self._theirs = (
            Simulation(case.scene, 1, key, traffic, agents, engine, kind) for engine in ENGINES
        )
        self._settings, self._is_outside = case.scene, ego is None

    def start(self, seed: int) -> None:
        for simulation in (self._ours, self._theirs):
            simulation.reset(np.array([seed], dtype=np.uint64))
        # highway-env computes with the numbers that it gets; networks return float32.
        number = np.float32 if seed % 2 else np.float64
        controls = random_controls(seed, self._settings.decisions)
        self._controls: Actions = controls.astype(number)

    def advance(self) -> None:
        self._advance(self._ours)

    def advance_stock(self) -> None:
        self._advance(self._theirs)

    def _advance(self, simulation: Simulation) -> None:
        starts = simulation.phase == 0 and self._is_outside
        simulation.advance(self._controls[simulation.steps] if starts else None)
        if simulation.phase == self._settings.steps_per_decision:
            simulation.finish_step()

    def values(self) -> Values:
        ours, theirs = self._ours, self._theirs
        pairs = {name: (getattr(ours.scene, name)[0], getattr(theirs.scene, name)[0])
                 for name in QUANTITIES}  # fmt: skip
        return {**pairs, "ending": (ours.ending[0], theirs.ending[0])}

    def is_over(self) -> bool:
        return not self._ours.scene.active[0]

    def has_crashed(self) -> bool:
        scene = self._ours.scene
        return bool(scene.crashed[0, scene.ego[0]])


def random_controls(seed: int, decisions: int) -> Floats:
    """Continuous actions (T, 2) of an episode, with means and spreads drawn per episode.

    The steering ranges from 0.1 % to all of its range. So there are egos that stay on the road,
    leave it, drive in circles, stop, and drive backwards.
    """
    rng = np.random.default_rng([seed, 5])
    size = np.array([1.0, 10 ** rng.uniform(-3, 0)])
    mean, spread = rng.uniform(-1, 1, 2), rng.uniform(0, 1, 2)
    return np.clip(size * (mean + spread * rng.normal(size=(decisions, 2))), -1, 1)

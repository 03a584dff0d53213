"""What an engine is, and the rules that all follow.

In one simulation step every driver model acts, in the order of the engine's `models`. The vehicles
of one model act in the order of entry, and each sees the target lanes of the vehicles before it.
Then all vehicles move, and then collisions are found. Actions given by `command` take effect before
the step that follows.

A vehicle with continuous actions keeps its acceleration and its steering angle until the next
action. As in highway-env, it has no targets: the traffic treats its target speed as 0 and its
nearest lane as its target lane.

`testing.reference_engine` is highway-env itself behind this interface. On every x86-64 processor,
it is equal to the last bit in a process that `testing.exact_maths` has prepared. In any other one,
its bits depend on the processor, NumPy, OpenBLAS and the C library.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from charms_bench.engine.seats import vacate
from charms_bench.engine.stepping import BeforeMove
from charms_bench.engine.views import Views
from charms_bench.plugins.agent import DriverModel, Policy
from charms_bench.world.actions import Actions, MetaAction
from charms_bench.world.plan_view import Plan
from charms_bench.world.recorded_moments import Moments
from charms_bench.world.scene import Bools, Floats, Ints, Scene, SceneSettings, Vehicles

if TYPE_CHECKING:
    from charms_bench.engine.state import SceneState


class Cast(NamedTuple):
    """The agents whose vehicles an engine moves, by their indices."""

    models: Mapping[int, DriverModel] = MappingProxyType({})
    """The driver models, in the order in which they act; `command` drives all other vehicles."""
    continuous: Collection[int] = ()
    """The agents with continuous actions."""
    memory: int = 0
    """The width of the scene's memory."""
    prescribed: Collection[int] = ()
    """The agents for whose vehicles `before_move` decides."""
    own_actions: Mapping[int, tuple[MetaAction, ...]] = MappingProxyType({})
    """The meta-actions of the agents that have other ones than highway-env's."""
    policies: Mapping[int, Policy] = MappingProxyType({})
    """The policies, whose observations decide how vehicles act on a road with a name."""

    @property
    def parameters(self) -> int:
        """P of the scene."""
        return max((len(model.parameters) for model in self.models.values()), default=0)


class Engine(ABC):
    """B scenes of N vehicles that advance together; nothing is spawned yet.

    What is not abstract is as on the straight road, unless an engine says otherwise.
    """

    drivers: Ints
    """[B, N] the index of each vehicle's agent."""
    measures: Mapping[str, Floats] = MappingProxyType({})
    """[B] what a road adds to the rows of episodes, by column."""
    goals: Bools
    """[B] whether the ego has reached the goal of its road."""
    has_goal = False
    """Whether the road has one."""
    egos = 1
    """How many of the first vehicles are egos, which the ego's agent drives."""
    ego_index = 0
    """Which of them is the ego of the next episodes, the vehicle at place 0."""
    renewal_steps = 0
    """After so many simulation steps each, a road lets vehicles enter and leave; 0 if never."""
    arrivals = 0
    """So many vehicles at most enter at random by `scene.inflow`."""
    moments: Moments | None = None
    """The moments of a recorded scene on a road in a file; None if there are none."""
    scene: Scene
    """The scenes along the ways of their egos; to be asked for anew after a step."""
    state: Scene
    """All vehicles where they are on the road; on the straight road, it is `scene` itself."""

    def __init__(self, settings: SceneSettings, scenes: int, cast: Cast) -> None:
        self._settings, self._models = settings, dict(cast.models)
        self._continuous, self._prescribed = list(cast.continuous), list(cast.prescribed)
        self.drivers = np.zeros((scenes, settings.vehicles), dtype=np.int64)
        self.goals = np.zeros(scenes, dtype=np.bool_)

    @abstractmethod
    def reset(
        self, rows: Ints, seeds: NDArray[np.uint64], agents: Ints, draws: Floats | None = None
    ) -> None:
        """Spawns the scenes `rows` (R,), with vehicles at their places in the order of entry.

        A scene depends on its seed and the settings alone. `agents` (R, N) are that of the ego,
        then those of the other vehicles by their places. `draws` (R, D) place the vehicles instead
        of the seeds; see `engine.draws`.
        """

    def settle(self, rows: Ints, seeds: NDArray[np.uint64]) -> None:
        """Takes over which vehicles of the scenes `rows` (R,) are there, and what drives them.

        Both have been written into `state` and `drivers` while an episode lasts.
        """
        vacate(self.scene, rows)
        self.restore(rows, seeds)

    def saved(self, rows: Ints) -> NDArray[np.uint8]:
        """What decides what follows in the scenes `rows` (R,), beside `state`; (R, W), W can be 0.

        The straight road has nothing.
        """
        return np.zeros((rows.size, 0), dtype=np.uint8)

    def check(self, state: "SceneState") -> None:  # noqa: B027  # the file of a state was checked
        """Raises an `InputError` if a state of these settings holds what no scene of a road can."""

    @abstractmethod
    def restore(
        self, rows: Ints, seeds: NDArray[np.uint64], saved: NDArray[np.uint8] | None = None
    ) -> None:
        """Takes over what was written into `state` and `drivers` for the scenes `rows` (R,).

        On a road, `saved` is what the method of that name returned. The neighbours and all other
        arrays that follow from positions and headings are found.
        """

    def renew(self, rows: Ints, agents: Ints, times_s: Floats) -> Vehicles:
        """Lets vehicles leave and enter the scenes `rows` (R,), and returns those that enter.

        They are numbered in the order of entry. Their drivers are the `agents` (R, A), as indices,
        in this order, and then again from the first on. `times_s` (R,) have passed since the start.
        """
        return rows[:0], rows[:0]

    def plan(self, row: int) -> Plan | None:
        """Where the vehicles of a scene are on its road, for pictures; None if it is straight."""
        return None

    def views(self) -> Views:
        """What each vehicle sees along its own way, from now on; not of the straight road."""
        raise NotImplementedError

    def seen_by(self, vehicles: Vehicles) -> tuple[Scene, Vehicles]:
        """The scenes as M vehicles see them, read-only, and these vehicles there."""
        return self._shown, vehicles

    @cached_property
    def _shown(self) -> Scene:
        return self.scene.read_only()

    def __getstate__(self) -> dict[str, Any]:
        """A copy makes the views anew: copied ones would be arrays in which nothing happens."""
        return {name: value for name, value in vars(self).items() if name != "_shown"}

    @abstractmethod
    def command(self, vehicles: Vehicles, actions: Actions) -> None:
        """Gives each of M vehicles a meta-action, (M,), or a continuous one, (M, 2)."""

    @abstractmethod
    def advance(self, hold_egos: bool = False, before_move: BeforeMove | None = None) -> None:
        """Advances every active scene by one simulation step.

        `before_move` is called when all agents have acted. It can change the control of prescribed
        vehicles, and says where the step ends for vehicles that follow a recording.

        If `hold_egos`, the egos keep the steering and the acceleration of the step before, within
        highway-env's limits, and their driver models are not asked.
        """


MakeEngine = Callable[[SceneSettings, int, Cast], Engine]
"""The class of an engine, or what makes one."""

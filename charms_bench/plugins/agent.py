"""The plugin contract of an agent, which drives many vehicles at once.

An agent is a `Policy` or a `DriverModel`. It is registered in the entry-point group
`charms_bench.agents`, under the name that suites use. It keeps no state between calls, because its
vehicles may be split over several calls, or over several runs, at any time. What it has to remember
is its declared memory, which the harness keeps with the state of the scenes.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

from charms_bench.world.actions import ActionsLike
from charms_bench.world.observations import ObservationLike
from charms_bench.world.scene import Floats, Ints, Observations, Scene, Vehicles

ACCELERATION_LIMIT_MPS2 = 20.0
"""The largest acceleration, either way, that a driver model may return."""


class Policy(ABC):
    """Chooses actions from observations, a few times per second."""

    actions: ActionsLike = "meta"
    """Its meta-actions, such as `(*DEFAULT_ACTIONS, MetaAction("BRAKE",
    speed_from_present_mps=-6.0))`. By default they are highway-env's, whose FASTER and SLOWER
    change the target speed as the profile says; with `with_speed_steps(0.25, 0.5, 1.0, 2.0)`, they
    have steps of their own. `continuous` actions are kept until its next decision (zero-order
    hold)."""

    observation: ObservationLike = "neighbours"
    """The observation that the policy receives."""

    decision_hz: float = 3.0
    """Decisions per second; the suite's simulation rate must be a multiple of this rate."""

    history_length: int = 1
    """The number K of observations that it receives. If it is above 1, `observations` is
    (M, K, ...), the latest last, with zeros for the time before the first decision."""

    memory_width: int = 0
    """The width Q of its memory: numbers per vehicle, zeros before the first decision."""

    noise_draws: int = 0
    """The number W of random numbers per decision, uniform in [0, 1) and independent. They depend
    only on the episode, the vehicle and the decision (`foundation.philox`)."""

    rollouts_with: str = ""
    """For a planner, the agent that drives all other vehicles in its rollouts. The planner receives
    `rollouts`, which simulates plans from a copy of the scene; see `engine.rollouts`."""

    @abstractmethod
    def decide(self, observations: Observations, *given: Any) -> Any:
        """The action of each vehicle.

        Args:
            observations: (M, 7, 5) for `neighbours`, (M, 5, 5) for highway-env's `Kinematics` with
                its default options; float32. See `charms_bench.world.observations`.
            given: Nothing for a plain policy, `decide(observations)`. A policy that declares
                `memory_width`, `noise_draws` or `rollouts_with` is asked
                `decide(observations, memory, noise)` with memory (M, Q) and noise (M, W), float64;
                with `rollouts_with`,
                `decide(observations, memory, noise, rollouts)`.

        Returns:
            (M,) integers, indices into `actions`, by default 0..4 for those whose names are
            `ACTIONS`. If `actions` is `continuous`, (M, 2) floats
            from -1 to 1: an acceleration, up to 5 m/s² either way, and a steering angle, up to
            pi / 4 rad either way, positive to the right. With `memory_width`, a pair: these actions
            and the new memory (M, Q).
        """

    @property
    def weights_sha256(self) -> str:
        """The hash of the policy's weights; empty for a policy without weights."""
        return ""


class DriverModel(ABC):
    """Chooses the acceleration and the lane of its vehicles at every simulation step.

    For the ego, it does so once per decision if the profile's `ego_control_rate` says so.
    """

    highway_env_class: ClassVar[str] = ""
    """The highway-env vehicle class that is this model's reference, as `module:Class`.

    If it is given, the engine `highway-env` uses that class instead of this model's `drive`.
    """

    parameters: Mapping[str, tuple[float, float]] = MappingProxyType({})
    """The parameters in which the drivers of this model differ, by name, and their ranges.

    Each vehicle's are drawn from its episode's seed, uniformly and independently; a scenario can
    give them instead. `drive` finds them in `scene.parameters`, in this order. A parameter that has
    the name of a field of the profile's `idm_mobil` also applies to the `highway_env_class`.
    """

    files_sha256: str = ""
    """The hash of the files besides its own code that decide how it drives; empty without."""

    memory_width: int = 0
    """The width Q of its memory: numbers per vehicle, zeros at the start. `drive` reads and writes
    them in the first columns of `scene.memory`."""

    follows_recording: bool = False
    """Whether its vehicles are moved as recorded, in a scene of recordings. Only where there is no
    recording, they do what `drive` says."""

    @abstractmethod
    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        """The acceleration and the target lane of each vehicle.

        The scene is as the last simulation step left it, except for the target lanes of vehicles
        whose agents act earlier in the same step. Policies act first, then the ego's driver model,
        then the driver models of the traffic, in the order in which the traffic plugin lists them.

        Args:
            scene: All scenes. The arrays are read-only, except for `timer_s` and `memory`, which
                the model may set for its own vehicles.
            vehicles: M vehicles, sorted by scene and then by the order of spawning.

        Returns:
            Accelerations (M,) in m/s², at most `ACCELERATION_LIMIT_MPS2` either way, and target
            lanes (M,), integers from 0 to lanes - 1. Answers for crashed vehicles are ignored.
        """


Agent = Policy | DriverModel

"""The plugin contract of an agent: something that drives vehicles, many at once.

An agent is a `Policy` or a `DriverModel`, registered in the entry-point group
`charms_bench.agents` under the name by which suites call it. It keeps no state between calls:
the same vehicles may be split over several calls, or several runs, at any time.
"""

from abc import ABC, abstractmethod
from typing import ClassVar

from charms_bench.world.actions import Actions
from charms_bench.world.observations import ObservationLike
from charms_bench.world.scene import Floats, Ints, Observations, Scene, Vehicles


class Policy(ABC):
    """Chooses meta-actions from observations, a few times a second."""

    observation: ObservationLike = "neighbours"
    """The observation it sees."""

    decision_hz: float = 3.0
    """Decisions a second; the suite's simulation rate must be a multiple."""

    @abstractmethod
    def decide(self, observations: Observations) -> Actions:
        """The action of each vehicle.

        Args:
            observations: (M, 7, 5) for `neighbours`, (M, 5, 5) for highway-env's `Kinematics` as
                it is by default, float32; see `charms_bench.world.observations`.

        Returns:
            (M,) integers 0..4, indices into `ACTIONS`.
        """

    @property
    def weights_sha256(self) -> str:
        """The hash of the weights it decides by; empty for a policy without any."""
        return ""


class DriverModel(ABC):
    """Chooses acceleration and lane of its vehicles at every simulation step."""

    highway_env_class: ClassVar[str] = ""
    """The highway-env vehicle class that is this model's reference, as `module:Class`.

    The engine `highway-env` then uses that class instead of this model's `drive`.
    """

    @abstractmethod
    def drive(self, scene: Scene, vehicles: Vehicles) -> tuple[Floats, Ints]:
        """The acceleration and the target lane of each vehicle.

        The scene is as the last simulation step left it, but for the target lanes of vehicles
        whose agents act before this one in the same step: policies, then the ego's driver model,
        then those of the traffic in the order in which the traffic plugin lists them.

        Args:
            scene: All scenes; of its arrays only `timer_s` of the model's vehicles may be written.
            vehicles: M vehicles, by scene and within a scene in the order of spawning.

        Returns:
            Accelerations (M,) in m/s2 and target lanes (M,), integers from 0 to lanes - 1. What
            is returned for a crashed vehicle is ignored.
        """


Agent = Policy | DriverModel

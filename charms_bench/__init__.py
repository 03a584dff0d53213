"""A benchmark harness for driving behaviour on highway-env's motorway, compiled."""

from charms_bench.agent import ACTIONS, DriverModel, Policy
from charms_bench.scene import Scene, SceneSettings
from charms_bench.traffic import Traffic

__all__ = ["ACTIONS", "DriverModel", "Policy", "Scene", "SceneSettings", "Traffic", "__version__"]
__version__ = "0.1.0"

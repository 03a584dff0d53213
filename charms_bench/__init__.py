"""A benchmark harness for driving behaviour on highway-env's motorway, compiled."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from charms_bench.plugins.agent import DriverModel, Policy
    from charms_bench.plugins.traffic import Traffic
    from charms_bench.world.actions import ACTIONS
    from charms_bench.world.kinematics import Kinematics
    from charms_bench.world.scene import Scene, SceneSettings

__version__ = "0.1.0"
_PUBLIC = {
    "ACTIONS": "world.actions",
    "DriverModel": "plugins.agent",
    "Kinematics": "world.kinematics",
    "Policy": "plugins.agent",
    "Scene": "world.scene",
    "SceneSettings": "world.scene",
    "Traffic": "plugins.traffic",
}
__all__ = [
    "ACTIONS",
    "DriverModel",
    "Kinematics",
    "Policy",
    "Scene",
    "SceneSettings",
    "Traffic",
    "__version__",
]


def __getattr__(name: str) -> Any:
    """Imports public names when they are asked for: the command line answers sooner."""
    if name in _PUBLIC:
        return getattr(import_module(f"charms_bench.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module 'charms_bench' has no attribute '{name}'")

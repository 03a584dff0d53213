"""A benchmark harness for driving behaviour on highway-env's motorway, compiled."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from charms_bench.agent import ACTIONS, DriverModel, Policy
    from charms_bench.kinematics import Kinematics
    from charms_bench.scene import Scene, SceneSettings
    from charms_bench.traffic import Traffic

__version__ = "0.1.0"
_PUBLIC = {
    "ACTIONS": "agent",
    "DriverModel": "agent",
    "Kinematics": "kinematics",
    "Policy": "agent",
    "Scene": "scene",
    "SceneSettings": "scene",
    "Traffic": "traffic",
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

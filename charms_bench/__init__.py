"""A compiled benchmark harness for driving behaviour on highway-env's motorway.

All public names are here; each is imported when it is first used, so `import charms_bench` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from charms_bench.api import Rare as Rare
    from charms_bench.api import Run as Run
    from charms_bench.api import audit as audit
    from charms_bench.api import open_run as open_run
    from charms_bench.api import open_training as open_training
    from charms_bench.api import rare as rare
    from charms_bench.api import run as run
    from charms_bench.api import search as search
    from charms_bench.api import train as train
    from charms_bench.api import warm_up as warm_up
    from charms_bench.engine.state import SceneState as SceneState
    from charms_bench.engine.state_file import load_state as load_state
    from charms_bench.engine.state_file import save_state as save_state
    from charms_bench.envs.learners_vector_env import LearnersVectorEnv as LearnersVectorEnv
    from charms_bench.envs.parallel_env import HighwayParallelEnv as HighwayParallelEnv
    from charms_bench.envs.road_parallel_env import RoadParallelEnv as RoadParallelEnv
    from charms_bench.envs.sb3 import EpisodesVecEnv as EpisodesVecEnv
    from charms_bench.errors import CharmsBenchError as CharmsBenchError
    from charms_bench.errors import InputError as InputError
    from charms_bench.errors import ModelError as ModelError
    from charms_bench.foundation.compiled import compiled as compiled
    from charms_bench.humans.reference import references as references
    from charms_bench.maps.reading import read_road as read_road
    from charms_bench.maps.road_file import write_road as write_road
    from charms_bench.maps.road_map import RoadMap as RoadMap
    from charms_bench.metrics import Metric as Metric
    from charms_bench.metrics import MetricSet as MetricSet
    from charms_bench.metrics.metric import ratio as ratio
    from charms_bench.plugins.agent import DriverModel as DriverModel
    from charms_bench.plugins.agent import Policy as Policy
    from charms_bench.plugins.event import Event as Event
    from charms_bench.plugins.registry import make_agent as make_agent
    from charms_bench.plugins.registry import make_traffic as make_traffic
    from charms_bench.plugins.traffic import Mixture as Mixture
    from charms_bench.plugins.traffic import Traffic as Traffic
    from charms_bench.report.table import Table as Table
    from charms_bench.report.training_tables import Training as Training
    from charms_bench.roads.layout import Layout as Layout
    from charms_bench.testing import agent_rules as agent_rules
    from charms_bench.testing import traffic_rules as traffic_rules
    from charms_bench.world.actions import ACTIONS as ACTIONS
    from charms_bench.world.actions import DEFAULT_ACTIONS as DEFAULT_ACTIONS
    from charms_bench.world.actions import FASTER as FASTER
    from charms_bench.world.actions import IDLE as IDLE
    from charms_bench.world.actions import LANE_LEFT as LANE_LEFT
    from charms_bench.world.actions import LANE_RIGHT as LANE_RIGHT
    from charms_bench.world.actions import SLOWER as SLOWER
    from charms_bench.world.actions import Actions as Actions
    from charms_bench.world.actions import MetaAction as MetaAction
    from charms_bench.world.actions import with_speed_steps as with_speed_steps
    from charms_bench.world.kinematics_observation import Kinematics as Kinematics
    from charms_bench.world.observations import ACTION_MASK as ACTION_MASK
    from charms_bench.world.observations import EGO as EGO
    from charms_bench.world.observations import FRONT as FRONT
    from charms_bench.world.observations import LEFT_FRONT as LEFT_FRONT
    from charms_bench.world.observations import LEFT_REAR as LEFT_REAR
    from charms_bench.world.observations import REAR as REAR
    from charms_bench.world.observations import RIGHT_FRONT as RIGHT_FRONT
    from charms_bench.world.observations import RIGHT_REAR as RIGHT_REAR
    from charms_bench.world.observations import SPEED_SCALE_MPS as SPEED_SCALE_MPS
    from charms_bench.world.observations import X_SCALE_M as X_SCALE_M
    from charms_bench.world.observations import Y_SCALE_M as Y_SCALE_M
    from charms_bench.world.road import closest_lane as closest_lane
    from charms_bench.world.road import local_coordinates as local_coordinates
    from charms_bench.world.scene import Bools as Bools
    from charms_bench.world.scene import Floats as Floats
    from charms_bench.world.scene import Ints as Ints
    from charms_bench.world.scene import Observations as Observations
    from charms_bench.world.scene import Scene as Scene
    from charms_bench.world.scene import SceneSettings as SceneSettings
    from charms_bench.world.scene import Vehicles as Vehicles

__version__ = "0.1.0"
_NAMES = {
    "api": "Rare Run audit open_run open_training rare run search train warm_up",
    "engine.state": "SceneState",
    "engine.state_file": "load_state save_state",
    "envs.learners_vector_env": "LearnersVectorEnv",
    "errors": "CharmsBenchError InputError ModelError",
    "foundation.compiled": "compiled",
    "maps.reading": "read_road",
    "maps.road_file": "write_road",
    "maps.road_map": "RoadMap",
    "metrics": "Metric MetricSet",
    "metrics.metric": "ratio",
    "humans.reference": "references",
    "plugins.agent": "DriverModel Policy",
    "plugins.event": "Event",
    "plugins.registry": "make_agent make_traffic",
    "plugins.traffic": "Mixture Traffic",
    "report.table": "Table",
    "report.training_tables": "Training",
    "roads.layout": "Layout",
    "testing": "agent_rules traffic_rules",
    "world.actions": (
        "ACTIONS Actions DEFAULT_ACTIONS FASTER IDLE LANE_LEFT LANE_RIGHT MetaAction "
        "SLOWER with_speed_steps"
    ),
    "world.kinematics_observation": "Kinematics",
    "world.observations": (
        "ACTION_MASK EGO FRONT LEFT_FRONT LEFT_REAR REAR RIGHT_FRONT RIGHT_REAR "
        "SPEED_SCALE_MPS X_SCALE_M Y_SCALE_M"
    ),
    "world.road": "closest_lane local_coordinates",
    "world.scene": "Bools Floats Ints Observations Scene SceneSettings Vehicles",
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names.split()}
__all__ = ["__version__", *_MODULE_OF]
_MODULE_OF |= {  # names that need an extra
    "HighwayParallelEnv": "envs.parallel_env",
    "RoadParallelEnv": "envs.road_parallel_env",
    "EpisodesVecEnv": "envs.sb3",
}


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first used."""
    if name in _MODULE_OF:
        return getattr(import_module(f"charms_bench.{_MODULE_OF[name]}"), name)
    raise AttributeError(f"module 'charms_bench' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*__all__, *_MODULE_OF})

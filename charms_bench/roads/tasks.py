"""The environments that can be simulated, by highway-env's names."""

from charms_bench.roads.merge import Merge
from charms_bench.roads.task import Task

TASKS: dict[str, type[Task]] = {"merge-v0": Merge, "merge-v1": Merge}

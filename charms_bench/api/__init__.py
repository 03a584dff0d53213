"""The Python interface: run a suite, open a run, train networks.

    run = charms_bench.run("suites/ego.yaml", episodes=200)
    run.table.select("speed_mean", "crashed_episodes").frame()
    run.edge_cases(top=3)

The command line is a thin layer over these functions. They import what they need when they run, so
that a run starts at once.
"""

from charms_bench.api.auditing import audit as audit
from charms_bench.api.evaluation import run as run
from charms_bench.api.failures import search as search
from charms_bench.api.rare_events import Rare as Rare
from charms_bench.api.rare_events import rare as rare
from charms_bench.api.results import Run as Run
from charms_bench.api.results import open_run as open_run
from charms_bench.api.training import open_training as open_training
from charms_bench.api.training import train as train
from charms_bench.api.warming import warm_up as warm_up

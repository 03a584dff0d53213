"""A suite, and its table as a file has it."""

from charms_bench.runs.suite import Suite

EGO = """\
agent,traffic,metric_set,metric,value,low,high,n,paper
IDM,mixed,paper-2,speed_mean,24.0,23.5,24.5,100,24.2
CHARMS,mixed,paper-2,speed_mean,30.0,29.0,31.0,100,
IDM,mixed,paper-2,dhw_mean,40.0,39.0,41.0,100,
CHARMS,mixed,paper-2,dhw_mean,,,,0,
IDM,mixed,standard-5(ttc_s=2),speed_mean,25.0,24.0,26.0,100,
CHARMS,mixed,standard-5(ttc_s=2),speed_mean,31.0,30.0,32.0,100,
"""
SUITE = Suite.model_validate(
    {"suite": "ego", "episodes": 1, "egos": [{"agent": "a"}], "traffic_models": [{"traffic": "t"}]}
)

"""Searches what bounds CHARMS on roads; see docs/training-plan-roads.md.

    python tools/roads_bound.py NETWORKS RUNS

NETWORKS and RUNS are those of `plan_roads.py`. Each validation episode in which the first seed's
network does not reach the goal is simulated again, `TRIES` times: the network drives in a style
that each try draws, and in up to `SEGMENTS` parts of the episode, a drawn action takes its place.
"""

import sys
from pathlib import Path

import numpy as np
import plan_roads as plan
from result_pages import keep

from charms_bench.engine.endings import GOAL
from charms_bench.envs.learners import Learners
from charms_bench.envs.progress_reward import ProgressReward
from charms_bench.metrics.collisions import ENDING
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_traffic
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table
from charms_bench.runs.finished_run import open_finished
from charms_bench.world.scene import SceneSettings

TRIES, SEGMENTS, LONGEST = 256, 3, 18
"""The longest part is 6 s."""
FORMS = {
    "episodes": ",.0f",
    "goal reached": ".1%",
    "no try reaches it": ".1%",
    "fewer than 5 % of the tries do": ".1%",
}


def reached(
    settings: SceneSettings, policies: list[OnnxPolicy], seed: int, rng: np.random.Generator
) -> float:
    """The proportion of the tries in which the ego reaches the goal of the episode of a seed."""
    one, count = policies[0], settings.decisions
    traffic = make_traffic(plan.OWN)
    how = ProgressReward(), one.observation, "tries", one.actions
    learners = Learners(settings, TRIES, (0,), traffic, {}, *how)
    learners.reset(np.full(TRIES, seed, dtype=np.uint64), np.arange(TRIES))
    style = rng.integers(len(policies), size=TRIES)
    given = np.full((count, TRIES), -1)
    for k in range(TRIES):
        for _ in range(rng.integers(SEGMENTS + 1)):
            start, length = rng.integers(count), rng.integers(1, LONGEST + 1)
            given[start : start + length, k] = rng.integers(len(one.actions))
    for decision in range(count):
        if not (alive := learners.alive).any():
            break
        actions, seen = np.zeros(TRIES, dtype=np.int64), learners.observe(learners.vehicles)
        for k, policy in enumerate(policies):
            some = np.nonzero((style == k) & alive)[0]
            noise = rng.random((some.size, policy.noise_draws))
            actions[some] = policy.decide(seen[some], np.zeros((some.size, 0)), noise)
        learners.step(np.where(given[decision] >= 0, given[decision], actions))
    return float((learners.simulation.ending == GOAL).mean())


def bound(networks: Path, runs: Path) -> None:
    """Searches, and writes the table."""
    rng, run, records = np.random.default_rng(0), open_finished(runs / plan.VALIDATION[0]), []
    network = networks / str(plan.FIRST_SEED) / "networks" / "roads.onnx"
    policies = [OnnxPolicy(network, style=style) for style in plan.STYLES]
    for index in run.finished:
        cell, settings = run.cell(index), run.suite.cells[index].scene
        if cell.agent != f"{plan.CHARMS}{plan.SEED}{plan.FIRST_SEED}":
            continue
        ended = cell.episodes.group_by("episode").agg(goal=ENDING == "goal").sort("episode")
        failed = ended.remove("goal")["episode"].to_list()
        found = np.array([reached(settings, policies, seed, rng) for seed in failed])
        count = len(ended)
        parts = count, 1 - len(failed) / count, (found == 0).sum() / count
        few = (found < 0.05).sum() / count
        records.append({"road": cell.road} | dict(zip(FORMS, (*parts, few), strict=True)))
        print(records[-1], flush=True)
    keep("plan-roads-bound", markdown(Table.plain(records, ("road",), FORMS)))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python tools/roads_bound.py NETWORKS RUNS")
    bound(*map(Path, sys.argv[1:]))

"""Episodes of a run, simulated again from their seeds, with what every vehicle did.

A run keeps rows of its egos alone. An episode follows from its seed and its agents, so whatever
else is to be known of it is simulated again and held against those rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from charms_bench.engine.recording import Recording
from charms_bench.engine.simulation import Simulation
from charms_bench.errors import RunFolderError, suggestion
from charms_bench.plugins.agent import Agent
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.specs import AgentSpec
from charms_bench.runs.finished import FinishedRun
from charms_bench.runs.runner import plan
from charms_bench.runs.suite import Cell, EgoEntry
from charms_bench.world.scene import Bools, Floats, Ints, SceneSettings

TRAJECTORY_SCHEMA = pl.Schema(
    {
        "t_s": pl.Float64(),  # since the start of the episode
        "vehicle": pl.Int32(),  # its place in the order of spawning
        "agent": pl.String(),
        "ego": pl.Boolean(),
        "x": pl.Float64(),  # m, centre along the road
        "y": pl.Float64(),  # m, centre to the right of the leftmost lane's centre
        "heading": pl.Float64(),  # rad, positive to the right
        "speed": pl.Float64(),  # m/s
        "acceleration": pl.Float64(),  # m/s2, as commanded
        "lane": pl.Int8(),  # the nearest, 0 is the leftmost
        "target_lane": pl.Int8(),
        "action": pl.Int8(),  # index into agent.ACTIONS; null under a driver model
        "crashed": pl.Boolean(),
    }
)


@dataclass(frozen=True)
class Replay:
    """An episode: T simulation steps and the start before them, N vehicles."""

    cell: Cell
    settings: SceneSettings
    episode: int
    """Its seed."""
    ego: int
    """The ego's place."""
    agents: tuple[str, ...]
    """N names."""
    t_s: Floats
    """[T + 1] since the start."""
    x: Floats
    """[T + 1, N], as all that follow; see `scene.Scene`."""
    y: Floats
    heading: Floats
    speed: Floats
    acceleration: Floats
    lane: Ints
    target_lane: Ints
    crashed: Bools
    action: Ints
    """The last meta-action, -1 before the first and under a driver model."""
    episodes: pl.DataFrame
    """Its episode row (`recording.EPISODE_SCHEMA`)."""
    steps: pl.DataFrame
    """Its step rows (`recording.STEP_SCHEMA`)."""

    @property
    def ending(self) -> str:
        """One of `simulation.ENDINGS`."""
        return str(self.episodes["ending"].item())

    def frame_of(self, step: int) -> int:
        """The simulation step in which a decision interval, counted from 1, ends."""
        return step * self.settings.simulation_hz // self.settings.decision_hz

    def trajectories(self) -> pl.DataFrame:
        """A row a vehicle and simulation step, by time and vehicle (`TRAJECTORY_SCHEMA`)."""
        frames, vehicles = self.x.shape
        place = np.tile(np.arange(vehicles), frames)
        action = pl.Series(self.action.ravel())
        columns = {
            "t_s": np.repeat(self.t_s, vehicles),
            "vehicle": place,
            "agent": list(self.agents) * frames,
            "ego": place == self.ego,
            **{name: getattr(self, name).ravel() for name in _OF_SCENE},
            "action": action.set(action < 0, None),
        }
        return pl.DataFrame(columns).select(TRAJECTORY_SCHEMA.names()).cast(TRAJECTORY_SCHEMA)


_OF_SCENE = (
    "x", "y", "heading", "speed", "acceleration", "lane", "target_lane", "crashed"
)  # fmt: skip


def find_cells(run: FinishedRun, agent: str | None, traffic: str | None) -> list[int]:
    """The cells of a run whose ego and traffic have these titles; None is any.

    Raises:
        RunFolderError: It has none of that title.
    """
    asked = {
        "ego": (agent, [entry.title for entry in run.suite.egos]),
        "traffic": (traffic, [entry.title for entry in run.suite.traffics]),
    }
    for what, (title, titles) in asked.items():
        if title is not None and title not in titles:
            known = suggestion(title, dict.fromkeys(titles))
            raise RunFolderError(f"{run.folder.path}: no {what} called '{title}'. {known}")
    return [
        index
        for index, cell in enumerate(run.suite.cells)
        if agent in (None, cell.ego.title) and traffic in (None, cell.traffic.title)
    ]


def replay(run: FinishedRun, cell: int, episodes: Sequence[int], folder: Path) -> list[Replay]:
    """Episodes of a cell, in the order asked for.

    Args:
        run: A finished run.
        cell: Index into its suite's `cells`.
        episodes: Their seeds; all are kept in memory.
        folder: Where paths of networks in the suite start.

    Raises:
        RunFolderError: The run has no such episode, or it goes another way now.
        CharmsBenchError: An agent cannot be made.
    """
    stored = _stored(run, cell, episodes)
    simulation = _simulation(run, cell, len(episodes), folder)
    simulation.reset(np.array(episodes, dtype=np.uint64))
    recording = Recording(simulation)
    frames = [_frame(simulation)]
    interval = simulation.settings.simulation_hz // simulation.settings.decision_hz
    while simulation.scene.active.any():
        for _ in range(interval):
            simulation.advance()
            frames.append(_frame(simulation))
        simulation.finish_step()
        recording.note()
    ended, steps = recording.episodes(), recording.steps()
    drivers = simulation.drivers
    replays = []
    for b, episode in enumerate(episodes):
        mine = pl.col("episode") == episode
        again = steps.filter(mine)
        _check(run, cell, folder, stored.filter(mine), again)
        length = int(simulation.steps[b]) * interval + 1
        replays.append(
            Replay(
                cell=run.suite.cells[cell],
                settings=run.suite.scene,
                episode=episode,
                ego=int(simulation.scene.ego[b]),
                agents=tuple(map(str, drivers[b])),
                t_s=np.arange(length) / run.suite.scene.simulation_hz,
                episodes=ended.filter(mine),
                steps=again,
                **{
                    name: np.stack([frame[name][b] for frame in frames[:length]])
                    for name in frames[0]
                },
            )
        )
    return replays


def _stored(run: FinishedRun, cell: int, episodes: Sequence[int]) -> pl.DataFrame:
    """The run's step rows of these episodes."""
    first, last = run.suite.seed, run.suite.seed + run.suite.episodes - 1
    for episode in episodes:
        if not first <= episode <= last:
            raise RunFolderError(
                f"{run.folder.path}: holds the episodes {first} to {last}, not {episode}"
            )
    shards = [
        shard
        for shard in run.shards
        if shard.cell == cell
        and any(0 <= episode - shard.first_seed < shard.episodes for episode in episodes)
    ]
    return run.folder.read("steps", shards).filter(pl.col("episode").is_in(list(episodes)))


def _simulation(run: FinishedRun, cell: int, scenes: int, folder: Path) -> Simulation:
    ego = run.suite.cells[cell].ego.agent
    traffic = run.suite.cells[cell].traffic.traffic.make()
    agents = {name: AgentSpec(name=name).make(folder) for name in traffic.agents}
    agents[ego.key] = _ego(run, ego, folder)
    return Simulation(run.suite.scene, scenes, ego.key, traffic, agents)


def _ego(run: FinishedRun, ego: AgentSpec, folder: Path) -> Agent:
    """The ego's agent; a network given by path is the one that the run folder holds."""
    kept = None if ego.onnx is None else run.folder.network(ego.key)
    if kept is None:
        return ego.make(folder)
    network = OnnxPolicy(kept, ego.decision_hz)
    if network.weights_sha256 != kept.stem:
        raise RunFolderError(f"{kept}: has changed since it was written; run the suite again")
    return network


def _frame(simulation: Simulation) -> dict[str, Any]:
    """Copies `[B, N]` of what a replay keeps of a moment."""
    scene = {name: getattr(simulation.scene, name).copy() for name in _OF_SCENE}
    return scene | {"action": simulation.action.copy()}


def _check(
    run: FinishedRun, cell: int, folder: Path, stored: pl.DataFrame, again: pl.DataFrame
) -> None:
    """Refuses a replay whose ego's rows are not the run's."""
    if again.equals(stored):
        return
    both = stored.join(again, on=["episode", "step"], how="full", suffix="_now")
    differing = [
        (row["step"] or row["step_now"], name, row[name], row[f"{name}_now"])
        for row in both.iter_rows(named=True)
        for name in stored.columns
        if row[name] != row[f"{name}_now"]
    ]
    step, name, then, now = min(differing, key=lambda difference: difference[0])
    raise RunFolderError(
        f"{run.folder.path}: episode {stored['episode'][0]} of {run.suite.cells[cell].ego.title} "
        f"goes another way now: step {step}, {name} was {then}, now {now}. "
        f"{_reason(run, cell, folder)}"
    )


def _reason(run: FinishedRun, cell: int, folder: Path) -> str:
    """Why an episode may go another way than when the run was made."""
    manifest, chosen = run.folder.manifest(), run.suite.cells[cell]
    ego = chosen.ego
    if ego.agent.onnx is not None:  # known by its hash; the traffic's agents are left to compare
        ego = EgoEntry(agent=AgentSpec(name=chosen.traffic.traffic.make().agents[0]))
    alone = {"egos": (ego,), "traffics": (chosen.traffic,), "folder": folder}
    _, agents = plan(run.suite.model_copy(update=alone), "batched")
    theirs = manifest.get("agents", {})
    changed = [name for name, identity in agents.items() if theirs.get(name) != identity]
    if changed:
        return f"The run had other versions of: {', '.join(changed)}; install those to replay it"
    return (
        f"The run is of charms-bench {manifest.get('charms_bench')} with "
        f"{manifest.get('versions')}; install those to replay it"
    )

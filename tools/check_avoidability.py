"""Checks avoidability by a plain search: `python tools/check_avoidability.py RUN --ego LABEL`.

For some collisions of an ego that is a policy, all 15,625 sequences of six meta-actions are
simulated, twice: from the last decision with an escape, and from the decision after it. Nothing is
left out as a repetition. Before these decisions, the episode is simulated from its seed, and the
ego takes its recorded actions. Sequences that survive are continued with every meta-action,
decision by decision, until all have failed or, for the first of the two, one has survived.
"""

import argparse
from pathlib import Path

import numpy as np

from charms_bench import open_run
from charms_bench.engine.simulation import Simulation
from charms_bench.engine.state import SceneState
from charms_bench.episodes.recorded_cell import RecordedCell, find_cell
from charms_bench.episodes.replay import Replay, replay
from charms_bench.runs.finished_run import open_finished
from charms_bench.world.actions import ACTIONS
from charms_bench.world.scene import Bools, Ints

DEPTH = 6
SCENES = len(ACTIONS) ** DEPTH


def survivors(simulation: Simulation, start: SceneState, sequences: Ints) -> Bools:
    """Which of S sequences (S, K) the ego survives."""
    alive = np.zeros(len(sequences), dtype=np.bool_)
    for first in range(0, len(sequences), SCENES):
        chunk = sequences[first : first + SCENES]
        rows = np.arange(len(chunk))
        simulation.scene.active[:] = False
        simulation.restore(start.take(np.zeros(len(chunk), dtype=np.int64)), rows)
        actions = np.zeros(SCENES, dtype=np.int64)
        for taken in chunk.T:
            actions[rows] = taken
            simulation.step(actions)
        alive[first : first + SCENES] = ~simulation.failed[rows]
    return alive


def before(simulation: Simulation, episode: Replay, step: int) -> SceneState:
    """The episode before a decision, from its seed."""
    row = np.array([0])
    simulation.scene.active[:] = False
    simulation.reset(np.array([episode.episode], dtype=np.uint64), row)
    for action in episode.action[1 :: episode.frame_of(1), episode.ego][: step - 1]:
        simulation.step(np.full(SCENES, action))
    return simulation.state(row)


def escapes(
    simulation: Simulation, episode: Replay, step: int, until: int, needs_proof: bool
) -> bool:
    """Whether some sequence from a decision on survives; with proof, all are tried if none does."""
    start = before(simulation, episode, step)
    length = min(DEPTH, until - step + 1)
    sequences = np.stack(np.meshgrid(*[range(len(ACTIONS))] * length, indexing="ij"), axis=-1)
    sequences = sequences.reshape(-1, length)
    sequences = sequences[survivors(simulation, start, sequences)]
    print(f"    from decision {step}: {len(sequences):,} of {5**length:,} survive", flush=True)
    if not needs_proof:  # one survivor is enough: keep one action from then on
        held = np.repeat(sequences, len(ACTIONS), axis=0)[-SCENES:]
        last = np.tile(np.arange(len(ACTIONS)), len(sequences))[-SCENES:, None]
        whole = np.concatenate([held, np.repeat(last, until - step + 1 - length, axis=1)], axis=1)
        if survivors(simulation, start, whole).any():
            return True
    while len(sequences) and sequences.shape[1] < until - step + 1:
        every = np.tile(np.arange(len(ACTIONS)), len(sequences))[:, None]
        sequences = np.concatenate([np.repeat(sequences, len(ACTIONS), axis=0), every], axis=1)
        sequences = sequences[survivors(simulation, start, sequences)]
    return len(sequences) > 0


def check(cell: RecordedCell, seed: int, step: int) -> None:
    """Raises an AssertionError if the decision is not the last one with an escape."""
    (episode,) = replay(cell, [seed])
    scene = cell.run.suite.scene
    longer = scene.model_copy(update={"duration_s": scene.duration_s + 3.0})
    simulation = cell.simulation(SCENES, settings=longer, is_ego_outside=True)
    frame = int(episode.crashed[:, episode.ego].argmax())
    until = -(-(frame + 2 * scene.simulation_hz) // scene.steps_per_decision)
    assert escapes(simulation, episode, step, until, needs_proof=False)
    if step < episode.steps.height:
        assert not escapes(simulation, episode, step + 1, until, needs_proof=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("--ego")
    parser.add_argument("--traffic")
    parser.add_argument("--collisions", type=int, default=10)
    asked = parser.parse_args()
    cell = find_cell(open_finished(asked.run), Path(), asked.ego, asked.traffic)
    found = open_run(asked.run).avoidability(ego=asked.ego, traffic=asked.traffic)
    known = [each for each in found if each.last_step is not None]
    for each in known[:: max(1, len(known) // asked.collisions)][: asked.collisions]:
        print(f"episode {each.episode}, collision in decision {each.step}", flush=True)
        check(cell, each.episode, each.last_step or 0)
        print(f"    the last decision with an escape is {each.last_step}, as found", flush=True)


if __name__ == "__main__":
    main()

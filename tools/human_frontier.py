"""Draws what fine-tuning gains in likeness to people and loses in safety, over lambda of eq. 11.

`python tools/human_frontier.py SUITE NETWORK RECORDINGS` fine-tunes NETWORK, which a stage of
the training suite SUITE with the file's name made, once for each pull, with and without rehearsal.
Networks of the same folder drive the stage's traffic where they have the name of its driver. It
draws docs/human-frontier.png, and writes and prints docs/results/human-frontier.md, which
`write_results.py` copies to the pages.

The likelihood and the agreement are those of held-out drivers; the episodes are validation
episodes of the scene of suites/ego.yaml.
"""

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from charms_agents.human.samples import Samples, SampleStore
from charms_agents.training.curve import Epoch
from charms_agents.training.network import read_network, untrained
from charms_agents.training.own_driving import own_driving
from charms_agents.training.settings import (
    EPISODES_OF_A_SEED,
    FIRST_TRAINING_SEED,
    Supervised,
    load_training,
)
from charms_agents.training.standardised import folded
from charms_agents.training.supervised import Fit
from torch.nn import Sequential

from charms_bench.engine.simulation import Simulation
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.plugins.traffic import OneAgent
from charms_bench.report.figures.drawing import crosses, panels, save
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Column, Number, Row, Table
from charms_bench.runs.suite import load_suite
from charms_bench.statistics.intervals import wilson
from charms_bench.world.observations import neighbours

DOCS = Path(__file__).parent.parent / "docs"
PULLS = (0.0, 0.002, 0.02, 0.2, 2.0, 20.0)
FIRST_SEED, EPISODES, AT_ONCE = 900_700_000, 1_000, 500
COLUMNS = (
    Column("log-likelihood", form=".3f"),
    Column("agreement", form=".1%"),
    Column("temperature", form=".2f"),
    Column("episodes crashed", form=".1%"),
    Column("speed, m/s", form=".1f"),
)


@dataclass(frozen=True)
class Outcome:
    """A network after learning: what it says of held-out drivers, and how it drives."""

    human: Epoch
    crashed: int
    speed_mps: float

    @property
    def crashed_share(self) -> Number:
        return Number(self.crashed / EPISODES, *wilson(self.crashed, EPISODES))

    @property
    def numbers(self) -> tuple[Number, ...]:
        human = (self.human.log_likelihood, self.human.agreement, self.human.temperature)
        return (*map(Number, human), self.crashed_share, Number(self.speed_mps))


def outcome(fit: Fit) -> Outcome:
    """Lets a network learn and drive."""
    fit.learn()
    network = fit.network
    scene, agents = load_suite(DOCS.parent / "suites" / "ego.yaml").scene, ["idm_mobil"]
    crashed, speeds = 0, []
    for first in range(FIRST_SEED, FIRST_SEED + EPISODES, AT_ONCE):
        traffic, drivers = OneAgent("idm_mobil"), {name: make_agent(name) for name in agents}
        simulation = Simulation(scene, AT_ONCE, None, traffic, drivers)
        simulation.reset(np.arange(first, first + AT_ONCE, dtype=np.uint64))
        running = simulation.scene.active
        while running.any():
            rows = np.flatnonzero(running)
            egos = rows, simulation.scene.ego[rows]
            speeds.append(simulation.scene.speed[egos].copy())
            actions = np.zeros(AT_ONCE, dtype=np.int64)
            actions[rows] = best_actions(network, neighbours(simulation.scene, egos))
            simulation.step(actions)
        crashed += int(simulation.failed.sum())
    return Outcome(fit.curve[-1], crashed, float(np.concatenate(speeds).mean()))


def best_actions(network: Sequential, observations: np.ndarray) -> np.ndarray:
    with torch.no_grad():
        values: np.ndarray = network(torch.from_numpy(observations).flatten(1)).numpy()
    return values.argmax(axis=1)


def commonest(samples: Samples) -> float:
    """The agreement of always choosing the action that agrees most often with training samples."""
    agrees = samples.labels == samples.labels.max(axis=1, keepdims=True)
    action = agrees[~samples.held_out].mean(axis=0).argmax()
    return float(agrees[samples.held_out, action].mean())


def outcomes(suite_file: Path, start: Path, samples: Samples) -> dict[str, Outcome]:
    """The outcome of each way to learn, by what the table calls it."""
    suite = load_training(suite_file)
    assert suite.human is not None
    stage, seed = suite.stages[start.stem], suite.seed
    standardised = suite.hyperparameters_of(stage).standardised
    traffic = suite.traffic_of(stage)
    files = {name: start.parent / f"{name}.onnx" for name in traffic.agents}
    drivers = {
        name: OnnxPolicy(file) if file.exists() else make_agent(name)
        for name, file in files.items()
    }
    network = read_network(start)
    first_seed = FIRST_TRAINING_SEED + seed * EPISODES_OF_A_SEED
    own = own_driving(network, stage.scene, traffic, drivers, first_seed)
    tuning, imitation = suite.human.fine_tuning, suite.human.imitation
    layers = suite.hyperparameters.hidden_layers

    def tuned(**changes: float) -> Outcome:
        settings = Supervised(**{**tuning.model_dump(), **changes})
        return outcome(Fit(network, samples, settings, seed, standardised, own))

    fresh = Fit(folded(untrained(layers, seed)), samples, imitation, seed, standardised=True)
    before = Fit(network, samples, tuning.model_copy(update={"epochs": 0}), seed, standardised)
    found = {"before": outcome(before), "imitation": outcome(fresh)}
    print(found, file=sys.stderr, flush=True)
    for rehearsal in (tuning.rehearsal, 0.0):
        for pull in PULLS:
            name = f"{pull:g}{'' if rehearsal else ', no rehearsal'}"
            found[name] = tuned(pull=pull, rehearsal=rehearsal)
            print(name, found[name], file=sys.stderr, flush=True)
    return found


def draw(found: dict[str, Outcome]) -> None:
    """The figure: agreement and likelihood against crashes."""
    figure, every = panels(2, 5.2, 4.0)
    series = {
        "with rehearsal": [f"{pull:g}" for pull in PULLS],
        "without rehearsal": [name for name in found if name.endswith("no rehearsal")],
        "before": ["before"],
        "imitation": ["imitation"],
    }
    for axes, place, title in zip(every, (0, 1), ("log-likelihood", "agreement"), strict=True):
        for label, names in series.items():
            points = [found[name] for name in names]
            x = [each.crashed_share for each in points]
            crosses(axes, x, [each.numbers[place] for each in points], fmt="o", label=label)
            for name, share, each in zip(names, x, points, strict=True):
                if label.startswith("with"):
                    at = (share.value, each.numbers[place].value)
                    text = name.partition(",")[0]
                    axes.annotate(text, at, (4, 3), textcoords="offset points", fontsize=7)
        axes.set(xlabel="episodes crashed", ylabel=f"{title}, held-out drivers", xscale="log")
        shares = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
        axes.minorticks_off()
        axes.set_xticks(shares, [f"{share:.0%}" for share in shares])
    every[0].legend(frameon=False, fontsize=8)
    save(figure, DOCS / "human-frontier.png")


def main(suite: Path, start: Path, recordings: Path) -> None:
    torch.set_num_threads(1)
    human = load_training(suite).human
    assert human is not None
    with tempfile.TemporaryDirectory() as cache:
        samples = SampleStore(recordings, Path(cache), human.samples).load()
    finish(outcomes(suite, start, samples), samples)


def finish(found: dict[str, Outcome], samples: Samples) -> None:
    """Draws the figure, and writes and prints the table."""
    draw(found)
    rows = tuple(Row((name,), each.numbers) for name, each in found.items())
    text = markdown(Table("human-frontier", "", ("lambda",), COLUMNS, rows))
    text += (
        f"\nAll actions alike have a log-likelihood of {-np.log(5):.3f}. Always choosing the "
        f"commonest action agrees with {commonest(samples):.1%}".replace("%", " %")
        + f" of the held-out samples. Of these there are {samples.held_out.sum():,}, of "
        f"{samples.rows['driver'].filter(samples.held_out).n_unique()} drivers; the other "
        f"{samples.rows['driver'].filter(~samples.held_out).n_unique()} drivers have "
        f"{(~samples.held_out).sum():,} samples.\n"
    )
    (DOCS / "results" / "human-frontier.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit("usage: python tools/human_frontier.py SUITE NETWORK RECORDINGS")
    main(*map(Path, sys.argv[1:]))

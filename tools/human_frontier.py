"""Draws what fine-tuning gains in likeness to people and loses in safety, over lambda of eq. 11.

`python tools/human_frontier.py SUITE NETWORK RECORDINGS` fine-tunes NETWORK, which a stage of
the training suite SUITE with the file's name made, once for each pull, with and without rehearsal.
In the traffic of the stage's conditions, networks of the same folder drive the vehicles whose
driver has their name. It draws docs/human-frontier.png, and writes and prints
docs/results/human-frontier.md, which `write_results.py` copies to the pages.

The likelihood and the agreement are those of held-out drivers; the episodes are validation
episodes of the scene of suites/ego.yaml.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch
import yaml
from charms_agents.human.samples import Samples, SampleStore
from charms_agents.training.hyperparameters import Supervised
from charms_agents.training.network import untrained
from charms_agents.training.network_file import export, read_network
from charms_agents.training.own_driving import own_driving
from charms_agents.training.settings import (
    EPISODES_OF_A_SEED,
    FIRST_TRAINING_SEED,
    Stage,
    TrainingSuite,
)
from charms_agents.training.standardised import folded
from charms_agents.training.suite_file import load_training
from charms_agents.training.supervised import Fit

import charms_bench
from charms_bench.plugins.agent import Policy
from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.plugins.registry import make_agent
from charms_bench.report.figures.drawing import crosses, panels, save
from charms_bench.report.markdown import markdown
from charms_bench.report.number import Number
from charms_bench.report.table import Table

DOCS = Path(__file__).parent.parent / "docs"
PULLS = (0.0, 0.002, 0.02, 0.2, 2.0, 20.0)
FIRST_SEED, EPISODES = 900_700_000, 1_000
FORMS = {
    "log-likelihood": ".3f",
    "agreement": ".1%",
    "temperature": ".2f",
    "episodes crashed": ".1%",
    "speed, m/s": ".1f",
}
"""What a network says of held-out drivers, and how it drives; see `Column.form`."""
Outcomes = dict[str, dict[str, Number]]
"""The numbers of `FORMS` of each network, by name."""


def driven(fits: dict[str, Fit], training: TrainingSuite, stage: Stage, folder: Path) -> Outcomes:
    """The outcomes of networks that have learnt; each drives the same episodes."""
    facts = {"decision_hz": f"{Policy.decision_hz:g}"}
    if steps := stage.scene.profile.target_speed_steps_mps:
        facts["target_speed_steps_mps"] = json.dumps(steps)
    seen, draws = training.observed, stage.prior is not None
    suite = yaml.safe_load((DOCS.parent / "suites" / "ego.yaml").read_text(encoding="utf-8"))
    egos = []
    for number, (name, fit) in enumerate(fits.items()):
        file = folder / f"{number}.onnx"
        export(fit.network, file, facts, fit.observations, seen, stochastic=draws)
        egos.append({"agent": str(file), "label": name})
    suite |= {"egos": egos, "seed": FIRST_SEED, "episodes": EPISODES}
    path = folder / "suite.yaml"
    path.write_text(yaml.safe_dump(suite), encoding="utf-8")
    table = charms_bench.run(path, folder / "run").table
    names = [column.name for column in table.columns]
    crashed, speed = names.index("crashed_episodes"), names.index("speed_mean")
    found = {}
    for (name, fit), row in zip(fits.items(), table.rows, strict=True):
        human = fit.curve[-1]
        said = map(Number, (human.log_likelihood, human.agreement, human.temperature))
        numbers = (*said, row.numbers[crashed], Number(row.numbers[speed].value))
        found[name] = dict(zip(FORMS, numbers, strict=True))
    return found


def commonest(samples: Samples) -> float:
    """The agreement of always choosing the action that agrees most often with training samples."""
    agrees = samples.labels == samples.labels.max(axis=1, keepdims=True)
    action = agrees[~samples.held_out].mean(axis=0).argmax()
    return float(agrees[samples.held_out, action].mean())


def learnt(suite: TrainingSuite, start: Path, samples: Samples) -> dict[str, Fit]:
    """Learns in each way, by what the table calls it."""
    assert suite.human is not None
    stage, seed = suite.stages[start.stem], suite.seed
    standardised = suite.hyperparameters_of(stage).standardised
    files = {name: start.parent / f"{name}.onnx" for name in suite.drivers_of(stage)}
    drivers = {
        name: OnnxPolicy(file) if file.exists() else make_agent(name)
        for name, file in files.items()
    }
    network = read_network(start)
    first_seed = FIRST_TRAINING_SEED + seed * EPISODES_OF_A_SEED
    own = own_driving(network, suite.places_of(stage), drivers, first_seed, suite.observed)
    tuning, imitation = suite.human.fine_tuning, suite.human.imitation
    rows, columns = suite.observed.shape
    fresh = folded(untrained(suite.hyperparameters.hidden_layers, seed, rows * columns))
    before = tuning.model_copy(update={"epochs": 0})
    fits = {
        "before": Fit(network, samples, before, seed, standardised),
        "imitation": Fit(fresh, samples, imitation, seed, standardised=True),
    }
    for rehearsal in (tuning.rehearsal, 0.0):
        for pull in PULLS:
            name = f"{pull:g}{'' if rehearsal else ', no rehearsal'}"
            settings = Supervised(**{**tuning.model_dump(), "pull": pull, "rehearsal": rehearsal})
            fits[name] = Fit(network, samples, settings, seed, standardised, own)
    for name, fit in fits.items():
        fit.learn()
        print(name, fit.curve[-1].in_words, file=sys.stderr, flush=True)
    return fits


def draw(found: Outcomes) -> None:
    """The figure: agreement and likelihood against crashes."""
    figure, every = panels(2, 5.2, 4.0)
    series = {
        "with rehearsal": [f"{pull:g}" for pull in PULLS],
        "without rehearsal": [name for name in found if name.endswith("no rehearsal")],
        "before": ["before"],
        "imitation": ["imitation"],
    }
    for axes, title in zip(every, ("log-likelihood", "agreement"), strict=True):
        for label, names in series.items():
            x, y = ([found[name][each] for name in names] for each in ("episodes crashed", title))
            crosses(axes, x, y, fmt="o", label=label)
            for name, share, number in zip(names, x, y, strict=True):
                if label.startswith("with"):
                    at, text = (share.value, number.value), name.partition(",")[0]
                    axes.annotate(text, at, (4, 3), textcoords="offset points", fontsize=7)
        axes.set(xlabel="episodes crashed", ylabel=f"{title}, held-out drivers", xscale="log")
        shares = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
        axes.minorticks_off()
        axes.set_xticks(shares, [f"{share:.0%}" for share in shares])
    every[0].legend(frameon=False, fontsize=8)
    save(figure, DOCS / "human-frontier.png")


def main(suite_file: Path, start: Path, recordings: Path) -> None:
    torch.set_num_threads(1)
    suite = load_training(suite_file)
    assert suite.human is not None
    with tempfile.TemporaryDirectory() as folder:
        samples = SampleStore(recordings, Path(folder), suite.human.samples, suite.observed).load()
        fits = learnt(suite, start, samples)
        found = driven(fits, suite, suite.stages[start.stem], Path(folder))
    draw(found)
    records = ({"lambda": name, **numbers} for name, numbers in found.items())
    text = markdown(Table.plain(records, ("lambda",), FORMS))
    text += (
        f"\nIf all five actions are equally likely, the log-likelihood is {-np.log(5):.3f}. Always "
        f"choosing the commonest action agrees with {commonest(samples):.1%}".replace("%", " %")
        + f" of the held-out samples. The {samples.held_out.sum():,} held-out samples come from "
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

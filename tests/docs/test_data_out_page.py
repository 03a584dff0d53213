"""The code of `docs/run-folders.md` runs; `tox -e data` has d3rlpy, in which it trains."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
from written import ROOT, blocks

import charms_bench

SUITE = """\
suite: small
episodes: 100
seed: 900000000
egos: [{agent: imitation}]
traffic_models: [{traffic: idm_mobil}]
"""
STEPS, EPOCH = 1500, 500
REPORT = """
import json
import numpy as np

observations = np.concatenate([episode.observations for episode in episodes])
actions = np.concatenate([episode.actions for episode in episodes])[:, 0]
cloned = d3rlpy.algos.DiscreteBCConfig().create(device="cpu:0")
cloned.fit(buffer, n_steps=STEPS, n_steps_per_epoch=EPOCH)
facts = {
    "steps": actions.size,
    "losses": [float(metrics["loss"]) for _, metrics in history],
    "agreement": float((cloned.predict(observations) == actions).mean()),
    "commonest": float(np.bincount(actions).max() / actions.size),
}
print("FACTS", json.dumps(facts))
"""


def test_polars_reads_the_states_of_all_vehicles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    charms_bench.run("ego", "runs/ego", episodes=1, workers=1).dataset("parquet", ego="CHARMS")
    page = blocks(ROOT / "docs" / "run-folders.md")
    (code,) = (block.text for block in page if "scan_parquet" in block.text)
    names: dict[str, Any] = {}
    exec(compile(code, "run-folders.md", "exec"), names)
    assert names["states"].collect()["vehicle"].n_unique() == 21


@pytest.mark.slow
def test_d3rlpy_trains_on_the_dataset(tmp_path: Path) -> None:
    python = os.environ.get("D3RLPY_PYTHON")
    if python is None:
        pytest.skip("needs d3rlpy in an environment of its own; run by tox -e data")
    (tmp_path / "suite.yaml").write_text(SUITE)
    run = charms_bench.run(tmp_path / "suite.yaml", tmp_path / "run", workers=1)
    run.dataset("minari", tmp_path / "datasets" / "imitation-v0")

    page = blocks(ROOT / "docs" / "run-folders.md")
    (script,) = (block.text for block in page if "import d3rlpy" in block.text)
    shortened = script.replace("3000", str(STEPS)).replace("1000", str(EPOCH))
    assert f"(buffer, n_steps={STEPS}, n_steps_per_epoch={EPOCH})" in shortened
    seeded = shortened.replace("import minari\n", "import minari\n\nd3rlpy.seed(0)\n")
    report = REPORT.replace("STEPS", str(STEPS)).replace("EPOCH", str(EPOCH))
    done = subprocess.run(
        [python, "-c", seeded + report],
        cwd=tmp_path,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("FACTS"))
    facts = json.loads(line.removeprefix("FACTS"))
    assert facts["steps"] == run.episodes["steps"].sum()
    assert facts["losses"][-1] < 0.9 * facts["losses"][0], facts
    assert facts["agreement"] > facts["commonest"] + 0.2, facts

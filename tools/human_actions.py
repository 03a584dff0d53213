"""Which actions networks choose where people drove: the shares of each, over all human samples.

    python tools/human_actions.py RECORDINGS NETWORK...

RECORDINGS is a folder in highD's format, and NETWORK an ONNX file. Networks that choose one action
almost everywhere have learnt nothing about the differences between the situations of people.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from charms_agents.human.samples import SampleSettings, SampleStore

from charms_bench.plugins.onnx_policy import OnnxPolicy
from charms_bench.report.markdown import markdown
from charms_bench.report.table import Table
from charms_bench.world.actions import ACTIONS


def main(recordings: Path, networks: list[Path]) -> None:
    with tempfile.TemporaryDirectory() as cache:
        samples = SampleStore(recordings, Path(cache), SampleSettings()).load()
    records = []
    for path in networks:
        chosen = np.bincount(OnnxPolicy(path).decide(samples.observations), minlength=len(ACTIONS))
        records.append({"network": path, **dict(zip(ACTIONS, chosen / chosen.sum(), strict=True))})
    print(markdown(Table.plain(records, ("network",), dict.fromkeys(ACTIONS, ".1%"))))
    print(f"{len(samples.observations):,} samples")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("usage: python tools/human_actions.py RECORDINGS NETWORK...")
    main(Path(sys.argv[1]), [Path(name) for name in sys.argv[2:]])

"""Trains with each library of `docs/training-libraries.md`, and prints the speed of each.

The speed is the number of decisions per second of CPU time on one core, from the end of the first
step of the environment to the end of the last one.

    python tools/library_speed.py
"""

import os
import re
import runpy
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parent.parent / "docs" / "training-libraries.md"
SCRIPT = re.compile(r"^## (.*?)$(?:(?!^## ).)*?^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
"""A section's title, and its script."""


def measure(script: str) -> None:
    """Runs a script in this process, and prints its speed."""
    from charms_bench.envs.vector_env import HighwayVectorEnv

    step, calls = HighwayVectorEnv.step, list[tuple[float, float, int]]()

    def timed(self: HighwayVectorEnv[Any], actions: Any) -> Any:
        before = time.process_time()
        result = step(self, actions)
        calls.append((before, time.process_time(), self.num_envs))
        return result

    HighwayVectorEnv.step = timed  # type: ignore[method-assign]
    runpy.run_path(script)
    (_, began, _), *later = calls
    seconds = later[-1][1] - began
    inside = sum(after - before for before, after, _ in later)
    decisions = sum(number for *_, number in later)
    print(f"{decisions / seconds:,.0f} decisions per second, {inside / seconds:.0%} in the steps")


def main() -> None:
    """Runs each script in a process and a folder of its own."""
    threads = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
    trainings, _, _ = PAGE.read_text(encoding="utf-8").partition("## Watch")
    for title, code in SCRIPT.findall(trainings):
        with tempfile.TemporaryDirectory() as folder:
            script = Path(folder, "script.py")
            script.write_text(code, encoding="utf-8")
            command = [sys.executable, "-W", "ignore", str(Path(__file__).resolve()), str(script)]
            environment = {**os.environ, **threads}
            print(f"{title}: ", end="", flush=True)
            done = subprocess.run(
                command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=True
            )
            print(done.stdout.splitlines()[-1])


if __name__ == "__main__":
    if sys.argv[1:]:
        measure(sys.argv[1])
    else:
        main()

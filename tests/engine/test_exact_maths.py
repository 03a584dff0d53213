"""highway-env's vehicles compute with the project's functions where they are simulated."""

import subprocess
import sys

import pytest

from charms_bench.testing.exact_maths import use_exact_maths

PROGRAM = """
import os
os.environ["OPENBLAS_CORETYPE"] = "Nehalem"
import numpy as np
from highway_env.road import spline
from highway_env.vehicle import behavior, controller, kinematics, objects
from charms_bench.testing.exact_maths import use_exact_maths
from charms_bench.foundation import maths

stock = np.arctan
assert controller.np is np
use_exact_maths()
assert np.arctan is stock
for module in (behavior, controller, kinematics, objects):
    for theirs, ours in (("sin", "sin"), ("cos", "cos"), ("tan", "tan"), ("arcsin", "asin"),
                         ("arctan", "atan"), ("exp", "exp")):
        assert getattr(module.np, theirs)(0.3) == getattr(maths, ours)(0.3)
    assert module.np.arctan2(3, -4) == maths.atan2(3.0, -4.0)
    assert module.np.power(0.3, 4.1) == maths.power(0.3, 4.1)
    assert module.np.power(0.3, 2) == 0.3 * 0.3
    assert module.np.sqrt is np.sqrt
use_exact_maths()  # a worker does so before each of its tasks
assert spline.CurvePose(0.0, 0.0, 3.0, 4.0).normal.tolist() == [0.6, 0.8]
"""


def test_highway_env_uses_the_projects_functions_in_workers_and_numpys_elsewhere() -> None:
    subprocess.run([sys.executable, "-c", PROGRAM], check=True)


def test_a_process_with_another_setting_of_openblas_is_rejected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    with pytest.raises(RuntimeError, match="exact maths"):
        use_exact_maths()

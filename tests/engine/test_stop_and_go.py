"""Stop-and-go waves grow on a ring above the density that linear theory gives."""

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from charms_bench.world.profile import PROFILES


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    path = Path(__file__).parents[2] / "tools" / "stop_and_go.py"
    spec = importlib.util.spec_from_file_location("stop_and_go", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("desired", "limit"), [(30.0, 26.9), (25.0, 31.1)])
def test_the_limit_of_linear_theory_is_that_of_highway_envs_constants(
    tool: ModuleType, desired: float, limit: float
) -> None:
    """Computed by hand for a 3, b 5, T 1.5 and s0 10 m, centre to centre."""
    found = tool.critical_density(PROFILES["highway-env"].idm_mobil, desired)
    assert found == pytest.approx(limit, abs=0.05)


@pytest.mark.parametrize(("profile", "desired"), [("highway-env", 30.0), ("naturalistic", 33.3)])
def test_waves_grow_above_the_limit_and_decay_below_it(
    tool: ModuleType, profile: str, desired: float
) -> None:
    p = PROFILES[profile].idm_mobil
    densities = tool.critical_density(p, desired) * np.array([0.9, 0.97, 1.03, 1.1])
    rates, _ = tool.ring(profile, desired, densities, 600.0)
    assert (np.sign(rates) == [-1, -1, 1, 1]).all()
    theory = [tool.growth_rate(density, p, desired) for density in densities]
    np.testing.assert_allclose(rates, theory, atol=1e-4)

"""Stop-and-go waves grow on a ring above the density that linear theory gives."""

import numpy as np
import pytest
from rings import critical_density, growth_rate, ring

from charms_bench.world.profile import PROFILES


@pytest.mark.parametrize(("desired", "limit"), [(30.0, 26.9), (25.0, 31.1)])
def test_the_limit_of_linear_theory_is_that_of_highway_envs_constants(
    desired: float, limit: float
) -> None:
    """Computed by hand for a 3, b 5, T 1.5 and s0 10 m, centre to centre."""
    found = critical_density(PROFILES["highway-env"].idm_mobil, desired)
    assert found == pytest.approx(limit, abs=0.05)


@pytest.mark.parametrize(("profile", "desired"), [("highway-env", 30.0), ("naturalistic", 33.3)])
def test_waves_grow_above_the_limit_and_decay_below_it(profile: str, desired: float) -> None:
    p = PROFILES[profile].idm_mobil
    densities = critical_density(p, desired) * np.array([0.9, 0.97, 1.03, 1.1])
    rates, _ = ring(profile, desired, densities, 600.0)
    assert (np.sign(rates) == [-1, -1, 1, 1]).all()
    theory = [growth_rate(density, p, desired) for density in densities]
    np.testing.assert_allclose(rates, theory, atol=1e-4)

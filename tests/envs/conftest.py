"""What tests of environments share."""

from collections.abc import Iterator

import pytest

from charms_bench.testing.stock_roads import unchanged_idm


@pytest.fixture(autouse=True)
def _idm_of_highway_env() -> Iterator[None]:
    """Without it, other roads of highway-env would differ after its `intersection`."""
    with unchanged_idm():
        yield

"""What `import charms_bench` offers."""

import subprocess
import sys

import pytest

import charms_bench


@pytest.mark.parametrize("name", charms_bench.__all__)
def test_every_public_name_can_be_imported_and_is_listed(name: str) -> None:
    assert getattr(charms_bench, name) is not None
    assert name in dir(charms_bench)


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Polcy'"):
        _ = charms_bench.Polcy


def test_the_package_alone_imports_no_library() -> None:
    code = "import charms_bench, sys; charms_bench.CharmsBenchError; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {"numpy", "numba", "polars", "pydantic"} & set(done.stdout.split())

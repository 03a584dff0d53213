"""The environment variables of worker processes."""

import pytest

from charms_bench.engine.exact_maths import worker_environment


def test_processor_features_that_the_user_disables_stay_disabled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usual = worker_environment("highway-env")["NPY_DISABLE_CPU_FEATURES"].split()
    monkeypatch.setenv("NPY_DISABLE_CPU_FEATURES", "AVX512_SPR")
    environment = worker_environment("highway-env")
    assert environment["NPY_DISABLE_CPU_FEATURES"].split() == ["AVX512_SPR", *usual]

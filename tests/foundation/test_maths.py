"""The elementary functions are accurate and give the same bits however they are compiled."""

import math
from collections.abc import Callable
from itertools import product
from typing import Any

import mpmath
import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from charms_bench.foundation import maths

PRECISE = mpmath.mp.clone()
PRECISE.prec = 200
ANGLES = st.floats(-1e5, 1e5)
MULTIPLES = st.builds(
    lambda k, direction: math.nextafter(k * math.pi / 2, direction),
    st.integers(-60_000, 60_000),
    st.sampled_from([-math.inf, math.inf]),
)
"""Angles next to multiples of a quarter turn, where most digits cancel."""
SIDES = st.one_of(
    *(st.floats(-size, size).filter(lambda side: abs(side) >= 1e-140) for size in (1e140, 1e4, 2.0))
)
UNARY = ("sin", "cos", "tan", "asin", "atan", "exp")


def error_in_ulp(found: float, exact: Any) -> float:
    if exact == 0:
        return 0.0 if found == 0 else math.inf
    return float(abs(PRECISE.mpf(found) - exact) / math.ulp(float(exact)))


@pytest.mark.parametrize("name", ["sin", "cos", "tan"])
@given(x=st.one_of(ANGLES, MULTIPLES, st.floats(-4, 4), st.floats(-1e-8, 1e-8)))
def test_trigonometric_functions_err_by_less_than_1_ulp(name: str, x: float) -> None:
    exact = getattr(PRECISE, name)(PRECISE.mpf(x))
    assert error_in_ulp(getattr(maths, name)(x), exact) < 1


@given(x=st.one_of(st.floats(-1, 1), st.floats(0.49, 0.51), st.floats(0.999, 1)))
def test_the_arcsine_errs_by_less_than_1_ulp(x: float) -> None:
    assert error_in_ulp(maths.asin(x), PRECISE.asin(PRECISE.mpf(x))) < 1


@given(x=st.one_of(st.floats(-1e280, 1e280), st.floats(-4, 4), st.floats(0.41, 0.42)))
def test_the_arctangent_errs_by_less_than_1_ulp(x: float) -> None:
    assert error_in_ulp(maths.atan(x), PRECISE.atan(PRECISE.mpf(x))) < 1


@settings(deadline=None)  # the first call compiles
@given(
    y=SIDES,
    x=SIDES,
    ratio=st.one_of(
        st.none(), st.floats(0.41, 0.42), st.floats(2.41, 2.42), st.floats(0.999, 1.001)
    ),
)
def test_the_angle_of_a_point_errs_by_less_than_1_ulp(
    y: float, x: float, ratio: float | None
) -> None:
    y = y if ratio is None else x * ratio
    exact = PRECISE.atan2(PRECISE.mpf(y), PRECISE.mpf(x))
    assert error_in_ulp(maths.atan2(y, x), exact) < 1


@pytest.mark.parametrize(("y", "x"), [*product((-1.0, 0.0, 1.0), (-1.0, 0.0, 1.0))])
def test_the_angles_of_points_on_axes_and_diagonals_are_those_of_the_c_library(
    y: float, x: float
) -> None:
    assert maths.atan2(y, x) == math.atan2(y, x)


@pytest.mark.parametrize(("x", "angle"), [(5e-324, 0.0), (0.0, 0.0), (-5e-324, math.pi)])
def test_a_point_at_the_origin_has_an_angle(x: float, angle: float) -> None:
    assert maths.atan2(2e-309, x) == pytest.approx(angle, abs=1e-300)


@given(x=st.one_of(st.floats(-708, 709), st.floats(-2, 2)))
def test_the_exponential_errs_by_less_than_1_ulp(x: float) -> None:
    assert error_in_ulp(maths.exp(x), PRECISE.exp(PRECISE.mpf(x))) < 1


@given(
    x=st.one_of(st.floats(1e-300, 1e300), st.floats(1e-3, 2), st.floats(0.99, 1.01)),
    y=st.one_of(st.floats(1e-3, 1000), st.floats(3.5, 4.5)),
)
def test_powers_err_by_less_than_1_ulp(x: float, y: float) -> None:
    exact = PRECISE.power(PRECISE.mpf(x), PRECISE.mpf(y))
    found = maths.power(x, y)
    if exact < 1e-307 or exact > 8e307:
        assert found in (0, math.inf) or error_in_ulp(found, exact) < 1
    else:
        assert error_in_ulp(found, exact) < 1


@pytest.mark.parametrize(
    ("found", "exact"),
    [
        (maths.power(0.0, 4.0), 0.0),
        (maths.power(1.0, 4.1), 1.0),
        (maths.power(2.0, 0.5), math.sqrt(2)),
        (maths.exp(0.0), 1.0),
        (maths.exp(-800.0), 0.0),
        (maths.exp(800.0), math.inf),
        (maths.asin(1.0), math.pi / 2),
        (maths.asin(-1.0), -math.pi / 2),
        (maths.atan(1.0), math.pi / 4),
        (maths.tan(0.0), 0.0),
        (maths.sin_cos(0.0), (0.0, 1.0)),
    ],
)
def test_known_values_are_exact(found: object, exact: object) -> None:
    assert found == exact


def over_arrays(function: Callable[[float], float]) -> Any:
    """A compiled loop over an array, which LLVM vectorises."""

    @numba.njit(error_model="numpy")  # type: ignore[untyped-decorator]
    def loop(values: np.ndarray, results: np.ndarray) -> None:
        for i in range(values.size):
            results[i] = function(values[i])

    return loop


@numba.njit(error_model="numpy")  # type: ignore[untyped-decorator]
def powers(x: np.ndarray, y: np.ndarray, results: np.ndarray) -> None:
    for i in range(x.size):
        results[i] = maths.power(x[i], y[i])


@numba.njit(error_model="numpy")  # type: ignore[untyped-decorator]
def angles(y: np.ndarray, x: np.ndarray, results: np.ndarray) -> None:
    for i in range(x.size):
        results[i] = maths.atan2(y[i], x[i])


@pytest.mark.parametrize("name", UNARY)
def test_vectorised_code_and_plain_python_compute_the_same_bits(name: str) -> None:
    function, loop = getattr(maths, name), over_arrays(getattr(maths, name))
    values = np.random.default_rng(0).uniform(-1, 1, 1001)
    results = np.empty_like(values)
    loop(values, results)
    plain = [function.py_func(value) for value in values]  # its helpers are still compiled
    np.testing.assert_array_equal(results, plain)
    assert_vectorised_without_fused_operations(loop)


def test_vectorised_powers_are_those_of_plain_python() -> None:
    rng = np.random.default_rng(0)
    x, y, results = rng.uniform(0, 2, 1001), rng.uniform(3.5, 4.5, 1001), np.empty(1001)
    powers(x, y, results)
    plain = [maths.power.py_func(*pair) for pair in zip(x, y, strict=True)]
    np.testing.assert_array_equal(results, plain)
    assert_vectorised_without_fused_operations(powers)


def test_vectorised_angles_are_those_of_plain_python() -> None:
    y, x = np.random.default_rng(0).uniform(-1, 1, (2, 1001))
    results = np.empty(1001)
    angles(y, x, results)
    plain = [maths.atan2.py_func(*pair) for pair in zip(y, x, strict=True)]
    np.testing.assert_array_equal(results, plain)
    assert_vectorised_without_fused_operations(angles)


def assert_vectorised_without_fused_operations(loop: Any) -> None:
    (assembly,) = loop.inspect_asm().values()
    assert "vfm" not in assembly  # fused multiply-adds: vfmadd, vfmsub
    assert "vfnm" not in assembly
    if "vmulsd" in assembly or "mulsd" in assembly:  # x86-64
        assert "mulpd" in assembly

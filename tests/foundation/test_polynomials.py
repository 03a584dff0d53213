"""The polynomials of the elementary functions interpolate at Chebyshev nodes.

Such a polynomial is within a factor of about two of the best one.
"""

import inspect
import re
from collections.abc import Callable
from typing import Any, NamedTuple

import mpmath
import pytest

from charms_bench.foundation import maths

mp = mpmath.mp.clone()
mp.prec = 300


Real = Callable[[Any], Any]


class Fit(NamedTuple):
    """A function, the end points of its interval and the number of coefficients."""

    function: Real
    low: Any
    high: Any
    terms: int


SOURCE = inspect.getsource(maths)


def of_square(function: Real) -> Real:
    """An even function of r as a function of r squared."""
    return lambda z: function(mp.sqrt(z))


QUARTER_PI_SQUARED = (mp.pi / 4 * mp.mpf("1.0001")) ** 2
FITS = {
    "SIN": Fit(of_square(lambda r: (mp.sin(r) - r) / r**3), mp.mpf(0), QUARTER_PI_SQUARED, 7),
    "COS": Fit(
        of_square(lambda r: (mp.cos(r) - 1 + r * r / 2) / r**4), mp.mpf(0), QUARTER_PI_SQUARED, 6
    ),
    "ASIN": Fit(of_square(lambda r: (mp.asin(r) - r) / r**3), mp.mpf(0), mp.mpf("0.2501"), 14),
    "ATAN": Fit(of_square(lambda r: (mp.atan(r) - r) / r**3), mp.mpf(0), mp.mpf("0.1717"), 12),
    "EXP": Fit(lambda r: (mp.exp(r) - 1 - r) / r**2, -mp.mpf("0.3467"), mp.mpf("0.3467"), 12),
    "LOG": Fit(
        of_square(lambda s: (2 * mp.atanh(s) - 2 * s - 2 * s**3 / 3) / s**5),
        mp.mpf(0),
        mp.mpf("0.02945"),
        8,
    ),
}


def coefficients(fit: Fit) -> list[float]:
    """The coefficients, lowest power first, rounded to doubles."""
    middle, half, terms = (fit.low + fit.high) / 2, (fit.high - fit.low) / 2, fit.terms
    # The offset keeps a node away from 0, where the functions are 0 / 0.
    angles = [(2 * k + 1) * mp.pi / (2 * terms) + mp.mpf("1e-9") for k in range(terms)]
    nodes = [middle + half * mp.cos(angle) for angle in angles]
    powers = mp.matrix([[node**j for j in range(terms)] for node in nodes])
    values = mp.matrix([fit.function(node) for node in nodes])
    return [float(c) for c in mp.lu_solve(powers, values)]


@pytest.mark.parametrize("name", FITS)
def test_the_coefficients_are_those_of_the_interpolation(name: str) -> None:
    written = re.findall(r"^    [pq] = (?:[pq] \* \w+ ([+-]) )?(-?[\d.e-]+)$", SOURCE, re.MULTILINE)
    numbers = [float(f"{sign}{number}".replace("+", "")) for sign, number in written]
    expected = coefficients(FITS[name])[::-1]
    starts = [k for k, number in enumerate(numbers) if number == expected[0]]
    assert [numbers[k : k + len(expected)] for k in starts] == [expected]

"""Elementary functions that compute the same bits on every machine.

They use only the additions, multiplications, divisions, square roots and bit operations whose
results IEEE 754 and Python define. So the results depend neither on the processor nor on the C
library. No function branches on its data or reads a table, so loops over them vectorise. Errors are
below 1 ulp (unit in the last place) on the ranges that the functions state.

The methods are classical: reduction of the argument by Cody and Waite, one polynomial (computed by
`tests/foundation/test_polynomials.py`), and double-double arithmetic (Dekker 1971, Knuth) for what
a single double would round away. A number that is written as two is their exact sum, the larger
part first.
"""

import math

import numpy as np

from charms_bench.foundation.compiled import inlined

_TO_INTEGER = 6755399441055744.0
"""1.5 * 2**52: adding and subtracting it rounds a double below 2**51 to an integer."""
_TO_INTEGER_BITS = 0x4338000000000000
_SPLIT = 134217729.0
"""2**27 + 1, which splits a double into two halves of its digits."""

_HALF_PI, _HALF_PI_LOW = 1.5707963267948966, 6.123233995736766e-17
_QUARTER_PI, _QUARTER_PI_LOW = 0.7853981633974483, 3.061616997868383e-17
_PI, _PI_LOW = 3.141592653589793, 1.2246467991473532e-16
_THREE_QUARTERS_PI, _THREE_QUARTERS_PI_LOW = 2.356194490192345, 9.184850993605148e-17
_TWO_OVER_PI = 0.6366197723675814
_HALF_PI_1, _HALF_PI_2 = 1.5707963267341256, 6.077100506303966e-11
_HALF_PI_3 = 2.0222662487959506e-21
"""pi / 2 in three parts; the first two have 33 digits, so their multiples are exact."""
_LN2_HIGH, _LN2_LOW = 0.6931471805592082, 7.371002565167799e-13
"""ln 2 in two parts; the first has 40 digits."""
_TWO_THIRDS, _TWO_THIRDS_LOW = 0.6666666666666666, 3.700743415417188e-17
_LOG2_E = 1.4426950408889634
_TAN_EIGHTH_PI = 0.41421356237309503
_NOTHING = 1e-300
_HALF_BITS, _ROOT_HALF_BITS = 0x3FE0000000000000, 0x3FE6A09E667F3BCD
_EXP_LOWEST, _EXP_HIGHEST = -708.0, 709.0


@inlined
def sin(x: float) -> float:
    """Sine of x rad, |x| < 1e5."""
    return sin_cos(x)[0]


@inlined
def cos(x: float) -> float:
    """Cosine of x rad, |x| < 1e5."""
    return sin_cos(x)[1]


@inlined
def sin_cos(x: float) -> tuple[float, float]:
    """Sine and cosine of x rad, |x| < 1e5."""
    quarter, s, s_low, c, c_low = _sin_cos_parts(x)
    sine, cosine = s + s_low, c + c_low
    odd = abs(quarter) == 1.0
    turned_sine, turned_cosine = (cosine, sine) if odd else (sine, cosine)
    sine = -turned_sine if (quarter == -1.0) | (abs(quarter) == 2.0) else turned_sine
    cosine = -turned_cosine if (quarter == 1.0) | (abs(quarter) == 2.0) else turned_cosine
    return sine, cosine


@inlined
def tan(x: float) -> float:
    """Tangent of x rad, |x| < 1e5."""
    quarter, s, s_low, c, c_low = _sin_cos_parts(x)
    s, s_low = _add(s, s_low)
    c, c_low = _add(c, c_low)
    odd = abs(quarter) == 1.0
    above, above_low = (-c, -c_low) if odd else (s, s_low)
    below, below_low = (s, s_low) if odd else (c, c_low)
    quotient, low = _divide(above, above_low, below, below_low)
    return quotient + low


@inlined
def asin(x: float) -> float:
    """Arcsine of x in rad, |x| <= 1."""
    size = abs(x)
    is_large = size > 0.5
    z = (1.0 - size) / 2 if is_large else size * size
    s = math.sqrt(z) if is_large else size
    product, low = _multiply(s, s)
    s_low = ((z - product) - low) / max(s + s, 1e-300) if is_large else 0.0
    p = 0.029635026229160807
    p = p * z - 0.019277545872870144
    p = p * z + 0.019579201579784485
    p = p * z + 0.003035007189432908
    p = p * z + 0.009322101496571563
    p = p * z + 0.009621402748168655
    p = p * z + 0.011566511821787404
    p = p * z + 0.013963775787857076
    p = p * z + 0.017352816768545953
    p = p * z + 0.022372157435623836
    p = p * z + 0.030381944475693704
    p = p * z + 0.04464285714255019
    p = p * z + 0.07500000000000119
    p = p * z + 0.16666666666666666
    tail = s * z * p
    # For a large x: pi / 2 - 2 * asin(sqrt((1 - x) / 2)).
    high, high_low = _add(_HALF_PI, -2 * s)
    large = high + (high_low + (_HALF_PI_LOW - 2 * (s_low + tail)))
    value = large if is_large else size + tail
    return -value if x < 0 else value


@inlined
def atan(x: float) -> float:
    """Arctangent of x in rad, |x| < 1e280."""
    return atan2(x, 1.0)


@inlined
def atan2(y: float, x: float) -> float:
    """The angle of the point (x, y) in rad, above -pi to pi; a zero counts as positive.

    The sizes of the coordinates are 0 or between 1e-140 and 1e140. A point within 1e-300 of the
    origin counts as a point of the x-axis.
    """
    aside, along = abs(y), abs(x)
    along = 1.0 if (aside < _NOTHING) & (along < _NOTHING) else along
    is_large, is_small = aside > (1 + math.sqrt(2)) * along, aside <= _TAN_EIGHTH_PI * along
    # atan(z) is pi / 4 + atan((z - 1) / (z + 1)), or pi / 2 + atan(-1 / z).
    minus, minus_low = _add(aside, -along)
    plus, plus_low = _add(aside, along)
    above = aside if is_small else (-along if is_large else minus)
    above_low = 0.0 if is_small | is_large else minus_low
    below = along if is_small else (aside if is_large else plus)
    below_low = 0.0 if is_small | is_large else plus_low
    is_behind = x < 0.0
    base = 0.0 if is_small else (_HALF_PI if is_large else _QUARTER_PI)
    base_low = 0.0 if is_small else (_HALF_PI_LOW if is_large else _QUARTER_PI_LOW)
    behind = _PI if is_small else (_HALF_PI if is_large else _THREE_QUARTERS_PI)
    behind_low = _PI_LOW if is_small else (_HALF_PI_LOW if is_large else _THREE_QUARTERS_PI_LOW)
    base, base_low = (behind, behind_low) if is_behind else (base, base_low)
    t, t_low = _divide(above, above_low, below, below_low)
    t, t_low = (-t, -t_low) if is_behind else (t, t_low)
    z = t * t
    p = 0.01627552169304575
    p = p * z - 0.03456132297692475
    p = p * z + 0.04551233845184265
    p = p * z - 0.05230375457658945
    p = p * z + 0.05878918292987617
    p = p * z - 0.06666423954374522
    p = p * z + 0.07692296323157852
    p = p * z - 0.09090908751706078
    p = p * z + 0.11111111105119366
    p = p * z - 0.14285714285659457
    p = p * z + 0.19999999999999804
    p = p * z - 0.3333333333333333
    high, high_low = _add(base, t)
    value = high + (high_low + (base_low + (t * z * p + t_low * (1.0 - z))))
    return -value if y < 0 else value


@inlined
def exp(x: float) -> float:
    """e to the power of x; 0 below -708, infinity above 709."""
    return _exp(x, 0.0)


@inlined
def power(x: float, y: float) -> float:
    """x to the power of y, for x = 0 or a normal x > 0, and y > 0.

    A result below 1e-307 is 0, and one above 8e307 is infinity.
    """
    high, low = _log(x)
    product, product_low = _multiply(y, high)
    value = _exp(product, product_low + y * low)
    return 0.0 if x == 0.0 else value


@inlined
def _sin_cos_parts(x: float) -> tuple[float, float, float, float, float]:
    """The quarter turns in x (-2 to 2), and the sine and cosine of the rest, each in two parts."""
    turns = (x * _TWO_OVER_PI + _TO_INTEGER) - _TO_INTEGER
    quarter = turns - 4 * ((turns / 4 + _TO_INTEGER) - _TO_INTEGER)
    rest, rest_low = _add(x - turns * _HALF_PI_1, -(turns * _HALF_PI_2))
    r, r_low = _add(rest, -(turns * _HALF_PI_3))
    r_low += rest_low
    z, z_low = _multiply(r, r)
    p = -7.586685070129962e-13
    p = p * z + 1.6058531414589727e-10
    p = p * z - 2.505210623115791e-08
    p = p * z + 2.7557319219335453e-06
    p = p * z - 0.0001984126984126506
    p = p * z + 0.008333333333333331
    p = p * z - 0.16666666666666666
    sine_low = r * z * p + r_low * (1.0 - z / 2)
    q = -1.1382614868612891e-11
    q = q * z + 2.087614602469062e-09
    q = q * z - 2.7557317270560326e-07
    q = q * z + 2.4801587298763433e-05
    q = q * z - 0.0013888888888887395
    q = q * z + 0.041666666666666664
    cosine = 1.0 - z / 2
    cosine_low = ((1.0 - cosine) - z / 2) + (z * z * q - (z_low / 2 + r * r_low))
    return quarter, r, sine_low, cosine, cosine_low


@inlined
def _log(x: float) -> tuple[float, float]:
    """The natural logarithm of a normal x > 0 in two parts; relative error about 2**-64."""
    bits = np.float64(x).view(np.int64)
    exponent = (bits - _ROOT_HALF_BITS) >> 52
    mantissa = np.int64(bits - (exponent << 52)).view(np.float64)  # sqrt(1/2) to sqrt(2)
    k = np.int64(exponent + _TO_INTEGER_BITS).view(np.float64) - _TO_INTEGER
    # log(m) = 2 atanh(s), s = (m - 1) / (m + 1).
    plus, plus_low = _add(mantissa, 1.0)
    s, s_low = _divide(mantissa - 1.0, 0.0, plus, plus_low)
    z, z_low = _multiply(s, s)
    z_low += 2 * s * s_low
    cube, cube_low = _multiply(s, z)
    cube_low += s * z_low + s_low * z
    third, third_low = _multiply(cube, _TWO_THIRDS)
    third_low += cube * _TWO_THIRDS_LOW + cube_low * _TWO_THIRDS
    p = 0.1172360362209304
    p = p * z + 0.11706195689965045
    p = p * z + 0.13334806212097203
    p = p * z + 0.15384594934597987
    p = p * z + 0.1818181833565416
    p = p * z + 0.22222222221654733
    p = p * z + 0.2857142857142937
    p = p * z + 0.4
    low = cube * z * p + third_low + 2 * s_low + k * _LN2_LOW
    total, first = _add(k * _LN2_HIGH, 2 * s)
    total, second = _add(total, third)
    return _add(total, low + first + second)


@inlined
def _exp(high: float, low: float) -> float:
    """e to the power of `high + low`."""
    inside = min(max(high, _EXP_LOWEST), _EXP_HIGHEST)
    shifted = inside * _LOG2_E + _TO_INTEGER
    k = shifted - _TO_INTEGER
    r, r_low = _add(inside - k * _LN2_HIGH, -(k * _LN2_LOW))
    r, r_low = _add(r, r_low + low)
    p = 1.6086642571620485e-10
    p = p * r + 2.091815966932328e-09
    p = p * r + 2.5052071054779885e-08
    p = p * r + 2.7557263219790347e-07
    p = p * r + 2.7557319247255658e-06
    p = p * r + 2.480158733649766e-05
    p = p * r + 0.00019841269841263285
    p = p * r + 0.0013888888888879054
    p = p * r + 0.008333333333333333
    p = p * r + 0.04166666666666668
    p = p * r + 0.16666666666666666
    p = p * r + 0.5
    total, total_low = _add(1.0, r)
    value = total + (total_low + (r * r * p + (r_low + r * r_low)))
    bits = np.float64(shifted).view(np.int64) + 1023
    scale = np.int64(bits << 52).view(np.float64)  # 2**k: the shift leaves the last digits of k
    value *= scale
    value = math.inf if high > _EXP_HIGHEST else value  # choices that are nested do not vectorise
    return 0.0 if high < _EXP_LOWEST else value


@inlined
def _add(a: float, b: float) -> tuple[float, float]:
    """a + b in two parts, exactly (Knuth's TwoSum)."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@inlined
def _multiply(a: float, b: float) -> tuple[float, float]:
    """a * b in two parts, exactly (Dekker 1971), |a|, |b| < 1e290."""
    product = a * b
    shifted_a, shifted_b = a * _SPLIT, b * _SPLIT
    a_high, b_high = shifted_a - (shifted_a - a), shifted_b - (shifted_b - b)
    a_low, b_low = a - a_high, b - b_high
    error = ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low
    return product, error


@inlined
def _divide(a: float, a_low: float, b: float, b_low: float) -> tuple[float, float]:
    """The quotient of two numbers in two parts each, in two parts."""
    inverse = 1.0 / b
    quotient = a * inverse
    product, product_low = _multiply(quotient, b)
    rest = ((a - product) - product_low) + (a_low - quotient * b_low)
    return quotient, rest * inverse

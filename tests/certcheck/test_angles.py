"""Sines and angles of the checker at arguments that are hard, against 78 digits."""

import math
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import libmp, mp

from surctl.certcheck.elementary import angle, circle, elementary, pi, tangent
from surctl.certcheck.enclosure import enclose, span
from surctl.certcheck.expressions import ExpressionTable

BITS = 260
HARD = [
    0.0,
    5e-324,
    -5e-324,
    2.0**-41,
    -(2.0**-40),
    0.75,
    1.0,
    -1.0,
    1 - 2.0**-53,
    2.0**-60 - 1,
    1.7976931348623157e308,
]

near_ties = st.builds(lambda k, way: math.nextafter(k * math.pi / 2, way), st.integers(-(10**15), 10**15),
                      st.sampled_from([-math.inf, math.inf]))  # fmt: skip
numbers = st.one_of(
    st.floats(-4, 4), st.floats(allow_nan=False, allow_infinity=False), near_ties, st.sampled_from(HARD)
)


def arccos(x):
    return elementary("acos", x, Fraction(1))


def arcsin(x):
    return elementary("asin", x, Fraction(1))


def raw(x: float):
    return libmp.from_float(x)


def holds(found, value) -> bool:
    return libmp.mpf_le(found[0], value) and libmp.mpf_le(value, found[1])


def narrow(found, value) -> bool:
    """The range is no wider than 2^-57 of the value, or 2^-115."""
    size = libmp.mpf_add(libmp.mpf_shift(libmp.mpf_abs(value), -57), libmp.mpf_shift(libmp.fone, -115))
    return libmp.mpf_le(libmp.mpf_sub(found[1], found[0]), size)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(numbers, numbers)
def test_at_a_number_they_hold_the_value_and_are_narrow(x: float, y: float) -> None:
    cosine, sine = circle((raw(x), raw(x)))
    told = [(cosine, libmp.mpf_cos(raw(x), BITS)), (sine, libmp.mpf_sin(raw(x), BITS))]
    if x or y:
        told.append((angle((raw(y), raw(y)), (raw(x), raw(x))), libmp.mpf_atan2(raw(y), raw(x), BITS)))
    if abs(x) <= 1:
        told.append((arccos((raw(x), raw(x))), libmp.mpf_acos(raw(x), BITS)))
    for found, value in told:
        assert holds(found, value) and narrow(found, value)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(numbers, st.floats(0, 7), numbers, st.floats(0, 1))
def test_on_an_interval_they_hold_the_value_everywhere(x: float, width: float, y: float, share: float) -> None:
    high = min(x + width, 1.7e308) if x < 1e308 else x
    at = min(max(x + share * width, x), high)
    cosine, sine = circle((raw(x), raw(high)))
    assert holds(cosine, libmp.mpf_cos(raw(at), BITS)) and holds(sine, libmp.mpf_sin(raw(at), BITS))
    if y > 0 or x > 0:
        found = angle((raw(y), raw(y)), (raw(x), raw(high)))
        assert holds(found, libmp.mpf_atan2(raw(y), raw(at), BITS))
    if x >= -1 and high <= 1:
        assert holds(arccos((raw(x), raw(high))), libmp.mpf_acos(raw(at), BITS))


def test_a_crest_or_a_trough_inside_counts() -> None:
    one, minus = libmp.fone, libmp.fnone
    for quarters, of_cosine, of_sine in ((0, one, None), (1, None, one), (2, minus, None), (3, None, minus)):
        for turn in (-8, 0, 400):
            middle = (quarters + turn) * math.pi / 2
            cosine, sine = circle((raw(middle - 0.1), raw(middle + 0.1)))
            assert (of_cosine in cosine, of_sine in sine) == (of_cosine is not None, of_sine is not None)
    whole = (minus, one)
    assert circle((raw(-1.0), raw(4.0)))[0] == whole == circle((raw(0.0), raw(1e300)))[1]
    far = libmp.from_man_exp(1, 10**12)
    assert circle((far, far)) == (whole, whole)


def test_pi_lies_between_its_ends() -> None:
    mp.prec = BITS
    assert mp.make_mpf(pi()[0]) < mp.pi < mp.make_mpf(pi()[1])
    mp.prec = 53


@pytest.mark.parametrize("x", [-0.15756893157958984, 0.9999999999999999, 2.0**-45, -1.0])
def test_an_arccos_by_the_checker_is_rounded_outward(x: float) -> None:
    sheet = ExpressionTable(("x",))
    (value_,) = enclose(sheet, [sheet.read("acos(x)")], [span(x, x)])
    assert holds(value_, libmp.mpf_acos(raw(x), BITS))


# numbers of 100 bits, whose roundings to 60 bits lie on either side
LONG = [libmp.from_man_exp((1 << 99) + 12345678901234567 * k, e) for k in range(1, 6) for e in (-150, -240, -99, -98)]
LONG.append(libmp.from_man_exp(((1 << 59) + 1 << 30) + 1, -132))  # just above 60 bits, its arctangent just below them


@pytest.mark.parametrize("sign", [1, -1])
def test_bounds_of_long_and_of_tiny_numbers_are_rounded_outward(sign: int) -> None:
    for size in LONG:
        x = size if sign > 0 else libmp.mpf_neg(size)
        cosine, sine = circle((x, x))
        assert holds(cosine, libmp.mpf_cos(x, 400)) and holds(sine, libmp.mpf_sin(x, 400))
        for other in (raw(1.0), raw(3.0 * 2.0**60), raw(7.0 * 2.0**200), size):
            assert holds(angle((x, x), (other, other)), libmp.mpf_atan2(x, other, 400))
            assert holds(angle((other, other), (x, x)), libmp.mpf_atan2(other, x, 400))
        if libmp.mpf_le(size, libmp.fone):
            assert holds(arcsin((x, x)), libmp.mpf_asin(x, 400)) and holds(arccos((x, x)), libmp.mpf_acos(x, 400))


def test_the_ends_of_an_interval_are_those_of_its_own_ends() -> None:
    wide = (raw(-0.75), raw(0.5))
    for function, exact in ((arcsin, libmp.mpf_asin), (tangent, libmp.mpf_tan), (arccos, libmp.mpf_acos)):
        assert all(holds(function(wide), exact(end, BITS)) for end in wide)


def test_ends_that_are_no_numbers_or_too_large_bound_nothing() -> None:
    whole = (libmp.fnone, libmp.fone)
    far = libmp.from_man_exp(1, 1200)
    for bad in (libmp.finf, libmp.fninf, libmp.fnan, far, libmp.mpf_neg(far)):
        for ends in ((bad, bad), (libmp.fzero, bad), (bad, libmp.fzero), (raw(1.0), bad), (bad, raw(1.0))):
            assert circle(ends) == (whole, whole)
            assert tangent(ends) is None


def test_a_tangent_has_no_range_over_a_pole() -> None:
    for low, high in ((1.5, 1.6), (-1.6, -1.5), (1.0, 4.5), (math.pi / 2, math.pi / 2), (1.0, 30.0), (-2.0, 2.0)):
        near = (raw(low), raw(high)) if low < high else pi_half()
        assert tangent(near) is None
    for low, high in ((1.6, 4.7), (-1.5, 1.5), (-4.7, -1.6)):
        found = tangent((raw(low), raw(high)))
        assert holds(found, libmp.mpf_tan(raw(low), BITS)) and holds(found, libmp.mpf_tan(raw(high), BITS))


def pi_half():
    """The two numbers of 200 bits around π/2."""
    return libmp.mpf_shift(libmp.mpf_pi(200, "d"), -1), libmp.mpf_shift(libmp.mpf_pi(200, "u"), -1)


def test_a_crest_next_to_an_end_counts() -> None:
    """The angle is within 2^-130 of a multiple of π/2, on either side."""
    for quarters in range(-6, 7):
        if not quarters:
            continue
        for rounding in "fc":
            middle = libmp.mpf_shift(libmp.mpf_mul_int(libmp.mpf_pi(220, rounding), quarters, 240), -1)
            for e in (-140, -130, -127, -125):
                off = libmp.from_man_exp(1, e)
                below, above = libmp.mpf_sub(middle, off), libmp.mpf_add(middle, off)
                for ends in (
                    (below, above),
                    (below, libmp.mpf_add(middle, raw(0.5))),
                    (libmp.mpf_sub(middle, raw(0.5)), above),
                ):
                    cosine, sine = circle(ends)
                    value = libmp.from_int((1, 1, -1, -1)[quarters % 4])
                    assert holds(sine if quarters % 2 else cosine, value)

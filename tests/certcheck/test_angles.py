"""Sines and angles of the checker at arguments that are hard, against 78 digits."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import libmp, mp

from surctl.certcheck.angles import angle, arccos, circle, pi
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
    (jet,) = enclose(sheet, [sheet.read("acos(x)")], [span(x, x)])
    assert holds(jet.value, libmp.mpf_acos(raw(x), BITS))

"""Exponentials, logarithms, tangents and powers of the checker at arguments that are hard, against 78 digits."""

import math
import time
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mpmath import libmp, mp

from surctl.certcheck import check_document, seal
from surctl.certcheck.derivative import along
from surctl.certcheck.elementary import Undefined, elementary, real_power
from surctl.certcheck.enclosure import enclose, exact
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.jets import Tape
from surctl.verification.formula import parse, variable
from tests.certcheck.test_angles import BITS, LONG, holds, narrow, raw
from tests.verification.expressions import worth

EXPONENTS = [Fraction(1, 2), Fraction(-3, 2), Fraction(1, 3), Fraction("63.999"), Fraction("-1e-6")]
HARD = [
    0.0, 5e-324, -5e-324, 2.0**-40, -(2.0**-40), math.nextafter(2.0**-40, 0.0), 1.0, -1.0, 1 - 2.0**-53, 1 + 2.0**-52,
    2.0**8, -745.2, 709.78, 2.0**20, math.nextafter(2.0**20, 0.0), -(2.0**20), 1.7976931348623157e308,
]  # fmt: skip
near_ties = st.builds(
    lambda k, unit, way: math.nextafter(k * unit, way),
    st.integers(-(10**6), 10**6), st.sampled_from([math.pi / 2, math.log(2)]), st.sampled_from([-math.inf, math.inf]),
)  # fmt: skip
numbers = st.one_of(
    st.floats(-4, 4), st.floats(-1000, 1000), st.floats(allow_nan=False, allow_infinity=False), near_ties,
    st.sampled_from(HARD),
)  # fmt: skip


def sinh(x):
    """The difference loses twice the bits by which x is small."""
    if x == libmp.fzero:
        return x
    bits = BITS + 2 * max(0, -(x[2] + x[3])) + 20
    both = libmp.mpf_exp(x, bits), libmp.mpf_exp(libmp.mpf_neg(x), bits)
    return libmp.mpf_shift(libmp.mpf_sub(*both, bits), -1)


def powr(x, exponent: Fraction):
    if x == libmp.fzero:
        return x
    bits = 2 * BITS
    times = libmp.mpf_mul(libmp.mpf_log(x, bits), libmp.from_int(exponent.numerator), bits)
    return libmp.mpf_exp(libmp.mpf_div(times, libmp.from_int(exponent.denominator), bits), BITS)


TRUE = {
    "exp": lambda x, _: libmp.mpf_exp(x, BITS), "log": lambda x, _: libmp.mpf_log(x, BITS),
    "sinh": lambda x, _: sinh(x), "cosh": lambda x, _: libmp.mpf_cosh(x, BITS),
    "tanh": lambda x, _: libmp.mpf_tanh(x, BITS), "tan": lambda x, _: libmp.mpf_tan(x, BITS),
    "asin": lambda x, _: libmp.mpf_asin(x, BITS), "powr": powr,
}  # fmt: skip


def suited(op: str, x: float) -> float:
    """The argument, within the domain of the function and of the reference."""
    if op in ("log", "powr"):
        return abs(x) or 5e-324
    if op == "asin":
        return x if abs(x) <= 1 else 1 / x
    return x if op in ("tan", "tanh") else math.copysign(min(abs(x), 1e6), x)


@pytest.mark.parametrize("op", TRUE)
@settings(max_examples=30, deadline=None, derandomize=True)
@given(numbers, st.sampled_from(EXPONENTS), st.floats(0, 7), st.floats(0, 1))
def test_on_an_interval_they_hold_the_value_everywhere(
    op: str, x: float, exponent: Fraction, width: float, share: float
) -> None:
    low = suited(op, x)
    value = elementary(op, exact(low), exponent)
    told = TRUE[op](raw(low), exponent)
    assert holds(value, told)
    # the cosine of a double nearest to a pole has 7 bits less
    assert narrow(value, told) or (op == "tan" and narrow((value[0], value[1]), libmp.mpf_shift(told, 3)))
    high = suited(op, min(low + width, 1.7e308)) if op != "asin" else min(low + width, 1.0)
    at = min(max(low + share * width, low), high)
    if high < low:
        return
    try:
        value = elementary(op, (raw(low), raw(high)), exponent)
    except Undefined:
        assert op == "tan" and (width > 3 or abs(low) > 1e9 or math.floor(low / math.pi + 0.5 - 1e-6)
                                != math.floor(high / math.pi + 0.5 + 1e-6))  # fmt: skip
        return
    assert holds(value, TRUE[op](raw(at), exponent))


def test_where_claims_hold_with_equality_the_values_are_exact() -> None:
    one, zero = (libmp.fone, libmp.fone), (libmp.fzero, libmp.fzero)
    told = [
        *(("exp", 0, one), ("log", 1, zero), ("sinh", 0, zero), ("cosh", 0, one), ("tanh", 0, zero), ("tan", 0, zero)),
        *(("asin", 0, zero), ("powr", 0, zero), ("powr", 1, one)),
    ]
    for op, at, value in told:
        assert elementary(op, exact(float(at)), Fraction(1, 2)) == value


@pytest.mark.parametrize(
    ("op", "ends"),
    [("tan", (1.5, 1.6)), ("tan", (1.0, 5.0)), ("tan", (1e300, 2e300)), ("log", (0.0, 1.0)), ("powr", (-1e-300, 1.0)),
     ("exp", (0.0, 2.0**20)), ("sinh", (-2e6, 0.0)), ("cosh", (-2e6, 0.0)), ("asin", (0.0, 1.0000000000000002))],
)  # fmt: skip
def test_an_interval_that_leaves_the_domain_is_refused(op: str, ends: tuple[float, float]) -> None:
    with pytest.raises(Undefined):
        elementary(op, (raw(ends[0]), raw(ends[1])), Fraction(1, 2))


@pytest.mark.parametrize("text", ["x^0.5", "x^.5", "x^(1/2)", "x^(0.25/0.5)", "x^5e-1"])
def test_an_exponent_is_a_constant(text: str) -> None:
    table = ExpressionTable(("x",))
    assert table.read(text) == table.read("x^0.5")
    assert table.entries[table.read("x^(-4/2)")].op == "pow"


@pytest.mark.parametrize(
    "text", ["x^x", "x^65", "x^(1/0)", "x^(1/2", "x^", "x^(1/2/3)", "x^(1+1)", "x^0.5^2", "x^" + "1" * 41]
)
def test_what_is_no_exponent_is_rejected_in_one_line(text: str) -> None:
    assert "\n" not in refused("0", text)


@pytest.mark.parametrize(
    ("left", "right", "box"),
    [
        ("exp(exp(exp(x)))", "1", (0.0, 9.0)),
        ("-exp(exp(exp(exp(exp(x)))))", "0", (0.0, 9.0)),
        ("tan(x)", "1", (0.0, 2.0)),
        ("tan(x)", "1e300", (1.5, 1.5707963267948968)),
        ("tan(exp(exp(x)))", "2", (0.0, 8.0)),
        ("exp(((((x^64)^64)^64)^64)^64)", "2", (0.0, 2.0)),
        ("log(((((x^64)^64)^64)^64)^64)", "2", (1.0, 2.0)),
        ("cos(exp(exp(x)))", "0.5", (0.0, 2.3)),
        ("exp(700000)^64 - exp(700000)^63", "0", (0.0, 1.0)),
    ],
)
def test_huge_values_and_poles_are_answered_in_one_line(left: str, right: str, box: tuple[float, float]) -> None:
    began = time.process_time()
    reason = refused(left, right, box)
    assert reason and "\n" not in reason and time.process_time() - began < 1.0


def refused(left: str, right: str, box: tuple[float, float] = (0.0, 1.0)) -> str:
    found = verdict(left, right, f"({left}) - ({right})", box)
    assert found
    return found


def verdict(left: str, right: str, numerator: str, box: tuple[float, float] = (0.0, 1.0)) -> str:
    """The reason why a certificate is rejected; empty if it is accepted."""
    claim = {
        "name": "c", "statement": "", "unit": "1", "left": left, "right": right, "constraints": [], "slack": 0.0,
        "variables": [{"name": "x", "unit": "1", "lower": box[0], "upper": box[1]}],
    }  # fmt: skip
    case = {
        "choice": "", "numerator": numerator, "denominators": [], "multipliers": [], "tree": "m",
        "points": [],
    }  # fmt: skip
    return check_document(seal("interval", claim, {"cases": [case]})).reason


SMOOTH = (
    "exp(2*x)", "log(x)", "sinh(x)", "cosh(x)", "tanh(x)", "tan(x)", "asin(x/2)", "acos(x/2)", "x^(3/2)", "x^-0.7",
    "exp(tanh(x)) - x^0.5*sin(x)",
)  # fmt: skip


@pytest.mark.parametrize("text", SMOOTH)
def test_the_exact_derivative_lies_in_the_enclosed_slope(text: str) -> None:
    table = ExpressionTable(("x",))
    root = table.read(text)
    slope = along(table, root, [table.put("num", value=1)])
    at = np.array([[0.625]])
    told = [float(end[0, 0]) for end in Tape(table, (root,)).run((at, at), order=1).jets[0].slope]
    (found,) = enclose(table, [slope], [exact(0.625)])
    assert told[0] <= libmp.to_float(found[1]) and libmp.to_float(found[0]) <= told[1]
    assert told[1] - told[0] <= 1e-13 * abs(told[0])
    root_of = parse(text, {"x": variable("x")})
    with mp.workdps(40):  # worth has sixty digits
        near = mp.diff(lambda x: worth(root_of, {"x": x}), mp.mpf("0.625"), h=mp.mpf("1e-15"))
        low, high = map(mp.make_mpf, found)
        assert low - mp.mpf("1e-12") < near < high + mp.mpf("1e-12")


def test_equal_arguments_are_one_indeterminate_and_unequal_ones_are_not() -> None:
    left = "exp(x + x)*exp(2*x) - x^0.5*sqrt(x)/exp(2*x)"
    assert verdict(left, "99", "exp(2*x)^2 - sqrt(x)*x^(1/2)/exp(x*2) - 99") == ""
    for wrong in ("exp(2*x)*exp(x) - sqrt(x)*x^0.5/exp(2*x) - 99", "exp(2*x)^2 - sqrt(x)*x^1.5/exp(2*x) - 99"):
        assert "do not make up the claim" in verdict(left, "99", wrong)


def test_a_root_of_a_fraction_of_functions_uses_their_ranges_on_the_box() -> None:
    assert verdict("sqrt(x/exp(x)) + x - x", "9", "sqrt(x/exp(x)) - 9") == ""
    assert "unknown sign" in verdict("sqrt(x/tan(x)) + x - x", "9", "sqrt(x/tan(x)) - 9", (-1.0, -0.5))


def test_a_variable_may_have_the_name_of_a_function_that_came_later() -> None:
    """Certificates from before these functions stay accepted."""
    table = ExpressionTable(("exp", "log"))
    (value_,) = enclose(table, [table.read("exp(log) - exp*2")], [exact(0.5), exact(0.0)])
    assert value_ == (libmp.fzero, libmp.fzero)


@pytest.mark.parametrize("bad", [libmp.finf, libmp.fninf, libmp.fnan])
def test_ends_that_are_no_numbers_have_no_range(bad) -> None:
    one = libmp.fone
    for ends in ((bad, bad), (bad, one), (one, bad)):
        for op in ("exp", "sinh", "cosh", "tanh", "log", "tan", "asin", "acos"):
            with pytest.raises(Undefined):
                elementary(op, ends, Fraction(1))
        for exponent in (Fraction(1, 2), Fraction(-1, 2)):
            assert real_power(ends, exponent) is None


def test_an_unknown_operation_has_no_range() -> None:
    one = (libmp.fone, libmp.fone)
    with pytest.raises(Undefined, match="is not known"):
        elementary("sec", one, Fraction(1))


def test_tiny_and_long_numbers_are_rounded_outward() -> None:
    for size in (n for n in LONG if libmp.mpf_lt(n, raw(2.0**-40))):
        for x in (size, libmp.mpf_neg(size)):
            assert holds(elementary("sinh", (x, x), Fraction(1)), sinh(x))
            assert holds(elementary("tanh", (x, x), Fraction(1)), libmp.mpf_tanh(x, 400))


def test_a_logarithm_needs_positive_numbers() -> None:
    with pytest.raises(Undefined, match="numbers of at most 0"):
        elementary("log", (raw(-2.0), raw(-1.0)), Fraction(1))

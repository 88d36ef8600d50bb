from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from mpmath import libmp, mp, mpf

from surctl.certcheck.enclosure import Undefined, enclose, exact, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.jets import Tape
from surctl.verification.formula import parse, text_of, variable
from surctl.verification.proving.tape import build_tape
from tests.verification.expressions import NAMES, NoValue, TooClose, expressions, worth

ends = st.floats(-4, 4).map(lambda x: round(x, 3))


def as_mpf(raw):
    return mp.make_mpf(raw)


def corner_and_inside(box, shares):
    """Points of the box as exact rationals: corners as well as points between."""
    return {n: mpf(low) + (mpf(high) - mpf(low)) * mpf(s) for n, (low, high), s in zip(NAMES, box, shares, strict=True)}


boxes = st.lists(st.tuples(ends, st.one_of(st.just(0.0), st.floats(0, 2))), min_size=3, max_size=3).map(
    lambda rows: [(low, low + width) for low, width in rows]
)
shares = st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), min_size=3, max_size=3)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(expressions(), boxes, shares)
def test_the_checkers_ranges_hold_the_value_at_every_point(root, box, at) -> None:
    sheet = ExpressionTable(NAMES)
    place = sheet.read(text_of(root))
    with mp.workdps(60):
        point = corner_and_inside(box, at)
        try:
            value = worth(root, point)
        except TooClose:
            return
        except NoValue:
            with pytest.raises(Undefined):
                enclose(sheet, [place], [span(*b) for b in box])
            return
        try:
            (value_,) = enclose(sheet, [place], [span(*b) for b in box])
        except Undefined:
            return
        room = abs(value) * mpf(10) ** -50
        assert as_mpf(value_[0]) - room <= value <= as_mpf(value_[1]) + room, text_of(root)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(expressions(), boxes, shares)
def test_the_provers_ranges_hold_the_value_at_every_point(root, box, at) -> None:
    tape = build_tape(NAMES, [root])
    lower, upper = (np.array([[b[k]] for b in box]) for k in (0, 1))
    read = tape.run((lower, upper))
    with mp.workdps(60):
        point = corner_and_inside(box, at)
        try:
            value = worth(root, point)
        except TooClose:
            return
        except NoValue:
            assert not read.defined[0][0]
            return
        if read.defined[0][0]:
            low, high = (mpf(float(e[0])) for e in read.jets[0].value)
            assert low <= value <= high, text_of(root)


def of_each_function(test):
    """A property for a narrow box and each function as well, whatever is drawn."""
    names = {n: variable(n) for n in NAMES}
    texts = ("sqrt(x + 2)", "acos(x/3)", "sin(x)", "cos(x)", "tan(x)", "asin(x/3)", "exp(x)", "log(x + 2)", "tanh(x)")
    for text in (*texts, "sinh(x)", "cosh(x)", "x^3", "x/(y + 4)", "atan2(x, y)", "(x + 2)^1.5"):
        at = [(0.5, 0.5078125), (0.625, 0.6328125), (1.0, 1.0)]
        test = example(parse(text, names), at, [0.5, 0.5, 0.5])(test)
    return test


@of_each_function
@settings(max_examples=30, deadline=None, derandomize=True)
@given(expressions(branching=False), boxes, shares)
def test_derivatives_hold_the_slopes_and_bends_that_differences_show(root, box, at) -> None:
    sheet = ExpressionTable(NAMES)
    place = sheet.read(text_of(root))
    lower, upper = (np.array([[b[k]] for b in box]) for k in (0, 1))
    (checked,), (fine,) = Tape(sheet, (place,)).run((lower, upper), order=2)
    if not fine[0]:
        return
    prover = build_tape(NAMES, [root]).run((lower, upper), order=2).jets[0]
    with mp.workdps(60):
        point = corner_and_inside(box, at)
        h = mpf(10) ** -15

        def value(*steps):
            return worth(root, {n: point[n] + s * h for n, s in zip(NAMES, steps, strict=True)})

        for i in range(3):
            e = [int(k == i) for k in range(3)]
            minus = [-k for k in e]
            try:
                first = (value(*e) - value(*minus)) / (2 * h)
                second = (value(*e) - 2 * value(0, 0, 0) + value(*minus)) / h**2
            except (NoValue, TooClose):
                return
            assume(abs(first) < 1e6 and abs(second) < 1e6)
            tolerance = mpf(10) ** -8 * (1 + abs(first) + abs(second))
            derivatives = [(j.slope, first) for j in (prover, checked)] + [(j.bend, second) for j in (prover, checked)]
            for shown, wanted in derivatives:
                low, high = (mpf(float(x[i, 0] if x.ndim == 2 else x[i, i, 0])) for x in shown)
                assert low - tolerance <= wanted <= high + tolerance, text_of(root)


def test_at_a_point_the_range_is_narrow() -> None:
    sheet = ExpressionTable(("x",))
    place = sheet.read("sin(x)*sqrt(x + 2)/acos(x/3) - atan2(x, 0.5)^3")
    (value_,) = enclose(sheet, [place], [exact(0.7)])
    assert as_mpf(value_[1]) - as_mpf(value_[0]) < 1e-15


@pytest.mark.parametrize(
    ("text", "box"),
    [
        ("1/x", (-1.0, 1.0)),
        ("x^-2", (0.0, 1.0)),
        ("sqrt(x)", (-1e-300, 1.0)),
        ("acos(x)", (0.0, 1.0000000000000002)),
        ("atan2(x, x)", (-1.0, 1.0)),
        ("asin(x)", (-1.0000000000000002, 1.0)),
        ("log(x)", (0.0, 1.0)),
        ("tan(x)", (1.5, 1.6)),
        ("tan(x)", (-1e308, -1e308 + 1e300)),
        ("x^0.5", (-1e-300, 1.0)),
        ("x^(-1/2)", (0.0, 1.0)),
        ("exp(exp(exp(x)))", (0.0, 9.0)),
        ("1/exp(-exp(exp(x)))", (0.0, 9.0)),
        ("cosh(x)", (-1e300, 1.0)),
    ],
)
def test_what_is_not_defined_on_the_whole_box_is_refused(text, box) -> None:
    sheet = ExpressionTable(("x",))
    with pytest.raises(Undefined):
        enclose(sheet, [sheet.read(text)], [span(*box)])


def test_numbers_are_exact_decimals() -> None:
    sheet = ExpressionTable(("x",))
    assert sheet.entries[sheet.read("0.1")].value == Fraction(1, 10)
    (value_,) = enclose(sheet, [sheet.read("0.1")], [exact(0.0)])
    low, high = (libmp.to_rational(e) for e in value_)
    assert Fraction(*low) < Fraction(1, 10) < Fraction(*high)

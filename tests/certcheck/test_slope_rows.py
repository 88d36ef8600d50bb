"""Rows of slopes: they contain the expressions at samples of the region, and their ranges are narrow."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from mpmath import libmp
from numpy.typing import NDArray

from surctl.certcheck import Rejected
from surctl.certcheck.enclosure import Undefined, span
from surctl.certcheck.radii import widened
from surctl.certcheck.region_exact import inverse, up
from surctl.certcheck.secants import _MOST_EXPONENT, fraction
from surctl.certcheck.slope_rows import Number, Rows
from surctl.verification.formula import parse, values_of, variable

Array = NDArray[np.float64]
NAMES = ["x", "y", "p", "w"]
CENTRE = [Fraction(3, 10), Fraction(-1, 5)]
BOX = [(-2.0, 2.0), (-2.0, 2.0), (0.8, 1.25), (-0.5, 0.3)]
P = [[Fraction(2), Fraction(1, 2)], [Fraction(1, 2), Fraction(1)]]
EXPRESSIONS = (
    "sin(x) + p*y", "x*abs(x)", "max(-0.4, min(0.5, x + 2*y))", "x*y - w", "x*cos(y)", "x/(1 + y^2)", "p*x*p",
    "min(x, 0.3*p + y)", "max(x, -0.3/p)", "exp(y)*(x + y)", "sqrt(1 + x^2)*y", "y/p + x/3", "atan(x - y)",
    "p*y*sin(x)", "abs(x - y)", "atan2(x, 2 + y)", "(x + y)^2 + x^3", "w*x + w*w*y", "sin(p)*x + cos(p*p)", "-y*x*p",
    "max(x, min(y, p))", "(x + 1/3)*(y - p)*x", "abs(x + 3) - abs(y - 3)", "log(2 + x)/(2 + x)", "(p - 1)*(p + x)",
    "min(5, x) + max(5, y)", "abs(3 + x*y)", "min(x*y, x - 9)", "max(y, x*x - 9)", "(x + 2*y)*(x - y)", "x*p/(2 + p)",
    "(x - 0.3*p)*abs(x - 0.3*p)", "(4 + p*abs(x - 0.3*p))*(x - 0.3*p)", "p*x*abs(x)", "x*y*abs(x)", "x*(p*x*y)*y",
    "(4 + p*abs(x))*x", "(x - 0.3*p)*(y - p*abs(x - 0.3*p) + x)", "(p*x - y)*x*x", "y*w*w",
)  # fmt: skip


def rows_of(first: str, second: str = "0*x", level: float = 1.0, **further: object) -> Rows:
    settings = {"p": P, "centre": CENTRE, "disturbances": ["w"], "box": BOX} | further
    box, covers = [span(*ends) for ends in settings.pop("box")], [inverse(settings.pop("p"))]
    return Rows(NAMES, box, [first, second], covers, level=Fraction(level), **settings)


def samples(count: int = 400) -> Array:
    """Return states of the region, and parameters (4, N)."""
    random = np.random.default_rng(1)
    z = random.normal(size=(2, count))
    p = np.array([[float(x) for x in row] for row in P])
    z *= np.where(random.random(count) < 0.6, 1, random.random(count)) / np.sqrt(np.einsum("in,ij,jn->n", z, p, z))
    low, high = np.array(BOX[2:]).T[:, :, None]
    share = random.random((2, count))
    share = np.where(random.random((2, count)) < 0.5, share.round(), share)
    return np.vstack([z + np.array([[float(c)] for c in CENTRE]), low + (high - low) * share])


def evaluated(rows: Rows, number: Number, at: dict[int, Fraction]) -> float:
    total = Fraction(0)
    for term, x in number.poly.items():
        for k in term:
            x = x * at[k]
        total += x
    return float(total)


def extremes(rows: Rows, row: list[Number], along: Array) -> tuple[Array, Array]:
    """Return the least and the largest row · along (N,) over all vertices."""
    used = sorted({k for entry in row for term in entry.poly for k in term})
    every = [
        [evaluated(rows, entry, dict(zip(used, ends, strict=True))) for entry in row]
        for ends in product(*(rows.slopes[k] for k in used))
    ]
    values = np.array(every) @ along
    error = np.array([[float(entry.error) for entry in row]]) @ np.abs(along)
    return values.min(axis=0) - error[0], values.max(axis=0) + error[0]


@pytest.mark.parametrize("radius", [Fraction(0), Fraction(1, 10), Fraction(1, 10**12)])
@pytest.mark.parametrize("text", EXPRESSIONS)
def test_a_row_contains_the_expression(text: str, radius: Fraction) -> None:
    radii = [radius, radius / 2] if radius else []
    rows = rows_of(text, level=widened(P, Fraction(1), radii), radii=radii)
    at = samples()
    node = parse(text, {name: variable(name) for name in NAMES})
    rest = at.copy()
    rest[:2], rest[3] = np.array([[float(c)] for c in CENTRE]), 0.0
    if radii:  # about every point within them
        rest[:2] += np.random.default_rng(2).choice([-1, -0.3, 1], at[:2].shape) * np.array([radii], dtype=float).T
    change = values_of([node], dict(zip(NAMES, at, strict=True)))[0]
    change = change - values_of([node], dict(zip(NAMES, rest, strict=True)))[0]
    low, high = extremes(rows, rows.rows[0], np.vstack([at[:2] - rest[:2], at[3]]))
    assert np.all(low <= change + 1e-12)
    assert np.all(change - 1e-12 <= high)


R = float(np.sqrt(float(P[1][1]) / (float(P[0][0]) * float(P[1][1]) - 0.25)))  # of x in the region
LOW, HIGH = 0.3 - R, 0.3 + R


@pytest.mark.parametrize(
    ("text", "slope"),
    [
        ("x^2", (LOW + 0.3, HIGH + 0.3)),
        ("x*abs(x)", (None, HIGH + 0.3)),
        ("max(-0.1, min(0.5, x))", (0.2 / R, 1.0)),
        ("max(x, 0)", (0.3 / R, 1.0)),
        ("exp(x)", ((np.exp(LOW) - np.exp(0.3)) / -R, (np.exp(HIGH) - np.exp(0.3)) / R)),
        ("p*x", BOX[2]),
        ("x/p", (0.8, 1.25)),
    ],
)
def test_the_range_of_a_slope_is_narrow(text: str, slope: tuple[float | None, float]) -> None:
    [(low, high)] = [(float(a), float(b)) for a, b in rows_of(text).slopes]
    for value, expected in zip((low, high), slope, strict=True):
        assert expected is None or value == pytest.approx(expected, abs=6e-3)
    assert slope[0] is None or low <= slope[0] + 1e-12
    assert slope[1] - 1e-12 <= high


def test_a_kink_at_0_on_both_sides_of_which_the_equilibrium_may_lie_adds_no_slope_of_another_sign() -> None:
    [(low, high)] = rows_of("(x - 0.3*p)*abs(x - 0.3*p)").slopes
    most = HIGH - 0.24 + 0.06  # of the two values between which it is a secant
    assert low == 0 and most <= float(high) <= most + 0.05


@pytest.mark.parametrize(
    "text", ["p*x*abs(x)", "x*p*abs(x)", "abs(x)*(x*p)", "p*(x*abs(x))", "(4 + p*abs(x))*x", "x*(p*abs(x) - 4)"]
)
def test_functions_of_one_variable_are_multiplied_first(text: str) -> None:
    rows = rows_of(text)
    used = {rows.slopes[k] for entry in rows.rows[0] for term in entry.poly for k in term}
    assert used == {*rows_of("p*y").slopes, *rows_of("x*abs(x)").slopes}


def test_the_support_of_a_sum_is_that_of_the_ellipsoid() -> None:
    # max(0, x + y - 3) is 0 on the region if the support of x + y is below 2.9
    reach = float(np.sqrt(np.ones(2) @ np.linalg.inv(np.array(P, dtype=float)) @ np.ones(2)))
    for gap, slopes in ((1.001, 0), (0.999, 1)):
        assert len(rows_of(f"max(0, x + y - {0.1 + gap * reach!r})").slopes) == slopes


def test_the_box_limits_the_region() -> None:
    wide, narrow = (rows_of("x^2", box=[(0.2, end), *BOX[1:]]).slopes[0] for end in (2.0, 0.4))
    assert float(wide[0]) == pytest.approx(0.5, abs=1e-3)
    assert [float(end) for end in narrow] == pytest.approx([0.5, 0.7], abs=1e-3)


def test_a_branch_that_ranges_decide_has_no_slope() -> None:
    for text in ("abs(x + 3)", "abs(x - 3)", "min(x, 5)", "max(5, x)", "select(x, 5, x, y)", "select(5, x, x, y)"):
        assert not rows_of(text).slopes, text
    # at the border, the first of two equal operands of select counts
    assert not rows_of("select(p, 1.25, x, y)").slopes
    assert rows_of("min(p, 1.24)*x").slopes


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("atan2(x + 5, y)", "positive second operand"), ("select(x, y, x, y)", "does not cover select"),
    ],
)  # fmt: skip
def test_what_the_rule_does_not_cover_is_refused(text: str, message: str) -> None:
    with pytest.raises(Rejected, match=message):
        rows_of(text)


@pytest.mark.parametrize(("count", "fits"), [(64, True), (65, False)])
def test_too_many_terms_are_refused(count: int, fits: bool) -> None:
    rows = rows_of("x")
    rows.slopes += [(Fraction(0), Fraction(1))] * (2 * count)
    first, second = (Number({(k + begin,): Fraction(1) for k in range(count)}) for begin in (0, count))
    if fits:
        assert len(rows.times(first, second).poly) == count**2
        return
    with pytest.raises(Rejected, match="too many terms"):
        rows.times(first, second)


@pytest.mark.parametrize("text", ["select(x, 0.3, x, 2*x)", "x/(x - 0.2)", "sqrt(x)", "log(x)*y"])
def test_an_expression_that_is_not_defined_or_jumps_is_refused(text: str) -> None:
    with pytest.raises(Undefined):
        rows_of(text)


@pytest.mark.parametrize(
    ("text", "rests"),
    [
        ("x - 0.3", True), ("x - 0.3000001", False), ("(x - 0.3)*p + w", True), ("(x - 0.3)*p + w + p - p", True),
        ("x - 0.3 + p", False), ("max(0, y)", True), ("sqrt(x*x) - 0.3", True),
        ("sqrt(x*x) - 0.3001", False), ("sin(x - 0.3)", True),
    ],
)  # fmt: skip
def test_the_rest_at_the_equilibrium_is_exact(text: str, rests: bool) -> None:
    free = rows_of(text).resting(0, Fraction(0))
    assert (not free.poly and not free.error) is rests


@pytest.mark.parametrize(
    "text",
    ["sin(p)*x - cos(p)*x*p", "50*(p - p*p) + 50*(p*p*p - p)", "30*sqrt(p) - 29*p", "p/(1 + p) + x*p"],
)
def test_the_rest_for_all_parameters_is_bounded_closely_where_terms_cancel(text: str) -> None:
    ends = (1.0, 1.02)
    rows = rows_of(text, box=[*BOX[:2], ends, BOX[3]])
    [(term, _)] = rows.resting(0, Fraction(0)).poly.items()
    [low, high] = [float(end) for end in rows.slopes[term[0]]]
    at = {"x": np.full(101, float(CENTRE[0])), "p": np.linspace(*ends, 101)}
    values = values_of([parse(text, {name: variable(name) for name in NAMES})], at)[0]
    assert low <= values.min() and values.max() <= high
    assert high - low <= 1.5 * np.ptp(values)


def test_the_rest_of_a_successor_is_the_equilibrium() -> None:
    rows = rows_of("0.3 + p*(x - 0.3)", "x*p")
    assert not rows.resting(0, CENTRE[0]).poly
    moved = rows.resting(1, CENTRE[1])
    [(term, factor)] = moved.poly.items()
    [low, high] = [float(end) for end in rows.slopes[term[0]]]
    assert factor == 1
    assert (low, high) == pytest.approx((0.24 + 0.2, 0.375 + 0.2))
    assert low <= 0.44 <= 0.575 <= high


def test_products_replace_a_common_slope_by_a_copy() -> None:
    rows = rows_of("p*x", "p*p*x")
    k = next(iter(rows.rows[0][0].poly))[0]
    one = Number({(k,): Fraction(2), (): Fraction(1)}, Fraction(1, 8))
    square = rows.times(one, one)
    copies = {term for term in square.poly if len(term) == 2}
    assert len(copies) == 1
    assert len(set(next(iter(copies)))) == 2
    largest = Fraction(rows.slopes[k][1])
    assert rows.slopes[max(next(iter(copies)))] == rows.slopes[k]
    assert square.error == Fraction(1, 8) * (rows.size(one) + 2 * largest + 1)
    assert rows.size(one) == 2 * largest + 1 + Fraction(1, 8)
    assert one + Number({(k,): Fraction(-2)}, Fraction(1)) == Number({(): Fraction(1)}, Fraction(9, 8))
    assert rows.times(one, Number({})) == Number({})


def test_an_end_of_too_many_digits_is_refused() -> None:
    tiny = "1e-300*(1 + x^2)"
    for _ in range(3):
        tiny = f"({tiny})^64"
    with pytest.raises(Undefined, match="too large or small"):
        rows_of(f"y*{tiny}")


@pytest.mark.parametrize("x", [Fraction(1, 3), Fraction(2, 3), Fraction(1, 10**30), Fraction(0)])
def test_up_rounds_up(x: Fraction) -> None:
    assert x <= Fraction(up(x)) <= x * (1 + Fraction(1, 2**50))


def test_the_ends_of_a_range_are_rounded_outwards() -> None:
    third = libmp.from_rational(1, 3, 60, "f"), libmp.from_rational(2, 3, 60, "c")
    rows = rows_of("x")
    assert rows._slope(third) == Number({(0,): Fraction(1)})
    [(low, high)] = rows.slopes
    assert Fraction(1, 3) - Fraction(1, 2**20) < low < Fraction(1, 3)
    assert Fraction(2, 3) < high < Fraction(2, 3) + Fraction(1, 2**20)
    narrow = libmp.from_rational(1, 3, 60, "f"), libmp.from_rational(1, 3, 60, "c")
    number = rows._slope(narrow)
    assert len(rows.slopes) == 1
    assert abs(number.poly[()] - Fraction(1, 3)) <= number.error < Fraction(1, 2**55)


def test_a_number_with_a_huge_exponent_is_refused_before_it_is_written() -> None:
    for exponent in (_MOST_EXPONENT + 1, -_MOST_EXPONENT - 1):
        with pytest.raises(Undefined, match="too large or small"):
            fraction((0, 1, exponent, 1))
    assert fraction((1, 3, -2, 2)) == Fraction(-3, 4)

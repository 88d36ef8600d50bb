"""Normal forms of the checker: limits on their size, and what they may not equate."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest

from surctl.certcheck import patience
from surctl.certcheck.document import Rejected
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact, Sum, _check_size, _product
from surctl.certcheck.inequality import Inequality

ONE = Fraction(1)


def powers(name: str, count: int) -> Sum:
    return {((name, k),): ONE for k in range(1, count + 1)}


def equal(left: str, right: str) -> bool:
    table = ExpressionTable(["x", "y"])
    exactly = Exact(table)
    return exactly.equal(table.read(left), lambda e: e.of(table.read(right)))


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("sqrt(1 + sqrt(x))^2*sqrt(x)", "sqrt(x) + x"),
        ("sqrt(sqrt(x))^4 + sqrt(x)^3", "x + x*sqrt(x)"),
        ("sqrt(x)^4 + sqrt(x)^2 + 1", "x^2 + x + 1"),
        ("sqrt(x)^4 + sqrt(x)^6", "x^2 + x^3"),
        ("sin(x)^5", "sin(x)*(1 - cos(x)^2)^2"),
        ("sqrt(4*y + 4*x^2)", "2*sqrt(x^2 + y)"),
    ],
)
def test_squares_of_roots_and_sines_are_replaced(left: str, right: str) -> None:
    assert equal(left, right)
    assert not equal(left, f"{right} + 1") and not equal(left, f"2*({right})")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1/(x - x)", "a division by an expression that is identically 0"),
        ("(x - x)^-1", "a division by an expression that is identically 0"),
        ("sqrt(x/(-4))", "a root of a fraction with a negative denominator"),
        ("x*(1/2 + 1/3^64 + 1/5^64)^64", "too large to be checked"),
    ],
)
def test_what_has_no_normal_form(text: str, says: str) -> None:
    table = ExpressionTable(["x"])
    with pytest.raises(Rejected, match=says):
        Exact(table).of(table.read(text))


def test_a_denominator_under_a_root_is_shown_to_be_positive_by_its_range() -> None:
    table = ExpressionTable(["x", "y"])
    claim = Inequality(table, [table.read(text) for text in ("sqrt(x/exp(y))", "9")], [(1.0, 2.0), (-1.0, 1.0)])
    case = {"choice": "", "numerator": "sqrt(x*exp(y)) - 9*exp(y)", "denominators": ["exp(y)"], "multipliers": [],
            "tree": "n", "points": []}  # fmt: skip
    claim.check([case])


def too_large(call: Any, *words: Any) -> None:
    with pytest.raises(Rejected, match="an identity is too large to be checked"):
        call(*words)


def test_polynomials_are_limited_in_terms_and_digits() -> None:
    exactly = Exact(ExpressionTable(["x"]))
    assert len(exactly.mul(powers("v0", 100), powers("v0", 100))) == 199
    too_large(exactly.mul, powers("v0", 150), powers("v0", 81))  # many products of few terms
    too_large(exactly.mul, powers("v0", 109), powers("v1", 110))
    too_large(_product, powers("v0", 130), powers("v1", 130))
    too_large(exactly.mul, {(): Fraction(2**3000)}, {(): Fraction(2**3000)})
    too_large(exactly.plus, {(): Fraction(1, 2**4000)}, {(): Fraction(1, 3**2500)})
    too_large(exactly._spelled, {(("v0", k),): Fraction(10**9 + k) for k in range(1500)})
    _check_size(Fraction(2**4095, 3))
    too_large(_check_size, Fraction(2**4096))
    too_large(_check_size, Fraction(1, 2**4096))


def test_every_product_counts_all_pairs() -> None:
    a, b = powers("v0", 9), powers("v1", 9)
    assert _product(a, b) == {(("v0", i), ("v1", j)): 1 for i in range(1, 10) for j in range(1, 10)}


def memory(monkeypatch: pytest.MonkeyPatch, size: int, call: Any) -> None:
    monkeypatch.setattr(patience, "MEMORY", size)
    with patience.patient(9.0), pytest.raises(Rejected, match="memory"):
        call()


def test_what_an_identity_stores_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = powers("v0", 9), powers("v1", 9)
    memory(monkeypatch, 10_000, lambda: _product(a, b))
    monkeypatch.setattr(patience, "MEMORY", 1_000_000)
    with patience.patient(9.0):
        assert len(_product(a, b)) == 81
    table = ExpressionTable(["x"])
    roots = [table.read(f"(x + {k})^8") for k in range(40)]

    def normal_forms() -> None:
        exactly = Exact(table)
        for root in roots:
            exactly.of(root)

    memory(monkeypatch, 100_000, normal_forms)

    def names() -> None:
        exactly = Exact(table)
        for k in range(20):
            exactly._spelled({(("v0", 1),): Fraction(2 ** (3000 + k))})

    memory(monkeypatch, 30_000, names)


def test_normal_forms_are_reusable_if_they_are_few_and_assume_nothing() -> None:
    table = ExpressionTable(["x", "y"])
    few, assuming, many = Exact(table), Exact(table), Exact(table)
    few.of(table.read("sqrt(x)*y"))
    assuming.of(table.read("sqrt(x/(y + 2))"))
    for k in range(600):
        many.of(table.read(f"(x + y + {k})^3"))
    assert (few.reusable, assuming.reusable, many.reusable) == (True, False, False)

"""Parts of a proof by sums of squares: each malformed or false one is the only reason for the rejection."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import pytest

from surctl.certcheck import patience
from surctl.certcheck.document import Rejected
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact
from surctl.certcheck.squares import (
    Claimed,
    _Block,
    _common,
    _fraction,
    _less,
    _monomial,
    _product,
    _Ring,
    check_squares,
)

NOTHING: dict[str, Any] = {"symbols": ["x", "y"], "facts": [], "blocks": [], "relations": []}
ZERO = {"factors": [], "monomials": [], "over": 1, "gram": []}
ONE = {"factors": [], "monomials": [[0, 0]], "over": 1, "gram": [0]}
BOX = ((-1.0, 1.0), (-1.0, 1.0))


def claimed(
    numerator: str = "0", box: Any = BOX, constraints: tuple[str, ...] = (), denominators: tuple[str, ...] = ()
) -> Claimed:
    table = ExpressionTable(["x", "y"])
    read = [[table.read(text) for text in texts] for texts in (denominators, constraints)]
    return Claimed(table, table.read(numerator), *read, box, 0.0, Exact(table))


def rejected(says: str, numerator: str = "0", box: Any = BOX, **changed: Any) -> None:
    with pytest.raises(Rejected, match=says):
        check_squares(NOTHING | changed, claimed(numerator, box))


def test_nothing_proves_that_0_is_not_negative() -> None:
    check_squares(NOTHING, claimed())
    check_squares(NOTHING | {"blocks": [ZERO] * 600, "facts": [None] * 60}, claimed())
    check_squares(NOTHING | {"symbols": [f"exp({k}*x)" for k in range(40)]}, claimed())


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"blocks": [ZERO] * 601}, "too many sums of squares"),
        ({"blocks": [ONE | {"factors": ["l0"] * 5}]}, "a sum of squares has 5 factors beside it"),
        ({"facts": [None] * 61}, "the proof has 2 variables and 61 inequalities"),
        ({"symbols": [f"exp({k}*x)" for k in range(41)]}, "the proof has 41 variables"),
        *(({"symbols": ["x", text]}, "symbol 1 does not have the form")
          for text in ("3", "x + y", "y^2", "x*y", "pi*y", "2*x")),
        ({"relations": [{"symbol": 0, "monomials": [], "factors": [[1, 1]]}], "symbols": ["sin(x)", "cos(x)"]},
         "a relation has a wrong number of factors"),
        ({"relations": [{"symbol": 0, "monomials": [[0, 0]] * 2, "factors": [[0, 1]] * 2}],
          "symbols": ["sin(x)", "cos(x)"]}, "a monomial occurs twice"),
        ({"blocks": [ONE | {"monomials": [[k % 60, k // 60] for k in range(131)], "gram": [0] * (131 * 66)}]},
         "more than 130 monomials"),
        ({"blocks": [ONE | {"gram": [0, 0]}]}, "a wrong number of entries"),
        ({"blocks": [ONE | {"gram": []}]}, "a wrong number of entries"),
    ],
)  # fmt: skip
def test_a_malformed_proof_is_named(changed: dict[str, Any], says: str) -> None:
    rejected(says, **changed)


@pytest.mark.parametrize(
    ("numerator", "says"),
    [
        ("x/y", "is not a polynomial"),
        # equal only for y > 2
        ("exp(sqrt(x/(y - 2))) - exp(sqrt(x*(y - 2))/(y - 2))", "is not a polynomial"),
        ("sin(x)", "not among the symbols"),
        ("x^61", "an exponent is too large"),
        ("(x^64)^64 - y", "an exponent is too large"),  # the exponents would fill the place of the next one
    ],
)
def test_a_numerator_that_is_no_polynomial_in_the_symbols(numerator: str, says: str) -> None:
    symbols = ["x", "y"] if "exp" not in numerator else ["exp(sqrt(x/(y - 2)))"]
    rejected(says, numerator, ((-2.0, -1.0), (-1.0, 1.0)), symbols=symbols)


def test_the_number_of_denominators_is_limited() -> None:
    check_squares(NOTHING, claimed(denominators=("1",) * 13))
    with pytest.raises(Rejected, match="too many denominators"):
        check_squares(NOTHING, claimed(denominators=("1",) * 14))


@pytest.mark.parametrize(
    ("name", "says"),
    [(7, "has a name that is not"), (["c"], "has a name that is not"), ("cx", "has a name that is not"),
     ("c٠", "has a name that is not"), ("c", "has a name that is not"), ("c0000", "has a name that is not"),
     ("c1", "the factor 'c1' does not exist"), ("h2", "the factor 'h2' does not exist"),
     ("f1", "the factor 'f1' does not exist"), ("x0", "the factor 'x0' does not exist")],
)  # fmt: skip
def test_a_factor_that_does_not_exist(name: Any, says: str) -> None:
    ring = _Ring(claimed(constraints=("x",)), NOTHING | {"facts": [{"of": "x", "factors": ["t^2"]}]})
    assert ring.factor("c0") == {1: -1} and ring.factor("c000") == {1: -1}
    assert ring.factor("f0") == {2: 1}
    with pytest.raises(Rejected, match=says):
        ring.factor(name)


@pytest.mark.parametrize(
    "fact",
    ["t^2", ["of", "factors"], {"of": "x", "factors": ["t^2"], "more": 1}, {"of": "x"}, {"of": "x", "factors": []},
     {"of": "x", "factors": ["1"] * 3}],
    ids=str,
)  # fmt: skip
def test_a_fact_that_is_malformed(fact: Any) -> None:
    ring = _Ring(claimed(), NOTHING | {"facts": [fact]})
    with pytest.raises(Rejected, match="a fact needs the keys"):
        ring.factor("f0")


def test_both_bounds_of_a_variable_contain_the_double_and_its_decimal() -> None:
    for end in (0.1, 0.3):  # the double lies above and below the decimal
        numbers = Fraction(end), Fraction(repr(end))
        ring = _Ring(claimed(box=((end, 1.0), (-1.0, end))), NOTHING)
        assert ring.factor("l0") == {1: 1, 0: -min(numbers)}
        assert ring.factor("h1") == {1 << 12: -1, 0: max(numbers)}


@pytest.mark.parametrize("exponents", [[0], [0, 0, 0], [0, -1], [-1, 0], [0, 61], [61, 0], [True, 0], [0.0, 0], "ab"])
def test_a_monomial_has_an_exponent_for_each_symbol(exponents: Any) -> None:
    assert _monomial([60, 60], 2) == 60 + (60 << 12)
    with pytest.raises(Rejected):
        _monomial(exponents, 2)


# memory and digits


def test_denominators_do_not_grow_without_end() -> None:
    numbers = [Fraction(1, 2**6000 + 2 * k + 1) for k in range(6)]
    with pytest.raises(Rejected, match="too many digits"):
        _common(numbers)
    with pytest.raises(Rejected, match="too many digits"):
        _less({0: Fraction(1, 2**12500)}, {0: Fraction(1, 3**8000)})


def test_what_a_proof_stores_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patience, "MEMORY", 9000)
    about = claimed(constraints=tuple(f"(x + y + {k})^2" for k in range(9)))
    with patience.patient(9.0):
        many = {k: Fraction(1) for k in range(20)}
        with pytest.raises(Rejected, match="memory"):
            _less(many, {k + 20: Fraction(1) for k in range(20)})
        two = [{0: Fraction(1), one: Fraction(2**5000)} for one in (1, 2)]
        with pytest.raises(Rejected, match="memory"):  # four terms with up to 10,000 bits
            _product(*two)
        ring = _Ring(about, NOTHING)
        with pytest.raises(Rejected, match="memory"):
            for k in range(9):
                ring.factor(f"c{k}")


@pytest.mark.parametrize("number", [[1], [1, 2, 3], [1, 0], [1, -2], [1, 2.0], [True, 1], 1])
def test_a_number_is_a_fraction_with_a_positive_denominator(number: Any) -> None:
    assert _fraction([-3, 6]) == Fraction(-1, 2)
    with pytest.raises(Rejected):
        _fraction(number)


def test_a_matrix_is_the_one_of_the_document() -> None:
    block = _Block({"factors": [], "monomials": [[0, 0], [1, 0]], "over": 2, "gram": [2, 3, [4, 3]]}, 2)
    assert block.polynomial() == {0: 1, 1: 3, 2: Fraction(4, 3)}

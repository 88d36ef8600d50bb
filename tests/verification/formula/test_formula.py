from fractions import Fraction

import casadi as ca
import pytest
from hypothesis import given, settings
from mpmath import mp, mpf

from surctl.errors import InputError, UnsupportedOperation
from surctl.verification.formula import from_casadi, number, parse, power, text_of, to_casadi, variable
from surctl.verification.formula.node import PI
from surctl.verification.formula.parser import clipped
from surctl.verification.proving.algebra import Algebra, TooLarge, Written
from tests.verification.expressions import NAMES, NoValue, TooClose, expressions, worth

KNOWN = {n: variable(n) for n in NAMES}
POINT = {"x": mpf("0.37"), "y": mpf("-1.3"), "z": mpf("0.81")}


@settings(max_examples=24, deadline=None, derandomize=True)
@given(expressions())
def test_text_reads_back_as_what_was_written(root) -> None:
    again = parse(text_of(root), KNOWN)
    assert parse(text_of(again), KNOWN) == again
    try:
        value = worth(root, POINT)
    except (NoValue, TooClose):
        return
    assert abs(value - worth(again, POINT)) <= abs(value) * mpf(10) ** -40


def test_a_text_that_is_too_long_is_refused() -> None:
    long = KNOWN["x"]
    for _ in range(40):
        long = long * long
    with pytest.raises(InputError, match="longer than"):
        text_of(long)


@settings(max_examples=24, deadline=None, derandomize=True)
@given(expressions())
def test_casadi_computes_what_the_text_says(root) -> None:
    try:
        value = float(worth(root, POINT))
    except (NoValue, TooClose, OverflowError):
        return
    if not 1e-3 < abs(value) < 1e6:
        return  # what cancels in doubles is not compared
    symbols = {n: ca.SX.sym(n) for n in NAMES}
    f = ca.Function("f", [*symbols.values()], [to_casadi(root, symbols)])
    found = float(f(*(float(POINT[n]) for n in NAMES)))
    assert found == pytest.approx(value, rel=1e-6)


@settings(max_examples=24, deadline=None, derandomize=True)
@given(expressions(branching=False))
def test_the_normal_form_has_the_value_of_the_expression(root) -> None:
    algebra = Algebra()
    try:
        value = worth(root, POINT)
        ratio = algebra.of(root)
        written = Written(algebra)
        same = worth(written.ratio(ratio), POINT)
        signs = [worth(written.factor(at), POINT) for at in algebra.positive]
    except (NoValue, TooClose, TooLarge):
        return
    if any(s <= 0 for s in signs):
        return  # the form is only claimed for positive ones
    with mp.workdps(60):
        assert abs(value - same) <= (abs(value) + 1) * mpf(10) ** -30, text_of(root)


def test_powers_of_powers_have_no_endless_normal_form() -> None:
    x = variable("x")
    Algebra().of(power(power(x, 64), 64))
    with pytest.raises(TooLarge):
        Algebra().of(power(power(power(x, 64), 64), 64))


def test_casadi_comes_back_with_readable_numbers() -> None:
    x = ca.SX.sym("x", 2)
    nodes = from_casadi(x, ["a", "b"], [ca.fmax(x[0], 0.1) * ca.pi / 2, ca.sqrt(x[1] ** 2 + 0.3**2) + 0.3])
    assert text_of(nodes[0]) == "pi*max(a, 0.1)/2"
    assert text_of(nodes[1]) == "sqrt(b^2 + 0.09) + 0.3"


def test_a_product_that_casadi_folded_is_seen_again() -> None:
    x = ca.SX.sym("x")
    (node,) = from_casadi(x, ["x"], [(x + 0.8) * 0.3 + 0.8**2 + 0.3 * 0.7777777])
    assert (0.8**2 != 0.64 and "0.8^2" in text_of(node)) or "0.64" in text_of(node)
    (node,) = from_casadi(x, ["x"], [ca.sqrt(x * x + 0.8**2) + 0.8 * x])
    assert "0.8^2" in text_of(node)


def test_pi_is_itself() -> None:
    assert parse("pi", {}) is PI
    x = ca.SX.sym("x")
    assert text_of(from_casadi(x, ["x"], [x + ca.pi])[0]) == "x + pi"


def test_what_the_grammar_does_not_have_is_named() -> None:
    x = ca.SX.sym("x")
    inside = ca.if_else(ca.logic_and(x > 0, x < 1), 1, 2)
    for expression in (ca.floor(x), inside, x > 0, ca.asinh(x), ca.constpow(x, 99.5), x + ca.inf):
        with pytest.raises(UnsupportedOperation, match=r"grammar|constant inf"):
            from_casadi(x, ["x"], [expression])


def test_functions_and_powers_of_casadi_come_back() -> None:
    x = ca.SX.sym("x", 2)
    a, b = x[0], x[1]
    told = {
        "exp(a) - log(b)": ca.exp(a) - ca.log(b), "tanh(a)*tan(b)": ca.tanh(a) * ca.tan(b),
        "asin(a) + atan(b)": ca.asin(a) + ca.atan(b), "sinh(a)/cosh(b)": ca.sinh(a) / ca.cosh(b),
        "a^1.5": ca.power(a, 1.5), "a^(1/3)": a ** (1 / 3), "b^-0.5": ca.constpow(b, -0.5), "sqrt(b)": b**0.5,
        "a*a^2": a**3, "exp(b*log(a))": ca.power(a, b), "exp(a*log(2))": ca.power(2, a),
        "log(1 + a) - (exp(b) - 1)": ca.log1p(a) - ca.expm1(b),
        "select(a, b, exp(a), 0)": ca.if_else(a <= b, ca.exp(a), 0),
        "select(a, b, 0, tan(b))": ca.if_else(a <= b, 0, ca.tan(b)),
    }  # fmt: skip
    assert [text_of(n) for n in from_casadi(x, ["a", "b"], list(told.values()))] == list(told)


@pytest.mark.parametrize(
    ("text", "again"),
    [("x^0.5", "x^0.5"), ("x^(3/2)", "x^1.5"), ("x^-1.5", "x^-1.5"), ("x^(-2/6)", "x^(-1/3)"),
     ("-x^(1 - 0.5)", "-x^0.5"), ("x^n", "x^0.7"), ("x^-(n/7)", "x^-0.1"), ("x^(4/2)", "x^2"), ("x^2.0", "x^2")],
)  # fmt: skip
def test_an_exponent_is_any_constant(text: str, again: str) -> None:
    root = parse(text, KNOWN | {"n": number(Fraction("0.7"))})
    assert text_of(root) == again and parse(again, KNOWN) == root


@pytest.mark.parametrize("text", ["x^y", "x^(1/0)", "x^65", "x^(y - y)", "x^pi", "x^0." + "1" * 31, "x^0.5^2", "x^"])
def test_what_is_no_exponent_is_told_in_one_line(text: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(text, KNOWN)
    assert "column" in str(caught.value) and "\n" not in str(caught.value)


def test_a_very_long_sum_is_an_error_and_no_crash() -> None:
    with pytest.raises(InputError, match=r"too long|deep"):
        parse(" + ".join(["x"] * 2000), KNOWN)


def test_numbers_are_exact() -> None:
    assert parse("0.1", {}) == number(Fraction(1, 10))


def test_a_long_fraction_is_shown_as_a_decimal() -> None:
    long = Fraction(6084722881095501464954147438592, 42442463276361393525147138291191)
    text = text_of(power(variable("x") - number(long), 2) + number(Fraction(2, 15)))
    assert clipped(text) == "(x - 0.1433640371…)^2 + 2/15"

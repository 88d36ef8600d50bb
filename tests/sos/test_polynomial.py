"""The arithmetic of sparse polynomials agrees with that of numbers at points."""

from fractions import Fraction

from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from surctl.sos import Polynomial, monomials
from surctl.sos.basis import parity_classes

COUNT = 3
NUMBERS = st.fractions(min_value=-4, max_value=4, max_denominator=6)
TERMS = st.dictionaries(st.sampled_from(monomials(range(COUNT), 4)), NUMBERS.filter(bool), max_size=6)
POLYNOMIALS = TERMS.map(Polynomial)
POINTS = st.lists(NUMBERS, min_size=COUNT, max_size=COUNT)


@given(POLYNOMIALS, POLYNOMIALS, POINTS, NUMBERS)
@settings(max_examples=30, deadline=None, phases=[Phase.generate])
def test_sums_and_products_have_the_values_of_numbers(p: Polynomial, q: Polynomial, x, c: Fraction) -> None:
    assert (p + q).value(x) == p.value(x) + q.value(x)
    assert (p - q).value(x) == p.value(x) - q.value(x)
    assert (p * q).value(x) == p.value(x) * q.value(x)
    assert (c - p * c).value(x) == c - c * p.value(x)
    assert (p**2).value(x) == p.value(x) ** 2
    assert all((p - p + q).terms.values()) and (p - p).terms == {}
    assert all(c for r in (p + q, p * q, p - q) for c in r.terms.values())


@given(POLYNOMIALS, POLYNOMIALS, st.integers(0, COUNT - 1))
@settings(max_examples=25, deadline=None, phases=[Phase.generate])
def test_derivatives_follow_the_product_rule(p: Polynomial, q: Polynomial, k: int) -> None:
    assert (p * q).derivative(k) == p.derivative(k) * q + p * q.derivative(k)
    assert all(x.derivative(k) == Polynomial.constant(j == k) for j, x in enumerate(Polynomial.variables(COUNT)))


@given(POLYNOMIALS, POLYNOMIALS, POINTS)
@settings(max_examples=25, deadline=None, phases=[Phase.generate])
def test_a_substituted_polynomial_has_the_value_at_the_substituted_point(p: Polynomial, q: Polynomial, x) -> None:
    moved = p.substituted({0: q, 1: Polynomial.variable(0)})  # both at once
    assert moved.value(x) == p.value([q.value(x), x[0], x[2]])


@given(POLYNOMIALS)
@settings(max_examples=15, deadline=None, phases=[Phase.generate])
def test_monomials_of_one_term_are_in_the_classes_of_their_symmetries(p: Polynomial) -> None:
    """A change of signs that leaves p unchanged multiplies all monomials of a class by the same sign."""
    classes = parity_classes(monomials(range(COUNT), 2), [p])
    assert sorted(m for c in classes for m in c) == sorted(monomials(range(COUNT), 2))
    for bits in range(2**COUNT):
        signs = [-1 if bits >> k & 1 else 1 for k in range(COUNT)]
        if p.substituted({k: s * Polynomial.variable(k) for k, s in enumerate(signs)}) == p:
            assert all(len({Polynomial.monomial(m).value(signs) for m in c}) == 1 for c in classes)

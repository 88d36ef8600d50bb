"""Proofs are exact identities with positive semidefinite matrices, and a false statement has none."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.sos import Certificate, Polynomial, certify, monomials
from surctl.sos.polynomial import joined
from surctl.verification.proving.squares import zeros_of

X, Y, Z = Polynomial.variables(3)
MOTZKIN = X**4 * Y**2 + X**2 * Y**4 + 1 - 3 * X**2 * Y**2
DISK = 1 - X**2 - Y**2


def assert_proves(proof: Certificate | None, target: Polynomial, weights=(), relations=()) -> None:
    """The identity holds once the remainder is added, with matrices whose eigenvalues are not negative."""
    assert proof is not None
    rest, full = target, []
    for block in proof.blocks:
        weight = weights[block.weight] if block.weight >= 0 else Polynomial.constant(1)
        entries, products = list(block.entries), []
        for i, m in enumerate(block.basis):
            for j, n in enumerate(block.basis[: i + 1]):
                products.append((joined(m, n), 1 if i == j else 2))
        for (m, times), c in zip(products, entries, strict=True):
            rest = rest - Polynomial({m: times * c} if c else {}) * weight
        full.append((block, entries, products))
    for h, relation in zip(proof.multipliers, relations, strict=True):
        rest = rest - h * relation
    left = dict(rest.terms)
    for block, entries, products in full:
        for at, (m, times) in enumerate(products if block.weight < 0 else ()):
            entries[at] += Fraction(left.pop(m, 0)) / times
        matrix = np.zeros((len(block.basis), len(block.basis)))
        matrix[np.tril_indices(len(block.basis))] = [float(x) for x in entries]
        lower = np.tril(matrix) + np.tril(matrix, -1).T
        assert np.linalg.eigvalsh(lower)[0] >= 0
    assert not left


TRUE = {
    "a quartic form": (2 * X**4 + 2 * X**3 * Y - X**2 * Y**2 + 5 * Y**4, [], 4),
    "a half plane on the disk": (Fraction(3, 2) - X - Y, [DISK], 2),
    "of order four at 0": ((X**2 - Y**2) ** 2 + X**4 - Fraction(1, 10) * X**6, [DISK], 6),
    "Motzkin above 1/100 on a box": (MOTZKIN + Fraction(1, 100), [4 - X**2, 4 - Y**2], 8),
    "an odd degree on a box": (Fraction(9, 2) - X**2 * Y, [2 - X, 2 + X, 1 - Y, 1 + Y, (1 - Y) * (4 - X**2)], None),
    "long decimals": (Fraction("0.123456789012345678") * X**2 + Fraction("0.9871") * Y**2 - X * Y / 3, [], 2),
}


@pytest.mark.parametrize("name", TRUE)
def test_a_true_statement_is_proved_exactly(name: str) -> None:
    target, weights, degree = TRUE[name]
    assert_proves(certify(target, weights, degree=degree), target, weights)


def test_coefficients_that_no_square_has_are_matched_exactly() -> None:
    """The relation s^2 + d^2 = 2 d has the monomial d, which is in no product of two monomials without 1."""
    s, d = X, Y
    target = Fraction(1, 3) * d + s**2 / 7
    relation = s**2 + d**2 - 2 * d
    assert_proves(certify(target, [], relations=[relation], degree=2), target, [], [relation])


@given(st.integers(1, 4), st.integers(1, 2), st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_random_sums_of_squares_are_proved(count: int, half: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    basis = monomials(range(count), half)
    roots = [
        Polynomial({m: Fraction(c) for m in basis if (c := int(rng.integers(-5, 6)))}) for _ in range(len(basis) + 3)
    ]
    target = sum((r * r for r in roots), Polynomial({})) + sum(
        (Polynomial.monomial(m) ** 2 for m in basis), Polynomial({})
    )
    assert_proves(certify(target), target)


@given(st.integers(1, 3), st.integers(0, 2**32 - 1), st.sampled_from([1e-6, 1e-4, 0.1]))
@settings(max_examples=15, deadline=None)
def test_a_statement_false_by_a_millionth_is_never_proved(count: int, seed: int, gap: float) -> None:
    rng = np.random.default_rng(seed)
    basis = monomials(range(count), 1)
    root = sum((int(rng.integers(-5, 6)) * Polynomial.monomial(m) for m in basis), Polynomial({}))
    bounds = [9 - x**2 for x in Polynomial.variables(count)]
    point = [Fraction(int(rng.integers(-8, 9)), 4) for _ in range(count)]
    target = sum(((x - c) ** 2 for x, c in zip(Polynomial.variables(count), point, strict=True)), Polynomial({}))
    target = target * (root * root + 1) - Fraction(gap)
    assert target.value(point) < 0
    assert certify(target, bounds, degree=target.degree) is None


def test_irrational_zeros_restrict_the_squares() -> None:
    target = (X**2 - 2) ** 2 + X**2 * Y**2 + Y**2
    ends = [(Fraction(-2), Fraction(2))] * 2
    zeros = zeros_of(target, ends, [], scales=[Fraction(1)] * 2)
    assert sorted(zeros) == [pytest.approx((-(2**0.5), 0.0), abs=1e-9), pytest.approx((2**0.5, 0.0), abs=1e-9)]
    assert certify(target) is None  # no matrix of this identity is positive definite
    assert_proves(certify(target, zeros=zeros), target)


def test_no_proof_of_a_false_statement() -> None:
    assert certify(Polynomial({})) is not None
    assert certify(-1 * X**2) is None
    assert certify(X) is None
    assert certify(-1 - X**2) is None

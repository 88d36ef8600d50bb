"""Sums of squares: sparse polynomials, semidefinite programs with polynomial identities, exact certificates."""

from surctl.sos.basis import gram_basis, monomials, parity_classes
from surctl.sos.polynomial import Monomial, Polynomial
from surctl.sos.program import Affine, Program, Solution, Squares

__all__ = [
    "Affine", "Monomial", "Polynomial", "Program", "Solution", "Squares", "gram_basis", "monomials", "parity_classes",
]  # fmt: skip

"""Sums of squares: sparse polynomials, semidefinite programs with polynomial identities, exact certificates."""

from surctl.sos.basis import monomials, parity_classes
from surctl.sos.exact import Certificate, GramBlock, certify, completed, is_semidefinite
from surctl.sos.polynomial import Monomial, Polynomial, quotient
from surctl.sos.program import Affine, Program, Solution, Squares

__all__ = [
    "Affine", "Certificate", "GramBlock", "Monomial", "Polynomial", "Program", "Solution", "Squares", "certify",
    "completed", "is_semidefinite", "monomials", "parity_classes", "quotient",
]  # fmt: skip

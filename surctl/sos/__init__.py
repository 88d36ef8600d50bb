"""Sums of squares: sparse polynomials, semidefinite programs with polynomial identities, exact certificates."""

from surctl.sos.basis import monomials
from surctl.sos.exact import Certificate, certify, completed, is_semidefinite
from surctl.sos.polynomial import Monomial, Polynomial, quotient
from surctl.sos.program import Program, Solution

__all__ = [
    "Certificate", "Monomial", "Polynomial", "Program", "Solution", "certify",
    "completed", "is_semidefinite", "monomials", "quotient",
]  # fmt: skip

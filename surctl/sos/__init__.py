"""Sums of squares: sparse polynomials, exact certificates."""

from surctl.sos.basis import monomials
from surctl.sos.exact import Certificate, certify, completed
from surctl.sos.polynomial import Monomial, Polynomial, quotient

__all__ = [
    "Certificate", "Monomial", "Polynomial", "certify",
    "completed", "monomials", "quotient",
]  # fmt: skip

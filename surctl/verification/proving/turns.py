"""Normal forms with the angles of the checker's normal forms, for proofs by sums of squares."""

from __future__ import annotations

from fractions import Fraction

from surctl.sos.polynomial import Polynomial
from surctl.verification.proving.algebra import Algebra, Ratio, TooLarge
from surctl.verification.proving.polynomial import Monomial, Poly, constant

__all__ = ["MOST_TERMS", "SplitAngles"]

MOST_TERMS = 1500
"""Largest number of terms of a polynomial."""


class SplitAngles(Algebra):
    """Normal forms as in the checker: sine and cosine of a sum are those of its terms; products may be large."""

    def product(self, a: Poly, b: Poly) -> Poly:
        """Return the product a b, simplified by relations between atoms."""
        if len(a) * len(b) > 8 * MOST_TERMS:
            raise TooLarge
        terms = (Polynomial(a) * Polynomial(b)).terms.items()
        total = self._reduced({m: c if isinstance(c, Fraction) else Fraction(c) for m, c in terms})
        if len(total) > MOST_TERMS:
            raise TooLarge
        return total

    def _turned(self, angle: Ratio) -> tuple[Ratio, Ratio]:
        if angle.under:
            return self._leaf_angle(angle)
        total = (Ratio(constant(1)), Ratio({}))
        for monomial, coefficient in angle.over.items():
            total = self._sum_of_turns(total, self._one_turn(monomial, coefficient))
        return total

    def _one_turn(self, monomial: Monomial, coefficient: Fraction) -> tuple[Ratio, Ratio]:
        known = self._known_turn(monomial, coefficient)
        if known is not None:
            return known
        times, size = abs(coefficient.numerator), Fraction(1, coefficient.denominator)
        if times >= 9:
            times, size = 1, abs(coefficient)
        one = total = self._leaf_angle(Ratio({monomial: size}))
        for _ in range(times - 1):
            total = self._sum_of_turns(total, one)
        return total if coefficient > 0 else (total[0], Ratio({m: -c for m, c in total[1].over.items()}))

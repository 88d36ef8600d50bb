"""Convert normal forms to nested expressions (Horner form), whose interval evaluation gives narrow results."""

from __future__ import annotations

from fractions import Fraction

from surctl.verification.formula import Node, number, power, variable
from surctl.verification.formula.node import PI
from surctl.verification.proving.algebra import Algebra, Ratio
from surctl.verification.proving.polynomial import Monomial, Poly

__all__ = ["Written"]


class Written:
    """Converter of the polynomials of one `Algebra` to expressions; every atom is converted only once."""

    def __init__(self, algebra: Algebra) -> None:
        self._algebra = algebra
        self._atoms: dict[int, Node] = {}

    def ratio(self, a: Ratio) -> Node:
        """Return a fraction as an expression."""
        tree = self.poly(a.over)
        for at, exponent in a.under:
            tree = tree / power(self.factor(at), exponent)
        return tree

    def factor(self, at: int) -> Node:
        """Return the denominator factor with index `at` as an expression."""
        return self._algebra.factor_words.get(at) or self.poly(self._algebra.factors[at])

    def poly(self, a: Poly) -> Node:
        """Return a polynomial in nested form.

        The power that most terms share is factored out first; even powers take precedence over odd powers.
        """
        if not a:
            return number(0)
        shared = self._shared(a)
        if len(a) == 1 or shared is None:
            terms = [self._term(m, c) for m, c in sorted(a.items(), key=lambda item: _rank(item[0]), reverse=True)]
            tree = terms[0]
            for term in terms[1:]:
                tree = tree - term.args[0] if term.op == "neg" else tree + term
            return tree
        atom, exponent = shared
        inside: Poly = {}
        outside: Poly = {}
        for m, c in a.items():
            powers = dict(m)
            if powers.get(atom, 0) >= exponent:
                powers[atom] -= exponent
                inside[tuple((k, e) for k, e in sorted(powers.items()) if e)] = c
            else:
                outside[m] = c
        tree = power(self.atom(atom), exponent) * self.poly(inside)
        return tree + self.poly(outside) if outside else tree

    def atom(self, at: int) -> Node:
        """Return the atom with index `at` as an expression."""
        if at not in self._atoms:
            kind, args = self._algebra.atoms[at]
            if at in self._algebra.words:
                self._atoms[at] = self._algebra.words[at]
            elif kind == "var":
                self._atoms[at] = variable(str(args[0]))
            elif kind == "pi":
                self._atoms[at] = PI
            else:
                self._atoms[at] = Node(kind, tuple(self.ratio(a) for a in args if isinstance(a, Ratio)))
        return self._atoms[at]

    def _shared(self, a: Poly) -> tuple[int, int] | None:
        counts: dict[tuple[int, int], int] = {}
        for m in a:
            for atom, exponent in m:
                for e in range(1, exponent + 1):
                    counts[atom, e] = counts.get((atom, e), 0) + 1
        worth = {key: n + (0.5 if key[1] % 2 == 0 else 0.0) for key, n in counts.items() if n >= 2}
        # do not split an even power e + 1 only to share its odd power e
        for (atom, e), n in counts.items():
            if e % 2 and (atom, e) in worth and counts.get((atom, e + 1), 0) > 0 and counts[atom, e + 1] < n:
                worth[atom, e] -= 0.75
        return max(worth, key=lambda key: (worth[key], key)) if worth else None

    def _term(self, m: Monomial, c: Fraction) -> Node:
        factors = [power(self.atom(k), e) for k, e in m]
        size = abs(c)
        if size != 1 or not factors:
            factors.insert(0, number(size))
        tree = factors[0]
        for factor in factors[1:]:
            tree = tree * factor
        return -tree if c < 0 else tree


def _rank(m: Monomial) -> tuple[int, Monomial]:
    return sum(e for _, e in m), m

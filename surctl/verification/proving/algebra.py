"""Exact normal forms of expressions, in which equal terms cancel as in a calculation by hand.

The normal form of an expression is a fraction; its numerator and its denominators are polynomials in atoms. Atoms are
variables, π, square roots, sines and cosines of arguments without inverse functions, the inverse functions atan2 and
acos, and all other functions. The rewriting rules are sqrt(p)² = p, sin² = 1 − cos², the addition theorems, and the
sine and cosine of atan2 and acos. A normal form may be defined on a larger domain than the original expression; whoever
uses the normal form must prove separately that the original expression is defined.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import isqrt

from surctl.sos.polynomial import Monomial, Polynomial
from surctl.verification.formula import Node, number, ordered, power, variable
from surctl.verification.formula.node import PI

MOST_TERMS = 1500
"""Largest number of terms of a polynomial; its variables are the atoms of `Algebra`, by index."""

_MOST_EXPONENT = 4096


class TooLarge(Exception):
    """Error: a polynomial has too many terms, or an operation has no normal form."""


def leading(a: Polynomial) -> tuple[Monomial, Fraction]:
    """Return the leading monomial and its coefficient, in a fixed order of monomials."""
    first = max(a.terms, key=_rank)
    return first, a.terms[first]


@dataclass(frozen=True)
class Ratio:
    """A fraction: the polynomial `over`, divided by a product of powers of factors.

    `under` holds the pairs (index of the factor in `Algebra.factors`, exponent).
    """

    over: Polynomial
    under: tuple[tuple[int, int], ...] = ()


class Algebra:
    """Arithmetic of normal forms, with the atoms and denominators collected so far.

    Attributes:
        atoms: list of atoms; an atom is its kind and, if it is a function, its arguments.
        factors: the denominator polynomials, each with leading coefficient 1.
        positive: indices of the factors that a rewriting assumed to be positive.
        words: mapping from the index of an atom to its original expression, which gives narrower intervals than the
            expression multiplied out.
        factor_words: mapping from the index of a factor to its original expression.

    Args:
        split: whether sine and cosine of a sum are those of its terms, as in the checker.
    """

    def __init__(self, *, split: bool = False) -> None:
        self._split = split
        self.atoms: list[tuple[str, tuple[Ratio | str, ...]]] = []
        self.factors: list[Polynomial] = []
        self.positive: set[int] = set()
        self.words: dict[int, Node] = {}
        self.factor_words: dict[int, Node] = {}
        self._atom_at: dict[Hashable, int] = {}
        self._factor_at: dict[Hashable, int] = {}
        self._known: dict[Node, Ratio] = {}

    # ---- from expressions

    def of(self, root: Node) -> Ratio:
        """Return the normal form of an expression without min, max, abs and select.

        Raises:
            TooLarge: the normal form has too many terms, or an operation has no normal form.
        """
        for node in ordered(root):
            if node not in self._known:
                self._known[node] = self._apply(node, [self._known[a] for a in node.args])
        return self._known[root]

    def _apply(self, node: Node, args: list[Ratio]) -> Ratio:
        match node.op:
            case "num":
                return Ratio(Polynomial.constant(node.value))
            case "pi":
                return Ratio(Polynomial.variable(self._atom("pi")))
            case "var":
                return Ratio(Polynomial.variable(self._atom("var", node.name)))
            case "add" | "sub":
                return self.plus(args[0], args[1], 1 if node.op == "add" else -1)
            case "mul":
                return self.times(args[0], args[1])
            case "div":
                return self.times(args[0], self.inverse(args[1], words=node.args[1]))
            case "neg":
                return Ratio(-args[0].over, args[0].under)
            case "pow":
                return self._power(args[0], node.value.numerator, node.args[0])
            case "sqrt":
                return self.root(args[0], words=node.args[0])
            case "sin" | "cos":
                return self._turned(args[0])[node.op == "sin"]
            case "atan":
                return self._unreduced(Node("atan2", (*node.args, number(1))), [*args, Ratio(Polynomial.constant(1))])
            case "atan2" | "acos":
                return self._unreduced(node, args)
            case "exp" | "log" | "tan" | "tanh" | "asin" | "sinh" | "cosh":
                return self._unreduced(node, args)
            case "powr":
                return self._unreduced(node, [*args, str(node.value)])
        raise TooLarge

    def _unreduced(self, node: Node, args: Sequence[Ratio | str]) -> Ratio:
        # an atom without rewriting rules of its own
        at = self._atom(node.op, *args)
        self.words.setdefault(at, node)
        return Ratio(Polynomial.variable(at))

    # ---- arithmetic

    def plus(self, a: Ratio, b: Ratio, factor: int = 1) -> Ratio:
        """Return a + b, or a − b for a negative factor."""
        under = dict(a.under)
        for at, exponent in b.under:
            under[at] = max(under.get(at, 0), exponent)
        first, second = self._over(a, under), self._over(b, under)
        return self._lowest(first + second if factor > 0 else first - second, under)

    def times(self, a: Ratio, b: Ratio) -> Ratio:
        """Return the product a b."""
        under = dict(a.under)
        for at, exponent in b.under:
            under[at] = under.get(at, 0) + exponent
        return self._lowest(self.product(a.over, b.over), under)

    def inverse(self, a: Ratio, *, words: Node | None = None) -> Ratio:
        """Return 1 / a; the numerator of a becomes a factor of the denominator.

        `words` is the original expression of a.
        """
        if not a.over:
            raise TooLarge
        monomial, coefficient = leading(a.over)
        over = Polynomial.constant(1 / coefficient)
        for at, exponent in a.under:
            for _ in range(exponent):
                over = self.product(over, self.factors[at])
        if len(a.over.terms) == 1:
            under = {self._factor(Polynomial.variable(atom)): exponent for atom, exponent in monomial}
        else:
            at = self._factor(a.over / coefficient)
            under = {at: 1}
            if words is not None and not a.under:
                self.factor_words.setdefault(at, words if coefficient == 1 else number(1 / coefficient) * words)
        return self._lowest(over, under)

    def product(self, a: Polynomial, b: Polynomial) -> Polynomial:
        """Return the product a b, simplified by relations between atoms such as sin² = 1 − cos²."""
        if len(a.terms) * len(b.terms) > 8 * MOST_TERMS:
            raise TooLarge
        total = self.reduced(a * b)
        if len(total.terms) > MOST_TERMS:
            raise TooLarge
        return total

    def root(self, a: Ratio, *, words: Node | None = None) -> Ratio:
        """Return √a; the denominators of a are assumed to be positive. `words` is the original expression of a."""
        if not a.over:
            return a
        over, under = a.over, {at: (exponent + 1) // 2 for at, exponent in a.under}
        for at, exponent in a.under:
            self.positive.add(at)
            if exponent % 2:
                over = self.product(over, self.factors[at])
        _, coefficient = leading(over)
        content = _square_root(abs(coefficient))
        over = over / content**2
        if over == Polynomial.constant(1):
            return self._lowest(Polynomial.constant(content), under)
        at = self._atom("sqrt", Ratio(over))
        root = Polynomial.variable(at)
        if words is not None and not a.under:
            inside = words if content == 1 else number(1 / content**2) * words
            self.words.setdefault(at, Node("sqrt", (inside,)))
        return self._lowest(root * content, under)

    def _power(self, a: Ratio, exponent: int, words: Node) -> Ratio:
        if exponent < 0:
            return self._power(self.inverse(a, words=words), -exponent, words)
        if not exponent:
            return Ratio(Polynomial.constant(1))
        if exponent * max((e for m in a.over.terms for _, e in m), default=1) > _MOST_EXPONENT:
            raise TooLarge  # the work grows with the exponent
        result = a
        for _ in range(exponent - 1):
            result = self.times(result, a)
        return result

    def _over(self, a: Ratio, under: Mapping[int, int]) -> Polynomial:
        """Return the numerator of the fraction a after expansion to the denominator `under`, a multiple of its own."""
        own, over = dict(a.under), a.over
        for at, exponent in under.items():
            for _ in range(exponent - own.get(at, 0)):
                over = self.product(over, self.factors[at])
        return over

    def _lowest(self, over: Polynomial, under: Mapping[int, int]) -> Ratio:
        """Cancel the powers of single atoms that numerator and denominator have in common; return the fraction."""
        left = {}
        for at, exponent in under.items():
            factor = self.factors[at]
            (atom, _), *more = leading(factor)[0]
            alone = len(factor.terms) == 1 and not more
            while alone and exponent and over and all(atom in dict(m) for m in over.terms):
                terms = {tuple((k, e - (k == atom)) for k, e in m if e > (k == atom)): c for m, c in over.terms.items()}
                over, exponent = Polynomial(terms), exponent - 1
            left[at] = exponent
        return Ratio(over, tuple(sorted((at, e) for at, e in left.items() if e)) if over else ())

    def reduced(self, a: Polynomial) -> Polynomial:
        """Replace sqrt(p)² by p and sin² by 1 − cos² in a polynomial until neither occurs; return the polynomial."""

        def squared(monomial: Monomial) -> int | None:
            return next((k for k, e in monomial if e >= 2 and self.atoms[k][0] in ("sqrt", "sin")), None)

        while high := {m: k for m in a.terms if (k := squared(m)) is not None}:
            total = Polynomial({m: c for m, c in a.terms.items() if m not in high})
            for monomial, square in high.items():
                kind, args = self.atoms[square]
                assert isinstance(args[0], Ratio)
                by = args[0].over if kind == "sqrt" else 1 - Polynomial.variable(self._atom("cos", args[0])) ** 2
                rest = tuple((k, e - 2 * (k == square)) for k, e in monomial if e > 2 * (k == square))
                total = total + Polynomial({rest: a.terms[monomial]}) * by
            a = total
        return a

    # ---- angles

    def _turned(self, angle: Ratio) -> tuple[Ratio, Ratio]:
        """Return (cos, sin) of an angle; inverse functions and quarter turns in the angle are evaluated exactly."""
        if angle.under:
            return self._leaf_angle(angle)
        rest: dict[Monomial, Fraction] = {}
        total = (Ratio(Polynomial.constant(1)), Ratio(Polynomial({})))
        for monomial, coefficient in angle.over.terms.items():
            if (known := self._known_turn(monomial, coefficient)) is None and self._split:
                known = self._one_turn(monomial, coefficient)
            if known is None:
                rest[monomial] = coefficient
            else:
                total = self._sum_of_turns(total, known)
        return self._sum_of_turns(total, self._leaf_angle(Ratio(Polynomial(rest)))) if rest else total

    def _known_turn(self, monomial: Monomial, coefficient: Fraction) -> tuple[Ratio, Ratio] | None:
        if len(monomial) != 1 or monomial[0][1] != 1:
            return None
        kind, args = self.atoms[monomial[0][0]]
        if kind == "pi" and coefficient.denominator <= 2:
            quarter = int(2 * coefficient) % 4
            cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
            return Ratio(Polynomial.constant(cosine)), Ratio(Polynomial.constant(sine))
        if kind not in ("atan2", "acos") or coefficient.denominator != 1 or abs(coefficient) > 4:
            return None
        ratios, inside = [a for a in args if isinstance(a, Ratio)], self.words[monomial[0][0]].args
        if kind == "atan2":
            y, x = ratios
            words = power(inside[1], 2) + power(inside[0], 2)
            length = self.inverse(self.root(self.plus(self.times(x, x), self.times(y, y)), words=words))
            one = (self.times(x, length), self.times(y, length))
        else:
            square = self.times(ratios[0], ratios[0])
            words = number(1) - power(inside[0], 2)
            one = (ratios[0], self.root(self.plus(Ratio(Polynomial.constant(1)), square, -1), words=words))
        if coefficient < 0:
            one = (one[0], Ratio(-one[1].over, one[1].under))
        total = one
        for _ in range(abs(int(coefficient)) - 1):
            total = self._sum_of_turns(total, one)
        return total

    def _sum_of_turns(self, a: tuple[Ratio, Ratio], b: tuple[Ratio, Ratio]) -> tuple[Ratio, Ratio]:
        cosine = self.plus(self.times(a[0], b[0]), self.times(a[1], b[1]), -1)
        return cosine, self.plus(self.times(a[1], b[0]), self.times(a[0], b[1]))

    def _one_turn(self, monomial: Monomial, coefficient: Fraction) -> tuple[Ratio, Ratio]:
        times, size = abs(coefficient.numerator), Fraction(1, coefficient.denominator)
        if times >= 9:
            times, size = 1, abs(coefficient)
        one = total = self._leaf_angle(Ratio(Polynomial({monomial: size})))
        for _ in range(times - 1):
            total = self._sum_of_turns(total, one)
        return total if coefficient > 0 else (total[0], Ratio(-total[1].over))

    def _leaf_angle(self, angle: Ratio) -> tuple[Ratio, Ratio]:
        sign = 1 if leading(angle.over)[1] > 0 else -1
        upright = Ratio(sign * angle.over, angle.under)
        sine = sign * Polynomial.variable(self._atom("sin", upright))
        return Ratio(Polynomial.variable(self._atom("cos", upright))), Ratio(sine)

    # ---- tables

    def _atom(self, kind: str, *args: Ratio | str) -> int:
        key = (kind, *((frozenset(a.over.terms.items()), a.under) if isinstance(a, Ratio) else a for a in args))
        if key not in self._atom_at:
            self._atom_at[key] = len(self.atoms)
            self.atoms.append((kind, args))
        return self._atom_at[key]

    def _factor(self, poly: Polynomial) -> int:
        key = frozenset(poly.terms.items())
        if key not in self._factor_at:
            self._factor_at[key] = len(self.factors)
            self.factors.append(poly)
        return self._factor_at[key]


def _square_root(value: Fraction) -> Fraction:
    over, under = isqrt(value.numerator), isqrt(value.denominator)
    return (
        Fraction(over, under) if over * over == value.numerator and under * under == value.denominator else Fraction(1)
    )


# Convert normal forms to nested expressions (Horner form), whose interval evaluation gives narrow results


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

    def poly(self, a: Polynomial) -> Node:
        """Return a polynomial in nested form.

        The power that most terms share is factored out first; even powers take precedence over odd powers.
        """
        if not a:
            return number(0)
        shared = self._shared(a)
        if len(a.terms) == 1 or shared is None:
            terms = [self._term(m, a.terms[m]) for m in sorted(a.terms, key=_rank, reverse=True)]
            tree = terms[0]
            for term in terms[1:]:
                tree = tree - term.args[0] if term.op == "neg" else tree + term
            return tree
        atom, exponent = shared
        inside: dict[Monomial, Fraction] = {}
        outside: dict[Monomial, Fraction] = {}
        for m, c in a.terms.items():
            powers = dict(m)
            if powers.get(atom, 0) >= exponent:
                powers[atom] -= exponent
                inside[tuple((k, e) for k, e in sorted(powers.items()) if e)] = c
            else:
                outside[m] = c
        tree = power(self.atom(atom), exponent) * self.poly(Polynomial(inside))
        return tree + self.poly(Polynomial(outside)) if outside else tree

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

    def _shared(self, a: Polynomial) -> tuple[int, int] | None:
        counts: dict[tuple[int, int], int] = {}
        for m in a.terms:
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

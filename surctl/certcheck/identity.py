"""Proof of exact identities: two expressions are equal if the numerator of their difference is the polynomial 0.

If an angle is a sum, its cosine and sine are the real and imaginary parts of a product of unit complex numbers, one for
each term of the sum. The other rewriting rules are sqrt(p)² = p, sin² = 1 − cos², and the sine and cosine of atan2 and
acos as ratios of sides of a right triangle. Every elementary function of an argument (`surctl.certcheck.elementary`) is
one indeterminate. An identity holds wherever both sides are defined and the polynomials in `Exact.assumed` are
positive.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import isqrt, lcm

from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import ELEMENTARY
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.patience import Account, afford, go_on

__all__ = ["Exact", "Fraction_"]

Term = tuple[tuple[str, int], ...]
Sum = dict[Term, Fraction]
Fraction_ = tuple[Sum, Sum]
"""A fraction of polynomials: (numerator, denominator)."""

_MOST = 3000  # most terms of a polynomial
_SHARED = 1_000_000  # largest size of normal forms that another proof goes on with [bytes]
_TERM, _POWER = 280, 80  # size of a term and its coefficient, and of each power of it [bytes]
_BITS = 4096  # most bits of a coefficient's numerator or denominator
_LONGEST = 20_000  # most characters of an atom's name
_TOO_LARGE = "an identity is too large to be checked"
_SMALL = 64  # products of terms that need no account
_UNIT = Fraction(1)
_ONE: Sum = {(): _UNIT}


class Exact:
    """Expressions of one table as fractions of polynomials in the variables, roots, sines and cosines.

    Attributes:
        assumed: polynomials that must be positive for the identities to hold.
        entry_of: for each indeterminate that stands for an elementary function, the position of its first expression in
            the table.
    """

    def __init__(self, expressions: ExpressionTable) -> None:
        self.expressions = expressions
        self._values: dict[int, Fraction_] = {}
        self._account = Account()
        self._inside: dict[str, Sum] = {}  # radicand of each root, by its atom
        self._angles: dict[str, tuple[Fraction_, Fraction_]] = {}  # cosine and sine of each atan2 and acos
        self.assumed: list[Sum] = []
        self.entry_of: dict[str, int] = {}

    @property
    def reusable(self) -> bool:
        """Whether the normal forms so far assume nothing, and are few enough for another proof to go on with them."""
        return not self.assumed and self._account.held <= _SHARED

    def equal(self, a: int, b: Callable[[Exact], Fraction_]) -> bool:
        """Return whether the expression at table position `a` equals the fraction that the function `b` returns."""
        p, q = self.of(a), b(self)
        if p == q:
            return True
        return not self.plus(self.mul(p[0], q[1]), self.mul(q[0], p[1]), -1)

    def under_root(self, atom: str) -> Sum:
        """Return the polynomial under the root that the indeterminate `atom` denotes."""
        return self._inside[atom]

    # ---- polynomials

    @staticmethod
    def plus(a: Sum, b: Sum, factor: Fraction | int = 1) -> Sum:
        """Return the polynomial a + factor b."""
        out = dict(a)
        for term, number in b.items():
            number = number if factor == 1 else -number if factor == -1 else factor * number
            if term not in out:
                out[term] = number
                continue
            out[term] += number
            if not out[term]:
                del out[term]
            else:
                _check_size(out[term])
        return out

    def mul(self, a: Sum, b: Sum) -> Sum:
        """Return the polynomial a b, reduced so that roots and sines have powers of at most 1."""
        if a is _ONE or b is _ONE:
            return b if a is _ONE else a
        if len(a) * len(b) > _MOST * 4:
            raise Rejected(_TOO_LARGE)
        out = self._reduced(_product(a, b))
        if len(out) > _MOST:
            raise Rejected(_TOO_LARGE)
        for number in out.values():
            _check_size(number)
        return out

    def _reduced(self, a: Sum) -> Sum:
        """Return the polynomial with powers of at most 1 of roots and sines."""
        while squared := {k for t in a for k, e in t if e >= 2 and k[:5] in ("sqrt{", "sine{")}:
            # the name of a root contains those of the roots inside, which its square may raise
            atom = max(squared, key=lambda k: (len(k), k))
            by = self._inside[atom] if atom[:5] == "sqrt{" else self._sine_square(atom)
            halves: dict[int, Sum] = {}
            for term, number in a.items():
                half, odd = divmod(dict(term).get(atom, 0), 2)
                rest = tuple((k, odd if k == atom else e) for k, e in term if k != atom or odd)
                halves.setdefault(half, {})[rest] = number
            a = {}
            for half in range(max(halves), -1, -1):
                a = self.plus(_product(a, by), halves.get(half, {}))
        return a

    @staticmethod
    def _sine_square(atom: str) -> Sum:
        return {(): Fraction(1), (("cosi{" + atom[5:], 2),): Fraction(-1)}

    # ---- fractions

    def add(self, a: Fraction_, b: Fraction_, factor: int = 1) -> Fraction_:
        """Return the fraction a + factor b."""
        if a[1] == b[1]:
            return self.plus(a[0], b[0], factor), a[1]
        return self.plus(self.mul(a[0], b[1]), self.mul(b[0], a[1]), factor), self.mul(a[1], b[1])

    def times(self, a: Fraction_, b: Fraction_) -> Fraction_:
        """Return the fraction a b."""
        return self.mul(a[0], b[0]), self.mul(a[1], b[1])

    def of(self, root: int) -> Fraction_:
        """Return the expression at position `root` of the table as a fraction."""
        for at in self.expressions.needed([root]):
            if at not in self._values:
                go_on()
                self._values[at] = self._step(at)
                self._account.hold(sum(_size(poly) for poly in self._values[at] if poly is not _ONE))
        return self._values[root]

    def _step(self, at: int) -> Fraction_:
        entry = self.expressions.entries[at]
        args = [self._values[a] for a in entry.args]
        match entry.op:
            case "num":
                return ({(): entry.value} if entry.value else {}), _ONE
            case "pi":
                return {(("pi", 1),): _UNIT}, _ONE
            case "var":
                return {((f"v{entry.value.numerator}", 1),): _UNIT}, _ONE
            case "add":
                return self.add(args[0], args[1])
            case "sub":
                return self.add(args[0], args[1], -1)
            case "neg":
                return self.plus({}, args[0][0], -1), args[0][1]
            case "mul":
                return self.times(args[0], args[1])
            case "div":
                return self.times(args[0], self._flipped(args[1]))
            case "pow":
                base = args[0] if entry.value >= 0 else self._flipped(args[0])
                out: Fraction_ = (_ONE, _ONE)
                for _ in range(abs(entry.value.numerator)):
                    out = self.times(out, base)
                return out
            case "sqrt":
                return self._root(args[0])
            case "cos":
                return self._circle(args[0])[0]
            case "sin":
                return self._circle(args[0])[1]
            case "atan":
                return self._inverse_angle("atan2", args[0], (_ONE, _ONE))
            case "atan2" | "acos":
                return self._inverse_angle(entry.op, *args)
            case "min" | "max" if set((apart := self.add(args[0], args[1], -1))[0]) <= {()} == set(apart[1]):
                return args[(apart[0].get((), 0) / apart[1][()] > 0) is (entry.op == "min")]
            case _ if entry.op in ELEMENTARY:
                atom = f"{entry.op}{entry.value}{{{self._spelled(args[0][0])} over {self._spelled(args[0][1])}}}"
                self.entry_of.setdefault(atom, at)
                return {((atom, 1),): Fraction(1)}, _ONE
            case _:  # abs, max, min or select without a choice is a new unknown
                return {((f"b{at}", 1),): Fraction(1)}, _ONE

    @staticmethod
    def _flipped(a: Fraction_) -> Fraction_:
        if not a[0]:
            raise Rejected("a division by an expression that is identically 0")
        return a[1], a[0]

    def _root(self, a: Fraction_) -> Fraction_:
        """Return √(p/q) as √(p q)/q for q > 0; square factors of the coefficients are moved out of the root."""
        if not a[0]:
            return a
        inside = self.mul(a[0], a[1])
        if set(a[1]) != {()}:
            self.assumed.append(a[1])
        elif a[1][()] < 0:
            raise Rejected("a root of a fraction with a negative denominator")
        lead = abs(inside[max(inside, key=lambda t: (sum(e for _, e in t), t))])
        p, q = isqrt(lead.numerator), isqrt(lead.denominator)
        scale = Fraction(p, q) if p * p == lead.numerator and q * q == lead.denominator else Fraction(1)
        inside = {t: x / scale**2 for t, x in inside.items()}
        if inside == _ONE:
            return {(): scale}, a[1]
        atom = "sqrt{" + self._spelled(inside) + "}"
        self._inside[atom] = inside
        return {((atom, 1),): scale}, a[1]

    # ---- angles

    def _inverse_angle(self, op: str, *args: Fraction_) -> Fraction_:
        atom = op + "{" + ";".join(self._spelled(a[0]) + " over " + self._spelled(a[1]) for a in args) + "}"
        if atom not in self._angles:
            if op == "acos":
                square = self.times(args[0], args[0])
                self._angles[atom] = args[0], self._root(self.add((_ONE, _ONE), square, -1))
            else:
                y, x = args
                length = self._root(self.add(self.times(x, x), self.times(y, y)))
                flipped = self._flipped(length)
                self._angles[atom] = self.times(x, flipped), self.times(y, flipped)
        return {((atom, 1),): Fraction(1)}, _ONE

    def _circle(self, angle: Fraction_) -> tuple[Fraction_, Fraction_]:
        """Return (cos, sin) of an angle as the product of the unit complex numbers of its terms."""
        over, under = angle
        if set(under) != {()}:
            return self._unit(self._spelled(over) + " over " + self._spelled(under), 1)
        total: tuple[Fraction_, Fraction_] = ((_ONE, _ONE), ({}, _ONE))
        for term, number in over.items():
            total = self._turned(total, self._one_term(term, number / under[()]))
        return total

    def _one_term(self, term: Term, number: Fraction) -> tuple[Fraction_, Fraction_]:
        if term == (("pi", 1),) and lcm(number.denominator, 2) == 2:
            cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[int(2 * number) % 4]
            return ({(): Fraction(cosine)} if cosine else {}, _ONE), ({(): Fraction(sine)} if sine else {}, _ONE)
        times = abs(number.numerator)
        if len(term) == 1 and term[0][1] == 1 and term[0][0] in self._angles and number.denominator == 1 and times < 9:
            one = self._angles[term[0][0]]
        elif times < 9:
            one, times = self._unit(self._spelled({term: Fraction(1, number.denominator)}), 1), times
        else:
            one, times = self._unit(self._spelled({term: abs(number)}), 1), 1
        total = one
        for _ in range(times - 1):
            total = self._turned(total, one)
        return (total[0], (self.plus({}, total[1][0], -1), total[1][1])) if number < 0 else total

    def _spelled(self, a: Sum) -> str:
        # equal polynomials have equal texts
        text = "+".join(f"{x}" + "".join(f"*{k}^{e}" for k, e in t) for t, x in sorted(a.items()))
        if len(text) > _LONGEST:
            raise Rejected(_TOO_LARGE)
        self._account.hold(2 * len(text))  # the names of one or two atoms
        return text

    @staticmethod
    def _unit(key: str, power: int) -> tuple[Fraction_, Fraction_]:
        cosine, sine = "cosi{" + key + "}", "sine{" + key + "}"
        return ({((cosine, power),): Fraction(1)}, _ONE), ({((sine, power),): Fraction(1)}, _ONE)

    def _turned(self, a: tuple[Fraction_, Fraction_], b: tuple[Fraction_, Fraction_]) -> tuple[Fraction_, Fraction_]:
        cosine = self.add(self.times(a[0], b[0]), self.times(a[1], b[1]), -1)
        return cosine, self.add(self.times(a[1], b[0]), self.times(a[0], b[1]))


def _product(a: Sum, b: Sum) -> Sum:
    """Return a b without reduction."""
    out: Sum = {}
    if len(a) * len(b) > _SMALL:
        go_on()
        afford(_TERM * min(len(a) * len(b), 4 * _MOST) + (len(b) * _bits(a) + len(a) * _bits(b)) / 8)
    for k, (s, x) in enumerate(a.items()):
        if k % 16 == 0:
            go_on()
        if len(out) > 4 * _MOST:
            raise Rejected(_TOO_LARGE)
        for t, y in b.items():
            if not s or not t:
                term = s or t
            else:
                powers = dict(s)
                for atom, e in t:
                    powers[atom] = powers.get(atom, 0) + e
                term = tuple(sorted(powers.items()))
            product = y if x is _UNIT else x if y is _UNIT else x * y
            out[term] = out[term] + product if term in out else product
    return {t: x for t, x in out.items() if x}


def _bits(a: Sum) -> int:
    return sum(x.numerator.bit_length() + x.denominator.bit_length() for x in a.values())


def _size(a: Sum) -> int:
    """Return the memory of a polynomial [bytes]."""
    return len(a) * _TERM + _POWER * sum(map(len, a)) + _bits(a) // 8


def _check_size(number: Fraction) -> None:
    if number.numerator.bit_length() > _BITS or number.denominator.bit_length() > _BITS:
        raise Rejected(_TOO_LARGE)

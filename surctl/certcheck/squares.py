"""Check of a proof by sums of squares that a polynomial is not negative where other polynomials are not negative.

The entry `squares` of a case proves target = slack · Π denominators − numerator ≥ 0 by the identity

    target = Σ σ · (product of factors) + Σ h · relation,

in which every σ = z' G z has a positive semidefinite matrix G. The entry has these keys:

- `symbols`: texts of the indeterminates of all polynomials. Each is a number times an atom plus a number; an atom is a
  variable, π, or the value of a function;
- `facts`: inequalities about functions of one variable t. A fact has the keys `of`, the text that replaces t, and
  `factors`, one or two texts in t whose product is not negative where t has the values of `of` on the box;
- `blocks`: the sums of squares. A block has the keys `factors` (names such as "c0" for minus constraint 0, "l0" and
  "h0" for variable 0 minus its lower bound and its upper bound minus the variable, "f0" for the product of fact 0),
  `monomials` (exponents of the symbols), `over` and `gram`: the lower triangle of G times the integer `over`, row by
  row; an entry is an integer, or a list of two integers [p, q] for the entry p / q itself;
- `relations`: multipliers h of sin² + cos² − 1 or root² − radicand: `symbol` (index of the sine or root), `monomials`
  and `factors` (list of [p, q]).

The part of the target that the blocks and relations leave is added to the blocks without factors: for each monomial, to
the first entry whose two monomials have it as product. The identity then holds by construction, and only the matrices
have to be tested.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import reduce
from math import gcd, lcm
from typing import Any

from surctl.certcheck.definite import is_semidefinite
from surctl.certcheck.document import Rejected, listed, record
from surctl.certcheck.enclosure import enclose, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.identity import Exact, Sum
from surctl.certcheck.patience import Account, afford, go_on
from surctl.certcheck.series import same_sign

__all__ = ["Claimed", "check_squares"]

_SYMBOLS, _FACTS, _BLOCKS, _LARGEST, _FACTORS = 40, 60, 600, 130, 4
_EXPONENT, _BITS, _DIGITS = 60, 6000, 4
_SIZE = 360  # memory of a term, without the digits of its coefficient [bytes]
_FIELD = 12  # bits of one exponent in a packed monomial; sums of exponents stay below 2^12

Packed = dict[int, Fraction]
"""A polynomial in the symbols: a monomial is one integer with a field of bits for each exponent."""


@dataclass(frozen=True)
class Claimed:
    """What a case has to prove: numerator ≤ slack · Π denominators on the box where no constraint is positive.

    Attributes:
        expressions: table of all expressions.
        numerator: position of the numerator in the table.
        denominators: positions of the denominators.
        constraints: positions of the constraints.
        box: lower and upper bound of each variable.
        slack: the slack.
        normal: normal forms of expressions of the table, which assume nothing.
    """

    expressions: ExpressionTable
    numerator: int
    denominators: Sequence[int]
    constraints: Sequence[int]
    box: Sequence[tuple[float, float]]
    slack: float
    normal: Exact


def check_squares(entry: Mapping[str, Any], claimed: Claimed) -> None:
    """Raise Rejected unless the entry `squares` proves the inequality; it must be defined on the whole box."""
    entry = record(entry, {"symbols", "facts", "blocks", "relations"}, "squares")
    ring = _Ring(claimed, entry)
    rest = ring.target()
    plain: list[_Block] = []
    blocks = listed(entry["blocks"])
    if len(blocks) > _BLOCKS:
        raise Rejected("there are too many sums of squares")
    for each in blocks:
        go_on()
        block = _Block(each, len(ring.symbols))
        names = listed(each["factors"])
        if len(names) > _FACTORS:
            raise Rejected(f"a sum of squares has {len(names)} factors beside it; the limit is {_FACTORS}")
        part = block.polynomial()
        if names:
            part = _product(part, reduce(_product, map(ring.factor, names)))
        rest = _less(rest, part)
        if names:
            block.check()
        else:
            plain.append(block)
    for each in listed(entry["relations"]):
        rest = _less(rest, _product(*ring.relation(each)))
    _absorbed(rest, plain)
    for block in plain:
        block.check()


class _Ring:
    """Polynomials in the symbols of a proof."""

    def __init__(self, claimed: Claimed, entry: Mapping[str, Any]) -> None:
        self._claimed, self._exact = claimed, claimed.normal
        self._root = [span(*ends) for ends in claimed.box]
        self.symbols = listed(entry["symbols"])
        self._facts = listed(entry["facts"])
        if len(self.symbols) > _SYMBOLS or len(self._facts) > _FACTS:
            raise Rejected(
                f"the proof has {len(self.symbols)} variables and {len(self._facts)} inequalities that it may use; "
                f"the limits are {_SYMBOLS} and {_FACTS}"
            )
        self._atoms: dict[str, tuple[int, Fraction, Fraction]] = {}  # atom = factor · symbol + offset
        positions = [claimed.expressions.read(text) for text in self.symbols]
        if not claimed.expressions.total(positions):  # a symbol that is not a real number proves nothing
            enclose(claimed.expressions, positions, self._root)
        for at, position in enumerate(positions):
            self._define(at, self._sum(position))
        self._known: dict[str, Packed] = {}
        self._account = Account()

    def _define(self, at: int, poly: Sum) -> None:
        offset = poly.get((), Fraction(0))
        named = [(term, c) for term, c in poly.items() if term]
        if len(named) != 1 or len(named[0][0]) != 1 or named[0][0][0][1] != 1 or named[0][0][0][0] in self._atoms:
            raise Rejected(
                f"symbol {at} does not have the form a s + b with a variable or function s that no earlier symbol has"
            )
        (((atom, _),), scale) = named[0]
        self._atoms[atom] = at, 1 / scale, -offset / scale

    def _sum(self, position: int) -> Sum:
        over, under = self._exact.of(position)
        if set(under) != {()} or self._exact.assumed:
            raise Rejected("an expression in a sum of squares is not a polynomial")
        whole = under[()]
        return over if whole == 1 else {term: c / whole for term, c in over.items()}

    def packed(self, poly: Sum) -> Packed:
        """Return a polynomial in atoms as a polynomial in the symbols."""
        total: Packed = {}
        for term, c in poly.items():
            go_on()
            product: Packed = {0: c}
            for atom, exponent in term:
                if atom not in self._atoms:
                    raise Rejected("an expression has a variable or function that is not among the symbols")
                if exponent > _EXPONENT:
                    raise Rejected("an exponent is too large")
                at, scale, offset = self._atoms[atom]
                one = 1 << (at * _FIELD)
                if not offset:
                    size = scale**exponent
                    product = {m + exponent * one: x if size == 1 else x * size for m, x in product.items()}
                    continue
                for _ in range(exponent):
                    product = _product(product, {one: scale, 0: offset})
            for m, x in product.items():
                total[m] = total[m] + x if m in total else x
        return {m: x for m, x in total.items() if x}

    def target(self) -> Packed:
        """Return slack · Π denominators − numerator."""
        claimed = self._claimed
        total: Packed = {}
        if len(claimed.denominators) > _LARGEST // 10:
            raise Rejected("there are too many denominators for a proof by sums of squares")
        if claimed.slack:
            total = {0: Fraction(repr(claimed.slack))}
            for d in claimed.denominators:
                total = _product(total, self.packed(self._sum(d)))
        return _less(total, self.packed(self._sum(claimed.numerator)))

    def factor(self, name: object) -> Packed:
        """Return a polynomial that is not negative, by its name in a block."""
        if not isinstance(name, str) or not name[1:].isascii() or not name[1:].isdecimal() or len(name) > _DIGITS:
            raise Rejected("a factor has a name that is not c, l, h or f with a number")
        if name not in self._known:
            kind, at = name[0], int(name[1:])
            lists = {"c": self._claimed.constraints, "l": self._claimed.box, "h": self._claimed.box, "f": self._facts}
            if at >= len(lists.get(kind, ())):
                raise Rejected(f"the factor {name!r} does not exist")
            if kind == "c":
                self._known[name] = _less({}, self.packed(self._sum(self._claimed.constraints[at])))
            elif kind == "f":
                self._known[name] = self._fact(self._facts[at])
            else:
                self._known[name] = self._bound(at, lower=kind == "l")
            self._account.hold(_size(self._known[name]))
        return self._known[name]

    def _bound(self, at: int, *, lower: bool) -> Packed:
        """Return the distance of a variable from a bound; the bound contains the double and its decimal."""
        end = self._claimed.box[at][0 if lower else 1]
        both = Fraction(end), Fraction(repr(end))
        if lower:
            return self.packed({((f"v{at}", 1),): Fraction(1), (): -min(both)})
        return self.packed({((f"v{at}", 1),): Fraction(-1), (): max(both)})

    def _fact(self, fact: object) -> Packed:
        """Return the product of a fact's factors, which is not negative."""
        if not isinstance(fact, dict) or set(fact) != {"of", "factors"} or not 1 <= len(listed(fact["factors"])) <= 2:
            raise Rejected("a fact needs the keys 'of' and 'factors', with one or two factors")
        expressions = self._claimed.expressions
        inside = expressions.read(fact["of"])
        own = ExpressionTable(["t"])
        roots = [own.read(text) for text in fact["factors"]]
        if not same_sign(own, roots, enclose(expressions, [inside], self._root)[0]):
            raise Rejected("a fact about a function is not shown")
        moved: list[int] = []
        for e in own.entries:
            put = inside if e.op == "var" else expressions.put(e.op, *(moved[a] for a in e.args), value=e.value)
            moved.append(put)
        total: Packed = {0: Fraction(1)}
        for root in roots:
            total = _product(total, self.packed(self._sum(moved[root])))
        return total

    def relation(self, entry: object) -> tuple[Packed, Packed]:
        """Return a multiplier and a polynomial that is 0."""
        entry = record(entry, {"symbol", "monomials", "factors"}, "a relation")
        atom = next((a for a, (at, _, _) in self._atoms.items() if at == entry["symbol"]), "")
        if atom.startswith("sine{"):
            zero: Sum = {((atom, 2),): Fraction(1), (("cosi{" + atom[5:], 2),): Fraction(1), (): Fraction(-1)}
        elif atom.startswith("sqrt{"):
            zero = Exact.plus({((atom, 2),): Fraction(1)}, self._exact.under_root(atom), -1)
        else:
            raise Rejected("a relation is about a symbol that is neither a sine nor a root")
        monomials, numbers = listed(entry["monomials"]), listed(entry["factors"])
        if len(monomials) != len(numbers):
            raise Rejected("a relation has a wrong number of factors")
        terms = [_monomial(m, len(self.symbols)) for m in monomials]
        if len(set(terms)) < len(terms):
            raise Rejected("a monomial occurs twice")
        multiplier = {m: _fraction(x) for m, x in zip(terms, numbers, strict=True)}
        return multiplier, self.packed(zero)


class _Block:
    """A sum of squares z' G z: its monomials, and the lower triangle of G as integers over one denominator."""

    def __init__(self, entry: object, count: int) -> None:
        entry = record(entry, {"factors", "monomials", "over", "gram"}, "a sum of squares")
        self.monomials = [_monomial(m, count) for m in listed(entry["monomials"])]
        size, numbers = len(self.monomials), listed(entry["gram"])
        if size > _LARGEST:
            raise Rejected(f"a sum of squares has more than {_LARGEST} monomials")
        if len(set(self.monomials)) < size:
            raise Rejected("a monomial occurs twice")
        if len(numbers) != size * (size + 1) // 2:
            raise Rejected("a matrix of a sum of squares has a wrong number of entries")
        self._over, self._numbers = _fraction([1, entry["over"]]).denominator, numbers
        self._added: dict[int, Fraction] = {}  # to entries

    def add(self, at: int, more: Fraction) -> None:
        """Add a number to an entry of the triangle."""
        self._added[at] = more

    def pairs(self) -> Iterator[tuple[int, bool]]:
        """Yield the monomial of each entry and whether the entry is on the diagonal."""
        z = self.monomials
        return ((z[i] + z[j], i == j) for i in range(len(z)) for j in range(i + 1))

    def polynomial(self) -> Packed:
        """Return z' G z."""
        numbers, whole = self._integers()
        total: dict[int, int] = {}
        for (m, diagonal), x in zip(self.pairs(), numbers, strict=True):
            total[m] = total.get(m, 0) + (x if diagonal else 2 * x)
        return {m: Fraction(x, whole) for m, x in total.items() if x}

    def check(self) -> None:
        """Raise Rejected unless G is positive semidefinite."""
        go_on()
        size, numbers = len(self.monomials), iter(self._integers()[0])
        matrix = [[0] * size for _ in range(size)]
        for i in range(size):
            for j in range(i + 1):
                matrix[i][j] = matrix[j][i] = next(numbers)
        if not is_semidefinite(matrix):
            raise Rejected("the matrix of a sum of squares is not shown to be positive semidefinite")

    def _integers(self) -> tuple[list[int], int]:
        """Return the entries as integers over their least common denominator, and the denominator.

        Only the numbers of the document are stored: they need less memory than fractions.
        """
        over = self._over
        others = {at: _fraction(x) for at, x in enumerate(self._numbers) if not isinstance(x, int)}
        for at, more in self._added.items():
            others[at] = more + (others[at] if at in others else Fraction(self._numbers[at], over))
        whole = lcm(over, _common(others.values()))
        afford(len(self._numbers) * (_SIZE + (whole.bit_length() + _BITS) // 8))
        scale = whole // over
        numbers = [
            x.numerator * (whole // x.denominator) if x is not None else scale * _integer(y)
            for x, y in ((others.get(at), y) for at, y in enumerate(self._numbers))
        ]
        shared = gcd(whole, *numbers)
        return (numbers if shared == 1 else [x // shared for x in numbers]), whole // shared


def _absorbed(rest: Packed, blocks: Sequence[_Block]) -> None:
    """Add a polynomial to sums of squares without factors, which then have it as part of z' G z."""
    waiting = dict(rest)
    for block in blocks:
        for at, (m, diagonal) in enumerate(block.pairs()):
            if m in waiting:
                block.add(at, waiting.pop(m) / (1 if diagonal else 2))
    if waiting:
        raise Rejected("the sums of squares do not make up the claim")


def _product(a: Packed, b: Packed) -> Packed:
    over, under = _whole(a), _whole(b)
    total: dict[int, int] = {}
    size = _SIZE + (over[2] + under[2]) // 4
    for m, x in over[0].items():
        go_on()
        for n, y in under[0].items():
            total[m + n] = total.get(m + n, 0) + x * y
        afford(len(total) * size)
    return {m: Fraction(x, over[1] * under[1]) for m, x in total.items() if x}


def _whole(a: Packed) -> tuple[dict[int, int], int, int]:
    """Return integers and their common denominator, and the most bits of any of them."""
    whole = _common(a.values())
    bits = whole.bit_length() + max((x.numerator.bit_length() for x in a.values()), default=0)
    afford(len(a) * (_SIZE + bits // 8))
    return {m: x.numerator * (whole // x.denominator) for m, x in a.items()}, whole, bits


def _common(numbers: Iterable[Fraction]) -> int:
    """Return the least common denominator."""
    whole = 1
    for q in {x.denominator for x in numbers}:
        whole = lcm(whole, q)
        if whole.bit_length() > 4 * _BITS:
            raise Rejected("an integer in a sum of squares has too many digits")
    return whole


def _less(a: Packed, b: Packed) -> Packed:
    go_on()
    total = dict(a)
    for m, x in b.items():
        total[m] = total[m] - x if m in total else -x
        if total[m].denominator.bit_length() > 4 * _BITS:
            raise Rejected("an integer in a sum of squares has too many digits")
    afford(_size(total))
    return {m: x for m, x in total.items() if x}


def _size(a: Packed) -> int:
    return len(a) * _SIZE + sum(x.numerator.bit_length() + x.denominator.bit_length() for x in a.values()) // 8


def _monomial(exponents: object, count: int) -> int:
    powers = listed(exponents)
    if len(powers) != count or any(type(e) is not int or not 0 <= e <= _EXPONENT for e in powers):
        raise Rejected(f"a monomial is not a list of {count} exponents from 0 to {_EXPONENT}")
    return sum(e << (at * _FIELD) for at, e in enumerate(powers))


def _integer(x: object) -> int:
    if type(x) is not int or x.bit_length() > _BITS:
        raise Rejected("an entry of a sum of squares is not an integer, or has too many digits")
    return x


def _fraction(x: object) -> Fraction:
    pair = listed(x)
    if len(pair) != 2 or _integer(pair[1]) <= 0:
        raise Rejected("a number of a sum of squares is not a fraction with a positive denominator")
    return Fraction(_integer(pair[0]), pair[1])

"""An equilibrium x* that is known up to radii: a box around a stated centre x̂ contains it.

The box is B: |c_k − x̂_k| ≤ r_k. The slope rule, with slopes about every c of B, shows for a solution x in the region
{V(x − x̂) ≤ level} and a solution c in B of the same parameters that V(x − c) decays at a rate above ρ. With e, a bound
on the norm √V of what the dynamics leave at x̂, such as f(x̂, w):

1. x̂ in the place of c: d√V/dt < −ρ/2 √V + e (continuous time) and √V⁺ < (1 − ρ/2) √V + e (a step or a period). So V
   decreases on the region outside E = {√V(x − x̂) ≤ 2e/ρ}, and solutions stay in the region, and in E.
2. E lies in B if ρ ≥ 2 e √(P⁻¹)_kk / r_k for all k (`least_rate`). Two solutions in E approach each other; so, for
   constant parameters, E contains exactly one equilibrium, or fixed point of the step, to which all solutions in the
   region converge, and V(x − x*) decays at the rate ρ. (Contraction: Lohmiller and Slotine, Automatica 34 (6), 1998.)

With `constant`, a claim is about constant parameters only. Then it is shown that B contains an equilibrium x* of each
(`require_rest`), and that V(x − c) decays on {V(x − c) ≤ wide} for each c of B, where this set contains the region
{V(x − x̂) ≤ level} (`widened`) and lies in the box: so every solution in the region converges to the x* of its
parameters, and B contains no other equilibrium of them. How fast V decays does not matter.

In a sampled loop, the fixed point is also at rest between the instants. Constants added to the dynamics leave all
differences of solutions as they are: so no two states can be equilibria of dynamics that differ by constants only, and
the equilibrium moves continuously from x̂, with the constants for which x̂ is one, to x* without any (Brouwer degree).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import inf, isfinite, nextafter
from typing import Any, TypeAlias

import numpy as np

from surctl.certcheck.arrays import Ends
from surctl.certcheck.document import Rejected, number
from surctl.certcheck.enclosure import Undefined, rational
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.inequality import Box
from surctl.certcheck.jets import Tape, as_array
from surctl.certcheck.region_exact import Matrix, relative_root_up

__all__ = ["least_rate", "narrowed", "norm", "read_constant", "read_radii", "require_rest", "widened"]

_Ends: TypeAlias = tuple[Fraction, Fraction]

_MOST_RANGES, _INFLATIONS = 300, 6  # into which parameters are cut; boxes that are tried for each
_STEPS, _FAR = 8, 4  # of Newton's method; radii from the centre beyond which it is stopped
_WIDER, _LEAST = Fraction(5, 4), Fraction(1, 10**9)  # size of a box relative to its image, and to the radii


def read_radii(claim: Mapping[str, Any], names: Sequence[str]) -> list[Fraction]:
    """Return the radius of each state and command of a claim; none of them if the equilibrium is exact."""
    if "radius" not in claim:
        return []
    stated = claim["radius"]
    if not isinstance(stated, dict) or set(stated) != set(names):
        raise Rejected("the radius does not name every coordinate of the equilibrium once")
    radii = [Fraction(repr(number(stated[name]))) for name in names]
    if not all(r > 0 for r in radii):
        raise Rejected("a radius of the equilibrium is not positive")
    return radii


def read_constant(claim: Mapping[str, Any]) -> bool:
    """Return whether the parameters of a claim are constant; it then states radii."""
    if claim.get("constant", True) is not True or ("constant" in claim and "radius" not in claim):
        raise Rejected("'constant' must be true, and needs radii of the equilibrium")
    return "constant" in claim


def narrowed(box: Box, radii: Sequence[Fraction]) -> list[tuple[float, float]]:
    """Return a box that is narrower by the radii: a set about x̂ in it lies in `box` if it is moved within B."""
    ends = ((Fraction(repr(low)) + r, Fraction(repr(high)) - r) for (low, high), r in zip(box, radii, strict=False))
    return [(nextafter(float(low), inf), nextafter(float(high), -inf)) for low, high in ends]


def require_rest(
    names: Sequence[str], ranges: Box, residuals: Sequence[str], centre: Sequence[Fraction], radii: Sequence[Fraction]
) -> None:
    """Raise Rejected unless the residuals G(x, p) have a common zero x in B for all parameters p in their ranges.

    The ranges are halved until the interval Newton operator of Krawczyk (Computing 4, 1969) shows a zero: a box D with
    a point c contains one, for each p, if c − C G(c, p) + (I − C J) (D − c) lies inside D for all p and for the
    derivatives J of G on D, with any matrix C.

    Args:
        names: names of the n coordinates, then of the parameters.
        ranges: bounds of the parameters.
        residuals: texts of G (n,).
        centre, radii: of B (n,).

    Raises:
        Undefined: a residual is not defined near a zero.
    """
    table = ExpressionTable(names)
    newton = _Newton(Tape(table, tuple(table.read(text) for text in residuals)), centre, radii)
    whole = [(Fraction(low), Fraction(high)) for low, high in ranges]
    waiting = [whole]
    for _ in range(_MOST_RANGES):
        if not waiting:
            return
        box = waiting.pop()
        at = newton.zero([(low + high) / 2 for low, high in box])
        if at is None:
            break
        if newton.shows(at, box):
            continue
        # a parameter may also matter to the derivatives
        shares = {k: (box[k][1] - box[k][0]) / (high - low) for k, (low, high) in enumerate(whole) if low < high}
        if not any(shares.values()):
            break
        moves = newton.moves(at, box)
        k = max(shares, key=lambda k: shares[k] / 4 + moves[k])
        (low, high), middle = box[k], sum(box[k], Fraction(0)) / 2
        waiting += [[*box[:k], ends, *box[k + 1 :]] for ends in ((low, middle), (middle, high))]
    raise Rejected("an equilibrium within the radii is not shown to exist for all parameters")


@dataclass(frozen=True)
class _Newton:
    """Newton's method in intervals for residuals G(x, p) (n,) on B (`centre`, `radii`)."""

    residuals: Tape
    centre: Sequence[Fraction]
    radii: Sequence[Fraction]

    def derivatives(self, *box: _Ends) -> tuple[list[_Ends], list[list[_Ends]]]:
        """Return values of G, and its derivatives by x and p, on a box."""
        around = as_array(*((rational(low)[0], rational(high)[1]) for low, high in box))
        jets = self.residuals.everywhere(around, order=1)
        values, slopes = [jet.value for jet in jets], [jet.slope for jet in jets if jet.slope is not None]
        return [*map(_ends, values)], [[_ends((low[k], high[k])) for k in range(len(box))] for low, high in slopes]

    def inverse(self, slopes: Sequence[Sequence[_Ends]]) -> list[list[Fraction]]:
        """Return about the inverse of the derivatives by x."""
        middles = [[float(low + high) / 2 for low, high in row[: len(self.centre)]] for row in slopes]
        return [[Fraction(x) for x in row] for row in np.linalg.pinv(np.array(middles)).tolist()]

    def zero(self, p: Sequence[Fraction]) -> list[Fraction] | None:
        """Return a point of B where G is about 0 for the parameters p; None if Newton's method ends at none."""
        at = list(self.centre)
        for _ in range(_STEPS):
            values, slopes = self.derivatives(*((x, x) for x in (*at, *p)))
            step = _product(self.inverse(slopes), [low for low, _ in values])
            at = [Fraction(float(x - y)) for x, y in zip(at, step, strict=True)]
            if not all(abs(x - c) < _FAR * r for x, c, r in zip(at, self.centre, self.radii, strict=True)):
                return None
            if all(abs(y) < _LEAST * r for y, r in zip(step, self.radii, strict=True)):
                break
        return at if all(abs(x - c) < r for x, c, r in zip(at, self.centre, self.radii, strict=True)) else None

    def shows(self, at: Sequence[Fraction], p: Sequence[_Ends]) -> bool:
        """Return whether a box around a point lies in B and is shown to have a zero for all p."""
        own = [(c - r, c + r) for c, r in zip(self.centre, self.radii, strict=True)]
        try:
            slopes = self.derivatives(*((x, x) for x in at), *p)[1]
            still = self.still(self.at_middles(at, p), p, slopes, range(len(p)))
            size = self.image(self.inverse(slopes), [], still, [])
            for _ in range(_INFLATIONS):
                size = [_WIDER * x + r * _LEAST for x, r in zip(size, self.radii, strict=True)]
                box = [(max(x - r, low), min(x + r, high)) for x, r, (low, high) in zip(at, size, own, strict=True)]
                slopes = self.derivatives(*box, *p)[1]
                image = self.image(self.inverse(slopes), slopes, still, size)
                if all(low < x - r and x + r < high for x, r, (low, high) in zip(at, image, box, strict=True)):
                    return True
                if any(x > 2 * r for x, r in zip(image, self.radii, strict=True)):
                    return False
                size = image
        except Undefined:
            pass
        return False

    def at_middles(self, at: Sequence[Fraction], p: Sequence[_Ends]) -> list[_Ends]:
        """Return G(at, p) at the middles of the ranges."""
        middles = ((sum(ends, Fraction(0)) / 2,) * 2 for ends in p)
        return self.derivatives(*((x, x) for x in at), *middles)[0]

    def still(
        self, values: Sequence[_Ends], p: Sequence[_Ends], slopes: Sequence[Sequence[_Ends]], which: Iterable[int]
    ) -> list[Fraction]:
        """Return bounds on |G(at, p)| by the mean value theorem in p, of which only some move."""
        n, halves = len(self.centre), {k: (p[k][1] - p[k][0]) / 2 for k in which}
        moved = (sum((_size(row[n + k]) * x for k, x in halves.items()), Fraction(0)) for row in slopes)
        return [_size(value) + x for value, x in zip(values, moved, strict=True)]

    def image(
        self,
        inverse: Sequence[Sequence[Fraction]],
        slopes: Sequence[Sequence[_Ends]],
        still: Sequence[Fraction],
        size: Sequence[Fraction],
    ) -> list[Fraction]:
        """Return |C| |G(at, p)| + |I − C J| size, for C and for the derivatives J on a box."""
        out = []
        for i, line in enumerate(inverse):
            total = sum((abs(c) * x for c, x in zip(line, still, strict=True)), Fraction(0))
            for j, width in enumerate(size):
                ends = [(c * row[j][0], c * row[j][1]) for c, row in zip(line, slopes, strict=True)]
                low, high = (sum((pick(pair) for pair in ends), Fraction(0)) for pick in (min, max))
                total += max(abs((i == j) - low), abs((i == j) - high)) * width
            out.append(total)
        return out

    def moves(self, at: Sequence[Fraction], p: Sequence[_Ends]) -> list[Fraction]:
        """Return how far each parameter moves the zero, relative to the radii."""
        try:
            slopes = self.derivatives(*((x, x) for x in at), *p)[1]
            values, inverse = self.at_middles(at, p), self.inverse(slopes)
        except Undefined:
            return [Fraction(0)] * len(p)
        images = (self.image(inverse, [], self.still(values, p, slopes, [k]), []) for k in range(len(p)))
        return [max(x / r for x, r in zip(image, self.radii, strict=True)) for image in images]


def _product(matrix: Sequence[Sequence[Fraction]], vector: Sequence[Fraction]) -> list[Fraction]:
    return [sum((x * y for x, y in zip(row, vector, strict=True)), Fraction(0)) for row in matrix]


def _size(ends: _Ends) -> Fraction:
    return max(abs(ends[0]), abs(ends[1]))


def _ends(a: Ends) -> _Ends:
    """Return the ends of the only interval of an array."""
    low, high = (end.item() for end in a)
    if not (isfinite(low) and isfinite(high)):
        raise Undefined("a derivative that is not bounded near an equilibrium")
    return Fraction(low), Fraction(high)


def norm(p: Matrix, sizes: Sequence[Fraction]) -> Fraction:
    """Return an upper bound on √(vᵀ P v) for all |v_k| ≤ sizes_k; P is positive semidefinite."""
    return sum((size * relative_root_up(p[k][k]) for k, size in enumerate(sizes)), Fraction(0))


def widened(p: Matrix, level: Fraction, radii: Sequence[Fraction]) -> Fraction:
    """Return a level that (x − c)ᵀ P (x − c) does not exceed for c in B, where (x − x̂)ᵀ P (x − x̂) ≤ level.

    Raises:
        Rejected: B is not shown to lie inside the level set.
    """
    if not radii:
        return level
    extent = norm(p, radii)
    if not extent**2 < level:
        raise Rejected("the radii of the equilibrium do not lie inside the region")
    return (relative_root_up(level) + extent) ** 2


def least_rate(drift: Fraction, covers: Sequence[Matrix], radii: Sequence[Fraction]) -> Fraction:
    """Return a rate with which {ξᵀ Q⁻¹ ξ ≤ (2 drift/rate)²} lies in B for all covers Q of the first coordinates."""
    ratios = (relative_root_up(q[k][k]) / radius for q in covers for k, radius in enumerate(radii[: len(q)]))
    return 2 * drift * max(ratios)

"""An equilibrium x* that is known up to radii: a box around a stated centre x̂ contains it.

The box is B: |c_k − x̂_k| ≤ r_k. The slope rule, with slopes about every c of B, shows for a solution x in the region
{V(x − x̂) ≤ level} and a solution c in B of the same parameters that V(x − c) decays at a rate above ρ. With e, a bound
on the norm √V of what the dynamics leave at x̂, such as f(x̂, w):

1. x̂ in the place of c: d√V/dt < −ρ/2 √V + e (continuous time) and √V⁺ < (1 − ρ/2) √V + e (a step or a period). So V
   decreases on the region outside E = {√V(x − x̂) ≤ 2e/ρ}, and solutions stay in the region, and in E.
2. E lies in B if ρ ≥ 2 e √(P⁻¹)_kk / r_k for all k (`least_rate`). Two solutions in E approach each other; so, for
   constant parameters, E contains exactly one equilibrium, or fixed point of the step, to which all solutions in the
   region converge, and V(x − x*) decays at the rate ρ. (Contraction: Lohmiller and Slotine, Automatica 34 (6), 1998.)

In a sampled loop, the fixed point is also at rest between the instants. Constants added to the dynamics leave all
differences of solutions as they are: so no two states can be equilibria of dynamics that differ by constants only, and
the equilibrium moves continuously from x̂, with the constants for which x̂ is one, to x* without any (Brouwer degree).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from surctl.certcheck.document import Rejected, number
from surctl.certcheck.region_exact import Matrix, relative_root_up

__all__ = ["least_rate", "norm", "read_radii", "widened"]


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

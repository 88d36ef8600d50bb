"""Check of a region of a sampled loop: a plant in continuous time under a controller that is evaluated once a period.

At each sampling instant the states of the controller take their next values, and the commands are computed; both are
functions of the states before the instant. Then the states of the plant follow their rates for one period T while the
commands u are held. The parameters may take any value of their ranges at any time, unless the claim is about constant
ones.

The region is V(ξ) = ξᵀ P ξ < level at the sampling instants, ξ = x − x*. In between, W(τ, ζ) = ζᵀ Q(τ)⁻¹ ζ with
ζ = (x − x*, u − u*) and the time τ since the last instant, where Q(τ) ≻ 0 is linear between equidistant knots. With the
slopes of `surctl.certcheck.slope_rows` on {V ≤ level} and on {W ≤ level}, three inequalities are shown:

1. ζ⁺ = J(θ) ξ at an instant: W(0, ζ⁺) < (1 − rate) V(ξ), from [[(1 − rate) P, Jᵀ], [J, Q(0)]] ≻ 0;
2. ζ' = A(θ) ζ in between: W decreases, from Q' − A Q − Q Aᵀ ≻ 0, as dW/dτ = −ηᵀ (Q' − A Q − Q Aᵀ) η with
   η = Q⁻¹ ζ. On a piece Q' is constant and Q lies between the knots, so that both ends and all vertices of θ decide;
3. V(ξ) ≤ W(T, ζ), from P⁻¹ − Π Q(T) Πᵀ ⪰ 0: the ellipsoid of W, projected on the states, lies in that of V.

Slopes of a piece hold on {W ≤ level}, as the extent ζᵀ Q⁻¹ ζ ≤ level in a direction c is √(level cᵀ Q c), which is
greatest at a knot. A held command lies in the range that it has on {V ≤ level}. So V falls by the factor 1 − rate, or a
smaller one, in each period, and W ≤ level in between. (Clock-dependent Lyapunov functions: Briat, Automatica 49 (11),
2013; in the inverse: Hu, Lin and Chen, IEEE Transactions on Automatic Control 47 (3), 2002.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np

from surctl.certcheck.document import Rejected, listed, number, record
from surctl.certcheck.enclosure import Undefined, greatest, least, outward, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.inequality import Box
from surctl.certcheck.interval import printable, variables_of
from surctl.certcheck.motion import Motion, require_loop, rest_of
from surctl.certcheck.radii import (
    least_rate,
    narrowed,
    norm,
    read_constant,
    read_radii,
    require_rest,
    widened,
)
from surctl.certcheck.region_exact import Matrix, inverse, is_positive_definite
from surctl.certcheck.slope_rows import Rows
from surctl.certcheck.slopes import is_definite, quadratic_form, require_in_box

__all__ = ["check"]

_CLAIM = {
    "name", "time", "property", "about", "states", "parameters", "commands", "dynamics", "next", "period_s", "function",
    "level", "rate", "equilibrium",
}  # fmt: skip
_MOST_KNOTS = 65


def check(document: Mapping[str, Any]) -> None:
    """Raise Rejected unless the certificate proves its claim about a sampled loop."""
    claim = record(document["claim"], _CLAIM | document["claim"].keys() & {"radius", "constant"}, "claim")
    record(document, {"format", "version", "kind", "claim", "sha256", "knots", "feedbacks"}, "the certificate")
    printable(claim["name"])
    if claim["property"] != "stability":
        raise Rejected("a sampled loop has the property stability only")
    if claim["about"]:
        require_loop(claim["about"])
    commands = [record(row, {"name", "unit", "value"}, "a command") for row in listed(claim["commands"])]
    rows = [{"name": row["name"], "unit": row["unit"], "lower": 0.0, "upper": 0.0} for row in commands]
    states, box = variables_of(claim["states"])
    names, whole = variables_of([*claim["states"], *rows, *listed(claim["parameters"])])
    n, size = len(states), len(states) + len(rows)
    flow, after = claim["dynamics"], claim["next"]
    if sorted([*flow, *after]) != sorted(states):
        raise Rejected("each state must have either a rate or a next value")
    if set(claim["equilibrium"]) != set(names[:size]):
        raise Rejected("the equilibrium does not name every state and command once")
    centre = [rest_of(claim["equilibrium"][name])[1] for name in names[:size]]
    radii, fixed = read_radii(claim, names[:size]), read_constant(claim)
    period, level, rate = (
        Fraction(repr(number(claim[key]))) if claim[key] is not None else Fraction(0)
        for key in ("period_s", "level", "rate")
    )
    if not period > 0 or (claim["rate"] is not None and not 0 < rate <= 1):
        raise Rejected("the period is not positive, or the rate is not positive, or exceeds 1")
    p = quadratic_form(states, claim["function"], centre[:n])
    knots = [_symmetric(knot, size) for knot in listed(document["knots"])]
    if not 2 <= len(knots) <= _MOST_KNOTS:
        raise Rejected(f"there are not 2 to {_MOST_KNOTS} knots")
    cover = inverse(p)
    wide = widened(p, level, radii[:n])
    for shape in (cover, *knots):
        require_in_box(shape, centre, *((wide, narrowed(box, radii)) if fixed else (level, box)))
    last = [[x - y for x, y in zip(*pair, strict=False)] for pair in zip(cover, knots[-1], strict=False)]
    if not is_positive_definite(last):
        raise Rejected("V may exceed W, the function between the instants, at the end of a period")
    at_samples = [*states, *names[size:]], [*box, *whole[size:]]
    feedbacks = [_exact(row) for row in listed(document["feedbacks"])]
    texts = [*(after.get(name, name) for name in states), *(row["value"] for row in commands)]
    jump, drift = _rows(*at_samples, texts, [cover], centre[:n], wide, feedbacks, centre, radii[:n])
    ends = [(least(a, b)[0], greatest(a, b)[1]) for a, b in ((jump.range[k], jump.rest[k]) for k in jump.roots)]
    ranges = [outward(one) for one in ends]
    rates = [flow.get(name, "0") for name in names[:size]]  # a command is held
    between = Motion(names[:size], names, [*box, *ranges[n:], *whole[size:]], rates, discrete=False)
    table = ExpressionTable(names)
    between.require_continuous(table, [table.read(text) for text in between.rates], "the dynamics contain")
    shapes = [inverse(knot) for knot in knots] if radii and not fixed else []  # for the drift about x̂
    moved, time = norm(shapes[0], drift) if shapes else Fraction(0), period / (len(knots) - 1)
    for k, pair in enumerate(pairwise(knots)):
        extent = wide if fixed else max((widened(shape, level, radii) for shape in shapes[k : k + 2]), default=level)
        drift = _piece(between, centre, extent, pair, time, radii)
        moved += time * max((norm(shape, drift) for shape in shapes[k : k + 2]), default=Fraction(0))
    if fixed:
        still = [flow.get(name, f"({text}) - {name}") for name, text in zip(names, texts, strict=False)]
        try:
            require_rest(names, whole[size:], still, centre, radii)
        except Undefined as reason:
            raise Rejected(f"an expression is not defined near the equilibrium: {reason}") from None
    elif radii:
        rate = max(rate, least_rate(moved, [cover, *knots], radii))
    _instant(jump, p, knots[0], rate)


def _instant(rows: Rows, p: Matrix, knot: Matrix, rate: Fraction) -> None:
    """Raise Rejected unless W(0) < (1 − rate) V after an instant."""
    jump = np.array(rows.rows, dtype=object)
    whole = np.block([[np.array(p, dtype=object) * (1 - rate), jump.T], [jump, np.array(knot, dtype=object)]])
    if not is_definite(rows, whole):
        raise Rejected("the slope rule does not show that the function decreases at a sampling instant")


def _piece(
    between: Motion,
    centre: Sequence[Fraction],
    level: Fraction,
    knots: tuple[Matrix, Matrix],
    time: Fraction,
    radii: Sequence[Fraction] = (),
) -> list[Fraction]:
    """Return bounds on the rates at the centre; raise Rejected unless W decreases between two knots in this time."""
    still = [Fraction(0)] * len(between.states)
    rows, drift = _rows(between.names, between.box, between.rates, knots, centre, level, (), still, radii)
    first, last = (np.array(knot, dtype=object) for knot in knots)
    for knot in (first, last):
        moved = knot @ np.array(rows.rows, dtype=object).T  # Q Aᵀ
        whole = -moved - moved.T + (last - first) * (1 / time)
        if not is_definite(rows, whole):
            raise Rejected(
                "the slope rule does not show that W, which bounds V between the sampling instants, decreases"
            )
    return drift


def _rows(
    names: Sequence[str],
    box: Box,
    texts: Sequence[str],
    covers: Sequence[Matrix],
    centre: Sequence[Fraction],
    level: Fraction,
    feedbacks: Sequence[Sequence[Fraction]],
    rests: Sequence[Fraction],
    radii: Sequence[Fraction],
) -> tuple[Rows, list[Fraction]]:
    """Return rows of texts about a centre with radii, and bounds on how far their values there are from `rests`.

    Raises:
        Rejected: a text is not defined on the region, or they differ although there are no radii.
    """
    try:
        rows = Rows(names, [span(*ends) for ends in box], texts, covers, centre, level, (), feedbacks, radii)
        if len(rows.limits) != len(feedbacks):
            raise Rejected(f"there are {len(feedbacks)} feedbacks for {len(rows.limits)} limits")
        moves = [rows.size(rows.resting(k, rest)) for k, rest in enumerate(rests)]
    except Undefined as reason:
        raise Rejected(f"an expression is not defined on the region: {reason}") from None
    if any(moves) and not radii:
        raise Rejected("the loop does not rest at the equilibrium for all parameters")
    return rows, moves


def _exact(row: object) -> list[Fraction]:
    return [Fraction(repr(number(x))) for x in listed(row)]


def _symmetric(stated: object, size: int) -> Matrix:
    """Return a positive definite matrix (size, size) of the certificate."""
    matrix = [_exact(row) for row in listed(stated)]
    if [len(row) for row in matrix] != [size] * size or not is_positive_definite(matrix):
        raise Rejected("a knot is not a positive definite matrix of the states and commands")
    return matrix

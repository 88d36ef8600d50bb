"""Rules that prove function ≤ 0 on a box; each leaf of the tree of boxes holds the letter of the rule that proves it.

`i`: a constraint is positive on the whole box, so the box lies outside the domain. `j`: the mean-value form shows that
a constraint is positive on the whole box. `n`: the interval of the function's values shows the inequality. `m`: the
mean-value form shows the inequality on one face of the box; on this face, every variable in which the function is
monotone is at the end where the function is larger. `c`: the function is concave on that face, and its tangent at one
point, which is an upper bound, shows the inequality.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.verification.proving import intervals as iv
from surctl.verification.proving.intervals import Ends
from surctl.verification.proving.jets import Jet
from surctl.verification.proving.tape import Tape

Array = NDArray[np.float64]

_NEWTON, _RESTS = 12, 1e-13  # largest number of Newton steps; step size at convergence, as a share of the box
_SNAP = 1e-12  # a point nearer to 0 than this share of the box is set to 0


@dataclass(frozen=True, eq=False)
class Verdicts:
    """Result of trying the rules on B boxes: the rule that proves each box, or data for splitting an unproved box.

    Attributes:
        rule: (B,) letter of the rule that proves the box; "" if no rule proves it.
        points: (n, B) point of the tangent that rule `c` uses.
        smear: (n, B) contribution of every variable to the width of the function values that are not yet proved ≤ 0.
    """

    rule: NDArray[np.str_]
    points: Array
    smear: Array


def middle(low: Array, high: Array) -> Array:
    """Return the centre of an interval, computed as the checker does."""
    with np.errstate(over="ignore", invalid="ignore"):  # the sum of the ends may overflow
        whole = low + high
        return np.where(np.isfinite(whole), whole / 2, low / 2 + high / 2)


def apply_rules(bound: Tape, constraints: Tape, box: Ends, slack: float, defined: NDArray[np.bool_]) -> Verdicts:
    """Try every rule on every box; return the results.

    Args:
        bound: instruction list of the function to be proved ≤ 0, then of the positive factors of its denominator; a
            power appears as repeated factors.
        constraints: instruction list of the constraints; a point belongs to the domain if no constraint is positive at
            the point.
        box: the boxes (n, B).
        slack: amount by which the function, divided by its denominator, may exceed 0.
        defined: (B,) whether the claim as written is known to be defined on the box.
    """
    n, count = box[0].shape
    rule = np.full(count, "", dtype="<U1")
    points, smear = np.zeros((n, count)), np.zeros((n, count))
    _infeasible(constraints, box, rule)
    _natural(bound, box, slack, defined, rule)
    open_ = np.flatnonzero(rule == "")
    if open_.size:
        part = box[0][:, open_], box[1][:, open_]
        letters, smear[:, open_], points[:, open_] = _by_derivatives(bound, constraints, part, slack, defined[open_])
        rule[open_] = letters
    return Verdicts(rule, points, smear)


def _infeasible(constraints: Tape, box: Ends, rule: NDArray[np.str_]) -> None:
    read = constraints.run(box)
    for jet, fine in zip(read.jets, read.defined, strict=True):
        rule[fine & (jet.value[0] > 0)] = "i"


def _natural(bound: Tape, box: Ends, slack: float, defined: NDArray[np.bool_], rule: NDArray[np.str_]) -> None:
    read = bound.run(box)
    good = (read.jets[0].value[1] <= _limit(read.jets[1:], slack)) & read.defined[0] & defined
    rule[good & (rule == "")] = "n"


def _limit(factors: tuple[Jet, ...], slack: float) -> Array | float:
    # rounded down
    if not slack:
        return 0.0
    least: Array | float = slack
    for factor in factors:
        least = np.maximum(np.nextafter(least * factor.value[0], -np.inf), 0.0)
    return least


def _by_derivatives(
    bound: Tape, constraints: Tape, box: Ends, slack: float, defined: NDArray[np.bool_]
) -> tuple[NDArray[np.str_], Array, Array]:
    count = box[0].shape[1]
    rule = np.full(count, "", dtype="<U1")
    smear = np.zeros_like(box[0])
    guards = constraints.run(box, order=1)
    centre = middle(*box)
    at_centre = constraints.run(iv.point(centre))
    for jet, fine, there in zip(guards.jets, guards.defined, at_centre.jets, strict=True):
        smear = np.maximum(smear, _weight(jet, box))
        rule[fine & (_mean_value(jet, there, box, centre, lower=True) > 0)] = "j"
    read = bound.run(box, order=1)
    limit = _limit(read.jets[1:], slack)
    smear = np.maximum(smear, _weight(read.jets[0], box))
    fine = read.defined[0] & defined
    low, high, free = _face(read.jets[0], box)
    at = np.where(free, middle(low, high), low)
    on_face = bound.run((low, high)).jets[0].value[1]
    by_mean = _mean_value(read.jets[0], bound.run(iv.point(at)).jets[0], (low, high), at, lower=False)
    rule[(rule == "") & fine & (np.minimum(on_face, by_mean) <= limit)] = "m"
    points = at
    left = np.flatnonzero((rule == "") & fine)
    if left.size:
        cut = low[:, left], high[:, left]
        bar = limit if isinstance(limit, float) else limit[left]
        good, points[:, left] = _concave(bound, cut, free[:, left], bar)
        rule[left[good]] = "c"
    return rule, smear, points


def _weight(jet: Jet, box: Ends) -> Array:
    """Return the share (n, B) of each of n variables in the width of a function's interval bound on each of B boxes.

    The width is estimated as the sum, over the variables, of the largest |slope| times the side length of the box; the
    share of a variable is its term divided by this sum. The share is 0 on a box where the interval bound shows that the
    function is not positive, and where the sum is 0.
    """
    assert jet.slope is not None
    steep = np.maximum(np.abs(jet.slope[0]), np.abs(jet.slope[1]))
    steep = np.where(np.isfinite(steep), steep, 1e100)
    moved = steep * (box[1] - box[0])
    total = moved.sum(axis=0)
    matters = (jet.value[1] > 0) & (total > 0)
    weight: Array = np.where(matters, moved / np.where(total > 0, total, 1.0), 0.0)
    return weight


def _face(jet: Jet, box: Ends) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the face of the box on which the function is largest in every variable in which it is monotone."""
    assert jet.slope is not None
    up = jet.slope[0] >= 0
    down = ~up & (jet.slope[1] <= 0)
    low, high = np.where(up, box[1], box[0]), np.where(down, box[0], box[1])
    return low, high, ~(up | down) & (low < high)


def _mean_value(jet: Jet, there: Jet, box: Ends, at: Array, *, lower: bool) -> Array:
    assert jet.slope is not None
    with np.errstate(all="ignore"):
        offset = iv.subtract(box, iv.point(at))
        moves = iv.multiply(jet.slope, offset)
        total = there.value
        for k in range(len(at)):
            total = iv.add(total, (moves[0][k], moves[1][k]))
    return total[0] if lower else total[1]


def _concave(bound: Tape, face: Ends, free: NDArray[np.bool_], limit: Array | float) -> tuple[NDArray[np.bool_], Array]:
    """Return for each face whether a tangent proves the inequality on it, and the tangent points."""
    points = np.clip(np.zeros_like(face[0]), face[0], face[1])
    good = np.zeros(face[0].shape[1], dtype=bool)
    bend = bound.run(face, order=2).jets[0].bend
    assert bend is not None
    down = np.flatnonzero(_bends_down(bend, free))
    if not down.size:
        return good, points
    cut, at = (face[0][:, down], face[1][:, down]), points[:, down]
    bar = limit if isinstance(limit, float) else limit[down]
    good[down] = _tangent(bound, cut, at) <= bar
    again = np.flatnonzero(~good[down])
    if again.size:
        cut, at, down = (cut[0][:, again], cut[1][:, again]), at[:, again], down[again]
        points[:, down] = _climbed(bound, cut, at, free[:, down])
        bar = limit if isinstance(limit, float) else limit[down]
        good[down] = _tangent(bound, cut, points[:, down]) <= bar
    return good, points


def _bends_down(bend: Ends, free: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether the function is concave on each of B boxes, by interval elimination on the free variables.

    If all pivots are positive, every symmetric matrix in the interval matrix −bend is positive definite, apart from
    rows of zeros, so the function is concave.
    """
    with np.errstate(all="ignore"):
        m = iv.negate(bend)
        both = free[:, None] & free[None]
        m = np.where(both, m[0], 0.0), np.where(both, m[1], 0.0)
        active = np.any((m[0] != 0) | (m[1] != 0), axis=1)
        good = np.ones(free.shape[1], dtype=bool)
        for k in range(len(free)):
            pivot = m[0][k, k], m[1][k, k]
            good &= ~active[k] | (pivot[0] > 0)
            pivot = np.where(active[k] & good, pivot[0], 1.0), np.where(active[k] & good, pivot[1], 1.0)
            column = m[0][:, k], m[1][:, k]
            ratio = iv.divide(column, (pivot[0][None], pivot[1][None]))
            product = iv.multiply((ratio[0][:, None], ratio[1][:, None]), (column[0][None], column[1][None]))
            m = iv.subtract(m, product)
    bounded: NDArray[np.bool_] = np.all(np.isfinite(bend[0]) & np.isfinite(bend[1]) | ~both, axis=(0, 1))
    return good & bounded


def _tangent(bound: Tape, face: Ends, at: Array) -> Array:
    """Return the largest value (B,) that the tangent at a point of the face has on the face."""
    read = bound.run(iv.point(at), order=1)
    value = _mean_value(read.jets[0], read.jets[0], face, at, lower=False)
    return np.where(read.defined[0], value, np.inf)


def _climbed(bound: Tape, face: Ends, start: Array, free: NDArray[np.bool_]) -> Array:
    # Newton's method
    at = start
    n = len(at)
    for _ in range(_NEWTON):
        jet = bound.run(iv.point(at), order=2).jets[0]
        assert jet.slope is not None and jet.bend is not None
        slope, bend = middle(*jet.slope), middle(*jet.bend)
        # fix a variable at its bound if the step would move it beyond this bound
        held = ~free | ((at <= face[0]) & (slope < 0)) | ((at >= face[1]) & (slope > 0))
        held |= ~np.isfinite(slope) | np.any(~np.isfinite(bend), axis=0)
        matrix = np.where(held[:, None] | held[None], 0.0, bend)
        flat = np.all(matrix == 0, axis=1)
        matrix = matrix - np.eye(n)[:, :, None] * flat[None]
        right = np.where(held, 0.0, slope)
        try:
            step = np.linalg.solve(np.moveaxis(matrix, 2, 0), -right.T[..., None])[..., 0].T
        except np.linalg.LinAlgError:
            break
        after = np.clip(at + np.where(np.isfinite(step), step, 0.0), face[0], face[1])
        rests = np.all(np.abs(after - at) <= _RESTS * (face[1] - face[0]))
        at = after
        if rests:
            break
    near = (np.abs(at) < _SNAP * (face[1] - face[0])) & (face[0] <= 0) & (face[1] >= 0)
    return np.where(near, 0.0, at)

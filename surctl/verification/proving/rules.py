"""The rules of `surctl.certcheck.rules` in a search: which rule proves a box, tangent points, where to split."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import arrays as iv
from surctl.certcheck.arrays import Array, Ends, Flags
from surctl.certcheck.jets import Jet, Tape
from surctl.certcheck.rules import Face, Rules, middle

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


def apply_rules(rules: Rules, box: Ends, defined: Flags) -> Verdicts:
    """Try every rule on every box; return the results.

    Args:
        rules: the inequality.
        box: the boxes (n, B).
        defined: (B,) whether the claim as written is known to be defined on the box.
    """
    n, count = box[0].shape
    rule = np.full(count, "", dtype="<U1")
    points, smear = np.zeros((n, count)), np.zeros((n, count))
    rule[rules.natural(box) & defined] = "n"
    rule[rules.outside(box)] = "i"
    open_ = np.flatnonzero(rule == "")
    if open_.size:
        part = box[0][:, open_], box[1][:, open_]
        rule[open_], smear[:, open_], points[:, open_] = _by_derivatives(rules, part, defined[open_])
    return Verdicts(rule, points, smear)


def _by_derivatives(rules: Rules, box: Ends, defined: Flags) -> tuple[NDArray[np.str_], Array, Array]:
    rule = np.full(box[0].shape[1], "", dtype="<U1")
    outside, guards = rules.outside_by_slopes(box)
    shown, face, jet = rules.by_slopes(box)
    smear = np.max([_weight(one, box) for one in (*guards, jet)], axis=0)
    rule[shown & defined] = "m"
    rule[outside] = "j"
    points = np.where(face.free, middle(face.low, face.high), face.low)
    left = np.flatnonzero((rule == "") & face.defined & defined)
    if left.size:
        good, points[:, left] = _concave(rules, face.among(left))
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


def _concave(rules: Rules, face: Face) -> tuple[Flags, Array]:
    """Return for each face whether a tangent proves the inequality on it, and the tangent points."""
    points, good = np.clip(np.zeros_like(face.low), face.low, face.high), np.zeros(len(face.limit), dtype=bool)
    down = np.flatnonzero(rules.concave(face))
    good[down] = rules.tangent(face.among(down), points[:, down])
    again = down[~good[down]]
    if again.size:
        points[:, again] = _climbed(rules.bound, face.among(again), points[:, again])
        good[again] = rules.tangent(face.among(again), points[:, again])
    return good, points


def _climbed(bound: Tape, face: Face, at: Array) -> Array:
    # Newton's method
    n = len(at)
    for _ in range(_NEWTON):
        jet = bound.run(iv.point(at), order=2).jets[0]
        assert jet.slope is not None and jet.bend is not None
        slope, bend = middle(*jet.slope), middle(*jet.bend)
        # fix a variable at its bound if the step would move it beyond this bound
        held = ~face.free | ((at <= face.low) & (slope < 0)) | ((at >= face.high) & (slope > 0))
        held |= ~np.isfinite(slope) | np.any(~np.isfinite(bend), axis=0)
        matrix = np.where(held[:, None] | held[None], 0.0, bend)
        flat = np.all(matrix == 0, axis=1)
        matrix = matrix - np.eye(n)[:, :, None] * flat[None]
        right = np.where(held, 0.0, slope)
        try:
            step = np.linalg.solve(np.moveaxis(matrix, 2, 0), -right.T[..., None])[..., 0].T
        except np.linalg.LinAlgError:
            break
        after = np.clip(at + np.where(np.isfinite(step), step, 0.0), face.low, face.high)
        rests = np.all(np.abs(after - at) <= _RESTS * (face.high - face.low))
        at = after
        if rests:
            break
    near = (np.abs(at) < _SNAP * (face.high - face.low)) & (face.low <= 0) & (face.high >= 0)
    return np.where(near, 0.0, at)

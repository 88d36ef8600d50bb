"""Rules that prove function ≤ 0 on a box; each leaf of the tree of boxes holds the letter of the rule that proves it.

`i`: a constraint is positive on the whole box, so the box lies outside the domain. `j`: the mean-value form shows that
a constraint is positive on the whole box. `n`: the interval of the function's values shows the inequality. `m`: the
mean-value form shows the inequality on one face of the box; on this face, every variable in which the function is
monotone is at the end where the function is larger. `c`: the function is concave on that face, and its tangent at one
point, which is an upper bound, shows the inequality.

The prover searches with the rules by which the checker decides.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import arrays as iv
from surctl.certcheck.arrays import Array, Ends, Flags
from surctl.certcheck.jets import Jet, Tape, mean_value

__all__ = ["DIMENSIONS", "Face", "Rules", "bends_down", "middle"]

DIMENSIONS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"
"""The letters and digits that name the variables of a claim in a tree; rules have small letters."""


def middle(low: Array, high: Array) -> Array:
    """Return the centre of an interval."""
    with np.errstate(over="ignore", invalid="ignore"):  # the sum of the ends may overflow
        whole = low + high
        return np.where(np.isfinite(whole), whole / 2, low / 2 + high / 2)


class Face(NamedTuple):
    """The face of each box (n, B) on which the function is largest in every variable in which it is monotone.

    `free` (n, B) says which variables vary on the face, `limit` is the largest allowed value of the function, and
    `defined` (B,) says on which boxes the function is defined.
    """

    low: Array
    high: Array
    free: Flags
    limit: Array
    defined: Flags

    def among(self, boxes: NDArray[np.intp]) -> Face:
        """Return the faces of some boxes."""
        low, high, free = self.low[:, boxes], self.high[:, boxes], self.free[:, boxes]
        return Face(low, high, free, self.limit[boxes], self.defined[boxes])


@dataclass(frozen=True, eq=False)
class Rules:
    """The inequality to prove on boxes: function ≤ slack · Π factors where no constraint is positive.

    Boxes have lower and upper ends (n, B).

    Attributes:
        bound: the function, then the positive factors of its denominator; a power appears as repeated factors.
        constraints: the constraints; a point belongs to the domain if no constraint is positive at the point.
        slack: amount by which the function, divided by its denominator, may exceed 0.
        around: the intervals that stand for boxes.
    """

    bound: Tape
    constraints: Tape
    slack: float
    around: Callable[[Array, Array], Ends] = lambda low, high: (low, high)

    def outside(self, box: Ends) -> Flags:
        """Return on which boxes rule `i` holds."""
        read = self.constraints.run(self.around(*box))
        shown = np.zeros(box[0].shape[1], dtype=bool)
        for jet, fine in zip(read.jets, read.defined, strict=True):
            shown |= fine & (jet.value[0] > 0)
        return shown

    def outside_by_slopes(self, box: Ends) -> tuple[Flags, tuple[Jet, ...]]:
        """Return on which boxes rule `j` holds, and the constraints with their slopes."""
        read, centre = self.constraints.run(self.around(*box), order=1), iv.point(middle(*box))
        offset = self._offset(*box, centre)
        shown = np.zeros(box[0].shape[1], dtype=bool)
        at_centre = self.constraints.run(centre)
        for jet, fine, there in zip(read.jets, read.defined, at_centre.jets, strict=True):
            shown |= fine & (mean_value(jet, there, offset)[0] > 0)
        return shown, read.jets

    def natural(self, box: Ends) -> Flags:
        """Return on which boxes rule `n` holds."""
        read = self.bound.run(self.around(*box))
        return read.defined[0] & (read.jets[0].value[1] <= self._limit(read.jets[1:], box))

    def by_slopes(self, box: Ends) -> tuple[Flags, Face, Jet]:
        """Return on which boxes rule `m` holds, the faces, and the function with its slopes."""
        face, jet = self.face(box)
        at = iv.point(np.where(face.free, middle(face.low, face.high), face.low))
        on_face = self.bound.run(self.around(face.low, face.high)).jets[0].value[1]
        by_mean = mean_value(jet, self.bound.run(at).jets[0], self._offset(face.low, face.high, at))[1]
        return face.defined & (np.minimum(on_face, by_mean) <= face.limit), face, jet

    def face(self, box: Ends) -> tuple[Face, Jet]:
        """Return the faces of boxes, and the function with its slopes on the boxes."""
        read = self.bound.run(self.around(*box), order=1)
        jet = read.jets[0]
        assert jet.slope is not None
        rises = jet.slope[0] >= 0
        falls = ~rises & (jet.slope[1] <= 0)
        low, high = np.where(rises, box[1], box[0]), np.where(falls, box[0], box[1])
        free = ~(rises | falls) & (low < high)
        return Face(low, high, free, self._limit(read.jets[1:], box), read.defined[0]), jet

    def concave(self, face: Face) -> Flags:
        """Return on which faces the function is concave."""
        bend = self.bound.run(self.around(face.low, face.high), order=2).jets[0].bend
        assert bend is not None
        return bends_down(bend, face.free)

    def tangent(self, face: Face, points: Array) -> Flags:
        """Return on which faces the tangent at a point (n, B) shows the inequality, if the function is concave."""
        ends = self.around(face.low, face.high)
        # a variable at its worse end may be any number of its interval; the function is concave in the others for each
        at = np.where(face.free, points, ends[0]), np.where(face.free, points, ends[1])
        read = self.bound.run(at, order=1)
        offset = self._offset(face.low, face.high, at)
        free = np.where(face.free, offset[0], 0.0), np.where(face.free, offset[1], 0.0)
        most = mean_value(read.jets[0], read.jets[0], free)[1]
        return face.defined & read.defined[0] & (most <= face.limit)

    def _limit(self, factors: tuple[Jet, ...], box: Ends) -> Array:
        least = np.zeros(box[0].shape[1])
        if self.slack:
            least = least + iv.decimals(np.array([self.slack]), np.array([self.slack]))[0]
            for factor in factors:
                least = np.maximum(iv.down(least * factor.value[0]), 0.0)
        return least

    def _offset(self, low: Array, high: Array, at: Ends) -> Ends:
        with np.errstate(all="ignore"):
            return iv.subtract(self.around(low, high), at)


def bends_down(bend: Ends, free: Flags) -> Flags:
    """Return whether the function is concave on each of B boxes, by interval elimination on the free variables.

    If all pivots are positive, every symmetric matrix in the interval matrix −bend is positive definite, apart from
    rows of zeros, so the function is concave.

    Args:
        bend: Hessian (n, n, B).
        free: which variables count (n, B).
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
    bounded: Flags = np.all(np.isfinite(bend[0]) & np.isfinite(bend[1]) | ~both, axis=(0, 1))
    return good & bounded

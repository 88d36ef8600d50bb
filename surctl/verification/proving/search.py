"""Branch and bound: boxes are bisected until a rule proves every box; the tree of bisections is the proof."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import arrays as iv
from surctl.certcheck.arrays import Array, Ends, Flags
from surctl.certcheck.jets import Jet
from surctl.certcheck.rules import DIMENSIONS, Face, Rules, middle
from surctl.verification.proving.tape import Tape

Paths = NDArray[np.object_]

_CHUNK = 2048
_NARROWEST = 1e-12  # least width to bisect, as a share of the root box
_NEWTON, _RESTS = 12, 1e-13  # largest number of Newton steps; step size at convergence, as a share of the box
_SNAP = 1e-12  # a point nearer to 0 than this share of the box is set to 0


@dataclass(frozen=True, eq=False)
class BoxTask:
    """The inequality to prove on a box.

    Attributes:
        rules: the inequality and its rules.
        written: instruction list of the claim as written; it shows on which boxes the claim is defined.
        box: lower and upper bounds of the root box, each (n,).
    """

    rules: Rules
    written: Tape
    box: tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The result of branch and bound.

    Attributes:
        tree: the boxes in preorder, one letter per box: a letter of `DIMENSIONS` for a bisected box, or the letter of
            the rule for a proved box.
        points: the tangent points of the boxes proved by rule `c`, in preorder.
        remaining: (n, k) lower and upper bounds of the boxes that are not proved.
        boxes: number of boxes evaluated.
        reason: reason why the search stopped; empty if all boxes are proved.
    """

    tree: str
    points: tuple[tuple[float, ...], ...]
    remaining: Ends
    boxes: int
    reason: str

    @property
    def closed(self) -> bool:
        """Whether every box is proved."""
        return not self.reason


class _Tree(NamedTuple):
    # letters and tangent points of boxes by their path: one digit for each bisection, 0 for the lower half
    letters: dict[str, str]
    points: dict[str, tuple[float, ...]]


def search(
    task: BoxTask, *, deadline: float, most: int = 200_000, progress: Callable[[int, int], None] | None = None
) -> SearchResult:
    """Bisect boxes until all are proved, the deadline has passed, or `most` boxes were evaluated.

    If the interval of the bisected variable contains 0, the interval is bisected at 0, because many claims hold with
    equality there; otherwise the interval is bisected in the middle.

    Args:
        task: the inequality to prove.
        deadline: value of `time.process_time` [s] at which the search stops.
        most: largest number of boxes to evaluate.
        progress: function that is called after each round with two numbers: boxes evaluated, and boxes not proved yet.
    """
    lower, upper = task.box
    tree = _Tree({}, {})
    low, high, paths = lower[:, None], upper[:, None], np.array([""], dtype=object)
    looked, reason, stuck = 0, "", []
    everywhere = all(task.written.run((low, high)).defined)
    while paths.size and not reason:
        parts = []
        for begin in range(0, paths.size, _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            box, ids = (low[:, rows], high[:, rows]), paths[rows]
            if time.process_time() > deadline or looked >= most:
                reason = "the time limit was reached" if looked < most else "the limit on boxes was reached"
                parts.append((box[0], box[1], ids))
                continue
            looked += ids.size
            halves, narrow = _decide(task, box, ids, tree, everywhere)
            parts.append(halves)
            stuck.append(narrow)
        low, high = (np.hstack([part[k] for part in parts]) for k in (0, 1))
        paths = np.concatenate([part[2] for part in parts])
        if progress:
            progress(looked, paths.size)
    left = [np.hstack([end, *(s[k] for s in stuck)]) for k, end in enumerate((low, high))]
    if not reason and left[0].shape[1]:
        reason = "some boxes became too small to bisect"
    if reason:
        return SearchResult("", (), (left[0], left[1]), looked, reason)
    text = "".join(letter for _, letter in sorted(tree.letters.items()))  # a path is less than those that it begins
    return SearchResult(text, tuple(at for _, at in sorted(tree.points.items())), (left[0], left[1]), looked, "")


def _decide(
    task: BoxTask, box: Ends, ids: Paths, tree: _Tree, everywhere: bool
) -> tuple[tuple[Array, Array, Paths], Ends]:
    """Record the proved boxes; return unproved boxes that are too narrow to bisect, and the halves of the others."""
    count = ids.size
    defined = np.ones(count, dtype=bool)
    if not everywhere:
        defined = np.logical_and.reduce(task.written.run(box).defined)
    verdicts = apply_rules(task.rules, box, defined)
    for k in np.flatnonzero(verdicts.rule != ""):
        tree.letters[ids[k]] = str(verdicts.rule[k])
        if verdicts.rule[k] == "c":
            tree.points[ids[k]] = tuple(float(x) for x in verdicts.points[:, k])
    at = np.flatnonzero(verdicts.rule == "")
    low, high, smear = box[0][:, at], box[1][:, at], verdicts.smear[:, at]
    dimension = _dimension(task, low, high, smear)
    narrow = dimension < 0
    left = low[:, narrow], high[:, narrow]
    low, high, dimension, own = low[:, ~narrow], high[:, ~narrow], dimension[~narrow], ids[at][~narrow]
    columns = np.arange(own.size)
    a, b = low[dimension, columns], high[dimension, columns]
    where = np.where((a < 0) & (b > 0), 0.0, middle(a, b))
    first_high, second_low = high.copy(), low.copy()
    first_high[dimension, columns] = where
    second_low[dimension, columns] = where
    tree.letters.update(zip(own, (DIMENSIONS[d] for d in dimension), strict=True))
    halves = np.hstack([low, second_low]), np.hstack([first_high, high]), np.concatenate([own + "0", own + "1"])
    return halves, left


def _dimension(task: BoxTask, low: Array, high: Array, smear: Array) -> NDArray[np.int_]:
    # −1 if no variable is wide enough
    width = task.box[1] - task.box[0]
    share = (high - low) / np.where(width > 0, width, 1.0)[:, None]
    wide = share > _NARROWEST
    # infinite derivatives may hide a variable, so the width also contributes
    score = np.where(wide, smear + 1e-3 * share, -1.0)
    dimension: NDArray[np.int_] = np.where(wide.any(axis=0), np.argmax(score, axis=0), -1)
    return dimension


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
        points[:, again] = _climbed(rules, face.among(again), points[:, again])
        good[again] = rules.tangent(face.among(again), points[:, again])
    return good, points


def _climbed(rules: Rules, face: Face, at: Array) -> Array:
    # Newton's method
    n = len(at)
    for _ in range(_NEWTON):
        jet = rules.bound.run(iv.point(at), order=2).jets[0]
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


def corners(boxes: Ends, names: Sequence[str], most: int = 3) -> list[dict[str, list[float]]]:
    """Return the largest unproved boxes as plain data: for each box, (lower, upper) by variable."""
    volume = np.prod(np.maximum(boxes[1] - boxes[0], 1e-300), axis=0)
    order = np.argsort(-volume, kind="stable")[:most]
    return [{name: [float(boxes[0][i, k]), float(boxes[1][i, k])] for i, name in enumerate(names)} for k in order]

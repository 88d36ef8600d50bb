"""Branch and bound: boxes are bisected until a rule proves every box; the tree of bisections is the proof."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.arrays import Array, Ends
from surctl.certcheck.rules import DIMENSIONS, Rules, middle
from surctl.verification.proving.rules import apply_rules
from surctl.verification.proving.tape import Tape

_CHUNK = 2048
_NARROWEST = 1e-12  # least width to bisect, as a share of the root box


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


class _Tree:
    # by the index of a box: its letter, its first child and its tangent point
    def __init__(self) -> None:
        self.letters = [""]
        self.children: dict[int, int] = {}
        self.points: dict[int, tuple[float, ...]] = {}

    def split(self, box: int, dimension: int) -> int:
        first = len(self.letters)
        self.letters[box] = DIMENSIONS[dimension]
        self.children[box] = first
        self.letters += ["", ""]
        return first

    def text(self) -> tuple[str, tuple[tuple[float, ...], ...]]:
        letters, points, stack = [], [], [0]
        while stack:
            box = stack.pop()
            letters.append(self.letters[box])
            if box in self.points:
                points.append(self.points[box])
            if box in self.children:
                first = self.children[box]
                stack += [first + 1, first]
        return "".join(letters), tuple(points)


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
    tree = _Tree()
    low, high, numbers = lower[:, None], upper[:, None], np.zeros(1, dtype=int)
    looked, reason, stuck = 0, "", []
    everywhere = all(task.written.run((low, high)).defined)
    while numbers.size and not reason:
        parts = []
        for begin in range(0, numbers.size, _CHUNK):
            rows = slice(begin, begin + _CHUNK)
            box, ids = (low[:, rows], high[:, rows]), numbers[rows]
            if time.process_time() > deadline or looked >= most:
                reason = "the time limit was reached" if looked < most else "the limit on boxes was reached"
                parts.append((box[0], box[1], ids))
                continue
            looked += ids.size
            halves, narrow = _decide(task, box, ids, tree, everywhere)
            parts.append(halves)
            stuck.append(narrow)
        low, high = (np.hstack([part[k] for part in parts]) for k in (0, 1))
        numbers = np.concatenate([part[2] for part in parts])
        if progress:
            progress(looked, numbers.size)
    left = [np.hstack([end, *(s[k] for s in stuck)]) for k, end in enumerate((low, high))]
    if not reason and left[0].shape[1]:
        reason = "some boxes became too small to bisect"
    if reason:
        return SearchResult("", (), (left[0], left[1]), looked, reason)
    text, points = tree.text()
    return SearchResult(text, points, (left[0], left[1]), looked, "")


def _decide(
    task: BoxTask, box: Ends, ids: NDArray[np.int_], tree: _Tree, everywhere: bool
) -> tuple[tuple[Array, Array, NDArray[np.int_]], Ends]:
    """Record the proved boxes; return unproved boxes that are too narrow to bisect, and the halves of the others."""
    count = ids.size
    defined = np.ones(count, dtype=bool)
    if not everywhere:
        defined = np.logical_and.reduce(task.written.run(box).defined)
    verdicts = apply_rules(task.rules, box, defined)
    for k in np.flatnonzero(verdicts.rule != ""):
        tree.letters[ids[k]] = str(verdicts.rule[k])
        if verdicts.rule[k] == "c":
            tree.points[int(ids[k])] = tuple(float(x) for x in verdicts.points[:, k])
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
    first = np.array([tree.split(int(k), int(d)) for k, d in zip(own, dimension, strict=True)], dtype=int)
    halves = np.hstack([low, second_low]), np.hstack([first_high, high]), np.concatenate([first, first + 1])
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


def corners(boxes: Ends, names: Sequence[str], most: int = 3) -> list[dict[str, list[float]]]:
    """Return the largest unproved boxes as plain data: for each box, (lower, upper) by variable."""
    volume = np.prod(np.maximum(boxes[1] - boxes[0], 1e-300), axis=0)
    order = np.argsort(-volume, kind="stable")[:most]
    return [{name: [float(boxes[0][i, k]), float(boxes[1][i, k])] for i, name in enumerate(names)} for k in order]

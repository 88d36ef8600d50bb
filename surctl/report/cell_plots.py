"""Plots of the boxes of interval proofs: boxes that prove a claim, and boxes that remain open."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.report.theme import BAD, INK, dress, legend_above, new_axes
from surctl.verification.claim import Claim, Variable
from surctl.verification.proving.cells import Cells, cells_of
from surctl.verification.verdict import Verdict

__all__ = ["plot_cells", "plot_open_boxes"]

_RULES = {
    "i": "outside the domain", "j": "outside the domain, mean value", "n": "interval value", "m": "mean value",
    "c": "concave, by a tangent", "s": "sums of squares",
}  # fmt: skip
_BESIDE = 0.507  # section as a share of the domain: not exactly the middle, where boxes meet
_COLOURS = ("#0072B2", "#009E73", "#AA4499", "#E69F00", "#56B4E9", "#5F6368")


def plot_cells(verdict: Verdict, ax: Axes | None = None) -> Axes:
    """Plot the boxes of a proved claim's certificate over the two variables that the proof bisected most often.

    If the claim has more than two variables, the plot shows a section near the middle of the other variables. If the
    proof distinguishes several cases, the plot shows the case with the most boxes.

    Raises:
        InputError: the claim is not proved, or fewer than two of its variables vary.
    """
    claim = verdict.claim
    if verdict.certificate is None:
        raise InputError("is not proved", key=f"claim {claim.name}", remedy="plot proved claims only")
    cases = cells_of(verdict.certificate)
    most = max(cases, key=lambda c: len(c.rules))
    first, second = _axes(claim, [most.lower, most.upper])
    indices = _section(most, first, second)
    ax = _dressed(claim, first, second, ax)
    letters = sorted({most.rules[k] for k in indices})
    for colour, letter in zip(_COLOURS, letters, strict=False):
        boxes = [
            Rectangle(
                (most.lower[first, k], most.lower[second, k]),
                most.upper[first, k] - most.lower[first, k],
                most.upper[second, k] - most.lower[second, k],
            )
            for k in indices
            if most.rules[k] == letter
        ]
        ax.add_collection(PatchCollection(boxes, facecolor=colour, alpha=0.35, edgecolor=INK, linewidth=0.5))
        ax.plot([], [], "s", color=colour, alpha=0.5, label=_RULES.get(letter, f"rule {letter}"))
    legend_above(ax, columns=2)
    total = sum(len(c.rules) for c in cases)
    note = f"{len(indices)} of {total} boxes lie in this section" + (
        "; this case has the most boxes" if len(cases) > 1 else ""
    )
    ax.text(0.0, -0.2, note, transform=ax.transAxes, fontsize=8, color=INK)
    return ax


def plot_open_boxes(verdict: Verdict, ax: Axes | None = None) -> Axes:
    """Plot all boxes that an attempted proof left open, projected onto two variables.

    Raises:
        InputError: no box is open, or fewer than two variables of the claim vary.
    """
    claim, boxes = verdict.claim, verdict.open_boxes
    if not boxes:
        raise InputError("has no open boxes", key=f"claim {claim.name}", remedy="plot undecided claims only")
    ends = [np.array([[box[v.name][k] for box in boxes] for v in claim.variables]) for k in (0, 1)]
    first, second = _axes(claim, ends)
    ax = _dressed(claim, first, second, ax)
    patches = [
        Rectangle((ends[0][first, k], ends[0][second, k]), *(ends[1][i, k] - ends[0][i, k] for i in (first, second)))
        for k in range(len(boxes))
    ]
    ax.add_collection(PatchCollection(patches, facecolor=BAD, alpha=0.4, edgecolor=BAD, linewidth=0.7))
    ax.legend(
        handles=[Patch(facecolor=BAD, alpha=0.4, label=f"the {len(boxes)} largest open boxes")], fontsize=8,
        frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2,
    )  # fmt: skip
    return ax


def _axes(claim: Claim, ends: Sequence[NDArray[np.float64]]) -> tuple[int, int]:
    """Return the indices of the two variables in which the boxes are narrowest relative to the domain."""
    width = np.maximum(claim.upper - claim.lower, 1e-300)
    free = [k for k, v in enumerate(claim.variables) if v.upper > v.lower]
    if len(free) < 2:
        raise InputError(
            "has fewer than two variables that vary",
            key=f"claim {claim.name}",
            remedy="there is no picture; the certificate lists its boxes",
        )
    share = np.mean((ends[1] - ends[0]) / width[:, None], axis=1)
    first, second = sorted(sorted(free, key=lambda k: float(share[k]))[:2])
    return first, second


def _section(cells: Cells, first: int, second: int) -> list[int]:
    """Return the indices of the boxes that the section near the middle of all other variables cuts."""
    low, high = cells.lower.min(axis=1), cells.upper.max(axis=1)
    centre = low + _BESIDE * (high - low)
    others = [k for k in range(len(centre)) if k not in (first, second)]
    inside = np.all(
        (cells.lower[others] <= centre[others, None]) & (centre[others, None] <= cells.upper[others]), axis=0
    )
    return [int(k) for k in np.flatnonzero(inside)]


def _dressed(claim: Claim, first: int, second: int, ax: Axes | None) -> Axes:
    one, other = claim.variables[first], claim.variables[second]
    ax = dress(ax or new_axes(5.4, 4.4), x=_title(one), y=_title(other))
    ax.set_xlim(one.lower, one.upper)
    ax.set_ylim(other.lower, other.upper)
    return ax


def _title(variable: Variable) -> str:
    return variable.name if variable.unit == "1" else f"{variable.name} [{variable.unit}]"

"""Plots about one claim: counterexample and replay, boxes left open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.report.theme import AVOIDING, BAD, INK, ROBOT, curve, dress, legend_above, new_axes
from surctl.verification.claim import Claim, Variable
from surctl.verification.counterexample import Counterexample, Oracle, Replay, build_oracle, replay
from surctl.verification.verdict import Verdict

_CELLS = 121
_PROBES = 61


@dataclass(frozen=True, eq=False)
class MarginSlice:
    """A claim's margin over two variables near a counterexample; all other variables are constant.

    Attributes:
        claim: the claim.
        point: the counterexample.
        one, other: the variables along the two axes of the plane.
        x: (m,) values of `one`.
        y: (n,) values of `other`.
        margin: (n, m) left side − right side of the claim, positive where the claim fails; NaN outside the claim's
            domain.
    """

    claim: Claim
    point: Counterexample
    one: Variable
    other: Variable
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    margin: NDArray[np.float64]


def margin_slice(verdict: Verdict) -> MarginSlice:
    """Return the margin near a verdict's counterexample over the two most influential variables.

    The influence of a variable is the range of the margin while only this variable changes from its value at the
    counterexample. Before the comparison, margins are limited from below to −(margin at the counterexample), so that
    values far from the counterexample do not dominate.

    Raises:
        InputError: the verdict has no counterexample, or fewer than two variables can vary.

    Example:
        >>> from surctl.report import margin_slice
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import falsify
        >>> [claim] = claims(names=["v1-printed"])
        >>> verdict = falsify(claim, samples=256, starts=2)
        >>> cut = margin_slice(verdict)
        >>> cut.one.name, cut.other.name, cut.margin.shape, round(float(cut.margin.max()), 1)
        ('x_e', 'y_e', (121, 121), 4.8)
    """
    claim, point = verdict.claim, _counterexample(verdict)
    oracle = build_oracle(claim)
    here = claim.point(point.values)
    free = [k for k, v in enumerate(claim.variables) if v.upper > v.lower]
    if len(free) < 2:
        raise InputError(
            "has fewer than two variables that vary", key=f"claim {claim.name}", remedy="plot its replay instead"
        )
    first, second = sorted(sorted(free, key=lambda k: -_influence(oracle, here, k))[:2])
    one, other = claim.variables[first], claim.variables[second]
    x, y = np.linspace(one.lower, one.upper, _CELLS), np.linspace(other.lower, other.upper, _CELLS)
    points = np.tile(here[:, None], (1, _CELLS * _CELLS))
    points[first], points[second] = (grid.ravel() for grid in np.meshgrid(x, y))
    return MarginSlice(claim, point, one, other, x, y, _inside(oracle, points).reshape(_CELLS, _CELLS))


def _counterexample(verdict: Verdict) -> Counterexample:
    if verdict.counterexample is None:
        raise InputError(
            "has no counterexample to show", key=f"claim {verdict.claim.name}", remedy="plot refuted claims only"
        )
    return verdict.counterexample


def _inside(oracle: Oracle, points: NDArray[np.float64]) -> NDArray[np.float64]:
    margin, _, inside = oracle.evaluate(points)
    return np.where(inside & np.isfinite(margin), margin, np.nan)


def _influence(oracle: Oracle, here: NDArray[np.float64], k: int) -> float:
    variable = oracle.claim.variables[k]
    points = np.tile(here[:, None], (1, _PROBES))
    points[k] = np.linspace(variable.lower, variable.upper, _PROBES)
    margin = _inside(oracle, points)
    depth = float(_inside(oracle, here[:, None])[0])
    known = np.maximum(margin[np.isfinite(margin)], -abs(depth))
    # rounded, so that variables of equal influence keep their order in the claim
    return round(float(np.ptp(known)) / max(abs(depth), 1e-300), 3) if known.size else 0.0


def plot_counterexample(verdict: Verdict, ax: Axes | None = None) -> Axes:
    """Plot the counterexample's replay over time if the claim bounds a rate, otherwise the slice of the margin.

    Raises:
        InputError: the verdict has no counterexample.

    Example:
        >>> from surctl.report import plot_counterexample
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import falsify
        >>> [claim] = claims(names=["v1-printed"])
        >>> verdict = falsify(claim, samples=256, starts=2)
        >>> ax = plot_counterexample(verdict)
        >>> ax.get_xlabel(), ax.get_ylabel(), [text.get_text() for text in ax.get_legend().get_texts()]
        ('time from the counterexample [s]', 'V1 [m^2]', ['most that the claim allows', 'V1, replayed'])
    """
    point = _counterexample(verdict)
    if verdict.claim.motion is None:
        return plot_slice(margin_slice(verdict), ax)
    return plot_replay(verdict, replay(verdict.claim, point), ax)


def plot_replay(verdict: Verdict, trajectory: Replay, ax: Axes | None = None) -> Axes:
    """Plot the quantity whose rate the claim bounds along the replayed motion, and its bound by the claim.

    Raises:
        InputError: the verdict has no counterexample, or the replay has no motion.
    """
    claim, point = verdict.claim, _counterexample(verdict)
    if trajectory.time.size == 0:
        raise InputError("has no motion", key=f"claim {claim.name}", remedy="plot the slice of its margin instead")
    ax = dress(ax or new_axes(5.1, 3.7), x="time from the counterexample [s]")
    ax.set_ylabel(f"{trajectory.name} [{trajectory.unit}]", fontsize=9.5, color=INK, parse_math=False, wrap=True)
    sense = _sense(claim, claim.point(point.values))
    if sense:
        bound = trajectory.watched - sense * trajectory.excess
        word = "most" if sense > 0 else "least"
        curve(ax, trajectory.time, bound, label=f"{word} that the claim allows", k=1)
        ax.fill_between(trajectory.time, bound, trajectory.watched, color=AVOIDING, alpha=0.15, linewidth=0)
    curve(ax, trajectory.time, trajectory.watched, label=f"{trajectory.name}, replayed", k=0)
    if trajectory.time[-1] > 0:
        ax.set_xlim(0.0, float(trajectory.time[-1]))
    legend_above(ax, columns=2 if len(trajectory.name) <= 25 else 1)
    return ax


def _sense(claim: Claim, here: NDArray[np.float64]) -> int:
    """Return +1 if the claim's left side is the rate of the plotted quantity, −1 if minus this rate, otherwise 0.

    The left side and the rate are compared at the counterexample. A left side that is the maximum over two turning
    directions equals the rate for only one direction.
    """
    if claim.motion is None:
        return 0
    x = claim.symbols
    moving = ca.vertcat(*[claim.motion.rates.get(v.name, ca.SX(0)) for v in claim.variables])
    rate = ca.jtimes(ca.SX(claim.motion.watched), x, moving)
    sides = ca.Function("sides", [x], [ca.densify(rate), ca.densify(ca.SX(claim.left))])
    speed, left = (float(side) for side in sides(here))
    return next((sign for sign in (1, -1) if np.isclose(left, sign * speed, rtol=1e-6, atol=1e-12)), 0)


def plot_slice(cut: MarginSlice, ax: Axes | None = None) -> Axes:
    """Plot where and by how much the claim fails near the counterexample; points outside the domain are white.

    Example:
        >>> from surctl.report import margin_slice, plot_slice
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import falsify
        >>> [claim] = claims(names=["v1-printed"])
        >>> verdict = falsify(claim, samples=256, starts=2)
        >>> ax = plot_slice(margin_slice(verdict))
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('x_e [m]', 'y_e [m]')
    """
    ax = dress(ax or new_axes(5.1, 3.7), x=_title(cut.one), y=_title(cut.other))
    ax.grid(visible=False)
    known = cut.margin[np.isfinite(cut.margin)]
    # the largest violation sets the colour range: how well the claim holds elsewhere matters less
    size = float(np.max(known, initial=0.0)) or float(np.max(np.abs(known), initial=0.0)) or 1.0
    image = ax.pcolormesh(
        cut.x, cut.y, np.ma.masked_invalid(cut.margin), cmap="PuOr_r", vmin=-size, vmax=size, shading="nearest",
        rasterized=True,
    )  # fmt: skip
    bar = ax.figure.colorbar(image, ax=ax, extend="min" if np.min(known, initial=0.0) < -size else "neither")
    bar.set_label(f"left − right [{cut.claim.unit}]: above 0 the claim fails", fontsize=8.5, color=INK, wrap=True)
    bar.ax.tick_params(labelsize=8.5)
    if known.size and known.min() < 0 < known.max():
        ax.contour(cut.x, cut.y, np.ma.masked_invalid(cut.margin), levels=[0.0], colors=INK, linewidths=1.4)
        ax.plot([], [], color=INK, linewidth=1.4, label="boundary")
    at = (cut.point.values[cut.one.name], cut.point.values[cut.other.name])
    ax.plot(
        *at, marker="X", color=ROBOT, markersize=11, markeredgecolor="white", linestyle="none", clip_on=False,
        zorder=5, label="counterexample",
    )  # fmt: skip
    legend_above(ax, columns=2)
    return ax


def _title(variable: Variable) -> str:
    return variable.name if variable.unit == "1" else f"{variable.name} [{variable.unit}]"


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
        remedy = "there is no picture; the certificate lists its boxes"
        raise InputError("has fewer than two variables that vary", key=f"claim {claim.name}", remedy=remedy)
    share = np.mean((ends[1] - ends[0]) / width[:, None], axis=1)
    first, second = sorted(sorted(free, key=lambda k: float(share[k]))[:2])
    return first, second


def _dressed(claim: Claim, first: int, second: int, ax: Axes | None) -> Axes:
    one, other = claim.variables[first], claim.variables[second]
    ax = dress(ax or new_axes(5.4, 4.4), x=_title(one), y=_title(other))
    ax.set_xlim(one.lower, one.upper)
    ax.set_ylim(other.lower, other.upper)
    return ax

"""Plots of a region of attraction in planes of two states: level sets, vector field and solutions from the boundary."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import combinations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from surctl.lyapunov import Dynamics
from surctl.report.theme import AVOIDING, GOOD, INK, MUTED, ROBOT, dress, grid_of, head
from surctl.system.plant import runge_kutta
from surctl.verification.formula import Node

Array = NDArray[np.float64]

_MOST_PLANES = 6
_GRID = 121
_ARROWS = 15  # of the vector field, along each side
_STARTS = 16  # solutions drawn from the boundary
_STEPS = 600
_TURN = 0.02  # step of a drawn solution, as a share of the box over the largest rate


def plot_motion(dynamics: Dynamics, function: Node, *, level: float, falsified: float | None = None) -> Figure:
    """Plot the region V < level in every plane of two states, with all other states at the equilibrium.

    The planes are those of the first states, at most six. Arrows show the vector field in the plane (continuous time),
    or the change over a control period if the dynamics have a sampled form. Grey lines are solutions that start on the
    boundary of the region in the plane; with more than two states, they leave the plane, and the plot shows their
    projection.

    Args:
        dynamics: the dynamics; parameters have the middle of their ranges. The sampled form, if any, is plotted.
        function: V, an expression of the states.
        level: level of the region.
        falsified: least level at which the claim is known to fail, an upper limit; drawn as a dashed line.

    Example:
        >>> from surctl.lyapunov import Dynamics, State
        >>> from surctl.report import plot_motion
        >>> from surctl.verification.formula import parse, variable
        >>> k = {name: variable(name) for name in ("x", "y")}
        >>> rates = tuple(parse(text, k) for text in ("-y", "x - (1 - x^2)*y"))
        >>> states = (State("x", -3.0, 3.0, "m"), State("y", -3.0, 3.0, "m/s"))
        >>> van_der_pol = Dynamics("van-der-pol", "continuous", states, rates)
        >>> figure = plot_motion(van_der_pol, parse("1.5*x^2 - x*y + y^2", k), level=2.2, falsified=2.3)
        >>> [ax.get_xlabel() for ax in figure.axes]
        ['x [m]']
    """
    planes = list(combinations(range(len(dynamics.states)), 2))[:_MOST_PLANES] or [(0, 0)]
    axes = grid_of(len(planes), most=3, size=(4.4, 3.9), extra=0.9)
    for ax, plane in zip(axes, planes, strict=True):
        if plane == (0, 0):
            _line(ax, dynamics, function, level, falsified)
        else:
            _plane(ax, dynamics, function, plane, level, falsified)
    figure, columns = axes[0].figure.figure, min(len(planes) + 1, 3)
    head(figure, f"{dynamics.name}: certified region")
    handles = [
        Line2D([], [], color=GOOD, lw=1.8, label=f"V = {level:.4g}, certified"),
        Line2D([], [], color=MUTED, lw=0.8, label="solutions from the boundary"),
    ]
    if falsified is not None:
        handles.insert(1, Line2D([], [], color=AVOIDING, lw=1.4, ls="--", label=f"V = {falsified:.4g}, upper limit"))
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, fontsize=8.5, frameon=False)
    return figure


def _plane(
    ax: Axes, dynamics: Dynamics, function: Node, plane: tuple[int, int], level: float, falsified: float | None
) -> None:
    i, j = plane
    low, high = dynamics.box
    a, b = np.linspace(low[i], high[i], _GRID), np.linspace(low[j], high[j], _GRID)
    points = np.repeat(dynamics.equilibrium[:, None], _GRID * _GRID, axis=1)
    points[i], points[j] = (mesh.reshape(-1) for mesh in np.meshgrid(a, b))
    values = _values(dynamics, function, points).reshape(_GRID, _GRID)
    dress(ax, x=_label(dynamics, i), y=_label(dynamics, j))
    ax.grid(visible=False)
    ax.locator_params(axis="x", nbins=7)  # more numbers of three decimals touch each other
    if not dynamics.discrete:
        few, after = np.arange(_GRID)[_GRID // (2 * _ARROWS) :: _GRID // _ARROWS], _after(dynamics)
        x = points.reshape(-1, _GRID, _GRID)[:, few[:, None], few].reshape(len(points), -1)
        rates = dynamics.evaluate(x) if after is None else after(x) - x
        u, v = rates[[i, j]].reshape(2, len(few), -1) / (high - low)[[i, j], None, None]
        size = np.maximum(np.hypot(u, v), 1e-12)
        ax.quiver(a[few], b[few], u / size, v / size, angles="uv", pivot="mid", color=ROBOT, scale=26, width=0.004)
    ax.contourf(a, b, values, levels=[-np.inf, level], colors=[GOOD], alpha=0.12)
    boundary = ax.contour(a, b, values, levels=[level], colors=[GOOD], linewidths=1.8)
    if falsified is not None:
        ax.contour(a, b, values, levels=[falsified], colors=[AVOIDING], linewidths=1.4, linestyles="--")
    around = np.vstack([np.zeros((0, 2)), *[np.asarray(path.vertices) for path in boundary.get_paths()]])
    if around.size:
        around = around[:: max(1, len(around) // _STARTS)]
        start = np.repeat(dynamics.equilibrium[:, None], len(around), axis=1)
        start[i], start[j] = around.T
        paths = _solutions(dynamics, start)
        for path in paths.transpose(2, 0, 1):
            ax.plot(path[:, i], path[:, j], color=MUTED, lw=0.8, marker="." if dynamics.discrete else "", ms=3.0)
    ax.plot(*dynamics.equilibrium[[i, j]], "o", color=INK, ms=3.5)
    ax.set_xlim(low[i], high[i])
    ax.set_ylim(low[j], high[j])


def _line(ax: Axes, dynamics: Dynamics, function: Node, level: float, falsified: float | None) -> None:
    """Plot V over the only state."""
    a = np.linspace(float(dynamics.box[0, 0]), float(dynamics.box[1, 0]), _GRID)
    ax.plot(a, _values(dynamics, function, a[None]), color=INK, lw=1.4)
    ax.axhline(level, color=GOOD, lw=1.8)
    if falsified is not None:
        ax.axhline(falsified, color=AVOIDING, lw=1.4, ls="--")
    dress(ax, x=_label(dynamics, 0), y="V")


def _values(dynamics: Dynamics, function: Node, points: Array) -> Array:
    nominal = np.repeat(dynamics.ranges.mean(axis=0)[:, None], points.shape[1], axis=1)
    return np.asarray(dynamics.compiled(function)(points, nominal)).reshape(-1)


def _solutions(dynamics: Dynamics, start: Array) -> Array:
    """Return solutions (steps, n, N) from the states (n, N); a solution ends where it leaves the box by far."""
    low, high = dynamics.box
    after, path = _after(dynamics), [start]
    if after is None:
        rates = np.abs(dynamics.evaluate(start)) / (high - low)[:, None]
        step = _TURN / max(float(rates[np.isfinite(rates)].max(initial=1e-9)), 1e-9)
        after = partial(runge_kutta, lambda x, _: dynamics.evaluate(x), h=step)
    for _ in range(_STEPS // 10 if dynamics.discrete else _STEPS):
        path.append(_inside(after(path[-1]), low, high))
    return np.array(path)


def _after(dynamics: Dynamics) -> Callable[[Array], Array] | None:
    """Return the map from states (n, N) to those at the next instant; None for continuous time."""
    if dynamics.sampling is None:
        return dynamics.evaluate if dynamics.discrete else None
    middle = dynamics.ranges.mean(axis=0)
    return lambda x: np.asarray(dynamics.held(x, middle))


def _inside(x: Array, low: Array, high: Array) -> Array:
    width = (high - low)[:, None]
    far = np.any(~np.isfinite(x) | (x < low[:, None] - width) | (x > high[:, None] + width), axis=0)
    return np.where(far, np.nan, x)


def _label(dynamics: Dynamics, k: int) -> str:
    state = dynamics.states[k]
    return f"{state.name} [{state.unit}]"

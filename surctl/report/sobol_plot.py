"""Bars of Sobol' indices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from surctl.report.theme import AVOIDING, INK, MUTED, ROBOT, dress, legend_below, new_axes, printable, save_figure
from surctl.tuning import SobolIndices

__all__ = ["plot_sobol_indices", "save_sobol_plot"]


def plot_sobol_indices(result: SobolIndices, ax: Axes | None = None) -> Axes:
    """Plot the first-order and total Sobol' indices of each parameter with their confidence intervals.

    Args:
        result: the Sobol' indices.
        ax: axes to draw in.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Cost, Plant, System
        >>> from surctl.tuning import parse_axis, saltelli, sobol_indices, sweep_system
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart", 1.0), Port("force", (1,), "m/s^2", "over the mass")
        >>> cart = Plant("cart", Layout((speed,)), Layout((force,)), lambda x, f, d, p: {"speed": f["force"]})
        >>> gain = Layout((Port("k", (1,), "1/s", "gain", 1.0),))
        >>> brake = Controller(
        ...     "brake", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -p["k"] * u["speed"], gains=gain
        ... )
        >>> system = System(cart, brake, costs={"way": Cost(lambda s: s.x["speed"], "integral", "m")})
        >>> design = saltelli([parse_axis("k=1..2"), parse_axis("start.speed=0.9..1.1")], base=16)
        >>> way = sweep_system(system, design, 5.0).mean("way")
        >>> ax = sobol_indices(design, way, "way").plot()
        >>> ax.get_title("left"), ax.get_xlabel(), [label.get_text() for label in ax.get_yticklabels()]
        ('What way depends on', 'share of the variance [1]', ['k', 'start.speed'])
    """
    ax = ax or new_axes(6.4, 1.5 + 0.55 * len(result.axes))
    title = f"What {result.column} depends on"
    dress(ax, title=f"{title}: it is constant" if result.constant else title, x="share of the variance [1]")
    at = np.arange(len(result.axes))[::-1]
    series = (
        ("alone (first order)", result.first, result.first_interval, ROBOT, 0.19, None),
        ("with others (total order)", result.total, result.total_interval, AVOIDING, -0.19, "///"),
    )
    for label, values, intervals, colour, offset, hatch in series:
        heights = np.array(values)
        ax.barh(
            at + offset, heights, 0.34, color="white" if hatch else colour, edgecolor=colour, hatch=hatch, label=label
        )
        # a bootstrap interval need not contain the estimate
        errors = np.abs(np.array(intervals).T - heights)
        ax.errorbar(heights, at + offset, xerr=errors, fmt="none", ecolor=INK, elinewidth=1.1, capsize=2.5)
    ax.set_yticks(at, [printable(name) for name in result.axes])
    ends = [v for pair in (*result.first_interval, *result.total_interval) for v in pair]
    ax.set_xlim(min(0.0, *ends) - 0.02, max(1.0, *ends) + 0.02)
    ax.axvline(0.0, color=MUTED, linewidth=0.8)
    handles, _ = ax.get_legend_handles_labels()
    legend_below(ax, columns=2, handles=handles)
    return ax


def save_sobol_plot(result: SobolIndices, folder: Path) -> Path:
    """Write the plot of Sobol' indices as a PNG; return its path. InputError if the folder cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from surctl.report import save_sobol_plot
        >>> from surctl.tuning import SobolIndices
        >>> indices = SobolIndices("way", ("k",), (0.7,), (0.8,), ((0.6, 0.8),), ((0.7, 0.9),), False, 9)
        >>> save_sobol_plot(indices, Path("pictures")).name
        'sensitivity-way.png'
    """
    return save_figure(plot_sobol_indices(result).figure.figure, folder, ("sensitivity", result.column))

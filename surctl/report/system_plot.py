"""Plots of a recorded run of any system over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from surctl.ir import Layout
from surctl.report.pictures import save_figure
from surctl.report.theme import BAD, curve, dress, head, legend_above, new_figure
from surctl.system import Record, entry_labels, entry_units

__all__ = ["plot_record", "save_record_plot"]

_NONE: Mapping[str, tuple[float, float]] = MappingProxyType({})


def plot_record(record: Record, *, limits: Mapping[str, tuple[float, float]] = _NONE) -> Figure:
    """Plot all states, commands and references of a run over one time axis; each plot has signals of one unit.

    Args:
        record: the run.
        limits: lower and upper limit of signals by name, which are drawn as lines; what lies outside is shaded.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.report import plot_record
        >>> from surctl.system import Controller, Plant, System, run_system
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart", 1.0), Port("force", (1,), "m/s^2", "over the mass")
        >>> cart = Plant("cart", Layout((speed,)), Layout((force,)), lambda x, f, d, p: {"speed": f["force"]})
        >>> brake = Controller("brake", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -u["speed"])
        >>> [ax.get_ylabel() for ax in plot_record(run_system(System(cart, brake), 2.0)).axes]
        ['speed [m/s]', 'force [m/s^2]']
    """
    groups = _groups(record)
    figure = new_figure(8.5, 1.0 + 1.8 * len(groups))
    system = record.system
    head(
        figure,
        f"{system.plant.name} under {system.controller.name}, ended after {record.duration:g} s ({record.stopped})",
    )
    axes = figure.subplots(len(groups), 1, sharex=True, squeeze=False)[:, 0]
    for ax, (name, unit, lines) in zip(axes, groups, strict=True):
        for k, (label, values, held) in enumerate(lines):
            curve(ax, record.time, values, label=label, k=k)
            if held:
                ax.lines[-1].set_drawstyle("steps-post")
            if len(values) == 1:
                ax.lines[-1].set_marker("o")
        if name in limits:
            _draw_limits(ax, limits[name])
        dress(ax, y=f"{name} [{unit}]", x="time [s]" if ax is axes[-1] else "")
        if len(lines) > 1:
            legend_above(ax)
    return figure


def _draw_limits(ax: Axes, limits: tuple[float, float]) -> None:
    low, high = ax.get_ylim()
    space = 0.08 * (limits[1] - limits[0])
    low, high = min(low, limits[0] - space), max(high, limits[1] + space)
    for end, limit in ((low, limits[0]), (high, limits[1])):
        ax.axhspan(min(end, limit), max(end, limit), color=BAD, alpha=0.1, linewidth=0)
        ax.axhline(limit, color=BAD, linewidth=1.2)
    ax.set_ylim(low, high)


_Line = tuple[str, NDArray[np.float64], bool]


def _groups(record: Record) -> list[tuple[str, str, list[_Line]]]:
    """Return (signal, unit, lines) of each plot; lines of commands are constant between control instants."""
    commands = record.ports("command")
    groups: dict[tuple[str, str], list[_Line]] = {}
    for name, port in record.ports("state", "command", "reference").items():
        alone = Layout((port,))
        entries = zip(entry_labels(alone), entry_units(alone), record.signals[name].T, strict=True)
        for label, unit, values in entries:
            groups.setdefault((name, unit), []).append((label, values, name in commands))
    return [(name, unit, lines) for (name, unit), lines in groups.items()]


def save_record_plot(record: Record, folder: Path | str, *, name: str) -> Path:
    """Write the plot of `plot_record` as the PNG with this name; return its path.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from surctl.ir import Layout, Port
        >>> from surctl.report import save_record_plot
        >>> from surctl.system import Controller, Plant, System, run_system
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart", 1.0), Port("force", (1,), "m/s^2", "over the mass")
        >>> cart = Plant("cart", Layout((speed,)), Layout((force,)), lambda x, f, d, p: {"speed": f["force"]})
        >>> brake = Controller("brake", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -u["speed"])
        >>> print(save_record_plot(run_system(System(cart, brake), 2.0), "pictures", name="cart").name)
        cart.png
    """
    return save_figure(plot_record(record), folder, (name,))

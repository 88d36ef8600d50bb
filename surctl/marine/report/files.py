"""Pictures that commands write (`--out`): margins, verdicts, runs, tunings; phase portraits of a region."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from surctl.marine.control import Gains, Law
from surctl.marine.report.goals import goal_bars, plot_front, plot_goal_bars
from surctl.marine.report.margin_plots import plot_disk_margins
from surctl.marine.report.plan_view import plot_run
from surctl.marine.report.signals import plot_run_signals
from surctl.marine.simulation import Run
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification import law_loop
from surctl.marine.verification.portrait import Portrait, planes_of, portrait
from surctl.report.evidence import margin_slice, plot_counterexample, plot_open_boxes, plot_slice
from surctl.report.page_parts import plot_tightest
from surctl.report.theme import (
    AVOIDING,
    GOOD,
    INK,
    MUTED,
    ROBOT,
    dress,
    legend_below,
    new_axes,
    new_figure,
    save_figure,
)
from surctl.tuning import Tuning
from surctl.verification import Verdict
from surctl.verification.sampled_margins import open_loop

# The plots that `surctl verify --out` writes: margins, refuted claims, boxes of proofs, and regions


_LABELS = {
    "along": ("along the path, x_e from its equilibrium [m]", "velocity along it [m/s]"),
    "across": ("across the path, y_e [m]", "velocity across it [m/s]"),
    "place": ("along the path, x_e from its equilibrium [m]", "across the path, y_e [m]"),
    "turning": ("heading against the path, ψ [rad]", "yaw rate [rad/s]"),
    "steering": ("across the path, y_e [m]", "heading against the path, ψ [rad]"),
}
_STILL = ("place", "steering")  # planes of positions: the velocities are 0 in them, so there is no flow
_EXTENT = 1.9  # half-width of the picture, in half-axes of the ellipse V = 1
_MOST_LEVEL = 16.0  # a higher level would make the certified one too small
_ARROWS = 15  # number of flow arrows along each side of the plot


def plot_region(document: Mapping[str, Any], *, falsified: float | None = None) -> Figure:
    """Plot phase portraits of a region certificate in all its planes, side by side.

    Args:
        document: the certificate, in which V = 1 is the certified level.
        falsified: the least level of V with a counterexample, which is drawn too; None for none.

    Raises:
        InputError: the certificate is not a region certificate.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import plot_region
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.region import prove_statement, region_statement
        >>> statement = region_statement("region-cruise-20").model_copy(update={"attempts": 1})
        >>> proof = prove_statement(statement, load_vehicle("sur540-flooded"), load_gains("default"))
        >>> figure = plot_region(proof.certificate())
        >>> [ax.get_ylabel() for ax in figure.axes]
        ['velocity along it [m/s]', 'velocity across it [m/s]', 'across the path, y_e [m]']
    """
    shown = falsified is not None and falsified <= _MOST_LEVEL
    extent = max(_EXTENT, 1.1 * np.sqrt(falsified)) if falsified is not None and shown else _EXTENT
    portraits = [portrait(document, plane, extent=extent) for plane in planes_of(document)]
    figure = new_figure(4.4 * len(portraits), 4.9)
    for ax, one in zip(figure.subplots(1, len(portraits)), portraits, strict=True):
        plot_portrait(one, ax)
        if shown:
            ax.contour(one.x, one.y, one.level, levels=[falsified], colors=[AVOIDING], linewidths=1.6, linestyles=":")
    handles = _handles(portraits[0])
    if falsified is not None:
        where = "" if shown else ", outside of the picture"
        label = f"least level with a counterexample: V = {falsified:.3g}{where}"
        handles.insert(1, Line2D([], [], color=AVOIDING, linewidth=1.6, linestyle=":", label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8.5, frameon=False)
    return figure


def plot_portrait(one: Portrait, ax: Axes | None = None) -> Axes:
    """Plot one phase portrait: level sets of the Lyapunov function, points where the certified rate fails, and flow."""
    alone = ax is None
    ax = dress(ax or new_axes(5.1, 4.9), x=_LABELS[one.plane][0], y=_LABELS[one.plane][1])
    ax.grid(visible=False)
    ax.locator_params(nbins=6)
    if not one.lagged:
        fails = np.where(one.level > one.levels[0], one.excess, -np.inf) > 0
        ax.contourf(one.x, one.y, fails.astype(float), levels=[0.5, 1.5], colors=[AVOIDING], alpha=0.28)
        if one.plane not in _STILL:
            step = max(1, len(one.x) // _ARROWS)
            pick = slice(step // 2, None, step)
            u, v = one.flow[:, pick, pick]
            size = np.maximum(np.hypot(u / np.ptp(one.x), v / np.ptp(one.y)), 1e-12)
            ax.quiver(
                one.x[pick], one.y[pick], u / np.ptp(one.x) / size, v / np.ptp(one.y) / size, angles="uv", pivot="mid",
                color=MUTED, scale=26, width=0.0045, zorder=2,
            )  # fmt: skip
    ax.contourf(one.x, one.y, one.level, levels=[one.levels[0], 1.0], colors=[GOOD], alpha=0.16)
    ax.contour(one.x, one.y, one.level, levels=[1.0], colors=[GOOD], linewidths=2.0)
    if len(one.levels) > 2:
        ax.contour(one.x, one.y, one.level, levels=list(one.levels[1:-1]), colors=[GOOD], linewidths=0.7)
    if one.levels[0] > 0:
        ax.contour(one.x, one.y, one.level, levels=[one.levels[0]], colors=[ROBOT], linewidths=1.4, linestyles="--")
    ax.plot(0, 0, marker="+", color=INK, markersize=9)
    if one.plane == "place":
        ax.set_aspect("equal", adjustable="datalim")
    if alone:
        legend_below(ax, columns=2, handles=_handles(one))
    return ax


def _handles(one: Portrait) -> list[Artist]:
    shells = ", with inner level sets" if len(one.levels) > 2 else ""
    handles: list[Artist] = [Line2D([], [], color=GOOD, linewidth=2.0, label=f"certified: V = 1{shells}")]
    if one.levels[0] > 0:
        handles.append(
            Line2D([], [], color=ROBOT, linewidth=1.4, linestyle="--", label="floor of V: rate certified above")
        )
    if one.lagged:
        return [*handles, Line2D([], [], linestyle="none", label="flow and failures are not shown: thrust lag")]
    handles.append(Patch(facecolor=AVOIDING, alpha=0.28, label="rate fails for some vehicle and heading"))
    if one.plane not in _STILL:
        handles.append(Line2D([], [], color=MUTED, marker=r"$\rightarrow$", linestyle="none", markersize=11,
                           label="direction of the nominal flow"))  # fmt: skip
    return handles


def save_margins(
    law: Law, vehicle: Vehicle, gains: Gains, folder: Path | str, *, cruise: float | Sequence[float]
) -> list[Path]:
    r"""Write PNGs of the loops that tolerate the least delay, and of the disk margins of all loops; return the paths.

    With several cruise speeds [m/s], the loops are plotted at each speed, and opened where the loop at the largest one
    is tightest. An unstable loop has no disk margin.

    Raises:
        InputError: see `law_loop`; or the folder cannot be written.
    """
    speeds = sorted((float(speed) for speed in np.atleast_1d(cruise)), reverse=True)
    loops = [law_loop(law, vehicle, gains, cruise=u) for u in speeds]
    figures = plot_tightest({f"{u:g} m/s": loop.linear for u, loop in zip(speeds, loops, strict=True)})
    if loops[0].stable:
        linear = loops[0].linear
        opened = [open_loop(linear, *signals) for signals in linear.places.values()]
        figures["disk"] = plot_disk_margins(list(zip(opened, loops[0].disks, strict=True)), highest=np.pi / law.dt)
    return [save_figure(figure, folder, ("margins", vehicle.name, name)) for name, figure in figures.items()]


def save_verdicts(verdicts: Sequence[Verdict], folder: Path | str) -> list[Path]:
    """Write PNGs for each claim: a counterexample, or the undecided boxes; return the paths.

    Raises:
        InputError: the folder cannot be written.
    """
    saved = []
    for verdict in verdicts:
        for name, figure in _pictures(verdict).items():
            saved.append(save_figure(figure, folder, (verdict.claim.name, name)))
    return saved


def _pictures(verdict: Verdict) -> dict[str, Figure]:
    figures: dict[str, Figure] = {}
    varying = sum(v.upper > v.lower for v in verdict.claim.variables)
    if verdict.counterexample is not None:
        if verdict.claim.motion is not None:
            figures["replay"] = plot_counterexample(verdict).figure.figure
        if varying >= 2:
            figures["slice"] = plot_slice(margin_slice(verdict)).figure.figure
    elif varying >= 2 and verdict.open_boxes:
        figures["open"] = plot_open_boxes(verdict).figure.figure
    return figures


def save_run(run: Run, folder: Path | str) -> Path:
    """Write plan view and signals of a run as one PNG, named after the run; return the path of the PNG.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.report import save_run
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law, gains = build_law("closed_form"), load_gains("default")
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=gains, law=law)
        >>> print(save_run(run, "pictures").name)
        pool-behind-sur400-closed_form-corrected-nsb-truth-seed0.png
    """
    length, width, _ = run.scenario.site
    plan_height = min(max(8.2 * width / length + 1.5, 3.6), 7.6)
    figure = new_figure(9.8, plan_height + 7.0)
    halves = figure.add_gridspec(2, 1, height_ratios=[plan_height, 7.0])
    plot_run(run, figure.add_subfigure(halves[0]).add_subplot())
    plot_run_signals(run, figure.add_subfigure(halves[1]).subplots(3, 2, sharex=True).ravel().tolist())
    return save_figure(figure, folder, run_labels(run))


def run_labels(run: Run) -> tuple[str, ...]:
    """Return the parts of the name of a run's pictures."""
    law = run.law.name.removeprefix("surctl_")  # an identifier, also if the law is of the user's own
    how = (law, run.law.avoidance, *(() if run.law.guidance == "los" else (run.law.guidance,)), run.law.mode)
    how += () if run.law.fallback == "exact" else (run.law.fallback,)
    return (run.scenario.name, run.vehicle.name, *how, run.sensing, f"seed{run.seed}")


def save_tuning(tuning: Tuning, folder: Path | str) -> list[Path]:
    """Write PNGs of the overview and of the Pareto front; return their paths.

    Raises:
        InputError: the folder cannot be written.
    """
    axes = {"goals": plot_goal_bars(goal_bars(tuning)), "front": plot_front(tuning)}
    return [save_figure(ax, folder, ("tuning", name)) for name, ax in axes.items()]

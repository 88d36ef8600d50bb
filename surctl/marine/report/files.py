"""Pictures that commands write (`--out`): margins, verdicts, regions, runs, tunings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from surctl.marine.control import Gains, Law
from surctl.marine.report.goals import goal_bars, plot_front, plot_goal_bars
from surctl.marine.report.margin_plots import plot_disk_margins
from surctl.marine.report.plan_view import plot_run
from surctl.marine.report.signals import plot_run_signals
from surctl.marine.simulation import Run
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification import law_loop
from surctl.marine.verification.region.nominal import nominal_motion
from surctl.report.evidence import margin_slice, plot_counterexample, plot_open_boxes, plot_slice
from surctl.report.motion_plots import plot_motion
from surctl.report.page_parts import plot_tightest
from surctl.report.theme import (
    new_figure,
    save_figure,
)
from surctl.tuning import Tuning
from surctl.verification import Verdict
from surctl.verification.sampled_margins import open_loop

# The plots that `surctl verify --out` writes: margins, refuted claims, boxes of proofs, and regions


def plot_region(document: Mapping[str, Any], *, falsified: float | None = None) -> Figure:
    """Plot a region certificate in planes of two states: the region V < 1, and the motion of the nominal loop.

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
        ['y_e [m]', 'along [m/s]', 'across [m/s]', 'along [m/s]', 'across [m/s]', 'across [m/s]']
    """
    return plot_motion(*nominal_motion(document), level=1.0, falsified=falsified)


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

"""The figures of a linear loop and their verdict: one definition for vehicles, laws and systems."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from surctl.assessment.assessment import Figure, Line
from surctl.verification.linear.disk import LEAST_DISK_MARGIN
from surctl.verification.margins import LEAST_DELAY_MARGIN, LoopMargins

__all__ = ["SATURATED", "loop_figures", "loop_line"]

SATURATED = 0.5
"""Share of time at a limit above which the linear figures do not describe a run."""

_DISK = "all loops at once, at commands or measurements, at the worst corner of the ranges"


def loop_figures(
    disks: tuple[float, float],
    slowest: tuple[float, float],
    margins: Sequence[LoopMargins],
    *,
    corner: str,
    which: str,
    least_delay: float = LEAST_DELAY_MARGIN,
) -> dict[str, Figure]:
    """Return the figures of a linear loop by name.

    Args:
        disks: disk margin of all loops at once, nominal and at the worst corner.
        slowest: largest real part [1/s] of a pole, nominal and over the corners.
        margins: margins of each loop alone.
        corner: the worst corner.
        which: what the margins of each loop alone are of, such as the nominal vehicle.
        least_delay: least sufficient delay margin [s].
    """
    delay = min(margins, key=lambda m: m.delay_margin_s)
    single = min(margins, key=lambda m: m.disk_margin)
    figures = (
        Figure("disk_margin", disks[1], "1", _DISK, "high", LEAST_DISK_MARGIN, corner),
        Figure("nominal_disk_margin", disks[0], "1", "disk margin, nominal", "high"),
        Figure(
            "single_loop_disk_margin", single.disk_margin, "1", f"least disk margin of one loop alone, {which}",
            "high", where=single.name,
        ),
        Figure(
            "delay_margin_s", delay.delay_margin_s, "s", f"least delay margin of one loop alone, {which}",
            "high", least_delay, delay.name,
        ),
        Figure("slowest_pole_per_s", slowest[0], "1/s", "largest real part of a pole, nominal", "low"),
        Figure("corner_slowest_pole_per_s", slowest[1], "1/s", "largest real part of a pole, corners", "low"),
    )  # fmt: skip
    return {figure.name: figure for figure in figures}


def loop_line(figures: dict[str, Figure], *, stable: bool, place: str, unstable: str) -> Line:
    """Return the verdict on a linear loop; `unstable` says what is wrong with a nominal loop that is not stable."""
    disk, nominal, delay = (figures[n] for n in ("disk_margin", "nominal_disk_margin", "delay_margin_s"))
    if not stable:
        text = f"the linear loop {place} is UNSTABLE"
        if nominal.value > 0:
            text += f" at the corner {disk.where}; the nominal disk margin is {nominal.value:.2f}"
        else:
            text += unstable
        return Line(False, text, "margins")
    short = [f"at least {f.least:g}" + (f" {f.unit}" if f.unit != "1" else "") for f in (disk, delay) if not f.enough]
    worst, first = ("not determined" if np.isnan(f.value) else f"{f.value:.2f}" for f in (disk, nominal))
    text = f"margins {place}: disk margin {worst} at the worst corner, {first} nominal; least delay "
    text += f"margin {delay.value:{'.2f' if delay.value >= 0.1 else '.2g'}} s ({delay.where})"
    if short:
        text += f"; required: {', '.join(short)} (worst corner: {disk.where})"
    undetermined = np.isnan(disk.value) and delay.enough
    return Line(None if undetermined else not short, text, "margins")

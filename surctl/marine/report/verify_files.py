"""The plots that `surctl verify --out` writes: margins, refuted claims, boxes of proofs, and regions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from surctl.errors import InputError
from surctl.marine.report.loops import loop_responses, plot_nyquist
from surctl.marine.report.margin_plots import plot_disk_margins, plot_marked_bode, plot_s_and_t, sensitivities
from surctl.marine.report.region_plots import plot_region
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification import build_cascade, loop_margins
from surctl.marine.verification.linear import DISK_PLACES, open_loop
from surctl.report.cell_plots import plot_cells, plot_open_boxes
from surctl.report.evidence import margin_slice, plot_counterexample, plot_slice
from surctl.report.pictures import save_figure
from surctl.verification import Verdict
from surctl.verification.linear.disk import stored_disk_margin

__all__ = ["save_margins", "save_regions", "save_verdicts"]


def save_margins(
    vehicle: Vehicle, gains: Mapping[str, float], folder: Path | str, *, cruise: float | Sequence[float], dt: float
) -> list[Path]:
    r"""Write PNGs of Bode (loops of least margin), Nyquist, disk-margin and sensitivity plots; return the paths.

    With several cruise speeds [m/s], the sensitivities S and T are plotted at each speed, and all other plots are for
    the largest speed. Nothing is written for an unstable loop.

    Raises:
        InputError: see `loop_margins`; or the folder cannot be written.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import save_margins
        >>> from surctl.marine.vehicle import load_vehicle
        >>> gains = load_gains("default").values
        >>> paths = save_margins(load_vehicle("sur400"), gains, "pictures", cruise=0.15, dt=0.05)
        >>> print(*(path.name for path in paths), sep="\n")
        margins-sur400-bode-yaw.png
        margins-sur400-nyquist-thrust.png
        margins-sur400-bode-heading.png
        margins-sur400-nyquist-measurement.png
        margins-sur400-disk.png
        margins-sur400-sensitivity.png
    """
    speeds = [float(speed) for speed in np.atleast_1d(cruise)]
    cruise = max(speeds)
    margins = loop_margins(vehicle, gains, cruise=cruise, dt=dt)
    loops = loop_responses(vehicle, gains, cruise=cruise, dt=dt)
    if not all(m.stable for m in margins):
        return []
    figures: dict[str, Figure] = {}
    for at in ("thrust", "measurement"):
        group = [(loop, m) for loop, m in zip(loops, margins, strict=True) if loop.at == at]
        tightest = min(group, key=lambda pair: pair[1].delay_margin_s)
        figures[f"bode-{tightest[0].name}"] = plot_marked_bode(*tightest)
        least = min(m.disk_margin for _, m in group)
        figures[f"nyquist-{at}"] = plot_nyquist([loop for loop, _ in group], disk_margin=least).figure.figure
    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt)
    opened = [open_loop(cascade, place) for place in DISK_PLACES]
    pairs = [(loop, stored_disk_margin(loop, place)) for loop, place in zip(opened, DISK_PLACES, strict=True)]
    figures["disk"] = plot_disk_margins(pairs, highest=np.pi / dt)
    figures["sensitivity"] = plot_s_and_t(sensitivities(vehicle, gains, cruise=speeds, dt=dt, places=DISK_PLACES[:2]))
    return [save_figure(figure, folder, ("margins", vehicle.name, name)) for name, figure in figures.items()]


def save_verdicts(verdicts: Sequence[Verdict], folder: Path | str) -> list[Path]:
    """Write PNGs for each claim: a counterexample, the boxes of a proof, or the undecided boxes; return the paths.

    Raises:
        InputError: the folder cannot be written.

    Example:
        >>> from surctl.marine.report import save_verdicts
        >>> from surctl.marine.verification import claims
        >>> from surctl.verification import decide
        >>> chosen = claims(names=["v1-printed", "v1-corrected"])
        >>> verdicts = [decide(claim, samples=256, starts=2) for claim in chosen]
        >>> [path.name for path in save_verdicts(verdicts, "pictures")]
        ['v1-printed-replay.png', 'v1-printed-slice.png', 'v1-corrected-cells.png']
    """
    saved = []
    for verdict in verdicts:
        for name, figure in _pictures(verdict).items():
            saved.append(save_figure(figure, folder, (verdict.claim.name, name)))
    return saved


def save_regions(documents: Mapping[str, Mapping[str, Any]], folder: Path | str) -> list[Path]:
    """Write PNGs of level sets, flow and failure points for named region certificates; return the paths.

    Raises:
        InputError: a certificate is of another kind, or the folder cannot be written.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.report import save_regions
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.region import prove_statement, region_statement
        >>> statement = region_statement("region-heading-20").model_copy(update={"attempts": 1})
        >>> proof = prove_statement(statement, load_vehicle("sur540-flooded"), load_gains("default"))
        >>> [path.name for path in save_regions({"heading": proof.certificate()}, "pictures")]
        ['heading-levels.png']
    """
    return [save_figure(plot_region(document), folder, (name, "levels")) for name, document in documents.items()]


def _pictures(verdict: Verdict) -> dict[str, Figure]:
    figures: dict[str, Figure] = {}
    varying = sum(v.upper > v.lower for v in verdict.claim.variables)
    if verdict.counterexample is not None:
        if verdict.claim.motion is not None:
            figures["replay"] = plot_counterexample(verdict).figure.figure
        if varying >= 2:
            figures["slice"] = plot_slice(margin_slice(verdict)).figure.figure
    elif varying >= 2 and verdict.certificate is not None:
        try:
            figures["cells"] = plot_cells(verdict).figure.figure
        except InputError:  # this kind of certificate has no cells
            return figures
    elif varying >= 2 and verdict.open_boxes:
        figures["open"] = plot_open_boxes(verdict).figure.figure
    return figures

"""The contents of the HTML report: all results of a study in one object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export import ExportedFile, SilReport
from surctl.marine.control import Gains
from surctl.marine.report.loops import LoopResponse
from surctl.marine.simulation import Run
from surctl.marine.tuning import SweepTable
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.linear import LinearSide
from surctl.report.document import Check
from surctl.verification import Inapplicable, LoopMargins, Verdict

__all__ = ["ExportSummary", "ReportData"]


@dataclass(frozen=True, kw_only=True)
class ExportSummary:
    """An exported controller and its comparison with Python.

    Attributes:
        name: prefix of the files and C symbols.
        id: identifier of the law.
        files: the files that were written.
        sil: software-in-the-loop reports, one for each replayed run; empty if nothing was compiled.
        status: a sentence that says what was done or not done; may be empty.
    """

    name: str
    id: str
    files: tuple[ExportedFile, ...]
    sil: tuple[SilReport, ...] = ()
    status: str = ""

    @property
    def passed(self) -> bool | None:
        """Return whether C equalled Python in every comparison, without a reset; None if there was no comparison."""
        return all(report.conclusive for report in self.sil) if self.sil else None


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportData:
    """The contents of one HTML report.

    Attributes:
        title: heading of the report.
        command: the command line that produced the report.
        version: version of this package.
        vehicle: the vehicle that the gains and margins are for.
        gains: the gains of the runs.
        speeds: (cruise speed, speed limit) [m/s] of the margins and claims; None if these speeds are not known.
        margins: margins of the eight loops.
        linear: linear analysis (all loops together, poles, sampling), for the nominal vehicle and for the worst corner
            of its ranges.
        poles: closed-loop poles [rad/s]; None if they were not computed.
        loops: frequency responses of the loops; if empty, the report has no Bode plot.
        verdicts: verdicts on the claims.
        inapplicable: claims that do not apply to this vehicle, each with the reason.
        regions: region claims that cannot be proved for this vehicle, grouped by reason.
        runs: closed-loop runs.
        deciding: for each run, whether the run counts towards the result; if None, only runs with true positions count.
        sweep: the parameter sweep that selected the gains, or None.
        export: the exported controller, or None.
        seconds: computing time [s] of each part of the study.
        summary: lines of the summary, see `Check`.
        banner: the verdict in one sentence; empty: one that counts the lines.
        gains_file: name of the gain file with these gains, for the option `--gains`; empty if there is none.
        film: whether MuJoCo's pictures of the scene are shown beside the plan view of the decisive run.

    Raises:
        InputError: `deciding` and `runs` differ in length.
    """

    title: str
    command: str
    version: str
    vehicle: Vehicle
    gains: Gains
    speeds: tuple[float, float] | None = None
    margins: tuple[LoopMargins, ...] = ()
    linear: tuple[LinearSide, ...] = ()
    poles: NDArray[np.complex128] | None = None
    loops: tuple[LoopResponse, ...] = ()
    verdicts: tuple[Verdict, ...] = ()
    inapplicable: tuple[Inapplicable, ...] = ()
    regions: tuple[Inapplicable, ...] = ()
    runs: tuple[Run, ...] = ()
    deciding: tuple[bool, ...] | None = None
    sweep: SweepTable | None = None
    export: ExportSummary | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    summary: tuple[Check | tuple[bool | None, str], ...] = ()
    banner: str = ""
    gains_file: str = ""
    film: bool = False

    def __post_init__(self) -> None:
        if self.deciding is not None and len(self.deciding) != len(self.runs):
            raise InputError(
                f"has {len(self.deciding)} entries for {len(self.runs)} runs",
                key="deciding",
                remedy="give one entry per run",
            )

    @property
    def decides(self) -> tuple[bool, ...]:
        """Return, for each run, whether the run counts towards the result."""
        if self.deciding is None:
            return tuple(run.sensing == "truth" for run in self.runs)
        return self.deciding

    @property
    def passed(self) -> bool | None:
        """Return False if a line of the summary fails, None if one is open or none counts, True otherwise."""
        lines = [Check(*line) for line in self.summary]
        outcomes = [line.good for line in lines if line.good is not None or line.open]
        return False if False in outcomes else None if None in outcomes or not outcomes else True

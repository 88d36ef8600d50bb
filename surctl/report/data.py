"""The contents of the report page: all results of a study in one object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from surctl.control import Gains
from surctl.errors import InputError
from surctl.export import ExportedFile, SilReport
from surctl.report.document import Check
from surctl.report.loops import LoopResponse
from surctl.simulation import Run
from surctl.tuning import SweepTable
from surctl.vehicle import Vehicle
from surctl.verification import Inapplicable, LoopMargins, Verdict
from surctl.verification.linear import LinearSide

__all__ = ["ExportSummary", "ReportData"]


@dataclass(frozen=True, kw_only=True)
class ExportSummary:
    """An exported controller and its comparison with Python.

    Attributes:
        name: prefix of the files and C symbols.
        id: identifier of the law.
        files: the files that were written.
        sil: one software-in-the-loop report per replayed run; empty if nothing was compiled.
        status: a sentence that says what was done or not done; may be empty.
    """

    name: str
    id: str
    files: tuple[ExportedFile, ...]
    sil: tuple[SilReport, ...] = ()
    status: str = ""

    @property
    def passed(self) -> bool | None:
        """Whether every comparison with Python passed without a reset; None if there was no comparison."""
        return all(report.conclusive for report in self.sil) if self.sil else None


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportData:
    """The contents of one page.

    Attributes:
        title: heading of the page.
        command: the command line that produced the page.
        version: version of this package.
        vehicle: the vehicle that the gains and margins are for.
        gains: the gains of the runs.
        speeds: cruise speed and speed limit [m/s] of the margins and claims; None if they are not known.
        margins: margins of the eight loops.
        linear: analysis of all loops together, of poles and of sampling, for the nominal vehicle and the worst corner.
        poles: closed-loop poles [rad/s], or None.
        loops: frequency responses of the loops; without them the page has no Bode plot.
        verdicts: verdicts on the claims.
        inapplicable: claims that do not apply to this vehicle, each with the reason.
        runs: closed-loop runs.
        deciding: for each run, whether it counts towards the result; None counts only the runs with true positions.
        sweep: the sweep that selected the gains, or None.
        export: the exported controller, or None.
        seconds: computing time [s] of each stage.
        summary: lines of the summary: True holds, False fails, None does not count towards the result; see `Check`.
        gains_file: the gain file that `--gains` takes to use these gains; empty if there is none.

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
    runs: tuple[Run, ...] = ()
    deciding: tuple[bool, ...] | None = None
    sweep: SweepTable | None = None
    export: ExportSummary | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    summary: tuple[Check | tuple[bool | None, str], ...] = ()
    gains_file: str = ""

    def __post_init__(self) -> None:
        if self.deciding is not None and len(self.deciding) != len(self.runs):
            raise InputError(
                f"has {len(self.deciding)} entries for {len(self.runs)} runs",
                key="deciding",
                remedy="give one entry per run",
            )

    @property
    def decides(self) -> tuple[bool, ...]:
        """For each run, whether it counts towards the result."""
        if self.deciding is None:
            return tuple(run.sensing == "truth" for run in self.runs)
        return self.deciding

    @property
    def passed(self) -> bool | None:
        """False if a line of the summary fails, True if lines hold and none fails, None if no line counts."""
        outcomes = [line[0] for line in self.summary if line[0] is not None]
        return all(outcomes) if outcomes else None

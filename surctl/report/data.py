"""What the page is made of: everything a study found, as one object."""

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
        id: identity of the law.
        files: what was written.
        sil: one software-in-the-loop report a replayed run; empty when nothing was compiled.
        status: a sentence on what was or was not done; may be empty.
    """

    name: str
    id: str
    files: tuple[ExportedFile, ...]
    sil: tuple[SilReport, ...] = ()
    status: str = ""

    @property
    def passed(self) -> bool | None:
        """Whether every comparison passed without a reset; None when there was none."""
        return all(report.conclusive for report in self.sil) if self.sil else None


@dataclass(frozen=True, kw_only=True, eq=False)
class ReportData:
    """The contents of one page.

    Attributes:
        title: heading of the page.
        command: the command line that made it all.
        version: of this package.
        vehicle: what the gains and margins are for.
        gains: the gains of the runs.
        speeds: cruise speed and cap [m/s] that margins and claims are about; None where they are not known.
        margins: of the eight loops.
        linear: loops together, poles and sampling: of the vehicle, of the worst of its ranges.
        poles: closed-loop poles [rad/s], or None.
        loops: frequency responses of the loops; without them no Bode plot is drawn.
        verdicts: of the claims.
        inapplicable: claims that are not about this vehicle, and why.
        runs: closed-loop runs.
        deciding: for each run, whether it decides the outcome; None lets the runs with true positions decide.
        sweep: the sweep that picked the gains, or None.
        export: the exported controller, or None.
        seconds: time taken [s] by stage.
        summary: lines of the outcome: holds, fails, or None for a note that decides nothing; see `Check`.
        gains_file: the gain file that `--gains` takes to get these gains; empty when there is none.

    Raises:
        InputError: `deciding` has another length than `runs`.
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
                remedy="give one a run",
            )

    @property
    def decides(self) -> tuple[bool, ...]:
        """For each run, whether it decides."""
        if self.deciding is None:
            return tuple(run.sensing == "truth" for run in self.runs)
        return self.deciding

    @property
    def passed(self) -> bool | None:
        """False when a line of the summary fails, True when one holds and none fails, None when none decides."""
        outcomes = [line[0] for line in self.summary if line[0] is not None]
        return all(outcomes) if outcomes else None

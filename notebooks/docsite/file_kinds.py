"""The kinds of input files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import BaseModel

from surctl.lyapunov.problem import _ProblemTable
from surctl.marine.control.gains import _GainFile
from surctl.marine.simulation.scenario import _ScenarioFile
from surctl.marine.study.plan import _StudyFile
from surctl.marine.vehicle.logs.joining import LogMap
from surctl.marine.vehicle.parameters import _VehicleFile
from surctl.marine.vehicle.thruster_file import _AllocationTable, _ThrusterTable
from surctl.marine.verification.region.statement import RegionStatement
from surctl.tuning.goals import GoalsFile
from surctl.verification.claim_file import _ClaimTable

__all__ = ["FILES", "FileKind"]


@dataclass(frozen=True)
class FileKind:
    """A kind of file: its model, title, value of `kind`, purpose in one line, and text above its keys."""

    model: type[BaseModel]
    title: str
    kind: str
    purpose: str
    text: str


class _Vehicle(_VehicleFile):
    """A vehicle file with its thrusters in full."""

    thruster: tuple[_ThrusterTable, ...] = ()  # type: ignore[assignment]
    allocation: _AllocationTable | None = None  # type: ignore[assignment]


FILES: Mapping[str, FileKind] = {
    "vehicle": FileKind(
        _Vehicle,
        "Vehicle file",
        "vehicle",
        "mass, drag, thrust and thrusters, each with a source and a range",
        "The guide [Add a vehicle](../../add-a-vehicle.md) shows four ways to write one. Each table has the key "
        "`provenance`, the source of its numbers.",
    ),
    "scenario": FileKind(
        _ScenarioFile,
        "Scenario file",
        "scenario",
        "a mission: path, site, obstacles, disturbances and sensors",
        "The guides [Design a controller](../../design.md) and [Missions](../../missions.md) show examples. Positions "
        "are in the world frame ENU (x east, y north, z up), so depths are negative.",
    ),
    "gains": FileKind(
        _GainFile,
        "Gain file",
        "gains",
        "every tunable number of a law",
        "`surctl gains derive VEHICLE` and `surctl tune` write gain files. A law of your own adds its own gains "
        "([own law](../../own-law.md#its-own-gains)).",
    ),
    "goals": FileKind(
        GoalsFile,
        "Goals file",
        "goals",
        "hard and soft goals of a tuning",
        "The guide [Tune the gains](../../tune.md#goals-of-your-own) shows an example. A goal is about a "
        "metric and has `at_most` or `at_least`, or it has a `type` and is about the loop.",
    ),
    "claim": FileKind(
        _ClaimTable,
        "Claim file",
        "claim",
        "an inequality over a box that is to be proved or refuted",
        "The tutorial [Your own claim](../../tutorials/own-claim.md) shows an example. `left <= right` is claimed "
        "wherever all constraints hold.\n\nExpressions have numbers, names, `pi`, `+ - * / ^`, parentheses, and the "
        "functions `abs`, `acos`, `asin`, `atan`, `atan2`, `cos`, `cosh`, `exp`, `log` (natural), `max`, `min`, "
        "`select`, `sin`, `sinh`, `sqrt`, `tan` and `tanh`; `select(a, b, x, y)` is x if a ≤ b, and y otherwise.",
    ),
    "dynamics": FileKind(
        _ProblemTable,
        "Dynamics file",
        "lyapunov",
        "dynamics, with a Lyapunov function or a barrier to be proved or searched",
        'The guide [A region of attraction](../../region.md) shows examples of `kind = "lyapunov"` and of '
        '`kind = "barrier"`.',
    ),
    "region": FileKind(
        RegionStatement,
        "Region file",
        "region",
        "a region claim about the loop of a vehicle",
        "`surctl verify FILE --vehicle VEHICLE` proves it; `surctl list --show region-cruise-20` prints one.",
    ),
    "study": FileKind(
        _StudyFile,
        "Study file",
        "study",
        "the runs, sweep, claims and goals of `surctl study` and `surctl tune`",
        "`surctl new study NAME` writes one.",
    ),
    "log-map": FileKind(
        LogMap,
        "Log map",
        "log-map",
        "which fields of a log are motion and thrust",
        "The guide [Add a vehicle](../../add-a-vehicle.md#a-log-of-another-program) shows an example for a BlueROV2.",
    ),
}

"""The subject of an assessment of a system of the user's own: its loop at the equilibrium, a run, a proved region."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from surctl.assessment.assessment import Figure, Line, Part
from surctl.assessment.figures import SATURATED, loop_figures, loop_line
from surctl.errors import InputError
from surctl.system import ENDED, LOST, Record, System, run_system, unresponsive
from surctl.system.values import checked_ranges, run_numbers
from surctl.verification.system_corners import SystemCorners, system_corners

__all__ = ["ClosedLoop", "Region"]


class Region(Protocol):
    """A claim about a region of attraction with its verdict, such as `surctl.lyapunov.Solution`."""

    @property
    def falsified(self) -> float | None:
        """Return the least level at which a counterexample is known."""

    @property
    def verdict(self) -> Literal["proved", "refuted", "unknown"]:
        """Return the verdict."""

    @property
    def vacuous(self) -> str:
        """Why the proved claim says nothing; empty if it says something."""

    @property
    def level(self) -> float | None:
        """Return the level of the claim; None if it has none."""

    def lines(self) -> list[str]:
        """Return lines that state the claim."""


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A system with its numbers, the run in which it is judged, and the region that is claimed.

    Attributes:
        system: the closed loop.
        values: numbers of one run by name, see `run_numbers`.
        ranges: ranges of uncertain numbers; None: those that the system declares.
        record: the run; None: it is simulated, if there are `seconds`.
        seconds: duration of the run [s]; None: no run is judged.
        region: function that decides the claimed region of attraction; None: none is claimed.
    """

    system: System
    values: Mapping[str, ArrayLike] = field(default_factory=dict)
    ranges: Mapping[str, tuple[float, float]] | None = None
    record: Record | None = None
    seconds: float | None = None
    region: Callable[[], Region] | None = None

    @property
    def name(self) -> str:
        """Names of plant and controller."""
        return f"{self.system.plant.name} under {self.system.controller.name}"

    def parts(self) -> Mapping[str, Callable[[], Part]]:
        """Return the parts of the assessment; run and region only if they are asked for."""
        parts: dict[str, Callable[[], Part]] = {"loop": self._loop}
        if self.record is not None or self.seconds is not None:
            parts["run"] = self._run
        if self.region is not None:
            parts["region"] = self._region
        return parts

    def _loop(self) -> Part:
        run_numbers(self.system, self.values)  # a mistake is raised, unlike a loop without equilibrium
        checked_ranges(self.system, self.system.ranges if self.ranges is None else self.ranges)
        try:
            corners = system_corners(self.system, self.values, self.ranges)
        except InputError as error:
            line = Line(None, f"margins: not judged, because {error.problem}", "margins", counts=False)
            return Part((), (line,), error)
        figures = _figures(corners, self.system.dt)
        unstable = f": the largest pole is |z| = {np.abs(corners.nominal.poles).max(initial=0.0):.6g}"
        line = loop_line(figures, stable=corners.stable, place="at the equilibrium", unstable=unstable)
        if corners.lost:
            line = Line(False, f"the loop has no equilibrium at the corner {corners.corner}", "margins")
        return Part(tuple(figures.values()), (line,), corners)

    def _run(self) -> Part:
        record = self.record
        if record is None:
            assert self.seconds is not None  # `parts` asks for a run only then
            record = run_system(self.system, self.seconds, self.values)
        how = f"the run ends after {record.duration:.6g} s ({record.lost or record.stopped})"
        lines = [Line(record.stopped != LOST, how, "run", counts=record.stopped in (ENDED, LOST))]
        figures = []
        for name, cost in self.system.costs.items():
            value = record.figures[name]
            meaning = cost.meaning or f"{cost.how} over the run"
            figures.append(Figure(f"cost.{name}", value, cost.unit, meaning, "low", cost.at_most))
            if cost.at_most is not None:
                text = f"{name} = {value:.6g} {cost.unit}, at most {cost.at_most:g} {cost.unit}"
                lines.append(Line(figures[-1].enough, text, "run"))
        shares = unresponsive(record)
        if shares:
            worst = max(shares, key=lambda name: shares[name])
            meaning = "share of the run in which a command does not respond: at a limit, or in a dead zone"
            figures.append(Figure("limited_share", shares[worst], "1", meaning, "low", where=worst))
            if shares[worst] > SATURATED:
                text = f"command {worst} does not respond {shares[worst]:.0%} of the run"
                lines.append(Line(None, f"{text}, so the linear margins do not describe this run", "run"))
        return Part(tuple(figures), tuple(lines), record)

    def _region(self) -> Part:
        assert self.region is not None  # `parts` asks for a region only then
        solution = self.region()
        proved = solution.verdict == "proved" and not solution.vacuous
        passed = True if proved else False if solution.verdict == "refuted" else None
        line = Line(passed, f"region of attraction: {' '.join(solution.lines()[0].split())}", "region")
        level = solution.level
        if level is None:
            return Part((), (line,), solution)
        share = level / solution.falsified if proved and solution.falsified else float("nan") if proved else 0.0
        figure = Figure(
            "region_share", share, "1", "certified level over the least level with a counterexample", "high"
        )
        return Part((figure,), (line,), solution)


def _figures(corners: SystemCorners, dt: float) -> dict[str, Figure]:
    nominal = corners.nominal
    return loop_figures(
        (nominal.disk, corners.disk),
        (nominal.slowest_per_s, corners.slowest_per_s),
        nominal.margins,
        corner=corners.corner,
        which="nominal system",
        least_delay=dt,  # the command of a step may be applied up to one period late
    )

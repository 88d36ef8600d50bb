"""The control loops of a study, for its pages: the analysis of the assessment, other speeds, and curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from surctl.marine.assessment import LoopAnalysis
from surctl.marine.control import Gains
from surctl.marine.study.plan import Plan
from surctl.marine.verification import OverSpeeds, over_speeds
from surctl.verification import LoopMargins

if TYPE_CHECKING:
    from surctl.marine.report import LoopResponse

__all__ = ["Loops", "loops_of"]


@dataclass(frozen=True)
class Loops:
    """Linear analysis of the missions that count towards the result.

    Attributes:
        analysis: the analysis at their largest cruise speed, as it was assessed.
        over: metrics of the linear loops at the cruise speeds that the plan names, or None.
        responses: frequency responses of the loops; empty for a law without the built-in cascade.
    """

    analysis: LoopAnalysis
    over: OverSpeeds | None = None
    responses: tuple[LoopResponse, ...] = ()

    @property
    def margins(self) -> tuple[LoopMargins, ...]:
        """Delay margin and disk margin of each loop alone."""
        return self.analysis.margins

    def to_dict(self) -> dict[str, Any] | None:
        """Return the analysis of all loops together as plain data; None if there is none."""
        one = self.analysis
        if one.law is not None:
            return one.law.to_dict()
        if one.mode is None:
            return None
        nominal, worst = one.sides
        table = {"nominal": nominal.to_dict(), "worst": worst.to_dict(), "mode": one.mode.to_dict()}
        return table | ({} if self.over is None else {"speeds": self.over.to_dict()})


def loops_of(plan: Plan, gains: Gains, analysis: LoopAnalysis, *, dt: float) -> Loops:
    """Return the control loops of a plan's vehicle with these gains."""
    if analysis.mode is None:
        return Loops(analysis)
    from surctl.marine.report import loop_responses  # loads matplotlib only now

    vehicle, values = plan.vehicle, gains.values
    return Loops(
        analysis,
        over_speeds(vehicle, values, cruise=plan.cruise, dt=dt) if plan.cruise else None,
        loop_responses(vehicle, values, cruise=analysis.cruise, dt=dt),
    )

"""The control loops of a study, linearised about straight motion at cruise speed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surctl.control import Gains, build_law, law_source
from surctl.errors import InputError
from surctl.own_code import is_own
from surctl.simulation import Disturbance, simulate
from surctl.study.plan import Plan
from surctl.verification import (
    LawCorners,
    LoopMargins,
    OverSpeeds,
    closed_loop_poles,
    law_corners,
    loop_margins,
    over_speeds,
    steady_motion,
)
from surctl.verification.cascade import has_cascade
from surctl.verification.linear import LinearSide, Mode, corners, linear_side, slowest_mode, worst_linear_side

if TYPE_CHECKING:
    from surctl.report import LoopResponse

__all__ = ["Loops", "loops_of"]


@dataclass(frozen=True)
class Loops:
    """Linear analysis at the largest cruise speed of the missions that count towards the result.

    The analysis is empty for a law without a linear model.

    Attributes:
        margins: delay margin and disk margin of each loop.
        over: metrics of the linear loops at the cruise speeds that the plan names, or None.
        poles: closed-loop poles [rad/s], or None.
        mode: slowest or most unstable mode, or None.
        sides: analysis of all loops together, first for the nominal vehicle, then for the worst corner of its parameter
            ranges.
        responses: frequency responses of the loops.
        law: sampled loop of a law that is linearised numerically, nominal and at the worst corner, or None.
    """

    margins: tuple[LoopMargins, ...] = ()
    over: OverSpeeds | None = None
    poles: NDArray[np.complex128] | None = None
    mode: Mode | None = None
    sides: tuple[LinearSide, ...] = ()
    responses: tuple[LoopResponse, ...] = ()
    law: LawCorners | None = None

    @property
    def stable(self) -> bool:
        """Whether every loop is stable."""
        return all(loop.stable for loop in self.margins) and (self.law is None or self.law.stable)

    def to_dict(self) -> dict[str, Any] | None:
        """Return the analysis of all loops together as plain data; None if the law has no linear model."""
        if self.law is not None:
            return self.law.to_dict()
        if self.mode is None:
            return None
        nominal, worst = self.sides
        table = {"nominal": nominal.to_dict(), "worst": worst.to_dict(), "mode": self.mode.to_dict()}
        return table | ({} if self.over is None else {"speeds": self.over.to_dict()})


def loops_of(plan: Plan, gains: Gains, *, dt: float) -> Loops:
    """Return the linear analysis of a plan's vehicle with these gains; empty if the law has no linear model."""
    if law_source(plan.law).steering is not None:
        speed = max(leg.scenario.cruise for leg in plan.deciding)
        law = build_law(plan.law, guidance=plan.guidance, dt=dt)
        analysis = law_corners(law, plan.vehicle, gains, cruise=speed)
        return Loops(analysis.nominal.margins, law=analysis)
    if is_own(plan.law):
        return _own_loops(plan, gains, dt=dt)
    if not has_cascade(plan.law, plan.guidance):
        return Loops()
    from surctl.report import loop_responses  # loads matplotlib only now

    vehicle, values = plan.vehicle, gains.values
    cruise = max(leg.scenario.cruise for leg in plan.deciding)
    return Loops(
        loop_margins(vehicle, values, cruise=cruise, dt=dt),
        over_speeds(vehicle, values, cruise=plan.cruise, dt=dt) if plan.cruise else None,
        closed_loop_poles(vehicle, values, cruise=cruise, dt=dt),
        slowest_mode(vehicle, values, cruise=cruise, dt=dt),
        (
            linear_side(vehicle, values, cruise=cruise, dt=dt),
            worst_linear_side(corners(vehicle), values, cruise=cruise, dt=dt),
        ),
        loop_responses(vehicle, values, cruise=cruise, dt=dt),
    )


def _own_loops(plan: Plan, gains: Gains, *, dt: float) -> Loops:
    # about the steadiest motion of the first mission that has one
    own = gains.with_own(law_source(plan.law).gains)
    law = build_law(plan.law, guidance=plan.guidance, dt=dt)
    for leg in plan.deciding:
        try:
            calm = Disturbance(current_m_per_s=leg.scenario.disturbance.current_m_per_s)
            scenario = replace(leg.scenario, disturbance=calm)
            at = steady_motion(simulate(scenario, plan.vehicle, gains=own, law=law))
            analysis = law_corners(law, plan.vehicle, own, cruise=at.speed, at=at)
        except InputError:
            continue
        return Loops(analysis.nominal.margins, law=analysis)
    return Loops()

"""Goals about the loop of a law of the robot, for many gain sets and plants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl.control import Gains
from surctl.errors import InputError
from surctl.own_code import is_own
from surctl.simulation import Case, law_numbers, simulate
from surctl.system import LinearLoop
from surctl.tuning.goals import Goal
from surctl.verification import OperatingPoint, law_loop, steady_motion

__all__ = ["case_loop", "judged_loops"]

Sets = Mapping[str, NDArray[np.float64]]
_NOMINAL: Mapping[str, float] = MappingProxyType({})


def case_loop(
    case: Case,
    gains: Gains,
    *,
    cruise: float | None = None,
    plant: Mapping[str, float] = _NOMINAL,
    motion: OperatingPoint | None = None,
) -> LinearLoop:
    """Return the linear sampled loop of a case's law, with true positions.

    A built-in law is linearised about a straight cruise, a law of the user's own about the steady motion of its run in
    the scenario of the case.

    Args:
        case: the simulation case.
        gains: the gains of the law.
        cruise: cruise speed [m/s]; None: that of the scenario.
        plant: parameters of the plant (`plant.…`) that differ from the vehicle of the case.
        motion: a steady motion of another run, at which a law of the user's own is linearised with these gains.

    Raises:
        InputError: the vehicle cannot hold the speed, or the run has no steady motion.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.simulation import load_scenario
        >>> from surctl.tuning import build_cases, case_loop
        >>> (case,) = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> case_loop(case, case.gains, cruise=0.2).channels()[:4]
        ['surge', 'sway', 'heave', 'yaw']
    """
    law = (case if case.sensing == "truth" else replace(case, sensing="truth")).build()
    vehicle = case.vehicle.with_values({name.removeprefix("plant."): value for name, value in plant.items()})
    model, speed = case.model or case.vehicle, case.scenario.cruise if cruise is None else cruise
    if not is_own(case.law):
        return law_loop(law, vehicle, gains, cruise=speed, model=model).linear
    if cruise is not None and cruise != case.scenario.cruise:
        remedy = "leave it out: a law of your own is linearised about its run in the scenario"
        raise InputError("is not the cruise speed of the scenario", key="cruise_m_per_s", value=cruise, remedy=remedy)
    if motion is None:
        motion = steady_motion(simulate(case.scenario, vehicle, gains=gains, law=law, model=model))
    at = replace(motion, p=law_numbers(case.scenario, gains, model))
    return law_loop(law, vehicle, gains, cruise=speed, at=at).linear


def judged_loops(
    goal: Goal, case: Case, cruise: float | None, plants: Sequence[Mapping[str, float]], sets: Sets
) -> NDArray[np.float64]:
    """Return the normalised values (n gain sets, plants) of a goal about the loop.

    The value is NaN if the plant cannot hold the speed.
    """
    if goal.loop is None:
        raise InputError("is not about the loop", key=f"goals.{goal.name}", remedy="give its `loop`")
    count = len(next(iter(sets.values())))
    table = np.full((count, len(plants)), np.nan)
    known: dict[tuple[tuple[str, float], ...], int] = {}
    for j, plant in enumerate(plants):
        same = known.setdefault(tuple(sorted(plant.items())), j)
        if same != j:
            table[:, j] = table[:, same]
            continue
        for k in range(count):
            gains = case.gains.with_values({name: float(values[k]) for name, values in sets.items()})
            try:
                loop = case_loop(case, gains, cruise=cruise, plant=plant)
            except InputError:
                continue
            table[k, j] = goal.loop.judge(loop).normalised
    return table

"""Goals about the loop of a law of the robot, for many gain sets and plants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, ToolMissing
from surctl.ir import warn_slower
from surctl.marine.control import Gains
from surctl.marine.simulation import Case, case_parameters, law_numbers, simulate
from surctl.marine.simulation.batch.engines import trace_batch
from surctl.marine.simulation.loop import SingleRun
from surctl.marine.tuning.goals import Goal
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification import OperatingPoint, law_loop, steady_motion
from surctl.marine.verification.law_loop import operating_point, steadiest
from surctl.own_code import is_own
from surctl.system import LinearLoop

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
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, case_loop
        >>> (case,) = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> case_loop(case, case.gains, cruise=0.2).channels()[:4]
        ['surge', 'sway', 'heave', 'yaw']
    """
    law = (case if case.sensing == "truth" else replace(case, sensing="truth")).build()
    vehicle = _varied(case, plant)
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
    goal: Goal,
    case: Case,
    cruise: float | None,
    plants: Sequence[Mapping[str, float]],
    sets: Sets,
) -> NDArray[np.float64]:
    """Return the normalised values (n gain sets, plants) of a goal about the loop.

    The value is NaN if the plant cannot hold the speed, or the run of a law of the user's own has no steady motion.
    """
    if goal.loop is None:
        raise InputError("is not about the loop", key=f"goals.{goal.name}", remedy="give its `loop`")
    count = len(next(iter(sets.values())))
    keys = [tuple(sorted(plant.items())) for plant in plants]
    distinct = [dict(key) for key in dict.fromkeys(keys)]
    table = np.full((count, len(distinct)), np.nan)
    every = [
        (case.gains.with_values({name: float(values[k]) for name, values in sets.items()}), plant)
        for k in range(count)
        for plant in distinct
    ]
    motions = _motions(case, every) if is_own(case.law) else [None] * len(every)
    for place, ((gains, plant), motion) in enumerate(zip(every, motions, strict=True)):
        if motion is not _UNSTEADY:
            with suppress(InputError):
                loop = case_loop(case, gains, cruise=cruise, plant=plant, motion=motion)
                table.flat[place] = goal.loop.judge(loop).normalised
    place_of = {key: j for j, key in enumerate(dict.fromkeys(keys))}
    return table[:, [place_of[key] for key in keys]]


def _motions(case: Case, runs: Sequence[tuple[Gains, Mapping[str, float]]]) -> list[OperatingPoint | None]:
    """Return the steady motion of the run with each gain set and plant.

    The runs are simulated by the compiled loop. None stands for a motion that `case_loop` has to find: without a
    compiler, and on a path of more legs than the law holds.
    """
    case = replace(case, sensing="truth")
    names = sorted({name for _, plant in runs for name in plant})
    nominal = case_parameters(case)
    values = {name: [plant.get(name, nominal[name].value) for _, plant in runs] for name in names}
    values |= {name: [gains.values[name] for gains, _ in runs] for name in case.gains.values}
    law, motions = case.build(), list[OperatingPoint | None]()
    if case.scenario.path.fed:
        return [None] * len(runs)
    try:
        for (gains, plant), trace in zip(runs, trace_batch(case, values), strict=True):
            p = law_numbers(case.scenario, gains, case.model or case.vehicle)
            eta, nu = trace.plant[:, :4], trace.plant[:, 4:8]
            try:
                k = steadiest(eta, nu, trace.tau, law=law, scenario=case.scenario, p=p)
            except InputError:
                motions.append(_UNSTEADY)
                continue
            there = SingleRun(replace(case, vehicle=_varied(case, plant)), law, seed=0)
            u = there.at(trace.plant[k], k, p=p)["u"]
            motions.append(operating_point(case.scenario, k * law.dt, eta[k], nu[k], x=trace.law[k], u=u, p=p))
    except ToolMissing as missing:
        warn_slower(missing)
        return [None] * len(runs)
    return motions


_UNSTEADY = OperatingPoint(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(4), 0.0, "none")


def _varied(case: Case, plant: Mapping[str, float]) -> Vehicle:
    return case.vehicle.with_values({name.removeprefix("plant."): value for name, value in plant.items()})

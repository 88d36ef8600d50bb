"""Goals evaluated in batches of runs and loops: corner plants, fresh runs; goals judged at the end, or not at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, ToolMissing
from surctl.ir.native import warn_slower
from surctl.marine.control import Gains
from surctl.marine.simulation import Case, law_numbers, simulate, simulate_batch
from surctl.marine.simulation.batch.case import case_parameters
from surctl.marine.simulation.batch.engines import trace_batch
from surctl.marine.simulation.campaign.worlds import draw_plant
from surctl.marine.simulation.loop import SingleRun
from surctl.marine.tuning.goals import PART_OF, Goal
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification import law_loop, linear_table, steady_motion
from surctl.marine.verification.corners import range_ends
from surctl.marine.verification.cruise_loop import has_cruise_loop
from surctl.marine.verification.law_loop import OperatingPoint, operating_point, steadiest
from surctl.marine.verification.speeds import check_held
from surctl.own_code import is_own
from surctl.system import LinearLoop, every_combination
from surctl.tuning.montecarlo import APART
from surctl.tuning.pool import Condition, Evaluation, Sets, judged, scope

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
    goal: Goal, case: Case, cruise: float | None, plants: Sequence[Mapping[str, float]], sets: Sets
) -> NDArray[np.float64]:
    """Return the normalised values (n gain sets, plants) of a goal about the loop.

    The value is NaN if the plant cannot hold the speed, or the run of a law of the user's own has no steady motion.
    """
    if goal.loop is None:
        raise InputError("is not about the loop", key=f"goals.{goal.name}", remedy="give its `loop`")
    count = len(next(iter(sets.values())))
    distinct, which = _distinct(plants)
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
    return table[:, which]


def _distinct(plants: Sequence[Mapping[str, float]]) -> tuple[list[dict[str, float]], list[int]]:
    # the different plants, and for each plant its place among them
    keys = [tuple(sorted(plant.items())) for plant in plants]
    distinct = list(dict.fromkeys(keys))
    return [dict(key) for key in distinct], [distinct.index(key) for key in keys]


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


_DRAG = ("Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr")
_GROUPS = (("m11", "m22", "m33", "m44"), _DRAG, ("Fu_max", "Fv_max", "Fw_max", "Fr_max"))


def corners(vehicle: Vehicle) -> tuple[dict[str, float], ...]:
    """Return the plant parameters of the nominal vehicle, and those of the corners of the ranges in its vehicle file.

    In a corner, all masses are at the same end of their ranges. All drag coefficients are at one end of their ranges
    too, and so are all thrust limits. These three choices give up to eight corners. A parameter without a range keeps
    its value.
    """
    ends = ({f"plant.{name}": value for name, value in one.items()} for one in range_ends(vehicle, _GROUPS))
    return ({}, *(one for one in ends if one))


def conditions(cases: Sequence[Case], *, seeds: Sequence[int], with_corners: bool = True) -> tuple[Condition, ...]:
    """Return the conditions of every case: nominal plant with each seed, and each corner plant with the first seed.

    A case that does not depend on the seed is simulated with the first seed only.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import build_cases, conditions
        >>> cases = build_cases([load_scenario("tank-static")], gains=load_gains("default"))
        >>> runs = conditions(cases, seeds=[0])
        >>> len(runs), runs[0].label
        (9, 'tank-static/sur540-flooded/truth, seed 0')
    """
    result = []
    for case in cases:
        own = seeds if varied(case) else seeds[:1]
        result += [Condition(case, seed) for seed in own]
        if with_corners:
            result += [Condition(case, seeds[0], plant) for plant in corners(case.vehicle) if plant]
    return tuple(result)


def varied(case: Case) -> bool:
    """Return whether the runs of a case depend on the seed."""
    return case.scenario.seeded or case.sensing == "sonar"


def fresh(cases: Sequence[Case], *, runs: int, first: int, tuning: int = 0) -> tuple[Condition, ...]:
    """Return the conditions of fresh runs; the runs are assigned to the cases in turn.

    Every second run of a case has the nominal plant, because some goals apply to the nominal plant only. A case that
    does not depend on the seed has no runs with the nominal plant, because all of them would be equal.

    Args:
        cases: the simulated cases.
        runs: number of runs over all cases.
        first: number of seeds that this tuning has used so far.
        tuning: seed of the tuning; the runs of two tunings share no seed.
    """
    conditions = []
    for k in range(runs):
        case, seed = cases[k % len(cases)], tuning * APART + first + k
        nominal = k // len(cases) % 2 == 1 and varied(case)
        plant = {} if nominal else draw_plant(case.vehicle, seed=seed)
        conditions.append(Condition(case, seed, {f"plant.{name}": value for name, value in plant.items()}))
    return tuple(conditions)


def check_goals(goals: Sequence[Goal], conditions: Sequence[Condition]) -> None:
    """Raise InputError if goals do not fit the simulated conditions.

    Raises:
        InputError: a goal names a case that is not simulated, or its cruise speed exceeds the speed cap of one of its
            cases or needs more thrust than the vehicle of the case has.
    """
    for goal in goals:
        about = (conditions[k].case for k in scope(goal, conditions))
        for vehicle, cap in {(c.vehicle.name, c.scenario.cap): (c.vehicle, c.scenario.cap) for c in about}.values():
            check_held(goal.cruise, vehicle, cap=cap, key=goal.cruise_key)


def evaluate(goals: Sequence[Goal], conditions: Sequence[Condition], sets: Sets, *, threads: int = 1) -> Evaluation:
    """Evaluate m goals for n gain sets.

    Args:
        goals: the goals.
        conditions: the runs; every gain set is simulated in all of them.
        sets: values (n,) of each gain by name; all other gains have the values of the case.
        threads: number of threads of the compiled loop; the result does not depend on it.

    Raises:
        InputError: a value is out of its gain's bounds, or `check_goals` finds an error.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, build_cases, conditions, evaluate
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> goals = [Goal("soon", "time_s", "s", 20.3), Goal("clear", "min_clearance_m", "m", 0.08, "at least", "hard")]
        >>> evaluation = evaluate(goals, conditions(cases, seeds=[0]), {"k_v": [1.0, 1.5, 2.0]})
        >>> evaluation.normalised.round(2).tolist(), evaluation.feasible.tolist()
        ([[1.05, 0.84], [1.01, 0.82], [0.99, 0.81]], [True, True, True])
    """
    check_goals(goals, conditions)
    return judged(goals, conditions, figures(goals, conditions, sets, threads=threads))


def figures(
    goals: Sequence[Goal], conditions: Sequence[Condition], sets: Sets, *, threads: int = 1
) -> dict[str, NDArray[np.float64]]:
    """Return an array (n gain sets, conditions) for each metric of the goals and for the effort, by metric name.

    `Goal.columns` gives the names for goals at several cruise speeds.

    A value is NaN if the run did not arrive, or if no goal needs this linear metric under this condition.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, build_cases, conditions, figures
        >>> cases = build_cases([load_scenario("pool-behind")], gains=load_gains("default"), law="closed_form")
        >>> goals, runs = [Goal("soon", "time_s", "s", 20.5)], conditions(cases, seeds=[0, 1])
        >>> figures(goals, runs, {"k_v": [1.0, 1.5, 2.0]})["time_s"].round(2).tolist()  # one row for each gain set
        [[21.4, 21.4], [20.45, 20.35], [20.15, 20.05]]
    """
    count = len(next(iter(sets.values())))
    looped = {"effort_n", *(g.metric for g in goals if not g.linear)}
    linear = [g for g in goals if g.linear and g.loop is None]
    loops = [g for g in goals if g.loop is not None]
    needed: dict[float | None, set[int]] = {}  # compute only these, because a linear metric costs more than a run
    for goal in linear:
        for speed in goal.columns.values():
            needed.setdefault(speed, set()).update(scope(goal, conditions))
    columns = {(g.metric, speed): name for g in linear for name, speed in g.columns.items()}
    own_loops = [name for goal in loops for name in goal.columns]
    table = {name: np.full((count, len(conditions)), np.nan) for name in (*looped, *columns.values(), *own_loops)}
    plants = [condition.plant for condition in conditions]
    groups: dict[int, list[int]] = {}  # each case is simulated as one batch
    for k, condition in enumerate(conditions):
        groups.setdefault(id(condition.case), []).append(k)
    for own in groups.values():
        case = conditions[own[0]].case
        values = _spread(case, [plants[k] for k in own], sets, seed=[conditions[k].seed for k in own])
        batch = simulate_batch(case, values, seeds=values.pop("seed"), threads=threads)
        arrived = batch.column("reached").reshape(count, -1) > 0.5
        for name in looped:
            table[name][:, own] = np.where(arrived, batch.column(name).reshape(count, -1), np.nan)
        for speed, those in needed.items():
            about = [k for k in own if k in those]
            names = {metric for metric, at in columns if at == speed}
            if about:
                for name, column in _linear(case, speed, [plants[k] for k in about], sets, names, threads).items():
                    table[columns[name, speed]][:, about] = column
        for goal in loops:
            about = sorted(set(own) & set(scope(goal, conditions)))
            for name, speed in goal.columns.items() if about else ():
                table[name][:, about] = judged_loops(goal, case, speed, [plants[k] for k in about], sets)
    return table


def judged_goals(
    goals: Sequence[Goal], cases: Sequence[Case]
) -> tuple[tuple[Goal, ...], tuple[Goal, ...], tuple[Goal, ...]]:
    """Return the goals that the search judges, those that are checked at its end, and those that cannot be judged.

    A goal about a metric of the linear loop cannot be judged by the search if the law is not that of the model of these
    metrics. It is checked at the end if the assessment has the figure at that speed. A goal with `type` is judged on
    the law that runs.
    """
    linear = all(has_cruise_loop(case.law, case.guidance) for case in cases)
    late = [goal for goal in goals if goal.final or (goal.linear and goal.loop is None and not linear)]
    assessed = {max(case.scenario.cruise for case in cases)}
    final = tuple(g for g in late if g.metric in PART_OF and not g.cases and set(g.cruise) <= assessed)
    left = tuple(goal for goal in late if goal not in final)
    return tuple(goal for goal in goals if goal not in late), final, left


def _spread(
    case: Case, plants: Sequence[Mapping[str, float]], sets: Sets, **others: Sequence[float]
) -> dict[str, NDArray[np.float64]]:
    # every gain set with every plant; others: one number of each plant, by name
    nominal = case_parameters(case)
    varied = sorted({name for plant in plants for name in plant})
    own = {name: [plant.get(name, nominal[name].value) for plant in plants] for name in varied}
    return every_combination(sets, {**others, **own})


def _linear(
    case: Case, speed: float | None, plants: Sequence[Mapping[str, float]], sets: Sets, names: set[str], threads: int
) -> dict[str, NDArray[np.float64]]:
    # linear metrics (n, plants), computed once for each plant: seeds have no effect
    if not has_cruise_loop(case.law, case.guidance):  # the metrics of another law would mislead
        return dict.fromkeys(names, np.full((len(next(iter(sets.values()))), len(plants)), np.nan))
    distinct, which = _distinct(plants)
    count = len(next(iter(sets.values())))
    table = linear_table(
        case.vehicle,
        _spread(case, distinct, sets),
        base=case.gains.values,
        cruise=case.scenario.cruise if speed is None else speed,
        dt=case.build().dt,
        model=case.model or case.vehicle,
        columns=sorted(names),
        workers=threads,
        law=case.law,
    )
    return {name: table[name].reshape(count, len(distinct))[:, which] for name in names}

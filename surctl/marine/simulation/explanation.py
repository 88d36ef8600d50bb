"""Explain a run: why it ended or reached the time limit, and which tasks and rows the priority solver relaxed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surctl.marine.control.dead_end import SEARCH_PORT
from surctl.marine.simulation.fit import findings
from surctl.marine.simulation.run import Run, depth_changes
from surctl.marine.world import Prism
from surctl.priority import PriorityTimeline
from surctl.system.controller import lost_entry


def priority_timeline(run: Run) -> PriorityTimeline:
    """Return the priority timeline of a run, whose problem is solved again at each control step, with names of rows.

    Control steps whose input the law rejected are left out.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.simulation import load_scenario, priority_timeline, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law = build_law(mode="filter", contacts=1)
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=load_gains("default"), law=law)
        >>> timeline = priority_timeline(run)
        >>> [(name, round(float(most), 2)) for name, most in zip(timeline.levels, timeline.to_rows.max(axis=0))]
        [('velocity', 0.23), ('depth', 0.0), ('heading', 0.0)]
    """
    record, law = run.record, run.law
    steps = np.flatnonzero(record.status >= 0)
    solutions = [
        law.explained(record.law_state[k], record.law_input[k], record.parameters_at(k)) for k in steps.tolist()
    ]
    units = {name: unit for name, _, unit in law.levels}
    return PriorityTimeline.of(record.time[steps], solutions, units=units, rows=law.rows)


@dataclass(frozen=True)
class Explanation:
    """The constraint rows that bind or are relaxed, from `time_s` [s] until the next explanation.

    `text` describes the first control step of this interval.
    """

    time_s: float
    binding: tuple[str, ...]
    relaxed: tuple[str, ...]
    text: str


def explain(run: Run) -> list[Explanation]:
    """Return one explanation for each control step at which the set of binding or relaxed constraint rows changes.

    Mode `nsb` ignores the rows, so its relaxed rows are those that the velocity violates. Control steps with the status
    `NONFINITE` are left out.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.simulation import explain, load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law = build_law(mode="filter", contacts=1)
        >>> run = simulate(load_scenario("pool-behind"), load_vehicle("sur400"), gains=load_gains("default"), law=law)
        >>> first, second, *_ = explain(run)
        >>> print(first.text)
        No limit binds: v is the null-space-based law.
        >>> print(f"{second.time_s:.2f} s: {second.text}")
        10.15 s: Task `velocity` gave up 0.0017 m/s because `contact_0` binds.
    """
    record, explanations = run.record, list[Explanation]()
    for k, status in enumerate(record.status):
        if status < 0:
            continue
        solution = run.law.explained(record.law_state[k], record.law_input[k], record.parameters_at(k))
        binding, relaxed = tuple(name for name, _ in solution.binding), tuple(solution.relaxed)
        if not explanations or (binding, relaxed) != (explanations[-1].binding, explanations[-1].relaxed):
            explanations.append(Explanation(float(record.time[k]), binding, relaxed, solution.explain()))
    return explanations


_STILL = 0.2  # of the hull radius: a hull that stays within this distance rests (*chosen*)
_LEAST = 20.0  # [s] shortest rest at the end of a run that is said (*chosen*)
_NEAR = 4.0  # hull radii within which a drifting hull makes no way (*chosen*)
_TOUCH = 0.01  # [m] distance to the hull that counts as touching it
_NO_STEERAGE = "its rudders or fins do not turn it at rest"
_UNLEARNT = "guidance los does not learn the current: give --guidance ilos, also to surctl export"
_HELD_OFF = "a current keeps the hull beside the end of the path, unless the gain k_i is positive"


def failure(run: Run) -> str | None:
    """Return why a run fails (the command then exits with status 1); None if the robot arrives without contact."""
    m = run.metrics
    why = [] if m.reached else [f"it does not arrive ({m.stopped_because} at {m.time_s:.2f} s)"]
    why += [f"the hull touches an obstacle or wall (clearance {m.min_clearance_m:.3f} m)"] * (m.min_clearance_m <= 0)
    return f"{run.scenario.name} by {run.vehicle.name}: {', and '.join(why)}" if why else None


def stop_reason(run: Run) -> str:
    """Return why a run ended before its target, in one sentence without a full stop; empty if nothing is known.

    The sentence names what the hull touches, the information that the law lacked, the position where it gave up and the
    time without progress, where it stayed until the time limit, or the number that is not finite.
    """
    law, record, why = run.law, run.record, run.metrics.stopped_because
    known = {"dead end": _dead_end_reason, "time limit": _time_limit_reason, "collision": _collision_reason}
    if why in known:
        return known[why](run)
    if why == "fault":
        name = (
            lost_entry(law, record.law_state[-1], record.law_input[-1], record.parameters_at(-1))
            or "a number of the step"
        )
        return f"{name} is not finite at {record.time[-1]:.2f} s"
    if why != "standstill" or law.perception is None:
        return ""
    perceived = law.decision_inputs(record.law_state[-1], record.law_input[-1], record.parameters_at(-1))
    silent = np.flatnonzero(run.telemetry("healthy")[-1] < 0.5).tolist()
    if perceived[law.perception.outputs.slice("placed")][0] < 0.5:
        return "the robot does not know its position" + (f"; {_named(silent)} judged faulty" if silent else "")
    if len(silent) == law.outputs.port("healthy").size:
        return f"all sonars are judged faulty ({', '.join(map(str, silent))})"
    if not silent:
        return "the water ahead stays unknown, although every sonar is judged healthy"
    return f"the water ahead stays unknown; {_named(silent)} judged faulty"


def _rest(run: Run, within: float) -> float:
    """Return since when [s] the hull has stayed within this distance [m] of its last place."""
    place, time = run.record.eta[:, :2], run.record.time
    away = np.flatnonzero(np.hypot(*(place - place[-1]).T) > within)
    return float(time[away[-1] + 1]) if away.size else 0.0


def _collision_reason(run: Run) -> str:
    x, y, z = run.record.eta[-1, :3].tolist()
    bodies = run.record.obstacles[-1]
    apart, name = min(((Prism(b.shape, b.heights).distance(x, y, z), b.name) for b in bodies), default=(np.inf, ""))
    hit = name if apart <= run.vehicle["radius"] + _TOUCH else "a wall"
    near = _NEAR * run.vehicle["radius"]
    said, since = [f"the hull touches {hit} at ({x:.2f}, {y:.2f}) m"], _rest(run, near)
    if run.record.time[-1] - since >= _LEAST:
        said.append(f"the hull has stayed within {near:.2g} m of this point since {since:.0f} s")
        said += [_NO_STEERAGE] if run.vehicle.fin_share(run.scenario.cruise) > 0.5 else []
    return "; ".join(said)


def _time_limit_reason(run: Run) -> str:
    # where the hull stayed at the end, or since when it made no progress along the path, and the errors of the scenario
    place, time, vehicle = run.record.eta[-1, :2], run.record.time, run.vehicle
    near, said = _STILL * vehicle["radius"], []
    since = _rest(run, near)
    if time[-1] - since >= _LEAST and not since:
        said.append("the craft did not move")
    elif time[-1] - since >= _LEAST:
        left = float(np.hypot(*(run.scenario.target - place)))
        said.append(
            f"the hull has stayed within {near:.1g} m of ({place[0]:.2f}, {place[1]:.2f}) m since {since:.0f} s, "
            f"{left:.2f} m from the end of the path"
        )
        if vehicle.fin_share(run.scenario.cruise) > 0.5:
            said.append(_NO_STEERAGE)
        elif any(run.scenario.disturbance.current_m_per_s):
            beyond = run.record.law_state[-1, run.law.state.slice("progress")] >= run.scenario.path.length
            if beyond.all() and left > _TOUCH and not run.gains["k_i"]:
                said.append(_HELD_OFF)
            elif not beyond.all() and run.law.guidance == "los":
                said.append(_UNLEARNT)
    elif search := _search_reason(run):
        said.append(search)
    errors = [f for f in findings(run.scenario, vehicle, gains=run.gains) if f.level == "error"]
    return "; ".join([*said, *(f.text for f in errors if run.sensing == "sonar" or not f.key.startswith("sonar"))])


def _search_reason(run: Run) -> str:
    # a law that detects dead ends and still looked for a way round; the loop of another program keeps its own state
    law, record = run.law, run.record
    if "furthest" not in law.state or run.scenario.path.fed:
        return ""
    furthest = record.law_state[: record.time.size, law.state.slice("furthest")].ravel()
    since = float(record.time[int(np.argmax(furthest >= furthest[-1]))])
    if not furthest[-1] > -1 or record.time[-1] - since < _LEAST:
        return ""
    limit = run.scenario.sensors.equipment.search_limit
    limited = f", search_limit_s: {'none' if limit is None else f'{limit:g} s'}" if law.perception is not None else ""
    return (
        f"no progress along the path since {since:.0f} s, at {furthest[-1]:.1f} m of {run.scenario.path.length:.1f} m; "
        f"until the end it searched for a way round (gain patience: {run.gains['patience']:g} s{limited})"
    )


def _dead_end_reason(run: Run) -> str:
    law, record = run.law, run.record
    first = int(np.argmax(run.telemetry("trapped").ravel() > 0.5))
    x, y = record.eta[first, :2]
    state = record.law_state[first]
    furthest, stalled = (float(state[law.state.slice(name)][0]) for name in ("furthest", "stalled"))
    along, limit = "", run.scenario.sensors.equipment.search_limit
    if limit is not None and SEARCH_PORT.name in law.state:
        searching = float(state[law.state.slice(SEARCH_PORT.name)][0])
        if searching > limit - 2 * law.dt:  # the state is that before the step that gave up
            along, stalled = " along the path", searching
    if run.scenario.path.fed:  # the law measures along its window
        follower = run.scenario.follower()
        follower.track(record.eta[: first + 1, :2])
        furthest = float(run.scenario.path.lengths[: follower.leg].sum()) + follower.along
    length = run.scenario.path.length
    tried = [f"{change.to_m:.2f}" for change in depth_changes(run) if not change.back]
    depths = f"; depths tried besides the path's, z in m: {', '.join(tried)}" if tried else ""
    return (
        f"no progress{along} for {stalled:.0f} s, search ended at ({x:.2f}, {y:.2f}) m after "
        f"{record.time[first]:.0f} s; reached {furthest:.1f} m of the {length:.1f} m path{depths}"
    )


def _named(sensors: list[int]) -> str:
    if len(sensors) == 1:
        return f"sonar {sensors[0]} is"
    return f"sonars {', '.join(map(str, sensors[:-1]))} and {sensors[-1]} are"

"""The linear analysis of `surctl verify`: margins, poles, the slowest mode and the largest stable speed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from surctl.control import Gains, Law
    from surctl.simulation import Run, Scenario
    from surctl.vehicle import Vehicle

__all__ = ["LinearPart", "law_part", "linear_part", "over_speeds", "speed_lines"]


class LinearPart(NamedTuple):
    """Linear analysis at one cruise speed: lines to print, data for JSON, and metrics to compare over speeds.

    `stable` is None if no straight cruise is possible. `cruise` is the cruise speed [m/s]. `delay_s` is the least delay
    margin [s] of a single loop, and `disk` the least disk margin of a single loop; `peak` is the peak of the
    sensitivity S of all loops together. `failure` says why the run that shows the steady motion failed.
    """

    lines: list[str]
    data: dict[str, Any]
    stable: bool | None
    cruise: float
    delay_s: float = math.nan
    disk: float = math.nan
    peak: float = math.inf
    failure: str = ""


def law_part(
    law: str,
    vehicle: Vehicle,
    gains: Gains,
    *,
    cruise: float,
    uncertainty: float = 0.0,
    mission: Scenario | None = None,
) -> LinearPart:
    """Return the numeric analysis of the sampled loop of a law that the cascade does not describe.

    A law that steers is linearised about a straight cruise. Any other law is simulated, and linearised about the
    steadiest motion of this run.

    Args:
        law: reference of the law.
        vehicle: nominal plant and model of the controller.
        gains: the gains.
        cruise: cruise speed [m/s].
        uncertainty: relative uncertainty of mass and drag; 0: the ranges of the vehicle file, or the default of
            `law_corners`.
        mission: scenario of the simulated run, whose waves and drift are left out; None: a straight path in open water.

    Raises:
        InputError: the law is a user's own and fails.
    """
    from surctl.control import build_law, law_source
    from surctl.errors import InputError
    from surctl.simulation import stop_reason
    from surctl.verification import law_corners, steady_motion

    source, built = law_source(law), build_law(law)  # a mistake in a law of the user's own is an error
    own = gains.with_own(source.gains)
    run = None if source.steering is not None else _run(built, vehicle, own, cruise=cruise, mission=mission)
    if run is not None and run.metrics.stopped_because == "fault":
        why = f"the run of {run.scenario.name} ended with a fault: {stop_reason(run)}"
        unjudged: dict[str, Any] = {"margins": [], "linear": {"not_judged": why}}
        return LinearPart([f"margins: not judged, because {why}"], unjudged, None, cruise, failure=why)
    try:
        at = None if run is None else steady_motion(run)
        corners = law_corners(built, vehicle, own, cruise=cruise, uncertainty=uncertainty or None, at=at)
    except InputError as error:
        which = f"a cruise at {cruise:g} m/s" if error.key in (None, "cruise") else error.key
        why = f"not applicable to this vehicle, because {which} {error.problem}"
        return LinearPart([f"margins: {why}"], {"margins": [], "linear": {"not_applicable": why}}, None, cruise)
    loop = corners.nominal
    lines = [f"margins of {vehicle.name}:", *corners.lines()]
    data = {"margins": [m.to_dict() for m in loop.margins], "linear": corners.to_dict()}
    if law == "calm":
        further, data["by_sonar"] = _by_sonar(law, vehicle, own, cruise=cruise, mission=mission)
        lines += further
    delay = min((m.delay_margin_s for m in loop.margins), default=math.nan)
    disk = min((m.disk_margin for m in loop.margins), default=math.nan)
    return LinearPart(lines, data, corners.stable, cruise, delay, disk)


def _by_sonar(
    law: str, vehicle: Vehicle, gains: Gains, *, cruise: float, mission: Scenario | None
) -> tuple[list[str], list[dict[str, Any]]]:
    from surctl.control import build_law
    from surctl.errors import InputError
    from surctl.sensing import OwnState
    from surctl.verification import sonar_margins

    own = OwnState() if mission is None else mission.sensors.equipment.own
    if own is None:
        return [], []
    try:
        margins = sonar_margins(build_law(law, sonar=True), vehicle, gains, cruise=cruise, own=own)
    except InputError as error:
        return [f"margins by sonar: not judged, because {error.key} {error.problem}"], []
    late = f"own-state filter and fixes {own.fixes.latency:g} s late"
    head = f"by sonar, with {late}, about a straight cruise at {cruise:g} m/s without turning, nominal vehicle:"
    return [head, *(each.line() for each in margins)], [each.to_dict() for each in margins]


def _run(law: Law, vehicle: Vehicle, gains: Gains, *, cruise: float, mission: Scenario | None) -> Run:
    from surctl.simulation import Disturbance, mission_size, simulate, straight_mission

    if mission is None:
        scenario = straight_mission(vehicle, cruise=cruise, size=mission_size(vehicle, gains, cruise=cruise))
    else:
        calm = Disturbance(current_m_per_s=mission.disturbance.current_m_per_s)
        scenario = replace(mission, cruise=cruise, cap=max(mission.cap, cruise), disturbance=calm)
    return simulate(scenario, vehicle, gains=gains, law=law)


def linear_part(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, uncertainty: float
) -> LinearPart:
    """Return the linear analysis about a cruise speed [m/s], for the nominal and the worst uncertain vehicle.

    Raises:
        InputError: a gain is missing or not positive.
    """
    import numpy as np

    from surctl.errors import InputError
    from surctl.vehicle.linearise import check_cruise
    from surctl.verification import build_cascade, worst_margins
    from surctl.verification.linear import (
        DISK_PLACES,
        corners,
        linear_side,
        open_loop,
        sensitivity_of,
        slowest_mode,
        worst_linear_side,
    )

    tried = corners(vehicle, uncertainty or None)
    try:
        check_cruise(vehicle, cruise)
    except InputError as error:
        why = f"not applicable to this vehicle, because a cruise at {cruise:g} m/s {error.problem}"
        return LinearPart([f"margins: {why}"], {"margins": [], "linear": {"not_applicable": why}}, None, cruise)
    margins = worst_margins(vehicle, gains, uncertainty=uncertainty, cruise=cruise, dt=dt)
    nominal = linear_side(vehicle, gains, cruise=cruise, dt=dt)
    worst = worst_linear_side(tried, gains, cruise=cruise, dt=dt)
    mode = slowest_mode(vehicle, gains, cruise=cruise, dt=dt)
    least = min(margins, key=lambda m: m.delay_margin_s)
    stable = all(m.stable for m in margins)
    off = f" with mass and drag off by ±{uncertainty:.0%}" if uncertainty else ""
    word = f"stable, disk margin of all loops {_disk(nominal.disk)}" if mode.stable else f"UNSTABLE (loop {mode.loop})"
    if len(tried.vehicles) > 1:
        word += f", at the worst corner {_disk(worst.disk)}" if worst.stable else f", UNSTABLE at {worst.corner}"
    word += f", least delay margin {least.delay_margin_s:.2f} s ({least.name})" if stable else ""
    lines = [f"margins of {vehicle.name}{off}: {word}", *mode.lines()]
    if not stable:
        lines.append(
            "  the kinematic claims assume that the vehicle follows the commanded velocity, but this loop is unstable"
        )
    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt)
    curves = [sensitivity_of(open_loop(cascade, p), p, highest=np.pi / dt) for p in DISK_PLACES[:2] if cascade.stable]
    if curves:
        peaks = "; ".join(f"S {c.S.max():.2f}, T {c.T.max():.2f} ({c.place})" for c in curves)
        lines.append(f"  largest sensitivity of all loops together: {peaks}")
    lines += [*nominal.lines(), *(worst.lines() if len(tried.vehicles) > 1 else [])]
    if len(tried.vehicles) > 1 and not worst.stable and worst.at is not None:
        lines += slowest_mode(worst.at, gains, cruise=cruise, dt=dt, model=vehicle).remedy_lines()
    data = {
        "margins": [m.to_dict() for m in margins],
        "linear": {"nominal": nominal.to_dict(), "worst": worst.to_dict(), "mode": mode.to_dict()}
        | {"sensitivity": [c.to_dict() for c in curves]},
    }
    disk = min(m.disk_margin for m in margins)
    peak = max((float(c.S.max()) for c in curves), default=math.inf)
    return LinearPart(lines, data, stable, cruise, least.delay_margin_s, disk, peak)


def speed_lines(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, cap: float, dt: float, uncertainty: float
) -> tuple[list[str], dict[str, float]]:
    """Return the highest speeds at which all corners are stable, and have a disk margin: lines to print, numbers.

    If the cruise speed [m/s] is above the second speed, a line says what to change: the speed, or the gains.

    Speeds are in m/s. A warning is printed if the speed limit `cap` [m/s] exceeds one of these speeds.
    """
    from surctl.ir.stored_numbers import stored_numbers
    from surctl.verification.linear import LEAST_DISK_MARGIN, bearable_speed, corners, margin_speed

    tried = corners(vehicle, uncertainty or None)

    def searched() -> dict[str, float]:
        nominal = bearable_speed(vehicle, gains, dt=dt)
        stable = margin_speed(tried, gains, dt=dt, highest=nominal, least=0.0)
        robust = margin_speed(tried, gains, dt=dt, highest=stable)
        return {"nominal_stable": nominal, "stable": stable, "with_margin": robust, "disk_margin": LEAST_DISK_MARGIN}

    key = ([each.digest() for each in tried.vehicles], sorted(gains.items()), dt)
    numbers: dict[str, float] = stored_numbers(("surctl",), key, searched)  # the cascade reads laws, gains and plant
    nominal, stable, robust = numbers["nominal_stable"], numbers["stable"], numbers["with_margin"]
    whom = "the nominal vehicle and the corners" if len(tried.vehicles) > 1 else "the nominal vehicle"
    margin = f"disk margin of all loops at least {LEAST_DISK_MARGIN:g}"
    held = f"up to {robust:.3g} m/s" if robust > 0 else "at no speed with these gains (surctl tune searches others)"
    lines = [f"speeds of {whom}: stable with enough thrust up to {stable:.3g} m/s; {margin} {held}"]
    limits = (
        (nominal, "the bearable speed"),
        (stable, "up to which every corner is stable and has enough thrust"),
        (robust, "up to which every corner has that disk margin"),
    )
    over = next((f"exceeds {limit:.3g} m/s, {what}" for limit, what in limits if cap > limit > 0), None)
    lines += [] if over is None else [f"  warning: the cap, {cap:g} m/s, {over}; lower it"]
    if robust < cruise:
        lines.append(_change(vehicle, cruise=cruise, dt=dt, robust=robust))
    return lines, numbers


def _change(vehicle: Vehicle, *, cruise: float, dt: float, robust: float) -> str:
    # what reaches the required disk margin, or a larger one
    from surctl.tuning import derive_gains

    derived = derive_gains(vehicle, cruise=cruise, dt=dt)
    if derived.reached:
        better = f"gains derived for {cruise:g} m/s have {derived.disk_margin:.2f} (surctl gains derive)"
    elif derived.bearable > 0:
        better = f"up to {derived.bearable:.3g} m/s, gains derived for the speed have 0.4 (surctl gains derive)"
    else:
        better = "gains derived for a lower speed have no more"
    slower = f"cruise at {robust:.3g} m/s at most; " if robust > 0 else ""
    return f"  to change: {slower}{better}" + ("" if derived.reached else f"; to go faster, {derived.remedy}")


def _disk(margin: float) -> str:
    return "not determined" if math.isnan(margin) else f"{margin:.2f}"


def over_speeds(parts: Sequence[LinearPart]) -> LinearPart:
    """Combine analyses at several cruise speeds (slowest first): a comparison, then the whole analysis of the last."""
    import numpy as np

    from surctl.verification import worst_place, worst_text

    *_, last = parts
    if len(parts) == 1:
        return last
    lines = [f"margins at {len(parts)} cruise speeds (details for {last.cruise:g} m/s below):"]
    for part in parts:
        word = f"stable, least delay margin {part.delay_s:.2f} s, least disk margin of one loop {part.disk:.2f}"
        lines.append(f"  {part.cruise:g} m/s: " + (f"{word}, largest S {part.peak:.2f}" if part.stable else "UNSTABLE"))
    ill = {  # larger is worse
        "delay_margin_s": np.array([-part.delay_s for part in parts]),
        "disk_margin": np.array([-part.disk for part in parts]),
        "sensitivity_peak": np.array([part.peak for part in parts]),
    }
    worst = {name: parts[int(worst_place(each))].cruise for name, each in ill.items()}
    delay, disk, peak = (worst_text(each, [part.cruise for part in parts]) for each in ill.values())
    lines.append(f"  worst speed: delay margin at {delay}, disk margin at {disk}, S at {peak}")
    speeds = [{"cruise_m_per_s": part.cruise, "stable": part.stable, **part.data} for part in parts]
    data = {**last.data, "speeds": speeds, "worst_cruise_m_per_s": worst}
    return last._replace(lines=lines + last.lines, data=data, stable=all(part.stable for part in parts))

"""`surctl verify`, linear part: margins, poles, slowest mode, stable speeds; advice on gains, speed and cap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from surctl.errors import InputError
from surctl.marine.cli import lib


class LinearPart(NamedTuple):
    """Linear analysis at one cruise speed: lines to print, data for JSON, and metrics to compare over speeds.

    `stable` is None if no straight cruise is possible. `cruise` is the cruise speed [m/s]; `peak` is the peak of the
    sensitivity S of all loops together.
    """

    lines: list[str]
    data: dict[str, Any]
    stable: bool | None
    cruise: float
    loops: lib.LoopCorners | None = None
    peak: float = math.inf

    @property
    def short(self) -> bool:
        """Whether a margin of the loop is below the least sufficient value."""
        return self.loops is not None and not self.loops.enough


def linear_part(assessment: lib.Assessment, mission: lib.Mission) -> LinearPart:
    """Return the linear part of an assessment: about a straight cruise, or about a steady motion."""
    loop: lib.LoopAnalysis = assessment.sources["loop"]
    if loop.unjudged:
        key, why = "not_judged", loop.unjudged
        word = f"not judged, because {why}"
        if not loop.failed:
            key, why = "not_applicable", f"not applicable to this vehicle, because {why}"
            word = why
        unjudged: dict[str, Any] = {"margins": [], "linear": {key: why}}
        return LinearPart([f"margins: {word}"], unjudged, None, mission.cruise)
    lines, linear, peak = _loop_lines(loop, mission)
    data: dict[str, Any] = {"margins": [m.to_dict() for m in loop.margins], "linear": linear}
    source = lib.law_source(mission.law_ref)
    if loop.mode is None and source.scans and "sonar" in source.sensing:
        further, data["by_sonar"] = _by_sonar(mission)
        lines += further
    return LinearPart(lines, data, loop.stable, mission.cruise, loop.loops, peak)


def _loop_lines(loop: lib.LoopAnalysis, mission: lib.Mission) -> tuple[list[str], dict[str, Any], float]:
    loops, nominal, vehicle = loop.loops, loop.nominal, mission.vehicle
    assert loops is not None  # the caller asked
    lines, data = [f"{nominal.head}, {vehicle.name}:", *loops.lines(), *nominal.notes()], loops.to_dict()
    curves = []
    for place, signals in nominal.linear.places.items() if nominal.stable else ():
        omega, S, T = lib.sensitivity_curves(nominal.linear, signals)
        curves.append({"place": place, "omega_rad_s": omega.tolist(), "S": S.tolist(), "T": T.tolist(),
                       "peak_S": float(S.max()), "peak_T": float(T.max())})  # fmt: skip
    if curves:
        peaks = "; ".join(f"S {c['peak_S']:.2f}, T {c['peak_T']:.2f} ({c['place']})" for c in curves)
        lines.append(f"  largest sensitivity of all loops together: {peaks}")
    data["sensitivity"] = curves
    if loop.mode is not None:
        lines += loop.mode.lines()
        data["mode"] = loop.mode.to_dict()
        worst = lib.corners(vehicle, mission.uncertainty).vehicle(loops.corner)
        if not nominal.stable:
            claims = "the kinematic claims assume that the vehicle follows the commanded velocity"
            lines.append(f"  {claims}, but this loop is unstable")
        elif not loops.stable:
            about: dict[str, Any] = {"dt": mission.period, "model": vehicle, "law": mission.law_ref}
            lines += lib.slowest_mode(worst, mission.gains.values, cruise=loop.cruise, **about).remedy_lines()
    if loop.motion:
        lines.append(f"  {loop.motion}")
        data["motion"] = loop.motion
    return lines, data, max((c["peak_S"] for c in curves), default=math.inf)


def _by_sonar(mission: lib.Mission) -> tuple[list[str], list[dict[str, Any]]]:
    scenario = next(iter(mission.scenarios), None)
    own = lib.OwnState() if scenario is None else scenario.sensors.equipment.own
    if own is None:
        return [], []
    law, vehicle, cruise = mission.law_ref, mission.vehicle, mission.cruise
    gains = mission.gains
    try:
        margins = lib.sonar_margins(lib.vehicle_law(vehicle, law, sonar=True), vehicle, gains, cruise=cruise, own=own)
    except InputError as error:
        return [f"margins by sonar: not judged, because {error.key} {error.problem}"], []
    late = f"own-state filter and fixes {own.fixes.latency:g} s late"
    head = f"by sonar, with {late}, about a straight cruise at {cruise:g} m/s without turning, nominal vehicle:"
    return [head, *(each.line() for each in margins)], [each.to_dict() for each in margins]


def speed_lines(mission: lib.Mission, *, short: bool) -> tuple[list[str], dict[str, float]]:
    """Return the highest speeds at which all corners are stable, and have a disk margin: lines to print, numbers.

    If the cruise speed is above the second speed or a margin is too small (`short`), a line says what to change:
    the speed, or the gains.

    Speeds are in m/s. A warning is printed if the speed limit of the mission exceeds one of these speeds.
    """
    gains, law, dt, cruise, cap = mission.gains.values, mission.law_ref, mission.period, mission.cruise, mission.cap
    tried = lib.corners(mission.vehicle, mission.uncertainty)

    def searched() -> dict[str, float]:
        nominal = lib.bearable_speed(tried.alone, gains, dt=dt, law=law)
        stable = lib.bearable_speed(tried, gains, dt=dt, law=law)
        robust = lib.bearable_speed(tried, gains, dt=dt, law=law, least=lib.LEAST_DISK_MARGIN)
        return {
            "nominal_stable": nominal,
            "stable": stable,
            "with_margin": robust,
            "disk_margin": lib.LEAST_DISK_MARGIN,
        }

    key = ([each.digest() for each in tried.vehicles], sorted(gains.items()), dt, law)
    numbers: dict[str, float] = lib.stored_numbers(("surctl",), key, searched)  # the loop reads laws, gains and plant
    nominal, stable, robust = numbers["nominal_stable"], numbers["stable"], numbers["with_margin"]
    whom = "the nominal vehicle and the corners" if len(tried.vehicles) > 1 else "the nominal vehicle"
    margin = f"disk margin at least {lib.LEAST_DISK_MARGIN:g}"
    held = f"up to {robust:.3g} m/s" if robust > 0 else "at no speed with these gains (surctl tune searches others)"
    lines = [f"speeds of {whom}: stable with enough thrust up to {stable:.3g} m/s; {margin} {held}"]
    limits = (
        (nominal, "the bearable speed"),
        (stable, "up to which every corner is stable and has enough thrust"),
        (robust, "up to which every corner has that disk margin"),
    )
    for limit, what in limits:
        if cap > limit > 0:
            lower = "lower it" if limit >= cruise else "lower it and the cruise speed"
            lines.append(f"  warning: the cap, {cap:g} m/s, exceeds {limit:.3g} m/s, {what}; {lower}")
            break
    if robust < cruise or short:
        lines.append(_change(mission, robust=robust))
    return lines, numbers


def _change(mission: lib.Mission, *, robust: float) -> str:
    # what reaches the required margins, or larger ones

    cruise = mission.cruise
    derived = lib.derive_gains(mission.vehicle, cruise=cruise, dt=mission.period)
    if derived.reached:
        better = (
            f"gains derived for {cruise:g} m/s have a disk margin of {derived.disk_margin:.2f} and a delay margin of "
        )
        better += f"{derived.delay_margin_s:.2f} s (surctl gains derive)"
    elif derived.bearable > 0:
        better = f"up to {derived.bearable:.3g} m/s, gains derived for the speed have {lib.REQUIRED}"
        better += " (surctl gains derive)"
    else:
        better = "gains derived for a lower speed have no more"
    slower = f"cruise at {robust:.3g} m/s at most; " if 0 < robust < cruise else ""
    return f"  to change: {slower}{better}" + ("" if derived.reached else f"; to go faster, {derived.remedy}")


def over_speeds(parts: Sequence[LinearPart]) -> LinearPart:
    """Combine analyses at several cruise speeds (slowest first): a comparison, then the whole analysis of the last."""
    import numpy as np

    *_, last = parts
    if len(parts) == 1:
        return last
    lines = [f"margins at {len(parts)} cruise speeds, worst corner (details for {last.cruise:g} m/s below):"]
    margins = [(math.nan, math.nan) if (c := part.loops) is None else (c.delay.delay_s, c.disk) for part in parts]
    for part, (delay, disk) in zip(parts, margins, strict=True):
        word = f"stable, least delay margin {delay:.2f} s, disk margin {disk:.2f}"
        lines.append(f"  {part.cruise:g} m/s: " + (f"{word}, largest S {part.peak:.2f}" if part.stable else "UNSTABLE"))
    figures = np.array([(*each, part.peak) for each, part in zip(margins, parts, strict=True)]).T
    names = ("delay_margin_s", "disk_margin", "sensitivity_peak")
    over = lib.OverSpeeds(tuple(part.cruise for part in parts), dict(zip(names, figures, strict=True)))
    slow, weak, steep = map(over.where, over.figures)
    lines.append(f"  worst speed: delay margin at {slow}, disk margin at {weak}, S at {steep}")
    worst = {name: over.worst(name)[1] for name in over.figures}
    speeds = [{"cruise_m_per_s": part.cruise, "stable": part.stable, **part.data} for part in parts]
    data = {**last.data, "speeds": speeds, "worst_cruise_m_per_s": worst}
    return last._replace(lines=lines + last.lines, data=data, stable=all(part.stable for part in parts))

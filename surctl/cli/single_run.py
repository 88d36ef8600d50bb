"""The output of a command about one closed-loop run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surctl.marine.simulation import Run
    from surctl.marine.vehicle import Vehicle

from surctl.cli.output import saving

__all__ = ["activity_line", "failure", "further_output", "linear_part", "linear_warning", "run_line", "series_lines"]

_ROUNDING = 1e-9  # [N/s], [N m/s] variation of a thrust below which it is that of rounding
_CRABBING = 15.0  # [deg] mean crab angle from which the line of a run says that the hull crabs


def run_line(run: Run) -> str:
    """Return one line with the scenario, the vehicle, how the run ended, and its main metrics."""
    m = run.metrics
    missed = (
        f", a corner missed by {m.missed_corner_m:.3f} m" if m.missed_corner_m > run.scenario.arrival_radius else ""
    )
    crab = f", but crabbing {m.crab_angle_deg:.0f} deg" if m.crab_angle_deg > _CRABBING else ""
    error = "no path error, because the whole run counts as avoidance"
    if m.path_error_m >= 0:
        error = f"path error {m.path_error_m:.3f} m"
    return (
        f"{run.scenario.name} by {run.vehicle.name}, {run.sensing}, seed {run.seed}: {m.stopped_because} at "
        f"{m.time_s:.2f} s{crab}, least clearance {m.min_clearance_m:.3f} m, {error}{missed}"
    )


def activity_line(run: Run) -> str:
    """Return one line with crab angle, heading error, thrust activity and wasted thrust of a run."""
    m = run.metrics
    angles = f"crab angle {m.crab_angle_deg:.0f} deg (largest {m.max_crab_angle_deg:.0f}), " * (m.crab_angle_deg >= 0)
    angles += f"heading error {m.heading_error_deg:.0f} deg; " * (m.heading_error_deg >= 0)
    axes = (
        m.variation_surge_n_per_s,
        m.variation_sway_n_per_s,
        m.variation_heave_n_per_s,
        m.variation_yaw_n_m_per_s,
    )
    varies = ", ".join(f"{one if abs(one) > _ROUNDING else 0:.2g}" for one in axes)
    return (
        f"  {angles}thrust varies by {varies} (N/s in surge, sway, heave, N m/s in "
        f"yaw); worst axis: {m.axis_sign_changes_per_s:.2g} sign changes/s, saturated {m.axis_saturated_share:.0%} of "
        f"the time; wasted {m.wasted_impulse_n_s:.0f} N s ({m.wasted_share:.0%})"
    )


def failure(run: Run) -> str | None:
    """Return why a run fails (the command then exits with status 1); None if the robot arrives without contact."""
    m = run.metrics
    why = [] if m.reached else [f"it does not arrive ({m.stopped_because} at {m.time_s:.2f} s)"]
    why += [f"the hull touches an obstacle or wall (clearance {m.min_clearance_m:.3f} m)"] * (m.min_clearance_m <= 0)
    return f"{run.scenario.name} by {run.vehicle.name}: {', and '.join(why)}" if why else None


def series_lines(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return at most five lines about runs of one scenario that differ in the seed.

    The lines name two runs that collide or do not arrive, and a low margin of the linear loop, which all runs share.
    """
    from surctl.verification.linear import LEAST_DISK_MARGIN

    times = [run["time_s"] for run in runs if run["reached"]]
    worst = min(runs, key=lambda run: run["min_clearance_m"])
    collided = sum(run["min_clearance_m"] <= 0 for run in runs)
    arrivals = f"arrival after {min(times):.2f} to {max(times):.2f} s, " if times else ""
    lines = [
        f"{worst['scenario']} by {worst['vehicle']}, {worst['sensing']}: {len(times)} of {len(runs)} runs arrive, "
        f"{collided} collide",
        f"  {arrivals}least clearance {worst['min_clearance_m']:.3f} m (seed {worst['seed']}); --seed N prints one run",
    ]
    failing = [run for run in runs if not (run["reached"] and run["min_clearance_m"] > 0)]
    lines += [
        f"  seed {run['seed']}: {run['stopped_because']} at {run['time_s']:.2f} s, least clearance "
        f"{run['min_clearance_m']:.3f} m"
        for run in failing[:2]
    ]
    linear = worst["linear"] or {}
    if not linear.get("stable", True):
        lines.append("  the linear loop at this speed is unstable")
    elif (margin := linear.get("disk_margin", LEAST_DISK_MARGIN)) < LEAST_DISK_MARGIN:
        lines.append(
            f"  the linear loop has a disk margin of {margin:.2f} at its worst corner (below {LEAST_DISK_MARGIN:g})"
        )
    return lines


def linear_part(run: Run, result: dict[str, Any]) -> list[str]:
    """Add to `result` whether the linear loop at cruise speed is stable; return lines to print if its margin is low."""
    from surctl.marine.control import law_source

    if law_source(run.law.ref).steering is not None:
        result["linear"] = None
        return _sampled_part(run, result)
    attitude = run.attitude
    crab = "" if attitude is None else f", mean crab angle {attitude.crab_angle_deg:.0f} deg"
    data, lines = linear_warning(
        run.vehicle,
        run.gains.values,
        cruise=run.scenario.fastest,
        dt=run.law.dt,
        law=run.law.ref,
        guidance=run.law.guidance,
        crab=crab,
    )
    result["linear"] = data
    return lines


def linear_warning(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    law: str,
    guidance: str,
    model: Vehicle | None = None,
    crab: str = "",
) -> tuple[dict[str, Any] | None, list[str]]:
    """Return the stability and the disk margin of the linear loop of a run as data, and lines about a defect.

    There are lines if the loop is unstable, or if the disk margin is below the least one. The data is None if the law
    has no linear loop, or if the thrust cannot hold the speed (which lint reports). `crab` is appended to the first
    line.
    """
    from surctl.errors import InputError
    from surctl.marine.verification.cascade import has_cascade
    from surctl.marine.verification.linear import corner_margin, slowest_mode
    from surctl.verification.linear import LEAST_DISK_MARGIN

    if not has_cascade(law, guidance):
        return None, []
    try:
        margin, _, corner = corner_margin(vehicle, gains, cruise=cruise, dt=dt, model=model)
    except InputError:
        return None, []
    data: dict[str, Any] = {"cruise_m_per_s": cruise, "stable": True, "disk_margin": margin, "corner": corner}
    if margin >= LEAST_DISK_MARGIN:
        return data, []
    mode = slowest_mode(vehicle, gains, cruise=cruise, dt=dt, model=model)
    data |= {"stable": mode.stable, "mode": mode.to_dict()}
    if mode.stable:
        word = f"has a disk margin of {margin:.2f}" if margin > 0 else "is unstable"
        return data, [f"  the linear loop at this speed {word} at {corner} (at least {LEAST_DISK_MARGIN:g}){crab}"]
    head = f"  the linear loop at this speed is unstable{crab}:"
    return data, [head, *(f"    {line.strip()}" for line in mode.lines())]


def _sampled_part(run: Run, result: dict[str, Any]) -> list[str]:
    from surctl.errors import InputError
    from surctl.marine.verification import law_loop

    try:
        loop = law_loop(run.law, run.vehicle, run.gains, cruise=run.scenario.fastest)
    except InputError:  # the thrust cannot hold this speed; lint reports it
        return []
    result["linear"] = {"cruise_m_per_s": loop.cruise, "stable": loop.stable, "sampled": loop.to_dict()}
    return [] if loop.stable else ["  the linear loop at this speed is unstable:", f"    {loop.lines()[0]}"]


def further_output(
    run: Run, result: dict[str, Any], *, explained: bool, out: Path | None, animate: Path | None = None
) -> list[str]:
    """Return lines about depth changes, explanations, animation and plots, and write the plots to the folder `out`.

    Explanations and the path of the animation are also added to `result`.
    """
    from surctl.marine.simulation import depth_changes, thruster_use

    lines = [f"  {change}" for change in depth_changes(run)]
    if (use := thruster_use(run)) is not None:
        result["thrusters"] = use.to_dict()
        lines.append(f"  {use.line()}")
    if explained:
        from surctl.marine.simulation import explain

        explanations = explain(run)
        result["explanations"] = [asdict(one) for one in explanations]
        lines += [f"  {one.time_s:6.2f} s  {one.text}" for one in explanations]
    if out is not None:
        with saving("plots"):
            from surctl.marine.report import save_priority, save_run

            lines.append(f"  {save_run(run, out)}")
            if explained:
                lines.append(f"  {save_priority(run, out)}")
    if animate is not None:
        with saving("animation"):
            from surctl.marine.report import save_animation

            result["animation"] = str(save_animation(run, animate))
            lines.append(f"  {result['animation']}")
    return lines

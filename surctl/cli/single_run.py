"""The output of a command about one closed-loop run."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surctl.simulation import Run

__all__ = ["failure", "further_output", "linear_part", "run_line"]


def run_line(run: Run) -> str:
    """Return one line with the scenario, the vehicle, how the run ended, and its main metrics."""
    m = run.metrics
    missed = (
        f", a corner missed by {m.missed_corner_m:.3f} m" if m.missed_corner_m > run.scenario.arrival_radius else ""
    )
    return (
        f"{run.scenario.name} by {run.vehicle.name}, {run.sensing}, seed {run.seed}: {m.stopped_because} at "
        f"{m.time_s:.2f} s, least clearance {m.min_clearance_m:.3f} m, path error {m.path_error_m:.3f} m{missed}"
    )


def failure(run: Run) -> str | None:
    """Return why a run fails (the command then exits with status 1); None if the robot arrives without contact."""
    m = run.metrics
    why = [] if m.reached else [f"it does not arrive ({m.stopped_because} at {m.time_s:.2f} s)"]
    why += [f"the hull touches an obstacle or wall (clearance {m.min_clearance_m:.3f} m)"] * (m.min_clearance_m <= 0)
    return f"{run.scenario.name} by {run.vehicle.name}: {', and '.join(why)}" if why else None


def linear_part(run: Run, result: dict[str, Any]) -> list[str]:
    """Add to `result` whether the linear loop at cruise speed is stable; return lines to print if it is not."""
    from surctl.errors import InputError
    from surctl.verification.cascade import build_cascade, has_cascade
    from surctl.verification.linear import slowest_mode

    cruise, dt, gains = run.scenario.cruise, run.law.dt, run.gains.values
    result["linear"] = None
    if not has_cascade(run.law.ref, run.law.guidance):
        return []
    try:
        stable = build_cascade(run.vehicle, gains, cruise=cruise, dt=dt).stable
    except InputError:  # the thrust cannot hold this speed; lint reports it
        return []
    result["linear"] = {"cruise_m_per_s": cruise, "stable": stable}
    if stable:
        return []
    mode = slowest_mode(run.vehicle, gains, cruise=cruise, dt=dt)
    result["linear"]["mode"] = mode.to_dict()
    attitude = run.attitude
    crab = "" if attitude is None else f", mean crab angle {attitude.crab_angle_deg:.0f} deg"
    head = f"  the linear loop at this speed is unstable{crab}:"
    return [head, *(f"    {line.strip()}" for line in mode.lines())]


def further_output(
    run: Run, result: dict[str, Any], *, explained: bool, out: Path | None, animate: Path | None = None
) -> list[str]:
    """Return lines about depth changes, explanations, animation and plots, and write the plots to the folder `out`.

    Explanations and the path of the animation are also added to `result`.
    """
    from surctl.simulation import depth_changes, thruster_use

    lines = [f"  {change}" for change in depth_changes(run)]
    if (use := thruster_use(run)) is not None:
        result["thrusters"] = use.to_dict()
        lines.append(f"  {use.line()}")
    if explained:
        from surctl.simulation import explain

        explanations = explain(run)
        result["explanations"] = [asdict(one) for one in explanations]
        lines += [f"  {one.time_s:6.2f} s  {one.text}" for one in explanations]
    if out is not None:
        from surctl.report import save_run

        lines.append(f"  {save_run(run, out)}")
        if explained:
            from surctl.report import save_priority

            lines.append(f"  {save_priority(run, out)}")
    if animate is not None:
        from surctl.report import save_animation

        result["animation"] = str(save_animation(run, animate))
        lines.append(f"  {result['animation']}")
    return lines

"""`surctl vehicle thrusters`: what the thrusters of a vehicle can do together, and after a failure."""

from __future__ import annotations

from pathlib import Path

import click

from surctl.cli.output import as_json, finish, out_folder, saving

__all__ = ["thrusters"]

_FASTEST, _LARGEST = 100.0, 1e9  # [m/s], [N, N m]
_AXES = ("surge", "sway", "heave", "yaw")


@click.command
@click.argument("name", metavar="VEHICLE")
@click.option("--failed", multiple=True, metavar="NAME", help="Thruster that gives no force; may be repeated.")
@click.option(
    "--speed",
    type=float,
    default=1.0,
    metavar="U",
    help="Forward speed of rudders [m/s] (default 1).",
)
@click.option("--force", "wrench", type=float, nargs=4, metavar="FU FV FW FR", help="Allocate this force [N, N m].")
@out_folder
@as_json
def thrusters(
    name: str,
    failed: tuple[str, ...],
    speed: float,
    wrench: tuple[float, float, float, float] | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Print the forces that the thrusters of a vehicle give on each axis and together; with --force, their allocation.

    Examples: surctl vehicle thrusters bluerov2-heavy --out pictures; surctl vehicle thrusters bluerov2-heavy --failed
    T2 --force 40 30 0 5
    """
    from surctl.errors import InputError
    from surctl.marine.allocation import allocate, working_flags
    from surctl.marine.simulation import held_share, thruster_findings
    from surctl.marine.vehicle import axis_ends, load_vehicle

    if not 0 <= speed <= _FASTEST:
        problem = f"must be at least 0 and at most {_FASTEST:g}"
        raise InputError(problem, key="--speed", value=speed, remedy="give a forward speed in m/s")
    if wrench is not None and not max(map(abs, wrench)) <= _LARGEST:
        problem = f"must be finite and at most {_LARGEST:g} in size"
        raise InputError(problem, key="--force", value=list(wrench), remedy="give F_u, F_v, F_w in N and F_r in N m")
    vehicle = load_vehicle(name).at_speed(speed)
    actuators = vehicle.actuators
    if actuators is None:
        raise InputError(
            "describes no thrusters",
            file=vehicle.source,
            remedy="add [[thruster]] tables, as in surctl list --show bluerov2-heavy",
        )
    working_flags(actuators, failed)
    intervals, share = axis_ends(actuators, speed, failed=failed), held_share(vehicle, failed)
    result = {
        "vehicle": vehicle.name,
        "order": list(actuators.order),
        "failed": list(failed),
        "speed_m_per_s": speed,
        "intervals": {axis: ends.tolist() for axis, ends in zip(_AXES, intervals, strict=True)},
        "box_share": share,
        "findings": [finding.to_dict() for finding in thruster_findings(vehicle)],
    }
    lines = [f"{vehicle.name}: {len(actuators.thrusters)} thrusters, order {', '.join(actuators.order)}"]
    lines += [f"  {line}" for line in actuators.lines()]
    at = f" that have thrust at rest, at {speed:g} m/s" if actuators.fins else ""
    lost = f", without {', '.join(failed)}" if failed else ""
    lines.append(f"largest values on each axis, with 0 on the others{at}{lost}")
    for axis, (low, high), unit in zip(_AXES, intervals.tolist(), ("N", "N", "N", "N m"), strict=True):
        lines.append(f"  {axis:<6} {low:>8.2f} to {high:>7.2f} {unit}")
    limits = ", ".join(f"{key} {vehicle[key]:g}" for key in ("Fu_max", "Fv_max", "Fw_max", "Fr_max"))
    lines.append(f"at once in every combination: {share:.3g} times the limits {limits}")
    if wrench is not None:
        allocation = allocate(actuators, wrench, failed=failed, speed=speed)
        result["allocation"] = {
            "achieved": allocation.achieved.tolist(),
            "forces": dict(zip(actuators.names, allocation.forces.tolist(), strict=True)),
            "commands": dict(zip(actuators.names, allocation.commands.tolist(), strict=True)),
            "angles_rad": dict(allocation.angles),
            "roll_pitch_n_m": [allocation.roll, allocation.pitch],
            "gave_up": dict(allocation.gave_up),
            "binding": {level: list(names) for level, names in allocation.binding.items()},
        }
        lines.append("allocation: " + allocation.explain())
        for one, force, command in zip(actuators.names, allocation.forces, allocation.commands, strict=True):
            angle = f", joint at {allocation.angles[one]:.3f} rad" if one in allocation.angles else ""
            lines.append(f"  {one:<6} {force:>8.2f} N, command {command:+.4f}{angle}")
        lines.append(f"  not controlled: roll {allocation.roll:.3g} N m, pitch {allocation.pitch:.3g} N m")
    if out is not None:
        with saving("plot"):
            from surctl.marine.report import save_attainable

            result["file"] = str(save_attainable(vehicle, out, failed=failed))
            lines.append(f"wrote {result['file']}")
    finish(result, lines, as_json=as_json, passed=True)

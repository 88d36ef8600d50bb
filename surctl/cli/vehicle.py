"""`surctl vehicle`: derive a vehicle file from measurements."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from surctl.cli.output import as_json, finish
from surctl.cli.thrusters import thrusters

if TYPE_CHECKING:
    from surctl.vehicle import Identified, Vehicle

__all__ = ["vehicle"]


class _Measured(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.3 only
    # a number with unit, such as "54 cm"; without a unit, the unit that the help names applies
    def __init__(self, unit: str) -> None:
        self.unit, self.name = unit, unit

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        from surctl.errors import InputError
        from surctl.units import in_unit, number_and_unit

        if isinstance(value, float):
            return value
        try:
            number, unit = number_and_unit(str(value))
            return in_unit(number, unit or self.unit, self.unit)
        except InputError as error:
            key = param.opts[0] if param is not None else None
            raise InputError(error.problem, key=key, value=value, remedy=error.remedy) from None


_out = click.option(
    "--out", type=click.Path(path_type=Path), metavar="FILE", help="Vehicle file to write (default NAME.toml)."
)
_over = click.option("--force", is_flag=True, help="Overwrite an existing file.")
_name = click.option("--name", default="my-vehicle", metavar="TEXT", help="Name of the vehicle (default my-vehicle).")


@click.group()
def vehicle() -> None:
    """Write a vehicle file: from-geometry for a sphere, or from-log from a recording. Show what its thrusters can do.

    Examples: surctl vehicle from-geometry --help; surctl vehicle from-log --help; surctl vehicle thrusters --help
    """


vehicle.add_command(thrusters)


@vehicle.command("from-geometry")
@_name
@click.option("--diameter", type=_Measured("m"), required=True, help='Diameter of the sphere [m], or e.g. "54 cm".')
@click.option("--mass", type=_Measured("kg"), required=True, help="Mass in air, with the water drained [kg].")
@click.option(
    "--flooded",
    type=float,
    default=0.75,
    metavar="X",
    help="Fraction of the water inside the hull that moves with it (default 0.75).",
)
@click.option(
    "--cd", type=float, default=0.52, metavar="X", help="Drag coefficient of the frontal area (default 0.52)."
)
@click.option(
    "--thrust", type=_Measured("N"), required=True, help="Largest force along each axis [N], or with kgf or lbf."
)
@click.option("--yaw-thrust", type=_Measured("N m"), required=True, help="Largest moment about the vertical [N m].")
@click.option("--thrust-lag", type=_Measured("s"), default=0.3, help="First-order lag of the thrust [s] (default 0.3).")
@click.option(
    "--density", type=_Measured("kg/m^3"), default=1000.0, help="Density of the water [kg/m^3] (default 1000)."
)
@_out
@_over
@as_json
def from_geometry(
    name: str,
    diameter: float,
    mass: float,
    flooded: float,
    cd: float,
    thrust: float,
    yaw_thrust: float,
    thrust_lag: float,
    density: float,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Derive the parameters of a spherical vehicle, each with a range and its source.

    This command covers spheres only. For another hull, fit the parameters to a log (surctl vehicle from-log), or write
    known parameters into a file (surctl new vehicle).

    Example: surctl vehicle from-geometry --name mine --diameter "40 cm" --mass "6 kg" --thrust 0.5kgf
    --yaw-thrust "0.4 N m"
    """
    from surctl.vehicle import sphere

    robot = sphere(
        name,
        diameter=diameter,
        dry_mass=mass,
        thrust=thrust,
        yaw_thrust=yaw_thrust,
        flooded=flooded,
        drag_coefficient=cd,
        thrust_lag=thrust_lag,
        density=density,
    )
    lines = [f"{robot.name}: {robot.note}"]
    for key, p in robot.parameters.items():
        bounds = "" if p.range is None else f"  {p.range[0]:.4g} to {p.range[1]:.4g}"
        lines.append(f"  {key:<10} {p.value:>9.4g} {p.unit:<10}{bounds}")
    _write(robot, out, force, lines, {"vehicle": robot.name, "parameters": _numbers(robot)}, as_json=as_json)


@vehicle.command("from-log")
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--start",
    default="sur540-flooded",
    metavar="FILE",
    help="Vehicle that supplies hull, limits and initial values: name or file (default sur540-flooded).",
)
@click.option(
    "--frame",
    metavar="NAME",
    help="Frame of the log: enu (ENU/FLU) or ned (NED/FRD) (default: as in its first line, else enu).",
)
@_name
@_out
@_over
@as_json
def from_log(log: Path, start: str, frame: str | None, name: str, out: Path | None, force: bool, as_json: bool) -> None:
    """Fit masses, drag and thrust lag to a recording of motion and thrust (CSV, .mat, .nc), with 95 % intervals.

    The log has the columns t_s and Fu_N, Fv_N, Fw_N, Fr_N_m (commands, constant until the next row). It has those of
    the columns x_m, y_m, z_m, psi_rad, u_m_per_s, v_m_per_s, w_m_per_s, r_rad_per_s that were measured: x forward,
    y left, z up; or with --frame ned: x north, y east, z down, v to the right, w down. A parameter that the log does
    not determine keeps its value from --start, and the file says so. surctl simulate --save csv (or mat, nc) writes
    simulated runs as such logs.

    Example: surctl vehicle from-log trial.csv --start my-vehicle.toml --name fitted
    """
    from surctl.vehicle import identify, load_vehicle, read_motion_log

    fit = identify(read_motion_log(log, frame=frame), load_vehicle(start), name=name)
    result = {
        "vehicle": name,
        "start": fit.start.name,
        "estimates": {
            key: {"value": value, "half_interval": half, "identified": key in fit.identified, "start": fit.start[key]}
            for key, (value, half) in fit.estimates.items()
        },
        "noise": dict(fit.noise),
        "notes": list(fit.notes),
        "parameters": _numbers(fit.vehicle),
    }
    _write(fit.vehicle, out, force, _fit_lines(fit), result, as_json=as_json)


def _fit_lines(fit: Identified) -> list[str]:
    lines = [f"{fit.vehicle.name}: {fit.vehicle.note}", f"  {'':<10} {'estimate':>9}   95 % interval   start"]
    for key, (value, half) in fit.estimates.items():
        unit = fit.vehicle.parameters[key].unit
        estimate = f"{value:>9.4g} ± {half:<9.3g}" if key in fit.identified else f"{'':>9}   not determined"
        lines.append(f"  {key:<10} {estimate:<23} {fit.start[key]:>8.4g} {unit}")
    lines += [f"  noise of {column}: {level:.3g}" for column, level in fit.noise.items()]
    return lines + [f"  note: {note}" for note in fit.notes]


def _numbers(robot: Vehicle) -> dict[str, Any]:
    return {k: {"value": p.value, "unit": p.unit, "range": p.range} for k, p in robot.parameters.items()}


def _write(
    robot: Vehicle, out: Path | None, force: bool, lines: list[str], result: dict[str, Any], *, as_json: bool
) -> None:
    from surctl.cli.new import path_of, write_new
    from surctl.vehicle import write_vehicle

    target = write_new(out or path_of(robot.name, ".toml"), write_vehicle(robot), force=force)
    shown = shlex.quote(str(target))
    then = [f"surctl lint {shown}", f"surctl tune --vehicle {shown} --out tuned"]
    finish({**result, "file": str(target)}, [*lines, f"wrote {target}"], as_json=as_json, passed=True, then=then)

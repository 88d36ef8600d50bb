"""`surctl vehicle`: write a vehicle file from dimensions, a log or a Gazebo model; what its thrusters can do."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from surctl.cli.new import path_of, write_new
from surctl.cli.options import FILE, FiniteRange, option, options, out_folder
from surctl.cli.output import as_json, finish, saving
from surctl.errors import InputError
from surctl.marine.cli import lib

_FASTEST, _LARGEST = 100.0, 1e9  # [m/s], [N, N m]


@click.command
@click.argument("name", metavar="VEHICLE")
@click.option("--failed", multiple=True, metavar="NAME", help="Name of a thruster that gives no force; repeatable.")
@click.option(
    "--speed", type=float, default=1.0, metavar="U", help="Forward speed of a vehicle with rudders [m/s] (default 1)."
)
@click.option(
    "--force",
    "wrench",
    type=float,
    nargs=4,
    metavar="FU FV FW FR",
    help="Allocate to the thrusters: forces forward, left and up [N], moment counter-clockwise [N m].",
)
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
    """Print the largest force of a vehicle's thrusters per axis.

    Also print the share of the vehicle's force limits that the thrusters give on all axes at once. With --force, print
    the force of each thruster for a total force.

    Examples: surctl vehicle thrusters bluerov2-heavy --out pictures; surctl vehicle thrusters bluerov2-heavy --failed
    T2 --force 40 30 0 5
    """
    if not 0 <= speed <= _FASTEST:
        problem = f"must be at least 0 and at most {_FASTEST:g}"
        raise InputError(problem, key="--speed", value=speed, remedy="give a forward speed in m/s")
    if wrench is not None and not max(map(abs, wrench)) <= _LARGEST:
        problem = f"must be finite and at most {_LARGEST:g} in size"
        raise InputError(problem, key="--force", value=list(wrench), remedy="give F_u, F_v, F_w in N and F_r in N m")
    vehicle = lib.load_vehicle(name).at_speed(speed)
    actuators = vehicle.actuators
    if actuators is None:
        remedy = "add [[thruster]] tables, as in surctl list --show bluerov2-heavy"
        raise InputError("describes no thrusters", file=vehicle.source, remedy=remedy)
    lib.working_flags(actuators, failed)
    intervals, share = lib.axis_ends(actuators, speed, failed=failed), lib.held_share(vehicle, failed)
    result = {
        "vehicle": vehicle.name,
        "order": list(actuators.order),
        "failed": list(failed),
        "speed_m_per_s": speed,
        "intervals": {axis: ends.tolist() for axis, ends in zip(lib.AXES[:4], intervals, strict=True)},
        "box_share": share,
        "findings": [finding.to_dict() for finding in lib.thruster_findings(vehicle)],
    }
    lines = [f"{vehicle.name}: {len(actuators.thrusters)} thrusters, order {', '.join(actuators.order)}"]
    lines += [f"  {line}" for line in actuators.lines()]
    at = f" that have thrust at rest, at {speed:g} m/s" if actuators.fins else ""
    lost = f", without {', '.join(failed)}" if failed else ""
    ends = zip(lib.AXES[:4], intervals.tolist(), ("N", "N", "N", "N m"), strict=True)
    values = ", ".join(f"{axis} {low:.2f} to {high:.2f} {unit}" for axis, (low, high), unit in ends)
    lines.append(f"largest values on each axis, with 0 on the others{at}{lost}: {values}")
    limits = ", ".join(f"{key} {vehicle[key]:g}" for key in ("Fu_max", "Fv_max", "Fw_max", "Fr_max"))
    lines.append(f"at once in every combination: {share:.3g} times the limits {limits}")
    if wrench is not None:
        allocation = lib.allocate(actuators, wrench, failed=failed, speed=speed)
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
            named = (vehicle.name, "thrusters", *(f"without-{name}" for name in failed))
            result["file"] = str(lib.save_figure(lib.plot_attainable(vehicle, failed=failed), out, named))
            lines.append(f"wrote {result['file']}")
    finish(result, lines, as_json=as_json, passed=True)


class _Measured(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.4 only
    # a number with unit, such as "54 cm"; without a unit, the unit that the help names applies
    def __init__(self, unit: str) -> None:
        self.unit, self.name = unit, unit

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        if isinstance(value, float):
            return value
        try:
            number, unit = lib.number_and_unit(str(value))
            return lib.in_unit(number, unit or self.unit, self.unit)
        except InputError as error:
            key = param.opts[0] if param is not None else None
            raise InputError(error.problem, key=key, value=value, remedy=error.remedy) from None


_out = click.option("--out", type=FILE, help="Vehicle file to write (default NAME.toml).")
_over = click.option("--force", is_flag=True, help="Overwrite an existing file.")
_yaw_thrust = click.option(
    "--yaw-thrust", type=_Measured("N m"), required=True, help="Largest moment about the vertical axis [N m]."
)
_lag = click.option(
    "--thrust-lag", type=_Measured("s"), default=0.3, help="Time constant of the thrusters' lag [s] (default 0.3)."
)
_name = click.option("--name", default="my-vehicle", metavar="TEXT", help="Name of the vehicle (default my-vehicle).")


@click.group()
def vehicle() -> None:
    """Write a vehicle file from dimensions, from a log or from a Gazebo model; print the forces of thrusters.

    Examples: surctl vehicle from-geometry --help; surctl vehicle from-log --help; surctl vehicle thrusters --help
    """


vehicle.add_command(thrusters)


@vehicle.command("from-geometry")
@_name
@click.option(
    "--diameter", type=_Measured("m"), required=True, help='Diameter of the sphere [m], or a text such as "54 cm".'
)
@click.option("--mass", type=_Measured("kg"), required=True, help="Mass in air, without water in the hull [kg].")
@click.option(
    "--flooded",
    type=float,
    default=0.75,
    metavar="X",
    help="Fraction of the water in the hull that moves with the hull (default 0.75).",
)
@click.option(
    "--cd", type=float, default=0.52, metavar="X", help="Drag coefficient of the frontal area (default 0.52)."
)
@click.option(
    "--thrust",
    type=_Measured("N"),
    required=True,
    help='Largest force along each axis [N], or a text such as "0.5 kgf".',
)
@_yaw_thrust
@_lag
@click.option(
    "--density", type=_Measured("kg/m^3"), default=1000.0, help="Density of the water [kg/m^3] (default 1000)."
)
@_out
@_over
@as_json
def from_geometry(mass: float, cd: float, out: Path | None, force: bool, as_json: bool, **numbers: Any) -> None:
    """Write the file of a spherical vehicle from its dimensions.

    Each parameter has a range and the source of its value. For a hull that is not a sphere, fit the parameters to a log
    (surctl vehicle from-log), or write known parameters into a file (surctl new vehicle).

    A number without unit is in the unit that the help of its option states; a vehicle file needs the unit.

    Example: surctl vehicle from-geometry --name mine --diameter "40 cm" --mass "6 kg" --thrust 0.5kgf
    --yaw-thrust "0.4 N m"
    """
    robot = lib.sphere(dry_mass=mass, drag_coefficient=cd, **numbers)
    _write(robot, out, force, _parameter_lines(robot), _summary(robot), as_json=as_json)


@vehicle.command("from-gazebo")
@click.argument("model", type=click.Path(path_type=Path))
@_name
@click.option("--link", metavar="NAME", help="Link of the model that has hydrodynamics (default: the only one).")
@click.option("--diameter", type=_Measured("m"), required=True, help="Diameter of a circle around the hull [m].")
@click.option("--thrust", type=_Measured("N"), required=True, help="Largest force in surge [N].")
@click.option("--sway-thrust", type=_Measured("N"), help="Largest force in sway [N] (default: that of --thrust).")
@click.option("--heave-thrust", type=_Measured("N"), help="Largest force in heave [N] (default: that of --thrust).")
@_yaw_thrust
@_lag
@_out
@_over
@as_json
def from_gazebo(
    model: Path, name: str, diameter: float, out: Path | None, force: bool, as_json: bool, **numbers: Any
) -> None:
    """Write a vehicle file from a Gazebo model: SDF, or URDF of uuv_simulator.

    surctl reads mass, added mass and drag from the plugin gz::sim::systems::Hydrodynamics, the element
    fluid_added_mass, and a hydrodynamic_model of type fossen. The vehicle file has surge, sway, heave and yaw of the
    model, without roll and pitch. First expand a xacro file: xacro FILE > robot.urdf.

    A number without unit is in the unit that the help of its option states; a vehicle file needs the unit.

    Example: surctl vehicle from-gazebo model.sdf --name auv --diameter 0.5 --thrust 40 --yaw-thrust 6
    """
    robot = lib.gazebo_vehicle(model, name, radius=diameter / 2, **numbers)
    _write(robot, out, force, _parameter_lines(robot), _summary(robot), as_json=as_json)


@dataclass(frozen=True, eq=False, repr=False)
class _Fitting:
    """How logs are read, fitted and predicted."""

    start: str = option(
        "--start",
        "Vehicle (name or file) with hull, limits, and initial values of the fit (default sur540-flooded).",
        "sur540-flooded",
        metavar="FILE",
    )
    map_file: Path | None = option(
        "--map",
        "TOML file that says which topics and fields of the log are motion and thrust (not needed for tables of "
        "surctl simulate).",
        type=FILE,
    )
    topics: bool = option("--topics", "Print the topics and fields of the log, and fit nothing.", False)
    frame: str | None = option(
        "--frame",
        "Axes of a table: enu (ENU/FLU) or ned (NED/FRD) (default: as in the table's first line, else enu).",
        metavar="NAME",
    )
    share: float = option(
        "--held-out",
        "Fraction of the log, at its end, to predict by a fit to the rest (default 0.4; 0: no prediction).",
        0.4,
        type=FiniteRange(0.0, 0.9),
        metavar="X",
    )
    windows: tuple[float, ...] = option(
        "--window",
        "Length of a held-out prediction from a measured state [s] (default 5; repeatable).",
        (5.0,),
        type=FiniteRange(min=0.0, min_open=True),
        metavar="S",
    )
    picture: Path | None = option("--picture", "PNG file for a plot of the prediction (default: none).", type=FILE)


@vehicle.command("from-log")
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@options(fitting=_Fitting)
@_name
@_out
@_over
@as_json
def from_log(
    logs: tuple[Path, ...], fitting: _Fitting, name: str, out: Path | None, force: bool, as_json: bool
) -> None:
    """Fit the parameters of a vehicle to logs of its motion.

    The parameters are masses, drag, thrust lag and a constant force, with 95 % intervals. Several logs of one vehicle
    give one fit; each log has its own initial state.

    A log can be a table (CSV, .mat, .nc), as surctl simulate --save writes it: time t_s and commands Fu_N, Fv_N, Fw_N,
    Fr_N_m (constant until the next row), and any measured columns of x_m, y_m, z_m, psi_rad, u_m_per_s, v_m_per_s,
    w_m_per_s, r_rad_per_s. In a table, x is east, y north, z up, u forward, v left, w up; with --frame ned, x is north,
    y east, z down, v right, w down. The velocities in a table are along axes that turn with the heading, but not with
    roll and pitch. If the vehicle of --start has roll and pitch, the table also needs roll_rad or pitch_rad,
    and may have p_rad_per_s and q_rad_per_s.

    Logs of ArduPilot (.BIN, .tlog), ROS (.bag, .db3 or folder, .mcap) and PX4 (.ulg) need --map, and so does a table
    with column names other than those above. --topics prints the topics and fields of a log.

    If the log does not determine a parameter, the parameter keeps its value from --start, and the vehicle file says so.
    If the 95 % interval of a fitted mass or drag lies below 0, no file is written, and the exit status is 1. As a test,
    a fit to the first part of the log predicts the last part; the output compares its errors with those of a
    prediction with constant velocity.

    Example: surctl vehicle from-log trial.csv --start my-vehicle.toml --name fitted
    """
    share, picture, map_file = fitting.share, fitting.picture, fitting.map_file
    if fitting.topics:
        if len(logs) > 1:
            raise click.UsageError("--topics takes one log")
        named = lib.load_log_map(map_file) if map_file else None
        recording = lib.read_recording(logs[0], log_map=named, map_name=str(map_file or ""))
        fields = {topic: list(held.fields) for topic, held in recording.topics.items()}
        lines = [*lib.topic_lines(recording), *(f"  note: {note}" for note in recording.notes)]
        finish({"topics": fields, "notes": list(recording.notes)}, lines, as_json=as_json, passed=True)
    if picture is not None and share == 0:
        raise click.UsageError("--picture needs a prediction: --held-out above 0")
    robot = lib.load_vehicle(fitting.start)
    measured = lib.in_sequence([_read_log(log, map_file, fitting.frame) for log in logs])
    fit = lib.identify(measured, robot, name=name)
    predictions = lib.held_out_windows(measured, robot, fitting.windows, share=share) if share > 0 else ()
    windowed = [
        {"window_s": p.window, "windows": p.windows, "model": p.model, "last_velocity_held": p.hold}
        for p in predictions
    ]
    result = {
        "vehicle": name,
        "start": fit.start.name,
        "estimates": {
            key: {
                "value": value,
                "half_interval": half,
                "identified": key in fit.identified,
                "start": fit.start_value(key),
                "in_file": fit.fitted_value(key),
            }
            for key, (value, half) in fit.estimates.items()
        },
        "held": list(fit.held),
        "fixed_at_0": list(fit.zeroed),
        "not_determined": list(fit.directions),
        "sections": fit.sections,
        "noise": dict(fit.noise),
        "notes": list(fit.notes),
        "held_out": windowed[0] if windowed else None,
        "held_out_windows": windowed,
        "parameters": _numbers(fit.vehicle),
    }
    lines = [*_fit_lines(fit), *_prediction_lines(predictions, share)]

    def plot() -> None:
        with saving("plot"):
            if not predictions or picture is None:
                raise InputError("needs a prediction", key="--picture", remedy="give a longer log")
            title = f"{name}, fitted to the first {1 - share:.0%} of {', '.join(log.name for log in logs)}"
            figure = lib.plot_prediction(predictions[0], title=title)
            lines.append(f"picture {lib.save_figure(figure, picture.parent, (picture.stem,))}")

    draw = plot if picture else lambda: None
    if fit.refusal:
        draw()
        refused = [*lines, f"not written: {fit.refusal}"]
        brief = [refused[-1], lines[0]]
        finish(result | {"refusal": fit.refusal}, refused, as_json=as_json, passed=False, brief=brief)
    _write(fit.vehicle, out, force, lines, result, as_json=as_json, plot=draw)


def _read_log(log: Path, map_file: Path | None, frame: str | None) -> lib.MotionLog:
    if map_file is not None:
        if frame is not None:
            raise InputError(
                "cannot be combined with a map, which states the frame", file=map_file, key="--frame", value=frame,
                remedy="write log.frame in the map, and omit --frame",
            )  # fmt: skip
        return lib.read_mapped_log(log, map_file)
    if log.is_dir() or log.suffix.lower() in lib.FORMATS:
        raise InputError(
            "needs a map", file=log, remedy="see surctl vehicle from-log LOG --topics, then give --map FILE"
        )
    return lib.read_motion_log(log, frame=frame)


def _fit_lines(fit: lib.Identified) -> list[str]:
    lines = [f"{fit.vehicle.name}: {fit.vehicle.note}"]
    if fit.sections > 1:
        lines.append(
            f"  {fit.sections} sections without a gap, of at most {lib.LONGEST:g} s each, each with its own start"
        )
    lines.append(f"  {'':<10} {'estimate':>9}   95 % interval   {'in file':>8} {'start':>8}")
    for key, (value, half) in fit.estimates.items():
        unit = fit.unit(key)
        estimate = f"{value:>9.4g} ± {half:<9.3g}" if key in fit.identified else f"{'':>9}   {_kind(fit, key)}"
        lines.append(f"  {key:<10} {estimate:<23} {fit.fitted_value(key):>8.4g} {fit.start_value(key):>8.4g} {unit}")
    lines += [f"  noise of {column}: {level:.3g}" for column, level in fit.noise.items()]
    lines += [f"  not determined: {text}" for text in fit.directions]
    return lines + [f"  note: {note}" for note in fit.notes]


def _kind(fit: lib.Identified, key: str) -> str:
    if key in fit.zeroed:
        return "fixed at 0"
    if key in fit.drifting:
        return "drifts; mean"
    return "not determined" if key in fit.held else "with those held"


def _prediction_lines(predictions: tuple[lib.Prediction, ...], share: float) -> list[str]:
    if not predictions:
        return ["  no held-out prediction: the log is too short"] if share > 0 else []
    lines = []
    for prediction in predictions:
        lines += [
            f"  held-out prediction: the last {share:.0%} by a fit to the rest, {prediction.windows} windows of "
            f"{prediction.window:g} s, RMS error",
            f"    {'':<11} {'model':>9} {'last velocity held':>19}",
        ]
        for column, error in prediction.model.items():
            held = prediction.hold[column]
            worse = "  worse than holding" if error > held else ""
            lines.append(f"    {column:<11} {error:>9.3g} {held:>19.3g}{worse}")
    return lines


def _parameter_lines(robot: lib.Vehicle) -> list[str]:
    lines = [f"{robot.name}: {robot.note}"]
    for key, p in robot.parameters.items():
        bounds = "" if p.range is None else f"  {p.range[0]:.4g} to {p.range[1]:.4g}"
        lines.append(f"  {key:<10} {p.value:>9.4g} {p.unit:<10}{bounds}")
    return lines


def _summary(robot: lib.Vehicle) -> dict[str, Any]:
    return {"vehicle": robot.name, "parameters": _numbers(robot)}


def _numbers(robot: lib.Vehicle) -> dict[str, Any]:
    return {k: {"value": p.value, "unit": p.unit, "range": p.range} for k, p in robot.parameters.items()}


def _write(
    robot: lib.Vehicle, out: Path | None, force: bool, lines: list[str], result: dict[str, Any], *, as_json: bool,
    plot: Callable[[], None] = lambda: None,
) -> None:  # fmt: skip
    target = write_new(out or path_of(robot.name, ".toml"), lib.write_vehicle(robot), force=force)
    plot()
    shown = shlex.quote(str(target))
    then = [f"surctl lint {shown}", f"surctl tune --vehicle {shown} --out tuned"]
    finish(
        {**result, "file": str(target)}, [*lines, f"wrote {target}"],
        as_json=as_json, passed=True, then=then, files=[f"wrote {target}"],
        brief=[lines[0], *(line.strip() for line in lines[1:] if line.startswith(_NOTED))],
    )  # fmt: skip


_NOTED = ("  note: ", "  not determined: ", "  no held-out", "  held-out")

"""`surctl export` of the robot: law and mission as C or FMU, --constant-gains, the scene as a MuJoCo model."""

from __future__ import annotations

import shlex
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from surctl.cli.export import TARGETS, ExportOptions
from surctl.cli.output import FILE, Count, collected, finish, progress
from surctl.errors import InputError
from surctl.marine.cli.robot_options import (
    GAINS_HELP,
    MISSION,
    RobotOptions,
    barrier_options,
    check_barrier,
    choose_gains,
    choose_law,
    choose_sensing,
    choose_vehicle,
    form_options,
    law_option,
    priority_options,
)
from surctl.marine.cli.sensor_options import SensorOptions, sensor_data, sensor_options, split_faults

if TYPE_CHECKING:
    from surctl.assessment import Assessment
    from surctl.marine.simulation import Run


@click.command
@click.argument("words", nargs=-1, metavar="")
@click.option("--gains", metavar="FILE", help=GAINS_HELP)
@click.option("--vehicle", metavar="FILE", help="Vehicle: name or file (default: that of the scenario).")
@click.option(
    "--scenario", default=MISSION, metavar="FILE", help="Mission and sensors: name or file (default pool-static)."
)
@law_option
@form_options
@priority_options
@barrier_options
@click.option("--sensing", metavar="NAME", help="Obstacles: sonar (default if the law allows it) or truth.")
@sensor_options
@click.option("--constant-gains", is_flag=True, help="Write gains and mission as constants; needs --sensing truth.")
@click.option(
    "--certificate",
    "certificates",
    multiple=True,
    type=FILE,
    metavar="F",
    help="Certificate file to add to the bundle; repeatable.",
)
@click.option("--seed", type=Count(0), default=0, help="Seed of noise, drift and waves (default 0).")
@collected(robot=RobotOptions, sensors=SensorOptions, options=ExportOptions)
def export(
    words: tuple[str, ...],
    scenario: str,
    robot: RobotOptions,
    sensors: SensorOptions,
    options: ExportOptions,
    constant_gains: bool,
    certificates: tuple[Path, ...],
    seed: int,
    as_json: bool,
) -> None:
    """Write the controller as C99, compile the C code, and compare C with Python in every step of a simulated run.

    --check also compares the code of gcc and clang at -O0 to -O3, and of QEMU's Cortex-M3, -M4F and -M7, with Python:
    every byte of the outputs must be equal. --prove takes minutes for a law with sonars; the proof covers all gains
    within the ranges of the gain file. FILE.py:FUNCTION exports the controller of a system of your own. Exit status:
    1 if C and Python differ, or if a line of the output says FAIL; even then, the command writes the code.

    Examples: surctl export --gains surctl-out/gains.toml --out firmware; surctl export --law closed_form --sensing
    truth --constant-gains --check; surctl export my_system.py:build --seconds 5
    """
    if words:
        raise click.UsageError(f"Got unexpected extra argument ({words[0]})")
    import numpy as np

    from surctl.export import Records
    from surctl.export.bundle import check_folder
    from surctl.export.envelope import as_records
    from surctl.export.prove import gain_box
    from surctl.marine.control import law_source
    from surctl.marine.export import build_bundle, closed_form, operating_envelope
    from surctl.marine.export.origin import load_certificates, origin_of
    from surctl.marine.export.robot_bundle import replay_of
    from surctl.marine.guidance import MAX_WAYPOINTS
    from surctl.marine.simulation import law_numbers, load_scenario, simulate
    from surctl.marine.simulation.batch.case import fed_ranges
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.vehicle.linearise import command_range

    options = options.for_processor()
    if options.target == "mjcf":
        export_scene(scenario, robot.vehicle, out=options.out, as_json=as_json)
    real, tools = options.checked((*TARGETS, "mjcf"))
    refused = "give the exported step the input `working`, or use surctl simulate"
    sensors = replace(sensors, faults=split_faults(sensors.faults, refused=refused)[0])
    mission = load_scenario(scenario)
    choice = choose_vehicle(robot.vehicle, (mission.name, mission.vehicle))
    vehicle = load_vehicle(choice.word)
    check_barrier(robot.barrier, robot.movers)
    law, why = choose_law(robot.law, [vehicle])
    sensing = choose_sensing(robot.sensing, law)
    click.get_current_context().params["sensing"] = sensing
    sensors.check(sensing=sensing)
    mission = sensors.over(mission)
    chosen = choose_gains(robot.gains, vehicle, cruise=mission.cruise, own=law_source(law).gains)
    tuned = chosen.gains
    built = replace(robot, sensing=sensing).case(law, mission, vehicle, tuned).build(robot.fallback)
    numbers = law_numbers(mission, tuned, vehicle)
    if mission.path.fed and constant_gains:
        raise InputError(
            f"has more than {MAX_WAYPOINTS} points, or speeds or depths for its legs, which are inputs of the program",
            file=mission.source,
            key="path_m",
            remedy="remove --constant-gains",
        )
    table = mission.path.table(visits=mission.corners == "visit") if mission.path.fed else None
    shipped = closed_form(built, real=real, constants=numbers if constant_gains else None)
    within = operating_envelope(built, mission, vehicle, shipped.gains, tuned=None if constant_gains else numbers)
    if options.prove and not constant_gains:
        within = replace(within, gains=gain_box(built, numbers, {**tuned.ranges, **fed_ranges(mission)}))
    fixed = {} if constant_gains else built.gains.unpack(numbers)
    assumed = mission.sensors.on(vehicle["radius"]) if sensing == "sonar" else None
    origin = origin_of(built, vehicle, load_certificates(certificates), equipment=assumed)
    check_folder(options.out)  # an invalid name or folder is reported before the simulation
    bundle = build_bundle(shipped, fixed, name=options.name, real=real, envelope=within, origin=origin, mission=table)
    limit = command_range(vehicle) if vehicle.actuators is None else vehicle.thrust_bound
    bundle, proof = options.proved(shipped, bundle, limit)
    progress(f"simulating {mission.name}")
    run = simulate(mission, vehicle, gains=tuned, law=built, sensing=sensing, seed=seed)
    record, metrics, replay = run.record, run.metrics, replay_of(run)
    failed = replay.about["failure"]
    p = np.zeros((len(record.law_state), 0)) if constant_gains else record.step_parameters
    records = as_records(shipped, Records(record.law_state, record.law_input, p))
    compared = options.compared(shipped, bundle, records, fixed, tools)
    data = {
        "failure": failed,
        "vehicle_from": choice.origin,
        "derived_gains": chosen.data,
        "run": run.to_dict() | ({"sensors": sensor_data(mission)} if sensing == "sonar" else {}),
    }
    started = _how_to_start(options.out, click.get_current_context())
    alone = started[1].partition(" --controller ")[0]  # the run in Python
    text = f"{mission.name} by {vehicle.name}, {sensing}, seed {seed}: {metrics.stopped_because} at "
    lost = [] if failed is None else [f"the replayed run failed: {failed}; see: {alone}"]
    belong = [shlex.join(["surctl", "check", str(file), "--bundle", str(options.out)]) for file in certificates[:1]]
    runs = shutil.which("make") and not (mission.path.fed and options.real != "float64")
    options.finish(
        compared, bundle, _assessed(run, sensing),
        proof=proof, replay=replay, replayed=f"{text}{metrics.time_s:.2f} s",
        about=([*why, choice.line(vehicle.name), *chosen.lines], lost), data=data, same=compared.sil.conclusive,
        then=[*belong, *started] if runs else belong, as_json=as_json,
    )  # fmt: skip


_RUN_OPTIONS = (
    *("vehicle", "gains", "law", "avoidance", "guidance", "priority_mode", "fallback", "sensing"),
    *("faults", "chances", "seed"),
)


def _assessed(run: Run, sensing: str) -> Assessment:
    """Return what is assessed of the exported law, without the region of attraction."""
    from surctl.assessment import assess
    from surctl.marine.assessment import Mission

    law, mission = run.law, run.scenario
    speeds = (mission.cruise, mission.cap)
    kind: dict[str, Any] = {"sensing": sensing, "barrier": law.barrier, "movers": law.movers, "runs": (run,)}
    subject = Mission(run.vehicle, run.gains, *speeds, law.ref, law.guidance, (mission,), law.dt, **kind)
    return assess(subject, parts=["loop", "no contact", "runs"])


def _how_to_start(out: Path, context: click.Context) -> tuple[str, str]:
    words = [context.params["scenario"]]
    options = {parameter.name: parameter.opts[0] for parameter in context.command.params}
    for name in _RUN_OPTIONS:
        setting = context.params[name]
        typed = context.get_parameter_source(name) != ParameterSource.DEFAULT
        if setting != "truth" if name == "sensing" else typed:  # surctl simulate has another default for --sensing
            values = setting if isinstance(setting, tuple) else (setting,)
            words += [word for value in values for word in (options[name], str(value))]
    port = 5555
    run = f"make -C {shlex.quote(str(out))} controller && {shlex.quote(str(out / 'controller'))} {port}"
    return run, f"surctl simulate {shlex.join(words)} --controller tcp://127.0.0.1:{port}"


_APPLY = ("scenario", "vehicle", "target", "out", "as_json")


def export_scene(scenario: str, vehicle: str | None, *, out: Path, as_json: bool) -> None:
    """Write the model and the force of the water to a folder, and end the command.

    Raises:
        InputError: an option concerns the controller, which is not part of the model, or the hull starts inside an
            obstacle.
    """
    from surctl.marine.engine import EngineOptions
    from surctl.marine.engine.mjcf import write_mjcf
    from surctl.marine.simulation import load_scenario
    from surctl.marine.vehicle import load_vehicle

    context = click.get_current_context()
    for parameter in context.command.params:
        typed = context.get_parameter_source(str(parameter.name)) != ParameterSource.DEFAULT
        if typed and parameter.expose_value and parameter.name not in _APPLY:
            remedy = "drop it: the model holds the scenario and the vehicle, without a controller"
            raise InputError("does not apply to --target mjcf", key=parameter.opts[0], remedy=remedy)
    mission = load_scenario(scenario)
    choice = choose_vehicle(vehicle, (mission.name, mission.vehicle))
    robot = load_vehicle(choice.word)
    files = write_mjcf(mission, robot, out)
    hashes = {file.name: sha256(file.read_bytes()).hexdigest() for file in files}
    dof = EngineOptions().of(robot).dof
    lines = [choice.line(robot.name), f"{mission.name}, {dof} degrees of freedom"]
    lines += [f"{hashes[file.name][:12]}  {file}" for file in files]
    result = {"files": [str(file) for file in files], "sha256": hashes, "dof": dof, "vehicle_from": choice.origin}
    finish(result, lines, as_json=as_json, passed=True, brief=[lines[1]], files=[f"model {out}"])

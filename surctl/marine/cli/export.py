"""`surctl export` of the robot: law and mission as C or FMU, --constant-gains, the scene as a MuJoCo model."""

from __future__ import annotations

import shlex
import shutil
from dataclasses import dataclass, fields, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import click

from surctl.cli.export import TARGETS, ExportOptions
from surctl.cli.options import FILE, Count, collected, option, options, typed
from surctl.cli.output import finish, progress
from surctl.errors import InputError
from surctl.marine.cli import lib
from surctl.marine.cli.robot_options import (
    MISSION,
    ExportedRobot,
    choose_gains,
    choose_law,
    choose_sensing,
    choose_vehicle,
)
from surctl.marine.cli.sensor_options import SensorOptions, sensor_data, split_faults


@dataclass(frozen=True, eq=False, repr=False)
class _Mission:
    """The mission of an exported law, and what its bundle holds besides."""

    scenario: str = option(
        "--scenario", "Mission and sensors: name or file (default pool-static).", MISSION, metavar="FILE"
    )
    constant_gains: bool = option(
        "--constant-gains", "Write gains and mission as constants; needs --sensing truth.", False
    )
    certificates: tuple[Path, ...] = option(
        "--certificate", "Certificate file to add to the bundle; repeatable.", (), type=FILE, metavar="F"
    )
    seed: int = option("--seed", "Seed of noise, drift and waves (default 0).", 0, type=Count(0))


@click.command
@click.argument("words", nargs=-1, metavar="")
@options(robot=ExportedRobot, sensors=SensorOptions, ship=_Mission, only={"sensors": ("faults", "chances")})
@collected(options=ExportOptions)
def export(
    words: tuple[str, ...],
    robot: ExportedRobot,
    sensors: SensorOptions,
    ship: _Mission,
    options: ExportOptions,
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

    options = options.for_processor()
    if options.target == "mjcf":
        export_scene(ship.scenario, robot.vehicle, out=options.out, as_json=as_json)
    real, tools = options.checked((*TARGETS, "mjcf"))
    refused = "give the exported step the input `working`, or use surctl simulate"
    sensors = replace(sensors, faults=split_faults(sensors.faults, refused=refused)[0])
    mission = lib.load_scenario(ship.scenario)
    constant_gains, certificates, seed = ship.constant_gains, ship.certificates, ship.seed
    choice = choose_vehicle(robot.vehicle, (mission.name, mission.vehicle))
    vehicle = lib.load_vehicle(choice.word)
    law, why = choose_law(robot.law, [vehicle])
    sensing = choose_sensing(robot.sensing, law)
    click.get_current_context().params["sensing"] = sensing
    sensors.check(sensing=sensing)
    mission = sensors.over(mission)
    chosen = choose_gains(robot.gains, vehicle, cruise=mission.cruise, own=lib.law_source(law).gains)
    tuned = chosen.gains
    built = replace(robot, sensing=sensing).case(law, mission, vehicle, tuned).build(robot.fallback)
    numbers = lib.law_numbers(mission, tuned, vehicle)
    if mission.path.fed and constant_gains:
        many = f"has more than {lib.MAX_WAYPOINTS} points, or speeds or depths for its legs"
        problem, remedy = f"{many}, which are inputs of the program", "remove --constant-gains"
        raise InputError(problem, file=mission.source, key="path_m", remedy=remedy)
    table = mission.path.table(visits=mission.corners == "visit") if mission.path.fed else None
    shipped = lib.closed_form(built, real=real, constants=numbers if constant_gains else None)
    within = lib.operating_envelope(built, mission, vehicle, shipped.gains, tuned=None if constant_gains else numbers)
    if options.prove and not constant_gains:
        within = replace(within, gains=lib.gain_box(built, numbers, {**tuned.ranges, **lib.fed_ranges(mission)}))
    fixed = {} if constant_gains else built.gains.unpack(numbers)
    assumed = mission.sensors.on(vehicle["radius"]) if sensing == "sonar" else None
    origin = lib.origin_of(built, vehicle, lib.load_certificates(certificates), equipment=assumed)
    lib.check_folder(options.out)  # an invalid name or folder is reported before the simulation
    bundle = lib.build_bundle(
        shipped, fixed, name=options.name, real=real, envelope=within, origin=origin, mission=table
    )
    limit = lib.command_range(vehicle) if vehicle.actuators is None else vehicle.thrust_bound
    bundle, proof = options.proved(shipped, bundle, limit)
    progress(f"simulating {mission.name}")
    run = lib.simulate(mission, vehicle, gains=tuned, law=built, sensing=sensing, seed=seed)
    record, metrics, replay = run.record, run.metrics, lib.replay_of(run)
    failed = replay.about["failure"]
    p = np.zeros((len(record.law_state), 0)) if constant_gains else record.step_parameters
    records = lib.as_records(shipped, lib.Records(record.law_state, record.law_input, p))
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


def _assessed(run: lib.Run, sensing: str) -> lib.Assessment:
    """Return what is assessed of the exported law, without the region of attraction."""
    law, mission = run.law, run.scenario
    speeds = (mission.cruise, mission.cap)
    kind: dict[str, Any] = {"sensing": sensing, "barrier": law.barrier, "movers": law.movers, "runs": (run,)}
    subject = lib.Mission(run.vehicle, run.gains, *speeds, law.ref, law.guidance, (mission,), law.dt, **kind)
    return lib.assess(subject, parts=["loop", "no contact", "runs"])


def _how_to_start(out: Path, context: click.Context) -> tuple[str, str]:
    words = [context.params["scenario"]]
    options = {parameter.name: parameter.opts[0] for parameter in context.command.params}
    named = {parameter.name for parameter in typed()}
    for name in (*(one.name for one in fields(ExportedRobot)), "faults", "chances", "seed"):
        setting = context.params[name]
        if setting != "truth" if name == "sensing" else name in named:  # simulate has another default for --sensing
            values = setting if isinstance(setting, tuple) else (setting,)
            words += [word for value in values for word in (options[name], str(value))]
    port = 5555
    run = f"make -C {shlex.quote(str(out))} controller && {shlex.quote(str(out / 'controller'))} {port}"
    return run, f"surctl simulate {shlex.join(words)} --controller tcp://127.0.0.1:{port}"


def export_scene(scenario: str, vehicle: str | None, *, out: Path, as_json: bool) -> None:
    """Write the model and the force of the water to a folder, and end the command.

    Raises:
        InputError: an option concerns the controller, which is not part of the model, or the hull starts inside an
            obstacle.
    """
    for parameter in typed("scenario", "vehicle", "target", "out"):
        remedy = "drop it: the model holds the scenario and the vehicle, without a controller"
        raise InputError("does not apply to --target mjcf", key=parameter.opts[0], remedy=remedy)
    mission = lib.load_scenario(scenario)
    choice = choose_vehicle(vehicle, (mission.name, mission.vehicle))
    robot = lib.load_vehicle(choice.word)
    files = lib.write_mjcf(mission, robot, out)
    hashes = {file.name: sha256(file.read_bytes()).hexdigest() for file in files}
    dof = lib.EngineOptions().of(robot).dof
    lines = [choice.line(robot.name), f"{mission.name}, {dof} degrees of freedom"]
    lines += [f"{hashes[file.name][:12]}  {file}" for file in files]
    result = {"files": [str(file) for file in files], "sha256": hashes, "dof": dof, "vehicle_from": choice.origin}
    finish(result, lines, as_json=as_json, passed=True, brief=[lines[1]], files=[f"model {out}"])

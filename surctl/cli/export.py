"""`surctl export`: write the controller of the robot or of a system as C code or FMU, and compare it with Python."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Collection, Sequence
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
from click.core import ParameterSource

from surctl.cli.output import as_json, finish, finite, progress
from surctl.cli.robot_options import GAINS_HELP, MISSION, choose_gains, choose_law, law_option, priority_options
from surctl.cli.sensor_options import SensorOptions, sensor_data, sensor_options, split_faults
from surctl.cli.subject import assigned, cost_data, cost_lines, end_text, is_system, load_system, seconds_option

if TYPE_CHECKING:
    from surctl.marine.simulation import Run

__all__ = ["SystemExport", "export", "export_scene", "export_system"]


@click.command
@click.argument("system", nargs=-1, metavar="[FILE.py:FUNCTION [NAME=VALUE]...]")
@seconds_option
@click.option("--gains", metavar="FILE", help=GAINS_HELP)
@click.option("--vehicle", metavar="FILE", help="Vehicle: name or file (default: the scenario's).")
@click.option(
    "--scenario", default=MISSION, metavar="FILE", help="Mission, sensors: name or file (default pool-static)."
)
@law_option
@click.option(
    "--avoidance",
    default="corrected",
    metavar="NAME",
    help="Eq. (20): corrected (default), consistent or printed.",
)
@click.option("--guidance", default="los", metavar="NAME", help="Path guidance: los (default), ilos or alos.")
@priority_options
@click.option("--sensing", metavar="NAME", help="Obstacles: sonar (default if the law uses it), or truth (inputs).")
@sensor_options
@click.option("--name", metavar="TEXT", help="Prefix of files and C symbols (default: the law's name).")
@click.option("--target", default="c99", metavar="NAME", help="Output: c99 (default), fmu (FMI 2), fmu3 or mjcf.")
@click.option("--real", default="float64", metavar="NAME", help="Number type: float64 (default) or float32.")
@click.option(
    "--constant-gains",
    is_flag=True,
    help="Compile gains and mission as constants; needs --sensing truth.",
)
@click.option(
    "--certificate",
    "certificates",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Certificate to add to the bundle; may be repeated.",
)
@click.option("--check", is_flag=True, help="Compare the C of several compilers and processors with Python.")
@click.option(
    "--prove",
    is_flag=True,
    help="Prove that no run-time error occurs (Frama-C's Eva).",
)
@click.option("--targets", metavar="A,B", help="Compilers and processors that --check uses (default: all available).")
@click.option(
    "--steps", type=click.IntRange(min=1), metavar="N", help="Single steps that --check tries (default 100000)."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("surctl-out", "export"),
    metavar="DIR",
    help="Folder of the bundle (default surctl-out/export).",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, metavar="N", help="Seed of the replayed run (default 0)."
)
@as_json
def export(
    system: tuple[str, ...],
    seconds: float | None,
    gains: str,
    vehicle: str | None,
    scenario: str,
    law: str | None,
    avoidance: str,
    guidance: str,
    priority_mode: str,
    fallback: str,
    sensing: str | None,
    faults: tuple[str, ...],
    chances: tuple[str, ...],
    beam: float | None,
    own_state: str | None,
    name: str | None,
    target: str,
    real: str,
    constant_gains: bool,
    certificates: tuple[Path, ...],
    check: bool,
    prove: bool,
    targets: str | None,
    steps: int | None,
    out: Path,
    seed: int,
    as_json: bool,
) -> None:
    """Write the controller as C99, compile it, and compare it with Python at every step of a simulated run.

    Sensor options override the scenario's tables. --check also runs code built by gcc and clang at -O0 to -O3 and on
    QEMU's Cortex-M3, -M4F and -M7: every output byte must equal Python's. --prove takes minutes with sonar sensing; it
    covers gains within the ranges of the gain file. FILE.py:FUNCTION names a system of your own, whose controller is
    exported. Exit status: 1 if C and Python differ, or if the replayed run collides or does not arrive.

    Examples: surctl export --gains surctl-out/gains.toml --out firmware; surctl export --law closed_form --sensing
    truth --constant-gains --check; surctl export my_system.py:build --seconds 5
    """
    if is_system(system, "seconds", "as_json", *SystemExport._fields):
        own = SystemExport(name, target, real, check, targets, steps, prove, out)
        from surctl.marine.control.registry import LAWS

        reserved = {*LAWS, *(source.name for source in LAWS.values())}
        export_system(system, own, seconds=seconds, as_json=as_json, reserved=reserved)
    if system:
        raise click.UsageError(f"Got unexpected extra argument ({system[0]})")
    import tempfile
    from dataclasses import replace

    import numpy as np

    from surctl.cli.robot_options import choose_vehicle
    from surctl.cli.runs import failure
    from surctl.errors import InputError, nearest
    from surctl.export import (
        REALS,
        STEPS,
        Records,
        as_records,
        build_controller,
        check_builds,
        check_folder,
        chosen_targets,
        compare_runs,
        evidence_of,
        gain_box,
        prove_bundle,
        with_evidence,
        with_proof,
        write_bundle,
        write_fmu,
    )
    from surctl.ir import find_compiler
    from surctl.marine.control import build_law, law_source
    from surctl.marine.export import build_bundle, closed_form, load_certificates, operating_envelope, origin_of
    from surctl.marine.guidance import MAX_WAYPOINTS
    from surctl.marine.simulation import SENSING, law_numbers, load_scenario, simulate
    from surctl.marine.simulation.numbers import fed_ranges
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.vehicle.linearise import command_range

    checked = (
        ("--target", target, ("c99", "fmu", "fmu3", "mjcf")),
        ("--real", real, REALS),
        ("--sensing", sensing or SENSING[0], SENSING),
    )
    for key, value, known in checked:
        if value not in known:
            raise InputError("is not available", key=key, value=value, remedy=nearest(value, known))
    if target == "mjcf":
        export_scene(scenario, vehicle, out=out, as_json=as_json)
    if not check and (targets or steps):
        raise InputError("needs --check", key="--targets" if targets else "--steps", remedy="add --check")
    precision = REALS[REALS.index(real)]
    find_compiler()
    tried, untried = chosen_targets([name.strip() for name in targets.split(",")] if targets else ())
    faults, _ = split_faults(faults, refused="give the exported step the input `working`, or use surctl simulate")
    sensors = SensorOptions(faults, chances, beam, own_state)
    mission = load_scenario(scenario)
    choice = choose_vehicle(vehicle, (mission.name, mission.vehicle))
    robot = load_vehicle(choice.word)
    law, why = choose_law(law, [robot])
    sensing = sensing or ("sonar" if "sonar" in law_source(law).sensing else "truth")
    click.get_current_context().params["sensing"] = sensing
    sensors.check(law=law, sensing=sensing)
    mission = sensors.over(mission)
    equipment = mission.sensors.on(robot["radius"])
    built = build_law(
        law,
        avoidance=avoidance,
        mode=priority_mode,
        sonar=sensing == "sonar",
        equipment=equipment,
        guidance=guidance,
        fallback=fallback,
        depths=mission.depths is not None,
        actuators=robot.actuators,
    )
    chosen = choose_gains(gains, robot, cruise=mission.cruise, own=law_source(law).gains)
    tuned = chosen.gains
    numbers = law_numbers(mission, tuned, robot)
    if mission.path.fed and constant_gains:
        raise InputError(
            f"has more than {MAX_WAYPOINTS} points, or speeds or depths for its legs, which are inputs of the program",
            file=mission.source,
            key="path_m",
            remedy="remove --constant-gains",
        )
    table = mission.path.table(visits=mission.corners == "visit") if mission.path.fed else None
    shipped = closed_form(built, real=precision, constants=numbers if constant_gains else None)
    within = operating_envelope(built, mission, robot, shipped.gains, tuned=None if constant_gains else numbers)
    if prove and not constant_gains:
        within = replace(within, gains=gain_box(built, numbers, {**tuned.ranges, **fed_ranges(mission)}))
    fixed = {} if constant_gains else built.gains.unpack(numbers)
    assumed = equipment if sensing == "sonar" else None
    origin = origin_of(built, robot, load_certificates(certificates), equipment=assumed)
    check_folder(out)  # an invalid name or folder is reported before the simulation
    bundle = build_bundle(shipped, fixed, name=name, real=precision, envelope=within, origin=origin, mission=table)
    proof = None
    if prove:
        progress("proving")
        limit = command_range(robot) if robot.actuators is None else robot.thrust_bound
        proof = prove_bundle(shipped, bundle, limit)
        bundle = with_proof(bundle, proof)
    progress(f"simulating {mission.name}")
    run = simulate(mission, robot, gains=tuned, law=built, sensing=sensing, seed=seed)
    record, metrics = run.record, run.metrics
    progress("compiling and replaying")
    binaries = {}
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
        controller = build_controller(shipped, bundle, Path(scratch, bundle.name))
        records = as_records(
            shipped,
            Records(
                record.law_state,
                record.law_input,
                np.zeros((len(record.law_state), 0)) if constant_gains else record.step_parameters,
            ),
        )
        (sil,) = compare_runs(controller, [records])
        report = (
            check_builds(controller, [records], tried, steps=steps or STEPS, untried=untried, progress=progress)
            if check
            else None
        )
        if target in ("fmu", "fmu3"):
            progress("compiling the functional mock-up unit")
            unit = write_fmu(shipped, bundle, shipped.gains.pack(fixed), scratch, fmi=3 if target == "fmu3" else 2)
            binaries[unit.path.name] = unit.path.read_bytes()
    replayed = {
        "scenario": mission.name,
        "vehicle": robot.name,
        "sensing": sensing,
        "seed": seed,
        "path_length_m": mission.path.length,
        "arrival_m": mission.arrival_radius,
        "obstacles": [obstacle.model_dump(mode="json", exclude_defaults=True) for obstacle in mission.obstacles],
        "stopped_because": metrics.stopped_because,
        "time_s": metrics.time_s,
        "failure": failure(run),
    }
    evidence = evidence_of(run=replayed, sil=sil, check=report, proof=proof, statuses=record.status, period=built.dt)
    evidence["assessment"] = _assessed(run, sensing)
    # a bundle appears when it is complete and checked, at once
    files = write_bundle(with_evidence(bundle, evidence, binaries=binaries), out)
    result: dict[str, Any] = {
        "failure": failure(run),
        "name": bundle.name,
        "id": bundle.id,
        "vehicle_from": choice.origin,
        "derived_gains": chosen.data,
        "files": [str(f.path) for f in files],
        "sha256": {f.path.relative_to(out).as_posix(): f.sha256 for f in files},
        "run": run.to_dict() | ({"sensors": sensor_data(mission)} if sensing == "sonar" else {}),
        "real": real,
        "sil": sil.to_dict(),
    }
    if proof is not None:
        result["proof"] = proof.to_dict()
    started = _how_to_start(out, click.get_current_context())
    if report is not None:
        result["check"] = report.to_dict()
    failed = result["failure"]
    replay_text = f"replayed: {mission.name} by {robot.name}, {sensing}, seed {seed}: {metrics.stopped_because} at "
    lines = [
        *why,
        *(f"{f.sha256[:12]}  {f.path}" for f in files),
        "",
        *(choice.line(robot.name), *chosen.lines),
        f"{replay_text}{metrics.time_s:.2f} s",
        sil.summary(),
    ]
    lines += [] if failed is None else [f"warning: the replayed run failed: {failed}; see: {_again(started[1])}"]
    lines += [] if proof is None else ["", proof.summary()]
    lines += [] if report is None else ["", report.summary()]
    belong = [shlex.join(["surctl", "check", str(file), "--bundle", str(out)]) for file in certificates[:1]]
    finish(
        result,
        lines,
        as_json=as_json,
        passed=failed is None
        and sil.conclusive
        and (report is None or report.passed)
        and (proof is None or proof.proved),
        then=[*belong, *(() if mission.path.fed and real != "float64" else started)],
    )


_RUN_OPTIONS = (
    *("vehicle", "gains", "law", "avoidance", "guidance", "priority_mode", "fallback", "sensing"),
    *("faults", "chances", "beam", "own_state", "seed"),
)


def _again(command: str) -> str:
    """Return the command that simulates the replayed run in Python, without the exported controller."""
    return command.partition(" --controller ")[0]


def _assessed(run: Run, sensing: str) -> dict[str, Any]:
    """Return what is assessed of the exported law, without the region of attraction, as data for the manifest."""
    from surctl.assessment import assess
    from surctl.marine.assessment import Mission

    law, mission = run.law, run.scenario
    speeds = (mission.cruise, mission.cap)
    kind: dict[str, Any] = {"sensing": sensing, "barrier": law.barrier, "movers": law.movers, "runs": (run,)}
    subject = Mission(run.vehicle, run.gains, *speeds, law.ref, law.guidance, (mission,), law.dt, **kind)
    data: dict[str, Any] = finite(assess(subject, parts=["loop", "no contact", "runs"]).to_dict())
    return data


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


_TARGETS = ("c99", "fmu", "fmu3")


class SystemExport(NamedTuple):
    """Options of the export of a system, as typed: prefix, output, number type, checks, proof, folder."""

    name: str | None
    target: str
    real: str
    check: bool
    targets: str | None
    steps: int | None
    prove: bool
    out: Path


def export_system(
    words: Sequence[str],
    options: SystemExport,
    *,
    seconds: float | None,
    as_json: bool,
    reserved: Collection[str] = (),
) -> None:
    """Write the controller as C, compare C and Python over a run; exit with status 1 if a number differs.

    Raises:
        InputError: an option is not available, `--check` is missing, or the name is one of `reserved`.
    """
    from surctl.assessment.assessment import assess
    from surctl.assessment.closed_loop import ClosedLoop
    from surctl.errors import InputError, nearest
    from surctl.export.bundle import build_bundle, check_folder, write_bundle
    from surctl.export.check import STEPS, check_builds
    from surctl.export.evidence import evidence_of, with_evidence
    from surctl.export.fmu import write_fmu
    from surctl.export.precision import REALS
    from surctl.export.process import build_controller
    from surctl.export.prove import prove_bundle, with_proof
    from surctl.export.records import as_records
    from surctl.export.sil import compare_runs
    from surctl.export.supplement import PlantLists
    from surctl.export.targets import chosen_targets
    from surctl.ir import find_compiler
    from surctl.system import LOST, run_system
    from surctl.system.values import run_numbers

    for key, value, known in (("--target", options.target, _TARGETS), ("--real", options.real, REALS)):
        if value not in known:
            problem = "is not available for a system of your own"
            raise InputError(problem, key=key, value=value, remedy=nearest(value, known))
    if not options.check and (options.targets or options.steps):
        raise InputError("needs --check", key="--targets" if options.targets else "--steps", remedy="add --check")
    named = [name.strip() for name in options.targets.split(",")] if options.targets else ()
    tried, untried = chosen_targets(named)
    real = REALS[REALS.index(options.real)]
    own = load_system(words)
    duration, values = own.seconds(seconds), assigned(own.settings)
    name = own.exported_name(options.name, reserved=reserved)
    find_compiler()
    check_folder(options.out)
    controller = own.system.controller
    record = run_system(own.system, duration, values)
    gains = controller.gains.unpack(record.controller[2])
    plant = PlantLists(own.system.plant, run_numbers(own.system, values).plant[0])
    bundle = build_bundle(controller, gains, name=name, real=real, supplement=plant)
    proof = None
    if options.prove:
        progress("proving")
        proof = prove_bundle(controller, bundle)
        bundle = with_proof(bundle, proof)
    progress("compiling and replaying")
    binaries, report = {}, None
    with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
        compiled = build_controller(controller, bundle, Path(scratch, bundle.name))
        (sil,) = compare_runs(compiled, [record])
        if options.check:
            steps = options.steps or STEPS
            report = check_builds(
                compiled, [as_records(controller, record)], tried, steps=steps, untried=untried, progress=progress
            )
        if options.target != "c99":
            progress("compiling the functional mock-up unit")
            fmi = 3 if options.target == "fmu3" else 2
            unit = write_fmu(controller, bundle, controller.gains.pack(gains), scratch, fmi=fmi)
            binaries[unit.path.name] = unit.path.read_bytes()
    replayed = {
        "system": own.label,
        "text": end_text(own, record),
        "failure": record.lost if record.stopped == LOST else None,
    }
    assessment = assess(ClosedLoop(own.system, values, record=record))
    evidence = evidence_of(run=replayed, sil=sil, check=report, proof=proof)
    evidence["assessment"] = finite(assessment.to_dict())
    files = write_bundle(with_evidence(bundle, evidence, binaries=binaries), options.out)
    largest = max(part.absolute for part in (sil.tau, sil.state, sil.telemetry))
    passed = sil.exact and record.stopped != LOST
    passed = passed and (report is None or report.passed) and (proof is None or proof.proved)
    lines = [*(f"{file.sha256[:12]}  {file.path}" for file in files), "", f"replayed: {end_text(own, record)}"]
    lines += [*cost_lines(own.system, record.figures), *(f"{line.mark} {line.text}" for line in assessment.lines)]
    lines.append(sil.summary())
    lines += [] if proof is None else ["", proof.summary()]
    lines += [] if report is None else ["", report.summary()]
    data = {
        **own.names,
        "name": bundle.name,
        "id": bundle.id,
        "real": real,
        "commands": {port.name: port.unit for port in own.system.commands},
        "files": [str(file.path) for file in files],
        "sha256": {file.path.relative_to(options.out).as_posix(): file.sha256 for file in files},
        "stopped": record.stopped,
        "duration_s": record.duration,
        "costs": cost_data(own.system, record.figures),
        "assessment": assessment.to_dict(),
        "largest_difference": largest,
        "sil": sil.to_dict(),
    }
    data |= {} if proof is None else {"proof": proof.to_dict()}
    data |= {} if report is None else {"check": report.to_dict()}
    finish(data, lines, as_json=as_json, passed=passed, then=[f"make -C {shlex.quote(str(options.out))} check"])


_APPLY = ("scenario", "vehicle", "target", "out", "as_json")


def export_scene(scenario: str, vehicle: str | None, *, out: Path, as_json: bool) -> None:
    """Write the model and the force of the water to a folder, and end the command.

    Raises:
        InputError: an option concerns the controller, which is not part of the model, or the hull starts inside an
            obstacle.
    """
    from surctl.cli.robot_options import choose_vehicle
    from surctl.errors import InputError
    from surctl.marine.engine import EngineOptions, write_mjcf
    from surctl.marine.simulation import load_scenario
    from surctl.marine.vehicle import load_vehicle

    context = click.get_current_context()
    for parameter in context.command.params:
        typed = context.get_parameter_source(str(parameter.name)) != ParameterSource.DEFAULT
        if typed and parameter.name not in _APPLY:
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
    finish(result, lines, as_json=as_json, passed=True)

"""`surctl export`: controller of robot or system as C, FMU or MuJoCo model; its replayed run, --check, --prove."""

from __future__ import annotations

import shlex
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import click
from click.core import ParameterSource

from surctl.cli.output import FILE, FOLDER, Count, as_json, collected, finish, finite, progress
from surctl.cli.robot_options import (
    GAINS_HELP,
    MISSION,
    RobotOptions,
    barrier_options,
    check_barrier,
    choose_gains,
    choose_law,
    choose_sensing,
    choose_vehicle,
    law_option,
    priority_options,
)
from surctl.cli.sensor_options import SensorOptions, sensor_data, sensor_options, split_faults
from surctl.cli.subject import (
    OwnSystem,
    assigned,
    cost_data,
    cost_lines,
    end_text,
    is_system,
    load_system,
    seconds_option,
)
from surctl.errors import InputError, nearest

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from surctl.assessment import Assessment
    from surctl.export import CheckReport, ProofReport, Records, SilReport
    from surctl.export.bundle import Bundle
    from surctl.export.contract import Exportable
    from surctl.export.emulated import Target
    from surctl.ir import Real
    from surctl.marine.simulation import Run
    from surctl.system import Record

    Tools: TypeAlias = tuple[Sequence[Target], Mapping[str, tuple[str, ...]]]

_TARGETS = ("c99", "fmu", "fmu3")


@dataclass(frozen=True)
class ExportOptions:
    """The options about the bundle: prefix, output, number type, checks, proof, folder."""

    name: str | None
    target: str
    real: str
    check: bool
    targets: str | None
    steps: int | None
    prove: bool
    out: Path

    def for_processor(self) -> ExportOptions:
        """Return the options with C as output, and `--check` on the compiler or processor that `--target` names."""
        from surctl.export.emulated import TARGETS

        if self.target not in TARGETS:
            return self
        return replace(self, target="c99", check=True, targets=",".join(filter(None, (self.targets, self.target))))

    def tools(self) -> Tools:
        """Return the compilers and processors of `--check`, and those that are not available.

        Raises:
            InputError: `--check` is missing, or a target is unknown.
            ToolMissing: there is no C compiler.
        """
        from surctl.export.emulated import chosen_targets
        from surctl.ir.cache import find_compiler

        if not self.check and (self.targets or self.steps):
            raise InputError("needs --check", key="--targets" if self.targets else "--steps", remedy="add --check")
        tools = chosen_targets([name.strip() for name in self.targets.split(",")] if self.targets else ())
        find_compiler()
        return tools

    def proved(self, controller: Exportable, bundle: Bundle, limit: Any = None) -> tuple[Bundle, ProofReport | None]:
        """Return the bundle with its proof, and the proof, if it is requested; else the bundle and None."""
        if not self.prove:
            return bundle, None
        from surctl.export.prove import prove_bundle, with_proof

        progress("proving")
        proof = prove_bundle(controller, bundle, limit)
        return with_proof(bundle, proof), proof

    def compared(self, controller: Exportable, bundle: Bundle, records: Records, gains: Any, tools: Tools) -> Compared:
        """Return the comparison of C and Python over a run, the report of `--check`, and the binary files."""
        from surctl.export.check import STEPS, check_builds
        from surctl.export.fmu import write_fmu
        from surctl.export.process import build_controller
        from surctl.export.sil import compare_runs

        progress("compiling and replaying")
        binaries, report = dict[str, bytes](), None
        with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
            compiled = build_controller(controller, bundle, Path(scratch, bundle.name))
            (sil,) = compare_runs(compiled, [records])
            if self.check:
                steps, (tried, untried) = self.steps or STEPS, tools
                report = check_builds(compiled, [records], tried, steps=steps, untried=untried, progress=progress)
            if self.target != "c99":
                progress("compiling the functional mock-up unit")
                fmi = 3 if self.target == "fmu3" else 2
                unit = write_fmu(controller, bundle, controller.gains.pack(gains), scratch, fmi=fmi)
                binaries[unit.path.name] = unit.path.read_bytes()
        return Compared(sil, report, binaries)


class Compared(NamedTuple):
    """Comparison of C and Python over a run, report of `--check` or None, binary files by name."""

    sil: SilReport
    report: CheckReport | None
    binaries: dict[str, bytes]

    def summaries(self, proof: ProofReport | None) -> list[str]:
        """Return the lines about the proof and the report."""
        return [line for one in (proof, self.report) if one is not None for line in ("", one.summary())]

    def passed(self, proof: ProofReport | None) -> bool:
        """Whether proof and report are as expected."""
        return (self.report is None or self.report.passed) and (proof is None or proof.proved)

    def data(self, proof: ProofReport | None) -> dict[str, Any]:
        """Return comparison, proof and report for JSON."""
        parts = {"sil": self.sil, "proof": proof, "check": self.report}
        return {name: part.to_dict() for name, part in parts.items() if part is not None}


@click.command
@click.argument("system", nargs=-1, metavar="[FILE.py:FUNCTION [NAME=VALUE]...]")
@seconds_option
@click.option("--gains", metavar="FILE", help=GAINS_HELP)
@click.option("--vehicle", metavar="FILE", help="Vehicle: name or file (default: the scenario's).")
@click.option(
    "--scenario", default=MISSION, metavar="FILE", help="Scenario with mission, sensors (default pool-static)."
)
@law_option
@click.option(
    "--avoidance", default="corrected", metavar="NAME", help="Avoidance law: corrected (default), consistent, printed."
)
@click.option("--guidance", default="los", metavar="NAME", help="Path guidance: los (default), ilos or alos.")
@priority_options
@barrier_options
@click.option("--sensing", metavar="NAME", help="Obstacle positions: sonar (default, if used) or truth.")
@sensor_options
@click.option("--name", metavar="TEXT", help="Prefix of C names (default: the law's name).")
@click.option(
    "--target",
    default="c99",
    metavar="NAME",
    help="c99 (default), fmu, fmu3, mjcf or one of --targets.",
)
@click.option("--real", default="float64", metavar="NAME", help="Number type: float64 (default) or float32.")
@click.option("--constant-gains", is_flag=True, help="Compile gains and mission in; needs --sensing truth.")
@click.option(
    "--certificate", "certificates", multiple=True, type=FILE, help="Certificate to add to the bundle; may be repeated."
)
@click.option("--check", is_flag=True, help="Compare C code and Python for all --targets.")
@click.option("--prove", is_flag=True, help="Prove that no run-time error occurs (Frama-C's Eva).")
@click.option("--targets", metavar="A,B", help="Compilers, processors of --check (default: all).")
@click.option("--steps", type=Count(1), help="Single steps that --check compares (default 100000).")
@click.option(
    "--out", type=FOLDER, default=Path("surctl-out", "export"), help="Folder of the bundle (default surctl-out/export)."
)
@click.option("--seed", type=Count(0), default=0, help="Seed of the replayed run (default 0).")
@as_json
@collected(robot=RobotOptions, sensors=SensorOptions, options=ExportOptions)
def export(
    system: tuple[str, ...],
    seconds: float | None,
    scenario: str,
    robot: RobotOptions,
    sensors: SensorOptions,
    options: ExportOptions,
    constant_gains: bool,
    certificates: tuple[Path, ...],
    seed: int,
    as_json: bool,
) -> None:
    """Write the controller as C99, compile it, and compare it with Python at every step of a simulated run.

    Sensor options override the scenario's tables. --check also runs code built by gcc and clang at -O0 to -O3 and on
    QEMU's Cortex-M3, -M4F and -M7: every output byte must equal that of Python. --prove takes minutes with sonar
    sensing; the proof covers all gains within the ranges of the gain file. FILE.py:FUNCTION exports the controller of a
    system of your own. Exit status: 1 if C and Python differ, or if a line of the assessment fails; the code is written
    all the same.

    Examples: surctl export --gains surctl-out/gains.toml --out firmware; surctl export --law closed_form --sensing
    truth --constant-gains --check; surctl export my_system.py:build --seconds 5
    """
    options = options.for_processor()
    if is_system(system, "seconds", "gains", "as_json", *(one.name for one in fields(ExportOptions))):
        export_system(system, options, seconds=seconds, as_json=as_json)
    if system:
        raise click.UsageError(f"Got unexpected extra argument ({system[0]})")
    import numpy as np

    from surctl.cli.runs import failure
    from surctl.export import REALS, Records, write_bundle
    from surctl.export.bundle import check_folder
    from surctl.export.emulated import TARGETS
    from surctl.export.envelope import as_records
    from surctl.export.evidence import evidence_of, with_evidence
    from surctl.export.prove import gain_box
    from surctl.marine.control import law_source
    from surctl.marine.export import build_bundle, closed_form, operating_envelope
    from surctl.marine.export.origin import load_certificates, origin_of
    from surctl.marine.guidance import MAX_WAYPOINTS
    from surctl.marine.simulation import law_numbers, load_scenario, simulate
    from surctl.marine.simulation.numbers import fed_ranges
    from surctl.marine.vehicle import load_vehicle
    from surctl.marine.vehicle.linearise import command_range

    outputs = (*_TARGETS, "mjcf", *TARGETS)
    for key, value, known in (("--target", options.target, outputs), ("--real", options.real, REALS)):
        if value not in known:
            raise InputError("is not available", key=key, value=value, remedy=nearest(value, known))
    if options.target == "mjcf":
        export_scene(scenario, robot.vehicle, out=options.out, as_json=as_json)
    tools = options.tools()
    refused = "give the exported step the input `working`, or use surctl simulate"
    sensors = replace(sensors, faults=split_faults(sensors.faults, refused=refused)[0])
    mission = load_scenario(scenario)
    choice = choose_vehicle(robot.vehicle, (mission.name, mission.vehicle))
    vehicle = load_vehicle(choice.word)
    check_barrier(robot.barrier, robot.movers)
    law, why = choose_law(robot.law, [vehicle])
    sensing = choose_sensing(robot.sensing, law)
    click.get_current_context().params["sensing"] = sensing
    sensors.check(law=law, sensing=sensing)
    mission = sensors.over(mission)
    built = replace(robot, sensing=sensing).build(law, mission, vehicle)
    chosen = choose_gains(robot.gains, vehicle, cruise=mission.cruise, own=law_source(law).gains)
    tuned = chosen.gains
    numbers = law_numbers(mission, tuned, vehicle)
    if mission.path.fed and constant_gains:
        raise InputError(
            f"has more than {MAX_WAYPOINTS} points, or speeds or depths for its legs, which are inputs of the program",
            file=mission.source,
            key="path_m",
            remedy="remove --constant-gains",
        )
    table = mission.path.table(visits=mission.corners == "visit") if mission.path.fed else None
    real = REALS[REALS.index(options.real)]
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
    record, metrics, failed = run.record, run.metrics, failure(run)
    p = np.zeros((len(record.law_state), 0)) if constant_gains else record.step_parameters
    records = as_records(shipped, Records(record.law_state, record.law_input, p))
    compared = options.compared(shipped, bundle, records, fixed, tools)
    replayed = {
        "scenario": mission.name,
        "vehicle": vehicle.name,
        "sensing": sensing,
        "seed": seed,
        "path_length_m": mission.path.length,
        "arrival_m": mission.arrival_radius,
        "obstacles": [obstacle.model_dump(mode="json", exclude_defaults=True) for obstacle in mission.obstacles],
        "stopped_because": metrics.stopped_because,
        "time_s": metrics.time_s,
        "failure": failed,
    }
    evidence = evidence_of(
        run=replayed, sil=compared.sil, check=compared.report, proof=proof, statuses=record.status, period=built.dt
    )
    assessment = _assessed(run, sensing)
    evidence["assessment"] = finite(assessment.to_dict())
    # a bundle appears when it is complete and checked, at once
    files = write_bundle(with_evidence(bundle, evidence, binaries=compared.binaries), options.out)
    result: dict[str, Any] = {
        "failure": failed,
        "name": bundle.name,
        "id": bundle.id,
        "vehicle_from": choice.origin,
        "derived_gains": chosen.data,
        "files": [str(f.path) for f in files],
        "sha256": {f.path.relative_to(options.out).as_posix(): f.sha256 for f in files},
        "run": run.to_dict() | ({"sensors": sensor_data(mission)} if sensing == "sonar" else {}),
        "real": options.real,
        "assessment": assessment.to_dict(),
        **compared.data(proof),
    }
    started = _how_to_start(options.out, click.get_current_context())
    replay_text = f"replayed: {mission.name} by {vehicle.name}, {sensing}, seed {seed}: {metrics.stopped_because} at "
    lines = [
        *why,
        *(f"{f.sha256[:12]}  {f.path}" for f in files),
        "",
        *(choice.line(vehicle.name), *chosen.lines),
        f"{replay_text}{metrics.time_s:.2f} s",
        compared.sil.summary(),
    ]
    lines += [] if failed is None else [f"the replayed run failed: {failed}; see: {_again(started[1])}"]
    lines += [*compared.summaries(proof), f"exported; {assessment.verdict()}", *assessment.decisive]
    brief = _brief(compared, proof, assessment, replay_text + f"{metrics.time_s:.2f} s")
    belong = [shlex.join(["surctl", "check", str(file), "--bundle", str(options.out)]) for file in certificates[:1]]
    finish(
        result,
        lines,
        as_json=as_json,
        passed=compared.sil.conclusive and compared.passed(proof) and assessment.accepted(),
        then=[
            *belong,
            *(() if (mission.path.fed and options.real != "float64") or not shutil.which("make") else started),
        ],
        brief=brief,
        files=[f"code {options.out} ({len(files)} files)"],
    )


def _brief(compared: Compared, proof: ProofReport | None, assessment: Assessment, replayed: str) -> list[str]:
    """Return the summary of an export: comparison of the code, verdict on what was exported, proof, replayed run."""
    lines = [_sil_line(compared.sil), f"exported; {assessment.verdict()}"]
    lines += [] if proof is None else [proof.summary()]
    if compared.report is not None:
        # what differs first; sizes and instructions of one target fit
        lines += [" ".join(build.line().split()) for build in sorted(compared.report.builds, key=lambda one: one.same)]
    # the worst line, or the figures of a target, need the room
    return [*lines, replayed] if assessment.accepted() and compared.report is None else lines


def _sil_line(sil: SilReport) -> str:
    import numpy as np

    largest = np.max([sil.tau.mixed, sil.state.mixed, sil.telemetry.mixed])
    head, _, _ = sil.summary().partition("\n")
    return f"{head}: C and Python differ by at most {largest:.1e}"


_RUN_OPTIONS = (
    *("vehicle", "gains", "law", "avoidance", "guidance", "priority_mode", "fallback", "sensing"),
    *("faults", "chances", "beam", "own_state", "seed"),
)


def _again(command: str) -> str:
    """Return the command that simulates the replayed run in Python, without the exported controller."""
    return command.partition(" --controller ")[0]


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


def system_bundle(
    own: OwnSystem, values: Mapping[str, ArrayLike], record: Record, *, name: str | None = None, real: Real = "float64"
) -> Bundle:
    """Return the bundle of the system's controller with the gains of a run, and the plant's instruction lists."""
    from surctl.export.bundle import build_bundle
    from surctl.export.supplement import PlantLists
    from surctl.system.values import run_numbers

    controller = own.system.controller
    plant = PlantLists(own.system.plant, run_numbers(own.system, values).plant[0])
    gains = controller.gains.unpack(record.controller[2])
    return build_bundle(controller, gains, name=name, real=real, supplement=plant)


def system_evidence(
    own: OwnSystem, record: Record, assessment: Assessment, sil: SilReport, **others: Any
) -> dict[str, Any]:
    """Return what was checked of a system for the manifest of its bundle; `others` as in `evidence_of`."""
    from surctl.export.evidence import evidence_of
    from surctl.system import LOST

    failure = record.lost if record.stopped == LOST else None
    replayed = {"system": own.label, "text": end_text(own, record), "failure": failure}
    evidence = evidence_of(run=replayed, sil=sil, **others)
    return evidence | {"assessment": finite(assessment.to_dict())}


def export_system(words: Sequence[str], options: ExportOptions, *, seconds: float | None, as_json: bool) -> None:
    """Write the controller as C, compare C and Python over a run; exit with status 1 if a number or a line fails.

    Raises:
        InputError: an option is not available, `--check` is missing, or the name is that of a built-in law.
    """
    from surctl.assessment import ClosedLoop, assess
    from surctl.export.bundle import check_folder, write_bundle
    from surctl.export.emulated import TARGETS
    from surctl.export.envelope import as_records
    from surctl.export.evidence import with_evidence
    from surctl.export.precision import REALS
    from surctl.system import run_system

    for key, value, known in (("--target", options.target, (*_TARGETS, *TARGETS)), ("--real", options.real, REALS)):
        if value not in known:
            problem = "is not available for a system of your own"
            raise InputError(problem, key=key, value=value, remedy=nearest(value, known))
    tools = options.tools()
    real = REALS[REALS.index(options.real)]
    own = load_system(words)
    duration, values = own.seconds(seconds), assigned(own.settings)
    name = own.exported_name(options.name)
    check_folder(options.out)
    controller = own.system.controller
    record = run_system(own.system, duration, values)
    bundle, proof = options.proved(controller, system_bundle(own, values, record, name=name, real=real))
    gains = controller.gains.unpack(record.controller[2])
    compared = options.compared(controller, bundle, as_records(controller, record), gains, tools)
    assessment = assess(ClosedLoop(own.system, values, record=record))
    sil = compared.sil
    evidence = system_evidence(own, record, assessment, sil, check=compared.report, proof=proof)
    files = write_bundle(with_evidence(bundle, evidence, binaries=compared.binaries), options.out)
    lines = [*(f"{file.sha256[:12]}  {file.path}" for file in files), "", f"replayed: {end_text(own, record)}"]
    lines += [*cost_lines(own.system, record.figures), *(f"{line.mark} {line.text}" for line in assessment.lines)]
    lines += [f"exported; {assessment.verdict()}", sil.summary(), *compared.summaries(proof)]
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
        "largest_difference": max(part.absolute for part in (sil.tau, sil.state, sil.telemetry)),
        **compared.data(proof),
    }
    passed = sil.exact and compared.passed(proof) and assessment.accepted()
    # not the same comparison again, after that of --check
    then = [f"make -C {shlex.quote(str(options.out))} check"] if shutil.which("make") and not options.check else []
    brief = _brief(compared, proof, assessment, f"replayed: {end_text(own, record)}")
    brief += [f"{line.mark} {line.text}" for line in assessment.lines] if compared.report is None else []
    where = [f"code {options.out} ({len(files)} files)"]
    finish(data, lines, as_json=as_json, passed=passed, then=then, brief=brief, files=where)


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

"""`surctl export FILE.py:FUNCTION`: the controller of a system of the user's own as C or FMU, checked over a run."""

from __future__ import annotations

import shlex
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import NamedTuple

from surctl.cli.activity import progress
from surctl.cli.output import finish, finite
from surctl.cli.system_option import assigned, load_system
from surctl.cli.system_simulate import cost_data, cost_lines, end_text

__all__ = ["SystemExport", "export_system"]

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
    from surctl.assessment import ClosedLoop, assess
    from surctl.errors import InputError, nearest
    from surctl.export.bundle import build_bundle, check_folder, write_bundle
    from surctl.export.check import STEPS, check_builds
    from surctl.export.emulated import chosen_targets
    from surctl.export.envelope import as_records
    from surctl.export.evidence import evidence_of, with_evidence
    from surctl.export.fmu import write_fmu
    from surctl.export.precision import REALS
    from surctl.export.process import build_controller
    from surctl.export.prove import prove_bundle, with_proof
    from surctl.export.sil import compare_runs
    from surctl.export.supplement import PlantLists
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

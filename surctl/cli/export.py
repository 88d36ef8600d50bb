"""`surctl export`: the bundle, its replayed run, --check, --prove; of a system, its controller as C or FMU."""

from __future__ import annotations

import shlex
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import click

from surctl.cli import lib
from surctl.cli.application import to_application
from surctl.cli.options import FOLDER, Count, option, options
from surctl.cli.output import as_json, finish, note_replaced, progress, result_command
from surctl.cli.subject import OwnSystem, assigned, is_system, load_system, seconds_option
from surctl.errors import InputError, check_known

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    Tools: TypeAlias = tuple[Sequence[lib.Target], Mapping[str, tuple[str, ...]]]

TARGETS = ("c99", "fmu", "fmu3")


@dataclass(frozen=True, eq=False, repr=False)
class ExportOptions:
    """The options about the bundle: prefix, output, number type, checks, proof, folder."""

    name: str | None = option("--name", "Prefix of all names in C (default: name of the law).", metavar="TEXT")
    target: str = option(
        "--target", "c99 (default), fmu, fmu3, mjcf, or a processor (--targets).", "c99", metavar="NAME"
    )
    real: str = option("--real", "Number type of the C code: float64 (default) or float32.", "float64", metavar="NAME")
    check: bool = option("--check", "Compare C code with Python, for each target of --targets.", False)
    prove: bool = option("--prove", "Prove by Frama-C that the C code has no run-time error.", False)
    targets: str | None = option("--targets", "Compilers and processors of --check (default: all).", metavar="A,B")
    steps: int | None = option("--steps", "Steps at random states in --check (default 100000).", type=Count(1))
    out: Path = option(
        "--out", "Folder for the bundle (default surctl-out/export).", Path("surctl-out", "export"), type=FOLDER
    )

    def for_processor(self) -> ExportOptions:
        """Return the options with C as output, and `--check` on the compiler or processor that `--target` names."""
        if self.target not in lib.PROCESSORS:
            return self
        return replace(self, target="c99", check=True, targets=",".join(filter(None, (self.targets, self.target))))

    def checked(self, targets: Sequence[str], *, of: str = "") -> tuple[lib.Real, Tools]:
        """Return the number type, the compilers and processors of `--check`, and those that are not available.

        Raises:
            InputError: `--target` or `--real` is not available (`of` the subject), `--check` is missing, or a target is
                unknown.
            ToolMissing: there is no C compiler.
        """
        for key, value, known in (
            ("--target", self.target, (*targets, *lib.PROCESSORS)),
            ("--real", self.real, lib.REALS),
        ):
            check_known(value, known, f"is not available{of}", key=key)
        if not self.check and (self.targets or self.steps):
            raise InputError("needs --check", key="--targets" if self.targets else "--steps", remedy="add --check")
        tools = lib.chosen_targets([name.strip() for name in self.targets.split(",")] if self.targets else ())
        lib.find_compiler()
        return lib.REALS[lib.REALS.index(self.real)], tools

    def proved(
        self, controller: lib.Exportable, bundle: lib.Bundle, limit: Any = None
    ) -> tuple[lib.Bundle, lib.ProofReport | None]:
        """Return the bundle with its proof, and the proof, if it is requested; else the bundle and None."""
        if not self.prove:
            return bundle, None
        progress("proving")
        proof = lib.prove_bundle(controller, bundle, limit)
        return lib.with_proof(bundle, proof), proof

    def compared(
        self, controller: lib.Exportable, bundle: lib.Bundle, records: lib.Records, gains: Any, tools: Tools
    ) -> Compared:
        """Return the comparison of C and Python over a run, the report of `--check`, and the binary files."""
        progress("compiling and replaying")
        binaries, report = dict[str, bytes](), None
        with tempfile.TemporaryDirectory(prefix="surctl-sil-") as scratch:
            compiled = lib.build_controller(controller, bundle, Path(scratch, bundle.name))
            (sil,) = lib.compare_runs(compiled, [records])
            if self.check:
                steps, (tried, untried) = self.steps or lib.STEPS, tools
                report = lib.check_builds(compiled, [records], tried, steps=steps, untried=untried, progress=progress)
            if self.target != "c99":
                progress("compiling the functional mock-up unit")
                fmi = 3 if self.target == "fmu3" else 2
                unit = lib.write_fmu(controller, bundle, controller.gains.pack(gains), scratch, fmi=fmi)
                binaries[unit.path.name] = unit.path.read_bytes()
        return Compared(sil, report, binaries)

    def finish(
        self,
        compared: Compared,
        bundle: lib.Bundle,
        assessment: lib.Assessment,
        *,
        proof: lib.ProofReport | None,
        replay: lib.ReplayedRun,
        replayed: str,
        about: tuple[Sequence[str], Sequence[str]],
        data: Mapping[str, Any],
        same: bool,
        then: Sequence[str],
        as_json: bool,
    ) -> None:
        """Write the bundle with its evidence, print what was compared and assessed, and end the command.

        Args:
            compared, bundle, assessment, proof: what is exported, and what is known of it.
            replay: the replayed run, for the manifest; `replayed` is its line.
            about: lines before the verdict: on the choice of the subject, and on the run.
            data: further data for JSON.
            same: whether C and Python agree.
            then: the commands to suggest next.
        """
        sil, report = compared.sil, compared.report
        known: dict[str, Any] = {"check": report, "proof": proof, "binaries": compared.binaries}
        command = result_command()
        note_replaced(self.out / "manifest.json", command)
        # a bundle appears when it is complete and checked, at once
        files = lib.write_evidence(bundle, self.out, [replay], [sil], assessment, command=command, **known)
        parts = {"sil": sil, "proof": proof, "check": report}
        data = {
            **data,
            "name": bundle.name,
            "id": bundle.id,
            "real": self.real,
            "files": [str(file.path) for file in files],
            "sha256": {file.path.relative_to(self.out).as_posix(): file.sha256 for file in files},
            "assessment": assessment.to_dict(),
            **{name: part.to_dict() for name, part in parts.items() if part is not None},
        }
        further = [line for one in (proof, report) if one is not None for line in ("", one.summary())]
        soft = report is not None and any(lib.PROCESSORS[one.target].machine and not one.same for one in report.builds)
        remedy = "; use --real float32" if self.real == "float64" and soft else ""  # no hardware for double
        problems = {
            "C and Python differ over the run": not same,
            f"C and Python differ in --check{remedy}": report is not None and not report.passed,
            "a run-time error is not excluded": proof is not None and not proof.proved,
        }
        failing = "; ".join(problem for problem, is_one in problems.items() if is_one)
        verdict = f"exported; NOT accepted: {failing}" if failing else f"exported; {assessment.verdict()}"
        first, last = about
        lines = [*first, *(f"{file.sha256[:12]}  {file.path}" for file in files), "", f"replayed: {replayed}", *last]
        lines += [sil.summary(), *further, verdict, *assessment.decisive()]
        brief = [_sil_line(sil), verdict, *([] if proof is None else [proof.summary()])]
        if report is None:  # the worst line, or the figures of a target, need the room
            brief += [f"replayed: {replayed}"] * assessment.accepted()
        else:  # what differs first
            brief += [" ".join(build.line().split()) for build in sorted(report.builds, key=lambda one: one.same)]
        finish(
            data, lines, as_json=as_json, passed=not failing and assessment.accepted(), then=then,
            brief=brief, files=[f"code {self.out} ({len(files)} files)"],
        )  # fmt: skip


class Compared(NamedTuple):
    """Comparison of C and Python over a run, report of `--check` or None, binary files by name."""

    sil: lib.SilReport
    report: lib.CheckReport | None
    binaries: dict[str, bytes]


@click.command
@click.argument("words", nargs=-1, metavar="[FILE.py:FUNCTION [NAME=VALUE]...]")
@seconds_option
@options(options=ExportOptions)
@as_json
def export(words: tuple[str, ...], seconds: float | None, options: ExportOptions, as_json: bool, **_: Any) -> None:
    """Write the controller as C99 and compare it with Python at each step of a run."""
    options = options.for_processor()
    if is_system(words):
        export_system(words, options, seconds=seconds, as_json=as_json)
    to_application(words)


def _sil_line(sil: lib.SilReport) -> str:
    import numpy as np

    largest = np.max([sil.tau.mixed, sil.state.mixed, sil.telemetry.mixed])
    head, _, _ = sil.summary().partition("\n")
    return f"{head}: C and Python differ by at most {largest:.1e}"


def system_bundle(
    own: OwnSystem, values: Mapping[str, ArrayLike], *, name: str | None = None, real: lib.Real = "float64"
) -> lib.Bundle:
    """Return the bundle of the system's controller with the gains of a run, and the plant's instruction lists."""
    controller = own.system.controller
    numbers = lib.run_numbers(own.system, values)
    plant, gains = lib.PlantLists(own.system.plant, numbers.plant[0]), controller.gains.unpack(numbers.gains[0])
    return lib.build_bundle(controller, gains, name=name, real=real, supplement=plant)


def replay_of(own: OwnSystem, record: lib.Record) -> lib.ReplayedRun:
    """Return the run of a system for the comparison of C with Python, and for the manifest of its bundle."""
    import numpy as np

    failure = None if record.stopped == lib.ENDED else record.lost or record.stopped
    reference = [float(x) for port in own.system.references for x in np.asarray(record[port.name])[0].ravel()]
    about: dict[str, Any] = {"system": own.label, "text": own.end_text(record), "failure": failure}
    about |= {"reference": reference} if np.isfinite(reference).all() else {}
    return lib.ReplayedRun(about, record)


def export_system(words: Sequence[str], options: ExportOptions, *, seconds: float | None, as_json: bool) -> None:
    """Write the controller as C, compare C and Python over a run; exit with status 1 if a number or a line fails.

    Raises:
        InputError: an option is not available, `--check` is missing, or the name is that of a built-in law.
    """
    real, tools = options.checked(TARGETS, of=" for a system of your own")
    own = load_system(words)
    duration, values = own.seconds(seconds), assigned(own.settings)
    name = own.exported_name(options.name)
    lib.check_folder(options.out)
    controller = own.system.controller
    record = lib.run_system(own.system, duration, values)
    bundle, proof = options.proved(controller, system_bundle(own, values, name=name, real=real))
    gains = controller.gains.unpack(record.controller[2])
    compared = options.compared(controller, bundle, lib.as_records(controller, record), gains, tools)
    sil = compared.sil
    data = {
        **own.names,
        "commands": {port.name: port.unit for port in own.system.commands},
        "stopped": record.stopped,
        "duration_s": record.duration,
        "costs": own.cost_data(record.figures),
        "largest_difference": max(part.absolute for part in (sil.tau, sil.state, sil.telemetry)),
    }
    options.finish(
        compared, bundle, lib.assess(lib.ClosedLoop(own.system, values, record=record)),
        proof=proof, replay=replay_of(own, record), replayed=own.end_text(record),
        about=((), own.cost_lines(record.figures)), data=data, same=sil.exact,
        # not the same comparison again, after that of --check
        then=[f"make -C {shlex.quote(str(options.out))} check"] if shutil.which("make") and not options.check else [],
        as_json=as_json,
    )  # fmt: skip

"""`export --prove`: proof by abstract interpretation (Frama-C's Eva) that the exported C has no run-time error.

The analysed program (`proof.c`) sets every state, input, gain and last accepted input to an arbitrary number in its
range, sets an arbitrary sample number, and calls the step once. If Eva reports no alarm, then in every such step no
uninitialised value is read, no array index is out of bounds, no conversion overflows, and each thrust is a number
within its limit. For a law in closed form with bounded memory and with ranges of its inputs, Eva also shows that no NaN
or infinity is computed and nothing is divided by zero. This is not proved for a law that loops over velocity
constraints `n·v ≤ b` with possibly infinite bounds b, whose state is unbounded, or that has no ranges at all. IEEE 754
defines the operations of such a law on infinities and NaN, and the exported step checks every result of the law. The
analysis uses the ranges of the guard (input check), which rejects all numbers outside before the law reads them. The
proof therefore covers every step on the robot.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, SurctlError, ToolMissing
from surctl.export.bundle import Bundle, manifest_with
from surctl.export.contract import Exportable, commands, entries
from surctl.export.envelope import anywhere
from surctl.export.rendering import templates
from surctl.ir import Block, Loop, Program, Routine, c_literal
from surctl.ir.c99 import C_TYPE
from surctl.ir.routine import nested

Vector = NDArray[np.float64]

_TOOL = "frama-c"
_OPTIONS = ("-eva", "-eva-no-show-progress", "-eva-msg-key=-final-states", "-main", "proof")
_BOUNDED = ("-eva-precision", "3", "-warn-special-float", "non-finite")
# Precision 0: higher precision gains nothing and does not finish. Loops over rows are unrolled; otherwise Eva assumes
# that rows which one loop filled may be empty in the next loop.
_UNBOUNDED = ("-eva-precision", "0", "-warn-special-float", "none", "-eva-auto-loop-unroll")
_LEAST_UNROLLED = 24
_INSIDE = "every intermediate number is finite, no divisor is zero"
_OUTSIDE = "a result that overflows or is not a number is refused"
_PROVED = ("Valid", "Considered valid", "Dead")
_OF_SHOWING = ("assigns clause", "from clause")  # alarms of Eva's printing function; the exported C has no contracts
_ANY = 1e38  # a larger bound means no bound
_LIMIT = 3600.0  # s, time limit; a law with sonars takes 13 minutes


@dataclass(frozen=True)
class Alarm:
    """A property of the exported C that could not be proved.

    Attributes:
        file, line: C file and line number of the property.
        kind: kind of the property, such as "division_by_zero"; "user assertion" means that the thrust is within its
            limit.
        text: the property, in the specification language ACSL.
    """

    file: str
    line: int
    kind: str
    text: str


@dataclass(frozen=True)
class ProofReport:
    """Outcome of one analysis of the exported C by abstract interpretation.

    Attributes:
        alarms: properties that could not be proved, in order of file and line.
        properties: number of properties that were analysed.
        seconds: duration of the analysis [s].
        tool: the analyser's version.
        log: output of the analyser.
        source: text of the analysed program.
        inside: whether the proof also shows that every intermediate number is finite and no divisor is zero.
        limited: whether it also shows that each command is within its limit.
    """

    alarms: tuple[Alarm, ...]
    properties: int
    seconds: float
    tool: str
    log: str
    source: str
    inside: bool = True
    limited: bool = True

    @property
    def proved(self) -> bool:
        """Return whether every property was proved, and the input check accepts at least one step."""
        return not self.alarms and self.properties > 0 and self.accepts

    @property
    def accepts(self) -> bool:
        """Return whether the input check accepts at least one step; otherwise the analysis never reaches the law."""
        match = re.search(r"show_each_status: (.*)", self.log)
        return match is not None and any(not number.startswith("-") for number in re.findall(r"-?\d+", match.group(1)))

    @property
    def claim(self) -> str:
        """Return the statement that holds if every property is proved."""
        common = "no uninitialised read, no index out of bounds, no conversion overflow"
        common += ", each thrust within its limit" if self.limited else ""
        return f"{common}; {_INSIDE if self.inside else _OUTSIDE}"

    def to_dict(self) -> dict[str, Any]:
        """Return the report as plain data for JSON, without the duration, which differs between runs."""
        return {
            "status": "proved" if self.proved else "open",
            "tool": self.tool,
            "claim": self.claim,
            "properties": self.properties,
            "alarms": [{"file": a.file, "line": a.line, "kind": a.kind, "property": a.text} for a in self.alarms],
        }

    def summary(self) -> str:
        """Return the report as lines of text."""
        verdict = "proved" if self.proved else f"OPEN, {len(self.alarms)} alarms"
        verdict += "" if self.accepts else ", and the guard accepts no step"
        spent = f"{self.properties} properties, {self.seconds:.1f} s, {self.tool}"
        limits = " and of thrust limits" if self.limited else ""
        head = f"proof of no run-time error{limits}: {verdict}; {spent}"
        return "\n".join([head, f"  {self.claim}", *(f"  {a.file}:{a.line}: {a.kind}: {a.text}" for a in self.alarms)])


def prove_bundle(law: Exportable, bundle: Bundle, limit: Vector | None = None) -> ProofReport:
    """Analyse the bundle's C with Frama-C, and return the report.

    Args:
        law: the exported law.
        bundle: the exported files; the analysis covers the ranges that their guard accepts.
        limit: largest absolute thrust of each axis (n_tau,) [N, N m], or least and largest thrust (2, n_tau); None:
            limits are not part of the proof.

    Raises:
        ToolMissing: Frama-C is not installed.
        SurctlError: Frama-C reports an error, or does not finish in time.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.export import build_bundle, closed_form, operating_envelope
        >>> from surctl.export import prove_bundle
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> shipped = closed_form(law, real="float32", constants=p)
        >>> within = operating_envelope(law, mission, vehicle, shipped.gains)
        >>> bundle = build_bundle(shipped, {}, real="float32", envelope=within)
        >>> report = prove_bundle(shipped, bundle, vehicle.thrust_limit)
        >>> report.proved, report.alarms
        (True, ())
    """
    if shutil.which(_TOOL) is None:
        raise ToolMissing(
            "is not installed", key=_TOOL, remedy="install it (Debian: frama-c-base), or export without --prove"
        )
    source, options = _program(law, bundle, limit), _options(law, bundle)
    with tempfile.TemporaryDirectory(prefix="surctl-proof-") as scratch:
        folder = Path(scratch).resolve()
        for file in (*bundle.headers, *bundle.sources):
            (folder / file).write_bytes(bundle.files[file].encode())
        (folder / "proof.c").write_bytes(source.encode())
        begin = time.perf_counter()
        log = _run(folder, [*options, "-cpp-extra-args=-I."], ("proof.c", *bundle.sources))
        spent = time.perf_counter() - begin
        table = folder / "out.csv"
        if not table.exists():
            raise SurctlError(f"{_TOOL} did not analyse the program: {_first_error(log)}")
        rows = list(csv.DictReader(io.StringIO(table.read_text(encoding="utf-8")), delimiter="\t"))
    files = ("proof.c", *bundle.headers, *bundle.sources)
    rows = [row for row in rows if row["file"] in files and row["property kind"] not in _OF_SHOWING]
    alarms = [
        Alarm(row["file"], int(row["line"]), row["property kind"], row["property"])
        for row in rows
        if row["status"] not in _PROVED
    ]
    version = subprocess.run([_TOOL, "-version"], capture_output=True, text=True, check=False).stdout.split()
    ordered = tuple(sorted(alarms, key=lambda a: (a.file, a.line, a.kind, a.text)))
    tool = f"Frama-C {version[0] if version else '?'}"
    return ProofReport(
        ordered, len(rows), spent, tool, log, source, inside=options == _BOUNDED, limited=limit is not None
    )


def _options(law: Exportable, bundle: Bundle) -> tuple[str, ...]:
    # options of Eva, with or without the proof that all numbers are finite (see the module docstring)
    within = bundle.envelope or anywhere(law)
    bounded = np.abs(np.vstack([within.state, within.inputs, within.gains])) < _ANY
    if bounded[: len(within.state)].all() and bounded.any() and isinstance(law.block, Program):
        return _BOUNDED
    turns = [loop.count for loop in _loops(law.block) if loop.until is None]  # loops with `until` fill no rows
    return (*_UNBOUNDED, str(max(_LEAST_UNROLLED, *turns, 0)))


def _loops(block: Block) -> Iterator[Loop]:
    for inner in nested(block).values():
        if isinstance(inner, Routine):
            yield from (step for step in inner.steps if isinstance(step, Loop))


def _run(folder: Path, options: Sequence[str], sources: Sequence[str]) -> str:
    command = [_TOOL, *_OPTIONS, *options, *sources, "-then", "-report-csv", "out.csv"]
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env={**os.environ, "PWD": str(folder)},  # Frama-C uses PWD instead of the actual working directory
            capture_output=True,
            text=True,
            check=False,
            timeout=_LIMIT,
        )
    except subprocess.TimeoutExpired:
        raise SurctlError(f"{_TOOL} did not end within {_LIMIT:.0f} s: the law is too large for it") from None
    return done.stdout + done.stderr


def _first_error(log: str) -> str:
    match = re.search(r"^.*(?:error|Error).*$", log, re.MULTILINE)
    return match.group(0).strip() if match else "no reason given"


def _program(law: Exportable, bundle: Bundle, limit: Vector | None) -> str:
    # proof.c
    real = bundle.real
    within = bundle.envelope or anywhere(law).fitted(law, real)
    ranges = [(f"state.x[{k}]", bounds) for k, bounds in enumerate(within.state)]
    for struct, layout, box in (("input", law.inputs, within.inputs), ("gains", law.gains, within.gains)):
        ranges += [(f"{struct}.{member}", bounds) for (member, _), bounds in zip(entries(layout), box, strict=True)]
    ranges += [(f"state.last[{k}]", within.inputs[rate.entry]) for k, rate in enumerate(within.rates)]
    ends = np.zeros((2, 0)) if limit is None else np.array([-limit, limit] if np.ndim(limit) == 1 else limit)
    limits = [tuple(Decimal(float(np.dtype(real).type(end))) for end in pair) for pair in ends.T]
    return (
        templates()
        .get_template("proof.c.j2")
        .render(
            name=bundle.name,
            real=C_TYPE[real],
            f=lambda number: c_literal(float(number), real),
            gains=law.gains,
            ranges=ranges,
            limits=[] if limit is None else list(zip((m for m, _ in entries(commands(law))), limits, strict=True)),
        )
    )


def with_proof(bundle: Bundle, report: ProofReport) -> Bundle:
    """Return the bundle with the analysed program, the analyser's log, and the outcome in the manifest."""
    files = {name: text for name, text in bundle.files.items() if name != "manifest.json"}
    files |= {"proof.c": report.source, "proof.log": report.log}
    table = json.loads(bundle.files["manifest.json"])
    manifest = manifest_with(table, files, proof=report.to_dict(), binaries=bundle.binaries)
    return replace(bundle, files=MappingProxyType({**files, "manifest.json": manifest}))


def gain_box(law: Exportable, values: Vector, ranges: Mapping[str, tuple[float, float]]) -> Vector:
    """Return the ranges (np, 2) of the gains in the proof; a gain without a range in `ranges` is constant."""
    box = np.repeat(np.asarray(values, dtype=float)[:, None], 2, axis=1)
    for name, (low, high) in ranges.items():
        if name in law.gains:
            part = law.gains.slice(name)
            if not ((low <= box[part]) & (box[part] <= high)).all():
                problem = f"is outside the range of the proof, {low:g} to {high:g}"
                remedy = "widen its range in the gain file, or change the value"
                raise InputError(problem, key=name, value=float(values[part][0]), remedy=remedy)
            box[part] = (low, high)
    return box

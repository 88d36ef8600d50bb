"""Study 18: the same controller as C of surctl and of CasADi on an emulated Cortex-M4F; wrong versions of surctl's C.

    python analysis/18_export_benchmark/run.py [--quick] [--write]

Prints Markdown; --write writes the README from it. The exit status is 1 if a limit does not hold, and 2 for a bad
option.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from bounded import flights, quality
from contenders import Contender, casadi_c, controller, ours
from limits import USUAL, WORST, laws, ticks
from numpy.typing import NDArray
from peers import PROBLEM, race
from proofs import whole_laws
from whole import whole

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.errors import SurctlError
from surctl.export import TARGETS, Controller, Records
from surctl.export.check import Instructions, built_for, instructions, trial_steps
from surctl.export.process import code_bytes
from surctl.export.prove import prove_bundle
from surctl.ir import Program, replay
from tests.oracles.proof_mutants import caught_by, mutants

_DECIDED = 0.01  # [N] difference from which a step in floats counts as decided otherwise than in doubles
BUILDS = ("gcc-O0", "gcc-O3", "gcc-native", "clang-O2", "cortex-m4f", "cortex-m7")
QUICK = ("gcc-O0", "cortex-m4f")
MOST_INSTRUCTIONS, SPREAD, MOST_BYTES, LEAST_MUTANTS = 1200, 1.10, 4500, 20


@dataclass(frozen=True)
class Line:
    """The results of one version on the M4F."""

    contender: Contender
    level: str
    counted: Instructions
    size: int
    error: tuple[float, float]
    same: int
    builds: int

    def row(self) -> str:
        """Return its row of the table."""
        i = self.counted
        cells = [
            self.contender.name,
            "yes" if self.contender.guarded else "no",
            self.level,
            f"{i.least} / {i.mean:.0f} / {i.most}",
            f"{i.most / i.least:.2f}",
            str(self.size),
            f"{self.error[0]:.1e}",
            f"{self.error[1]:.2%}",
            f"{self.same} of {self.builds}",
        ]
        return f"| {' | '.join(cells)} |"


def vectors(base: Contender, flight: Records, steps: int) -> Records:
    """Return the run, then single steps around it that the guard accepts, in float and in double."""
    within = base.bundle.envelope
    assert within is not None
    alone = trial_steps(base.law, [flight], steps, real=base.bundle.real, within=within)
    box = np.vstack([within.state, within.inputs])
    rows = np.hstack([alone.X, alone.U])
    kept = np.isfinite(rows).all(axis=1) & (rows > box[:, 0]).all(axis=1) & (rows < box[:, 1]).all(axis=1)
    pairs = zip((flight.X, flight.U, flight.P), (part[kept] for part in (alone.X, alone.U, alone.P)), strict=True)
    return Records(*(np.concatenate(pair) for pair in pairs))


def measure(contender: Contender, reference: Contender, given: Records, names: tuple[str, ...], level: str) -> Line:
    """Build a version for all targets; compare the builds with each other and with the reference in double."""
    real = contender.bundle.real
    host = Controller(contender.law, contender.bundle, (), None)
    load = np.ones(len(given), dtype=bool)
    rounded = Records(*(part.astype(real).astype(float) for part in (given.X, given.U, given.P)))
    answers: list[NDArray[np.float64]] = []
    counted = size = None
    for name in names:
        flags = tuple(level if f == "-O2" and name.startswith("cortex") else f for f in TARGETS[name].flags)
        target = replace(TARGETS[name], flags=(*flags, "-w"))  # the C of other generators compiles only with warnings
        with tempfile.TemporaryDirectory() as scratch:
            built, counts, code = built_for(host, target, Path(scratch))
            rows = built.run(rounded, load=load)
            answers.append(np.hstack([rows.tau, rows.state]))
            if name == "cortex-m4f":
                counted = instructions(counts, rows.status >= 0)
                size = code_bytes(code[:-1], target.size_tool)  # without the self-test's
    assert counted is not None and size is not None
    assert isinstance(reference.law.block, Program)
    exact = replay(reference.law.block, rounded.X, rounded.U, rounded.P)[0]
    off = np.abs(answers[names.index("cortex-m4f")][:, :4] - exact).max(axis=1)
    error = (float(np.quantile(off, 0.95)), float(np.mean(off > _DECIDED)))
    same = max(sum(np.array_equal(a, b) for b in answers) for a in answers)
    return Line(contender, level, counted, size, error, same, len(names))


def wrong_versions(
    base: Contender, flight: Records, limit: NDArray[np.float64], each: int
) -> tuple[list[str], int, int]:
    """Return lines, the number of wrong versions, and the number that nothing detects."""
    counts: dict[tuple[str, str], int] = {}
    missed = []
    tried = mutants(base.bundle, each=each)
    for mutant in tried:
        with tempfile.TemporaryDirectory() as scratch:
            by = caught_by(base.law, mutant, flight, Path(scratch, "b"), limit=limit)
        counts[mutant.kind, by or "nothing"] = counts.get((mutant.kind, by or "nothing"), 0) + 1
        if by is None:
            missed.append(f"{mutant.file}, line {mutant.line}: `{mutant.old}` → `{mutant.new}`")
    lines = ["| kind | caught by | mutants |", "|---|---|---|"]
    lines += [f"| {kind} | {by} | {count} |" for (kind, by), count in sorted(counts.items())]
    return [*lines, *(["", *(f"- not caught: {m}" for m in missed)] if missed else [])], len(tried), len(missed)


def main() -> int:
    """Run the study and print the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer steps, builds and wrong versions")
    parser.add_argument("--write", action="store_true", help="write README.md beside this file")
    options = parser.parse_args()
    text, held = study(quick=options.quick)
    print(text)
    if options.write:
        folder = Path(__file__).parent
        folder.joinpath("README.md").write_text(f"{folder.joinpath('about.md').read_text()}\n{text}\n")
    return 0 if held else 1


def study(*, quick: bool) -> tuple[str, bool]:
    """Return the Markdown text, and whether every limit holds."""
    law, vehicle, numbers, flight = controller()
    single, double = ours(law, vehicle, numbers, "float32"), ours(law, vehicle, numbers, "float64")
    names, steps = (QUICK, 500) if quick else (BUILDS, 4_000)
    contenders = [
        (single, "-O2"),
        (single, "-Os"),
        (double, "-O2"),
        (casadi_c(law, single, numbers, shim=True), "-O2"),
        (casadi_c(law, single, numbers), "-O2"),
        (casadi_c(law, double, numbers), "-O2"),
    ]
    given = vectors(single, flight, steps)
    out = [
        f"{len(given)} steps, of which {len(flight)} are a run of `pool-ahead`; errors against the law in double.",
        "",
        "| C | guard | M4F | instructions, min / mean / max | max/min | code, B | error of τ, 95 % of steps, N "
        "| decided otherwise | same bytes in |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    lines = []
    for contender, level in contenders:
        try:
            lines.append(measure(contender, double, given, names, level))
            out.append(lines[-1].row())
        except SurctlError as failure:
            out.append(f"| {contender.name} | | {level} | {failure} | | | | | |")
    proof = prove_bundle(single.law, single.bundle, vehicle.thrust_limit)
    out += ["", f"{proof.summary().splitlines()[0]}."]
    told, tried, missed = wrong_versions(single, flight, vehicle.thrust_limit, 1 if quick else 10)
    out += ["", f"{tried} wrong versions of ours in float32, {missed} not caught:", "", *told]
    kept, alone = laws(quick=quick), ticks(quick=quick)
    out += [
        "",
        "## With limits: mode projected",
        "",
        *kept.lines,
        "",
        f"The step alone, {alone.title}:",
        "",
        *alone.lines,
    ]
    bounded_laws, bounded = laws(quick=quick, ladder="bounded"), ticks(quick=quick, ladder="bounded")
    out += [
        "",
        "## With limits and the bounded fallback",
        "",
        *bounded_laws.lines,
        "",
        f"The step alone, {bounded.title}:",
        "",
        *bounded.lines,
        "",
        "In double, where it had no answer of its own (rows of length 1, the task's longest too):",
        "",
        *quality(quick=quick),
        "",
        *flights(quick=quick),
    ]
    others, apart, cut = race(quick=quick)
    out += ["", f"Other solvers, {PROBLEM}:", "", *others]
    sizes, small = whole(quick=quick)
    out += ["", "## Whole laws: their C, their compilation, their steps", "", *sizes]
    proofs, proved = whole_laws(quick=quick)
    out += ["", "## Proof of whole laws", "", *proofs, "", "## Bars", ""]
    best, worst = lines[1], max(kept.most, alone.most)
    out += [f"- exact fallback, contradicting rows included: {worst} at most; only the bounded one has a bound"]
    usual, usual_bounded = lines[0].counted.mean + alone.mean, lines[0].counted.mean + bounded.mean
    held = [
        (f"at most {MOST_INSTRUCTIONS} instructions a step with -Os", best.counted.most <= MOST_INSTRUCTIONS),
        (f"max/min at most {SPREAD:.2f}", best.counted.most <= SPREAD * best.counted.least),
        (f"at most {MOST_BYTES} B of code", best.size <= MOST_BYTES),
        ("our bytes are the same in every build", all(line.same == line.builds for line in lines[:3])),
        ("no alarm in 60 s", proof.proved and proof.seconds <= 60.0),
        ("no alarm in whole laws", proved),
        (f"at least {LEAST_MUTANTS} wrong versions caught", quick or tried - missed >= LEAST_MUTANTS),
    ]
    held += small
    held += [
        (f"with limits, in a run, one static obstacle: at most {USUAL} in the mean", kept.mean <= USUAL),
        (f"closed form and a step of 24 rows that hold: at most {USUAL} in the mean ({usual:.0f})", usual <= USUAL),
        (
            f"24 compatible rows and 2 equalities: at most {USUAL} in the mean, {WORST} at worst",
            apart.mean() <= USUAL and apart.max() <= WORST,
        ),
        (
            f"bounded fallback, the step, contradicting rows included: at most {WORST} ({bounded.most})",
            bounded.most <= WORST,
        ),
        (f"bounded fallback, every loop of the step at its bound: at most {WORST}", bounded.bound <= WORST),
        (
            f"bounded fallback, laws with static obstacles, single steps: at most {WORST} ({bounded_laws.most})",
            bounded_laws.most <= WORST,
        ),
        (
            f"bounded fallback, closed form and a step of 24 rows that hold: at most {USUAL} in the mean "
            f"({usual_bounded:.0f})",
            usual_bounded <= USUAL,
        ),
        (
            f"bounded fallback, 24 compatible rows and 2 equalities: at most {USUAL} in the mean, {WORST} at worst",
            cut.mean() <= USUAL and cut.max() <= WORST,
        ),
        ("with limits: the bytes of Python", all(told.same for told in (kept, alone, bounded_laws, bounded))),
    ]
    out += [*(f"- {what}: {'holds' if holds else '**does not hold**'}" for what, holds in held)]
    return "\n".join(out), all(holds for _, holds in held)


if __name__ == "__main__":
    sys.exit(main())

"""Study 5: the time of a step of the priority law, compared with other solvers and libraries on the same problems.

    python analysis/05_priority_benchmark/run.py [--quick] [--out DIR] [--seed 0] [--bars]

Prints Markdown and saves a picture. The exit status is 0 if every solution of this toolkit is correct, and 1
otherwise; with --bars it is also 1 if a speed limit is missed; 2 for a bad option or folder, or without a C compiler.
"""

from __future__ import annotations

import argparse
import platform
import sys
import tempfile
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import get_args

from cascades import cascades, hierarchies, others
from contender import Contender, Missing, race, warm_up
from in_c import (
    CASADI_CLOSED,
    CLOSED,
    LEAST,
    OSQP,
    OURS,
    OURS_CLOSED,
    OURS_TICKS,
    QRQP,
    TICKS,
    CompiledRun,
    compiled,
    race_in_c,
)
from instances import draw_instances
from ours import FAST, FAST_STRICT, FILTER, NSB, PROJECTED, STRICT, by_reference, ours
from peers import MINK, PEER, PEER_API, PEER_FAST, PEER_FILTER, PINK, peers
from tables import Line, compiled_lines, draw, lines_of, print_bars, print_lines, print_rows

from surctl.errors import InputError, ToolMissing
from surctl.files import prepare_folder
from surctl.ir.cache import compiler_version
from surctl.priority import Mode

KEPT, ONE_CALL = "DAQP hierarchy: Model kept", "DAQP hierarchy: one call"
PACKAGES = (
    *("numpy", "casadi", "daqp", "osqp", "qpsolvers", "clarabel", "piqp", "proxsuite", "quadprog"),
    *("pin", "pin-pink", "mujoco", "mink"),
)

# reference of each problem: a contender that shares as little code as possible with our other contenders
REFERENCES = {
    **{NSB: "numpy nested pinv", FILTER: by_reference(FILTER), PROJECTED: by_reference(PROJECTED)},
    **{STRICT: KEPT, PEER: PEER_API},
}
OURS_IN_C = {LEAST: OURS, CLOSED: OURS_CLOSED} | {TICKS[mode]: OURS_TICKS[mode] for mode in TICKS}


def main(arguments: list[str]) -> int:
    """Run the study; the exit status."""
    parser = argparse.ArgumentParser(
        prog="run.py", description="Compare the time of a step of the priority law with other solvers."
    )
    parser.add_argument(
        "--quick", action="store_true", help="few steps, rounds and modes: shows that it runs; times are not reliable"
    )
    parser.add_argument("--out", type=Path, help="folder of benchmark.png; default: a new temporary one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bars", action="store_true", help="exit status 1 if a speed limit is missed")
    options = parser.parse_args(arguments)
    if options.seed < 0:
        parser.error("--seed is at least 0")
    try:
        out = prepare_folder(options.out or Path(tempfile.mkdtemp(prefix="surctl-benchmark-")))
        return study(quick=options.quick, seed=options.seed, out=out, strict=options.bars)
    except (InputError, ToolMissing) as error:
        print(error, file=sys.stderr)
        return 2


def study(*, quick: bool, seed: int, out: Path, strict: bool) -> int:
    """Time the contenders in Python and in C, print, and draw."""
    print_machine()
    count, rounds, budget = (16, 1, 0.1) if quick else (300, 12, 8.0)
    instances = draw_instances(count, seed=seed)
    fast = (PROJECTED,) if quick else (PROJECTED, NSB, "filter", STRICT)
    taking_part = [*ours(instances, fast), *hierarchies(instances), *cascades(instances), *others(instances)]
    taking_part += peers(count, seed=seed, filtered=not quick)
    contenders = [each for each in taking_part if isinstance(each, Contender)]
    timings = warm_up(contenders)
    race(contenders, timings, rounds=rounds, turn=25, budget=budget)
    python = lines_of(contenders, timings, REFERENCES)
    with tempfile.TemporaryDirectory() as folder:
        built, references = compiled(
            instances,
            modes=(NSB,) if quick else get_args(Mode),
            count=30 if quick else 1000,
            seed=seed + 5,
            folder=Path(folder),
        )
        runs = [run for run in built if isinstance(run, CompiledRun)]
        race_in_c(runs, rounds=1 if quick else 40)
    in_c = compiled_lines(runs, references)
    print("\n## One step, called from Python")
    print_lines(python, ours=dict.fromkeys(REFERENCES, FAST) | {PEER: PEER_FAST}, mean=False)
    print("\n## Inside C")
    print_lines(in_c, ours=OURS_IN_C, mean=True)
    print_missing([each for each in (*taking_part, *built) if isinstance(each, Missing)])
    print("\n## Bars of speed")
    held = print_bars(bars({line.name: line for line in (*python, *in_c)}))
    draw([*python, *in_c], out / "benchmark.png")
    print(f"\nPicture: {out / 'benchmark.png'}")
    right = print_wrong([*python, *in_c])
    return 0 if right and (held or not strict) else 1


def bars(lines: dict[str, Line]) -> list[tuple[str, float | None, float, bool]]:
    """Print the speed limits of the toolkit; study 3 has the comparison with DAQP's core."""

    def ratio(who: str, other: str) -> float | None:
        return lines[who].typical / lines[other].typical if {who, other} <= lines.keys() else None

    found: list[tuple[str, float | None, float, bool]] = [
        ("safe step from Python, median µs", lines[FAST].median / 1e3, 6.0, True),
        ("safe step from Python / DAQP's kept hierarchy", ratio(FAST, KEPT), 1.0, True),
    ]
    if FAST_STRICT in lines:
        found.append((f"{FAST_STRICT}, median µs", lines[FAST_STRICT].median / 1e3, 4.0, True))
        found.append((f"{FAST_STRICT} / {ONE_CALL}", ratio(FAST_STRICT, ONE_CALL), 1.0, True))
    for mode, most in ((PROJECTED, 40.0), (STRICT, 60.0)):
        found.append((f"surctl solve: {mode}, median µs", lines[f"surctl solve: {mode}"].median / 1e3, most, True))
    for fast in (PEER_FAST, PEER_FILTER):
        found += [(f"{name} / {fast}", ratio(name, fast), 30.0, False) for name in (PINK, MINK)]
    found.append((f"{QRQP} / ours", ratio(QRQP, OURS), 30.0, False))
    found += [(f"{name} / ours", ratio(name, OURS), 100.0, False) for name in OSQP]
    found.append(("our closed form / CasADi's, both in C", ratio(OURS_CLOSED, CASADI_CLOSED), 1.2, True))
    return found


def print_wrong(lines: Sequence[Line]) -> bool:
    """Print the wrong or missing solutions of this toolkit; return whether there are none."""
    wrong = [line for line in lines if line.ours and (line.off or line.silent)]
    for line in wrong:
        print(f"\n**Wrong**: {line.name}: {line.off} off by up to {line.gap:.1e}, {line.silent} without an answer.")
    if not wrong:
        print("\nEvery answer of this toolkit agrees with its reference.")
    return not wrong


def print_missing(missing: Sequence[Missing]) -> None:
    """Print the contenders that did not take part."""
    if missing:
        print_rows(["did not take part", "why"], [[each.name, each.reason] for each in missing])


def print_machine() -> None:
    """Print processor, system, compiler and versions."""
    system = f"{platform.system()} {platform.machine()}"
    print(f"Machine: {processor()}, {system}, Python {platform.python_version()}, {compiler_version()}")
    print(f"\nVersions: {', '.join(filter(None, map(installed, PACKAGES)))}")


def processor() -> str:
    """Return the name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(": ")[2] for line in lines if line.startswith("model name")), platform.processor())


def installed(package: str) -> str:
    """Return name and version of a package, or an empty text."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return ""


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

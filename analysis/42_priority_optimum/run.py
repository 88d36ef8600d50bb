"""Study 42: is the velocity of a priority step optimal, or does the status say that it may not be?

    python analysis/42_priority_optimum/run.py [--quick] [--count 20000] [--only 4 7 10 14 20] [--seed 0]

Prints Markdown. The exit status is 0 if every limit holds, 1 otherwise, and 2 for a bad option or without a C compiler.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from draws import CLASSES, QUICK, SIZES, Size, draw
from exact import least_residuals
from reference import best, least_opening, opened, violation, worse

from surctl.errors import ToolMissing
from surctl.ir.cache import find_compiler
from surctl.priority import Mode, PriorityProblem, PriorityStep, Settings
from surctl.priority.optimality import is_least

TOLERANCE = 1e-6
COMPARED = 5
"""One of so many problems is also solved by the references; every solution is judged by `is_least`."""

VIOLATED = 1e-8
"""A velocity that exceeds a limit (of length 1, barriers opened) by more than this counts as worse."""

COLUMNS = ("worse, no word", "unproved", "unconfirmed", "worse, unconfirmed", "compared")
"""worse: than a reference, by more than the tolerance. unproved: neither shown to be optimal by `is_least` nor called
unconfirmed; these are compared too. compared: with a reference solution that satisfies the limits to 1e-11."""


def main(arguments: list[str]) -> int:
    """Run the campaign; return the exit status."""
    parser = argparse.ArgumentParser(description="optimal, or a status that says it may not be")
    parser.add_argument("--quick", action="store_true", help="75 small problems of each mode")
    parser.add_argument("--count", type=int, default=20_000, help="problems of each number of velocities")
    parser.add_argument("--only", type=int, nargs="+", default=list(SIZES), choices=list(SIZES))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if options.count < 1 or options.seed < 0:
        parser.error("--count is at least 1, --seed at least 0")
    try:
        find_compiler()
    except ToolMissing as missing:
        print(missing, file=sys.stderr)
        return 2
    sizes = [QUICK] if options.quick else [SIZES[n] for n in options.only]
    modes: tuple[Mode, ...] = ("lexicographic", "projected")
    print("| n | mode | class | problems | " + " | ".join(COLUMNS) + " |\n" + "|---" * (4 + len(COLUMNS)) + "|")
    began, silent = time.process_time(), 0
    for size in sizes:
        for mode in modes:
            count = 75 if options.quick else options.count * (4 if mode == "lexicographic" else 1) // 5
            silent += _campaign(size, mode, count, options.seed, 1 if options.quick else COMPARED)
    print(
        f"\nWithout the status `unconfirmed`, worse than a reference or neither proved nor compared: {silent}", end=""
    )
    print("." if silent == 0 else ", FAILED.", f"Processor time {time.process_time() - began:.0f} s.")
    return 0 if silent == 0 else 1


def _campaign(size: Size, mode: Mode, count: int, seed: int, compare: int) -> int:
    """Print one row per class; return the number of solutions that are worse, or unproved, without a word."""
    step, silent = PriorityStep(mode, n=size.n, levels=size.shapes, rows=size.rows), 0
    for place, kind in enumerate(CLASSES):
        seen = Counter[str]()
        for k in range(count // len(CLASSES)):
            problem = draw(np.random.default_rng([seed, size.n, place, k]), size, kind)
            step.load(problem)
            step.solve()
            where = f"n={size.n} {mode} {kind} {k}"
            compared = k % compare == 0
            opening = float(step.opening[0])
            seen += _judged(problem, mode, step.v, step.target, step.stage, opening, where, compared, k == 0)
        cells = " | ".join(str(seen[name]) for name in COLUMNS)
        print(f"| {size.n} | {mode} | {kind} | {seen['problems']} | {cells} |", flush=True)
        silent += seen["worse, no word"] + seen["undecided"]
    return silent


def _judged(
    problem: PriorityProblem,
    mode: Mode,
    v: np.ndarray,
    target: np.ndarray,
    status: str,
    opening: float,
    where: str,
    compared: bool = True,
    exact: bool = False,
) -> Counter[str]:
    silent = status != "unconfirmed"
    proved = silent and is_least(v, problem, settings=Settings(mode), target=target, tol=TOLERANCE)
    result = Counter[str]({"problems": 1, "unconfirmed": int(not silent), "unproved": int(silent and not proved)})
    if not compared and (proved or not silent):
        return result
    strict = len(problem.levels) if mode == "lexicographic" else 1
    allowed = opened(problem, opening) if opening > 0.0 else problem
    found = [level.residual(v) for level in problem.levels[:strict]]
    others = best(allowed, strict)
    # a reference may exceed limits by 1e-11, which is worth 1e-5 of a residual in a few problems: then 60 digits decide
    lost = any(worse(found, other) for other in others)
    decided = proved or bool(others)
    if silent and (lost or not proved or exact):
        least = least_residuals(allowed, strict, v)
        decided = proved or least is not None
        lost = lost if least is None else worse(found, least)
        if lost:  # limits that almost contradict each other: 1e-10 beyond one of them may be worth 1e-5 of a residual
            within = least_residuals(allowed, strict, v, moved=False)
            lost = within is None or any(r > o + TOLERANCE * (1.0 + o) for r, o in zip(found, within, strict=True))
    lost = lost or violation(allowed, v) > VIOLATED
    if opening > 0.0:
        lost = lost or opening > least_opening(problem) + TOLERANCE * (1.0 + opening)
    result["compared"] += bool(others)
    result["worse, no word" if silent else "worse, unconfirmed"] += lost
    result["undecided"] += silent and not decided
    if silent and (lost or not proved):
        print(f"{where}: {status}, lost {lost}, proved {proved}, {np.round(found, 9).tolist()}", file=sys.stderr)
    return result


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

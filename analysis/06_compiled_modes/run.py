"""Study 6: the compiled step of every mode compared with the law in NumPy, and the time of a step from Python.

    python analysis/06_compiled_modes/run.py [--quick] [--n 10000] [--seed 0] [--no-timing]

Prints Markdown. The exit status is 0 if every limit below holds, and 1 otherwise; it is 2 for a bad option, or
without a C compiler. Times are medians over this machine and are not part of the exit status, except for the limit on
the safe step.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import casadi as ca
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.errors import ToolMissing
from surctl.ir.cache import compiler_version, find_compiler
from surctl.priority import Mode, Settings, build_problem, solve
from surctl.priority.compiled.assemble import assemble
from surctl.priority.compiled.step import PriorityStep
from surctl.priority.optimality import is_optimal
from surctl.priority.problem import Level, PriorityProblem, Row
from surctl.priority.shapes import LevelShape
from surctl.tasks import (
    HalfPlane,
    Stack,
    VelocityBox,
    depth_task,
    heading_task,
    line_of_sight_task,
    position_task,
)
from tests.oracles.shape_draws import draw_of_shape

N, PLACES = 4, 24
SHAPES = (
    (LevelShape(2), LevelShape(1)),
    (LevelShape(1),) * 4,
    (LevelShape(4), LevelShape(3), LevelShape(2)),
    (LevelShape(1, True), LevelShape(2), LevelShape(1, True)),
    (LevelShape(2), LevelShape(1, True), LevelShape(1)),
)
SETTINGS = (
    Settings("nsb"),
    Settings("nsb", damping=0.1),
    Settings("filter"),
    Settings("projected"),
    Settings("projected", damping=0.1),
    Settings("lexicographic"),
)
QUICK = (Settings("nsb"), Settings("projected"))
RUNGS = ("met", "limited", "relaxed", "clamped", "unconfirmed")
OUTCOMES = ("optimal", "limited", "relaxed", "clamped", "unconfirmed")
BARS = {"nsb": 1e-12, "met": 1e-9, "limited": 1e-8}
"""Largest difference of v, relative to 1 + max |v|. Where rows opened by the least amount nothing is left inside them:
v then depends on the last digits of the opening, and only the share above 1e-8 is printed."""
MICROSECONDS = 6.0


def main(arguments: list[str]) -> int:
    """Run both parts; return the exit status."""
    parser = argparse.ArgumentParser(description="compiled steps: agreement and speed")
    parser.add_argument("--quick", action="store_true", help="25 problems a mode unless --n says otherwise")
    parser.add_argument("--n", type=int, help="random problems a mode; 10,000 if not given")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-timing", action="store_true", help="skip the timing")
    options = parser.parse_args(arguments)
    count = options.n if options.n is not None else 25 if options.quick else 10_000
    if count < 1 or options.seed < 0:
        parser.error("--n is at least 1, --seed at least 0")
    try:
        find_compiler()
    except ToolMissing as missing:
        print(missing, file=sys.stderr)
        return 2
    held = agreement(count, options.seed, *((SHAPES[3:4], QUICK) if options.quick else (SHAPES, SETTINGS)))
    if not options.no_timing:
        held = timing(300 if options.quick else 3_000) and held
    return 0 if held else 1


def agreement(
    count: int, seed: int, shapes: tuple[tuple[LevelShape, ...], ...], settings: tuple[Settings, ...]
) -> bool:
    """Compare `count` problems per setting; return whether the limits hold."""
    print(f"## {count} problems a row, seed {seed}: v against the law in NumPy\n")
    print("| mode | λ | " + " | ".join(f"{rung} | worst" for rung in RUNGS[:3]), end=" | ")
    print("relaxed > 1e-8 | other outcome | refused at 1e-6 | |")
    print("|---" * 13 + "|")
    held = [_compared(each, count, seed, shapes) for each in settings]  # every row is printed
    return all(held)


def _compared(settings: Settings, count: int, seed: int, shapes: tuple[tuple[LevelShape, ...], ...]) -> bool:
    ticks = [PriorityStep(settings.mode, n=N, levels=s, rows=PLACES, damping=settings.damping) for s in shapes]
    rng = np.random.default_rng(seed)
    gaps: dict[str, list[float]] = {rung: [] for rung in RUNGS}
    other = refused = 0
    for k in range(count):
        tick = ticks[k % len(ticks)]
        problem = draw_of_shape(rng, shapes[k % len(shapes)])
        gap, same, right = _tried(tick, problem, settings)
        gaps[tick.stage].append(gap)
        other += not same
        refused += not right
    worst = {rung: max(values, default=0.0) for rung, values in gaps.items()}
    bars = {"met": BARS["nsb"]} if settings.mode == "nsb" else {rung: BARS[rung] for rung in ("met", "limited")}
    held = all(worst[rung] <= bar for rung, bar in bars.items()) and other == 0 and not gaps["clamped"]
    far = sum(gap > 1e-8 for gap in gaps["relaxed"])
    cells = " | ".join(f"{len(gaps[rung])} | {worst[rung]:.1e}" for rung in RUNGS[:3])
    print(
        f"| {settings.mode} | {settings.damping:g} | {cells} | {far} | {other} | {refused} |",
        end="",
    )
    print(" |" if held else " FAILED |")
    return held


def _tried(tick: PriorityStep, problem: PriorityProblem, settings: Settings) -> tuple[float, bool, bool]:
    """Return the difference of v, whether the status is equal, and whether `optimality` accepts the solution."""
    tick.load(problem)
    tick.solve()
    one = {"mode": settings.mode, "damping": settings.damping}
    want = solve(problem, **one, backend="daqp")
    gap = float(np.abs(tick.v - want.v).max() / (1.0 + np.abs(want.v).max()))
    right = is_optimal(tick.v, problem, settings=settings, target=tick.target, tol=1e-6)
    return gap, want.status == OUTCOMES[RUNGS.index(tick.stage)], right


def timing(rounds: int) -> bool:
    """Print median times of a step; return whether the limit holds."""
    problem = _benchmark()
    J = np.vstack([level.J for level in problem.levels])
    x = np.concatenate([level.lower for level in problem.levels])
    print(f"\n## Time of a step [µs]: 4 tasks (5 rows), box, 8 barriers; {compiler_version()}\n")
    print("| mode | solve | J, x and rows written, then solve | from a stack: η and barriers in, v out |")
    print("|---|---|---|---|")
    slowest = 0.0
    for mode in get_args(Mode):
        tick, step = PriorityStep.of(problem, mode), _from_stack(mode)
        barriers, places = tick.rows[N:].copy(), tick.rows[N:]
        fast = _median(tick.solve, rounds)
        full = _median(_rewriting(tick, J, x, barriers, places), rounds)
        print(f"| {mode} | {fast:.2f} | {full:.2f} | {_median(step, rounds):.2f} |")
        slowest = full if mode == "projected" else slowest
    held = slowest <= MICROSECONDS
    print(f"\nLimit: mode projected, all inputs written in each step, at most {MICROSECONDS:g}: {slowest:.2f}", end="")
    print("." if held else ", FAILED.")
    return held


def _rewriting(
    tick: PriorityStep, J: np.ndarray, x: np.ndarray, barriers: np.ndarray, places: np.ndarray
) -> Callable[[], None]:
    def run() -> None:
        tick.J[:] = J
        tick.lower[:] = x
        tick.upper[:] = x
        places[:] = barriers
        tick.solve()

    return run


def _benchmark() -> PriorityProblem:
    """Return four random tasks that the box and some barriers restrict."""
    rng = np.random.default_rng(1)
    levels = [Level(f"task{i}", rng.normal(size=(k, N)), 0.4 * rng.normal(size=k)) for i, k in enumerate((1, 1, 1, 2))]
    rows = [Row(f"box{i}", "actuator", np.eye(N)[i], -0.3, 0.3) for i in range(N)]
    rows += [Row(f"wall{i}", "barrier", rng.normal(size=N), -np.inf, rng.uniform(0.05, 0.4)) for i in range(8)]
    return build_problem(levels, rows)


def _from_stack(mode: Mode) -> Callable[[], None]:
    """Return a stack of the same sizes from symbols: depth, heading, line of sight, position; box and 8 half-planes."""
    rng = np.random.default_rng(1)
    eta, goal, walls = ca.SX.sym("eta", 4), ca.SX.sym("goal", 2), ca.SX.sym("walls", 40)
    tasks = (depth_task(eta, -0.2), heading_task(eta, 0.3), line_of_sight_task(eta, goal), position_task(eta, goal))
    planes = [HalfPlane(f"wall{i}", walls[5 * i : 5 * i + 4], walls[5 * i + 4]) for i in range(8)]
    made = assemble(
        Stack(tasks),
        [VelocityBox([-0.3] * 4, [0.3] * 4), *planes],
        inputs={"eta": eta, "goal": goal, "walls": walls},
    )
    tick = made.step(mode)
    pose, given = rng.normal(size=4), np.hstack([rng.normal(size=(8, 4)), rng.uniform(0.05, 0.4, (8, 1))]).reshape(-1)
    tick.inputs["goal"][:] = rng.normal(size=2)
    into_eta, into_walls = tick.inputs["eta"], tick.inputs["walls"]

    def run() -> None:
        into_eta[:] = pose
        into_walls[:] = given
        tick.solve()

    return run


def _median(run: Callable[[], None], rounds: int) -> float:
    """Return the median time of one call [µs], over groups of 20."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter_ns()
        for _ in range(20):
            run()
        times.append((time.perf_counter_ns() - start) / 20e3)
    return statistics.median(times)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Study 4: do the four priority modes have their stated properties, and how large are the residuals of the tasks?

    python analysis/04_priority_modes/run.py [--quick] [--n 10000] [--seed 0]

Prints Markdown. The exit status is 0 if every limit holds, 1 otherwise, and 2 for a bad option.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
from continuity import LOOPS, MAY_JUMP, SETTINGS, chatter, lipschitz
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.priority import Level, Mode, PriorityProblem, Row, build_problem, solve
from surctl.priority.diagnosis.laws import TOLERANCE, commutator_norms
from tests.oracles.priority_draws import draw_levels, draw_problem, inequality_problem, unit, wide, with_sets
from tests.oracles.priority_references import daqp_hierarchy, printed_law, svd_cascade

reference = partial(solve, backend="daqp")  # the problems have many shapes, and each would be compiled

Array = NDArray[np.float64]

LIMITED_MODES: tuple[Mode, ...] = ("filter", "projected", "lexicographic")
SPAN = 1e9  # a box that does not bind
JUMP = 1.6


@dataclass
class Facts:
    """Largest value of each fact, and its limit (None: without a limit)."""

    bars: dict[str, float | None] = field(default_factory=dict)
    values: dict[str, float] = field(default_factory=dict)

    def largest(self, name: str, value: float, *, bar: float | None) -> None:
        """Store the largest value of a fact; a NaN is never replaced."""
        self.bars[name] = bar
        known = self.values.get(name, 0.0)
        self.values[name] = known if value <= known else value

    def count(self, name: str, happened: bool, *, bar: float | None) -> None:
        """Increase the count of a fact if it occurred."""
        self.bars[name] = bar
        self.values[name] = self.values.get(name, 0.0) + happened

    def report(self) -> bool:
        """Print the facts; return whether every limit holds."""
        print("| fact | worst | bar | |\n|---|---|---|---|")
        good = True
        for name, value in self.values.items():
            bar = self.bars[name]
            kept = bar is None or value <= bar
            good = good and kept
            print(f"| {name} | {value:.3g} | {'' if bar is None else f'{bar:g}'} | {'' if kept else 'FAILED'} |")
        return good


QUICK_LOOPS = ("references and bounds move", "Jacobians turn too, task 1 out of reach")


def main(arguments: Sequence[str]) -> int:
    """Run all parts; return the exit status."""
    parser = argparse.ArgumentParser(description="the four priority modes: exactness, cost, continuity")
    parser.add_argument("--quick", action="store_true", help="15 problems unless --n says otherwise")
    parser.add_argument("--n", type=int, help="random problems; 10,000 if not given")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    count = options.n if options.n is not None else 15 if options.quick else 10_000
    if count < 1 or options.seed < 0:
        parser.error("--n is at least 1, --seed at least 0")
    good = [
        without_limits(count, options.seed),
        with_limits(count, options.seed),
        strict_with_limits(count, options.seed),
        continuous(*(20, 32, QUICK_LOOPS) if options.quick else (2000, 2000, tuple(LOOPS))),
    ]
    prices(8 if options.quick else 500, options.seed)
    return 0 if all(good) else 1


def without_limits(count: int, seed: int) -> bool:
    """Compare the modes with the printed formula, a cascade of pseudo-inverses, and the theorem on commutators."""
    rng, facts = np.random.default_rng([seed, 1]), Facts()
    for _ in range(count):
        made = draw_levels(rng, most=8)
        problem, free = wide(made, span=SPAN), build_problem(made)
        printed = printed_law(made)
        size = 1.0 + float(np.abs(printed).max())
        gap = float(np.abs(reference(free, mode="nsb").v - printed).max()) / size
        facts.largest("`nsb` against (16) as printed, relative", gap, bar=1e-12)
        for mode in ("filter", "projected"):
            v = reference(problem, mode=mode).v
            name = f"`{mode}` against (16), rows that do not bind, relative"
            facts.largest(name, float(np.abs(v - printed).max()) / size, bar=1e-10)
        strict, v = svd_cascade(made), reference(problem, mode="lexicographic").v
        most = 1.0 + float(np.abs(strict).max())
        for level in made:
            gap = abs(level.residual(v) - level.residual(strict)) / most
            facts.largest("`lexicographic` residuals against pseudo-inverses, relative", gap, bar=1e-8)
        theorem(made, rng, facts)
    print(f"## {count} problems without limits: 1–8 levels of 1–4 rows, some deficient, doubled or zero\n")
    return facts.report()


def theorem(made: list[Level], rng: np.random.Generator, facts: Facts) -> None:
    """Check that NSB equals strict priority for every reference if and only if the commutators vanish."""
    said = bool((commutator_norms([level.J for level in made]) <= TOLERANCE).all())
    apart, size = 0.0, 1.0
    for _ in range(3):
        again = [Level(level.name, level.J, rng.normal(size=level.lower.size)) for level in made]
        one, other = printed_law(again), svd_cascade(again)
        size = max(size, float(np.abs(one).max()), float(np.abs(other).max()))
        apart = max(apart, float(np.abs(one - other).max()))
    differs = apart > 1e-9 * size
    facts.count("number where the commutators vanish", said, bar=None)
    facts.count("number of exceptions to: equal if and only if the commutators vanish", said == differs, bar=0)


def with_limits(count: int, seed: int) -> bool:
    """Check every mode by the optimality conditions on problems whose rows often contradict each other."""
    rng, facts = np.random.default_rng([seed, 2]), Facts()
    for k in range(count):
        problem = draw_problem(rng)
        if k % 2:
            problem = with_sets(problem, rng)
        for mode in LIMITED_MODES:
            got = reference(problem, mode=mode)
            facts.count(f"number of `{mode}` not finite, or only clamped", got.status == "clamped", bar=0)
            facts.largest(f"actuator row of `{mode}` missed", _missed(problem, got.v), bar=1e-9)
            facts.count(f"number of `{mode}` not certified optimal", not got.is_optimal(problem, 1e-6), bar=0)
        facts.count("number with rows that contradict each other", got.status not in ("optimal", "limited"), bar=None)
    print(f"\n## {count} problems with limits, half of them with set-based levels\n")
    return facts.report()


def _missed(problem: PriorityProblem, v: Array) -> float:
    """Return the largest violation of an actuator row of length 1."""
    hard = [row for row in problem.rows if row.kind == "actuator"]
    return max(max(row.lower - row.a @ v, row.a @ v - row.upper) / float(np.linalg.norm(row.a)) for row in hard)


def strict_with_limits(count: int, seed: int) -> bool:
    """Compare `lexicographic` with DAQP's hierarchical solver, on rows of length 1 with compatible limits and sets."""
    rng, facts = np.random.default_rng([seed, 3]), Facts()
    for _ in range(count):
        problem = inequality_problem(rng)
        got, other = reference(problem, mode="lexicographic"), daqp_hierarchy(problem)
        gaps = np.array([level.residual(got.v) - level.residual(other) for level in problem.levels])
        first = gaps[np.flatnonzero(np.abs(gaps) > 1e-8)[:1]]
        # a small violation of a row or a level above, within its tolerance, gives a large gain below
        taken = max(max(row.lower - row.a @ other, row.a @ other - row.upper) for row in problem.rows)
        taken = max(taken, -float(gaps.min(initial=0.0)))
        worse = first.size > 0 and first[0] > 0 and taken <= 1e-10
        facts.count("number where `lexicographic` is worse than DAQP", bool(worse), bar=0)
        facts.count("number where DAQP is worse, or outside the limits", first.size > 0 and not worse, bar=None)
        facts.count("number not certified optimal", not got.is_optimal(problem, 1e-6), bar=0)
    print(f"\n## {count} problems with limits and sets: `lexicographic` and DAQP's hierarchy, residuals within 1e-8\n")
    return facts.report()


def continuous(points: int, steps: int, loops: tuple[str, ...]) -> bool:
    """Print Lipschitz estimates along smooth loops at two resolutions, and the chatter on a barrier."""
    print(f"\n## Along smooth loops of problems: largest |Δv|/Δs with {points} and with {2 * points} points\n")
    print("| loop | answer | coarse | fine | |\n|---|---|---|---|---|")
    good = True
    for where in loops:
        for how in SETTINGS:
            coarse, fine = lipschitz(where, how, points)
            # a jump doubles the estimate when the step is halved
            jumps, may = fine > JUMP * coarse, (where, how) in MAY_JUMP
            good = good and (may or not jumps)
            word = "" if not jumps else "jumps" if may else "FAILED"
            print(f"| {where} | {how} | {coarse:.4g} | {fine:.4g} | {word} |")
    turns = {mode: chatter(mode, steps=steps) for mode in LIMITED_MODES}
    print("\nDriven against a round obstacle and along it, most reversals of Δv in a row: ", end="")
    print(", ".join(f"`{mode}` {number}" for mode, number in turns.items()) + " (bar 2)")
    return good and max(turns.values()) <= 2


def prices(count: int, seed: int) -> None:
    """Print the residual of each task in each mode, on the same problems."""
    rng = np.random.default_rng([seed, 4])
    problems = [four_tasks(rng) for _ in range(count)]
    print(f"\n## Median residual of tasks 1–4 over {count} problems: box, 4 barriers, 4 tasks of 1–2 rows\n")
    print("| mode | task 1 | task 2 | task 3 | task 4 | rows missed |\n|---|---|---|---|---|---|")
    answers: dict[str, Callable[[PriorityProblem], Array]] = {
        f"`{mode}`": lambda problem, mode=mode: reference(problem, mode=mode).v for mode in get_args(Mode)
    }
    answers["`projected`, λ = 0.1"] = lambda problem: reference(problem, damping=0.1).v
    for name, answer in answers.items():
        found = [answer(problem) for problem in problems]
        left = np.median(
            [[level.residual(v) for level in p.levels] for p, v in zip(problems, found, strict=True)], axis=0
        )
        missed = np.mean([_any_missed(p, v) for p, v in zip(problems, found, strict=True)])
        print(f"| {name} | {' | '.join(f'{value:.3f}' for value in left)} | {missed:.0%} |")


def four_tasks(rng: np.random.Generator) -> PriorityProblem:
    """Return tasks that sometimes need more than the box allows, and barriers that allow zero velocity."""
    tasks = []
    for i in range(4):
        J = np.array([unit(rng) for _ in range(rng.integers(1, 3))])
        tasks.append(Level(f"task{i + 1}", J, rng.normal(size=len(J))))
    rows = [Row(f"box{i}", "actuator", np.eye(4)[i], -1.5, 1.5) for i in range(4)]
    rows += [Row(f"wall{i}", "barrier", unit(rng), -np.inf, abs(rng.normal())) for i in range(4)]
    return build_problem(tasks, rows)


def _any_missed(problem: PriorityProblem, v: Array) -> bool:
    return any(max(row.lower - row.a @ v, row.a @ v - row.upper) > 1e-7 for row in problem.rows)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""The most operations and instructions of the priority kernel on problems that are hard for it, beside its bound.

The bound on the instructions is that on the operations, times the most instructions for an operation in any run.
Before, the operations that drawn problems need, and how many of them are unconfirmed within a budget.
"""

from __future__ import annotations

import argparse
import ast
import sys
from pathlib import Path
from typing import TypeAlias

import numpy as np
from draws import CLASSES, SIZES, Size, draw
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "18_export_benchmark"))

from alone import counted

from surctl.ir import compile_block
from surctl.ir.bound import spending
from surctl.ir.procedure import Procedure
from surctl.priority import PriorityProblem
from surctl.priority.hierarchy.kernel import hierarchy
from surctl.priority.shapes import StackShape
from surctl.priority.solver.fallback import CLAMPED

Array = NDArray[np.float64]
_Run: TypeAlias = tuple[float, float, list[Array]]  # operations, iterations, inputs

KERNELS = {"n = 7 above": SIZES[7], "Panda of study 45": Size(7, (3, 3, 7), 10)}
"""The kernel of the Panda has three levels and 19 limits: 7 joints and 12 barriers."""

DAMPING = np.array([0.05])
BUDGETS = (60_000, 70_000, 80_000)
SHARES = (50, 99, 99.9, 99.99, 100)


def counting(procedure: Procedure) -> Procedure:
    """Return the procedure with one more output, the number of operations that it has executed."""
    own = any(name == "spent" for name, _, _ in procedure.memory)
    tree = ast.parse(procedure.source if own else spending(procedure.source))
    last = tree.body[-1]
    assert isinstance(last, ast.FunctionDef)
    last.body += ast.parse("s.operations[0] = 1.0 * s.spent").body
    outputs = (*procedure.outputs, ("operations", 1))
    memory = procedure.memory if own else (*procedure.memory, ("spent", "whole", 0))
    source = "\n".join(map(ast.unparse, tree.body))
    return Procedure(procedure.name, procedure.inputs, outputs, procedure.sizes, memory, source)


def kernel_of(size: Size, *, damped: bool, budget: int | None = None) -> Procedure:
    """Return the kernel for problems of a size."""
    return hierarchy(StackShape(size.n, size.shapes), size.rows, damped=damped, budget=budget)


def hardest(size: Size, *, draws: int, moves: int) -> dict[bool, list[_Run]]:
    """Return, without and with damping, the 30 runs with the most operations, and 300 of the drawn problems.

    Three searches for each kernel begin with the hardest of their own drawn problems; a fourth of three times as many
    moves begins with the hardest of these, and of those of the other kernel.

    draws: problems of each class. moves: changes of the 30; a changed problem replaces the one with fewest operations.
    """
    runs = {damped: compile_block(counting(kernel_of(size, damped=damped))) for damped in (False, True)}

    def solved(damped: bool, inputs: list[Array]) -> _Run:
        inputs = [*inputs[:5], *([*inputs[5:], DAMPING][:1] if damped else [])]
        outputs = runs[damped](*inputs)
        return float(outputs[-1][0]), float(outputs[5][0]), inputs

    def harder(damped: bool, hard: list[_Run], moves: int, rng: np.random.Generator) -> list[_Run]:
        for _ in range(moves):
            hard = sorted({one[0]: one for one in hard}.values(), key=lambda one: -one[0])[:30]
            inputs, other = (hard[int(rng.integers(0, len(hard)))][2] for _ in range(2))
            hard.append(solved(damped, changed(inputs, other, size, rng)))
        return sorted(hard, key=lambda one: -one[0])[:30]

    some: dict[bool, list[_Run]] = {False: [], True: []}
    found: dict[bool, list[_Run]] = {False: [], True: []}
    for seed in range(3):
        problems = [
            inputs_of(draw(np.random.default_rng([seed, size.n, place, k]), size, kind), size)
            for place, kind in enumerate(CLASSES)
            for k in range(draws)
        ]
        for damped in runs:
            drawn = [solved(damped, inputs) for inputs in problems]
            some[damped] += drawn[:: max(1, len(drawn) // 100)]
            found[damped] += harder(damped, drawn, moves, np.random.default_rng([seed, size.n]))
    return {
        damped: [
            *harder(
                damped,
                [solved(damped, one[2]) for d in runs for one in found[d]],
                3 * moves,
                np.random.default_rng([3, size.n]),
            ),
            *some[damped],
        ]
        for damped in runs
    }


def inputs_of(problem: PriorityProblem, size: Size) -> list[Array]:
    """Return the inputs of the undamped kernel for a problem."""
    lower = np.concatenate([level.lower for level in problem.levels])
    upper = np.concatenate([level.lower if level.upper is None else level.upper for level in problem.levels])
    rows = np.tile([*np.zeros(size.n), -np.inf, np.inf, 0.0], (size.rows, 1))
    rows[: len(problem.rows)] = problem.table
    J = np.concatenate([level.J for level in problem.levels])
    return [J.ravel(), lower, upper, rows.ravel(), np.ravel(problem.box)]


def changed(inputs: list[Array], other: list[Array], size: Size, rng: np.random.Generator) -> list[Array]:
    """Return inputs with one to three rows of Jacobian or limits changed, or taken from another problem."""
    J, lower, upper, rows, *rest = (array.copy() for array in inputs)
    for _ in range(rng.integers(1, 4)):
        J_rows, limits, part = J.reshape(-1, size.n), rows.reshape(size.rows, -1), 10.0 ** rng.uniform(-12, 0)
        size_of = 0.3 * rng.normal()
        i, j = rng.integers(0, len(J_rows)), rng.integers(size.n, len(limits))
        match rng.integers(0, 8 + len(rest)):
            case 0:
                J_rows[i] = other[0].reshape(-1, size.n)[i]
            case 1:
                J_rows[i] = J_rows[rng.integers(0, len(J_rows))] + part * rng.normal(size=size.n)
            case 2:
                move = (1.0 + abs(lower[i])) * part * rng.normal()
                lower[i], upper[i] = lower[i] + move, upper[i] + move
            case 3:
                limits[j] = other[3].reshape(size.rows, -1)[j]
            case 4:
                limits[j, : size.n] = limits[rng.integers(0, len(limits)), : size.n] + part * rng.normal(size=size.n)
            case 5:
                limits[j, size.n : size.n + 2] += part * rng.normal()
            case 6:
                J_rows[i] = J_rows[i] * 10.0 ** rng.normal()
            case 7:  # levels above that fix nothing leave more to the search of those below
                J_rows[i] = 0.0
            case 8:
                lower, upper = (array * 10.0**size_of for array in (lower, upper))
            case 9:
                rest[-1] = rest[-1] * 10.0 ** rng.normal()
    return [J, lower, upper, rows, *rest]


def print_hardest(draws: int, moves: int) -> None:
    """Print the table of the hardest problems that are found, each without and with a budget."""
    print(
        "| kernel | damped | budget | iterations | operations: most found, bound, ratio "
        "| instructions: most found, bound, ratio |"
        "\n|---|---|---|---|---|---|"
    )
    for name, size in KERNELS.items():
        for damped, hard in hardest(size, draws=draws, moves=moves).items():
            records = tuple(np.array(part) for part in zip(*(inputs for _, _, inputs in hard), strict=True))
            for budget in (None, BUDGETS[-1]):
                kernel = kernel_of(size, damped=damped, budget=budget)
                outputs = compile_block(counting(kernel))(*records)
                _, counts = counted(kernel, records, target="cortex-m7", real="float64")
                operations, bound = outputs[-1][:, 0], kernel.operations
                dear = bound * float((counts / operations).max())
                cells = (
                    name, "yes" if damped else "no", f"{budget:,}" if budget else "", f"{outputs[5].max():.0f}",
                    f"{operations.max():,.0f}, {bound:,}, {bound / operations.max():.1f}",
                    f"{counts.max():,}, {dear:,.0f}, {dear / counts.max():.1f}",
                )  # fmt: skip
                print(f"| {' | '.join(cells)} |", flush=True)


def moving(inputs: list[Array], size: Size, rng: np.random.Generator) -> list[Array]:
    """Return the same problem for v − u, where u is up to half as large again as the box: v = 0 is outside of it."""
    J, lower, upper, rows, box, *rest = inputs
    u = rng.uniform(-1.5, 1.5, size.n) * box[size.n :]
    table, rates = rows.reshape(size.rows, -1).copy(), J.reshape(-1, size.n) @ u
    table[:, size.n : size.n + 2] += (table[:, : size.n] @ u)[:, None]
    return [J, lower + rates, upper + rates, table.ravel(), box + np.tile(u, 2), *rest]


def print_shares(draws: int) -> None:
    """Print how many operations the drawn problems need, and how many are unconfirmed within each budget."""
    shares = ", ".join(f"{share:g} %" for share in SHARES)
    budgets = " | ".join(f"{budget:,}" for budget in BUDGETS)
    print(
        f"| kernel | damped | problems | operations: {shares} | {budgets} |\n|---|---|---|---|{'---|' * len(BUDGETS)}"
    )
    for name, size in KERNELS.items():
        for damped in (False, True):
            runs = [compile_block(counting(kernel_of(size, damped=damped, budget=b))) for b in (None, *BUDGETS)]
            regular = ("plain", "saturated", "infeasible")
            for kinds, moved in ((regular, ""), (("degenerate",), ""), (("near_singular",), ""), (regular, ", moving")):
                found = []
                for kind in kinds:
                    for k in range(draws // 10 if moved else draws):
                        rng = np.random.default_rng([1, size.n, CLASSES.index(kind), k])
                        inputs = [*inputs_of(draw(rng, size, kind), size), *[DAMPING] * damped]
                        inputs = moving(inputs, size, rng) if moved else inputs
                        found.append([(out[-1][0], out[4][0]) for out in (run(*inputs) for run in runs)])
                table = np.array(found)
                most = ", ".join(f"{most:,.0f}" for most in np.percentile(table[:, 0, 0], SHARES))
                ended = " | ".join(f"{n:,}" for n in (table[:, 1:, 1] >= CLAMPED).sum(axis=0))
                cells = (name, "yes" if damped else "no", f"{len(table):,} {', '.join(kinds)}{moved}", most, ended)
                print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few problems")
    draws, moves, many = (50, 200, 50) if parser.parse_args().quick else (2000, 100_000, 20_000)
    print_shares(many)
    print_hardest(draws, moves)


if __name__ == "__main__":
    main()

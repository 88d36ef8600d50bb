"""The most operations and instructions of the priority kernel on problems that are hard for it, beside its bound.

The bound on the instructions is that on the operations, times the most instructions for an operation in any run.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
from draws import CLASSES, SIZES, Size, draw
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "18_export_benchmark"))

from alone import counted

from surctl.ir import compile_block
from surctl.ir.bound import operations_in
from surctl.ir.procedure import Procedure
from surctl.priority import PriorityProblem
from surctl.priority.hierarchy.kernel import hierarchy
from surctl.priority.shapes import StackShape

Array = NDArray[np.float64]
_Run: TypeAlias = tuple[float, float, list[Array]]  # operations, iterations, inputs

KERNELS = {"n = 7 above": SIZES[7], "Panda of study 45": Size(7, (3, 3, 7), 10)}
"""The kernel of the Panda has three levels and 19 limits: 7 joints and 12 barriers."""


def counting(procedure: Procedure) -> Procedure:
    """Return the procedure with one more output, the number of operations that it has executed."""
    names = {function.name: 0 for function in procedure.functions}
    tree = ast.parse(procedure.source)
    for function in tree.body:
        assert isinstance(function, ast.FunctionDef)
        function.body = _counted(function.body, names)
    last = tree.body[-1]
    assert isinstance(last, ast.FunctionDef)
    last.body = [*ast.parse("s.spent = 0").body, *last.body, *ast.parse("s.operations[0] = 1.0 * s.spent").body]
    source = "\n".join(map(ast.unparse, map(ast.fix_missing_locations, tree.body)))
    outputs, memory = (*procedure.outputs, ("operations", 1)), (*procedure.memory, ("spent", "whole", 0))
    return Procedure(procedure.name, procedure.inputs, outputs, procedure.sizes, memory, source)


def _counted(body: Sequence[ast.stmt], names: dict[str, int]) -> list[ast.stmt]:
    """Add to `s.spent` before each group of statements that are executed together."""
    lines, group, cost = [], [], 0
    for statement in body:
        group.append(statement)
        if isinstance(statement, ast.If | ast.For):
            cost += operations_in(statement.test) if isinstance(statement, ast.If) else 0
            lines += [*_spent(cost), *group]
            group, cost = [], 0
            statement.body = _counted(statement.body, names)
            statement.orelse = _counted(statement.orelse, names)
        else:
            cost += operations_in(statement)
    return [*lines, *_spent(cost), *group]


def _spent(cost: int) -> list[ast.stmt]:
    return ast.parse(f"s.spent += {cost}").body if cost else []


def kernel_of(size: Size, *, damped: bool) -> Procedure:
    """Return the kernel for problems of a size."""
    return hierarchy(StackShape(size.n, size.shapes), size.rows, damped=damped)


def hardest(size: Size, *, damped: bool, draws: int, moves: int, seed: int = 0) -> list[_Run]:
    """Return the 30 runs of the kernel with the most operations that were found, and 300 of the drawn problems.

    draws: problems of each class. moves: changes of the 30; a changed problem replaces the one with fewest operations.
    """
    run, rng = compile_block(counting(kernel_of(size, damped=damped))), np.random.default_rng([seed, size.n])
    hard: list[_Run] = []

    def add(inputs: list[Array]) -> None:
        outputs = run(*inputs)
        hard.append((float(outputs[-1][0]), float(outputs[5][0]), inputs))

    for place, kind in enumerate(CLASSES):
        for k in range(draws):
            add(inputs_of(draw(np.random.default_rng([seed, size.n, place, k]), size, kind), size, damped=damped))
    some = hard[:: max(1, len(hard) // 300)]
    for _ in range(moves):
        hard = sorted({one[0]: one for one in hard}.values(), key=lambda one: -one[0])[:30]
        inputs, other = (hard[int(rng.integers(0, len(hard)))][2] for _ in range(2))
        add(changed(inputs, other, size, rng))
    return [*sorted(hard, key=lambda one: -one[0])[:30], *some]


def inputs_of(problem: PriorityProblem, size: Size, *, damped: bool) -> list[Array]:
    """Return the inputs of the kernel for a problem."""
    lower = np.concatenate([level.lower for level in problem.levels])
    upper = np.concatenate([level.lower if level.upper is None else level.upper for level in problem.levels])
    rows = np.tile([*np.zeros(size.n), -np.inf, np.inf, 0.0], (size.rows, 1))
    rows[: len(problem.rows)] = problem.table
    J = np.concatenate([level.J for level in problem.levels])
    return [J.ravel(), lower, upper, rows.ravel(), np.ravel(problem.box), *[np.array([0.05])] * damped]


def changed(inputs: list[Array], other: list[Array], size: Size, rng: np.random.Generator) -> list[Array]:
    """Return inputs with one to three rows of Jacobian or limits changed, or taken from another problem."""
    J, lower, upper, rows, *rest = (array.copy() for array in inputs)
    for _ in range(rng.integers(1, 4)):
        J_rows, limits, part = J.reshape(-1, size.n), rows.reshape(size.rows, -1), 10.0 ** rng.uniform(-12, 0)
        size_of = 0.3 * rng.normal()
        i, j = rng.integers(0, len(J_rows)), rng.integers(size.n, len(limits))
        match rng.integers(0, 7 + len(rest)):
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
            case 7:
                lower, upper = (array * 10.0**size_of for array in (lower, upper))
            case 8:
                rest[-1] = rest[-1] * 10.0 ** rng.normal()
    return [J, lower, upper, rows, *rest]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few problems")
    draws, moves = (50, 200) if parser.parse_args().quick else (2000, 300_000)
    print(
        "| kernel | damped | iterations | operations: most found, bound, ratio "
        "| instructions: most found, bound, ratio |"
        "\n|---|---|---|---|---|"
    )
    for name, size in KERNELS.items():
        for damped in (False, True):
            kernel = kernel_of(size, damped=damped)
            searches = [hardest(size, damped=damped, draws=draws, moves=moves, seed=seed) for seed in range(3)]
            hard = max(searches, key=lambda runs: runs[0][0])
            records = tuple(np.array(part) for part in zip(*(inputs for _, _, inputs in hard), strict=True))
            _, counts = counted(kernel, records, target="cortex-m7", real="float64")
            operations, most = np.array([one[0] for one in hard]), kernel.operations
            dear = most * float((counts / operations).max())
            cells = (
                name, "yes" if damped else "no", f"{hard[0][1]:.0f}",
                f"{operations[0]:,.0f}, {most:,}, {most / operations[0]:.1f}",
                f"{counts.max():,}, {dear:,.0f}, {dear / counts.max():.1f}",
            )  # fmt: skip
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()

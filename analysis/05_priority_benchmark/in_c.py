"""The race inside C: this toolkit's emitted code against what CasADi and OSQP generate.

All are compiled with the same flags, for the machine at hand.

Each contender is a shared library with the same loop around it (`loop.h`); they are called in turns.
"""

from __future__ import annotations

import ctypes
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias, get_args

import casadi as ca
import daqp
import numpy as np
import osqp
from contender import Missing
from fast import sweep_block, sweep_function, tick_block
from instances import BOX, LEVELS, ROWS, Instance, N
from numpy.typing import NDArray
from scipy import sparse

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.ir import Block, compile_block
from surctl.ir.c99_routine import emit_block
from surctl.ir.cache import find_compiler, tuned_flags
from surctl.priority import Mode, nsb, safe_step, solve
from surctl.priority.solver.fallback import MET
from tests.oracles.distance_trials import Trials, draw_trials

__all__ = [
    "CASADI_CLOSED",
    "CLOSED",
    "LEAST",
    "OSQP",
    "OURS",
    "OURS_CLOSED",
    "OURS_TICKS",
    "QRQP",
    "TICKS",
    "CompiledRun",
    "compiled",
    "race_in_c",
]

Array: TypeAlias = NDArray[np.float64]

HERE = Path(__file__).parent
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-D_POSIX_C_SOURCE=199309L", "-shared", "-fPIC", f"-I{HERE}")

LEAST = "least distance: 2 equalities, 24 rows"
CLOSED = "closed form of nsb"
TICKS: dict[Mode, str] = {mode: f"complete step of {mode}: 4 tasks, box, 8 rows" for mode in get_args(Mode)}

OURS, OURS_CLOSED = "surctl safe step, C", "surctl closed form, C"
OURS_TICKS: dict[Mode, str] = {mode: f"surctl {mode} step, C" for mode in TICKS}
QRQP, CASADI_CLOSED = "CasADi qrqp, generated C", "CasADi closed form, generated C"
OSQP = {"OSQP, generated C, tolerance 1e-3 (its default)": 1e-3, "OSQP, generated C, tolerance 1e-6": 1e-6}

_EQUAL, _M = 2, 24
_PART = 3e5  # ns per batch: short, so that other programs interrupt few batches


@dataclass(eq=False)
class CompiledRun:
    """A contender in C.

    Attributes:
        name: in the tables. problem: `LEAST`, `CLOSED`, or one of `TICKS`.
        records: (count, size), what it is given.
        answers: (count, width); NaN where it gave up.
        parts: where the parts of the problems that are run in one go begin, and the end; repeats: of each.
        batches: ns a solve, for each round and each part of the problems, (rounds, parts).
        single: ns of single solves, the clock's own cost taken off, (rounds, count).
    """

    name: str
    problem: str
    library: Any
    records: Array
    width: int
    ours: bool = False
    answers: Array = field(init=False)
    parts: NDArray[np.intp] = field(init=False)
    repeats: int = field(init=False)
    batches: list[list[float]] = field(default_factory=list)
    single: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Solve all problems once, and store the time."""
        self.library.many.restype = ctypes.c_double
        self.library.many.argtypes = [*[ctypes.c_long] * 4, *[ctypes.c_void_p] * 3]
        self.records = np.ascontiguousarray(self.records)
        count = len(self.records)
        self._out = np.zeros((count, self.width))
        self.run(0, count)
        self.answers = self._out.copy()
        self.answers[np.isnan(self.answers).any(axis=1)] = np.nan
        whole = min(self.run(0, count) for _ in range(3)) * count
        self.parts = np.linspace(0, count, max(1, min(count, round(whole / _PART))) + 1).astype(int)
        self.repeats = max(1, round(0.5 * _PART / whole))

    def run(self, first: int, last: int, *, repeats: int = 1, ns: Array | None = None) -> float:
        """Return the time per solve of the problems first … last − 1 [ns]; if `ns` (last − first,) is given, store
        each time in it.
        """
        place = None if ns is None else ns.ctypes.data
        data, out = self.records[first:].ctypes.data, self._out[first:].ctypes.data
        return float(self.library.many(last - first, self.records.shape[1], self.width, repeats, data, out, place))

    def mean(self) -> float:
        """Return the time per solve [ns]: the mean over the parts of the median over the rounds."""
        sizes = np.diff(self.parts)
        return float(np.median(self.batches, axis=0) @ sizes / sizes.sum())


def compiled(
    instances: list[Instance], *, modes: Sequence[Mode], count: int, seed: int, folder: Path
) -> tuple[list[CompiledRun | Missing], dict[str, Array]]:
    """Build all contenders in `folder` and let them solve their problems once; return them, and the reference
    solutions by problem. The complete step is built in each of `modes`.
    """
    trials = _met(count, seed)
    problems = [instance.problem for instance in instances]
    references = {
        LEAST: _daqp(trials),
        CLOSED: np.array([nsb(problem) for problem in problems]),
    } | {
        name: np.array([solve(problem, mode=mode, backend="daqp").v for problem in problems])
        for mode, name in TICKS.items()
    }
    stacked = np.array([np.concatenate([i.J.reshape(-1), i.x]) for i in instances])
    box = np.tile(BOX.reshape(-1), (len(stacked), 1))
    ticks = np.hstack([stacked, np.array([i.x for i in instances]), np.array([_table(i) for i in instances]), box])
    records = np.concatenate(trials.arrays, axis=1)
    safe, closed = safe_step(N, _EQUAL, _M), sweep_block(N, LEVELS)
    found: list[CompiledRun | Missing] = [
        CompiledRun(OURS, LEAST, _ours(folder, safe), records, N, ours=True),
        CompiledRun(QRQP, LEAST, _qrqp(folder), _conic(trials), N),
    ]
    for name, eps in OSQP.items():
        try:
            found.append(CompiledRun(name, LEAST, _osqp(folder, trials, eps), _split(trials), N))
        except (RuntimeError, AssertionError, ImportError) as error:  # an OSQP built without code generation
            found.append(Missing(name, str(error).splitlines()[0]))
    found.append(CompiledRun(OURS_CLOSED, CLOSED, _ours(folder, closed), stacked, N, ours=True))
    found.append(CompiledRun(CASADI_CLOSED, CLOSED, _closed(folder), stacked, N))
    for mode in modes:
        whole = _ours(folder, tick_block(mode, N, LEVELS, N + ROWS))
        found.append(CompiledRun(OURS_TICKS[mode], TICKS[mode], whole, ticks, N, ours=True))
    return found, references


def race_in_c(runs: list[CompiledRun], *, rounds: int) -> None:
    """Run batches alternately, then single solves alternately."""
    clock = _clock_cost(runs[0])
    for _ in range(rounds):
        for run in runs:
            run.batches.append([run.run(a, b, repeats=run.repeats) for a, b in pairwise(run.parts)])
        for run in runs:
            ns = np.zeros(len(run.records))
            run.run(0, len(ns), ns=ns)
            run.single.append(np.maximum(ns - clock, 0.0))


def _clock_cost(run: CompiledRun) -> float:
    """Return the time that reading the clock adds to a single solve [ns], from single solves and the batch."""
    count = len(run.records)
    singles, batches = [], []
    for _ in range(20):
        ns = np.zeros(count)
        run.run(0, count, ns=ns)
        singles.append(ns.mean())
        batches.append(run.run(0, count))
    return max(0.0, float(np.median(singles) - np.median(batches)))


def _met(count: int, seed: int) -> Trials:
    """Return random problems that the first stage solves, as in study 3."""
    trials = draw_trials(2 * count + 50, n=N, p=_EQUAL, m=_M, seed=seed, mixed=False)
    status = compile_block(safe_step(N, _EQUAL, _M))(*trials.arrays)[4][:, 0]
    return trials[np.flatnonzero(status == MET)[:count]]


def _daqp(trials: Trials) -> Array:
    """Return the nearest points by DAQP at tight settings as reference."""
    A, lower, upper = _bounds(trials)
    sense = np.append(np.zeros(_M), np.full(_EQUAL, 5)).astype(np.intc)
    points = []
    for rows, low, high, goal in zip(A, lower, upper, trials.target, strict=True):
        v, _, flag, _ = daqp.solve(np.eye(N), -goal, rows, high, low, sense.copy(), primal_tol=1e-12)
        points.append(v if flag == 1 else np.full(N, np.nan))
    return np.array(points)


def _table(instance: Instance) -> Array:
    """Return the rows of the complete step: the box, then the others."""
    box = np.column_stack([np.eye(N), *BOX, np.zeros(N)])
    return np.vstack([box, instance.table]).reshape(-1)


def _bounds(trials: Trials) -> tuple[Array, Array, Array]:
    """Return A (count, m + p, n), lower and upper, with the equalities last."""
    rows = trials.rows.reshape(len(trials.rows), _M, N + 3)
    A = np.concatenate([rows[..., :N], trials.J.reshape(-1, _EQUAL, N)], axis=1)
    lower, upper = (np.concatenate([rows[..., k], trials.x], axis=1) for k in (N, N + 1))
    return A, np.maximum(lower, -1e30), np.minimum(upper, 1e30)


def _conic(trials: Trials) -> Array:
    """Return records for CasADi's conic: g, a by columns, lba, uba, lbx, ubx; the first n rows are the box."""
    A, lower, upper = _bounds(trials)
    a = np.swapaxes(A[:, N:], 1, 2).reshape(len(A), -1)
    return np.hstack([-trials.target, a, lower[:, N:], upper[:, N:], lower[:, :N], upper[:, :N]])


def _split(trials: Trials) -> Array:
    """Return records for OSQP: q, l, u, and the values of A by columns, with only the diagonal of the box rows."""
    A, lower, upper = _bounds(trials)
    kept = _pattern().astype(bool)
    return np.hstack([-trials.target, lower, upper, np.swapaxes(A, 1, 2)[:, kept.T]])


def _pattern() -> Array:
    return np.vstack([np.eye(N), np.ones((_M - N + _EQUAL, N))])


def _library(folder: Path, name: str, sources: list[Path], *flags: str) -> Any:
    path = folder / f"{name}.so"
    command = [
        *shlex.split(find_compiler()),
        *FLAGS,
        *tuned_flags(),
        *shlex.split(os.environ.get("SURCTL_CFLAGS", "")),
        *flags,
        "-o",
        str(path),
        *map(str, sources),
        "-lm",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{name} does not compile: {done.stderr[:2000]}")
    return ctypes.CDLL(str(path))


def _ours(folder: Path, block: Block) -> Any:
    sizes = [size for _, size in block.inputs]
    starts = np.cumsum([0, *sizes[:-1]])
    given = ", ".join(f"record + {start}" for start in starts)
    others = [f"static double out{k}[{size}];" for k, (_, size) in enumerate(block.outputs) if k]
    taken = ", ".join("answer" if k == 0 else f"out{k}" for k in range(len(block.outputs)))
    name = f"ours_{block.name}_{sum(sizes)}"
    source = folder / f"{name}.c"
    source.write_text(
        f"#include <math.h>\n{emit_block(block, symbol='block', vectors=True)}\n"
        f"static void one(const double *record, double *answer)\n"
        f'{{\n    {" ".join(others)}\n    block({given}, {taken});\n}}\n#include "loop.h"\n'
    )
    return _library(folder, name, [source])


def _casadi(folder: Path, function: ca.Function, sizes: list[int], *, unity: int) -> Any:
    name = function.name()
    generator = ca.CodeGenerator(f"{name}.c")
    generator.add(function)
    generator.generate(f"{folder}/")
    work = {"ARG": function.sz_arg(), "RES": function.sz_res(), "IW": function.sz_iw(), "W": function.sz_w()}
    units = ",".join("1" for _ in range(N))
    macros = {"GENERATED": f'"{name}.c"', "ENTRY": name, "INPUTS": ",".join(map(str, sizes)), "UNITY": str(unity)}
    macros |= {"WIDTH": str(N), "UNITS": units, **{f"SIZE_{what}": str(size) for what, size in work.items()}}
    flags = [f"-D{key}={value}" for key, value in macros.items()]
    return _library(folder, name, [HERE / "casadi_one.c"], f"-I{folder}", *flags)


def _qrqp(folder: Path) -> Any:
    dense = ca.Sparsity.dense(_M - N + _EQUAL, N)
    options = {"print_iter": False, "print_header": False, "print_info": False, "error_on_fail": False}
    function = ca.conic("qrqp_last", "qrqp", {"h": ca.Sparsity.diag(N), "a": dense}, options)
    rows = _M - N + _EQUAL
    return _casadi(folder, function, [N, rows * N, rows, rows, N, N], unity=0)


def _closed(folder: Path) -> Any:
    function = sweep_function(N, LEVELS)
    return _casadi(folder, function, [N * sum(LEVELS), sum(LEVELS)], unity=-1)


def _osqp(folder: Path, trials: Trials, eps: float) -> Any:
    A, lower, upper = _bounds(trials)
    pattern = sparse.csc_matrix(_pattern())
    solver = osqp.OSQP()
    settings = {"eps_abs": eps, "eps_rel": eps, "scaling": 0, "warm_starting": False, "verbose": False}
    solver.setup(sparse.eye(N, format="csc"), -trials.target[0], pattern, lower[0], upper[0], **settings)
    place = folder / f"osqp_{eps:.0e}"
    solver.codegen(str(place), parameters="matrices", extension_name=None, force_rewrite=True)
    sources = [*sorted((place / "src").glob("*.c")), *place.glob("*workspace.c"), HERE / "osqp_one.c"]
    macros = {"COLUMNS": N, "ROWS": A.shape[1], "ENTRIES": pattern.nnz}
    include = [f"-I{place / part}" for part in ("inc/public", "inc/private", ".")]
    return _library(folder, place.name, sources, *include, *(f"-D{key}={value}" for key, value in macros.items()))

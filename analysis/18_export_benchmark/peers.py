"""The least-distance problem of the step, solved by the generated C of OSQP and CasADi on the emulated Cortex-M4F."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np
import osqp
from alone import counted, counted_c
from cvxpygen_c import INSTALLED, by_cvxpygen
from numpy.typing import NDArray
from scipy import sparse

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.ir import compile_block
from surctl.priority import safe_step
from surctl.priority.solver.elimination import FLOAT32
from surctl.priority.solver.fallback import MET
from tests.oracles.distance_trials import Trials, draw_trials

__all__ = ["PROBLEM", "race"]

PROBLEM = "4 velocities, 2 equalities, 24 rows, all of which can be kept; solved is what is right to 1e-3"

Array = NDArray[np.float64]

_N, _P, _M = 4, 2, 24
_RIGHT = 1e-3  # relative to 1 + max |v|: a solution off by more counts as unsolved
_FLOATS = "".join(f"#define {word} {word}f\n" for word in ("sqrt", "fabs", "fmin", "fmax"))


def race(*, quick: bool) -> tuple[list[str], NDArray[np.int64], NDArray[np.int64]]:
    """Return lines of the README, and the instructions of the step with the exact and with the bounded fallback."""
    trials, exact = _met(40 if quick else 200)
    outputs, counts = counted(safe_step(_N, _P, _M, precision=FLOAT32), trials.arrays)
    cut, fewer = counted(safe_step(_N, _P, _M, precision=FLOAT32, fallback="bounded"), trials.arrays)
    lines = [
        "| solver | instructions, min / mean / max | solved | error of 95 % of those |",
        "|---|---|---|---|",
        _line("surctl, the step with exact fallback", outputs[0], counts, exact),
        _line("surctl, the step with bounded fallback", cut[0], fewer, exact),
        *(
            _line(f"OSQP {osqp.__version__}, generated, tolerance {eps:g}", *_osqp(trials, eps), exact)
            for eps in (1e-3, 1e-5)
        ),
        *_cvxpygen(trials, exact),
        _line("CasADi qrqp, generated, tolerance 1e-5", *_qrqp(trials), exact),
    ]
    return lines, counts, fewer


def _cvxpygen(trials: Trials, exact: Array) -> list[str]:
    names = {
        True: "CVXPYgen with OSQP, tolerance 0.001, made float",
        False: "CVXPYgen with OSQP, tolerance 0.001, double",
    }
    if not INSTALLED:
        return [f"| {name} | not installed (pip install cvxpygen) | | |" for name in names.values()]
    return [_line(name, *by_cvxpygen(trials, 1e-3, _N, _P, _M, floats=floats), exact) for floats, name in names.items()]


def _line(name: str, v: NDArray[np.float32], counts: NDArray[np.int64], exact: Array) -> str:
    off = np.abs(v - exact).max(axis=1) / (1 + np.abs(exact).max(axis=1))
    right = off <= _RIGHT  # not for a NaN
    error = f"{np.quantile(off[right], 0.95):.0e}" if right.any() else ""
    return f"| {name} | {counts.min()} / {counts.mean():.0f} / {counts.max()} | {right.mean():.1%} | {error} |"


def _met(count: int) -> tuple[Trials, Array]:
    """Return random problems with compatible task and rows, and their solutions in double."""
    trials = draw_trials(3 * count + 50, n=_N, p=_P, m=_M, seed=0, mixed=False)
    v, *_, status, _ = compile_block(safe_step(_N, _P, _M))(*trials.arrays)
    chosen = np.flatnonzero(status[:, 0] == MET)[:count]
    return trials[chosen], v[chosen]


def _bounds(trials: Trials) -> tuple[Array, Array, Array]:
    """Return A (count, m + p, n), lower and upper, with the equalities last."""
    rows = trials.rows.reshape(len(trials.rows), _M, _N + 3)
    A = np.concatenate([rows[..., :_N], trials.J.reshape(-1, _P, _N)], axis=1)
    lower, upper = (np.concatenate([rows[..., k], trials.x], axis=1) for k in (_N, _N + 1))
    return A, np.maximum(lower, -1e30), np.minimum(upper, 1e30)


def _osqp(trials: Trials, eps: float) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    A, lower, upper = _bounds(trials)
    pattern = sparse.csc_matrix(np.ones(A.shape[1:]))
    settings = {"eps_abs": eps, "eps_rel": eps, "scaling": 0, "warm_starting": False, "verbose": False}
    solver = osqp.OSQP()
    solver.setup(sparse.eye(_N, format="csc"), -trials.target[0], pattern, lower[0], upper[0], **settings)
    text = f"""
#include <math.h>
#include "osqp.h"
#include "workspace.h"
static void one(const float *record, float *answer)
{{
    const float *l = record + {_N}, *u = l + {_M + _P}, *values = u + {_M + _P};
    const int bad = osqp_update_data_vec(&solver, record, l, u)
        || osqp_update_data_mat(&solver, 0, 0, 0, values, 0, {pattern.nnz}) || osqp_solve(&solver);
    const int solved = !bad && solver.info->status_val == OSQP_SOLVED;
    for (int i = 0; i < {_N}; ++i) {{ answer[i] = solved ? solver.solution->x[i] : NAN; }}
}}
"""
    records = np.hstack([-trials.target, lower, upper, np.swapaxes(A, 1, 2).reshape(len(A), -1)])
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch, "osqp")
        solver.codegen(str(place), parameters="matrices", extension_name=None, force_rewrite=True, use_float=True)
        sources = [*sorted((place / "src").glob("*.c")), *place.glob("*workspace.c")]
        include = [f"-I{place / part}" for part in ("inc/public", "inc/private", ".")]
        return counted_c(text, records, _N, sources=sources, flags=include)


def _qrqp(trials: Trials) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    A, lower, upper = _bounds(trials)
    rows = _M - _N + _P
    # in floats it seldom converges after many iterations, so not its default of 1000
    options = {"constr_viol_tol": 1e-5, "dual_inf_tol": 1e-5, "max_iter": 100, "error_on_fail": False}
    options |= {f"print_{what}": False for what in ("iter", "header", "info")}
    function = ca.conic("generated", "qrqp", {"h": ca.Sparsity.diag(_N), "a": ca.Sparsity.dense(rows, _N)}, options)
    generator = ca.CodeGenerator("generated", {"casadi_real": "float", "casadi_int": "int"})
    generator.add(function)
    places = np.cumsum([0, _N, rows * _N, rows, rows, _N, _N])
    given = ", ".join(f"record + {at}" for at in places[:-1])
    text = f"""
#include <math.h>
{_FLOATS}{generator.dump()}
static void one(const float *record, float *answer)
{{
    static const float ones[{_N}] = {{ {", ".join(["1"] * _N)} }};
    static int iw[{function.sz_iw() + 1}];
    static float w[{function.sz_w() + 1}];
    const float *arg[{function.sz_arg() + 1}] = {{ ones, {given} }};
    float *res[{function.sz_res() + 1}] = {{ answer }};
    if (generated(arg, res, iw, w, 0)) {{ answer[0] = NAN; }}
}}
"""
    a = np.swapaxes(A[:, _N:], 1, 2).reshape(len(A), -1)
    records = np.hstack([-trials.target, a, lower[:, _N:], upper[:, _N:], lower[:, :_N], upper[:, :_N]])
    return counted_c(text, records, _N)

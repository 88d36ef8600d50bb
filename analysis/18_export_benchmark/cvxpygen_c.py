"""CVXPYgen's C around OSQP for the problem of `peers`, prepared for the emulated Cortex-M4F."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import sys
import tempfile
from pathlib import Path

import numpy as np
from alone import counted_c
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from tests.oracles.distance_trials import Trials

__all__ = ["INSTALLED", "by_cvxpygen"]

Array = NDArray[np.float64]

INSTALLED = importlib.util.find_spec("cvxpygen") is not None

_FLOATS = {  # CVXPYgen writes only doubles; OSQP's own C supports both
    "c/include/cpg_workspace.h": ("typedef double cpg_float", "typedef float cpg_float"),
    "c/solver_code/osqp_configure.h": (
        "#define OSQP_EMBEDDED_MODE",
        "#define OSQP_USE_FLOAT\n#define OSQP_EMBEDDED_MODE",
    ),
}


def by_cvxpygen(
    trials: Trials, eps: float, n: int, p: int, m: int, *, floats: bool
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """(answers (N, n), instructions (N,)); NaN where OSQP says that it has not solved it.

    Args:
        trials: problems of n velocities, p equalities and m rows.
        eps: absolute and relative tolerance.
        floats: in float, by two lines of its C changed; else as it is written, in double.
    """
    import cvxpy as cp
    from cvxpygen import cpg

    rows = trials.rows.reshape(len(trials.rows), m, n + 3)
    values = {
        "t": trials.target,
        "G": np.swapaxes(rows[..., :n], 1, 2).reshape(len(rows), -1),
        "gl": np.maximum(rows[..., n], -1e3),
        "gu": np.minimum(rows[..., n + 1], 1e3),
        "J": np.swapaxes(trials.J.reshape(-1, p, n), 1, 2).reshape(len(rows), -1),
        "x": trials.x,
    }
    shapes = {"t": n, "G": (m, n), "gl": m, "gu": m, "J": (p, n), "x": p}
    given = {name: cp.Parameter(shape, name=name) for name, shape in shapes.items()}
    for name, parameter in given.items():
        parameter.value = values[name][0].reshape(parameter.shape, order="F")
    v = cp.Variable(n, name="v")
    kept = [given["gl"] <= given["G"] @ v, given["G"] @ v <= given["gu"], given["J"] @ v == given["x"]]
    problem = cp.Problem(cp.Minimize(0.5 * cp.sum_squares(v) - given["t"] @ v), kept)
    places = np.cumsum([0, *(part.shape[1] for part in values.values())])
    updates = "\n    ".join(
        f"for (int i = 0; i < {part.shape[1]}; ++i) {{ cpg_update_{name}(i, record[{at} + i]); }}"
        for (name, part), at in zip(values.items(), places[:-1], strict=True)
    )
    text = f"""
#include <math.h>
#include "cpg_solve.h"
static void one(const float *record, float *answer)
{{
    {updates}
    cpg_set_solver_eps_abs({eps:g});
    cpg_set_solver_eps_rel({eps:g});
    cpg_set_solver_warm_starting(0);
    cpg_solve();
    const int solved = solver.info->status_val == OSQP_SOLVED;
    for (int i = 0; i < {n}; ++i) {{ answer[i] = solved ? (float)CPG_Result.prim->v[i] : NAN; }}
}}
"""
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch, "cvxpygen")
        with contextlib.redirect_stdout(io.StringIO()):
            cpg.generate_code(
                problem, code_dir=str(place), solver="OSQP", solver_opts={"verbose": False}, wrapper=False
            )
        for name, (old, new) in _FLOATS.items() if floats else ():
            written = (place / name).read_text()
            if old not in written:
                raise RuntimeError(f"{name} of this version of CVXPYgen has no {old!r}")
            (place / name).write_text(written.replace(old, new))
        solver = place / "c" / "solver_code"
        sources = [place / "c/src/cpg_solve.c", place / "c/src/cpg_workspace.c", solver / "workspace.c"]
        sources += sorted((solver / "src").glob("*.c"))
        parts = (place / "c/include", solver, solver / "inc/public", solver / "inc/private")
        return counted_c(text, np.hstack(list(values.values())), n, sources=sources, flags=[f"-I{d}" for d in parts])

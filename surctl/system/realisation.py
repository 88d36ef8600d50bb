"""A state space of a transfer function with several inputs and outputs (python-control needs slycot for it)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["state_space"]

Array = NDArray[np.float64]

_RANK = 1e-12  # smaller singular values of columns of length 1 are rounding


def state_space(system: Any) -> Any:
    """Return the `control.StateSpace` of a linear system, minimal up to rounding for a matrix of transfer functions.

    Each column of the matrix gives one controllable canonical form for each of its denominators (Kailath 1980, section
    6.4). States that no input moves or that no output shows are removed, since a controller could not stabilise them.

    Args:
        system: `control.StateSpace` or `control.TransferFunction`.

    Raises:
        TypeError, ValueError: the system is not proper or not real.

    Example:
        >>> import control
        >>> from surctl.system.realisation import state_space
        >>> s = control.tf("s")
        >>> both = control.combine_tf([[1 / s, 2 / s], [1 / (s + 1), 0]])
        >>> sorted(state_space(both).poles().real.round(6).tolist())
        [-1.0, 0.0]
    """
    import control  # takes seconds to import
    from scipy.linalg import block_diag, matrix_balance

    if not isinstance(system, control.TransferFunction) or control.issiso(system):
        return control.ss(system)
    forms: list[tuple[Array, Array, Array]] = []
    D = np.zeros((system.noutputs, system.ninputs))
    for j in range(system.ninputs):
        columns: dict[tuple[float, ...], dict[int, Array]] = {}  # numerators by denominator and row
        for i in range(system.noutputs):
            den, num = (np.trim_zeros(np.asarray(part[i][j], dtype=float), "f") for part in (system.den, system.num))
            if len(num) > len(den):
                raise ValueError("transfer function is not proper")
            padded = np.concatenate([np.zeros(len(den) - len(num)), num])
            columns.setdefault(tuple((den / den[0]).tolist()), {})[i] = padded / den[0]
        for denominator, rows in columns.items():
            a, order = np.array(denominator[1:]), len(denominator) - 1
            B, C = np.zeros((order, system.ninputs)), np.zeros((system.noutputs, order))
            B[:1, j] = 1.0
            for i, numerator in rows.items():
                C[i], D[i, j] = numerator[1:] - numerator[0] * a, numerator[0]
            forms.append((np.vstack([-a, np.eye(order)[:-1]])[:order], B, C))
    A, B, C = block_diag(*(f[0] for f in forms)), np.vstack([f[1] for f in forms]), np.hstack([f[2] for f in forms])
    A, T = matrix_balance(A)
    A, B, C = _reached(A, np.linalg.solve(T, B), C @ T)
    A, C, B = (m.T for m in _reached(A.T, C.T, B.T))  # the states that the outputs show
    names = {"inputs": system.input_labels, "outputs": system.output_labels, "name": system.name}
    return control.ss(A, B, C, D, system.dt, **names)


def _reached(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    # restricted to the smallest subspace that has the columns of B and is invariant under A
    size, step = np.linalg.norm(B, axis=0), A / max(float(np.linalg.norm(A)), np.finfo(float).tiny)
    basis = _range(B[:, size > 0] / size[size > 0])
    while (larger := _range(np.hstack([basis, step @ basis]))).shape[1] > basis.shape[1]:
        basis = larger
    return basis.T @ A @ basis, basis.T @ B, C @ basis


def _range(matrix: Array) -> Array:
    # an orthonormal basis of the span of columns of length 1, or less where they matter less
    left, values, _ = np.linalg.svd(matrix, full_matrices=False)
    return left[:, values > _RANK]

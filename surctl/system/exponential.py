"""The matrix exponential in NumPy: importing it from SciPy takes longer than many commands of surctl."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["expm"]

Array = NDArray[np.float64]

# coefficients of the Padé approximant of degree 13, and the largest 1-norm at which it has full precision
_PADE = (
    *(64764752532480000.0, 32382376266240000.0, 7771770303897600.0, 1187353796428800.0, 129060195264000.0),
    *(10559470521600.0, 670442572800.0, 33522128640.0, 1323241920.0, 40840800.0, 960960.0, 16380.0, 182.0, 1.0),
)
_LARGEST = 5.371920351148152


def expm(matrices: Array) -> Array:
    """Return the exponential of each matrix (…, n, n), by scaling and squaring (Higham 2005).

    A matrix that contains NaN gives NaN.
    """
    A = np.asarray(matrices, dtype=float)
    norm = np.abs(A).sum(axis=-2).max(axis=-1, initial=0.0)
    halvings = np.maximum(np.frexp(norm / _LARGEST)[1], 0)
    A = A * np.ldexp(1.0, -halvings)[..., None, None]
    b, one, A2 = _PADE, np.eye(A.shape[-1]), A @ A
    A4 = A2 @ A2
    A6 = A2 @ A4
    odd = A @ (A6 @ (b[13] * A6 + b[11] * A4 + b[9] * A2) + b[7] * A6 + b[5] * A4 + b[3] * A2 + b[1] * one)
    even = A6 @ (b[12] * A6 + b[10] * A4 + b[8] * A2) + b[6] * A6 + b[4] * A4 + b[2] * A2 + b[0] * one
    grown: Array = np.linalg.solve(even - odd, even + odd)
    for done in range(int(halvings.max(initial=0))):
        again = halvings > done
        grown = np.where(again[..., None, None], grown @ grown, grown)
    return grown

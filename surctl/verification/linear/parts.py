"""Independent parts of linear loops, each computed once: the axes of a vehicle, and corners that differ elsewhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

__all__ = ["blockwise", "distinct", "eigenvalues", "independent"]


def independent(coupled: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Return the indices of a square pattern (n, n) in groups; entries outside of the groups' blocks are False."""
    reached = coupled | coupled.T | np.eye(len(coupled), dtype=bool)
    while (further := reached @ reached).sum() > reached.sum():
        reached = further
    return [np.flatnonzero(group) for group in np.unique(reached, axis=0)]


def distinct(*matrices: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where each distinct one of k tuples of matrices (k, …) occurs first, and which of these each equals."""
    rows = np.concatenate([m.reshape(len(m), -1) for m in matrices], axis=1) + 0.0  # no negative zeros
    known: dict[bytes, int] = {}
    first, which = np.unique([known.setdefault(row.tobytes(), k) for k, row in enumerate(rows)], return_inverse=True)
    return first, which


def eigenvalues(matrices: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the eigenvalues (k, n) of k matrices (k, n, n), in no order."""
    values = np.empty(matrices.shape[:2], dtype=complex)
    for group in independent((matrices != 0).any(axis=0)):
        block = matrices[:, group[:, None], group]
        first, which = distinct(block)
        values[:, group] = np.linalg.eigvals(block[first])[which]
    return values


def blockwise(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]], matrices: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a matrix function, such as the exponential, of k matrices (k, n, n) from those of their blocks."""
    values = np.zeros_like(matrices)
    for group in independent((matrices != 0).any(axis=0)):
        block = matrices[:, group[:, None], group]
        first, which = distinct(block)
        values[:, group[:, None], group] = function(block[first])[which]
    return values

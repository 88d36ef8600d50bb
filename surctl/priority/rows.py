"""Sizes that the routines of the ladder share, and the routines that several of them call."""

from __future__ import annotations

from surctl.priority.dual_step import Space
from surctl.priority.kernel import certificate, kernel

__all__ = ["SHORT", "Sizes"]

SHORT = 1e-15
"""Length up to which a row counts as a row of zeros."""


class Sizes:
    """n velocities, p task rows, m rows; the routines of the ladder share them.

    Attributes:
        general: v free in n directions. fast: in n − p, after p independent task rows (None if p ≥ n).
        rows: entries of all rows.
        general_kernel, certificate: of `kernel`, in the general space.
    """

    def __init__(self, n: int, p: int, m: int) -> None:
        self.n, self.p, self.m = n, p, m
        self.general = Space(n, n)
        self.fast = Space(n, n - p) if p < n else None
        self.rows = m * self.general.row
        self.general_kernel = kernel(self.general, m)
        self.certificate = certificate(self.general, m)

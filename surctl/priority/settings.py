"""Settings of the priority law: mode, damping and fallback, and which do not go together."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, check_known

CUTOFF = 1e-10
"""Singular values of a Jacobian J, or of J restricted to the null space of higher levels, below CUTOFF·‖J‖ count as
0."""

ZERO_ROW = 1e-15
"""A row, or a Jacobian, smaller than this counts as zero."""


def negligible(largest: ArrayLike) -> NDArray[np.float64]:
    """Return the size up to which singular values count as 0, for the largest one of the Jacobian (...)."""
    return np.maximum(CUTOFF * np.asarray(largest, dtype=float), ZERO_ROW)


Mode: TypeAlias = Literal["nsb", "filter", "projected", "lexicographic"]
"""nsb: the NSB law, equation (16) of the paper, without limits. filter: the velocity within the limits that is nearest
to that of nsb. projected: equation (16) with the projection on the first task restricted to the limits. lexicographic:
strict priority within the limits."""

Fallback: TypeAlias = Literal["exact", "bounded"]
"""What a compiled step does if task and limits are incompatible. exact: compute the optimum at any cost. bounded:
compute, at constant cost, a velocity that violates the limits no more than the better of two: the target clipped to the
velocity bounds, and 0."""

_BOUNDED: tuple[Mode, ...] = ("filter", "projected")

_LEAST_DAMPING = 1e-6


@dataclass(frozen=True)
class Settings:
    """Settings of the priority law that `solve` applies to a problem.

    Attributes:
        mode: the priority law; see `Mode`.
        damping: λ [unit of the Jacobian J], at least 1e-6, or 0 for no damping. With damping, every projection of a
            velocity w on a level J v = x becomes min λ²‖z − w‖² + ‖J z − x‖² over z. This is equation (16) with the
            damped inverse Jᵀ(JJᵀ + λ²I)⁻¹ in place of every pseudo-inverse. Must be 0 in mode lexicographic.

    Raises:
        InputError: an unknown mode, or a number out of range.
    """

    mode: Mode = "projected"
    damping: float = 0.0

    def __post_init__(self) -> None:
        """Check that each setting is in its range and that the mode uses it."""
        check_known(self.mode, get_args(Mode), "no such priority mode", key="mode")
        if not isinstance(self.damping, float | int | np.floating | np.integer) or isinstance(self.damping, bool):
            raise InputError(
                "is not a number", key="damping", value=self.damping, remedy="give a number, or leave it out"
            )
        if self.damping != 0.0 and not _LEAST_DAMPING <= self.damping < math.inf:
            raise InputError(
                "is out of range", key="damping", value=self.damping, remedy=f"give 0, or {_LEAST_DAMPING:g} and more"
            )
        if self.mode == "lexicographic" and self.damping != 0.0:
            raise InputError(
                "applies to the projections of the NSB law, and mode lexicographic makes none",
                key="damping",
                value=self.damping,
                remedy="leave it out, or use mode projected",
            )


def check_fallback(fallback: str, *, mode: str, damping: float = 0.0) -> None:
    """Raise an InputError if the fallback is unknown or the mode does not support the fallback.

    Example:
        >>> from surctl.priority import check_fallback
        >>> check_fallback("bounded", mode="projected")  # valid: no error
        >>> check_fallback("bounded", mode="nsb")
        Traceback (most recent call last):
            ...
        surctl.errors.InputError: fallback = 'bounded': mode nsb has none; use mode filter or projected
    """
    check_known(fallback, get_args(Fallback), key="fallback")
    if fallback != "exact" and (mode not in _BOUNDED or damping != 0.0):
        problem = f"mode {mode} has none" if mode not in _BOUNDED else "cannot be combined with damping"
        remedy = f"use mode {' or '.join(_BOUNDED)}" if mode not in _BOUNDED else "leave the damping out"
        raise InputError(problem, key="fallback", value=fallback, remedy=remedy)

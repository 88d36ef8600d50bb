"""The statement of an inequality with exact numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.verification.formula.node import Node

__all__ = ["Statement"]


@dataclass(frozen=True, eq=False)
class Statement:
    """The statement left ≤ right on the part of a box where no constraint is positive.

    Attributes:
        names: names of the n variables.
        lower: lower bounds (n,).
        upper: upper bounds (n,).
        left: expression of the left side.
        right: expression of the right side.
        constraints: expressions of the constraints.
        touching: values of variables for which left = right, if known; a proof needs them.
    """

    names: tuple[str, ...]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    left: Node
    right: Node
    constraints: tuple[Node, ...]
    touching: Mapping[str, Fraction] = field(default_factory=dict)

    @property
    def parts(self) -> tuple[Node, ...]:
        """All expressions of the statement: left, right and the constraints."""
        return (self.left, self.right, *self.constraints)

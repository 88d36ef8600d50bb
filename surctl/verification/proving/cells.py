"""Reconstruct the boxes of an interval certificate from its tree of bisections."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.verification.proving.rules import middle
from surctl.verification.proving.search import DIMENSIONS

__all__ = ["Cells", "cells_of"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cells:
    """The proved boxes of one case of a claim.

    Attributes:
        names: names of the n variables.
        lower, upper: (n, k) bounds of the k boxes.
        rules: for each box, the letter of the rule that proves it; "s" if sums of squares prove the whole case.
        choice: the branches that the case takes, one for each min, max, abs and select; empty if the claim has only one
            case.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    rules: tuple[str, ...]
    choice: str


def cells_of(certificate: Mapping[str, Any]) -> tuple[Cells, ...]:
    """Return the boxes of a certificate of kind `interval`, one `Cells` object for each case of the claim.

    Raises:
        InputError: the certificate is of another kind.
    """
    if certificate.get("kind") != "interval":
        raise InputError(
            "has no cells", key="certificate", value=certificate.get("kind"), remedy="give an interval certificate"
        )
    variables = certificate["claim"]["variables"]
    names = tuple(v["name"] for v in variables)
    root = (
        np.array([v["lower"] for v in variables], dtype=float),
        np.array([v["upper"] for v in variables], dtype=float),
    )
    return tuple(_cells(names, root, case) for case in certificate["cases"])


def _cells(names: tuple[str, ...], root: tuple[Array, Array], case: Mapping[str, Any]) -> Cells:
    stack, low, high, rules = [root], [], [], []
    for letter in case.get("tree", "s"):
        lower, upper = stack.pop()
        if letter not in DIMENSIONS:
            low.append(lower)
            high.append(upper)
            rules.append(letter)
            continue
        k = DIMENSIONS.index(letter)
        # search and checker bisect at 0 if the interval contains it, otherwise in the middle
        at = 0.0 if lower[k] < 0 < upper[k] else float(middle(lower[k : k + 1], upper[k : k + 1])[0])
        first, second = upper.copy(), lower.copy()
        first[k], second[k] = at, at
        stack += [(second, upper), (lower, first)]
    return Cells(names, np.array(low).T, np.array(high).T, tuple(rules), str(case["choice"]))

"""The boxes of an interval certificate, read back from its tree of halvings."""

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
    """The settled boxes of one case of a claim.

    Attributes:
        names: of the variables.
        lower, upper: (n, k) ends of the k boxes.
        rules: the letter of the rule that settled each.
        choice: which side of its branches the case is about; empty where there is one case.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    rules: tuple[str, ...]
    choice: str


def cells_of(certificate: Mapping[str, Any]) -> tuple[Cells, ...]:
    """The boxes of a certificate of kind `interval`, one `Cells` a case.

    Raises:
        InputError: a certificate of another kind.
    """
    if certificate.get("kind") != "interval":
        raise InputError(
            "has no cells", key="certificate", value=certificate.get("kind"), remedy="give an interval one"
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
    for letter in case["tree"]:
        lower, upper = stack.pop()
        if letter not in DIMENSIONS:
            low.append(lower)
            high.append(upper)
            rules.append(letter)
            continue
        k = DIMENSIONS.index(letter)
        # as the search and the checker halve: at 0 where it lies inside
        at = 0.0 if lower[k] < 0 < upper[k] else float(middle(lower[k : k + 1], upper[k : k + 1])[0])
        first, second = upper.copy(), lower.copy()
        first[k], second[k] = at, at
        stack += [(second, upper), (lower, first)]
    return Cells(names, np.array(low).T, np.array(high).T, tuple(rules), str(case["choice"]))

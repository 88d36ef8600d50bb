"""Test vectors inside the exported source: a short run of the law with perturbed inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable
from surctl.export.envelope import Envelope
from surctl.ir import Real

__all__ = ["TOLERANCE", "SelfTest", "self_test_vectors"]

Vector = NDArray[np.float64]

TOLERANCE: Mapping[Real, float] = MappingProxyType({"float64": 1e-9, "float32": 1e-5})
"""Largest difference, relative or absolute, that the exported self-test accepts, by precision.

Doubles are stored with 12 digits. Floats are stored exactly, but a processor may compute in a wider format.
"""

_SPREADS = (0.0, 0.1, 0.5, 1.0, 1.0, 2.0)  # perturbation of each step; a wide one also switches flags on
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class SelfTest:
    """Inputs and expected results of the self-test, a run of the law from its initial state.

    Attributes:
        inputs: inputs of each step (T, nu).
        tau: expected thrust (T, n_tau) [N, N m].
        state: expected state after each step (T, nx).
        status: expected status of each step (T,).
    """

    inputs: Vector
    tau: Vector
    state: Vector
    status: tuple[int, ...]


def self_test_vectors(law: Exportable, gains: Vector, within: Envelope) -> SelfTest:
    """Run `law` for one step on default inputs, then on perturbed inputs; return inputs and results as a `SelfTest`.

    The perturbation is a low-discrepancy sequence of ±0.1 to ±2 times 1 + |default|, so nothing is random. Expected
    values are rounded to 12 digits, so that the bundle does not depend on the last bits of the machine's sine function.
    Inputs are rounded to 6 digits to be short, and limited to the accepted ranges, so that the input check accepts
    every step.
    """
    default = law.inputs.pack()
    inputs = np.array([_perturbed(default, k, spread) for k, spread in enumerate(_SPREADS)])
    inputs = np.clip(inputs, within.inputs[:, 0], within.inputs[:, 1])
    x, rows = law.initial_state(), []
    for u in inputs:
        step = law.step(x, u, gains)
        rows.append(step)
        x = step.x_next
    return SelfTest(
        inputs,
        np.array([_rounded(s.tau) for s in rows]),
        np.array([_rounded(s.x_next) for s in rows]),
        tuple(int(s.status) for s in rows),
    )


def _perturbed(default: Vector, k: int, spread: float) -> Vector:
    phase = (np.arange(default.size) + 1 + k * default.size) * _GOLDEN
    offset = 2.0 * (phase - np.floor(phase)) - 1.0
    return _rounded(default + spread * (1.0 + np.abs(default)) * offset, digits=6)


def _rounded(values: Vector, digits: int = 12) -> Vector:
    return np.array([float(f"{v:.{digits - 1}e}") for v in values], dtype=float)

"""Seeded random numbers of a run, identical in CasADi and C, and independent of those of all other runs.

The generator is MRG32k3a (L'Ecuyer 1999, "Good parameters and implementations for combined multiple recursive random
number generators"); its arithmetic is exact in double precision. Each seed selects a stream; two streams start at
least 2^127 draws apart (L'Ecuyer, Simard, Chen and Kelton 2002). The method of Box and Muller turns two uniform numbers
into two standard normal numbers.
"""

from __future__ import annotations

from functools import cache
from math import log, pi, sqrt

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError

__all__ = ["NOISE_STATE", "draw_normals", "draw_uniforms", "noise_states", "remainder"]

NOISE_STATE = 6
"""Number of values in a generator's state: six whole numbers below 2^32, three for each component, oldest first."""

_M1, _M2 = 4294967087, 4294944443
_A1 = ((0, 1, 0), (0, 0, 1), (-810728, 1403580, 0))
_A2 = ((0, 1, 0), (0, 0, 1), (-1370589, 0, 527612))
_NORM = 2.328306549295728e-10  # 1/(m1 + 1)
_STREAM = 127  # streams start 2^127 draws apart
_FIRST = 12345
_SEED_BITS = 63
# natural logarithm on [sqrt(1/2), sqrt(2)): 2 artanh((m − 1)/(m + 1)), its series to the 19th power, error < 1e-16
_LOG_TERMS = tuple(2.0 / (2 * k + 1) for k in range(10))


def noise_states(seeds: ArrayLike) -> NDArray[np.float64]:
    """Return the generator's state at the start of each seed's stream, (n, 6).

    Args:
        seeds: (n,) whole numbers, 0 to 2^63 − 1.

    Raises:
        InputError: if a seed is not a whole number, or is negative.

    Example:
        >>> from surctl.noise import noise_states
        >>> noise_states([7, 8])[:, :3].tolist()  # one row per seed; half of its six numbers
        [[3281794178.0, 2616230133.0, 1457051261.0], [3777646647.0, 1837464056.0, 4204654757.0]]
    """
    values = np.atleast_1d(np.asarray(seeds))
    if values.dtype.kind == "f" and not np.all(values == np.floor(values)):
        raise InputError("is not a whole number", key="seed", value=values[values != np.floor(values)][0])
    if values.dtype.kind not in "iuf" or values.ndim != 1 or np.any(values < 0):
        raise InputError("must be whole numbers, at least 0", key="seed", value=values.tolist()[:3])
    whole = values.astype(np.uint64)
    parts = []
    for modulus, jumps in ((_M1, _jumps(0)), (_M2, _jumps(1))):
        state = np.full((len(whole), 3), _FIRST, dtype=np.uint64)
        for bit in range(int(whole.max(initial=np.uint64(0))).bit_length()):
            moved = _times(jumps[bit], state, np.uint64(modulus))
            state = np.where(((whole >> np.uint64(bit)) & np.uint64(1))[:, None] == 1, moved, state)
        parts.append(state)
    return np.hstack(parts).astype(np.float64)


@cache
def _jumps(component: int) -> list[NDArray[np.uint64]]:
    """Return the matrices that advance one component of the generator by 2^127 · 2^k draws, for k = 0, 1, …"""
    modulus, matrix = ((_M1, _A1), (_M2, _A2))[component]
    power = np.array(matrix, dtype=object) % modulus
    jumps = []
    for k in range(_STREAM + _SEED_BITS):
        if k >= _STREAM:
            jumps.append(power.astype(np.uint64))
        power = power.dot(power) % modulus
    return jumps


def _times(matrix: NDArray[np.uint64], state: NDArray[np.uint64], modulus: np.uint64) -> NDArray[np.uint64]:
    # (n, 3); a product of two numbers below 2^32 fits into 64 bits
    rows = [sum((matrix[i, j] * state[:, j] % modulus for j in range(3)), start=np.uint64(0)) for i in range(3)]
    return np.column_stack([row % modulus for row in rows])


def draw_normals(state: ca.SX, count: int) -> tuple[ca.SX, ca.SX]:
    """Return independent standard normal numbers (count, 1) and the next state (6, 1) in CasADi symbols.

    Args:
        state: (6, 1) state of the generator.
        count: number of random numbers, even.

    Raises:
        InputError: if `count` is odd.

    Example:
        >>> import casadi as ca
        >>> from surctl.noise import draw_normals, noise_states
        >>> numbers, _ = draw_normals(ca.SX(noise_states([7])[0]), 2)
        >>> ca.evalf(numbers).full().ravel().round(4).tolist()
        [-0.3605, -0.5043]
    """
    if count % 2:
        raise InputError("must be even", key="count", value=count)
    out = []
    uniform, state = draw_uniforms(state, count)
    for k in range(0, count, 2):
        radius, turn = ca.sqrt(-2.0 * _log_of_uniform(uniform[k])), 2.0 * pi * uniform[k + 1]
        out += [radius * ca.cos(turn), radius * ca.sin(turn)]
    return ca.vertcat(*out), state


def draw_uniforms(state: ca.SX, count: int) -> tuple[ca.SX, ca.SX]:
    """Return independent uniform numbers in (0, 1), (count, 1), and the next state (6, 1) in CasADi symbols.

    Example:
        >>> import casadi as ca
        >>> from surctl.noise import draw_uniforms, noise_states
        >>> numbers, _ = draw_uniforms(ca.SX(noise_states([7])[0]), 2)
        >>> ca.evalf(numbers).full().ravel().round(4).tolist()
        [0.8252, 0.6512]
    """
    one, two = [state[k] for k in range(3)], [state[k] for k in range(3, 6)]
    out = []
    for _ in range(count):
        number, one, two = _uniform(one, two)
        out.append(number)
    return ca.vertcat(*out), ca.vertcat(*one, *two)


def _uniform(one: list[ca.SX], two: list[ca.SX]) -> tuple[ca.SX, list[ca.SX], list[ca.SX]]:
    a = remainder(1403580.0 * one[1] - 810728.0 * one[0], float(_M1))
    b = remainder(527612.0 * two[2] - 1370589.0 * two[0], float(_M2))
    difference = a - b
    return ca.if_else(difference > 0, difference, difference + _M1) * _NORM, [*one[1:], a], [*two[1:], b]


def remainder(x: ca.SX, modulus: float) -> ca.SX:
    """Return x mod modulus for a whole number x with |x| < 2^53.

    Unless it is whole, the quotient x/modulus lies at least 1/modulus below the next whole number. The rounding error
    of the quotient is smaller than 1/modulus (|quotient| < 2^21), so floor gives the exact result.

    Example:
        >>> import casadi as ca
        >>> from surctl.noise import remainder
        >>> float(remainder(ca.SX(17), 5.0))
        2.0
    """
    return x - ca.floor(x / modulus) * modulus


def _log_of_uniform(u: ca.SX) -> ca.SX:
    """Return ln u for 2^-33 < u < 1 without a logarithm function.

    The number u is scaled by powers of 2 to [1/2, 1); a series then gives the logarithm.
    """
    mantissa, exponent = u, ca.SX(0)
    for step in (32, 16, 8, 4, 2, 1):
        small = mantissa < 2.0**-step
        mantissa = ca.if_else(small, mantissa * 2.0**step, mantissa)
        exponent = ca.if_else(small, exponent - step, exponent)
    low = mantissa < sqrt(0.5)
    mantissa, exponent = ca.if_else(low, 2 * mantissa, mantissa), ca.if_else(low, exponent - 1, exponent)
    t = (mantissa - 1) / (mantissa + 1)
    square = t * t
    series = ca.SX(_LOG_TERMS[-1])
    for term in reversed(_LOG_TERMS[:-1]):
        series = series * square + term
    return exponent * log(2.0) + t * series

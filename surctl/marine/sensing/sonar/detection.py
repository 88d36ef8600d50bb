"""Uniform random numbers of single echoes, which depend only on the run's seed, the instant, the sensor and the echo.

The numbers are counter-based: no state passes from one number to the next, so their order and the number of threads do
not matter. A number comes from the cipher MiMC (Albrecht, Grassi, Rechberger, Roy and Tiessen 2016): rounds of adding a
key and a constant and of taking the cube modulo a prime p. The cube is a permutation because p − 1 is not divisible by
3. With p below 2^26, all products are exact in double precision, so Python, CasADi and C give the same bits.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.noise import noise_states

__all__ = ["ECHO_KEY", "echo_keys", "firing_block_symbols", "uniform_symbols"]

ECHO_KEY = 6
"""Number of values in the key of a run: whole numbers below 2^26."""

_P = 67108859  # 2^26 − 5, the largest prime below 2^26
_ROUNDS = 4  # for each of the three counters: instant, sensor, echo
_CONSTANTS = (14159265, 35897932, 38462643, 38327950, 28841971, 69399375 % _P, 10582097, 49445923, 7816406, 28620899,
              8628034, 82534211 % _P)  # fmt: skip  # digits of π


def echo_keys(seeds: ArrayLike) -> NDArray[np.float64]:
    """Return the key of each seed, (n, `ECHO_KEY`) whole numbers.

    Example:
        >>> from surctl.marine.sensing import echo_keys
        >>> echo_keys([0, 1]).shape
        (2, 6)
    """
    return np.asarray(noise_states(seeds) % _P, dtype=float)


def firing_block_symbols(key: ca.SX, instant: ca.SX, sensor: ca.SX) -> ca.SX:
    """Return the state of a firing, from which `uniform_symbols` makes the numbers of its echoes, in CasADi symbols.

    Args:
        key: (`ECHO_KEY`,) key of the run.
        instant: number of the firing instant, 0 to 6e7.
        sensor: index of the sensor that fires.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.sensing import echo_keys, firing_block_symbols
        >>> key = ca.SX(echo_keys([7])[0])
        >>> float(ca.evalf(firing_block_symbols(key, ca.SX(40), ca.SX(1)))) < 2**26
        True
    """
    return _mixed_symbols(_mixed_symbols(instant, key, 0) + sensor, key, 1)


def uniform_symbols(key: ca.SX, block: ca.SX, echo: ca.SX | int) -> ca.SX:
    """Return the uniform random number in (0, 1) of one echo of a firing in CasADi symbols.

    Args:
        key: (`ECHO_KEY`,) key of the run.
        block: state of the firing, from `firing_block_symbols`.
        echo: number of the echo, 0 to 2^22.

    Example:
        >>> import casadi as ca
        >>> from surctl.marine.sensing import echo_keys, firing_block_symbols, uniform_symbols
        >>> key = ca.SX(echo_keys([7])[0])
        >>> block = firing_block_symbols(key, ca.SX(40), ca.SX(1))
        >>> [round(float(ca.evalf(uniform_symbols(key, block, echo))), 4) for echo in (0, 1)]
        [0.1932, 0.2188]
    """
    return (_mixed_symbols(block + echo, key, 2) + 0.5) / float(_P)


def _mixed_symbols(x: ca.SX, key: ca.SX, counter: int) -> ca.SX:
    for k in range(counter * _ROUNDS, (counter + 1) * _ROUNDS):
        x = _remainder(x + key[k % ECHO_KEY] + _CONSTANTS[k])
        x = _remainder(_remainder(x * x) * x)
    return x


def _remainder(x: ca.SX) -> ca.SX:
    # exact for whole x below 2^52: the quotient is whole or at least 1/p below the next whole number, and its rounding
    # error is below 2^-27
    return x - ca.floor(x / float(_P)) * float(_P)

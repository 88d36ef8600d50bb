"""Frequency responses and margins of one loop of many systems at once, from eigenvalues; least delay margin.

Let A_o be the system matrix with a loop open and A_c the matrix with this loop closed. The loop transfer function is
l(s) = det(sI − A_c)/det(sI − A_o) − 1, and the same in z for a sampled loop. Its frequency response is therefore a
product over poles, and no linear system is solved at any frequency. A is first split into its decoupled diagonal blocks
(surge; heave; sway with yaw), and each loop uses only the block that contains it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_LOWEST = 1e-4  # [rad/s]
_SPURIOUS = 1e-6  # a crossing with |L| or 1/|L| below this value belongs to ω → ∞ or ω → 0
_HALVINGS = 20
_GOLDEN = (np.sqrt(5) - 1) / 2
_SHRINKS = 16


@dataclass(frozen=True, eq=False)
class BrokenLoop:
    """One loop at n operating points; it is opened at one signal while all other loops are closed.

    Attributes:
        closed: (n, k) poles [rad/s] of the system with this loop closed; poles z of a sampled loop.
        opened: (n, k) poles of the system with this loop open.
        dt: control period [s] of a sampled loop; 0: continuous.
    """

    closed: NDArray[np.complex128]
    opened: NDArray[np.complex128]
    dt: float = 0.0

    def response(self, omega: NDArray[np.float64], points: NDArray[np.intp] | slice) -> NDArray[np.complex128]:
        """Return the frequency response L(jω), or L(e^(jω dt)), (p, …) of the p selected points.

        Args:
            omega: frequencies [rad/s] in an array of shape (p, …), or of a shape that broadcasts to (p, …).
            points: indices of the p points, or a slice.
        """
        s = np.exp(1j * self.dt * omega) if self.dt else 1j * omega
        closed, opened = (p[points].T[(..., *(None,) * (omega.ndim - 1))] for p in (self.closed, self.opened))
        product = np.ones(np.broadcast_shapes(closed.shape[1:], omega.shape), dtype=complex)
        for zero, pole in zip(closed, opened, strict=True):
            product *= (s - zero) / (s - pole)
        return product - 1


def crossings_of(loop: BrokenLoop, grid: Array) -> dict[str, Array]:
    """Return the margins (n,) of one loop at n operating points, by their names in `LoopMargins`.

    The closed loop must be stable at every point. The margins are defined as in python-control's `stability_margins`
    and `disk_margins`. Crossings are bracketed on a grid of frequencies and refined by bisection; golden-section
    searches find the frequencies of the disk margin and of the largest sensitivity.

    Args:
        loop: the loop.
        grid: ascending frequencies (m,) or (n, m) [rad/s].
    """
    count = len(loop.closed)
    grid = np.broadcast_to(grid, (count, grid.shape[-1]))
    response = loop.response(grid, slice(None))
    every = np.ones((count, grid.shape[1] - 1), dtype=bool)
    gain_margin, lag, rejection = (np.full(count, np.inf) for _ in range(3))
    crossover, least_gain = np.zeros(count), np.zeros(count)

    def at_phase(value: NDArray[np.complex128]) -> Array:
        return np.asarray(np.angle(-value), dtype=float)

    def distance(value: NDArray[np.complex128]) -> Array:
        return np.asarray(np.abs(1 + value), dtype=float)

    left = response[:, :-1].real <= 0  # where the real part is positive, the real axis is crossed at 0°, not −180°
    points, omega = _zeros(loop, grid, response, at_phase, left)
    with np.errstate(divide="ignore"):  # a loop that is 0 there has no margin there
        gain = 1 / np.abs(loop.response(omega, points))
    for ends, factors in _at_ends(loop):
        points, gain = np.append(points, ends), np.append(gain, factors)
    more, less = (gain > 1) & (gain < 1 / _SPURIOUS), (gain < 1) & (gain > _SPURIOUS)
    np.minimum.at(gain_margin, points[more], gain[more])
    np.maximum.at(least_gain, points[less], gain[less])

    points, omega, phase = _gain_crossings(loop, grid, response)
    np.minimum.at(lag, points, phase)
    np.maximum.at(crossover, points, omega)
    delay = _least_delays(count, points, omega, phase)
    points, omega = _zeros(loop, grid, response, lambda value: distance(value) - np.sqrt(2), every)
    np.minimum.at(rejection, points, omega)
    rejection[distance(response[:, 0]) < np.sqrt(2)] = 0.0
    return {
        "gain_margin": gain_margin, "phase_margin_deg": lag, "delay_margin_s": delay,
        "disk_margin": _disk(loop, grid, response), "crossover_rad_s": crossover, "least_gain": least_gain,
        "sensitivity_peak": 1 / _least(loop, grid, response, distance), "rejection_rad_s": rejection,
    }  # fmt: skip


def delays_of(loop: BrokenLoop, grid: Array) -> Array:
    """Return the delay margins (n,) [s] of `crossings_of` alone."""
    grid = np.broadcast_to(grid, (len(loop.closed), grid.shape[-1]))
    return _least_delays(len(loop.closed), *_gain_crossings(loop, grid, loop.response(grid, slice(None))))


def _gain_crossings(
    loop: BrokenLoop, grid: Array, response: NDArray[np.complex128]
) -> tuple[NDArray[np.intp], Array, Array]:
    # points, frequencies [rad/s] and phase margins [deg] of all crossings of the gain 1

    def at_gain(value: NDArray[np.complex128]) -> Array:
        return np.asarray(np.abs(value) - 1, dtype=float)

    points, omega = _zeros(loop, grid, response, at_gain, np.ones((len(response), grid.shape[1] - 1), dtype=bool))
    # a phase lead φ counts as a lag of 360° − φ
    return points, omega, np.remainder(np.rad2deg(np.angle(-loop.response(omega, points))), 360.0)


def _least_delays(count: int, points: NDArray[np.intp], omega: Array, phase: Array) -> Array:
    delay = np.full(count, np.inf)
    np.minimum.at(delay, points, np.deg2rad(phase) / omega)
    return delay


def _at_ends(loop: BrokenLoop) -> list[tuple[NDArray[np.intp], NDArray[np.float64]]]:
    """Return the points with phase −180° at ω = 0, and the gain factors that put a pole there; likewise at Nyquist."""
    ends = []
    for omega in (0.0, np.pi / loop.dt) if loop.dt else (0.0,):
        steady, near = (np.cos(omega * loop.dt), loop.dt) if loop.dt else (0.0, 1.0)
        points = np.flatnonzero(np.all(np.abs(loop.opened - steady) > _SPURIOUS * _LOWEST * near, axis=1))
        value = loop.response(np.array([omega]), points).real
        ends.append((points[value < 0], -1 / value[value < 0]))
    return ends


def _zeros(
    loop: BrokenLoop,
    grid: NDArray[np.float64],
    response: NDArray[np.complex128],
    value: Callable[[NDArray[np.complex128]], NDArray[np.float64]],
    selected: NDArray[np.bool_],
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return points and frequencies at which a function of the response changes sign, in selected grid intervals."""
    points, at = np.nonzero((np.diff(np.sign(value(response)), axis=1) != 0) & selected)
    low, high = np.log(grid[points, at]), np.log(grid[points, at + 1])
    first, second = value(response[points, at]), value(response[points, at + 1])
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        at_middle = value(loop.response(np.exp(middle), points))
        same = np.sign(at_middle) == np.sign(first)
        low, first = np.where(same, middle, low), np.where(same, at_middle, first)
        high, second = np.where(same, high, middle), np.where(same, second, at_middle)
    # the remaining interval is nearly linear: one secant step suffices
    share = np.where(second != first, first / np.where(second != first, first - second, 1), 0.5)
    return points, np.exp(low + np.clip(share, 0, 1) * (high - low))


def _disk(loop: BrokenLoop, grid: NDArray[np.float64], response: NDArray[np.complex128]) -> NDArray[np.float64]:
    # α = min over ω of |2 (1 + L)/(1 − L)| (Seiler, Packard and Gahinet 2020)
    def radius(value: NDArray[np.complex128]) -> NDArray[np.float64]:
        with np.errstate(divide="ignore"):
            return np.asarray(2 * np.abs(1 + value) / np.abs(1 - value), dtype=float)

    return _least(loop, grid, response, radius)


def _least(
    loop: BrokenLoop,
    grid: NDArray[np.float64],
    response: NDArray[np.complex128],
    radius: Callable[[NDArray[np.complex128]], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Return the least value of `radius` over frequency at every point (n,), by golden-section search from the grid."""
    points, log = np.arange(len(response)), np.log(grid)

    def radii(at: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([radius(loop.response(np.exp(one), points)) for one in at])

    coarse = radius(response)
    nearest = np.argmin(coarse, axis=1)
    low = log[points, np.maximum(nearest - 1, 0)]
    high = log[points, np.minimum(nearest + 1, grid.shape[1] - 1)]
    least: NDArray[np.float64] = coarse[points, nearest]
    for _, values in golden_section(radii, low, high, shrinks=_SHRINKS):
        least = np.minimum(least, values.min(axis=0))
    return least


def golden_section(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    *,
    shrinks: int,
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Yield points (2, n) and the values there while n intervals shrink around least values of a function.

    Args:
        function: the values (2, n) at points (2, n).
        low: lower ends (n,) of the intervals.
        high: upper ends (n,).
        shrinks: how often the intervals shrink, each time to 0.618 of their length.

    Example:
        >>> import numpy as np
        >>> from surctl.verification.loops import golden_section
        >>> *_, (points, values) = golden_section(lambda x: (x - 0.3) ** 2, np.zeros(1), np.ones(1), shrinks=30)
        >>> points.round(5).ravel().tolist()
        [0.3, 0.3]
    """
    for _ in range(shrinks):
        both = np.stack([high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)])
        values = function(both)
        yield both, values
        lower = values[0] < values[1]
        low, high = np.where(lower, low, both[0]), np.where(lower, both[1], high)


# Stability margins of one loop at a time.
#
# Tests compare the margins with those of python-control.


LEAST_DELAY_MARGIN = 0.2
"""Least delay margin [s] of each loop alone, in every check, goal and search: four control periods (*chosen*)."""


class LeastDelay(NamedTuple):
    """The least delay margin [s] of one loop alone, the name of that loop, and the corner as text."""

    delay_s: float
    loop: str
    corner: str

    @property
    def where(self) -> str:
        """Loop and corner as text."""
        return f"{self.loop} at {self.corner}"


@dataclass(frozen=True)
class LoopMargins:
    """The stability margins of one loop while all other loops are closed.

    Attributes:
        name: the signal at which the loop is opened.
        stable: whether the closed loop is stable; if it is not, both gain factors are 1, the sensitivity is infinite,
            the crossover is NaN and all other values are 0.
        gain_margin: least factor > 1 on the loop gain that destabilises the loop; inf if no such factor exists.
        phase_margin_deg: least extra phase lag [deg] that destabilises the loop; inf if the gain never crosses 1.
        delay_margin_s: least extra delay [s] that destabilises the loop, which is the least ratio of phase margin to
            frequency over all gain crossings.
        disk_margin: radius α of the balanced disk margin (Seiler, Packard and Gahinet 2020), 0 … 2.
        crossover_rad_s: highest frequency [rad/s] at which the loop gain crosses 1; 0 if the loop gain never crosses 1.
        least_gain: largest factor < 1 on the loop gain that destabilises the loop; 0 if no such factor exists. A loop
            that is unstable when it is open always has a destabilising factor < 1.
        sensitivity_peak: largest |S| = |1/(1 + L)| over frequency.
        rejection_rad_s: frequency [rad/s] up to which |S| ≤ −3 dB, so that the loop attenuates disturbances; 0 if
            |S| > −3 dB at all frequencies.
    """

    name: str
    stable: bool
    gain_margin: float
    phase_margin_deg: float
    delay_margin_s: float
    disk_margin: float
    crossover_rad_s: float
    least_gain: float
    sensitivity_peak: float
    rejection_rad_s: float

    def to_dict(self) -> dict[str, Any]:
        """The margins as plain data for JSON; infinite margins stay inf."""
        return asdict(self)

    def line(self) -> str:
        """Return the margins as one line of text."""
        least = f" (and above {self.least_gain:.3g})" if self.least_gain > 0 else ""
        bounds = {"phase": (self.phase_margin_deg, "deg"), "delay": (self.delay_margin_s, "s")}
        texts = [f"{n} {f'{v:.4g} {unit}' if np.isfinite(v) else 'never lost'}" for n, (v, unit) in bounds.items()]
        gain = f"gain factor below {self.gain_margin:.4g}{least}"
        return f"{self.name}: {gain}, {', '.join(texts)}, disk margin {self.disk_margin:.3g}"


_SAME = 1e-6  # relative difference up to which two metric values count as equal


def worst_place(ill: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the indices of the worst entries along the first axis (the places), in the shape of the other axes.

    The largest entry is the worst; NaN counts as larger than all numbers. Entries that differ only by rounding count as
    equal; the index is then the first one.

    Example:
        >>> import numpy as np
        >>> from surctl.verification.loops import worst_place
        >>> worst_place(np.array([[0.81, 2.0], [0.81 + 1e-15, 3.0]])).tolist()
        [0, 1]
    """
    size = np.where(np.isnan(ill), np.inf, ill)
    return np.asarray(np.isclose(size, size.max(axis=0), rtol=_SAME, atol=0.0).argmax(axis=0))

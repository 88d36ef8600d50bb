"""Attitude of a vehicle along its motion: crab angle, heading error, and oscillation of the sway velocity."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.marine.guidance import Follower
from surctl.marine.simulation.metrics import MOVING

__all__ = ["Attitude", "attitude_of"]

Array = NDArray[np.float64]

_TRANSIENT = 0.4  # share of the run that is skipped before the search for an oscillation
_SWING = 0.05  # share of the cruise speed: smallest sway amplitude that counts as an oscillation
_ALIKE = 0.6  # smallest autocorrelation after one period that counts as an oscillation
_PERIODS = 3.0  # smallest number of periods in the examined part of the run


@dataclass(frozen=True)
class Attitude:
    """Crab angle, heading error and oscillation of one run.

    Attributes:
        crab_angle_deg: mean absolute angle between hull and velocity while the vehicle moves; NaN if it never moves.
        max_crab_angle_deg: largest absolute crab angle while the vehicle moves; NaN if it never moves.
        heading_error_deg: rms angle between the hull and the current path segment while the vehicle moves.
        oscillates: whether the sway velocity is periodic in the last part of the run, as in a limit cycle.
        period_s: period of the sway oscillation [s]; NaN if the sway velocity does not oscillate.
        swing_m_per_s: amplitude of the sway velocity in the last part of the run [m/s].
    """

    crab_angle_deg: float
    max_crab_angle_deg: float
    heading_error_deg: float
    oscillates: bool
    period_s: float
    swing_m_per_s: float

    def to_dict(self) -> dict[str, Any]:
        """Return the attitude results as plain data; NaN values are converted when a file is written."""
        return asdict(self)


def attitude_of(follower: Follower, cruise: float, time: Array, eta: Array, nu: Array) -> Attitude:
    """Return crab angle, heading error and oscillation of a recorded motion.

    Args:
        follower: path follower, which selects the current path segment; it must be at the start of its path.
        cruise: cruise speed [m/s].
        time: (n,) time [s], evenly spaced.
        eta: (n, 4) position [m] and heading [rad] in the earth frame {E}.
        nu: (n, 4) body velocity [m/s, rad/s].

    Example:
        >>> import numpy as np
        >>> from surctl.marine.guidance import Follower, Path
        >>> from surctl.marine.simulation import attitude_of
        >>> time = np.arange(0.0, 60.0, 0.05)
        >>> eta = np.stack([0.15 * time, 0 * time, 0 * time, 0 * time + 0.2], axis=1)
        >>> nu = np.tile([0.15 * np.cos(0.2), -0.15 * np.sin(0.2), 0.0, 0.0], (len(time), 1))
        >>> attitude = attitude_of(Follower(Path([[0.0, 0.0], [9.0, 0.0]])), 0.15, time, eta, nu)
        >>> round(attitude.crab_angle_deg, 1), round(attitude.heading_error_deg, 1), attitude.oscillates
        (11.5, 11.5, False)
    """
    moving = np.hypot(nu[:, 0], nu[:, 1]) > MOVING * cruise
    swings, period, amplitude = _swing(time, nu[:, 1], cruise)
    if not moving.any():
        nothing = float("nan")
        return Attitude(nothing, nothing, nothing, swings, period, amplitude)
    crab = np.abs(np.arctan2(nu[moving, 1], nu[moving, 0]))
    off = eta[moving, 3] - follower.directions(eta[:, :2])[moving]
    off = (off + np.pi) % (2 * np.pi) - np.pi
    return Attitude(
        float(np.rad2deg(crab.mean())),
        float(np.rad2deg(crab.max())),
        float(np.rad2deg(np.sqrt(np.mean(off**2)))),
        swings,
        period,
        amplitude,
    )


def _swing(time: Array, sway: Array, cruise: float) -> tuple[bool, float, float]:
    """Return whether the sway velocity is periodic, and its period [s] and amplitude [m/s].

    The function computes all three from the autocorrelation of the sway velocity.
    """
    late = sway[int(_TRANSIENT * len(sway)) :]
    nothing = False, float("nan"), 0.0
    if len(late) < 8:
        return nothing
    middle = late - late.mean()
    amplitude = float(np.sqrt(2) * middle.std())
    if amplitude < _SWING * cruise:
        return False, float("nan"), amplitude
    size = len(middle)
    spectrum = np.fft.rfft(middle, 2 * size)
    raw = np.fft.irfft(np.abs(spectrum) ** 2)[:size]
    left = np.arange(size, 0, -1)
    correlation = raw / left / (raw[0] / size)  # divide each lag by its number of samples
    crossed = np.flatnonzero(correlation < 0)
    last = int(size / _PERIODS)
    if not crossed.size or crossed[0] >= last:
        return False, float("nan"), amplitude
    at = int(crossed[0] + np.argmax(correlation[crossed[0] : last + 1]))
    if at == last or correlation[at] < _ALIKE:
        return False, float("nan"), amplitude
    return True, float(at * (time[1] - time[0])), amplitude

"""Whether the measured velocities of a log follow from its poses; if not, which change of the map would help."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle.motion_log import MotionLog

__all__ = ["velocity_notes"]

_SPAN, _SPAN_ROWS = 2.0, 10  # displacements are compared over this [s], or this many rows, whichever is longer
_GAP, _GAP_FACTOR = 0.5, 5.0  # displacements across a gap, longer than this [s] and than these periods, do not count
_AGREES = 0.3  # largest difference, relative to the displacement, that counts as agreement
_CLOSE, _FAR_CLOSER = 0.05, 0.2  # a difference above the first one is reported if a change reduces it to this share
_HELPS = 0.5  # of a larger difference, a change is named if it reduces the difference to this share
_ABOVE = 6.0  # standard deviations of the pose's noise that a displacement must have
_DEGREES = 180 / np.pi
_LEAST = 20  # displacements

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


def velocity_notes(log: MotionLog) -> tuple[str, ...]:
    """Return one text for each velocity that does not follow from the pose, with the change that would make it follow.

    The displacement over some seconds is compared with the integral of the velocity, turned by the heading. A wrong
    frame, sign or unit in the map of a log makes them differ, and so do a velocity through the water in a current, and
    clocks that differ.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle import MotionLog, velocity_notes
        >>> t, motion = 0.1 * np.arange(200), np.zeros((200, 8))
        >>> motion[:, 3], motion[:, 7] = 0.2 * t, -0.2  # the yaw rate has the wrong sign
        >>> velocity_notes(MotionLog(t, motion, np.zeros((200, 4)), "log.csv"))[0].partition(":")[0]
        'r_rad_per_s does not follow from psi_rad'
    """
    notes = []
    motion = log.motion
    x, y, z, psi, u, v, w, r = motion[:, :8].T
    flat = _compared(
        log,
        x + 1j * y,
        (u + 1j * v) * np.exp(1j * psi),
        (
            ('velocities of the world frame (frame = "world")', u + 1j * v),
            ('velocities of the world frame (frame = "world")', -v + 1j * u),  # north and east, converted as if u, v
            ("the other sign of v", (u - 1j * v) * np.exp(1j * psi)),
            ("the other sign of the heading", (u + 1j * v) * np.exp(-1j * psi)),
            ("the other sign of the heading", (u + 1j * v) * -np.exp(-1j * psi)),  # the same in a log of frame ned
            ("the heading times 57.3 (radians, read as degrees)", (u + 1j * v) * np.exp(1j * _DEGREES * psi)),
            ("the heading divided by 57.3 (degrees, read as radians)", (u + 1j * v) * np.exp(1j * psi / _DEGREES)),
        ),
    )
    if flat:
        notes.append(f"u_m_per_s, v_m_per_s do not follow from x_m, y_m, psi_rad: {flat}")
    for pose, rate, names in ((z, w, ("z_m", "w_m_per_s")), (psi, r, ("psi_rad", "r_rad_per_s"))):
        text = _compared(log, pose.astype(complex), rate.astype(complex), ())
        if text:
            notes.append(f"{names[1]} does not follow from {names[0]}: {text}")
    return tuple(notes)


def _compared(log: MotionLog, pose: Complex, velocity: Complex, others: Sequence[tuple[str, Complex]]) -> str:
    """Return how far a velocity is from the pose, and which other velocity or factor is closer; "" if it agrees."""
    moved, first = _displacements(log, pose, velocity)
    if len(moved) < _LEAST:
        return ""
    size, difference = max(_rms(moved), _rms(first)), _rms(moved - first)
    bends = np.abs(np.diff(pose[np.isfinite(pose)], 2))
    noise = float(np.median(bends)) / np.sqrt(2.0) if len(bends) else 0.0  # jumps between runs do not count
    if difference <= _CLOSE * size or size <= _ABOVE * noise:
        return ""
    square = float(np.sum(np.abs(first) ** 2))
    factor = complex(np.vdot(first, moved)) / square if square > 0 else 1.0
    turned = f"{np.degrees(np.angle(factor)):.0f} deg more heading and " if others else ""
    named = f"{turned}the factor {abs(factor) if others else factor.real:.3g}"
    candidates = [(_rms(moved - factor * first), named)]
    candidates += [(_rms(np.subtract(*_displacements(log, pose, other))), name) for name, other in others]
    closest, best = min(candidates)
    if difference <= _AGREES * size and closest > _FAR_CLOSER * difference:
        return ""
    said = f"the displacements differ by {difference:.2g} of {size:.2g}"
    if closest > _HELPS * difference:
        return f"{said}; check frames, signs, units and clocks, or expect a current"
    return f"{said}, with {best} by {closest:.2g}; correct the map or the columns"


def _displacements(log: MotionLog, pose: Complex, velocity: Complex) -> tuple[Complex, Complex]:
    # displacements over the span, and integrals of the velocity over it, within the parts without a gap
    period = float(np.median(np.diff(log.time)))
    rows = max(int(np.ceil(_SPAN / period)), _SPAN_ROWS)
    known = np.isfinite(pose) & np.isfinite(velocity)
    time, place, rate = log.time[known], pose[known], velocity[known]
    if len(time) <= rows:
        return np.zeros(0, dtype=complex), np.zeros(0, dtype=complex)
    step = np.diff(time)
    integral = np.concatenate([[0], np.cumsum(step * (rate[1:] + rate[:-1]) / 2)])
    cuts = np.concatenate([[0], np.cumsum(step > max(_GAP, _GAP_FACTOR * period))])
    whole = cuts[rows:] == cuts[:-rows]
    return (place[rows:] - place[:-rows])[whole], (integral[rows:] - integral[:-rows])[whole]


def _rms(values: NDArray[np.number]) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2))) if len(values) else 0.0

"""Stability margins of the cascade linearised about cruise, one loop at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.cascade import LOOP_NAMES, Cascade, broken_loops, build_cascade
from surctl.marine.verification.linear.corners import corners
from surctl.verification.loops import LoopMargins, crossings_of, margins_from

__all__ = ["closed_loop_poles", "loop_margins", "worst_margins"]


def loop_margins(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle | None = None
) -> tuple[LoopMargins, ...]:
    """Return the stability margins of the eight loops about cruise; the module `cascade` describes the linear model.

    The loops `surge`, `sway`, `heave` and `yaw` are opened at the thrust command while guidance stays closed: their
    margins bound a delay or gain error of this thrust. The loops `along_track`, `cross_track`, `depth` and `heading`
    are opened at the measured x_e, y_e, z_e, ψ: their margins bound a delay or gain error of this measurement.

    Args:
        vehicle: the vehicle.
        gains: k1, k2, k_psi, k_r, k_v [1/s], lookahead [m]; k_i [1/s²] for integral action.
        cruise: cruise speed U [m/s].
        dt: control period [s].
        model: the controller's model of the vehicle; default the vehicle itself.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot hold the cruise speed.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import loop_margins
        >>> for loop in loop_margins(load_vehicle("sur400"), load_gains("default").values, cruise=0.15, dt=0.05)[:3]:
        ...     print(f"{loop.name}: {loop.phase_margin_deg:.0f} deg, {loop.delay_margin_s:.2f} s")
        surge: 56 deg, 0.70 s
        sway: 55 deg, 0.69 s
        heave: 49 deg, 0.61 s
    """
    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model)
    highest = np.pi / dt  # the Nyquist frequency: a sampled controller does not act above it
    if not cascade.stable:
        return tuple(LoopMargins.unstable(name) for name in LOOP_NAMES)
    one = Cascade(*(m[None] for m in (cascade.A, cascade.B, cascade.C, cascade.K)))
    return tuple(
        margins_from(name, crossings_of(loop, highest=highest))
        for name, loop in zip(LOOP_NAMES, broken_loops(one), strict=True)
    )


def worst_margins(
    vehicle: Vehicle, gains: Mapping[str, float], *, uncertainty: float, cruise: float, dt: float
) -> tuple[LoopMargins, ...]:
    """Return the least margins of each loop over uncertain mass and drag; the controller keeps the nominal model.

    All masses are multiplied by 1 − uncertainty or 1 + uncertainty, and all drag coefficients likewise. Combining the
    two signs gives four corner vehicles besides the nominal vehicle. A linear loop is usually worst at a corner, but
    the result is no proof for the values between the corners.

    Args:
        vehicle: the nominal vehicle.
        gains: the gains by name, as in `loop_margins`.
        uncertainty: relative uncertainty of mass and drag, 0 ≤ uncertainty < 1.
        cruise: cruise speed U [m/s].
        dt: control period [s].

    Raises:
        InputError: `loop_margins` rejects its arguments, or the uncertainty is out of range.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import worst_margins
        >>> vehicle, gains = load_vehicle("sur400"), load_gains("default").values
        >>> for share in (0.0, 0.2):
        ...     worst = worst_margins(vehicle, gains, uncertainty=share, cruise=0.15, dt=0.05)
        ...     print(share, round(min(loop.disk_margin for loop in worst), 2))
        0.0 0.81
        0.2 0.74
    """
    tried = corners(vehicle, uncertainty).vehicles
    margins = [loop_margins(corner, gains, cruise=cruise, dt=dt, model=vehicle) for corner in tried]
    return _least_margins(margins)


def _least_margins(margins: Sequence[tuple[LoopMargins, ...]]) -> tuple[LoopMargins, ...]:
    """Return, for each loop, the least value of every margin over several vehicles."""
    return tuple(_least(same) for same in zip(*margins, strict=True))


def _least(loops: Sequence[LoopMargins]) -> LoopMargins:
    return LoopMargins(
        loops[0].name,
        all(m.stable for m in loops),
        min(m.gain_margin for m in loops),
        min(m.phase_margin_deg for m in loops),
        min(m.delay_margin_s for m in loops),
        min(m.disk_margin for m in loops),
        max(m.crossover_rad_s for m in loops),
        max(m.least_gain for m in loops),
    )


def closed_loop_poles(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float
) -> NDArray[np.complex128]:
    """Return the poles (n,) [rad/s] of the closed cascade, slowest first; for the arguments see `loop_margins`.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import closed_loop_poles
        >>> poles = closed_loop_poles(load_vehicle("sur400"), load_gains("default").values, cruise=0.15, dt=0.05)
        >>> poles.real[:3].round(2).tolist(), len(poles)
        ([-0.22, -0.38, -0.38], 24)
    """
    return build_cascade(vehicle, gains, cruise=cruise, dt=dt).poles

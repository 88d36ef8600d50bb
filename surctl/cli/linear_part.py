"""The linear analysis of `surctl verify`: margins, poles, the slowest mode and the largest stable speed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from surctl.vehicle import Vehicle

__all__ = ["LinearPart", "linear_part"]


class LinearPart(NamedTuple):
    """Lines to print, data for JSON, and whether the loop is stable; None if no straight cruise is possible."""

    lines: list[str]
    data: dict[str, Any]
    stable: bool | None


def linear_part(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, uncertainty: float, requested: bool
) -> LinearPart:
    """Return the linear analysis about a cruise speed [m/s], for the nominal vehicle and the worst uncertain one.

    Raises:
        InputError: the vehicle cannot hold a requested cruise speed, or a gain is missing or not positive.
    """
    import numpy as np

    from surctl.errors import InputError
    from surctl.vehicle.linearise import check_trim
    from surctl.verification import build_cascade, worst_margins
    from surctl.verification.linear import (
        DISK_PLACES,
        corners,
        linear_side,
        open_loop,
        sensitivity_of,
        slowest_mode,
        worst_linear_side,
    )

    tried = corners(vehicle, uncertainty or None)
    try:
        check_trim(vehicle, np.array([cruise, 0.0, 0.0, 0.0]))
    except InputError as error:
        if requested:
            raise
        why = f"not applicable to this vehicle, because a cruise at {cruise:g} m/s {error.problem} N"
        return LinearPart([f"margins: {why}"], {"margins": [], "linear": {"not_applicable": why}}, None)
    margins = worst_margins(vehicle, gains, uncertainty=uncertainty, cruise=cruise, dt=dt)
    nominal = linear_side(vehicle, gains, cruise=cruise, dt=dt)
    worst = worst_linear_side(tried, gains, cruise=cruise, dt=dt)
    mode = slowest_mode(vehicle, gains, cruise=cruise, dt=dt)
    least = min(margins, key=lambda m: m.delay_margin_s)
    stable = all(m.stable for m in margins)
    off = f" with mass and drag off by ±{uncertainty:.0%}" if uncertainty else ""
    word = f"stable, least delay margin {least.delay_margin_s:.2f} s ({least.name})" if stable else "UNSTABLE"
    lines = [f"margins of {vehicle.name}{off}: {word}", *mode.lines()]
    if not stable:
        lines.append(
            "  the kinematic claims assume that the vehicle follows the commanded velocity, but this loop is unstable"
        )
    cascade = build_cascade(vehicle, gains, cruise=cruise, dt=dt)
    curves = [sensitivity_of(open_loop(cascade, p), p, highest=np.pi / dt) for p in DISK_PLACES[:2] if cascade.stable]
    if curves:
        peaks = "; ".join(f"S {c.S.max():.2f}, T {c.T.max():.2f} ({c.place})" for c in curves)
        lines.append(f"  largest sensitivity of all loops together: {peaks}")
    lines += [*nominal.lines(), *(worst.lines() if len(tried.vehicles) > 1 else [])]
    data = {
        "margins": [m.to_dict() for m in margins],
        "linear": {"nominal": nominal.to_dict(), "worst": worst.to_dict(), "mode": mode.to_dict()}
        | {"sensitivity": [c.to_dict() for c in curves]},
    }
    return LinearPart(lines, data, stable)

"""A quick estimate of the disk margin of all loops at once, on a coarse grid of frequencies."""

from __future__ import annotations

from collections.abc import Mapping

from surctl.vehicle import Vehicle
from surctl.verification.cascade import build_cascade
from surctl.verification.linear.disk import screened_peaks
from surctl.verification.linear.places import open_loop
from surctl.verification.linear.sampled import radius_of

__all__ = ["estimated_margin"]


def estimated_margin(
    vehicle: Vehicle, gains: Mapping[str, float], *, cruise: float, dt: float, model: Vehicle | None = None
) -> float:
    """Return an estimate of the disk margin of all loops at once, at thrust commands and measured pose; 0 if unstable.

    The loop counts as unstable if the continuous loop with approximated delay or the sampled loop with one period of
    delay is unstable. `disk_margin` shows a margin at all frequencies, but takes seconds; the estimate is larger by a
    few percent at most.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot hold the cruise speed.

    Example:
        >>> from surctl.control import load_gains
        >>> from surctl.vehicle import load_vehicle
        >>> from surctl.verification.linear import estimated_margin
        >>> gains = load_gains("default").values
        >>> [round(estimated_margin(load_vehicle("bluerov2-wu"), gains, cruise=u, dt=0.05), 2) for u in (0.1, 0.47)]
        [0.42, 0.0]
    """
    delayed = build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model)
    plain = build_cascade(vehicle, gains, cruise=cruise, dt=dt, model=model, delay=0.0)
    if not delayed.stable or radius_of(plain, dt, 1) >= 1:
        return 0.0
    loop = open_loop(delayed, "both")
    (peak,) = screened_peaks(type(loop)(loop.A[None], loop.B[None], loop.C[None], loop.D[None]))
    return float(1 / peak)

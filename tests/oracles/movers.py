"""The tracker of moving obstacles in NumPy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from surctl.marine.sensing.localisation.movers import Movers, MoverTracker

__all__ = ["mover_step"]


def mover_step(
    tracker: MoverTracker,
    state: Mapping[str, NDArray[np.float64]],
    *,
    message: NDArray[np.float64],
    message_fresh: float,
    prefix: str = "",
) -> Movers:
    """Return the result of `MoverTracker.update` for NumPy arrays; the function changes no input.

    Example:
        >>> import numpy as np
        >>> from surctl.ir import Layout
        >>> from surctl.marine.sensing.localisation.movers import MoverTracker
        >>> from tests.oracles.movers import mover_step
        >>> tracker = MoverTracker(dt=0.05, slots=1)
        >>> layout = Layout(tracker.ports())
        >>> drifting = np.array([[1.0, 0.5, 0.2, 0.1, 0.0, 1.0]])  # x, y, radius, vx, vy, valid
        >>> movers = mover_step(tracker, layout.unpack(layout.pack()), message=drifting, message_fresh=1.0)
        >>> movers.rows.round(3).tolist(), movers.bound.round(4).tolist()  # 0.1 s later
        ([[1.01, 0.5, 0.2, 0.1, 0.0, 1.0]], [0.0335])
    """
    latest = np.array(state[f"{prefix}latest"], dtype=float)
    age = np.array(state[f"{prefix}age"], dtype=float) + tracker.dt
    received = np.asarray(message, dtype=float)
    rows, bound = np.zeros((tracker.slots, 6)), np.zeros(tracker.slots)
    for k in range(tracker.slots):
        if message_fresh:
            age[k] = tracker.latency if received[k, 5] else np.inf
            latest[k] = received[k, :5] if received[k, 5] else latest[k]
        age[k] = min(age[k], tracker.forget + tracker.dt)
        if age[k] <= tracker.forget + 0.5 * tracker.dt:
            x, y, radius, vx, vy = latest[k]
            rows[k] = x + vx * age[k], y + vy * age[k], radius, vx, vy, 1.0
            spread = tracker.position_sd + tracker.velocity_sd * age[k]
            bound[k] = tracker.sigmas * spread + tracker.acceleration * age[k] ** 2 / 2
    return Movers({f"{prefix}latest": latest, f"{prefix}age": age}, rows, bound, age.copy())

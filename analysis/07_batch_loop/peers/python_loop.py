"""The loop as it is written in Python: the toolkit's world, sonar and law, the plant integrated by somebody else.

The plant is solved once per control period, with output also at its middle, when the second sonar fires. The plant is
in plain Python floats: for twelve states this is several times as fast as arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import cos, sin
from typing import Any, TypeAlias
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import tests.oracles.mission_loop as reference
from surctl.marine.simulation.physics import advance

__all__ = ["Step", "control_step", "flown_by", "matched", "scipy_step"]

Array: TypeAlias = NDArray[np.float64]
Step: TypeAlias = Callable[[Array, Array, Array, Array, Array], tuple[Array, Array]]
"""Function (state (12,), thrust (4,), disturbance (7,) of each half, parameters (17,)) → state after 25 and 50 ms."""

_HALF, _DT = reference.FIRING, 2 * reference.FIRING


def plant(x: Sequence[float], tau: Sequence[float], d: Sequence[float], p: Sequence[float]) -> list[float]:
    """Return the plant's equation (3) with lag and current; layouts as in `surctl.marine.vehicle`."""
    c, s = cos(x[3]), sin(x[3])
    u, v, w, r = x[4], x[5], x[6], x[7]
    cx, cy = c * d[0] + s * d[1], c * d[1] - s * d[0]
    a, b = u - cx, v - cy
    lag = p[16]
    thrust = x[8:12]
    change = [(min(max(f, -m), m) - t) / lag for f, m, t in zip(tau, p[12:16], thrust, strict=True)]
    load = [t - (q * abs(n) + k) * n for t, k, q, n in zip(thrust, p[4:8], p[8:12], (a, b, w, r), strict=True)]
    load[0] += c * d[3] + s * d[4] + p[1] * b * r
    load[1] += c * d[4] - s * d[3] - p[0] * a * r
    load[3] -= (p[1] - p[0]) * a * b
    rate = [f / m for f, m in zip(load, p[:4], strict=True)]
    return [c * u - s * v, s * u + c * v, w, r, rate[0] + r * cy, rate[1] - r * cx, rate[2], rate[3], *change]


def scipy_step(method: str, rtol: float) -> Step:
    """Return a plant step by `scipy.integrate.solve_ivp`, called once per control period."""

    def step(x: Array, tau: Array, first: Array, second: Array, p: Array) -> tuple[Array, Array]:
        thrust, halves, numbers = tau.tolist(), (first.tolist(), second.tolist()), p.tolist()

        def rate(t: float, y: Array) -> list[float]:
            return plant(y.tolist(), thrust, halves[int(t >= _HALF)], numbers)

        done = solve_ivp(rate, (0.0, _DT), x, method=method, t_eval=(_HALF, _DT), rtol=rtol, atol=1e-2 * rtol)
        return done.y[:, 0], done.y[:, 1]

    return step


def control_step(rtol: float) -> Step:
    """Return a plant step by `control.input_output_response` of a `NonlinearIOSystem`, called once per control
    period.
    """
    import control

    numbers: list[float] = []

    def rate(t: float, x: Array, u: Array, params: dict[str, Any]) -> list[float]:
        return plant(x.tolist(), u[:4].tolist(), u[4:].tolist(), numbers)

    system = control.NonlinearIOSystem(rate, None, inputs=11, outputs=12, states=12, name="plant")
    times = np.array((0.0, _HALF, _DT))

    def step(x: Array, tau: Array, first: Array, second: Array, p: Array) -> tuple[Array, Array]:
        numbers[:] = p.tolist()
        inputs = np.vstack([np.tile(tau, (3, 1)).T, np.column_stack([first, second, second])])
        options = {"rtol": rtol, "atol": 1e-2 * rtol}
        done = control.input_output_response(system, times, inputs, x, solve_ivp_kwargs=options)
        return done.states[:, 1], done.states[:, 2]

    return step


@contextmanager
def flown_by(step: Step) -> Iterator[None]:
    """Run the loop in NumPy of the tests with its plant integrated by `step`."""
    with patch.object(reference.Loop, "_advance", _stepped(step)):
        yield


def _stepped(step: Step) -> Callable[..., None]:
    def advanced(loop: Any, time: float, decided: Any, drawn: Any) -> None:
        current = [*loop.world.scenario.disturbance.current_m_per_s, 0.0]
        first, second = (np.array([*current, *loop.world.force(time + at)]) for at in (0.0, _HALF))
        physics = loop.physics
        middle, end = step(loop.state, decided.tau, first, second, physics.plant)
        loop.state = physics.state = middle
        bodies = loop.world.bodies(time + _HALF)
        loop._listen(bodies, drawn, 1)
        loop._clearance(bodies)
        loop.state = physics.state = end

    return advanced


def matched(make: Callable[[float], Step], ticks: Sequence[tuple[Array, Array, Array, Array]]) -> tuple[float, float]:
    """The largest tolerance, a power of 10, with which `make` is as accurate as the toolkit's RK4, and its error.

    Errors are the largest over the steps (state, thrust, disturbance, parameters), against DOP853 at 1e-13.
    """
    exact = scipy_step("DOP853", 1e-13)
    right = [exact(x, tau, d, d, p)[1] for x, tau, d, p in ticks]

    def error(found: Sequence[Array]) -> float:
        return max(float(np.abs(a - b).max()) for a, b in zip(found, right, strict=True))

    once = advance()
    ours = error([np.asarray(once(once(x, tau, d, p), tau, d, p)).reshape(-1) for x, tau, d, p in ticks])
    for power in range(2, 13):
        theirs = error([make(10.0**-power)(x, tau, d, d, p)[1] for x, tau, d, p in ticks])
        if theirs <= ours:
            break
    return 10.0**-power, theirs

"""LOS with memory: the laws as printed, their twins, and where the error of a steady push goes."""

from __future__ import annotations

from functools import cache
from math import atan, cos, hypot, sin, sqrt

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.guidance import GUIDANCE, Guidance
from surctl.marine.guidance.tracking import check_guidance, crosstrack_next, crosstrack_shift

DT, SIGMA, GAMMA, LOOKAHEAD, SPEED = 0.05, 0.05, 0.4, 0.8, 0.2
STEEPEST = 1.0  # largest slope of the course that a law may learn
numbers = st.floats(-5, 5)


def numeric_crosstrack_next(
    method: Guidance,
    memory: float,
    y_e: float,
    *,
    along: float,
    lookahead: float,
    sigma: float,
    gamma: float,
    held: bool,
    dt: float,
) -> tuple[float, float]:
    """Return the method's next state, y_int [s] or b [1], and the present shift [m], in plain numbers."""
    shift = {"los": 0.0, "ilos": sigma * memory, "alos": lookahead * memory}[method]
    if method == "los":
        return 0.0, shift
    rate = gamma * along * y_e if method == "alos" else lookahead * y_e / (lookahead**2 + (y_e + shift) ** 2)
    most = STEEPEST if method == "alos" else STEEPEST * lookahead / max(sigma, 1e-9)
    return min(max(memory + (0.0 if held else dt * rate), -most), most), shift


@cache
def _step(method: Guidance) -> ca.Function:
    names = ("memory", "y_e", "along", "lookahead", "sigma", "gamma", "held")
    v = {name: ca.SX.sym(name) for name in names}
    after = crosstrack_next(
        method,
        v["memory"],
        v["y_e"],
        along=v["along"],
        lookahead=v["lookahead"],
        sigma=v["sigma"],
        gamma=v["gamma"],
        held=v["held"],
        dt=DT,
    )
    shift = crosstrack_shift(method, v["memory"], lookahead=v["lookahead"], sigma=v["sigma"])
    return ca.Function("step", list(v.values()), [after, shift])


@pytest.mark.parametrize("method", GUIDANCE)
@settings(derandomize=True, deadline=None)
@given(numbers, numbers, st.floats(0, 0.5), st.floats(0.1, 3), st.floats(1e-3, 0.5), st.floats(1e-3, 5), st.booleans())
def test_symbols_and_numbers_are_twins(
    method: Guidance, memory: float, y: float, along: float, lookahead: float, sigma: float, gamma: float, held: bool
) -> None:
    if method == "los":
        memory = 0.0
    found = [float(v) for v in _step(method)(memory, y, along, lookahead, sigma, gamma, held)]
    twin = numeric_crosstrack_next(
        method, memory, y, along=along, lookahead=lookahead, sigma=sigma, gamma=gamma, held=held, dt=DT
    )
    assert found == pytest.approx(twin, abs=1e-12)


@settings(derandomize=True, deadline=None)
@given(st.floats(-1, 1), numbers, st.floats(0.01, 0.5), st.floats(0.1, 3))
def test_alos_is_the_published_rate(b: float, y: float, along: float, lookahead: float) -> None:
    """b' = γ U Δ y/√(Δ² + (y + Δ b)²), with U the speed on the commanded course γ_d − atan(y/Δ + b)."""
    course = -atan(y / lookahead + b)
    U = along / cos(course)
    assert U * sin(course) == pytest.approx(-along * (y + lookahead * b) / lookahead, abs=1e-12)
    rate = GAMMA * U * lookahead * y / sqrt(lookahead**2 + (y + lookahead * b) ** 2)
    after, _ = (float(v) for v in _step("alos")(b, y, along, lookahead, SIGMA, GAMMA, 0))
    assert after == pytest.approx(min(max(b + DT * rate, -1), 1), abs=1e-12)


def test_ilos_is_the_published_rate() -> None:
    m, y = 1.5, 0.4
    rate = LOOKAHEAD * y / (LOOKAHEAD**2 + (y + SIGMA * m) ** 2)
    assert float(_step("ilos")(m, y, SPEED, LOOKAHEAD, SIGMA, GAMMA, 0)[0]) == pytest.approx(m + DT * rate, abs=1e-15)


@pytest.mark.parametrize("method", ["ilos", "alos"])
@settings(derandomize=True, deadline=None)
@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6), st.booleans())
def test_the_slope_learnt_is_bounded_and_nothing_is_learnt_while_held(
    method: Guidance, memory: float, y: float, held: bool
) -> None:
    after = float(_step(method)(memory, y, SPEED, LOOKAHEAD, SIGMA, GAMMA, held)[0])
    shift = float(_step(method)(after, y, SPEED, LOOKAHEAD, SIGMA, GAMMA, held)[1])
    assert abs(shift) <= LOOKAHEAD * (1 + 1e-12)
    if held and abs(shift) < LOOKAHEAD * (1 - 1e-9):
        assert after == memory


def test_v_of_alos_falls_as_said() -> None:
    """d/dt [y²/2 + (b − b*)²/(2γ)] = −U∥ y²/Δ of the kinematic loop, in symbols."""
    y, b, real, along, lookahead, gamma = (ca.SX.sym(n) for n in ("y", "b", "real", "along", "lookahead", "gamma"))
    after = crosstrack_next(
        "alos", b, y, along=along, lookahead=lookahead, sigma=ca.SX(1), gamma=gamma, held=ca.SX(0), dt=DT
    )
    y_rate = -along * (y + crosstrack_shift("alos", b, lookahead=lookahead, sigma=ca.SX(1))) / lookahead + along * real
    fall = y * y_rate + (b - real) * (after - b) / DT / gamma
    off = ca.Function("off", [y, b, real, along, lookahead, gamma], [fall + along * y * y / lookahead])
    for row in np.random.default_rng(3).uniform([-1, -0.5, -0.5, 0.05, 0.3, 0.1], [1, 0.5, 0.5, 0.4, 2, 1], (200, 6)):
        assert float(off(*row)) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("method", GUIDANCE)
def test_a_steady_push_leaves_an_offset_only_without_memory(method: Guidance) -> None:
    """Kinematic loop with a push d across: LOS stays at Δ d/U, the others come back."""
    y, memory, push = 0.0, 0.0, 0.02
    for _ in range(round(120 / DT)):
        memory, shift = numeric_crosstrack_next(
            method, memory, y, along=SPEED, lookahead=LOOKAHEAD, sigma=SIGMA, gamma=GAMMA, held=False, dt=DT
        )
        y += DT * (push - SPEED * (y + shift) / LOOKAHEAD)
    assert y == pytest.approx(LOOKAHEAD * push / SPEED if method == "los" else 0, abs=1e-4)
    assert hypot(y, 0) < 0.1


def test_an_unknown_guidance_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(InputError, match="guidance"):
        check_guidance("iloss")

"""Errata of section II: Table II, the analogue-to-digital converter, and the adaptive filter (E2–E6, E19, E20)."""

from __future__ import annotations

import casadi as ca
import numpy as np

from surctl.marine.reproduction.motion import Vector, value
from surctl.marine.reproduction.row import Result, agrees, differs, unreadable, wrong_in_print
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.calibration.table2 import MEDIA, RangeTest, table_ii
from surctl.marine.sensing.ranging.filters import StepRule, lms_step

__all__ = ["e2", "e3", "e4", "e5", "e6", "e19", "e20"]

# plausible readings [m], newest first, and the value to be predicted from them
_X = np.array([1.21, 1.18, 1.24, 1.20])
_X_N = 1.30


def largest_error(test: RangeTest) -> float:
    """Return the largest error |measured − desired| over both media of Table II [m]."""
    return max(float(np.max(np.abs(test.errors(medium)))) for medium in MEDIA)


def largest_percent(test: RangeTest) -> float:
    """Return the largest relative error over both media of Table II [%]."""
    return max(float(np.max(test.percent(medium))) for medium in MEDIA)


def printed_step(x: Vector, residual: float) -> float:
    """Return the step size μ = gᵀg/(gᵀRg) [1/m²] as printed in step S5 of Algorithm 1, with g = Xℜ and R = XXᵀ."""
    g, R = x * residual, np.outer(x, x)
    return float(g @ g / (g @ R @ g))


def residual_after(step: StepRule) -> float:
    """Return the residual after one step of Algorithm 1 divided by the residual before it, without momentum."""
    m = len(_X)
    theta, x = ca.SX(np.full(m, 1.0 / m)), ca.SX(_X)
    done = lms_step(
        theta,
        theta,
        X=x,
        x_n=ca.SX(_X_N),
        errors=ca.SX.zeros(8),
        mean_error=ca.SX(0),
        relaxation=ca.SX(1),
        beta_max=ca.SX(0),
        step=step,
    )
    return value((_X_N - ca.dot(done.theta, x)) / done.residual)


def loss_gradient(theta: Vector, x: Vector, x_n: float) -> Vector:
    """Return the gradient (n,) [m²] of ℜ² = (x_n − θᵀX)² with respect to θ, by automatic differentiation."""
    symbol = ca.SX.sym("theta", len(theta))
    loss = (x_n - ca.dot(symbol, ca.SX(x))) ** 2
    return np.asarray(ca.Function("gradient", [symbol], [ca.gradient(loss, symbol)])(theta)).ravel()


def printed_gradient(theta: Vector, x: Vector, x_n: float) -> Vector:
    """Return the gradient ∇(ℜ) = +2ℜX (n,) [m²] as printed in step S3 of Algorithm 1."""
    printed: Vector = 2 * (x_n - theta @ x) * x
    return printed


def e2() -> Result:
    """Return the result for erratum E2: all percentages of Table II recomputed; one printed percentage is wrong."""
    test = table_ii()
    off = [(medium, int(k)) for medium in MEDIA for k in test.disagreeing(medium)]
    if not off:
        return agrees(f"all {2 * len(test.desired)} percentages agree to their printed decimal")
    if len(off) > 1:
        return differs(f"{len(off)} percentages disagree", "only one was expected", disagreeing=float(len(off)))
    medium, k = off[0]
    exact, printed = float(test.percent(medium)[k]), float(test.column(medium).printed_percent[k])
    read, true = 100 * test.column(medium).measured[k], 100 * test.desired[k]
    return wrong_in_print(
        f"{exact:.3f} %; {len(off)} of {2 * len(test.desired)} percentages is wrong",
        f"a reading of {read:.0f} cm at {true:.0f} cm in {medium} is an error of {exact:.1f} %, not {printed:.1f} %",
        percent=exact,
        disagreeing=float(len(off)),
    )


def e3() -> Result:
    """Return the result for erratum E3: the largest absolute error of Table II, compared with 4.5 cm in the text."""
    test = table_ii()
    worst, percent = 100 * largest_error(test), largest_percent(test)
    ours = f"largest error {worst:.1f} cm"
    if abs(worst - 4.5) < 0.1:
        return agrees(ours, error_cm=worst)
    why = f"the largest error in the table is {worst:.1f} cm; {percent:.1f} is its largest percentage"
    return differs(ours, why, error_cm=worst, percent=percent)


def e4() -> Result:
    """Return the result for erratum E4: the range step of an 8-bit converter, compared with the printed resolution."""
    array = SonarArray()
    step, needed = 1e3 * array.resolution, int(np.ceil(np.log2(array.maximum / 0.005 + 1)))
    ours = f"{step:.2f} mm"
    if step <= 5.5:
        return agrees(ours, step_mm=step)
    return wrong_in_print(
        ours,
        f"a range of {array.maximum:g} m in {array.bits} bits gives steps of {step:.2f} mm; 5 mm needs {needed} bits",
        step_mm=step,
        bits_for_5_mm=float(needed),
    )


def e5() -> Result:
    """Return the result for erratum E5: one LMS step with the printed step size 2μ increases the residual."""
    m = len(_X)
    printed, corrected = residual_after("printed"), residual_after("corrected")
    mu = printed_step(_X, _X_N - float(np.full(m, 1 / m) @ _X))
    trace, by_hand = mu * float(_X @ _X), 1 - 2 * mu * float(_X @ _X)
    ours = f"after one printed step: residual × {printed:.3f}; after half that step: residual × {abs(corrected):.3f}"
    if abs(printed) < 1 or abs(printed - by_hand) > 1e-9 or abs(corrected) >= 1:
        return agrees(ours, printed=printed, corrected=corrected)
    return wrong_in_print(
        ours,
        f"each step changes ℜ to {printed:.3f} ℜ, and μ trR = {trace:.3f} is not below the printed bound of 1",
        printed=printed,
        corrected=corrected,
        mu_times_trace=trace,
    )


def e6() -> Result:
    """Return the result for erratum E6: the residual grows if t in equation (6) of the paper is the time."""
    half = 0.5 * printed_step(_X, 1.0)  # the line-search optimum
    at = {t: 1 - 2 * half * t * float(_X @ _X) for t in (1.0, 3.0)}
    ours = (
        f"with t as time, a step changes the residual by × {at[1.0]:.2f} at 1 s and × {at[3.0]:.2f} at 3 s, so it "
        f"grows; without t, by × {at[1.0]:.2f}"
    )
    if abs(at[3.0]) <= 1:
        return agrees(ours)
    return unreadable(ours, at_1_s=at[1.0], at_3_s=at[3.0])


def e19() -> Result:
    """Return the result for erratum E19: the printed gradient of ℜ² has the wrong sign, and X_n contains x_n."""
    theta = np.full(len(_X), 1.0 / len(_X))
    true, printed = loss_gradient(theta, _X, _X_N), printed_gradient(theta, _X, _X_N)
    ratio = float(true @ printed / (true @ true))
    with_itself = np.array([_X[0], _X_N, *_X[1:3]])  # X_n of S1, which contains x_n
    left = abs(_X_N - float(np.array([0.0, 1.0, 0.0, 0.0]) @ with_itself))
    ours = f"first component of ∇ℜ²: {true[0]:+.4f} m²; as printed: {printed[0]:+.4f} m²"
    if ratio > 0 or left > 0:
        return agrees(ours, ratio=ratio)
    return wrong_in_print(
        ours,
        f"θ − μ∇ with the printed ∇ is S4 with {ratio:+.0f} times its step; also, θ = (0, 1, 0, 0) always gives ℜ = 0, "
        "because X_n of S1 contains x_n",
        ratio=ratio,
    )


def e20() -> Result:
    """Return the result for erratum E20: the printed total ranging error and the largest error of Table II."""
    worst = largest_error(table_ii())
    ours = f"largest error {worst:.3f} m"
    if worst < 0.02:
        return agrees(ours, error_m=worst)
    return wrong_in_print(ours, f"Table II contains an error of {100 * worst:.0f} cm", error_m=worst)

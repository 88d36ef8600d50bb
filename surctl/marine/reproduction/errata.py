"""Compare the printed statement with the computed result for each of the errata E1–E21."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from math import cos, pi, sin, sqrt

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.marine.guidance.avoidance import avoidance_course, clearance_rate, encounter_side, printed_side
from surctl.marine.guidance.tracking import along_command, tracking_rate
from surctl.marine.reproduction.range_test import MEDIA, Medium, RangeTest, table_ii
from surctl.marine.reproduction.row import Item, Result, Word, agrees
from surctl.marine.sensing import SonarArray
from surctl.marine.sensing.ranging.filters import StepRule, lms_step
from surctl.marine.simulation import Finding, findings, load_scenario
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims
from surctl.marine.verification.avoidance_claims import settling_intrusion
from surctl.marine.verification.tracking_claims import cap_limit
from surctl.system.plant import runge_kutta
from surctl.tasks.task import planar_rotation
from surctl.verification import evaluate
from surctl.verification.setting import Setting

Vector = NDArray[np.float64]
Shown = tuple[bool, str, str, Mapping[str, float]]
"""Whether the computation shows the erratum, our result, the reason or counterexample, and the numbers by name."""

_ITEMS: list[Item] = []


def errata_items() -> list[Item]:
    """Return the comparisons for all errata; E8 has two, for the sign of ‖e‖²‖M‖ and for the diagonal of M."""
    return sorted(_ITEMS, key=lambda item: int(item.id[1:].partition("-")[0]))


def _erratum(
    name: str, what: str, paper: str, word: Word = "wrong in print"
) -> Callable[[Callable[[], Shown]], Callable[[], Shown]]:
    """Return a decorator that makes a row of a computation; `word` is the verdict if it shows the erratum."""

    def result(compute: Callable[[], Shown]) -> Result:
        shown, ours, why, numbers = compute()
        return Result(ours, word, why, numbers) if shown else agrees(ours, **numbers)

    def add(compute: Callable[[], Shown]) -> Callable[[], Shown]:
        _ITEMS.append(Item(name, "errata", what, paper, word, partial(result, compute)))
        return compute

    return add


def value(expression: ca.SX) -> float:
    """Return the numeric value of a CasADi SX expression that contains no symbols."""
    return float(ca.evalf(expression))


def _at_witness(name: str) -> tuple[float, bool, Mapping[str, float]]:
    """Return the margin of a claim at its first witness, whether the witness is in its domain, and the witness."""
    [claim] = claims(names=[name])
    return *evaluate(claim, claim.witnesses[0]), claim.witnesses[0]


def _trajectory(rate: ca.Function, start: Vector) -> Vector:
    """Return the states (k + 1, n) of ẋ = rate(x) from `start` (n,) over 120 s, by k = 2,400 steps of RK4."""
    x = ca.SX.sym("x", len(start))
    steps = ca.Function("step", [x], [runge_kutta(lambda x, _: rate(x), x, 0.05)]).mapaccum(2400)
    return np.vstack([start, np.asarray(steps(start), dtype=float).T])


_UNREADABLE: Word = "unreadable in our copy"
PRINTED_HULL = "sur540-flooded"  # the paper's hull of 540 mm


def _findings_of_hull(scenario: str) -> tuple[Finding, ...]:
    return tuple(findings(load_scenario(scenario), load_vehicle(PRINTED_HULL)))


@_erratum("E15", "clearance of the 0.54 m hull in the pool", "V-B: all obstacles passed")
def _pool() -> Shown:
    reported = [f for f in _findings_of_hull("pool-static") if f.level == "error"]
    distances = [(f.key == "path_m", f.clearance_m) for f in reported if f.clearance_m is not None]
    inside = max((-clearance for at_wall, clearance in distances if at_wall), default=0.0)
    near = min((clearance for at_wall, clearance in distances if not at_wall), default=np.inf)
    ours = f"the hull is {inside:.3f} m inside a wall and {near:.3f} m from an obstacle; {len(reported)} findings"
    numbers = {"inside_wall_m": inside, "off_obstacle_m": near}
    return inside > 0 and bool(np.isfinite(near)), ours, "; ".join(f.text for f in reported), numbers


@_erratum("E16", "depth of the hull", "IV-B: z = −0.15 m", "differs")
def _depth() -> Shown:
    above = load_scenario("tank-static").depth + load_vehicle(PRINTED_HULL)["radius"]
    reported = [f.text for f in _findings_of_hull("tank-static") if f.key == "depth_m"]
    ours = f"the top of the hull is {above:.2f} m above the water"
    return above > 0 and bool(reported), ours, "; ".join(reported[:1]), {"above_m": above}


def printed_obstacle_rate(speed: float, psi: float) -> tuple[float, float]:
    """Return the obstacle's velocity ẋ_OB, ẏ_OB [m/s] by equation (17) as printed in the paper."""
    return speed * cos(psi), -speed * sin(psi)


def printed_turn(acceleration: float, radius: float, time: float) -> float:
    """Return the angle σ_0 of equation (19) as our (damaged) copy of the paper reads: √((acceleration/radius)·time)."""
    return sqrt(acceleration / radius * time)


def mended_turn(acceleration: float, radius: float, time: float) -> float:
    """Return the corrected angle σ_0 = √(acceleration/radius)·time [rad] of equation (19) of the paper."""
    return sqrt(acceleration / radius) * time


def course(e2: ca.SX, phi: ca.SX, setting: Setting, *, delta: float = 0.0) -> ca.SX:
    """Return the desired course ψ_dm [rad] of equation (20) of the paper, with the obstacle on the side λ2 = +1."""
    return avoidance_course(
        "consistent",
        phi,
        e2,
        radius=ca.SX(setting.radius),
        side=ca.SX(1),
        delta=ca.SX(delta),
        k3=ca.SX(setting.k3),
        speed=ca.SX(setting.avoidance_speed),
        closing=ca.SX(0),
        kappa=ca.SX(setting.kappa),
        standoff=ca.SX(setting.standoff),
    )


def _final_distance(start: float, setting: Setting, *, delta: float = 0.0, closing: float = 0.0) -> float:
    """Return the distance e2 [m] to the safety circle after 120 s of avoidance by the paper's equation (20).

    The distance at the beginning is `start` [m]. The obstacle approaches head-on at the speed −`closing` [m/s].
    """
    e2 = ca.SX.sym("e2")
    turned = course(e2, ca.SX(0), setting, delta=delta)
    rate = clearance_rate(turned, ca.SX(0), speed=ca.SX(setting.avoidance_speed), closing=ca.SX(closing))
    f = ca.Function("rate", [e2], [rate])
    return float(_trajectory(f, np.array([start]))[-1, 0])


def inertial_motion(start: Vector, setting: Setting, acceleration: float) -> Vector:
    """Return position and velocity (k, 4) of a point mass that avoids the origin by equation (20) of the paper."""
    x = ca.SX.sym("x", 4)
    away = ca.sqrt(ca.sumsqr(x[:2]))
    turned = course(away - setting.radius, ca.atan2(-x[1], -x[0]), setting)
    desired = setting.avoidance_speed * ca.vertcat(ca.cos(turned), ca.sin(turned))
    pull = (desired - x[2:]) / 0.1  # [1/s] a velocity loop much faster than the thrust allows
    held = pull * ca.fmin(1, acceleration / ca.fmax(ca.sqrt(ca.sumsqr(pull)), 1e-9))
    f = ca.Function("rate", [x], [ca.vertcat(x[2:], held)])
    return _trajectory(f, start)


@_erratum("E1", "positive direction of angles", "(17): ẏ_OB = −u_OB sin ψ_OB")
def _direction() -> Shown:
    speed, psi = 0.15, pi / 4
    ours_y = value((planar_rotation(ca.SX(psi)) @ ca.vertcat(speed, 0.0))[1])
    printed_y = printed_obstacle_rate(speed, psi)[1]
    margin, _, point = _at_witness("v2-clockwise")
    why = "angles are clockwise in (17) and (22), but not in (2): with a clockwise angle, (20) gives "
    why += f"V̇2 = {margin:+.4f} m²/s at a bearing of {np.degrees(point['phi']):.0f}°"
    ours = f"at 45° and {speed} m/s, ẏ = {ours_y:+.4f} m/s by (2) and {printed_y:+.4f} m/s by (17)"
    shown = abs(ours_y - printed_y) >= 1e-9 and margin > 0
    return shown, ours, why, {"by_2": ours_y, "by_17": printed_y, "margin": margin}


@_erratum("E10", "rule for the side λ2", "III-C: λ2 depends on the range of φ")
def _side() -> Shown:
    rule, mended = set(), set()
    for k in range(360):
        phi = np.radians(k + 0.5)
        normal = ca.SX([cos(phi), sin(phi)])
        # the robot moves 20° to the left of the bearing, for every bearing
        velocity = 0.2 * ca.SX([cos(phi + pi / 9), sin(phi + pi / 9)])
        rule.add(int(value(printed_side(ca.SX(phi)))))
        mended.add(int(value(encounter_side(velocity, normal))))
    sides, right = (", ".join(f"{side:+d}" for side in sorted(each)) for each in (rule, mended))
    ours = f"side λ2 by the printed rule: {sides}; by the relative velocity: {right}"
    why = f"the printed rule selects the other side for the same encounter rotated by 180°: {sides}"
    return len(rule) > 1 and mended == {1}, ours, why, {"sides": float(len(rule))}


@_erratum("E11", "the safety distance δ", "(24): V̇2 ≤ 0 for δ")
def _offset() -> Shown:
    s = Setting()
    margin, inside, point = _at_witness("v2-printed")
    end = _final_distance(0.5, s, delta=s.delta)
    ours = f"V̇2 = {margin:+.5f} m²/s at e2 = {point['e2']:.3g} m; e2 converges to {end:.4f} m for δ = {s.delta} m"
    shown = margin > 0 and inside and end <= -1e-3
    return shown, ours, f"e2 converges to {end:.3f} m = −δ", {"margin": margin, "settles_m": end}


@_erratum("E12", "the obstacle's own velocity in V̇2", "(24): omitted")
def _approaching() -> Shown:
    s = Setting()
    end, formula = _final_distance(0.5, s, closing=-s.obstacle_speed), settling_intrusion(s)
    ours = f"e2 converges to {end:.4f} m; the formula −k3 R c/√(1 − c²) gives {formula:.4f} m"
    why = f"with u_OB = {s.obstacle_speed}, u_dm = {s.avoidance_speed} m/s, R_OB = {s.radius} m, the robot ends "
    why += f"{-end:.3f} m inside the circle"
    return end <= -1e-3 and abs(end - formula) <= 1e-3, ours, why, {"settles_m": end, "formula_m": formula}


@_erratum("E13", "whether V2 → 0 implies safety", "III-D: avoids obstacles effectively")
def _inertia() -> Shown:
    s, vehicle = Setting(), load_vehicle("sur540-flooded")
    acceleration = float(np.min(vehicle.thrust_limit[:2]) / np.max(vehicle.mass[:2]))
    begins = 0.3  # [m] less than the 0.46 m that it takes to stop
    ideal = _final_distance(begins, s)
    path = inertial_motion(np.array([-(s.radius + begins), -1e-3, s.avoidance_speed, 0.0]), s, acceleration)
    clearance = np.hypot(path[:, 0], path[:, 1]) - s.radius
    least, end = float(clearance.min()), float(clearance[-1])
    ours = f"without inertia e2 → {abs(ideal):.4f} m; with at most {acceleration:.3f} m/s² from e2 = {begins} m, "
    ours += f"e2 falls to {least:.3f} m"
    why = f"V2 → 0 means convergence to the circle, not that the robot stays outside: {vehicle.name} starts {begins} m "
    why += f"outside at {s.avoidance_speed} m/s and crosses the circle by {-least:.3f} m"
    numbers = {"ideal_m": ideal, "least_m": least, "end_m": end}
    return abs(ideal) <= 1e-3 and least <= -1e-3, ours, why, numbers


@_erratum("E17", "dimension of σ_0", "(19): √((a/R_OB)·t)", _UNREADABLE)
def _turn() -> Shown:
    a, radius, t, minute = 0.05, 0.5, 2.0, 60.0  # the angle must not depend on the unit of time
    read = printed_turn(a * minute**2, radius, t / minute) / printed_turn(a, radius, t)
    mended = mended_turn(a * minute**2, radius, t / minute) / mended_turn(a, radius, t)
    ours = f"in minutes instead of seconds, the printed σ_0 changes by × {read:.3f}, and √(a/R_OB)·t by × {mended:.3f}"
    return abs(read - 1) >= 1e-9 and abs(mended - 1) <= 1e-9, ours, "", {"as_read": read, "mended": mended}


# plausible readings [m], newest first, and the value to be predicted from them
_X = np.array([1.21, 1.18, 1.24, 1.20])
_X_N = 1.30


def largest_error(test: RangeTest) -> float:
    """Return the largest error |measured − desired| over both media of Table II [m]."""
    return max(float(np.max(np.abs(test.errors(medium)))) for medium in MEDIA)


def percent_at(medium: Medium, k: int) -> tuple[float, str]:
    """Return the relative error of a reading of Table II [%], and how it differs from the printed one, as text."""
    test = table_ii()
    exact, column = float(test.percent(medium)[k]), test.column(medium)
    read, true, printed = 100 * column.measured[k], 100 * test.desired[k], float(column.printed_percent[k])
    text = f"a reading of {read:.0f} cm at {true:.0f} cm in {medium} is an error of {exact:.1f} %, not {printed:.1f} %"
    return exact, text


def printed_step(x: Vector, residual: float) -> float:
    """Return the step size μ = gᵀg/(gᵀRg) [1/m²] as printed in step S5 of Algorithm 1, with g = Xℜ and R = XXᵀ."""
    g, R = x * residual, np.outer(x, x)
    return float(g @ g / (g @ R @ g))


def _residual_after(step: StepRule) -> float:
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


def _loss_gradient(theta: Vector, x: Vector, x_n: float) -> Vector:
    """Return the gradient (n,) [m²] of ℜ² = (x_n − θᵀX)² with respect to θ, by automatic differentiation."""
    symbol = ca.SX.sym("theta", len(theta))
    loss = (x_n - ca.dot(symbol, ca.SX(x))) ** 2
    return np.asarray(ca.Function("gradient", [symbol], [ca.gradient(loss, symbol)])(theta)).ravel()


def printed_gradient(theta: Vector, x: Vector, x_n: float) -> Vector:
    """Return the gradient ∇(ℜ) = +2ℜX (n,) [m²] as printed in step S3 of Algorithm 1."""
    printed: Vector = 2 * (x_n - theta @ x) * x
    return printed


@_erratum("E2", "a percentage of Table II", "Table II: 3.6 % at 85 cm in water")
def _percentage() -> Shown:
    test = table_ii()
    count, off = 2 * len(test.desired), [(medium, int(k)) for medium in MEDIA for k in test.disagreeing(medium)]
    if len(off) != 1:
        return False, f"{len(off)} of {count} percentages are wrong", "", {"disagreeing": float(len(off))}
    exact, why = percent_at(*off[0])
    numbers = {"percent": exact, "disagreeing": float(len(off))}
    return True, f"{exact:.3f} %; {len(off)} of {count} percentages is wrong", why, numbers


@_erratum("E3", "largest absolute error of Table II", "II-C: less than 4.5 cm", "differs")
def _largest() -> Shown:
    test = table_ii()
    worst = 100 * largest_error(test)
    percent = max(float(np.max(test.percent(medium))) for medium in MEDIA)
    why = f"the largest error in the table is {worst:.1f} cm; {percent:.1f} is its largest percentage"
    return abs(worst - 4.5) >= 0.1, f"largest error {worst:.1f} cm", why, {"error_cm": worst, "percent": percent}


@_erratum("E4", "resolution of the converter", "Table I: about 5 mm; II-B: 8-bit")
def _resolution() -> Shown:
    array = SonarArray()
    step, needed = 1e3 * array.resolution, int(np.ceil(np.log2(array.maximum / 0.005 + 1)))
    why = f"a range of {array.maximum:g} m in {array.bits} bits gives steps of {step:.2f} mm; 5 mm needs {needed} bits"
    return step > 5.5, f"{step:.2f} mm", why, {"step_mm": step, "bits_for_5_mm": float(needed)}


@_erratum("E5", "step size of Algorithm 1", "S5: μ = gᵀg/(gᵀRg), S4: θ + 2μℜX")
def _step() -> Shown:
    m = len(_X)
    printed, corrected = _residual_after("printed"), _residual_after("corrected")
    mu = printed_step(_X, _X_N - float(np.full(m, 1 / m) @ _X))
    trace, by_hand = mu * float(_X @ _X), 1 - 2 * mu * float(_X @ _X)
    ours = f"after one printed step: residual × {printed:.3f}; after half that step: residual × {abs(corrected):.3f}"
    why = f"each step changes ℜ to {printed:.3f} ℜ, and μ trR = {trace:.3f} is not below the printed bound of 1"
    shown = abs(printed) >= 1 and abs(printed - by_hand) <= 1e-9 and abs(corrected) < 1
    return shown, ours, why, {"printed": printed, "corrected": corrected, "mu_times_trace": trace}


@_erratum("E6", "the t in the step size of (6)", "(6): 2μtℜX", _UNREADABLE)
def _time() -> Shown:
    half = 0.5 * printed_step(_X, 1.0)  # the line-search optimum
    one, three = (1 - 2 * half * t * float(_X @ _X) for t in (1.0, 3.0))
    ours = f"with t as time, a step changes the residual by × {one:.2f} at 1 s and × {three:.2f} at 3 s, so it "
    ours += f"grows; without t, by × {one:.2f}"
    return abs(three) > 1, ours, "", {"at_1_s": one, "at_3_s": three}


@_erratum("E19", "gradient of Algorithm 1", "S3: ∇ = +2ℜX; S1: x_n in X_n")
def _gradient() -> Shown:
    theta = np.full(len(_X), 1.0 / len(_X))
    true, printed = _loss_gradient(theta, _X, _X_N), printed_gradient(theta, _X, _X_N)
    ratio = float(true @ printed / (true @ true))
    with_itself = np.array([_X[0], _X_N, *_X[1:3]])  # X_n of S1, which contains x_n
    left = abs(_X_N - float(np.array([0.0, 1.0, 0.0, 0.0]) @ with_itself))
    ours = f"first component of ∇ℜ²: {true[0]:+.4f} m²; as printed: {printed[0]:+.4f} m²"
    why = f"θ − μ∇ with the printed ∇ is S4 with {ratio:+.0f} times its step; also, θ = (0, 1, 0, 0) always gives "
    why += "ℜ = 0, because X_n of S1 contains x_n"
    return ratio <= 0 and left <= 0, ours, why, {"ratio": ratio}


@_erratum("E20", "total ranging error", "II-B: less than 0.02 m")
def _total() -> Shown:
    worst = largest_error(table_ii())
    why = f"Table II contains an error of {100 * worst:.0f} cm"
    return worst >= 0.02, f"largest error {worst:.3f} m", why, {"error_m": worst}


_AT = (0.1, 0.4, 0.2)  # x_e, y_e, z_e [m] at which expressions are compared
_TURN = 0.1  # γ̇_d [rad/s] at that point


def cross_track_rate(y_e: ca.SX, u: float, v: float, *, lookahead: float, course: bool) -> ca.SX:
    """Return the cross-track rate ẏ_e [m/s] on a straight path; equation (9) steers the heading or the course."""
    aim = -ca.atan2(y_e, lookahead)
    heading = aim - ca.atan2(v, u) if course else aim
    return (planar_rotation(heading) @ ca.vertcat(u, v))[1]


def loop_terms(setting: Setting) -> tuple[float, float, float]:
    """Return V̇1 [m²/s], the speed U_h [m/s] and √(y_e² + Δ_h²) [m] of the closed loop at the tracking errors `_AT`."""
    x_e, y_e, z_e = (ca.SX(v) for v in _AT)
    s = setting
    along = along_command(
        x_e, y_e, speed=ca.SX(s.speed), k1=ca.SX(s.k1), lookahead=ca.SX(s.lookahead), maximum=None, repaired=False
    )
    rate = tracking_rate(
        ca.vertcat(x_e, y_e, z_e),
        along,
        speed=ca.SX(s.speed),
        lookahead=ca.SX(s.lookahead),
        k2=ca.SX(s.k2),
        turn=ca.SX(_TURN),
    )
    slant = float(np.hypot(_AT[1], s.lookahead))
    return value(ca.dot(ca.vertcat(x_e, y_e, z_e), rate)), value(along) * slant / s.lookahead, slant


def first_line(setting: Setting, speed: float, *, factor: float) -> float:
    """Return the first line of equation (12) [m²/s] at the errors `_AT`, with U_h times `factor` (1 as printed)."""
    (x, y, z), s = _AT, setting
    return (-s.k1 * x + y * _TURN) * x + (-speed * factor - x * _TURN) * y - s.k2 * z * z


def quadratic_form(setting: Setting, middle: float, third: float) -> float:
    """Return −eᵀMe of equation (12) [m²/s] at the tracking errors `_AT`, for M = diag(k1, middle, third)."""
    x, y, z = _AT
    return -(setting.k1 * x * x + middle * y * y + third * z * z)


def followed_path(x: float, y: float) -> float:
    """Return the quantity T of equation (10) as printed in the paper."""
    return x + y


def printed_position_error(x: float, y: float, z: float) -> float:
    """Return the position error E_p as our copy of the paper reads: metres plus square metres.

    There the root ends after its first term.
    """
    return float(np.sqrt(x * x)) + y * y + z * z


@_erratum("E7", "heading or course in (9)", "(9): ẏ_e = U_h sin(ψ − γ_d) − x_e γ̇_d")
def _sway() -> Shown:
    s, y = Setting(), ca.SX.sym("y_e")
    u, v = s.speed, s.speed / 3
    ends = []
    for course in (False, True):
        rate = ca.Function("rate", [y], [cross_track_rate(y, u, v, lookahead=s.lookahead, course=course)])
        ends.append(float(_trajectory(rate, np.array([1.0]))[-1, 0]))
    (heading, course_end), left = ends, s.lookahead * v / u
    ours = f"y_e converges to {heading:.4f} m with heading control, to {abs(course_end):.4f} m with course control"
    why = f"with {v:.2f} m/s sway and {u:.2f} m/s surge, y_e stays at Δ_h v/u = {left:.4f} m"
    shown = abs(heading) >= 1e-3 and abs(course_end) <= 1e-3 and abs(heading - left) <= 1e-3
    return shown, ours, why, {"heading_m": heading, "course_m": course_end}


@_erratum("E8", "last inequality of (12)", "(12): −eᵀMe ≤ ‖e‖²‖M‖ ≤ 0")
def _norm() -> Shown:
    # also checks the corrected bound V̇1 ≤ −λ_min(M)‖e‖² at the tracking errors `_AT`
    margin, inside, _ = _at_witness("m-norm-printed")
    s = Setting()
    rate, speed, slant = loop_terms(s)
    least = min(s.k1, s.k2, speed / slant)
    bound = -least * float(np.sum(np.square(_AT)))
    ours = f"‖e‖²‖M‖ = {margin:.3g} m²/s at e = (1, 0, 0) m; V̇1 = {rate:.4f} ≤ −λ_min‖e‖² = {bound:.4f} at {_AT} m"
    why = f"‖e‖²‖M‖ = {margin:.3g} > 0 at e = (1, 0, 0) m"
    return margin > 0 and inside and rate <= bound, ours, why, {"margin": margin, "rate": rate, "bound": bound}


@_erratum("E8-diagonal", "M's third diagonal entry", "(12): U_h/√(y_e² + Δ_h²) twice", _UNREADABLE)
def _diagonal() -> Shown:
    s = Setting()
    rate, speed, slant = loop_terms(s)
    with_k2 = quadratic_form(s, speed / slant, s.k2)
    as_read = quadratic_form(s, speed / slant, speed / slant)
    ours = f"V̇1 = {rate:.5f} m²/s; −eᵀMe = {with_k2:.5f} m²/s with k2, {as_read:.5f} m²/s with the entry in our copy"
    shown = abs(rate - with_k2) <= 1e-12 and abs(rate - as_read) >= 1e-6
    return shown, ours, "", {"rate": rate, "with_k2": with_k2, "as_read": as_read}


@_erratum("E9", "the region with V̇1 ≤ 0", "(12): V̇1 ≤ 0 everywhere")
def _everywhere() -> Shown:
    (margin, inside, point), (far, far_inside, _) = _at_witness("v1-printed"), _at_witness("v1-speed-cap")
    region = cap_limit(Setting())[0]
    ours = f"V̇1 = {margin:+.4f} m²/s at a point; with the speed limit, V̇1 ≤ 0 only for x_e ≥ −{region:.3f} m"
    why = f"V̇1 = {margin:+.4f} m²/s at x_e = {point['x_e']:.3g}, y_e = {point['y_e']:.3g} m"
    shown = margin > 0 and far > 0 and inside and far_inside
    return shown, ours, why, {"margin": margin, "capped": far, "region_m": region}


@_erratum("E14", "the square root in E_p", "VI-B: E_p = √Δ… + …", _UNREADABLE)
def _root() -> Shown:
    x, y, z = 0.02, 0.06, 0.03
    used = float(np.sqrt(np.hypot(x, y) ** 2 + z**2))  # as `path_error_m` of a run
    whole, read = float(np.linalg.norm([x, y, z])), printed_position_error(x, y, z)
    ours = f"offset ({x}, {y}, {z}) m: {used:.4f} m with the root over all terms; {read:.4f} as our copy reads"
    return abs(used - whole) <= 1e-12 and abs(read - whole) >= 1e-6, ours, "", {"used_m": used, "as_read": read}


@_erratum("E18", "the two lines of (12)", "(12): both lines are equal")
def _lines() -> Shown:
    s = Setting()
    rate, speed, slant = loop_terms(s)
    printed, mended = first_line(s, speed, factor=1.0), first_line(s, speed, factor=_AT[1] / slant)
    second = quadratic_form(s, speed / slant, s.k2)
    ours = f"line 1 is {printed:.5f} m²/s, line 2 is {second:.5f} m²/s, and line 1 with y_e/√(y_e² + Δ_h²) is "
    ours += f"{mended:.5f} m²/s"
    why = f"the two lines differ by {abs(printed - second):.5f} m²/s at e = {_AT} m"
    shown = abs(printed - second) >= 1e-6 and abs(mended - second) <= 1e-12 and abs(rate - second) <= 1e-12
    return shown, ours, why, {"line_1": printed, "line_2": second}


@_erratum("E21", "definition of T in (10)", "(10): T = x + y")
def _quantity() -> Shown:
    one, other = (1.0, 2.0), (2.0, 1.0)
    first, second, apart = followed_path(*one), followed_path(*other), float(np.hypot(1.0, 1.0))
    ours = f"T{one} = {first:g} m and T{other} = {second:g} m for points {apart:.3f} m apart"
    why = f"T{one} = T{other} for points {apart:.3f} m apart"
    return first == second, ours, why, {"T": first, "apart_m": apart}

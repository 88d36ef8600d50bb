"""Errata of the paper's tracking law in section III-A (E7–E9, E18, E21) and of its position error E_p (E14)."""

from __future__ import annotations

import casadi as ca
import numpy as np

from surctl.marine.guidance.tracking import along_command, tracking_rate
from surctl.marine.reproduction.motion import trajectory, value
from surctl.marine.reproduction.row import Result, agrees, unreadable, wrong_in_print
from surctl.marine.simulation.metrics import path_error
from surctl.marine.verification import claims
from surctl.marine.verification.tracking_claims import cap_limit
from surctl.tasks.kinematics import planar_rotation
from surctl.verification import evaluate
from surctl.verification.setting import Setting

__all__ = ["e7", "e8", "e8_diagonal", "e9", "e14", "e18", "e21"]

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


def e7() -> Result:
    """Return the result for erratum E7: with sway and heading control, a cross-track error y_e remains."""
    s, y = Setting(), ca.SX.sym("y_e")
    u, v = s.speed, s.speed / 3
    ends = []
    for course in (False, True):
        rate = ca.Function("rate", [y], [cross_track_rate(y, u, v, lookahead=s.lookahead, course=course)])
        ends.append(float(trajectory(rate, np.array([1.0]), duration=120.0)[-1, 0]))
    heading, course_end = ends
    ours = f"y_e converges to {heading:.4f} m with heading control, to {abs(course_end):.4f} m with course control"
    if abs(heading) < 1e-3 or abs(course_end) > 1e-3 or abs(heading - s.lookahead * v / u) > 1e-3:
        return agrees(ours, heading_m=heading, course_m=course_end)
    return wrong_in_print(
        ours,
        f"with {v:.2f} m/s sway and {u:.2f} m/s surge, y_e stays at Δ_h v/u = {s.lookahead * v / u:.4f} m",
        heading_m=heading,
        course_m=course_end,
    )


def e8() -> Result:
    """Return the result for erratum E8: a point that violates ‖e‖²‖M‖ ≤ 0 in equation (12) of the paper.

    The function also checks the corrected bound V̇1 ≤ −λ_min(M)‖e‖² at the tracking errors `_AT`.
    """
    claim = claims(names=["m-norm-printed"])[0]
    margin, inside = evaluate(claim, claim.witnesses[0])
    s = Setting()
    rate, speed, slant = loop_terms(s)
    least = min(s.k1, s.k2, speed / slant)
    bound = -least * float(np.sum(np.square(_AT)))
    ours = f"‖e‖²‖M‖ = {margin:.3g} m²/s at e = (1, 0, 0) m; V̇1 = {rate:.4f} ≤ −λ_min‖e‖² = {bound:.4f} at {_AT} m"
    if margin <= 0 or not inside or rate > bound:
        return agrees(ours, margin=margin)
    return wrong_in_print(ours, f"‖e‖²‖M‖ = {margin:.3g} > 0 at e = (1, 0, 0) m", margin=margin, rate=rate, bound=bound)


def e8_diagonal() -> Result:
    """Return the result for erratum E8 on M: V̇1 = −eᵀMe holds if the third diagonal entry of M is k2."""
    s = Setting()
    rate, speed, slant = loop_terms(s)
    with_k2 = quadratic_form(s, speed / slant, s.k2)
    as_read = quadratic_form(s, speed / slant, speed / slant)
    ours = f"V̇1 = {rate:.5f} m²/s; −eᵀMe = {with_k2:.5f} m²/s with k2, {as_read:.5f} m²/s with the entry in our copy"
    if abs(rate - with_k2) > 1e-12 or abs(rate - as_read) < 1e-6:
        return agrees(ours)
    return unreadable(ours, rate=rate, with_k2=with_k2, as_read=as_read)


def e9() -> Result:
    """Return the result for erratum E9: a point with V̇1 > 0, and the region with V̇1 ≤ 0 under the speed limit."""
    s = Setting()
    printed, capped = claims(names=["v1-printed", "v1-speed-cap"])
    margin, inside = evaluate(printed, printed.witnesses[0])
    far, far_inside = evaluate(capped, capped.witnesses[0])
    region, point = cap_limit(s)[0], printed.witnesses[0]
    ours = f"V̇1 = {margin:+.4f} m²/s at a point; with the speed limit, V̇1 ≤ 0 only for x_e ≥ −{region:.3f} m"
    if margin <= 0 or far <= 0 or not (inside and far_inside):
        return agrees(ours, margin=margin)
    where = f"x_e = {point['x_e']:.3g}, y_e = {point['y_e']:.3g} m"
    return wrong_in_print(ours, f"V̇1 = {margin:+.4f} m²/s at {where}", margin=margin, capped=far, region_m=region)


def e14() -> Result:
    """Return the result for erratum E14: the position error E_p by √(Δx² + Δy² + Δz²) and by our copy's formula."""
    x, y, z = 0.02, 0.06, 0.03
    used = path_error(np.array([np.hypot(x, y)]), np.array([z]), np.array([False]))
    whole, read = float(np.linalg.norm([x, y, z])), printed_position_error(x, y, z)
    ours = f"offset ({x}, {y}, {z}) m: {used:.4f} m with the root over all terms; {read:.4f} as our copy reads"
    if abs(used - whole) > 1e-12 or abs(read - whole) < 1e-6:
        return agrees(ours, used=used)
    return unreadable(ours, used_m=used, as_read=read)


def e18() -> Result:
    """Return the result for erratum E18: the two lines of equation (12) of the paper differ at a point."""
    s = Setting()
    rate, speed, slant = loop_terms(s)
    printed, mended = first_line(s, speed, factor=1.0), first_line(s, speed, factor=_AT[1] / slant)
    second = quadratic_form(s, speed / slant, s.k2)
    ours = (
        f"line 1 is {printed:.5f} m²/s, line 2 is {second:.5f} m²/s, and line 1 with y_e/√(y_e² + Δ_h²) is "
        f"{mended:.5f} m²/s"
    )
    if abs(printed - second) < 1e-6 or abs(mended - second) > 1e-12 or abs(rate - second) > 1e-12:
        return agrees(ours)
    return wrong_in_print(
        ours,
        f"the two lines differ by {abs(printed - second):.5f} m²/s at e = {_AT} m",
        line_1=printed,
        line_2=second,
    )


def e21() -> Result:
    """Return the result for erratum E21: T = x + y of equation (10) is equal at two different points of the plane."""
    one, other = (1.0, 2.0), (2.0, 1.0)
    first, second, apart = followed_path(*one), followed_path(*other), float(np.hypot(1.0, 1.0))
    ours = f"T{one} = {first:g} m and T{other} = {second:g} m for points {apart:.3f} m apart"
    if first != second:
        return agrees(ours)
    return wrong_in_print(ours, f"T{one} = T{other} for points {apart:.3f} m apart", T=first, apart_m=apart)

"""Errata E1, E10–E13 and E17 of the paper's sections III-C and III-D on obstacle avoidance."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

import casadi as ca
import numpy as np

from surctl.marine.guidance.avoidance import avoidance_course, clearance_rate, encounter_side, printed_side
from surctl.marine.reproduction.motion import Vector, trajectory, value
from surctl.marine.reproduction.row import Result, agrees, unreadable, wrong_in_print
from surctl.marine.vehicle import load_vehicle
from surctl.marine.verification import claims
from surctl.marine.verification.avoidance_claims import settling_intrusion
from surctl.tasks.kinematics import planar_rotation
from surctl.verification import evaluate
from surctl.verification.setting import Setting

__all__ = ["e1", "e10", "e11", "e12", "e13", "e17"]


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


def final_distance(start: float, setting: Setting, *, delta: float = 0.0, closing: float = 0.0) -> float:
    """Return the distance e2 [m] to the safety circle after 120 s of avoidance by the paper's equation (20).

    The distance at the beginning is `start` [m]. The obstacle approaches head-on at the speed −`closing` [m/s].
    """
    e2 = ca.SX.sym("e2")
    turned = course(e2, ca.SX(0), setting, delta=delta)
    rate = clearance_rate(turned, ca.SX(0), speed=ca.SX(setting.avoidance_speed), closing=ca.SX(closing))
    f = ca.Function("rate", [e2], [rate])
    return float(trajectory(f, np.array([start]), duration=120.0)[-1, 0])


def inertial_motion(start: Vector, setting: Setting, acceleration: float) -> Vector:
    """Return position and velocity (k, 4) of a point mass that avoids the origin by equation (20) of the paper."""
    x = ca.SX.sym("x", 4)
    away = ca.sqrt(ca.sumsqr(x[:2]))
    turned = course(away - setting.radius, ca.atan2(-x[1], -x[0]), setting)
    desired = setting.avoidance_speed * ca.vertcat(ca.cos(turned), ca.sin(turned))
    pull = (desired - x[2:]) / 0.1  # [1/s] a velocity loop much faster than the thrust allows
    held = pull * ca.fmin(1, acceleration / ca.fmax(ca.sqrt(ca.sumsqr(pull)), 1e-9))
    f = ca.Function("rate", [x], [ca.vertcat(x[2:], held)])
    return trajectory(f, start, duration=120.0)


def e1() -> Result:
    """Return the result for erratum E1: equations (2) and (17) give different rates ẏ for the same speed and angle."""
    speed, psi = 0.15, pi / 4
    ours_y = value((planar_rotation(ca.SX(psi)) @ ca.vertcat(speed, 0.0))[1])
    printed_y = printed_obstacle_rate(speed, psi)[1]
    ours = f"at 45° and {speed} m/s, ẏ = {ours_y:+.4f} m/s by (2) and {printed_y:+.4f} m/s by (17)"
    if abs(ours_y - printed_y) < 1e-9:
        return agrees(ours)
    claim = claims(names=["v2-clockwise"])[0]
    margin, _ = evaluate(claim, claim.witnesses[0])
    if margin <= 0:
        return agrees(ours, margin=margin)
    return wrong_in_print(
        ours,
        f"angles are clockwise in (17) and (22), but not in (2): with a clockwise angle, (20) gives "
        f"V̇2 = {margin:+.4f} m²/s at a bearing of {np.degrees(claim.witnesses[0]['phi']):.0f}°",
        by_2=ours_y,
        by_17=printed_y,
        margin=margin,
    )


def e10() -> Result:
    """Return the result for erratum E10: the printed rule for the side λ2 depends on the compass direction."""
    rule, mended = set(), set()
    for k in range(360):
        phi = np.radians(k + 0.5)
        normal = ca.SX([cos(phi), sin(phi)])
        # the robot moves 20° to the left of the bearing, for every bearing
        velocity = 0.2 * ca.SX([cos(phi + pi / 9), sin(phi + pi / 9)])
        rule.add(int(value(printed_side(ca.SX(phi)))))
        mended.add(int(value(encounter_side(velocity, normal))))
    sides = ", ".join(f"{side:+d}" for side in sorted(rule))
    right = ", ".join(f"{side:+d}" for side in sorted(mended))
    ours = f"side λ2 by the printed rule: {sides}; by the relative velocity: {right}"
    if len(rule) == 1 or mended != {1}:
        return agrees(ours)
    return wrong_in_print(
        ours,
        f"the printed rule selects the other side for the same encounter rotated by 180°: {sides}",
        sides=float(len(rule)),
    )


def e11() -> Result:
    """Return the result for erratum E11: for δ > 0, V̇2 > 0 inside the safety circle, and the robot ends inside."""
    s = Setting()
    claim = claims(names=["v2-printed"])[0]
    margin, inside = evaluate(claim, claim.witnesses[0])
    end = final_distance(0.5, s, delta=s.delta)
    ours = (
        f"V̇2 = {margin:+.5f} m²/s at e2 = {claim.witnesses[0]['e2']:.3g} m; e2 converges to {end:.4f} m for "
        f"δ = {s.delta} m"
    )
    if margin <= 0 or not inside or end > -1e-3:
        return agrees(ours, margin=margin, settles_m=end)
    return wrong_in_print(ours, f"e2 converges to {end:.3f} m = −δ", margin=margin, settles_m=end)


def e12() -> Result:
    """Return the result for erratum E12: the robot enters the safety circle of a slower, approaching obstacle."""
    s = Setting()
    end, formula = final_distance(0.5, s, closing=-s.obstacle_speed), settling_intrusion(s)
    ours = f"e2 converges to {end:.4f} m; the formula −k3 R c/√(1 − c²) gives {formula:.4f} m"
    if end > -1e-3 or abs(end - formula) > 1e-3:
        return agrees(ours, settles_m=end)
    numbers = f"u_OB = {s.obstacle_speed}, u_dm = {s.avoidance_speed} m/s, R_OB = {s.radius} m"
    return wrong_in_print(
        ours, f"with {numbers}, the robot ends {-end:.3f} m inside the circle", settles_m=end, formula_m=formula
    )


def e13() -> Result:
    """Return the result for erratum E13: how close a robot without or with inertia comes to a resting obstacle."""
    s, vehicle = Setting(), load_vehicle("sur540-flooded")
    acceleration = float(np.min(vehicle.thrust_limit[:2]) / np.max(vehicle.mass[:2]))
    begins = 0.3  # [m] less than the 0.46 m that it takes to stop
    ideal = final_distance(begins, s)
    path = inertial_motion(np.array([-(s.radius + begins), -1e-3, s.avoidance_speed, 0.0]), s, acceleration)
    clearance = np.hypot(path[:, 0], path[:, 1]) - s.radius
    least, end = float(clearance.min()), float(clearance[-1])
    ours = (
        f"without inertia e2 → {abs(ideal):.4f} m; with at most {acceleration:.3f} m/s² from e2 = {begins} m, "
        f"e2 falls to {least:.3f} m"
    )
    if abs(ideal) > 1e-3 or least > -1e-3:
        return agrees(ours, ideal_m=ideal, least_m=least)
    return wrong_in_print(
        ours,
        f"V2 → 0 means convergence to the circle, not that the robot stays outside: {vehicle.name} starts {begins} m "
        f"outside at {s.avoidance_speed} m/s and crosses the circle by {-least:.3f} m",
        ideal_m=ideal,
        least_m=least,
        end_m=end,
    )


def e17() -> Result:
    """Return the result for erratum E17: the angle σ_0 must not depend on the unit of time (seconds or minutes)."""
    a, radius, t, minute = 0.05, 0.5, 2.0, 60.0
    read = printed_turn(a * minute**2, radius, t / minute) / printed_turn(a, radius, t)
    mended = mended_turn(a * minute**2, radius, t / minute) / mended_turn(a, radius, t)
    ours = f"in minutes instead of seconds, the printed σ_0 changes by × {read:.3f}, and √(a/R_OB)·t by × {mended:.3f}"
    if abs(read - 1) < 1e-9 or abs(mended - 1) > 1e-9:
        return agrees(ours)
    return unreadable(ours, as_read=read, mended=mended)

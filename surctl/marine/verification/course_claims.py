"""Claims about equation (9) of the paper: the effect of sway on a robot that steers by heading (erratum E7)."""

from __future__ import annotations

import casadi as ca

from surctl.tasks.kinematics import planar_rotation
from surctl.verification.claim import Claim, Motion, Variable
from surctl.verification.setting import Setting

__all__ = ["course_corrected", "course_printed"]


def _course(setting: Setting, *, corrected: bool) -> Claim:
    y_e, u, v = ca.SX.sym("y_e"), ca.SX.sym("u"), ca.SX.sym("v")
    aim = -ca.atan2(y_e, setting.lookahead)
    heading = aim - ca.atan2(v, u) if corrected else aim
    rate = (planar_rotation(heading) @ ca.vertcat(u, v))[1]  # (2), path along x: ẏ_e = U_h sin(χ − γ_d)
    promised = -ca.sqrt(u**2 + v**2) * y_e**2 / ca.sqrt(y_e**2 + setting.lookahead**2)
    half, u0, v0 = max(2.0, 4 * setting.lookahead), setting.speed, setting.speed / 3
    return Claim(
        name="course-corrected" if corrected else "course-printed",
        statement=(
            "y_e ẏ_e ≤ −U_h y_e²/√(y_e² + Δ²), steered by course: ψ = γ_d − β − atan(y_e/Δ), β = atan2(v, u)"
            if corrected
            else "y_e ẏ_e ≤ 0, steered by heading: ψ = γ_d − atan(y_e/Δ), whatever the sway v"
        ),
        equation="(9), (12)",
        errata=("E7",),
        expected="proved" if corrected else "refuted",
        variables=(
            Variable("y_e", y_e, "m", -half, half, "cross-track error, left positive"),
            Variable("u", u, "m/s", setting.speed / 3, setting.speed_max, "surge in {B}"),
            Variable("v", v, "m/s", -v0, v0, "sway in {B}"),
        ),
        left=y_e * rate,
        right=promised if corrected else ca.SX(0),
        unit="m^2/s",
        witnesses=({"y_e": 0.5 * setting.lookahead * v0 / u0, "u": u0, "v": v0},),
        motion=Motion({"y_e": rate}, y_e**2 / 2, "y_e^2/2", "m^2"),
    )


def course_printed(setting: Setting) -> Claim:
    """Return the refuted claim of the paper's equation (9) as printed, with the heading in place of the course.

    A sway speed v then leaves a cross-track error Δ_h v/u, where Δ_h is the lookahead distance and u the surge speed.
    """
    return _course(setting, corrected=False)


def course_corrected(setting: Setting) -> Claim:
    """Return the claim of the paper's equation (9) for course control; the heading command compensates the sideslip."""
    return _course(setting, corrected=True)

"""Claims about the avoidance law: the function V2 of the paper's equations (21)–(24), and a barrier function.

The position of an obstacle is given in polar coordinates about the robot: the distance is l = R_OB + e2, where R_OB is
the anti-collision radius, and the bearing φ is positive counter-clockwise (erratum E1). V2 is e2²/2. The claims use the
expression for the course that `surctl.marine.guidance.avoidance` implements.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from surctl.marine.guidance.avoidance import AvoidanceForm, avoidance_course, clearance_rate
from surctl.verification.claim import Claim, Motion, Variable
from surctl.verification.setting import Setting

_LEAST_SPEED = 0.02  # [m/s] lower bound of u_dm in the claims


@dataclass(frozen=True, eq=False)
class _Encounter:
    setting: Setting
    e2: ca.SX
    phi: ca.SX
    psi_ob: ca.SX
    u_ob: ca.SX
    u: ca.SX
    delta: ca.SX

    def course(self, form: AvoidanceForm, side: int) -> ca.SX:
        s = self.setting
        return avoidance_course(
            form, self.phi, self.e2, radius=ca.SX(s.radius), side=ca.SX(side), delta=self.delta, k3=ca.SX(s.k3),
            speed=self.u, closing=self.closing, kappa=ca.SX(s.kappa), standoff=ca.SX(s.standoff),
        )  # fmt: skip

    @property
    def closing(self) -> ca.SX:
        # [m/s] along the bearing; positive if the obstacle moves away
        return self.u_ob * ca.cos(self.psi_ob - self.phi)

    def rate(self, form: AvoidanceForm, side: int) -> ca.SX:
        # l̇ = ė2 [m/s], from (23)
        return clearance_rate(self.course(form, side), self.phi, speed=self.u, closing=self.closing)

    def worse(self, form: AvoidanceForm, factor: ca.SX) -> ca.SX:
        # the vehicle passes on either side of the obstacle: λ2 = ±1
        return ca.fmax(factor * self.rate(form, 1), factor * self.rate(form, -1))

    def claim(
        self, name: str, statement: str, form: AvoidanceForm, *, static: bool = True, clearance: bool = False,
        delta: tuple[float, float] = (0.0, 0.0), **entries: Any,
    ) -> Claim:  # fmt: skip
        # about the rate of V2, or of the clearance outside the radius
        watched = (self.e2, "l - R_OB", "m") if clearance else (self.e2**2 / 2, "V2", "m^2")
        # λ2 = +1; the speeds and the course of the obstacle are constant
        across = self.u_ob * ca.sin(self.psi_ob - self.phi) - self.u * ca.sin(self.course(form, 1) - self.phi)
        rates = {"e2": self.rate(form, 1), "phi": across / (self.setting.radius + self.e2)}
        return Claim(
            name, statement, variables=self.variables(static=static, delta=delta, outside=clearance),
            left=self.worse(form, ca.SX(-1) if clearance else self.e2), unit=f"{watched[2]}/s",
            motion=Motion(rates, *watched), **({"right": ca.SX(0)} | entries),
        )  # fmt: skip

    def variables(self, *, static: bool, delta: tuple[float, float], outside: bool) -> tuple[Variable, ...]:
        s = self.setting
        fastest = max(s.speed_max, s.avoidance_speed)
        moving = 0.0 if static else fastest
        return (
            Variable("e2", self.e2, "m", 0.0 if outside else -0.5 * s.radius, 2.0, "l - R_OB"),
            Variable("phi", self.phi, "rad", -np.pi, np.pi, "bearing of the obstacle in {E}"),
            Variable("psi_ob", self.psi_ob, "rad", -np.pi, np.pi, "course of the obstacle in {E}"),
            Variable("u_ob", self.u_ob, "m/s", 0.0, moving, "speed of the obstacle"),
            Variable("u", self.u, "m/s", _LEAST_SPEED, fastest, "speed of the robot"),
            Variable("delta", self.delta, "m", *delta, "delta of (20)"),
        )

    def point(
        self, *, e2: float, phi: float = 0.0, u_ob: float = 0.0, recede: bool = False, delta: float = 0.0
    ) -> dict[str, float]:
        # the obstacle approaches or recedes along the bearing
        course = phi if recede else phi + np.pi * (1 if phi <= 0 else -1)
        speed = self.setting.avoidance_speed
        return {"e2": e2, "phi": phi, "psi_ob": course, "u_ob": u_ob, "u": speed, "delta": delta}


def _encounter(setting: Setting) -> _Encounter:
    return _Encounter(setting, *(ca.SX.sym(name) for name in ("e2", "phi", "psi_ob", "u_ob", "u", "delta")))


def _rate_bound(e: _Encounter) -> ca.SX:
    # the right side of (24) [m²/s]
    return -e.u * e.e2**2 / ca.sqrt((e.setting.k3 * e.setting.radius) ** 2 + (e.e2 + e.delta) ** 2)


def v2_printed(setting: Setting) -> Claim:
    """Return the refuted claim V̇2 ≤ 0 of the paper's equation (24), for a static obstacle and safety distances δ ≥ 0.

    The claim is refuted because the robot comes as near to the obstacle as R_OB − δ, which is less than the
    anti-collision radius R_OB.
    """
    e = _encounter(setting)
    return e.claim(
        "v2-printed", "V̇2 ≤ 0, as (24) concludes, for a static obstacle and any δ ≥ 0", "consistent",
        equation="(20), (21), (24)", errata=("E11",), expected="refuted", delta=(0.0, 2 * setting.delta),
        witnesses=(e.point(e2=-setting.delta / 2, delta=setting.delta),),
    )  # fmt: skip


def v2_static(setting: Setting) -> Claim:
    """Return the claim of the paper's equation (24) for a static obstacle and δ e2 ≥ 0; then equation (24) holds.

    δ is the safety distance of equation (20), and e2 is the distance to the obstacle minus the anti-collision radius.
    """
    e = _encounter(setting)
    return e.claim(
        "v2-static", "V̇2 ≤ −2u/√(k3²R² + (e2 + δ)²) V2 for a static obstacle where δ e2 ≥ 0", "consistent",
        equation="(24)", errata=("E11",), expected="proved", delta=(-2 * setting.delta, 2 * setting.delta),
        right=_rate_bound(e), constraints=-e.delta * e.e2,
    )  # fmt: skip


def v2_obstacle(setting: Setting) -> Claim:
    """Return the refuted claim V̇2 ≤ 0 of the paper's equation (24), for a moving obstacle slower than the robot.

    The claim is refuted because a term is missing in equation (24) (erratum E12). The claim has the constraint δ e2 ≥
    0, which excludes the failure that erratum E11 describes.
    """
    e = _encounter(setting)
    obstacle = setting.obstacle_speed
    witnesses = (
        e.point(e2=0.6 * setting.radius, u_ob=obstacle, recede=True, delta=setting.delta),
        e.point(e2=-0.1 * setting.radius, u_ob=obstacle),
    )
    return e.claim(
        "v2-obstacle", "V̇2 ≤ 0, as (24) concludes, for an obstacle slower than the robot, where δ e2 ≥ 0", "consistent",
        equation="(17), (23), (24)", errata=("E12",), expected="refuted", static=False,
        delta=(-2 * setting.delta, 2 * setting.delta), constraints=ca.vertcat(-e.delta * e.e2, e.u_ob - e.u),
        witnesses=witnesses,
    )  # fmt: skip


def settling_intrusion(setting: Setting) -> float:
    """Return the equilibrium e2* < 0 [m] of the paper's equation (20) for an obstacle that approaches head-on.

    e2 is the distance from the robot to the centre of the obstacle, minus the anti-collision radius R_OB. Erratum E12:
    equation (24) omits the obstacle's velocity and concludes V̇2 ≤ 0 with V2 = e2²/2. In fact e2 converges to e2* < 0,
    so the robot ends inside the circle of radius R_OB. The obstacle's speed u_OB is less than the robot's speed u_dm.
    For the safety distance δ = 0, e2* = −k3 R_OB c/√(1 − c²) with c = u_OB/u_dm and the convergence coefficient k3.

    Example:
        >>> from surctl.verification import Setting
        >>> from surctl.marine.verification import settling_intrusion
        >>> round(settling_intrusion(Setting(radius=0.5, avoidance_speed=0.22, obstacle_speed=0.15)), 3)  # m inside
        -0.466
    """
    c = setting.obstacle_speed / setting.avoidance_speed
    return float(-setting.k3 * setting.radius * c / np.sqrt(1 - c**2))


def v2_clockwise(setting: Setting) -> Claim:
    """Return the refuted claim V̇2 ≤ 0 for the case that the paper's equation (2) uses a clockwise course angle.

    The course angle comes from equation (20); equations (17) and (22) define it as clockwise.
    """
    e = _encounter(setting)
    # at this bearing the printed course points 155° away from the obstacle; the angle of (20) is 45°, because ζ = 1
    phi = float(np.deg2rad(55.0))
    return e.claim(
        "v2-clockwise", "V̇2 ≤ 0 for a static obstacle and δ = 0, with (20)'s angle taken clockwise and used in (2)",
        "printed", equation="(2), (20), (22), (24)", errata=("E1", "E10"), expected="refuted",
        witnesses=(e.point(e2=setting.k3 * setting.radius, phi=phi),),
    )  # fmt: skip


def clearance_printed(setting: Setting) -> Claim:
    """Return the refuted claim that the clearance l − R_OB is a barrier function of the law as printed.

    l is the distance to a static obstacle, and R_OB the anti-collision radius. Under the law as printed, the robot hits
    static obstacles at some bearings.
    """
    e = _encounter(setting)
    return e.claim(
        "clearance-printed", "l̇ ≥ −κ(l − R_OB) where l ≥ R_OB, for a static obstacle and δ = 0, with (20) as printed",
        "printed", equation="(2), (20), (22)", errata=("E1", "E10", "E13"), expected="refuted", clearance=True,
        right=setting.kappa * e.e2, witnesses=(e.point(e2=0.0, phi=float(np.deg2rad(135.0))),),
    )  # fmt: skip


def clearance_corrected(setting: Setting) -> Claim:
    """Return the claim that h = l − R_OB − d_s is a barrier function of the corrected law if u_OB ≤ u − κ d_s.

    l is the distance to the obstacle, R_OB the anti-collision radius, d_s the standoff distance, u_OB the obstacle's
    speed, u the robot's speed and κ the barrier gain.
    """
    e = _encounter(setting)
    needed = e.u_ob + setting.kappa * setting.standoff
    return e.claim(
        "clearance-corrected",
        "ḣ ≥ −κh, h = l − R_OB − d_s, where l ≥ R_OB and u ≥ u_OB + κ d_s; obstacle at rest or not", "corrected",
        equation="corrected form of (20)", errata=("E1", "E10", "E12", "E13"), expected="proved", static=False,
        clearance=True, right=setting.kappa * (e.e2 - setting.standoff), constraints=needed - e.u,
    )  # fmt: skip

"""Claims about the avoidance law: V2 of (21)–(24), and the clearance as a barrier.

Robot and obstacle in polar coordinates about the robot: l = R_OB + e2, bearing φ counter-clockwise (E1).
Every course comes from the expressions that the law itself is built of (`surctl.guidance.avoidance`).
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from surctl.guidance.avoidance import AvoidanceForm, avoidance_course, clearance_rate
from surctl.verification.claim import Claim, Motion, Variable
from surctl.verification.setting import Setting

__all__ = [
    "clearance_corrected",
    "clearance_printed",
    "settling_intrusion",
    "v2_clockwise",
    "v2_obstacle",
    "v2_printed",
    "v2_static",
]

_LEAST_SPEED = 0.02  # [m/s] least u_dm of the claims


@dataclass(frozen=True, eq=False)
class _Encounter:
    """One robot and one obstacle, symbolic."""

    setting: Setting
    e2: ca.SX
    phi: ca.SX
    psi_ob: ca.SX
    u_ob: ca.SX
    u: ca.SX
    delta: ca.SX

    def course(self, form: AvoidanceForm, side: int) -> ca.SX:
        """ψ_dm [rad]."""
        s = self.setting
        return avoidance_course(
            form,
            self.phi,
            self.e2,
            radius=ca.SX(s.radius),
            side=ca.SX(side),
            delta=self.delta,
            k3=ca.SX(s.k3),
            speed=self.u,
            closing=self.closing,
            kappa=ca.SX(s.kappa),
            standoff=ca.SX(s.standoff),
        )

    @property
    def closing(self) -> ca.SX:
        """v_o·n [m/s]."""
        return self.u_ob * ca.cos(self.psi_ob - self.phi)

    def rate(self, form: AvoidanceForm, side: int) -> ca.SX:
        """l̇ = ė2 [m/s] of (23)."""
        return clearance_rate(self.course(form, side), self.phi, speed=self.u, closing=self.closing)

    def worse(self, form: AvoidanceForm, factor: ca.SX) -> ca.SX:
        """The larger of factor·l̇ for the two sides λ2 = ±1."""
        return ca.fmax(factor * self.rate(form, 1), factor * self.rate(form, -1))

    def motion(self, form: AvoidanceForm, *, clearance: bool) -> Motion:
        """l and φ under the law with λ2 = +1; the speeds and the obstacle's course are held."""
        across = self.u_ob * ca.sin(self.psi_ob - self.phi) - self.u * ca.sin(self.course(form, 1) - self.phi)
        rates = {"e2": self.rate(form, 1), "phi": across / (self.setting.radius + self.e2)}
        if clearance:
            return Motion(rates, self.e2, "l - R_OB", "m")
        return Motion(rates, self.e2**2 / 2, "V2", "m^2")

    def variables(self, *, static: bool, delta: tuple[float, float], outside: bool = False) -> tuple[Variable, ...]:
        """Box of the encounter; `outside` keeps to l ≥ R_OB, `static` holds the obstacle."""
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
        """A witness at the printed speed; the obstacle approaches along the bearing, or recedes."""
        course = phi if recede else phi + np.pi * (1 if phi <= 0 else -1)
        speed = self.setting.avoidance_speed
        return {"e2": e2, "phi": phi, "psi_ob": course, "u_ob": u_ob, "u": speed, "delta": delta}


def _encounter(setting: Setting) -> _Encounter:
    return _Encounter(setting, *(ca.SX.sym(name) for name in ("e2", "phi", "psi_ob", "u_ob", "u", "delta")))


def _rate_bound(e: _Encounter) -> ca.SX:
    """Right side of (24), −u_dm e2²/√(k3²R² + (e2 + δ)²) [m²/s]."""
    return -e.u * e.e2**2 / ca.sqrt((e.setting.k3 * e.setting.radius) ** 2 + (e.e2 + e.delta) ** 2)


def v2_printed(setting: Setting) -> Claim:
    """(24) for a static obstacle and δ > 0: the "safety" lets the robot in to R_OB − δ."""
    e = _encounter(setting)
    return Claim(
        name="v2-printed",
        statement="V̇2 ≤ 0, as (24) concludes, for a static obstacle and any δ ≥ 0",
        equation="(20), (21), (24)",
        errata=("E11",),
        expected="refuted",
        variables=e.variables(static=True, delta=(0.0, 2 * setting.delta)),
        left=e.worse("consistent", e.e2),
        right=ca.SX(0),
        unit="m^2/s",
        witnesses=(e.point(e2=-setting.delta / 2, delta=setting.delta),),
        motion=e.motion("consistent", clearance=False),
    )


def v2_static(setting: Setting) -> Claim:
    """(24) where it holds: static obstacle, δ e2 ≥ 0."""
    e = _encounter(setting)
    return Claim(
        name="v2-static",
        statement="V̇2 ≤ −2u/√(k3²R² + (e2 + δ)²) V2 for a static obstacle where δ e2 ≥ 0",
        equation="(24)",
        errata=("E11",),
        expected="proved",
        variables=e.variables(static=True, delta=(-2 * setting.delta, 2 * setting.delta)),
        left=e.worse("consistent", e.e2),
        right=_rate_bound(e),
        unit="m^2/s",
        constraints=-e.delta * e.e2,
        motion=e.motion("consistent", clearance=False),
    )


def v2_obstacle(setting: Setting) -> Claim:
    """(24) for a moving obstacle slower than the robot: the dropped term decides; δ e2 ≥ 0 keeps E11 out."""
    e = _encounter(setting)
    obstacle = setting.obstacle_speed
    return Claim(
        name="v2-obstacle",
        statement="V̇2 ≤ 0, as (24) concludes, for an obstacle slower than the robot, where δ e2 ≥ 0",
        equation="(17), (23), (24)",
        errata=("E12",),
        expected="refuted",
        variables=e.variables(static=False, delta=(-2 * setting.delta, 2 * setting.delta)),
        left=e.worse("consistent", e.e2),
        right=ca.SX(0),
        unit="m^2/s",
        constraints=ca.vertcat(-e.delta * e.e2, e.u_ob - e.u),
        witnesses=(
            e.point(e2=0.6 * setting.radius, u_ob=obstacle, recede=True, delta=setting.delta),
            e.point(e2=-0.1 * setting.radius, u_ob=obstacle),
        ),
        motion=e.motion("consistent", clearance=False),
    )


def settling_intrusion(setting: Setting) -> float:
    """e2* [m] < 0 where the law (20) settles before an obstacle that approaches head-on at u_OB < u_dm (E12).

    e2* = −k3 R_OB c/√(1 − c²), c = u_OB/u_dm, for δ = 0.

    Example:
        >>> from surctl.verification import Setting, settling_intrusion
        >>> round(settling_intrusion(Setting(radius=0.5, avoidance_speed=0.22, obstacle_speed=0.15)), 3)  # m inside
        -0.466
    """
    c = setting.obstacle_speed / setting.avoidance_speed
    return float(-setting.k3 * setting.radius * c / np.sqrt(1 - c**2))


def v2_clockwise(setting: Setting) -> Claim:
    """(20) with the clockwise angle of (17), (22) used in (2)."""
    e = _encounter(setting)
    # bearing at which the printed course points 155° off, on the 45° of (20) that ζ = 1 gives
    phi = float(np.deg2rad(55.0))
    return Claim(
        name="v2-clockwise",
        statement="V̇2 ≤ 0 for a static obstacle and δ = 0, with (20)'s angle taken clockwise and used in (2)",
        equation="(2), (20), (22), (24)",
        errata=("E1", "E10"),
        expected="refuted",
        variables=e.variables(static=True, delta=(0.0, 0.0)),
        left=e.worse("printed", e.e2),
        right=ca.SX(0),
        unit="m^2/s",
        witnesses=(e.point(e2=setting.k3 * setting.radius, phi=phi),),
        motion=e.motion("printed", clearance=False),
    )


def clearance_printed(setting: Setting) -> Claim:
    """The printed law as a barrier on the clearance: it flies into a static obstacle from some bearings."""
    e = _encounter(setting)
    return Claim(
        name="clearance-printed",
        statement="l̇ ≥ −κ(l − R_OB) where l ≥ R_OB, for a static obstacle and δ = 0, with (20) as printed",
        equation="(2), (20), (22)",
        errata=("E1", "E10", "E13"),
        expected="refuted",
        variables=e.variables(static=True, delta=(0.0, 0.0), outside=True),
        left=e.worse("printed", ca.SX(-1)),
        right=setting.kappa * e.e2,
        unit="m/s",
        witnesses=(e.point(e2=0.0, phi=float(np.deg2rad(135.0))),),
        motion=e.motion("printed", clearance=True),
    )


def clearance_corrected(setting: Setting) -> Claim:
    """The corrected law keeps h = l − R_OB − d_s a barrier, for obstacles up to u_OB = u − κ d_s."""
    e = _encounter(setting)
    needed = e.u_ob + setting.kappa * setting.standoff
    return Claim(
        name="clearance-corrected",
        statement="ḣ ≥ −κh, h = l − R_OB − d_s, where l ≥ R_OB and u ≥ u_OB + κ d_s; obstacle at rest or not",
        equation="corrected form of (20)",
        errata=("E1", "E10", "E12", "E13"),
        expected="proved",
        variables=e.variables(static=False, delta=(0.0, 0.0), outside=True),
        left=e.worse("corrected", ca.SX(-1)),
        right=setting.kappa * (e.e2 - setting.standoff),
        unit="m/s",
        constraints=needed - e.u,
        motion=e.motion("corrected", clearance=True),
    )

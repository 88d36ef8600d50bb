"""Claims about the tracking law: V1 of the paper's equations (11) and (12), the speed limit, and the norms in (12).

The claims use the expressions for the rates that `surctl.marine.guidance.tracking` implements. V1 is a Lyapunov
function of the tracking error e = (x_e, y_e, z_e).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from surctl.errors import NotApplicable
from surctl.marine.guidance.tracking import along_command, tracking_rate
from surctl.verification.claim import Claim, Motion, Variable, VerdictWord
from surctl.verification.setting import Setting

_LEAST_BOX = 2.0  # [m] half-width of the box of tracking errors, unless the claim needs more
_LEAST_CAP_BOX = 10.0  # [m] half-width of the box in the claims with a speed limit, unless the claim needs more


@dataclass(frozen=True, eq=False)
class _Loop:
    error: ca.SX
    turn: ca.SX
    along: ca.SX
    rate: ca.SX

    @property
    def v1(self) -> ca.SX:
        # V1 = ½‖e‖² [m²] of (11)
        return ca.sumsqr(self.error) / 2

    @property
    def v1_rate(self) -> ca.SX:
        # [m²/s], by the chain rule: the terms in γ̇_d must cancel
        return ca.dot(self.error, self.rate)

    def variables(self, half: float) -> tuple[Variable, ...]:
        names = ("x_e", "y_e", "z_e")
        meanings = ("along-track error, path frame", "cross-track error, left positive", "depth error, up positive")
        errors = [Variable(name, self.error[i], "m", -half, half, meanings[i]) for i, name in enumerate(names)]
        return (*errors, Variable("turn", self.turn, "rad/s", -0.5, 0.5, "turn rate of the path"))

    def claim(self, name: str, statement: str, expected: VerdictWord, half: float, **entries: Any) -> Claim:
        # by default that V1 does not grow, by (11) and (12), where its rate depends on erratum E9
        about: dict[str, Any] = {"equation": "(11), (12)", "errata": ("E9",), "left": self.v1_rate, "right": ca.SX(0)}
        about |= entries
        rates = {name: self.rate[i] for i, name in enumerate(("x_e", "y_e", "z_e"))}  # at a constant turn rate
        about.setdefault("motion", Motion(rates, self.v1, "V1", "m^2"))
        return Claim(name, statement, expected=expected, variables=self.variables(half), unit="m^2/s", **about)


def _loop(setting: Setting, *, repaired: bool, capped: bool = False) -> _Loop:
    error, turn = ca.SX.sym("e", 3), ca.SX.sym("turn")
    speed, lookahead, most = (ca.SX(x) for x in (setting.speed, setting.lookahead, setting.speed_max))
    along = along_command(
        error[0], error[1], speed=speed, k1=ca.SX(setting.k1), lookahead=lookahead,
        maximum=most if capped else None, repaired=repaired,
    )  # fmt: skip
    rate = tracking_rate(error, along, speed=speed, lookahead=lookahead, k2=ca.SX(setting.k2), turn=turn)
    return _Loop(error, turn, along, rate)


def _half(setting: Setting) -> float:
    # [m]; more than 2 m if V1 first increases farther from the target
    return max(_LEAST_BOX, 1.25 * 2 * setting.speed / setting.k1, 1.6 * _first_cross_track(setting))


def _first_cross_track(setting: Setting) -> float:
    """Return the least cross-track error |y_e| [m] at which a negative surge command can make V̇1 positive."""
    # reached at x_e = 2 v_d/k1
    return float(np.sqrt(4 * setting.speed * setting.lookahead / setting.k1))


def v1_printed(setting: Setting) -> Claim:
    """Return the refuted claim V̇1 ≤ 0 of the paper's equation (12) as printed (erratum E9).

    The surge command as printed may become negative; the term of V̇1 in the cross-track error y_e then becomes
    positive.
    """
    loop = _loop(setting, repaired=False)
    x, y = 2 * setting.speed / setting.k1, max(1.0, 1.25 * _first_cross_track(setting))
    witness = {"x_e": x, "y_e": y, "z_e": 0.0, "turn": 0.0}
    statement = "V̇1 ≤ 0 for every tracking error, with U_h = (U_d − k1 x_e) √(y_e² + Δ²)/Δ of either sign"
    return loop.claim("v1-printed", statement, "refuted", _half(setting), witnesses=(witness,))


def _regional_rate(setting: Setting, half: float) -> float:
    """Return c > 0 [1/s] such that V̇1 ≤ −c‖e‖² on the box |e_i| ≤ half, for the law with surge clipped at 0.

    e is the tracking error, and V1 the Lyapunov function of the paper's equation (11).
    """
    # For x_e ≤ q = v_d/(2 k1) the speed along the path is at least v_d/2, so every term of V̇1 has a quadratic bound.
    # For larger x_e, the term in x_e alone must dominate y_e². That term is concave in x_e beyond v_d/k1, so its least
    # value is at one of the two ends of the interval.
    q2 = (setting.speed / (2 * setting.k1)) ** 2
    return min(
        setting.k1,
        setting.k2,
        setting.speed / (2 * setting.lookahead),
        setting.k1 * q2 / (half**2 + q2),
        setting.speed * half / (2 * half**2),
    )


def v1_corrected(setting: Setting) -> Claim:
    """Return the claim of the paper's equation (12) with a surge command ≥ 0: V1 decreases strictly in a box of errors.

    The rate of decrease depends on the size of the box.
    """
    loop, half = _loop(setting, repaired=True), _half(setting)
    c = _regional_rate(setting, half)
    statement = f"V̇1 ≤ −{c:.3g} ‖e‖² for |e_i| ≤ {half:g} m, with U_h = max(0, ·) and no speed cap"
    return loop.claim("v1-corrected", statement, "proved", half, right=-c * ca.sumsqr(loop.error))


def cap_limit(setting: Setting) -> tuple[float, float]:
    """Return the point (|x_e|, |y_e|) [m] nearest to the target at which the speed limit can make V1 grow.

    The point lies behind the target. V1 is the Lyapunov function of the paper's equation (11).

    Raises:
        NotApplicable: the speed limit is not above the cruise speed.
    """
    top, v, ahead = setting.speed_max, setting.speed, setting.lookahead
    if top <= v:
        raise NotApplicable(
            f"the speed limit of {top:g} m/s is not above the cruise speed of {v:g} m/s, and the tracking claims do "
            "not cover a robot that cannot catch up with its target",
            to="these speeds",
        )
    # With s = √(y_e² + Δ²), V1 grows if |x_e| > U (s² − Δ²)/(s v_d − U Δ). The bound on |x_e| is least at
    # s = Δ (U + √(U² − v_d²))/v_d, where the bound is 2 U s/v_d.
    s = ahead * (top + np.sqrt(top**2 - v**2)) / v
    return float(2 * top * s / v), float(np.sqrt(s**2 - ahead**2))


def v1_speed_cap(setting: Setting) -> Claim:
    """Return the refuted claim V̇1 ≤ 0 of the paper's equation (12) for a commanded speed 0 ≤ U_h ≤ U_max.

    The claim is refuted because the speed limit U_max makes V1 grow far behind the target.
    """
    loop = _loop(setting, repaired=True, capped=True)
    x, y = cap_limit(setting)
    statement = f"V̇1 ≤ 0 for every tracking error, with 0 ≤ U_h ≤ {setting.speed_max:g} m/s"
    witness = {"x_e": -1.2 * x, "y_e": y, "z_e": 0.0, "turn": 0.0}
    return loop.claim("v1-speed-cap", statement, "refuted", max(_LEAST_CAP_BOX, 2 * x), witnesses=(witness,))


def v1_speed_cap_region(setting: Setting) -> Claim:
    """Return the claim V̇1 ≤ 0 of the paper's equation (12) for a robot not too far behind its target (erratum E9)."""
    loop = _loop(setting, repaired=True, capped=True)
    x, _ = cap_limit(setting)
    half = max(_LEAST_CAP_BOX, 2 * x)
    statement = f"V̇1 ≤ 0 where x_e ≥ −{x:.3g} m, with 0 ≤ U_h ≤ {setting.speed_max:g} m/s"
    return loop.claim("v1-speed-cap-region", statement, "proved", half).on({"x_e": (-x, half)})


def _norm_of_m(setting: Setting, loop: _Loop) -> tuple[ca.SX, ca.SX]:
    # diagonal of M in (12) [1/s], with k2 as the third entry (E8)
    middle = loop.along / setting.lookahead  # U_h/√(y_e² + Δ²)
    least = ca.fmin(ca.fmin(setting.k1, setting.k2), middle)
    return least, ca.fmax(ca.fmax(setting.k1, setting.k2), ca.fabs(middle))


def m_norm_printed(setting: Setting) -> Claim:
    """Return the refuted claim ‖e‖²‖M‖ ≤ 0, the last step of the paper's equation (12) (erratum E8).

    e is the tracking error, and M is the diagonal matrix of equation (12).
    """
    loop = _loop(setting, repaired=True)
    return loop.claim(
        "m-norm-printed", "−eᵀMe ≤ ‖e‖²‖M‖ ≤ 0: the last step says ‖e‖²‖M‖ ≤ 0", "refuted", _half(setting),
        equation="(12)", errata=("E8",), left=ca.sumsqr(loop.error) * _norm_of_m(setting, loop)[1],
        witnesses=({"x_e": 1.0, "y_e": 0.0, "z_e": 0.0, "turn": 0.0},), motion=None,
    )  # fmt: skip


def m_norm_corrected(setting: Setting) -> Claim:
    """Return the corrected claim of the paper's equation (12): V̇1 ≤ −λ_min(M)‖e‖² ≤ 0 where U_h ≥ 0.

    e is the tracking error, M the diagonal matrix of equation (12), and U_h the commanded speed.
    """
    loop = _loop(setting, repaired=False)
    right = -ca.fmax(_norm_of_m(setting, loop)[0], 0) * ca.sumsqr(loop.error)
    return loop.claim(
        "m-norm-corrected", "V̇1 ≤ −λ_min(M)‖e‖² ≤ 0 where U_h ≥ 0", "proved", _half(setting),
        equation="(12)", errata=("E8", "E9"), right=right, constraints=-loop.along,
    )  # fmt: skip

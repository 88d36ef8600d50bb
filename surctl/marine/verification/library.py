"""The library of claims: the paper's claims about V1, V2 and the course, and which claims apply to a vehicle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import casadi as ca

from surctl.errors import InputError, NotApplicable, nearest
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import avoidance_claims as avoidance
from surctl.marine.verification import braking_claims as braking
from surctl.marine.verification import tracking_claims as tracking
from surctl.marine.verification.assumptions import check_sway_force
from surctl.tasks.task import planar_rotation
from surctl.verification.claim import Claim, Motion, Variable
from surctl.verification.setting import Setting, setting_from


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


def _course_printed(setting: Setting) -> Claim:
    """Return the refuted claim of the paper's equation (9) as printed, with the heading in place of the course.

    A sway speed v then leaves a cross-track error Δ_h v/u, where Δ_h is the lookahead distance and u the surge speed.
    """
    return _course(setting, corrected=False)


def _course_corrected(setting: Setting) -> Claim:
    """Return the claim of the paper's equation (9) for course control; the heading command compensates the sideslip."""
    return _course(setting, corrected=True)


_BUILDERS: Mapping[str, Callable[[Setting], Claim]] = {
    build.__name__.strip("_").replace("_", "-"): build
    for build in (
        tracking.v1_printed,
        tracking.v1_corrected,
        tracking.v1_speed_cap,
        tracking.v1_speed_cap_region,
        _course_printed,
        _course_corrected,
        tracking.m_norm_printed,
        tracking.m_norm_corrected,
        avoidance.v2_printed,
        avoidance.v2_static,
        avoidance.v2_obstacle,
        avoidance.v2_clockwise,
        avoidance.clearance_printed,
        avoidance.clearance_corrected,
    )
}

_BRAKING: Mapping[str, Callable[[Vehicle, float], Claim]] = {
    "braking-keeps": braking.braking_keeps,
    "braking-retreat": braking.braking_retreat,
    "braking-mass": braking.braking_mass,
}
VEHICLE = "sur540-flooded"


def claims(
    gains: Mapping[str, float] | None = None, names: Sequence[str] | None = None, *, vehicle: Vehicle | None = None
) -> tuple[Claim, ...]:
    """Return the named claims, or all claims, for the given gains.

    Args:
        gains: gain values by name. Only gains that are fields of `Setting` are used; `speed` is the cruise speed,
            `speed_max` the speed limit. If `gains` is None, the default setting is used.
        names: names of the claims, in the desired order; None returns all claims.
        vehicle: the vehicle to which the braking claims refer; if it is None, the vehicle sur540-flooded is used.

    Raises:
        InputError: the name of a claim is unknown (the error proposes the nearest known name), or a gain is not
            positive.
        NotApplicable: the vehicle violates an assumption of a claim.

    Example:
        >>> from surctl.marine.verification import claims
        >>> [claim.name for claim in claims()][:4]
        ['v1-printed', 'v1-corrected', 'v1-speed-cap', 'v1-speed-cap-region']
        >>> [claim] = claims({"k1": 0.3, "lookahead": 0.8}, ["m-norm-corrected"])
        >>> print(claim.statement, claim.equation, claim.errata, claim.expected)
        V̇1 ≤ −λ_min(M)‖e‖² ≤ 0 where U_h ≥ 0 (12) ('E8', 'E9') proved
    """
    applicable, refused = applicable_claims(gains, names, vehicle=vehicle)
    for reason in refused.values():
        raise reason
    return applicable


def applicable_claims(
    gains: Mapping[str, float] | None = None,
    names: Sequence[str] | None = None,
    *,
    vehicle: Vehicle | None = None,
    errata: bool = True,
) -> tuple[tuple[Claim, ...], Mapping[str, NotApplicable]]:
    """Return the claims that apply to the vehicle and, by name, the reason why each of the other claims does not apply.

    A reason is the `NotApplicable` error of the claim. The arguments are those of `claims`; without `errata` and
    without names, claims of the paper that are expected to be refuted are left out.

    Example:
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.library import applicable_claims
        >>> found, refused = applicable_claims(names=["course-corrected", "braking-mass"],
        ...                                    vehicle=load_vehicle("bluerov2-wu"))
        >>> [claim.name for claim in found], refused["braking-mass"].because[:40]
        (['course-corrected'], 'm11 = 17 kg and m22 = 24.2 kg differ and')
    """
    setting = setting_from(gains)
    known = [*_BUILDERS, *_BRAKING]
    applicable: list[Claim] = []
    refused: dict[str, NotApplicable] = {}
    for name in known if names is None else names:
        if name not in known:
            raise InputError("unknown claim", key="claim", value=name, remedy=nearest(name, known))
        try:
            if vehicle is not None:
                check_sway_force(vehicle)
            applicable.append(
                _BUILDERS[name](setting)
                if name in _BUILDERS
                else _BRAKING[name](vehicle or load_vehicle(VEHICLE), setting.fastest)
            )
        except NotApplicable as reason:
            refused[name] = NotApplicable(reason.because, to=reason.to, key=name)
    if names is None and not errata:
        applicable = [claim for claim in applicable if claim.expected == "proved"]
    return tuple(applicable), refused

"""The library of claims: what the paper says of V1, V2 and the course, as printed and as corrected; braking."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from surctl.errors import InputError, nearest
from surctl.vehicle import Vehicle, load_vehicle
from surctl.verification import avoidance_claims as avoidance
from surctl.verification import braking_claims as braking
from surctl.verification import course_claims as course
from surctl.verification import tracking_claims as tracking
from surctl.verification.claim import Claim
from surctl.verification.setting import Setting, setting_from

__all__ = ["claims"]

_BUILDERS: tuple[Callable[[Setting], Claim], ...] = (
    tracking.v1_printed,
    tracking.v1_corrected,
    tracking.v1_speed_cap,
    tracking.v1_speed_cap_region,
    course.course_printed,
    course.course_corrected,
    tracking.m_norm_printed,
    tracking.m_norm_corrected,
    avoidance.v2_printed,
    avoidance.v2_static,
    avoidance.v2_obstacle,
    avoidance.v2_clockwise,
    avoidance.clearance_printed,
    avoidance.clearance_corrected,
)

_BRAKING: Mapping[str, Callable[[Vehicle], Claim]] = {
    "braking-keeps": braking.braking_keeps,
    "braking-retreat": braking.braking_retreat,
    "braking-mass": braking.braking_mass,
}
VEHICLE = "sur540-flooded"


def claims(
    gains: Mapping[str, float] | None = None, names: Sequence[str] | None = None, *, vehicle: Vehicle | None = None
) -> tuple[Claim, ...]:
    """The claims of that name, or all of them, for these gains.

    Args:
        gains: values by name; those of `Setting` are used, the rest passed over. None takes the defaults.
        names: which claims, in this order; None takes all.
        vehicle: of the claims about braking; None takes sur540-flooded.

    Raises:
        InputError: an unknown claim, with the nearest known name; a gain that is not positive.

    Example:
        >>> from surctl.verification import claims
        >>> [claim.name for claim in claims()][:4]
        ['v1-printed', 'v1-corrected', 'v1-speed-cap', 'v1-speed-cap-region']
        >>> [claim] = claims({"k1": 0.3, "lookahead": 0.8}, ["m-norm-corrected"])
        >>> print(claim.statement, claim.equation, claim.errata, claim.expected)
        V̇1 ≤ −λ_min(M)‖e‖² ≤ 0 where U_h ≥ 0 (12) ('E8', 'E9') proved
    """
    setting = setting_from(gains)
    everything = {claim.name: claim for claim in (build(setting) for build in _BUILDERS)}
    wanted = [*everything, *_BRAKING] if names is None else names
    if any(name in _BRAKING for name in wanted):
        braked = vehicle or load_vehicle(VEHICLE)
        everything |= {name: build(braked) for name, build in _BRAKING.items()}
    for name in names or ():
        if name not in everything:
            raise InputError("unknown claim", key="claim", value=name, remedy=nearest(name, [*everything, *_BRAKING]))
    return tuple(everything[name] for name in wanted)

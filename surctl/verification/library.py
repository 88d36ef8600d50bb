"""The library of claims: what the paper says of V1, V2 and the course, as printed and as corrected; braking."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from surctl.control import Gains, load_gains
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

_BRAKING: Mapping[str, Callable[[Vehicle, Gains], Claim]] = {
    "braking-keeps": braking.braking_keeps,
    "braking-range": braking.braking_range,
    "braking-bound": braking.braking_bound,
}
_BRAKING_GAINS = ("margin", "reaction", "brake")
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
    """
    setting = setting_from(gains)
    everything = {claim.name: claim for claim in (build(setting) for build in _BUILDERS)}
    wanted = [*everything, *_BRAKING] if names is None else names
    if any(name in _BRAKING for name in wanted):
        told = {name: value for name, value in (gains or {}).items() if name in _BRAKING_GAINS}
        law, braked = load_gains("default").with_values(told), vehicle or load_vehicle(VEHICLE)
        everything |= {name: build(braked, law) for name, build in _BRAKING.items()}
    for name in names or ():
        if name not in everything:
            raise InputError("unknown claim", key="claim", value=name, remedy=nearest(name, [*everything, *_BRAKING]))
    return tuple(everything[name] for name in wanted)

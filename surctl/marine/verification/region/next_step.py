"""What is proved where a region claim is not: a stronger claim, which proves it too, or a weaker one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

from surctl.marine.verification.region.claim import RegionClaim
from surctl.marine.verification.region.statement import RegionStatement
from surctl.marine.verification.region.turning import TurningClaim

__all__ = ["Weaker", "implies", "shorter", "weaker"]

_RANGES = frozenset({"mass_factor", "drag_factor"})
_RANGES_OF_CRUISE = frozenset({"mass", "linear", "quadratic", "lag"})
_AT_LEAST = frozenset(
    {"mass_asymmetry", "drag_asymmetry", "asymmetry", "yaw_rate", "rate", "current", "force", "place_error",
     "velocity_error", "curvature", "heave", "turn_rate", "rest"}
)  # fmt: skip
_LABELS = frozenset({"name", "digests"})
_TRIED = 16  # largest number of start values of the search for a weaker claim
_CURRENTS = {
    "current_m_per_s": "a current of at most {:.3g} m/s",
    "force_n": "a disturbance force of at most {:.3g} N",
    "yaw_rate_rad_per_s": "a yaw rate of at most {:.3g} rad/s",
}


def implies(strong: RegionClaim | TurningClaim, weak: RegionClaim | TurningClaim) -> bool:
    """Return whether a proof of one claim about a cruise also proves another one about the same loop.

    The ranges of `strong` contain those of `weak`, its disturbances and its decay rate are at least as large, its
    thrust is at most as large, and everything else is equal.
    """
    if type(strong) is not type(weak):
        return False
    ranges = _RANGES | (_RANGES_OF_CRUISE if isinstance(strong, RegionClaim) else frozenset())
    for key in (field.name for field in fields(strong)):
        a: Any = getattr(strong, key)
        b: Any = getattr(weak, key)
        if key in ranges:
            good = a[0] <= b[0] and b[1] <= a[1]
        elif key in _AT_LEAST:
            good = bool(np.all(np.asarray(a) >= b))
        elif key == "thrust":
            good = bool(np.all(np.asarray(a) <= b))
        else:
            good = key in _LABELS or a == b
        if not good:
            return False
    return True


def shorter(statement: RegionStatement) -> RegionStatement:
    """Return the statement with a short search."""
    return statement.model_copy(update={"attempts": min(statement.attempts, _TRIED)})


class Weaker(NamedTuple):
    """A weaker claim: what is assumed or demanded instead, in words, the statement, and its speeds [m/s]."""

    words: str
    statement: RegionStatement
    cruise: float
    cap: float


def weaker(statement: RegionStatement, *, cruise: float | None, cap: float | None) -> Iterator[Weaker]:
    """Yield weaker claims than a statement about a cruise, each with one assumption changed and a short search."""
    own = {"cruise_m_per_s", "cap_m_per_s"} & statement.model_fields_set
    speed = statement.cruise_m_per_s if cruise is None or own else cruise
    most = statement.cap_m_per_s if cap is None or own else cap

    def changed(words: str, slower: float = 1.0, /, **changes: Any) -> Weaker:
        slow = {"cruise_m_per_s": slower * speed, "cap_m_per_s": slower * most} if own else {}
        one = shorter(statement).model_copy(update={**changes, **slow})
        return Weaker(words, one, slower * speed, slower * most)

    if statement.at_rest:
        yield changed("without a start at rest", at_rest=False)
    yield changed(f"at a decay rate of {statement.rate_per_s / 4:.3g}/s", rate_per_s=statement.rate_per_s / 4)
    if not statement.ranges and statement.share + statement.mass_share * (statement.loop == "turning") > 0:
        turning = statement.loop == "turning"
        halves = ("share", "asymmetry", *(("mass_share", "mass_asymmetry") if turning else ()))
        masses = statement.mass_share if turning else statement.share
        words = f"with masses off by up to {masses / 2:.3g} and drag by up to {statement.share / 2:.3g} of their values"
        yield changed(words, **{key: getattr(statement, key) / 2 for key in halves})
    for key, words in _CURRENTS.items():
        value = getattr(statement, key)
        late = statement.lagged or statement.sampled
        if value > 0 and (key != "yaw_rate_rad_per_s" or (late and not statement.spinning)):
            yield changed(f"with {words.format(value / 2)}", **{key: value / 2})
    for key, words in (("lagged", "without thrust lag"), ("sampled", "with commands that are not held")):
        if getattr(statement, key):
            yield changed(words, **{key: False})
    for share in (0.75, 0.5):
        yield changed(f"at a cruise speed of {share * speed:.3g} m/s", share)

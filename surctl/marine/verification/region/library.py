"""The library of region claims: the first that applies, why others are refused, stronger and weaker claims."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from surctl.errors import InputError, NotApplicable, nearest
from surctl.files import read_toml
from surctl.marine.control import Gains, build_law
from surctl.marine.guidance import Guidance
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.region.proof import RegionProof, prove_steering, prove_turning
from surctl.marine.verification.region.statement import RegionStatement
from surctl.marine.verification.region.steering import SteeringClaim
from surctl.marine.verification.region.turning import TurningClaim
from surctl.units import towards

AnyClaim: TypeAlias = TurningClaim | SteeringClaim

_RANGES = frozenset({"mass_factor", "drag_factor"})
_AT_LEAST = frozenset(
    {"mass_asymmetry", "drag_asymmetry", "yaw_rate", "rate", "current", "force", "place_error",
     "velocity_error", "curvature", "heave", "turn_rate", "rest"}
)  # fmt: skip
_LABELS = frozenset({"name", "digests"})
_TRIED = 16  # largest number of start values of the search for a weaker claim
_CURRENTS = {
    "current_m_per_s": "a current of at most {:.3g} m/s",
    "force_n": "a disturbance force of at most {:.3g} N",
    "yaw_rate_rad_per_s": "a yaw rate of at most {:.3g} rad/s",
}


def implies(strong: TurningClaim, weak: TurningClaim) -> bool:
    """Return whether a proof of one claim about a cruise also proves another one about the same loop.

    The ranges of `strong` contain those of `weak`, its disturbances and its decay rate are at least as large, its
    thrust is at most as large, and everything else is equal.
    """
    for key in (field.name for field in fields(strong)):
        a: Any = getattr(strong, key)
        b: Any = getattr(weak, key)
        if key in _RANGES:
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


def _shorter(statement: RegionStatement) -> RegionStatement:
    """Return the statement with a short search; that of craft without sway force searches only once."""
    if statement.loop == "steered":
        return statement
    return statement.model_copy(update={"attempts": min(statement.attempts, _TRIED)})


class _Weaker(NamedTuple):
    """A weaker claim: what is assumed or demanded instead, in words, the statement, and its speeds [m/s]."""

    words: str
    statement: RegionStatement
    cruise: float
    cap: float


def _weaker(statement: RegionStatement, *, cruise: float | None, cap: float | None) -> Iterator[_Weaker]:
    """Yield weaker claims than a statement about a cruise, each with one assumption changed and a short search."""
    own = {"cruise_m_per_s", "cap_m_per_s"} & statement.model_fields_set
    speed = statement.cruise_m_per_s if cruise is None or own else cruise
    most = statement.cap_m_per_s if cap is None or own else cap

    def changed(words: str, slower: float = 1.0, /, **changes: Any) -> _Weaker:
        slow = {"cruise_m_per_s": slower * speed, "cap_m_per_s": slower * most} if own else {}
        one = _shorter(statement).model_copy(update={**changes, **slow})
        return _Weaker(words, one, slower * speed, slower * most)

    if statement.at_rest:
        yield changed("without a start at rest", at_rest=False)
    yield changed(f"at a decay rate of {statement.rate_per_s / 4:.3g}/s", rate_per_s=statement.rate_per_s / 4)
    apart = statement.loop in ("turning", "steered")  # masses have an error of their own
    if not statement.ranges and statement.share + statement.mass_share * apart > 0:
        halves = ("share", *(("mass_share",) if apart else ()))
        halves += {"turning": ("asymmetry", "mass_asymmetry"), "cruise": ("asymmetry",)}.get(statement.loop, ())
        masses = statement.mass_share if apart else statement.share
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
    # the force of a rudder grows with the speed
    for share in (1.5, 2.0, 0.75, 0.5) if statement.loop == "steered" else (0.75, 0.5):
        yield changed(f"at a cruise speed of {share * speed:.3g} m/s", share)


REGION_CLAIMS: Mapping[str, RegionStatement] = {
    name: RegionStatement(name=name, **entries)
    for name, entries in read_toml(Path(__file__).with_name("library.toml")).items()
}


def region_statement(name: str) -> RegionStatement:
    """Return the region claim with a given name.

    Raises:
        InputError: no claim has this name; the message gives the most similar known name.
    """
    if name not in REGION_CLAIMS:
        raise InputError("unknown claim", key="claim", value=name, remedy=nearest(name, REGION_CLAIMS))
    return REGION_CLAIMS[name]


def refused_regions(
    vehicle: Vehicle, gains: Gains, *, cruise: float, cap: float
) -> tuple[tuple[NotApplicable, tuple[str, ...]], ...]:
    """Return each reason why region claims cannot be proved for a vehicle, gains and speeds [m/s], and their names.

    Nothing is searched: a claim that is left out may still have no proof. The claims about craft without sway force are
    left out for other vehicles.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.region import refused_regions
        >>> refused = refused_regions(load_vehicle("bluerov2-wu"), load_gains("default"), cruise=0.15, cap=0.22)
        >>> [(reason.because[:31], names[0], len(names)) for reason, names in refused]
        [('m11 = 17 kg and m22 = 24.2 kg d', 'region-cruise-20', 9)]
    """
    reasons: dict[tuple[str, str], tuple[NotApplicable, list[str]]] = {}
    for name, statement in REGION_CLAIMS.items():
        if statement.loop == "steered" and vehicle["Fv_max"] > 0:
            continue
        try:
            statement.claim(vehicle, gains, cruise=cruise, cap=cap)
        except NotApplicable as reason:
            reasons.setdefault((reason.because, reason.to), (reason, []))[1].append(name)
    return tuple((reason, tuple(names)) for reason, names in reasons.values())


def applicable_region(
    names: Sequence[str],
    vehicle: Vehicle,
    gains: Gains,
    *,
    law: str,
    cruise: float,
    cap: float,
    guidance: Guidance = "los",
) -> RegionStatement | NotApplicable:
    """Return the first of the named claims that applies to a law, vehicle, gains and speeds [m/s], or the first reason.

    Raises:
        InputError: `RegionStatement.claim` or `region_statement` raises this error.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification.region import applicable_region
        >>> names, rov = ("region-cruise-20", "region-turning-20"), load_vehicle("bluerov2-wu")
        >>> applicable_region(names, rov, load_gains("default"), law="guarded", cruise=0.15, cap=0.22).name
        'region-turning-20'
    """
    reasons = []
    for statement in map(region_statement, names):
        try:
            statement.claim(vehicle, gains, cruise=cruise, cap=cap)
            statement.require(law, guidance)
        except NotApplicable as reason:
            reasons.append(reason)
        else:
            return statement
    return reasons[0]


def prove_statement(
    statement: RegionStatement,
    vehicle: Vehicle,
    gains: Gains,
    *,
    seed: int = 0,
    cruise: float | None = None,
    cap: float | None = None,
    forms: Mapping[str, Any] | None = None,
) -> RegionProof:
    """Prove a region claim for a vehicle and gains, with the search effort that the statement sets.

    The certificate is about the law of these `forms` (`barrier`, `movers`): they change nothing in open water, but the
    instruction list of the law.

    If the search finds no proof of a claim about a cruise, a proof of a stronger claim of the library is one too. If
    there is none, the reason names a weaker claim that is proved, with its number.

    Raises:
        InputError, NotApplicable: `RegionStatement.claim` raises this error.
    """
    claim = _of_law(statement.claim(vehicle, gains, cruise=cruise, cap=cap), forms)
    proof = _prove(statement, claim, seed=seed)
    if proof.verdict == "proved":
        return proof
    for other in REGION_CLAIMS.values():
        strong = _claim_or_none(other, vehicle, gains, cruise, cap) if other.loop == statement.loop else None
        if strong is None or not isinstance(claim, TurningClaim) or strong.name == claim.name:
            continue
        if implies(strong, claim):
            result = _prove(_shorter(other), _of_law(strong, forms), seed=seed)
            if result.verdict == "proved":
                return replace(result, claim=claim, by=strong.name, seconds=proof.seconds + result.seconds)
    tried = []
    for words, one, slow, most in _weaker(statement, cruise=cruise, cap=cap):
        result = _prove(one, one.claim(vehicle, gains, cruise=slow, cap=most), seed=seed)
        if result.verdict == "proved":
            beside = f"from {towards(result.offset, up=False)} m beside the path"
            return replace(proof, reason=f"{proof.reason}; proved {words}: {beside}")
        tried.append(words)
    return replace(proof, reason=f"{proof.reason}; nor is it proved {', or '.join(tried)}")


def _of_law(claim: AnyClaim, forms: Mapping[str, Any] | None) -> AnyClaim:
    if not forms or not isinstance(claim, TurningClaim):
        return claim
    return replace(
        claim, digests=(claim.digests[0], build_law(barrier=forms["barrier"], movers=forms["movers"]).block.digest())
    )


def _claim_or_none(
    statement: RegionStatement, vehicle: Vehicle, gains: Gains, cruise: float | None, cap: float | None
) -> TurningClaim | None:
    try:
        claim = statement.claim(vehicle, gains, cruise=cruise, cap=cap)
    except (InputError, NotApplicable):
        return None
    return claim if isinstance(claim, TurningClaim) else None


def _prove(statement: RegionStatement, claim: AnyClaim, *, seed: int) -> RegionProof:
    if isinstance(claim, SteeringClaim):
        return prove_steering(claim)
    return prove_turning(claim, attempts=statement.attempts, seed=seed)

"""Proof of a claim about braking: propose the braking distance, prove its inequalities, let the checker decide."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from fractions import Fraction
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Rejected, check_document, seal
from surctl.certcheck import braking_claim as checker
from surctl.certcheck.braking import Distance, disturbance, drag_ranges, left_at, upper
from surctl.certcheck.inequality import Obligation
from surctl.lyapunov.near import point_text
from surctl.marine.control.gains import setting
from surctl.marine.guidance.braking import LEAST_THRUST
from surctl.marine.verification.braking.claim import BrakingClaim
from surctl.verification.certified import Certified
from surctl.verification.formula import parse, values_of, variable
from surctl.verification.proving import Statement, prove_by_boxes

_KNOTS, _POINTS = 10, 2000  # knots of a braking distance, at most, and points at which it is compared
_DIGITS = 9
_DENSE = 1.3  # knots are denser near 0
_LIFT, _ABOVE = 1e-3, 1e-7  # by which G' exceeds what is needed, relative to it and in m/(N s)
_FIGURES = 10**4  # an obstacle speed is rounded down to 0.1 mm/s
_SECONDS, _GRID = 10.0, 60  # limit of the processor time for an inequality; points of each variable
_FAILS = 1e-6  # excess at a point that is no rounding
_LARGER = (0.03, 0.07, 0.15, 0.3)  # [m] by which the gain `margin` is raised to find one that is enough

Vector = NDArray[np.float64]


def stated(claim: BrakingClaim) -> checker.BrakingClaim:
    """Return the claim as the checker reads it, with ranges and a largest obstacle speed of 0.

    Raises:
        Rejected: the checker does not accept the numbers of the claim.
    """
    return checker.read_claim(claim.document([[0.0] * len(claim.obstacles) for _ in claim.speeds], 0.0))


def largest_obstacle(claim: checker.BrakingClaim) -> float:
    """Return the largest obstacle speed [m/s] that leaves some braking force, rounded down to 0.1 mm/s; 0 if none."""
    low, high = 0, 100 * _FIGURES
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if left_at(claim, Fraction(middle, _FIGURES)) >= 0 else (low, middle)
    return low / _FIGURES


def distance_of(claim: checker.BrakingClaim, obstacle: Fraction) -> Distance:
    """Return a short braking distance before an obstacle.

    Raises:
        Rejected: drag and disturbance are as large as the braking force, or the claim is not covered.
    """
    from scipy.optimize import linprog

    through, top = float(obstacle + claim.current), float(claim.fastest + obstacle)
    knots = np.round(
        np.union1d(top * np.linspace(0.0, 1.0, _KNOTS) ** _DENSE, [through] if through < top else []), _DIGITS
    )
    knots[-1] = np.ceil(top * 10**_DIGITS) / 10**_DIGITS
    s = np.linspace(0.0, knots[-1], _POINTS)
    (low, high), (low2, high2) = drag_ranges(claim)
    left = float(claim.brake - upper(disturbance(claim, f"({obstacle + claim.current})")))
    v, share = s - through, 1.0 if claim.drag == "along" else 0.5**0.5
    force = left + np.where(v >= 0, float(low) * v + share * float(low2) * v**2, float(high) * v - float(high2) * v**2)
    exact = np.maximum.accumulate(s / force)
    hats = np.array([np.interp(s, knots, row) for row in np.eye(len(knots))]).T
    steps = np.diff(np.eye(len(knots)), axis=0)  # G' must not fall
    done = linprog(
        hats.mean(axis=0), -np.vstack([hats, steps]), -np.append((1 + _LIFT) * exact + _ABOVE, np.zeros(len(steps)))
    )
    if not done.success:
        raise Rejected("no braking distance was found")
    rows = [[Fraction(repr(round(float(x), _DIGITS))) for x in row] for row in (knots, np.maximum.accumulate(done.x))]
    distance = Distance(claim, obstacle, tuple(rows[0]), tuple(rows[1]), retreats=True)
    try:
        for obligation in distance.obligations():
            if obligation.names == ("r",):
                _proved(obligation, "retreat")
    except Rejected:
        return replace(distance, retreats=False)
    return distance


def _proved(obligation: Obligation, name: str) -> list[dict[str, Any]]:
    """Return the proof of an inequality; raise Rejected with a place where it fails or stays open."""
    symbols = {key: variable(key) for key in obligation.names}
    parts = [parse(text, symbols) for text in (obligation.left, obligation.right, *obligation.constraints)]
    low, high = np.array(obligation.box).T
    grid = np.meshgrid(*np.linspace(low, high, _GRID).T)
    left, right, *rows = values_of(parts, {key: x.ravel() for key, x in zip(obligation.names, grid, strict=True)})
    excess = np.where(np.all(np.array(rows).reshape(len(rows), left.size) <= 0, axis=0), left - right, -np.inf)
    what = "the gain margin is too small" if "b" in obligation.names else "an inequality of the distance is not proved"
    if excess.max() > _FAILS:
        at = {key: float(x.ravel()[excess.argmax()]) for key, x in zip(obligation.names, grid, strict=True)}
        where = f"at {point_text(at)}, by {excess.max():.2g}"
        if "b" in at:
            where = f"by {excess.max():.2g} m at {at['v']:.3g} m/s towards it, speed bound {at['b']:.3g} m/s"
        raise Rejected(f"{name}: {what} {where}")
    cases = prove_by_boxes(Statement(tuple(obligation.names), low, high, parts[0], parts[1], tuple(parts[2:])),
                           time_limit=_SECONDS)  # fmt: skip
    if cases.remaining:
        raise Rejected(f"{name}: {what}: {cases.remaining}")
    return list(cases.cases)


_SHARES = (LEAST_THRUST, 0.7, 0.55, 0.45, 0.3)  # of the thrust limit, as braking forces to try


@dataclass(frozen=True)
class BrakingProof(Certified):
    """The result of an attempt to prove a claim about braking.

    Attributes:
        claim: the claim.
        range_needed: detection range [m] that is enough at the robot's highest speed in the claim, for the fastest
            obstacle.
        seconds: total time of the attempt [s].
        check_seconds: duration of the check by the independent checker [s].
        enough: a larger gain `margin` with which the claim is proved [m]; NaN if none is known.
    """

    claim: BrakingClaim
    range_needed: float
    seconds: float
    check_seconds: float
    enough: float = nan

    @property
    def sentence(self) -> str:
        """Return the verdict in one line."""
        if self.verdict != "proved":
            return f"unknown: {self.reason}"
        claim, quickest = self.claim, max(self.claim.obstacles)
        what = f"obstacles that approach at up to {quickest:g} m/s" if quickest else "obstacles at rest"
        return (
            f"proved: no contact with {what}, provided they are detected at {self.range_needed:.2f} m or more "
            f"(robot at {max(claim.speeds):g} m/s); checked in {self.check_seconds:.2f} s"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return {
            **self.decided(),
            "range_needed_m": self.range_needed,
            "seconds": self.seconds,
            "check_seconds": self.check_seconds,
            "margin_enough_m": self.enough,
        }


def prove_braking(claim: BrakingClaim) -> BrakingProof:
    """Propose the braking distances of the claim, prove their inequalities, and let the checker decide.

    If the claim is not proved, a larger gain `margin` is searched with which it is.
    """
    own = _with_any_force(claim)
    if own.verdict == "proved" or claim.law is None:
        return own
    for more in _LARGER:
        margin = round(float(claim.law.margin) + more, 3)
        law = replace(claim.law, margin=Fraction(repr(margin)))
        if _with_any_force(replace(claim, law=law)).verdict == "proved":
            remedy = f"set {setting('margin', margin)} in the gain file (gains derive --margin {margin:g})"
            return replace(own, reason=f"{remedy}; {own.reason}", enough=margin)
    return own


def _with_any_force(claim: BrakingClaim) -> BrakingProof:
    """Return the proof, or the attempt with the guaranteed braking force if there is none.

    For a law of a vehicle with unequal masses, several braking forces are tried, the largest one first: the velocity
    loop commands a smaller one at a smaller excess over the speed bound, and the proof may count on any force up to the
    guaranteed one.
    """
    began, forces = time.perf_counter(), {claim.brakes.least}
    if claim.law is not None and claim.ratio != 1:
        forces |= {share * float(claim.law.limit) for share in _SHARES}
    for force in sorted(forces, reverse=True):
        attempt = _attempt(claim if force == claim.brakes.least else claim.braking_with(force), began)
        if attempt.verdict == "proved":
            return attempt
        if force == claim.brakes.least:
            own = attempt
    return own


def _attempt(claim: BrakingClaim, began: float) -> BrakingProof:
    try:
        document = _certificate(claim)
    except Rejected as reason:
        return BrakingProof(claim, "unknown", {}, str(reason), 0.0, time.perf_counter() - began, 0.0)
    checked = check_document(document)
    good = checked.accepted
    return BrakingProof(
        claim,
        "proved" if good else "unknown",
        document if good else {},
        checked.reason,
        document["claim"]["table"]["needed_m"][-1][-1] if good else 0.0,
        time.perf_counter() - began,
        checked.seconds,
    )


def _certificate(claim: BrakingClaim) -> dict[str, Any]:
    own = stated(claim)
    limit = largest_obstacle(own)
    if max(claim.obstacles) >= limit:
        pushed = float(upper(disturbance(own, f"({own.current})")))
        reason = f"this claim assumes a braking force of {claim.brakes.least:.3g} N and up to {pushed:.3g} N against it"
        reason += " by disturbances, turning, unequal masses and thrust across"
        reason += f", so that drag leaves none from {limit:.4g} m/s on" if limit > 0 else ": none is left, even at rest"
        raise Rejected(reason)
    distances = [distance_of(own, obstacle) for obstacle in own.obstacles]
    needed = [[float(distance.needed(speed)) for distance in distances] for speed in own.speeds]
    proofs = [
        _proved(obligation, f"before an obstacle at {float(d.obstacle):g} m/s")
        for d in distances
        for obligation in d.obligations()
    ]
    plain = [
        {"knots": list(map(float, d.knots)), "slopes": list(map(float, d.slopes)), "retreats": d.retreats}
        for d in distances
    ]
    return seal("braking", claim.document(needed, limit), {"distances": plain, "proofs": proofs})

"""Proof of a claim about braking: propose the braking distance, prove its inequalities, let the checker decide."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Rejected, check_document, seal
from surctl.certcheck import braking_claim as checker
from surctl.certcheck.braking import Distance, disturbance, drag_ranges, left_at, thrust_ahead, upper
from surctl.certcheck.motion import Obligation
from surctl.lyapunov.near import point_text
from surctl.marine.guidance.braking import LEAST_THRUST
from surctl.marine.verification.braking.claim import BrakingClaim
from surctl.verification.certified import Certified
from surctl.verification.formula import parse, values_of, variable
from surctl.verification.proving import Statement, prove_by_boxes

_FACTORS, _POINTS = 6, 150
_DIGITS = 9
_LIFT = 1e-3  # by which the polynomial exceeds what is needed, relative to it
_FIGURES = 10**4  # a distance is rounded up to 0.1 mm
_SECONDS, _GRID = 10.0, 60  # limit of the processor time for an inequality; points of each variable
_FAILS = 1e-6  # excess at a point that is no rounding

Vector = NDArray[np.float64]


def stated(claim: BrakingClaim) -> checker.BrakingClaim:
    """Return the claim as the checker reads it, with an empty table.

    Raises:
        Rejected: the checker does not accept the numbers of the claim.
    """
    return checker.read_claim(claim.document(_table(claim, 0.0), 0.0))


def _table(claim: BrakingClaim, figure: float) -> dict[str, Any]:
    rows = [[figure] * len(claim.obstacles) for _ in claim.speeds]
    return {"speeds_m_per_s": list(claim.speeds), **dict.fromkeys(("closed_m", "distance_m", "needed_m"), rows)}


def largest_obstacle(claim: checker.BrakingClaim) -> float:
    """Return the largest obstacle speed [m/s] that leaves some braking force, rounded down to 0.1 mm/s; 0 if none."""
    low, high = 0, 100 * _FIGURES
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if left_at(claim, Fraction(middle, _FIGURES)) >= 0 else (low, middle)
    return low / _FIGURES


def distance_of(claim: checker.BrakingClaim, obstacle: Fraction) -> Distance:
    """Return a short braking distance before an obstacle, by a linear program for the coefficients of its polynomial.

    Raises:
        Rejected: drag and disturbance are as large as the braking force, or the claim is not covered.
    """
    from scipy.optimize import linprog

    rough = Distance(claim, obstacle, (Fraction(0), claim.fastest + obstacle), ((Fraction(0),),), retreats=True)
    fastest, swing = claim.fastest + claim.speed_error, rough.swing / claim.mass[0]
    top = claim.fastest + obstacle
    if claim.ratio == 1:  # else the lag adds more than the largest closing speed
        gain = upper(rough.gain(f"({-fastest})", f"({thrust_ahead(claim)})"))
        top = Fraction(repr(round(float(fastest + obstacle + gain * claim.period + swing) + 0.01, _DIGITS)))
    knots = sorted({Fraction(0), top, *({rough.through} if 0 < rough.through < top else ())})
    starts, widths = np.array([[float(a), float(b - a)] for a, b in pairwise(knots)]).T[:, :, None]
    z = np.unique(
        [a + w * (1 - np.cos(np.linspace(0, np.pi, _POINTS))) / 2 for a, w in zip(starts, widths, strict=True)]
    )
    (low, high), (low2, high2) = drag_ranges(claim)
    left = float(claim.brake - upper(disturbance(claim, f"({rough.through})")))
    v, share = z - float(rough.through), 1.0 if claim.drag == "along" else 0.5**0.5
    force = left + np.where(v >= 0, float(low) * v + share * float(low2) * v**2, float(high) * v - float(high2) * v**2)
    powers = np.arange(_FACTORS)
    inside = ((z >= starts) & (z <= starts + widths)).astype(float)
    y = np.clip((z - starts) / widths, 0, 1)[:, :, None]  # of each piece, relative to its width
    slopes, growth = y ** (powers + 1), inside[:, :, None] * y**powers * (powers + 1)
    lengths = y ** (powers + 2) / (powers + 2) * widths[:, :, None] + np.maximum(z - starts - widths, 0)[:, :, None]
    slopes, growth, lengths = (np.hstack(list(each)) for each in (slopes, growth, lengths))
    exact = np.maximum.accumulate(z / force)
    area = np.concatenate([[0], np.cumsum((exact[1:] + exact[:-1]) / 2 * np.diff(z))])
    some = z > 0.1 * float(top)
    # unknowns: the coefficients, and by how much the length exceeds the least one; at 0, G' rises by 1/force at least
    first = np.zeros((1, slopes.shape[1]))
    first[0, 0] = float(widths[0, 0])
    rows, sides = (
        np.vstack([-slopes, -first]),
        -(1 + _LIFT) * np.concatenate([z, [float(widths[0, 0]) ** 2]]) / (np.concatenate([force, force[:1]])),
    )
    rows, sides = np.vstack([rows, -growth]), np.concatenate([sides, np.full(len(z), -_LIFT * exact[-1])])
    rows = np.block([[rows, np.zeros((len(rows), 1))], [lengths[some] / area[some, None], -np.ones((some.sum(), 1))]])
    cost = np.zeros(rows.shape[1])
    cost[-1] = 1.0
    done = linprog(cost, rows, np.concatenate([sides, np.ones(some.sum())]), bounds=(None, None))
    if not done.success:
        raise Rejected("no braking distance was found")
    factors = done.x[:-1].reshape(len(widths), -1) / widths ** (powers + 1)
    plain = tuple(tuple(Fraction(repr(round(float(x), _DIGITS))) for x in row) for row in factors)
    distance = Distance(claim, obstacle, tuple(knots), plain, retreats=True)
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
    what = "the law's margin is too small" if "b" in obligation.names else "an inequality of the distance is not proved"
    if excess.max() > _FAILS:
        at = {key: float(x.ravel()[excess.argmax()]) for key, x in zip(obligation.names, grid, strict=True)}
        raise Rejected(f"{name}: {what} at {point_text(at)}, by {excess.max():.2g}")
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
    """

    claim: BrakingClaim
    range_needed: float
    seconds: float
    check_seconds: float

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
        }


def prove_braking(claim: BrakingClaim) -> BrakingProof:
    """Propose the braking distances of the claim, prove their inequalities, and let the checker decide.

    For a law of a vehicle with unequal masses, smaller braking forces are tried too: the velocity loop commands them at
    a smaller excess over the speed bound, and the proof may count on any force up to the guaranteed one.
    """
    began = time.perf_counter()
    first = _attempt(claim, began)
    if first.verdict == "proved" or claim.law is None or claim.ratio == 1:
        return first
    forces = [share * claim.law.limit for share in _SHARES]
    attempts = (_attempt(claim.braking_with(force), began) for force in forces if force != claim.brakes.least)
    return next((attempt for attempt in attempts if attempt.verdict == "proved"), first)


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
    figures = [[d.figures(speed) for d in distances] for speed in own.speeds]
    table: dict[str, Any] = {"speeds_m_per_s": list(claim.speeds)}
    for k, name in enumerate(("closed_m", "distance_m", "needed_m")):
        table[name] = [[float(entry[k]) for entry in row] for row in figures]
    proofs = [
        _proved(obligation, f"{claim.name} before an obstacle at {float(d.obstacle):g} m/s")
        for d in distances
        for obligation in d.obligations()
    ]
    plain = [
        {
            "knots": [float(x) for x in d.knots],
            "factors": [[float(x) for x in row] for row in d.factors],
            "retreats": d.retreats,
        }
        for d in distances
    ]
    return seal("braking", claim.document(table, limit), {"distances": plain, "proofs": proofs})

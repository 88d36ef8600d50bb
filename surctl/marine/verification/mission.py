"""Search for the proof of a whole mission, leg by leg, or at a lower speed; `certcheck.mission` decides it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import minimize_scalar

from surctl.certcheck import check_document, seal
from surctl.certcheck.mission import (
    EXCLUDES,
    Funnel,
    Mission,
    decayed,
    funnel_of,
    leg_length,
    places,
    read_claim,
    starts,
    turn_of,
    turned,
)
from surctl.certcheck.region_exact import quadratic
from surctl.errors import NotApplicable
from surctl.marine.control import Gains
from surctl.marine.simulation import Scenario
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.region import RegionStatement, TurningClaim, prove_turning, region_statement
from surctl.units import towards
from surctl.verification.certified import Certified

Array = NDArray[np.float64]

USUAL = "region-turning-20-scale"
"""The region claim of each leg, if the user names none."""

_SLACK = 1e-6  # relative; covers the rounding of a level and of a multiplier
_STEPS = 40  # bisections of the level at the start
_LEFT = 1.0  # s, time in which the target moves as far as the robot may be beside the path at a corner
_FALL, _STRAIGHT = 0.6, 0.1  # of −ln V on the shortest leg, at the decay rate of the outermost shell
_SPEEDS, _HALVINGS = 8, 4  # most lower cruise speeds that are tried, and most halvings without a proof


@dataclass(frozen=True)
class MissionClaim:
    """Claim about a mission: its path, the region claim of a leg, and how it begins.

    Attributes:
        name: name of the claim.
        path: waypoints (n, 2) [m].
        loop: the region claim of one leg.
        at_rest: whether the mission begins at rest; otherwise it begins with the target's velocity.
    """

    name: str
    path: Array
    loop: TurningClaim
    at_rest: bool


@dataclass(frozen=True)
class MissionProof(Certified):
    """The result of an attempt to prove a claim about a mission.

    Attributes:
        claim: the claim.
        within: largest distances from the start along and across the path [m].
        tube, goal: largest distance from the path and from its end [m]; 0 if not proved.
        rest: why the claim does not hold from rest; empty if it does.
        check_seconds: duration of the check by the independent checker [s].
    """

    claim: MissionClaim
    within: tuple[float, float] = (0.0, 0.0)
    tube: float = 0.0
    goal: float = 0.0
    rest: str = ""
    check_seconds: float = 0.0

    @property
    def useful(self) -> bool:
        """Whether the claim is proved from rest."""
        return self.verdict == "proved" and self.claim.at_rest

    @property
    def sentence(self) -> str:
        """Return the verdict in one line."""
        if self.verdict != "proved":
            return f"unknown: {self.reason}"
        loop, legs = self.claim.loop, len(self.claim.path) - 1
        begins = "at rest" if self.claim.at_rest else "at the target's velocity, not at rest,"
        seconds = float(np.linalg.norm(np.diff(self.claim.path, axis=0), axis=1).sum()) / loop.cruise
        left_out = ["obstacles", "walls", *["thrust lag"] * (not loop.lag), *["held commands"] * (not loop.period)]
        without = f"{', '.join(left_out[:-1])} and {left_out[-1]}"
        along, across = self.within
        alike = "" if loop.mass_asymmetry else " by the same factor"
        return (
            f"proved without {without}: a robot that begins {begins} within {towards(along, up=False)} m along and "
            f"{towards(across, up=False)} m across the start stays within {towards(self.tube, up=True)} m of the path, "
            f"and is within {towards(self.goal, up=True)} m of the end of the path after {seconds:.0f} s; "
            f"{legs} leg{'s' if legs > 1 else ''} at {loop.cruise:g} m/s, drag off by up to "
            f"{loop.drag_factor[1] - 1:.0%}, masses by {loop.mass_factor[1] - 1:.0%}{alike}, a current of up to "
            f"{loop.current:g} m/s, a yaw rate of up to {loop.yaw_rate:g} rad/s; checked in {self.check_seconds:.2f} s"
            + (f"; not proved from rest: {self.rest}" if self.rest else "")
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain data for JSON."""
        return {
            **self.decided(),
            "within_m": self.within,
            "at_rest": self.claim.at_rest,
            "tube_m": self.tube,
            "goal_m": self.goal,
            "not_from_rest": self.rest or None,
            "check_seconds": self.check_seconds,
        }


class BrokenChain(Exception):
    """Error for a chain of regions that breaks; its message names the inequality that fails and its numbers."""


def mission_claim(
    scenario: Scenario, vehicle: Vehicle, gains: Gains, statement: RegionStatement,
    *, cruise: float, cap: float, at_rest: bool,
) -> MissionClaim:  # fmt: skip
    """Return the claim about a scenario's path, at the given speeds [m/s] and without its obstacles.

    Raises:
        NotApplicable: the region claim of a leg does not apply, or the mission has another form than the claim.
    """
    path = scenario.path
    if (path.rises is not None and np.any(path.rises)) or (path.speeds is not None and np.any(path.speeds)):
        raise NotApplicable("its path changes the depth or the speed", to="this mission")
    if scenario.visit is not None:
        raise NotApplicable("the robot stops at corners that it visits", to="this mission")
    turns = np.diff(np.angle(np.diff(path.waypoints, axis=0) @ [1, 1j]))
    loop = statement.claim(vehicle, gains, cruise=cruise, cap=cap)
    if not isinstance(loop, TurningClaim):
        raise NotApplicable(f"{statement.name} is not a claim about a cruise under the law guarded", to="this mission")
    # at a corner, the heading loop asks for the gain times the turn, and the target's velocity jumps
    yaw = float(np.abs(np.angle(np.exp(1j * turns))).max(initial=0.0) * gains["k_psi"])
    leaps = [(side * _LEFT * loop.cruise, loop.cruise * (np.exp(1j * turn) - 1)) for turn in turns for side in (1, -1)]
    jumps = leaps + [(0.0, complex(-loop.cruise))] * at_rest
    # on a short leg V must fall before the next corner; without corners, a low rate allows a larger region
    fall = _FALL if len(turns) else _STRAIGHT if at_rest else np.inf
    loop = replace(
        loop, rest=False, yaw_rate=max(loop.yaw_rate, round(float(np.ceil(1e3 * yaw) / 1e3), 3)),
        rate=min(loop.rate, fall * loop.cruise / float(path.lengths.min())),
        jumps=tuple((x, float(jump.real), float(jump.imag)) for x, jump in jumps),
    )  # fmt: skip
    current = float(np.hypot(*scenario.disturbance.current_m_per_s))
    if current > loop.current:
        why = f"its current of {current:.3g} m/s exceeds the {loop.current:g} m/s of {statement.name}"
        raise NotApplicable(why, to="this mission")
    return MissionClaim(f"mission-{scenario.name}", path.waypoints, loop, at_rest)


def prove_mission(claim: MissionClaim, *, attempts: int = 24, seed: int = 0) -> MissionProof:
    """Prove the region of one leg, chain it along the path, and let the checker decide."""
    region = prove_turning(claim.loop, attempts=attempts, seed=seed)
    if region.verdict != "proved":
        return MissionProof(claim, "unknown", {}, region.reason)
    try:
        document = certificate_of(claim, region.document)
    except BrokenChain as broken:
        return MissionProof(claim, "unknown", {}, str(broken))
    checked = check_document(document)
    if not checked.accepted:
        return MissionProof(claim, "unknown", {}, checked.reason)
    start, motion = (document["claim"][key] for key in ("start", "motion"))
    return MissionProof(
        claim, "proved", document, "", tuple(start["within_m"]), max(motion["tube_m"]), motion["goal_m"],
        check_seconds=checked.seconds,
    )  # fmt: skip


def certificate_of(claim: MissionClaim, region: dict[str, Any]) -> dict[str, Any]:
    """Return the certificate of a mission with the largest start that the chain allows.

    Raises:
        BrokenChain: the chain breaks for every start.
    """
    legs = len(claim.path) - 1
    stated: dict[str, Any] = {
        "system": "mission", "name": claim.name, "excludes": list(EXCLUDES), "path_m": claim.path.tolist(),
        "start": {"within_m": [0, 0], "at_rest": claim.at_rest},
        "motion": {"tube_m": [1.0] * legs, "goal_m": 1.0}, "loop": region["claim"],
    }  # fmt: skip
    mission = read_claim(stated)
    funnel = funnel_of(mission.loop, region["proof"])
    least = _start(mission, funnel, 0.0, 0.0)
    if least > 1:
        begin = "at rest" if claim.at_rest else "at the target's velocity"
        raise BrokenChain(f"a start {begin} has V = {least:.3g}, and the region ends at V = 1")
    levels, multipliers = _longest(mission, funnel, least)
    within = _widest(mission, funnel, levels[0])
    lengths = [leg_length(a, b) for a, b in pairwise(mission.path)]
    last = decayed(mission.loop, funnel, Fraction(levels[-1]), lengths[-1])

    def away(level: Fraction) -> float:
        return float(np.ceil(1e4 * float(funnel.extent(max(level, funnel.floor)) + mission.overrun) + 1e-6) / 1e4)

    stated["start"]["within_m"] = list(within)
    stated["motion"] = {"tube_m": [away(Fraction(repr(level))) for level in levels], "goal_m": away(last)}
    return seal("mission", stated, {"proof": {"loop": region["proof"], "levels": levels, "multipliers": multipliers}})


def _longest(mission: Mission, funnel: Funnel, least: float) -> tuple[list[float], list[float]]:
    """Return the levels of the legs and the multipliers of the corners, for the largest level at the start.

    Raises:
        BrokenChain: the chain breaks even for the least level.
    """

    def holds(level: float) -> bool:
        try:
            return bool(_chain(mission, funnel, level))
        except BrokenChain:
            return False

    return _chain(mission, funnel, 1.0 if holds(1.0) else _largest(holds, least, 1.0))


def _largest(holds: Callable[[float], bool], low: float, high: float) -> float:
    # the largest value between two at which a condition holds, by bisection
    for _ in range(_STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _chain(mission: Mission, funnel: Funnel, first: float) -> tuple[list[float], list[float]]:
    """Return the least levels of the legs and the multipliers of the corners for a level at the start.

    Raises:
        BrokenChain: an inequality of the chain fails.
    """
    levels, multipliers, p = [first], list[float](), _array(funnel.p)
    for k, (a, b, c) in enumerate(zip(mission.path, mission.path[1:], mission.path[2:], strict=False)):
        length, level = leg_length(a, b), Fraction(repr(levels[-1]))
        where = f"at the corner at ({float(b[0]):g}, {float(b[1]):g})"
        for u, distance, bound in places(mission, funnel, k, level):
            if distance > bound:
                raise BrokenChain(
                    f"{where}, the robot may be {float(distance):.3g} m from the target when the target is "
                    f"{float(u):.3g} m before the corner; at more than {float(bound):.3g} m it may leave out the corner"
                )
        cosine, sine = turn_of(a, b, c)
        rotation, moved = turned(mission, funnel, cosine, sine)
        before = float(decayed(mission.loop, funnel, level, length))
        reached, multiplier = _least(p, before, _array(rotation), _array(moved))
        if reached > 1:
            turn = np.degrees(np.arctan2(float(sine), float(cosine)))
            raise BrokenChain(
                f"{where}, a turn of {abs(turn):.0f} degrees, V may grow to {reached:.3g} on leg {k + 2}, and the "
                "region ends at V = 1"
            )
        levels.append(reached)
        multipliers.append(multiplier)
    return levels, multipliers


def _start(mission: Mission, funnel: Funnel, along: float, beside: float) -> float:
    """Return the least level that contains every start within these distances [m] along and across the path."""
    wider = replace(mission, within=(Fraction(along), Fraction(beside)))
    return _up(max(float(quadratic(funnel.p, start)) for start in starts(wider, funnel)))


def _widest(mission: Mission, funnel: Funnel, level: float) -> tuple[float, float]:
    """Return the largest distances from the start [m] along and across the path, rounded down, in V ≤ level.

    Along the path it is half of the largest distance that would be possible in both directions alike.
    """

    def most(shape: Callable[[float], tuple[float, float]]) -> float:
        def holds(far: float) -> bool:
            return _start(mission, funnel, *shape(far)) <= level

        high = 1.0
        while holds(high):
            high *= 2
        return float(np.floor(1e4 * _largest(holds, 0.0, high)) / 1e4)

    along = float(np.floor(5e3 * most(lambda far: (far, far))) / 1e4)
    return along, most(lambda far: (along, far))


def _least(p: Array, before: float, m: Array, moved: Array) -> tuple[float, float]:
    """Return the least level with (M z + w)ᵀ P (M z + w) ≤ level for zᵀ P z ≤ before and all w, and the multiplier."""
    values, basis = eigh(m.T @ p @ m, p)
    sides = np.square(moved @ p @ m @ basis)  # (w, n)
    own = np.einsum("wi,ij,wj->w", moved, p, moved)

    def level(logarithm: float) -> float:
        gap = np.exp(logarithm)
        return float(((values[-1] + gap) * before + own + (sides / (values[-1] + gap - values)).sum(axis=1)).max())

    best = minimize_scalar(level, bounds=np.log(values[-1] * np.array([1e-6, 1e6])), method="bounded")
    return _up(level(best.x)), float(values[-1] + np.exp(best.x))


def _up(level: float) -> float:
    return float(f"{level * (1 + _SLACK):.12g}")


def _array(rows: Sequence[Sequence[Fraction]]) -> Array:
    return np.array([[float(entry) for entry in row] for row in rows])


def prove_scenario(
    scenario: Scenario, vehicle: Vehicle, gains: Gains, region: RegionStatement | None = None,
    *, cruise: float, cap: float, seed: int = 0,
) -> MissionProof:  # fmt: skip
    """Prove a mission from rest or, if that fails, with the target's velocity at the start.

    Args:
        scenario: the mission; its obstacles are left out.
        vehicle: the vehicle that the law's model describes.
        gains: gains of the law.
        region: the region claim of a leg; None for `USUAL`.
        cruise, cap: speed of the target point on the path, and largest commanded speed [m/s].
        seed: seed of the search for a region.

    Raises:
        NotApplicable: the mission violates an assumption of the claim.
    """
    statement, reason = region_statement(USUAL) if region is None else region, ""
    for at_rest in (True, False):
        claim = mission_claim(scenario, vehicle, gains, statement, cruise=cruise, cap=cap, at_rest=at_rest)
        proof = prove_mission(claim, attempts=statement.attempts, seed=seed)
        if proof.verdict == "proved":
            return replace(proof, rest=reason)
        reason = f"{reason}; nor with the target's velocity: {proof.reason}" if reason else proof.reason
    return replace(proof, reason=f"from rest, {reason}")


def slower(
    scenario: Scenario, vehicle: Vehicle, gains: Gains, region: RegionStatement | None = None,
    *, cruise: float, cap: float, seed: int = 0,
) -> MissionProof | None:  # fmt: skip
    """Return the proof at the largest lower cruise speed that a bisection finds, if possible from rest, or None.

    The arguments are those of `prove_scenario`.
    """
    statement = region_statement(USUAL) if region is None else region
    for at_rest in (True, False):
        low, high, best = 0.0, cruise, None
        for k in range(_SPEEDS):
            speed = float(f"{np.sqrt(low * high) or high / 2:.2g}")
            if speed in (low, high) or (best is None and k > _HALVINGS):
                break
            claim = mission_claim(scenario, vehicle, gains, statement, cruise=speed, cap=cap, at_rest=at_rest)
            proof = prove_mission(claim, attempts=statement.attempts, seed=seed)
            if proof.verdict == "proved":
                best, low = proof, speed
            else:
                high = speed
        if best is not None:
            return best
    return None


def tube_radii(document: Mapping[str, Any], points: int = 41) -> list[Array]:
    """Return for each leg the distance of the robot from the target [m] at `points` places of the target (points, 3).

    Args:
        document: the certificate of a mission that the checker accepts.
        points: number of places, from the begin to the end of a leg.

    Returns:
        For each leg an array (points, 3) of the target's x and y, and the bound on the distance [m].
    """
    mission, proof = read_claim(document["claim"]), document["proof"]
    funnel = funnel_of(mission.loop, proof["loop"])
    legs = []
    for (a, b), level in zip(pairwise(mission.path), proof["levels"], strict=True):
        length, exact = leg_length(a, b), Fraction(repr(level))
        rows = []
        for share in (Fraction(k, points - 1) for k in range(points)):
            far = funnel.extent(decayed(mission.loop, funnel, exact, share * length)) + mission.overrun
            rows.append([float(a[i] + share * (b[i] - a[i])) for i in (0, 1)] + [float(far)])
        legs.append(np.array(rows))
    return legs

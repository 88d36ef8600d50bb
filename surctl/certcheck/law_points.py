"""Comparison of the exported law with what a certificate states about it, by evaluation of the law's instructions.

A certificate of kind `turning` or `braking` contains a model of the law, and one of kind `lyapunov` about the
law `steered` the dynamics of its heading loop. Here, the instruction
list of the bundle is evaluated with the gains of the bundle at some hundreds of points, which are drawn once with a
fixed seed: on one straight leg in open water, or before one obstacle or wall. At each point the command must be that of
the model. Some steps follow one another from fresh memory, so that a law that learns or smooths differs. Command limit,
speed cap, and a command of 0 occur among the points.

Agreement at these points is no proof of agreement everywhere. It excludes every law whose command differs on a part of
the region that is not small.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.braking import bound_distance
from surctl.certcheck.braking_claim import BrakingClaim
from surctl.certcheck.bundle import Listed, Manifest, places
from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import Undefined
from surctl.certcheck.enclosure import enclose, middle, rational
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.instructions import evaluate, read_list
from surctl.certcheck.patience import go_on
from surctl.certcheck.turning_claim import TurningClaim
from surctl.certcheck.turning_law import followed, velocity_loop

__all__ = [
    "Law", "Leg", "Report", "Same", "compare_braking", "compare_following", "leg_of", "report_difference", "values_at",
]  # fmt: skip

Array: TypeAlias = NDArray[np.float64]
Report: TypeAlias = Callable[[str], None]

_POINTS = 400
_STEPS = 2  # steps from fresh memory
_FAR = 1e4  # [m] distance of walls that are not near
_RADIUS = 5.0  # [m] of an obstacle
_SLACK = 1e-9  # largest difference of two equal values, relative to the largest: the law has its own sine

_UNITS = {
    "eta": "m, rad", "nu": "m/s, rad/s", "contacts": "m, m/s, 1", "tau": "N, N m", "nu_reference": "m/s, rad/s",
    "progress": "m", "waypoints": "m", "walls": "m", "depth": "m", "visit": "m", "hull": "m", "crab": "rad",
    "sway": "m/s", "surge": "m/s", "k1": "1/s", "lookahead": "m", "k_v": "1/s", "k_i": "1/s^2", "wait": "m",
    "cruise": "m/s", "cap": "m/s", "mass": "kg, kg m^2", "linear_drag": "N s/m, N m s",
    "quadratic_drag": "N s^2/m^2, N m s^2", "thrust_limit": "N, N m", "margin": "m", "reaction": "s", "brake": "1",
    "stopping": "kg, N, s, N s/m, N s^2/m^2", "k_psi": "1/s", "k_r": "1/s", "crab_time": "s", "sideslip": "rad",
    "munk": "kg", "centripetal": "kg", "fin_share": "1", "spin": "rad/s",
}  # fmt: skip
"""The unit of each part of a law's vectors that a comparison uses."""


@dataclass(frozen=True)
class Same:
    """Whether two values are equal up to rounding."""

    slack: float

    def apart(self, first: Array, second: Array) -> Array:
        """Return at which points (n,) any row differs by more than rounding, relative to the second's largest."""
        scale = float(np.max(np.abs(second), initial=0.0))
        within = np.abs(first - second) <= self.slack * scale
        return np.asarray(~np.all(within, axis=0))


class Law:
    """A robot's law as the bundle states it: its instructions, the names of its vectors, and its gains.

    Raises:
        Rejected: the instructions cannot be read, or a vector lacks a part that the comparison needs.
    """

    def __init__(self, listed: Listed, manifest: Manifest) -> None:
        self._block = read_list(listed.text)
        self._places = {name: places(ports) for name, ports in listed.vectors.items()}
        self._start = np.array(listed.numbers["initial_state"])
        self.period, self.same = manifest.period, Same(_SLACK)
        self.gains = {name: np.array(values) for name, values in manifest.gains.items()}
        sizes = [sum(port.size for port in listed.vectors[name]) for name in ("state", "inputs", "gains")]
        results = [sum(port.size for port in listed.vectors[name]) for name in ("commands", "telemetry")]
        if self._block.inputs != tuple(sizes) or self._block.outputs != (results[0], sizes[0], 1, results[1]):
            raise Rejected("the vectors of the law do not have the stated sizes")
        if len(self._start) != sizes[0] or self._places["gains"].keys() != self.gains.keys():
            raise Rejected("the law's list has other gains or another initial state than the bundle")
        for ports in listed.vectors.values():
            for port in ports:
                if _UNITS.get(port.name, port.unit) != port.unit:
                    raise Rejected(f"{port.name} of the law is in {port.unit}, not in {_UNITS[port.name]}")

    def state(self, count: int, **values: Any) -> Array:
        """Return fresh memory (nx, count) with the given values."""
        return self._filled("state", np.repeat(self._start[:, None], count, axis=1), values)

    def inputs(self, count: int, **values: Any) -> Array:
        """Return inputs (nu, count): the given values, and zeros."""
        return self._filled("inputs", np.zeros((self._block.inputs[1], count)), values)

    def step(self, x: Array, u: Array, **gains: Any) -> tuple[dict[str, Array], Array]:
        """Return commands and telemetry by name, and the next state, for gains of the bundle and those outputs."""
        count = x.shape[1]
        p = self._filled("gains", np.zeros((self._block.inputs[2], count)), {**self.gains, **gains})
        tau, after, _, telemetry = evaluate(self._block, x, u, p)
        outputs = {name: tau[place] for name, place in self._places["commands"].items()}
        return outputs | {name: telemetry[place] for name, place in self._places["telemetry"].items()}, after

    def part(self, vector: str, values: Array, name: str) -> Array:
        """Return a part (size, count) of a vector (n, count) by its name."""
        if name not in self._places[vector]:
            raise Rejected(f"the law has no {name} among its {vector}")
        return values[self._places[vector][name]]

    def _filled(self, vector: str, table: Array, values: Mapping[str, Any]) -> Array:
        for name, value in values.items():
            own, target = np.asarray(value, dtype=float), self.part(vector, table, name)
            # one number for each entry, or for each point of a part with one entry
            target[:] = own[:, None] if own.ndim == 1 and len(own) == len(target) else own
        return table


@dataclass(frozen=True)
class Leg:
    """A long straight leg, the arc length of its target and a pose (count,) beside it."""

    tangent: Array
    progress: float
    start: Array

    def pose(self, x_e: Array, y_e: Array, psi: Array, depth: float) -> Array:
        """Return the pose (4, count) with path errors x_e, y_e and the angle ψ from the path to the heading."""
        beside = np.array([-self.tangent[1], self.tangent[0]])
        place = self.start[:, None] + np.outer(self.tangent, self.progress + x_e) + np.outer(beside, y_e)
        turned = psi + np.arctan2(self.tangent[1], self.tangent[0])
        return np.vstack([place, np.full(len(psi), depth), turned])

    def mission(self, law: Law) -> dict[str, Any]:
        """Return the gains that give the law this leg in open water."""
        slots = law.part("gains", np.zeros((sum(map(len, law.gains.values())), 1)), "waypoints").size // 2
        points = [self.start, *[self.start + 2.5 * self.progress * self.tangent] * (slots - 1)]
        walls = [-_FAR, _FAR, -_FAR, _FAR]
        return {"waypoints": np.concatenate(points), "walls": np.array(walls), "depth": -3.0, "visit": 0.0}


def leg_of(angle: float, progress: float) -> Leg:
    """Return a leg at an angle to the first axis, whose target has an arc length [m]."""
    return Leg(np.array([np.cos(angle), np.sin(angle)]), progress, np.array([3.0, -2.0]))


def values_at(names: Sequence[str], points: Array, texts: Mapping[str, str]) -> dict[str, Array]:
    """Return the values (N,) of texts at points (n, N) of the named variables."""
    table = ExpressionTable(names)
    roots = [table.read(text) for text in texts.values()]
    rows: list[list[float]] = []
    for point in points.T:
        go_on()
        try:
            values = enclose(table, roots, [rational(Fraction(x)) for x in point.tolist()])
        except Undefined as reason:
            raise Rejected(f"a text is not defined at a point: {reason}") from None
        rows.append([middle(value) for value in values])
    return dict(zip(texts, np.array(rows).T, strict=True))


def compare_following(law: Law, claim: TurningClaim, report: Report) -> float:
    """Compare thrust in surge and sway and the motion of the target on a straight leg; return the largest yaw rate.

    Args:
        law: the exported law.
        claim: the claim about the law.
        report: function that gets one message if the law differs.
    """
    rng, leg, n = np.random.default_rng(11), leg_of(0.7, 40.0), _POINTS
    wait, cruise, cap = (float(x) for x in (claim.wait, claim.cruise, claim.cap))
    x_e = rng.uniform(-1.2 * wait, 1.5 * cruise / float(claim.k1), n)
    y_e = rng.uniform(-2, 2, n) * float(claim.lookahead)
    small = np.arange(n) % 2 == 0  # half of the points are near the steady motion, where no limit is reached
    x_e, y_e = np.where(small, 0.1 * x_e, x_e), np.where(small, 0.1 * y_e, y_e)
    psi = rng.uniform(-np.pi, np.pi, n)
    spread = np.where(small, 0.05, 1.5) * cap * rng.uniform(-1, 1, (4, n))
    c, s = np.cos(psi), np.sin(psi)
    nu = spread + np.vstack([cruise * c, -cruise * s, np.zeros((2, n))])
    inputs = law.inputs(n, eta=leg.pose(x_e, y_e, psi, -3.0), nu=nu)
    over_ground = np.stack([x_e, y_e, c * nu[0] - s * nu[1], s * nu[0] + c * nu[1]], axis=1)
    x, fastest = law.state(n, progress=leg.progress), 0.0
    for _ in range(_STEPS):
        progress = law.part("state", x, "progress")[0]
        over_ground[:, 0] = x_e + leg.progress - progress
        outputs, after = law.step(x, inputs, **leg.mission(law))
        claimed = followed(claim, law.gains["thrust_limit"][:2], over_ground, psi).T
        pace = cruise * np.clip(2 * (1 + over_ground[:, 0] / wait), 0, 1)
        moved = (law.part("state", after, "progress") - progress) / law.period
        for what, unit, first, second in (
            ("thrust", "N", claimed, outputs["tau"][:2]),
            ("speed of the path's target", "m/s", pace[None], moved),
        ):
            if (apart := law.same.apart(first, second)).any():
                at = int(np.argmax(apart))
                place = f"x_e = {over_ground[at, 0]:.4g} m, y_e = {y_e[at]:.4g} m, heading {psi[at]:.4g} rad"
                return report_difference(report, what, place, unit, first[:, at], second[:, at])
        fastest, x = max(fastest, float(np.max(np.abs(outputs["nu_reference"][3])))), after
    return fastest


def report_difference(report: Report, what: str, place: str, unit: str, claimed: Array, exported: Array) -> float:
    """Report two values of the law that differ at a place; return 0."""

    def text(values: Array) -> str:
        return ", ".join(f"{value:.6g}" for value in values)

    report(f"law: {what} at {place}: {text(claimed)} {unit} certified, {text(exported)} {unit} exported")
    return 0.0


def compare_braking(law: Law, claim: BrakingClaim, report: Report) -> None:
    """Compare the commanded speed towards one obstacle or wall with the claimed bound and the claimed excess braking.

    At a clearance at which the claimed bound is b, a law of the claim commands a speed of at most b − gain x towards
    the obstacle, where x is the excess of its own speed over b. It commands exactly this speed at some of the points;
    so a certificate with another bound or gain than the law's differs, in whichever direction. The thrust must be that
    of the claimed velocity loop.
    """
    assert claim.law is not None
    rng, n = np.random.default_rng(13), _POINTS
    for speed in claim.obstacles:
        bounds = rng.uniform(-0.02 - float(speed), float(claim.law.cap), n)
        away = values_at(["b"], bounds[None], {"K": bound_distance(claim.law, speed, claim.period)})["K"]
        table = bounds, away + float(claim.law.margin)
        for wall in (False, True) if not speed else (False,):
            _compare_approach(law, claim, (float(speed), wall), table, report)


def _compare_approach(
    law: Law, claim: BrakingClaim, met: tuple[float, bool], table: tuple[Array, Array], report: Report
) -> None:
    assert claim.law is not None
    (approach, wall), (bounds, clearance) = met, table
    rng, keep = np.random.default_rng(14), clearance > 0
    bounds, clearance = bounds[keep], clearance[keep]
    n = len(bounds)
    leg = leg_of(0.0 if wall else 0.7, 40.0)
    speed = bounds + 0.05 * rng.uniform(-1, 1, n)
    psi = rng.uniform(-np.pi, np.pi, n)
    c, s = np.cos(psi), np.sin(psi)
    pose = leg.pose(np.full(n, -0.5), np.zeros(n), psi, -3.0)
    nu = np.vstack([c * speed, -s * speed, np.zeros((2, n))])
    inputs = law.inputs(n, eta=pose, nu=nu)
    hull, mission = law.gains["hull"][0], leg.mission(law)
    if wall:
        mission["walls"] = np.vstack(
            [np.full(n, -_FAR), pose[0] + clearance + hull, *np.full((2, n), [[-_FAR], [_FAR]])]
        )
    else:
        centre = pose[:2] + np.outer(leg.tangent, clearance + hull + _RADIUS)
        moves = np.repeat(-approach * leg.tangent[:, None], n, axis=1)
        law.part("inputs", inputs, "contacts")[:6] = np.vstack([centre, np.full(n, _RADIUS), moves, np.ones(n)])
    outputs, _ = law.step(law.state(n, progress=leg.progress), inputs, **mission)
    commanded = c * outputs["nu_reference"][0] - s * outputs["nu_reference"][1]
    excess = np.maximum(speed - bounds, 0)
    claimed = np.maximum(bounds - float(claim.law.gain) * excess, -float(claim.law.cap))
    what = f"speed towards {'a wall' if wall else 'an obstacle'} that approaches at {approach:g} m/s"
    slack = law.same.slack
    over = commanded > claimed + slack
    brakes = (excess > 0.1 * 0.05) & (claimed > -float(claim.law.cap))
    reached = brakes & (np.abs(commanded - claimed) <= slack)
    place = "a clearance of {:.4g} m and a speed of {:.4g} m/s"
    if over.any() or not reached.any():
        at = int(np.argmax(over if over.any() else brakes))
        at_point = place.format(clearance[at], speed[at])
        report_difference(report, what, at_point, "m/s", claimed[at : at + 1], commanded[at : at + 1])
        return
    thrust = velocity_loop(claim.law, law.gains["thrust_limit"][:2], outputs["nu_reference"][:2], nu[:2])
    if (apart := law.same.apart(thrust, outputs["tau"][:2])).any():
        at = int(np.argmax(apart))
        at_point = place.format(clearance[at], speed[at])
        report_difference(report, "thrust", at_point, "N", thrust[:, at], outputs["tau"][:2, at])

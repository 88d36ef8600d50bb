"""Simulation of many worst-case runs within a claim's assumptions; the claim requires that no run has a contact.

The runs are in two dimensions. Whenever the braking rule allows it, the vehicle thrusts towards the obstacle with full
force, or in any other direction. When the rule requires braking, the vehicle brakes along the direction to the obstacle
at the last decision without braking. In half of the runs the obstacle is met head-on and every uncertain quantity is at
its worst limit; the others use random mass, lag, drag, braking force, errors and motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.braking import disturbance, thrust_ahead, upper
from surctl.certcheck.braking_claim import GuardedLaw
from surctl.marine.guidance.braking import Brakes, Watch
from surctl.marine.verification.braking.claim import BrakingClaim
from surctl.marine.verification.braking.proof import distance_of, stated

__all__ = ["Episodes", "Rule", "rule_of", "run_episodes"]

_STEP = 0.005  # [s]
_NEAR = 0.1  # [m]
_AGAINST = 40.0  # [N s/m] gain that reduces a sideways speed near the claim's largest
_RANGES = 4.0  # [m] largest range at which a law's bound is tabulated

Vector = NDArray[np.float64]
Rule = Callable[[Vector, Vector, Vector], NDArray[np.bool_]]
"""A function of measured range [m], measured own speed along the direction [m/s] and largest own speed since the echo
[m/s]; it returns for each vehicle whether the vehicle brakes."""


@dataclass(frozen=True)
class Episodes:
    """Summary of many simulated runs.

    Attributes:
        runs: number of runs.
        hits: number of runs in which the clearance was negative.
        least: least clearance of all runs [m].
        near: share of the runs with a clearance below 0.1 m.
        braked: share of the runs in which the vehicle had to brake.
        fastest: largest own speed of all runs along the direction of the obstacle [m/s].
    """

    runs: int
    hits: int
    least: float
    near: float
    braked: float
    fastest: float


def rule_of(claim: BrakingClaim, *, obstacle: float, share: float = 1.0) -> Rule:
    """Return the rule by which the claim's vehicle brakes before an obstacle that approaches at `obstacle` [m/s].

    If the claim has no law, the vehicle brakes unless the measured range is at least the range needed; this rule uses
    the braking distance of the proof, times `share`. If the claim has a law, the vehicle brakes when
    its speed exceeds the law's speed bound so far that the velocity loop commands the guaranteed braking force.
    """
    if claim.law is not None:
        return _law_rule(claim, claim.law, obstacle)
    distance = distance_of(stated(claim), Fraction(repr(obstacle)))
    scaled = tuple(Fraction(repr(share)) * x for x in distance.slopes)
    distance, grid = replace(distance, slopes=scaled), np.linspace(-1.0, claim.fastest + claim.watch.speed_error, 121)
    still = np.array([float(distance.needed(v) - distance.stale(v)) for v in map(Fraction, map(repr, grid.tolist()))])
    still += claim.watch.range_error

    def brakes(read: Vector, speed: Vector, since: Vector) -> NDArray[np.bool_]:
        late = np.maximum(np.maximum(since, speed) + claim.watch.speed_error + obstacle, 0.0) * claim.watch.age
        return np.asarray(read < np.interp(speed, grid, still) + late)

    return brakes


def _law_rule(claim: BrakingClaim, law: GuardedLaw, obstacle: float) -> Rule:
    ranges = np.linspace(-1.0, _RANGES, 4001)
    bound = np.array(
        [_bound(law, Watch(period=claim.watch.period), float(d) - float(law.margin), obstacle) for d in ranges]
    )
    over = np.array([_over(claim, law, float(b)) for b in bound])

    def brakes(read: Vector, speed: Vector, since: Vector) -> NDArray[np.bool_]:
        del since
        return np.asarray(speed > np.interp(read, ranges, bound + over))

    return brakes


def _over(claim: BrakingClaim, law: GuardedLaw, bound: float) -> float:
    """Return the excess over a bound [m/s] at which the velocity loop commands the guaranteed braking force."""
    gain, w = float(law.gain), claim.sideways
    (low, high), (low2, high2) = (sorted(map(float, pair)) for pair in (law.linear, law.quadratic))
    light, heavy = sorted(map(float, law.mass))
    loop, aside = light * float(law.k_v), (heavy - light) * float(law.k_v) * w

    def commanded(over: float) -> float:
        desired = bound - gain * over
        if desired < 0:  # the drag of the model then brakes; drag feedforward acts on each axis
            feed = low * desired - low2 * desired**2 / np.sqrt(2) + (high - low) * w / 2
            feed += (2 * high2 - low2) * w**2 / np.sqrt(27)
        else:
            feed = (
                high * desired + high2 * (desired**2 + np.sqrt(2) * desired * w + 0.7072 * w**2) + (high - low) * w / 2
            )
        return float(feed + aside - loop * (1 + gain) * over)

    least, most = 0.0, (claim.brakes.least + max(commanded(0.0), 0.0)) / (loop * (1 + gain))
    for _ in range(20):
        middle = (least + most) / 2
        least, most = (least, middle) if commanded(middle) <= -claim.brakes.least else (middle, most)
    return float(most)


def _bound(law: GuardedLaw, watch: Watch, distance: float, obstacle: float) -> float:
    if law.barrier == "inertia":
        lightest, heaviest, most, lag, linear, quadratic = map(float, law.stopping.values())
        least = float(law.brake * law.limit)
        own = Brakes((lightest, heaviest), least, most, lag, (0.0, linear), (0.0, quadratic))
        return allowed_speed(own, watch, distance, obstacle=obstacle)
    a, t = float(law.brake * law.limit / max(law.mass)), float(law.reaction)
    h = distance - t * obstacle
    return (h / t if h < 0 else float(np.sqrt((a * t) ** 2 + 2 * a * h)) - a * t) - obstacle


def run_episodes(
    claim: BrakingClaim,
    *,
    obstacle: float,
    runs: int = 10_000,
    seconds: float = 20.0,
    seed: int = 0,
    rule: Rule | None = None,
) -> Episodes:
    """Simulate many runs within the assumptions of a claim.

    Args:
        claim: the claim, with its assumptions and its braking rule.
        obstacle: approach speed v_o of the obstacle [m/s].
        runs: number of runs.
        seconds: duration of a run [s].
        seed: seed of all random numbers.
        rule: rule that replaces the claim's own rule, for example a rule that should fail.
    """
    world = _World(claim, obstacle, runs, np.random.default_rng(seed))
    decide = rule_of(claim, obstacle=obstacle) if rule is None else rule
    each = max(round(claim.watch.period / _STEP), 1)
    least, braked, fastest = np.full(runs, np.inf), np.zeros(runs, dtype=bool), 0.0
    for k in range(round(seconds / _STEP)):
        least = np.minimum(least, world.look())
        fastest = max(fastest, float(world.past[-1][1].max()))
        if k % each == 0:
            braked |= world.decide(decide)
        world.step()
    hits, near = int(np.sum(least < 0)), float(np.mean(least < _NEAR))
    return Episodes(runs, hits, float(least.min()), near, float(braked.mean()), fastest)


class _World:
    # the arrays have the shape (runs,) or (runs, 2)
    def __init__(self, claim: BrakingClaim, obstacle: float, runs: int, rng: np.random.Generator) -> None:
        b, self.claim, self.fastest_obstacle, self.rng, self.runs = claim.brakes, claim, obstacle, rng, runs
        self.worst = rng.uniform(size=runs) < 0.5
        worst = self.worst
        self.mass = np.where(worst, rng.choice(b.masses, runs), rng.uniform(*b.masses, runs))
        self.lag = b.lag * np.where(worst, 1.0, rng.uniform(0.2, 1.0, runs))
        shape = (runs, 2)
        self.linear = np.where(worst[:, None], b.linear[0], rng.uniform(*b.linear, shape))
        self.quadratic = np.where(worst[:, None], b.quadratic[0], rng.uniform(*b.quadratic, shape))
        self.brake = np.where(worst, b.least, rng.uniform(b.least, max(b.least, b.most), runs))
        self.heading = rng.uniform(-np.pi, np.pi, runs)
        self.turn = claim.turn * rng.choice((-1.0, 0.0, 1.0), runs)
        bearing = rng.uniform(-np.pi, np.pi, runs)
        self.latched = _unit(bearing)
        # three quarters of the obstacles are discs; a very large disc represents a wall
        self.radius = np.where(rng.uniform(size=runs) < 0.25, 1e4, rng.uniform(0.02, 1.0, runs))
        away = rng.uniform(1.0, 2.5, runs) + 4.0 * obstacle
        self.gap = self.latched * (away + self.radius)[:, None]  # vehicle → centre of the obstacle
        self.normal: Vector = self.latched
        self.clearance: Vector = away
        self.velocity = self.latched * rng.uniform(0.0, 0.1, runs)[:, None]
        self.thrust, self.braking = np.zeros(shape), np.zeros(runs, dtype=bool)
        self.mood = np.where(worst, 0.0, rng.uniform(size=runs))
        self.past: list[tuple[Vector, Vector]] = []
        self.command, self.came = np.zeros(shape), np.zeros(shape)
        self.sign = np.ones((2, runs))
        own = stated(claim)
        self.pushed = float(upper(disturbance(own, f"({own.current + Fraction(repr(obstacle))})")))
        self.ahead = float(thrust_ahead(own))
        if claim.ratio > 1:
            heavier = self.mass * np.where(worst, claim.ratio, rng.uniform(1.0, claim.ratio, runs))
            pair, swapped = np.column_stack([self.mass, heavier]), rng.uniform(size=runs) < 0.5
            self.masses = np.where(swapped[:, None], pair[:, ::-1], pair)

    def look(self) -> Vector:
        """Return the clearance [m] and store it for the delayed measurement."""
        distance = np.linalg.norm(self.gap, axis=1)
        self.normal, self.clearance = self.gap / distance[:, None], distance - self.radius
        late = round(self.claim.watch.age / _STEP)
        along = np.sum(self.velocity * self.normal, axis=1)
        self.past = [*self.past, (self.clearance, along)][-late - 1 :]
        return self.clearance

    def decide(self, rule: Rule) -> NDArray[np.bool_]:
        """Set the commands until the next decision, and return which vehicles brake."""
        w, rng = self.claim.watch, self.rng
        fresh = rng.uniform(size=self.runs) < 0.05
        self.mood = np.where(fresh & ~self.worst, rng.uniform(size=self.runs), self.mood)
        self.sign = np.where(self.worst, 1.0, rng.choice((-1.0, 1.0), (2, self.runs)))
        speed = np.sum(self.velocity * self.normal, axis=1) - w.speed_error * self.sign[1]
        since = np.max([v for _, v in self.past], axis=0) - w.speed_error
        self.braking = rule(self.past[0][0] + w.range_error * self.sign[0], speed, since)
        self.latched = np.where(self.braking[:, None], self.latched, self.normal)
        across = np.column_stack([-self.latched[:, 1], self.latched[:, 0]])
        stop = -self.brake[:, None] * self.latched
        if self.claim.ratio > 1:
            stop = stop + self._aside(across)
        self.command = np.where(self.braking[:, None], stop, self._free(across))
        self.came = self.fastest_obstacle * self._obstacle(across)
        return self.braking

    def _free(self, across: Vector) -> Vector:
        """Return the thrust of vehicles that need not brake: mostly ahead, sideways up to `claim.sideways`."""
        b, claim, mood = self.claim.brakes, self.claim, self.mood
        towards = np.sum(self.velocity * self.normal, axis=1)
        aside = np.sum(self.velocity * across, axis=1)
        ahead = self._ahead(towards)
        slanted = np.where(mood < 0.3, 0.0, (2 * mood - 1.0) * b.most * 0.7)
        below_limit = np.abs(aside) + b.most * self.claim.watch.period / b.masses[0] + 0.02 < claim.sideways
        sideways = np.where(
            below_limit | (slanted * aside < 0), slanted, -np.sign(aside) * np.minimum(abs(aside) * 40, b.most)
        )
        sideways = np.where(self.worst, 0.0, sideways)
        forward = np.minimum(np.sqrt(np.maximum(b.most**2 - sideways**2, 0.0)), ahead)
        forward = np.where(mood > 0.9, -forward, forward)
        return np.asarray(forward[:, None] * self.latched + sideways[:, None] * across)

    def _ahead(self, towards: Vector) -> Vector:
        # what the thrust still adds counts too: without it, a light vehicle exceeds the claim's speed
        claim, period = self.claim, self.claim.watch.period
        # what the thrust still adds counts too: without it, light vehicles with a lag exceed the claim's speed
        stored = towards + self.lag * np.sum(self.thrust * self.latched, axis=1) / self.mass
        return np.asarray(np.clip((claim.fastest - stored) * self.mass / period - self.pushed, 0.0, self.ahead))

    def _aside(self, across: Vector) -> Vector:
        """Return the thrust across the latched direction while a vehicle with unequal masses brakes."""
        claim, aside = self.claim, np.sum(self.velocity * across, axis=1)
        thrust = claim.side * self.rng.choice((-1.0, 0.0, 1.0), self.runs)
        allowed = np.abs(aside) + claim.side * claim.watch.period / claim.brakes.masses[0] + 0.02 < claim.sideways
        return np.asarray(np.where(allowed | (thrust * aside < 0), thrust, 0.0)[:, None] * across)

    def _obstacle(self, across: Vector) -> Vector:
        # mostly towards the vehicle
        mood = self.mood[:, None]
        on = -self.latched
        slant = (on + 0.5 * across) / np.sqrt(1.25)
        return np.where(mood < 0.5, on, np.where(mood < 0.7, slant, np.where(mood < 0.85, across, -on)))

    def step(self) -> None:
        b, h = self.claim.brakes, _STEP
        force = self.thrust + (b.disturbance * self.latched if b.disturbance else 0.0) - self._drag()
        rate = force / self.mass[:, None] if self.claim.ratio == 1 else self._accelerated(force)
        self.gap = self.gap + h * (self.came - self.velocity - h / 2 * rate)
        self.velocity = self.velocity + h * rate
        share = 1 - np.exp(-h / np.maximum(self.lag, 1e-6))
        turned = _turned(self.thrust, self.turn * h)  # the delivered thrust turns with the hull
        self.thrust = turned + share[:, None] * (self.command - turned)
        self.heading = self.heading + self.turn * h

    def _accelerated(self, force: Vector) -> Vector:
        own, moving = _turned(force, -self.heading), _turned(self.velocity, -self.heading)
        # m1 u̇ = X + m2 v r and m2 v̇ = Y − m1 u r, seen in axes that do not turn
        apart = (self.turn * (self.masses[:, 1] - self.masses[:, 0]))[:, None]
        return _turned((own + apart * moving[:, ::-1]) / self.masses, self.heading)

    def _drag(self) -> Vector:
        b = self.claim.brakes
        v = self.velocity - b.current * self.latched
        back = np.sum(v * self.latched, axis=1) < 0
        bad = (self.worst & back)[:, None]
        linear = np.where(bad, b.linear[1], self.linear)
        quadratic = np.where(bad, b.quadratic[1], self.quadratic)
        if self.claim.drag == "along":
            size = np.linalg.norm(v, axis=1)[:, None]
            return np.asarray((linear[:, :1] + quadratic[:, :1] * size) * v)
        own = _turned(v, -self.heading)
        return _turned((linear + quadratic * np.abs(own)) * own, self.heading)


def _unit(angle: Vector) -> Vector:
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _turned(vector: Vector, angle: Vector) -> Vector:
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * vector[:, 0] - s * vector[:, 1], s * vector[:, 0] + c * vector[:, 1]])


def allowed_speed(brakes: Brakes, watch: Watch, measured: float, *, obstacle: float = 0.0) -> float:
    """Return the largest speed of the robot [m/s] at which another period without braking is safe.

    The function assumes that the robot was not faster since the echo. If the robot is too near to the obstacle even at
    a closing speed of 0, the function continues linearly below this speed, so the robot must retreat. The result is
    −inf if the obstacle is too fast for braking.
    """
    left = brakes.left(obstacle)
    if left <= 0:
        return -inf
    gain, late = brakes.acceleration(obstacle), watch.age + watch.period
    gained, swing = gain * watch.period, brakes.lag * max(brakes.most + brakes.least, 0.0)
    rest = measured - watch.range_error - gain * watch.period**2 / 2 + late * gained
    closing = inf
    for m in brakes.masses:
        k, lost = m / (2 * left), swing / m
        remaining, slope = rest - k * lost**2, late + 2 * k * lost
        closing = min(closing, 2 * remaining / (slope + sqrt(slope**2 + 4 * k * max(remaining, 0.0))))
    return closing - watch.speed_error - obstacle - gained

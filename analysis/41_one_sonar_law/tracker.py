"""Trackers of surfaces on recorded firings, beside the present map: how far is each from the truth?

    python analysis/41_one_sonar_law/tracker.py            # four echo models, three scenarios, two seeds; some minutes
    python analysis/41_one_sonar_law/tracker.py --quick    # 5 s of one run in `pool-static`

`--scenario`, `--echoes` and `--maps` choose one; `--exact` replays the true pose, `--still` stops the drift of the
obstacles. Prints Markdown. The exit status is 2 for a bad option.

- `present`: the marked cells of the law of the library, with the radius that the law gives them.
- `arcs` (`Arcs`): an echo that no point explains adds the points of its arc that recent firings did not show to be
  free. An echo moves the points of the body that explains it; silence removes the points that should have answered.
- `arcs-5`: the same, but silence counts only from directions within 5 degrees of those from which a point answered.
- `points-10` (`Points`): at most 64 points, each with 40 weighted hypotheses of its place on the arc of its first echo.
  The map stops the hull where it meets a point with a probability of 10 %; silence counts as in `arcs-5`, and less.
- `elements-R` (`Elements`): at most 16 bodies, each with 100 weighted hypotheses of its place, radius and velocity. The
  map stops the hull where it meets a body with probability R in per cent.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from recorded import EACH, ECHOES, Array, Firing, Judge, Recorded, cells, present, record, stops_at

from surctl.marine.sensing import SonarArray

SCENARIOS = ("pool-static", "tank-static", "tank-slalom")
HEAD = (
    "| scenario | echoes | map | directions | median [cm] | 99 % of sizes [cm] | least [cm] | most [cm] "
    "| above 3 cm [%] | lost | not measured |\n|---|---|---|---|---|---|---|---|---|---|---|"
)
DRIFT, AMPLITUDE = 0.03, 0.06  # m/s and m: largest speed and way of a surface that drifts
MEMORY = 6.0  # s, age of the oldest firing that shows free water
EDGE = 0.03  # rad inside the beam's edge from which silence counts
SPREAD = 0.012  # m, standard deviation of a reading with the error of the robot's position


class Map(Protocol):
    """A map of surfaces that firings update."""

    def update(self, firing: Firing) -> None:
        """Update the map with one firing."""

    def stops(self, here: Array, hull: float) -> Array:
        """Return the ways (directions,) [m] of a hull from `here` until the map stops it."""

    def surface(self, here: Array) -> Array:
        """Return the places (n, 2) [m] of the surfaces next to a position (2,) [m] that count."""

    def covers(self, place: Array) -> bool:
        """Return whether the map has a surface within 0.1 m of a place (2,) [m]."""


class Free:
    """The recent firings of one run, which show where the water is free."""

    def __init__(self, half: float) -> None:
        self.half = half
        self.rows = np.zeros((0, 5))  # apex x, y, axis, range up to which the beam is free, time

    def add(self, firing: Firing, free: float) -> None:
        """Remember a firing that shows free water up to a range [m]."""
        rows = np.vstack([self.rows, [*firing.apex, firing.axis, free, firing.time]])
        self.rows = rows[rows[:, 4] > firing.time - MEMORY]

    def holds(
        self, points: Array, time: float, towards: Array | None = None, within: float = np.pi
    ) -> NDArray[np.bool_]:
        """Return for each point (n, 2) [m] whether two firings show that no surface can have drifted there.

        Only firings within `within` [rad] of the directions `towards` (n,) [rad] count.
        """
        away = points[:, None, :] - self.rows[None, :, :2]
        far, slack = np.hypot(away[..., 0], away[..., 1]), np.minimum(DRIFT * (time - self.rows[:, 4]), AMPLITUDE)
        bearing = np.arctan2(away[..., 1], away[..., 0])
        off = np.abs(wrapped(bearing - self.rows[:, 2]))
        same = True if towards is None else np.abs(wrapped(bearing - towards[:, None])) < within
        deep = np.sin(np.clip(self.half - EDGE - off, -1.5, 1.5)) * far
        return np.asarray((same & (deep > slack) & (far < self.rows[:, 3] - slack)).sum(axis=1) >= 2)


class Arcs:
    """Points on the arcs of echoes, each with the directions from which it answered and a score from 0 to 3."""

    SILENCE = 0.025  # m by which a point must be nearer than the reading for its silence to count
    EXPLAINS = 0.03  # m between a reading and the point that explains it
    GAIN = 0.3  # share of the difference by which the point's body moves
    BODY = 0.12  # m around the point that explains an echo: its body
    STEP = 0.065  # rad between two points of a new arc

    def __init__(self, array: SonarArray, *, within: float = np.pi, most: float = np.inf) -> None:
        """Start without points.

        Args:
            array: the sonars.
            within: angle [rad] beside the directions from which a point answered, within which silence counts.
            most: width [m] of the points that may explain an echo, up to which it counts as from all their directions.
        """
        self.array, self.half, self.within, self.most = array, array.half_angle, within, most
        self.free = Free(self.half)
        self.places = np.zeros((0, 2))
        # score, time of the last echo, first and last direction towards the sonar, time of the last range
        self.rest = np.zeros((0, 5))

    def update(self, firing: Firing) -> None:
        """Remove the points whose silence this firing shows, and move or add the points that explain its echo."""
        away = self.places - firing.apex
        far, bearing = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
        off = np.abs(wrapped(bearing - firing.axis))
        if not firing.blind:
            free = firing.reading - self.SILENCE
            middle, width = self.rest[:, 2:4].mean(axis=1), np.diff(self.rest[:, 2:4]).ravel()
            answers = np.abs(wrapped(bearing + np.pi - middle)) <= width / 2 + self.within
            self.rest[:, 0] -= (off < self.half - EDGE) & (far < free) & answers
        if not firing.silent and not firing.known:
            slack = self.EXPLAINS + DRIFT * np.minimum(firing.time - self.rest[:, 1], 1.0)
            fits = far < self.array.blind + self.EXPLAINS if firing.blind else np.abs(far - firing.reading) < slack
            fits &= (off < self.half + EDGE) & (self.rest[:, 0] > 0)
            if fits.any():
                self._explained(firing, fits, away, far)
            else:
                self._add(firing)
        if not firing.blind:
            self.free.add(firing, free)
        stays = self.rest[:, 0] > 0
        self.places, self.rest = self.places[stays], self.rest[stays]

    def _explained(self, firing: Firing, fits: NDArray[np.bool_], away: Array, far: Array) -> None:
        towards = np.arctan2(-away[fits, 1], -away[fits, 0])
        if not firing.blind:
            one = np.flatnonzero(fits)[np.argmin(far[fits])]
            body = np.hypot(*(self.places - self.places[one]).T) < self.BODY
            self.places[body] += self.GAIN * (firing.reading - far[one]) * away[one] / max(far[one], 0.05)
        first = self.rest[fits, 2]
        spread = firing.reading * np.ptp(wrapped(towards + np.pi - firing.axis))
        turned = first + wrapped(towards - first) if spread <= self.most else first
        self.rest[fits] = np.stack(
            [
                np.minimum(self.rest[fits, 0] + 1, 3),
                np.full(len(first), firing.time),
                np.minimum(first, turned),
                np.maximum(self.rest[fits, 3], turned),
                self.rest[fits, 4] if firing.blind else np.full(len(first), firing.time),
            ],
            axis=1,
        )

    def _add(self, firing: Firing) -> None:
        bearing = firing.axis + np.linspace(-self.half, self.half, int(2 * self.half / self.STEP) + 1)
        reach = self.array.blind if firing.blind else firing.reading
        arc = firing.apex + reach * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        may = ~self.free.holds(arc, firing.time)
        may |= not may.any()  # an object has moved to where the water was free
        towards = wrapped(bearing[may] + np.pi)
        now = np.full(len(towards), firing.time)
        rest = np.stack([np.ones(len(towards)), now, towards, towards, now], axis=1)
        self.places, self.rest = np.vstack([self.places, arc[may]]), np.vstack([self.rest, rest])

    def stops(self, here: Array, hull: float) -> Array:
        """Return the ways of the hull until it touches a point."""
        reach = np.full(len(self.places), hull)
        return np.asarray(stops_at(here, self.places, reach).min(axis=0, initial=np.inf))

    def surface(self, here: Array) -> Array:
        """Return the points (n, 2) [m]."""
        return self.places

    def covers(self, place: Array) -> bool:
        """Return whether a point is within 0.1 m."""
        return bool(np.hypot(*(self.places - place).T).min(initial=np.inf) < 0.1)


class Elements:
    """At most 16 round bodies; the hypotheses of a body exclude each other, and an echo belongs to one body."""

    COUNT, HYPOTHESES = 16, 100
    RADII = (0.02, 0.05, 0.1)  # m
    DETECTED = 0.9  # probability that a surface in the beam answers
    SURE = 0.99  # largest probability that a body exists, so that silence can refute it
    SOFT = 0.02  # rad over which the edge of the beam is soft
    SPEED, CHANGES = 0.015, 2.5  # m/s and s: standard deviation of a body's velocity, and how fast it changes
    LEAST = 1e-3  # least likelihood of an echo for a body to explain it
    FAR = 1.3  # m, readings beyond it add no body

    def __init__(self, array: SonarArray, *, risk: float, seed: int = 0) -> None:
        self.array, self.risk, self.rng = array, risk, np.random.default_rng(seed)
        self.free = Free(array.half_angle)
        shape = (self.COUNT, self.HYPOTHESES)
        self.centre, self.velocity = np.zeros((*shape, 2)), np.zeros((*shape, 2))
        self.weight, self.radius, self.exists = np.zeros(shape), np.zeros(shape), np.zeros(self.COUNT)
        self.time = 0.0

    def update(self, firing: Firing) -> None:
        """Weigh the hypotheses by what they predict of this firing; add a body if none explains the echo."""
        self._move(firing.time - self.time)
        self.time = firing.time
        away = self.centre - firing.apex
        middle = np.hypot(away[..., 0], away[..., 1])
        off = np.abs(wrapped(np.arctan2(away[..., 1], away[..., 0]) - firing.axis))
        inside = 1 / (1 + np.exp((off - self.array.half_angle) / self.SOFT))
        beside = np.arcsin(np.clip(self.radius / np.maximum(middle, 0.01), 0, 1))
        rim = 1 / (1 + np.exp(np.clip((off - beside - self.array.half_angle) / self.SOFT, None, 500)))
        excess = (firing.reading - middle + self.radius) / SPREAD
        factor = 1 - self.DETECTED * inside * _share(excess - 2) * (not firing.blind)
        alive, owner = self.exists > 0, -1
        if not firing.silent and not firing.known:
            excess += (self.array.blind - firing.reading) / SPREAD if firing.blind else 0
            like = rim * (_share(excess) if firing.blind else np.exp(-(excess**2) / 2))
            total = np.where(alive, self.exists * (self.weight * like).sum(axis=1), 0)
            if total.max() > self.LEAST:
                owner = int(np.argmax(total))
                factor[owner] = like[owner] + 1e-4 * factor[owner]
        after = self.weight * factor
        share = after.sum(axis=1)
        self.weight = after / np.maximum(share, 1e-300)[:, None]
        self.exists *= share / np.maximum(1 - self.exists + self.exists * share, 1e-9)
        if owner >= 0:
            self.exists[owner] = np.clip((1 + self.exists[owner]) / 2, 0.9, self.SURE)
        self.exists[self.exists < 0.05] = 0
        for k in np.flatnonzero(self.exists > 0):
            if (self.weight[k] ** 2).sum() > 3 / self.HYPOTHESES:
                self._resample(k, firing.apex)
        if not firing.silent and not firing.known and owner < 0 and firing.reading < self.FAR:
            self._add(firing)
        if not firing.blind:
            self.free.add(firing, firing.reading - 2 * SPREAD)

    def _move(self, dt: float) -> None:
        share = max(dt, 0.0) / self.CHANGES
        noise = self.rng.standard_normal(self.velocity.shape)
        self.velocity = (1 - share) * self.velocity + self.SPEED * np.sqrt(2 * share) * noise
        speed = np.hypot(self.velocity[..., 0], self.velocity[..., 1])[..., None]
        self.velocity /= np.maximum(speed / DRIFT, 1)
        self.centre += max(dt, 0.0) * self.velocity

    def _resample(self, k: int, apex: Array) -> None:
        # some hypotheses take another radius, with the same front towards the sonar
        many, chosen = self.HYPOTHESES, self._chosen(k)
        centre, radius = self.centre[k, chosen], self.radius[k, chosen]
        away = centre - apex
        other = np.where(self.rng.random(many) < 0.03, self.rng.choice(self.RADII, many), radius)
        centre = centre + ((other - radius) / np.maximum(np.hypot(*away.T), 0.01))[:, None] * away
        self.centre[k] = centre + 0.003 * self.rng.standard_normal((many, 2))
        self.velocity[k], self.radius[k], self.weight[k] = self.velocity[k, chosen], other, 1 / many

    def _chosen(self, k: int) -> NDArray[np.intp]:
        # systematic resampling
        steps = (np.arange(self.HYPOTHESES) + self.rng.random()) / self.HYPOTHESES
        return np.minimum(np.searchsorted(np.cumsum(self.weight[k]), steps), self.HYPOTHESES - 1)

    def _drawn(self, firing: Firing) -> tuple[int, Array, Array]:
        # the body that a new one replaces (an empty one, or else the farthest), and bearings and ranges of the echo
        many = self.HYPOTHESES
        distance = np.hypot(*np.moveaxis(self.centre.mean(axis=1) - firing.apex, -1, 0))
        reach = firing.reading + SPREAD / 2 * self.rng.standard_normal(many)
        if firing.blind:
            reach = self.array.blind * np.sqrt(self.rng.random(many))
        bearing = firing.axis + self.array.half_angle * self.rng.permutation(np.linspace(-1, 1, many))
        return int(np.argmax(np.where(self.exists > 0, distance, np.inf))), bearing, reach

    def _add(self, firing: Firing) -> None:
        many, (k, bearing, reach) = self.HYPOTHESES, self._drawn(firing)
        ray = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        front = firing.apex + reach[:, None] * ray
        self.radius[k] = self.rng.choice(self.RADII, many)
        self.centre[k] = front + self.radius[k][:, None] * ray
        self.velocity[k] = self.SPEED * self.rng.standard_normal((many, 2))
        weight = np.where(self.free.holds(front, firing.time), 1e-4, 1.0)
        self.weight[k], self.exists[k] = weight / weight.sum(), 0.9

    def stops(self, here: Array, hull: float) -> Array:
        """Return the ways of the hull until it meets a body with the probability `risk`."""
        live = self.exists > 0
        ways = stops_at(here, self.centre[live], hull + self.radius[live])
        order = np.argsort(ways, axis=1)
        weight = np.take_along_axis(np.broadcast_to(self.weight[live][..., None], ways.shape), order, axis=1)
        met = np.cumsum(weight, axis=1) * self.exists[live, None, None] >= self.risk
        ways = np.where(met, np.take_along_axis(ways, order, axis=1), np.inf)
        return np.asarray(ways.min(axis=(0, 1), initial=np.inf))

    def surface(self, here: Array) -> Array:
        """Return the places (n, 2) [m] next to `here` of the hypotheses that count.

        Those of each body that are left out are the least probable ones, and have together the probability `risk`.
        """
        order = np.argsort(self.weight, axis=1)
        out = np.cumsum(np.take_along_axis(self.weight, order, axis=1), axis=1) * self.exists[:, None] < self.risk
        counts = np.ones_like(out)
        np.put_along_axis(counts, order, ~out, axis=1)
        away = self.centre[counts] - here
        far = np.maximum(np.hypot(*away.T), 1e-3)
        return np.asarray(here + (1 - self.radius[counts] / far)[:, None] * away)

    def covers(self, place: Array) -> bool:
        """Return whether the surface of a body is within 0.1 m, with a probability above 0.3."""
        away = place - self.centre
        near = np.abs(np.hypot(away[..., 0], away[..., 1]) - self.radius) < 0.1
        return bool(((self.weight * near).sum(axis=1) * self.exists).max() > 0.3)


class Points(Elements):
    """At most 64 surface points; the places of a point on its arc exclude each other.

    Silence counts as in `arcs-5`. An echo is a likelihood for the places of the point that explains it; one that none
    explains adds a point.
    """

    COUNT, HYPOTHESES, RADII = 64, 40, (0.0,)
    LEAST = 0.05  # least probability of an echo for a point to explain it
    DETECTED = 0.3  # less than for a body: silence from the same direction tells the same again
    JITTER = 0.003  # m
    OTHER = 0.02  # probability that the echo comes from elsewhere
    WITHIN = float(np.radians(5))  # rad around the directions from which a place answered, where silence counts
    GAIN, BODY = 0.3, 0.12  # share of a difference by which a place follows, and m around it that follow with it

    def __init__(self, array: SonarArray, *, risk: float, seed: int = 0) -> None:
        super().__init__(array, risk=risk, seed=seed)
        self.middle, self.width = np.zeros_like(self.weight), np.zeros_like(self.weight)  # rad, where it answered from

    def update(self, firing: Firing) -> None:
        """Weigh the places by what they predict of this firing; add a point if none explains the echo."""
        self.time = firing.time
        live = np.flatnonzero(self.exists > 0)
        away, exists = self.centre[live] - firing.apex, self.exists[live]
        far, towards = np.hypot(away[..., 0], away[..., 1]), np.arctan2(away[..., 1], away[..., 0])
        off, turned = np.abs(wrapped(towards - firing.axis)), wrapped(towards + np.pi - self.middle[live])
        inside = 1 / (1 + np.exp(np.clip((off - self.array.half_angle) / self.SOFT, -500, 500)))
        excess = (firing.reading - far) / SPREAD
        answers = np.abs(turned) <= self.width[live] + self.WITHIN
        factor = 1 - self.DETECTED * inside * answers * _share(excess - 2) * (not firing.blind)
        owner, echo = -1, not firing.silent and not firing.known
        if echo:
            near = (self.array.blind - far) / SPREAD
            like = inside * (_share(near) if firing.blind else np.exp(-(excess**2) / 2))
            total = exists * (self.weight[live] * like).sum(axis=1)
            if total.max(initial=0) > self.LEAST:
                owner = int(np.argmax(total))
                factor[owner] = like[owner] + self.OTHER * factor[owner]
        after = self.weight[live] * factor
        share = after.sum(axis=1)
        self.weight[live] = after / np.maximum(share, 1e-300)[:, None]
        self.exists[live] *= share / np.maximum(1 - exists + exists * share, 1e-9)
        self.exists[self.exists < 0.05] = 0
        if owner >= 0:
            k = live[owner]
            self.exists[k] = np.clip((1 + self.exists[k]) / 2, 0.9, self.SURE)
            low, high = np.minimum(-self.width[k], turned[owner]), np.maximum(self.width[k], turned[owner])
            heard = like[owner] > 0.3
            self.middle[k] += np.where(heard, (low + high) / 2, 0)
            self.width[k] = np.where(heard, (high - low) / 2, self.width[k])
            if not firing.blind:
                step = self.GAIN * SPREAD * like[owner] * excess[owner] / np.maximum(far[owner], 0.05)
                self._follow(k, step[:, None] * away[owner])
            if (self.weight[k] ** 2).sum() > 3 / self.HYPOTHESES:
                self._resample(k, firing.apex)
        elif echo and firing.reading < self.FAR:
            self._add(firing)
        if not firing.blind:
            self.free.add(firing, firing.reading - 2 * SPREAD)

    def _follow(self, owner: int, move: Array) -> None:
        # the places follow the echo, and so does what belongs to the same body
        here, mean = self.weight[owner] @ self.centre[owner], self.weight[owner] @ move
        beside = np.hypot(self.centre[..., 0] - here[0], self.centre[..., 1] - here[1]) < self.BODY
        beside[owner] = False
        self.centre[owner] += move
        self.centre[beside] += mean

    def _resample(self, k: int, apex: Array) -> None:
        chosen = self._chosen(k)
        self.centre[k] = self.centre[k, chosen] + self.JITTER * self.rng.standard_normal((self.HYPOTHESES, 2))
        self.middle[k], self.width[k] = self.middle[k, chosen], self.width[k, chosen]
        self.weight[k] = 1 / self.HYPOTHESES

    def _add(self, firing: Firing) -> None:
        k, bearing, reach = self._drawn(firing)
        self.centre[k] = firing.apex + reach[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        self.middle[k], self.width[k] = wrapped(bearing + np.pi), 0.0
        weight = np.where(self.free.holds(self.centre[k], firing.time, bearing, self.WITHIN), 1e-2, 1.0)
        self.weight[k], self.exists[k] = weight / weight.sum(), 0.9


def wrapped(angle: Array) -> Array:
    """Return angles [rad] between -pi and pi."""
    return np.asarray(np.mod(angle + np.pi, 2 * np.pi) - np.pi)


def _share(z: Array) -> Array:
    # the normal distribution, as a logistic function
    return np.asarray(1 / (1 + np.exp(-1.7 * np.clip(z, -15, 15))))


def replay(run: Recorded, tracker: Map) -> Judge:
    """Return the errors of a tracker over a recorded run."""
    judge = Judge(run)
    for k, firings in enumerate(run.firings):
        judge.hear(firings)
        for firing in firings:
            tracker.update(firing)
        if k % EACH == 0:
            judge.compare(k, tracker.stops(run.true[k], run.hull), tracker.covers)
    return judge


MAPS: dict[str, Callable[[Recorded], Judge]] = {
    "present": present,
    "arcs": lambda run: replay(run, Arcs(run.array)),
    "arcs-5": lambda run: replay(run, Arcs(run.array, within=np.radians(5))),
    "elements-10": lambda run: replay(run, Elements(run.array, risk=0.1)),
    "elements-50": lambda run: replay(run, Elements(run.array, risk=0.5)),
    "points-10": lambda run: replay(run, Points(run.array, risk=0.1)),
}


def main(words: list[str]) -> int:
    """Run the comparison and print its table."""
    parser = argparse.ArgumentParser(prog="tracker.py", description="Compare maps of recorded firings with the truth.")
    parser.add_argument("--quick", action="store_true", help="5 s of one run in pool-static with ideal echoes")
    parser.add_argument("--seeds", type=int, default=2, help="runs of each row (default 2)")
    parser.add_argument("--scenario", choices=SCENARIOS, help="only this scenario")
    parser.add_argument("--echoes", choices=tuple(ECHOES), help="only this echo model")
    parser.add_argument("--maps", choices=tuple(MAPS), help="only this map")
    parser.add_argument("--exact", action="store_true", help="replay the true pose instead of its estimate")
    parser.add_argument("--still", action="store_true", help="simulate without the drift of obstacles")
    options = parser.parse_args(words)
    if options.seeds < 1:
        parser.error("--seeds: must be at least 1")
    kind: dict[str, Any] = {"exact": options.exact, "still": options.still, "limit": 5.0 if options.quick else None}
    print(HEAD)
    for name in [options.scenario] if options.scenario else SCENARIOS[: 1 if options.quick else None]:
        for echoes in [options.echoes] if options.echoes else list(ECHOES)[: 1 if options.quick else None]:
            runs = [record(name, echoes, seed, **kind) for seed in range(1 if options.quick else options.seeds)]
            for label in [options.maps] if options.maps else MAPS:
                print(f"| `{name}` | {echoes} | {label} | {cells([MAPS[label](run) for run in runs])} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

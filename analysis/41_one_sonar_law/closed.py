"""A short law by sonar in the closed loop: the points of `tracker.py`, a cost-to-go of their map, and a fan of courses.

    python analysis/41_one_sonar_law/closed.py            # eight scenarios, two echo models, 5 seeds; some minutes
    python analysis/41_one_sonar_law/closed.py --quick    # 3 s of one run in `pool-static`

`--scenario`, `--echoes`, `--law` and `--seeds` choose; `--why` adds a line for each run that does not arrive. Prints
Markdown. The exit status is 2 for a bad option.

The law takes pose, heave and yaw moment from the law of the library, and computes the horizontal thrust:

- map: `Points`, in which each place counts that is not among the least probable ones of its arc;
- cost-to-go on 24 x 24 cells, again every 0.5 s: a cell that the hull cannot enter costs 100 times its length, and
  water that no beam has reached `UNKNOWN` times more;
- of 72 courses at speeds from which the robot can brake, those that come least too near to a mover, and of these the
  one that comes farthest along the descent. The prediction includes the time in which the thrust changes the velocity.
  A speed above the cruise speed counts as the cruise speed, so only a mover makes the robot faster;
- with `faces`, the faces of `faces.py` also bound the speed, and the yaw moment keeps what is reached first in a beam;
- inner waypoints in order: each counts as passed within the hull radius of it, or, where the hull has no room in the
  map, of the first place of the path after it that has room.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from faces import Faces
from numpy.typing import NDArray
from recorded import ECHOES, Array, Ears, Firing, Pose, distances, level_echo
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from to_go import CELLS
from tracker import DRIFT, Arcs, Elements, Map, Points, wrapped

from surctl.marine.control import Law, build_law, default_law, load_gains
from surctl.marine.control.ports import YAW_SHARE
from surctl.marine.sensing import SonarArray
from surctl.marine.simulation import Run, Scenario, load_scenario, simulate
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.world import Disc, site_walls
from surctl.system import ControllerStep

SCENARIOS = (
    "pool-static", "tank-static", "tank-slalom", "tank-moving", "pool-speed-020", "tank-speed-020", "pool-ahead",
    "pool-behind",
)  # fmt: skip
MAPS: dict[str, Callable[[SonarArray], Map]] = {
    "drifting": lambda array: Drifting(array),
    "faces": lambda array: Drifting(array),
    "faces-strict": lambda array: Drifting(array, most=Arcs.BODY),
    "points": lambda array: Points(array, risk=RISK),
    "elements": lambda array: Elements(array, risk=RISK),
    "arcs-5": lambda array: Arcs(array, within=np.radians(5)),
}
LAWS = ("library", *MAPS)
MODELS = ("ideal", "webots")
HEAD = (
    "| scenario | echoes | law | runs | arrived | touched | else | mean time [s] | median [s] | slowest [s] "
    "| least clearance [m] |\n|---|---|---|---|---|---|---|---|---|---|---|"
)
RISK = 0.1  # probability of the places of a point that the map leaves out
MARGIN = 0.03  # m between the hull and a place that counts, for drift, position and shape
SPEED, AMPLITUDE = 0.015, 0.05  # m/s and m: drift of a surface
UNKNOWN = 1.0  # price of unknown water: share by which its way counts as longer
FROM_PATH = 1.0  # 1/m, as in `to_go.py`
EVERY = 10  # control steps between two costs-to-go
AHEAD = 0.5  # m along the descent to which the wanted course leads
NEAR_GOAL = 0.4  # m from the goal within which the course leads straight to it
COURSES, KEEPS = 72, 0.4  # number of courses, and weight of the last one beside the wanted one
BRAKE, HARD = 4.0, 0.02  # as in `surctl.marine.control.stopping`
STEPS = np.arange(0.5, 12.5, 0.5)  # s, prediction of movers; it ends `AFTER` the arrival, as in the library's law
AFTER = 3.0  # s
PASSING = 0.15  # m from a mover: the margin of the library's law and what it keeps beyond it
SAME = 0.005  # m by which two velocities may come too near to a mover before the nearer one is worse
LOOKS = 0.8  # m from the hull: places within it are kept in a beam; braking and a turn by 45 degrees need less
TURNS_BACK = float(np.radians(15))  # rad from a beam's axis; 22 degrees are covered 0.2 m from the hull, 8 to turn back
LAG = 0.1  # s, age of the position in the law's state

_TURNS = 2 * np.pi * np.arange(COURSES) / COURSES
_COURSES = np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=1)


class Drifting(Arcs):
    """The points of `arcs-5`, each nearer by what it may have drifted since an echo had its range.

    The drift and `MARGIN` add as independent errors.
    """

    def __init__(self, array: SonarArray, *, most: float = np.inf) -> None:
        super().__init__(array, within=np.radians(5), most=most)
        self.now = 0.0

    def update(self, firing: Firing) -> None:
        """Update the points with one firing."""
        self.now = firing.time
        super().update(firing)

    def surface(self, here: Array) -> Array:
        """Return the points (n, 2) [m], moved towards `here` (2,) [m]."""
        away = self.places - here
        drift = np.minimum(SPEED * (self.now - self.rest[:, 4]), AMPLITUDE)
        nearer = np.hypot(MARGIN, drift) - MARGIN
        return np.asarray(here + (1 - nearer / np.maximum(np.hypot(*away.T), 0.01))[:, None] * away)


class SonarLaw:
    """The law of one run; it takes the place of the law's step in `simulate`."""

    def __init__(self, scenario: Scenario, vehicle: Vehicle, law: Law, echoes: str, which: str) -> None:
        self.law, self.hull = law, vehicle["radius"]
        self.array = scenario.sensors.array_on(self.hull)
        self.extent = np.array(scenario.site[:2])
        walls = site_walls(float(self.extent[1]), float(self.extent[0]))
        self.ears = Ears(self.array, [*walls], level_echo(scenario, self.array, echoes))
        self.map = MAPS[which](self.array)
        self.faces = Faces(self.array) if which.startswith("faces") else None
        self.side, self.vehicle = 1.0, vehicle
        self.latency = scenario.sensors.equipment.station.messages.latency
        self.way, self.leg, self.gain = scenario.path.waypoints, 0, load_gains("default").values
        self.cruise, self.cap, self.limit = scenario.cruise, scenario.cap, np.array(vehicle.thrust_limit)
        self.mass, self.drag = np.array(vehicle.mass), np.array(vehicle.drag_at(self.cruise))
        self.quadratic = np.array(vehicle.quadratic_drag)
        self.slows = self.gain["brake"] * self.limit[:2].min() / self.mass[:2].max()  # m/s^2
        self.size = self.extent / CELLS
        self.centres = (np.stack(np.meshgrid(*[np.arange(CELLS)] * 2, indexing="ij"), axis=-1) + 0.5) * self.size
        self.seen = np.zeros((CELLS, CELLS), dtype=bool)
        along = np.diff(self.way, axis=0)
        off = self.centres[..., None, :] - self.way[:-1]
        share = np.clip((off * along).sum(axis=-1) / (along**2).sum(axis=-1), 0, 1)
        self.beside = np.hypot(*np.moveaxis(off - share[..., None] * along, -1, 0))
        self.edges, self.k, self.last = edges(self.centres), 0, np.zeros(2)
        self.movers, self.told = np.zeros((0, 5)), 0

    def __call__(self, x: Array, u: Array, p: Array) -> ControllerStep:
        """Return the control step; see `surctl.marine.simulation.loop.Stepper`."""
        inner, law = self.law.step(x, u, p), self.law
        if inner.status < 0:
            return inner  # an input is not finite
        after = inner.x_next.copy()
        own = {one: after[law.state.slice(f"own_{one}")] for one in ("position", "velocity", "turn")}
        velocity, heading = own["velocity"][:2], float(own["turn"][0])
        here = own["position"][:2] + LAG * velocity
        self._listen(u, Pose(here, heading, velocity, float(own["turn"][1])))
        self.here = here
        self.beside_heard = self.faces.places() if self.faces else np.zeros((0, 2))
        if self.k % EVERY == 0:
            self._plan()
        wanted = self.decide(here, velocity)
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, s], [-s, c]])
        reference, error = turn @ wanted, turn @ (wanted - velocity)
        drag = self.drag[:2] * reference + self.quadratic[:2] * reference * np.abs(reference)
        free = drag + self.gain["k_v"] * self.mass[:2] * error
        tau = inner.tau.copy()
        tau[:2] = np.clip(free, -self.limit[:2], self.limit[:2])
        if self.faces:
            tau[3] = self._moment(here, heading, velocity, float(own["turn"][1]))
        after[law.state.slice("last_thrust")] = tau
        after[law.state.slice("trapped")] = 0
        told = inner.telemetry.copy()
        told[law.telemetry_slice("trapped")] = 0
        self.k += 1
        return ControllerStep(tau, after, 0, told)

    def _surface(self, here: Array) -> Array:
        return np.concatenate([self.map.surface(here), self.beside_heard])

    def _moment(self, here: Array, heading: float, velocity: Array, rate: float) -> float:
        # turn on, but turn back before the place that the robot reaches first leaves its beam
        away = self._surface(here) - here
        far = np.maximum(np.hypot(*away.T), 1e-3)
        gap = np.where(far - self.hull < LOOKS, np.maximum(far - self.hull, 0.01), np.inf)
        when = gap / np.maximum(away @ velocity / far, DRIFT)
        if when.min(initial=np.inf) < np.inf:
            first = away[int(np.argmin(when))]
            off = wrapped(np.arctan2(first[1], first[0]) - heading - np.array(self.array.azimuths))
            nearest = off[int(np.argmin(np.abs(off)))]
            self.side = float(np.sign(nearest)) if abs(nearest) > TURNS_BACK else self.side
        vehicle, limit = self.vehicle, self.limit[3]
        turning = self.side * min(self.gain["spin"], vehicle.steady_yaw(YAW_SHARE, self.cruise))
        drag = vehicle.drag_at(self.cruise)[3] * turning + vehicle.quadratic_drag[3] * turning * abs(turning)
        return float(np.clip(drag + self.gain["k_r"] * vehicle.mass[3] * (turning - rate), -limit, limit))

    def _listen(self, u: Array, pose: Pose) -> None:
        inputs = self.law.inputs
        samples = u[inputs.slice("samples")].reshape(self.array.size, -1)
        if "contacts" in inputs and u[inputs.slice("contacts_fresh")][0] > 0.5:
            rows = u[inputs.slice("contacts")].reshape(-1, 6)
            self.movers, self.told = rows[rows[:, 5] > 0.5, :5], self.k
        self.movers_now = self.movers.copy()
        self.movers_now[:, :2] += ((self.k - self.told) * self.law.dt + self.latency) * self.movers[:, 3:]
        shapes: list[Any] = [Disc((m[0], m[1]), m[2]) for m in self.movers_now]
        readings = np.sort(samples, axis=1)[:, 1:-1].mean(axis=1)
        for _, firing in self.ears.heard(self.k, pose, readings, u[inputs.slice("fresh")] > 0.5, shapes):
            self.map.update(firing)
            if self.faces:
                self.faces.add(firing)
            if not firing.blind:
                self._see(firing)
        around = np.hypot(*np.moveaxis(self.centres - pose.position, -1, 0)) < self.hull + np.max(self.size)
        self.seen |= around

    def _see(self, firing: Firing) -> None:
        away = self.centres - firing.apex
        off = np.abs(wrapped(np.arctan2(away[..., 1], away[..., 0]) - firing.axis))
        self.seen |= (off < self.array.half_angle) & (np.hypot(away[..., 0], away[..., 1]) < firing.reading)

    def _plan(self) -> None:
        places, keep = self._surface(self.here), self.hull + MARGIN
        gap = np.minimum(self.centres, self.extent - self.centres).min(axis=-1)
        if len(places):
            gap = np.minimum(gap, KDTree(places).query(self.centres)[0])
        target = self._target(gap >= keep)
        beside = self.beside[..., self.leg :].min(axis=-1)
        weight = 1 + FROM_PATH * beside + UNKNOWN * ~self.seen + 100.0 * (gap < keep)
        flat, (one, other, length) = weight.ravel(), self.edges
        graph = csr_array((length * (flat[one] + flat[other]) / 2, (one, other)), shape=(CELLS**2, CELLS**2))
        self.next = dijkstra(graph, indices=self._cell(target), return_predecessors=True)[1]

    def _target(self, free: NDArray[np.bool_]) -> Array:
        # the end of the present leg, or the first place of the path after it where the map has room for the hull
        while self.leg < len(self.way) - 2:
            start, end = self.way[self.leg + 1 : self.leg + 3]
            steps = int(np.hypot(*(end - start)) / np.min(self.size)) + 1
            onward = start + np.linspace(0, 1, steps)[:, None] * (end - start)
            rooms = np.flatnonzero([free.ravel()[self._cell(place)] for place in onward])
            target = onward[rooms[0]] if len(rooms) else end
            if np.hypot(*(target - self.here)) > self.hull:
                return np.asarray(target)
            self.leg += 1
        return np.asarray(self.way[-1])

    def _cell(self, place: Array) -> int:
        i, j = np.clip((place / self.size).astype(int), 0, CELLS - 1)
        return int(CELLS * i + j)

    def decide(self, here: Array, now: Array) -> Array:
        """Return the velocity (2,) in {E} [m/s] to command at a position (2,) [m] with the velocity `now` [m/s]."""
        goal = self.way[-1] - here
        course, left = goal, float(np.hypot(*goal))
        if left > NEAR_GOAL or self.leg < len(self.way) - 2:
            centres = self.centres.reshape(-1, 2)
            cell = target = self._cell(here)
            while self.next[target] >= 0 and np.hypot(*(centres[target] - centres[cell])) < AHEAD:
                target = self.next[target]
            course = centres[target] - here
        ahead = course / max(float(np.hypot(*course)), 1e-6)
        normal, bound = self._bounds(here)
        most = min(self.cruise, 0.5 * left + 0.03)
        along = _COURSES @ normal.T
        free = np.where(along > 1e-3, np.maximum(bound, 0) / np.maximum(along, 1e-3), np.inf).min(axis=1)
        same = _COURSES @ self.last / max(float(np.hypot(*self.last)), 0.03)
        speed = np.minimum(free[:, None], [most, most / 2, 0.0, self.cap])
        value = (np.minimum(speed, most) * (_COURSES @ ahead + KEEPS * same)[:, None]).ravel()
        velocity = (speed[..., None] * _COURSES[:, None]).reshape(-1, 2)
        takes = self.gain["reaction"] + np.hypot(*(velocity - now).T) / self.slows
        ends = AFTER + left / self.cruise
        met = too_near(self.movers_now, here, now, velocity, takes, hull=self.hull, left=ends)
        best = int(np.argmax(np.where(met <= met.min() + SAME, value, -np.inf)))
        self.last = velocity[best]
        return braked(self.last, now, normal, bound)

    def _bounds(self, here: Array) -> tuple[Array, Array]:
        # unit normals and the largest speeds along them: the nearest place in each of 36 sectors, then the walls, which
        # are at right angles, so that the last projections are exact
        walls = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])
        clear = np.concatenate([self.extent - here, here]) - self.hull
        away = self._surface(here) - here
        far = np.hypot(*away.T)
        away, far = away[far < 2.0], far[far < 2.0]
        order = np.argsort(far)
        sector = (np.arctan2(away[order, 1], away[order, 0]) / (2 * np.pi) * 36).round()
        chosen = order[np.unique(sector, return_index=True)[1]]
        normal = np.concatenate([away[chosen] / np.maximum(far[chosen], 1e-3)[:, None], walls])
        clear = np.concatenate([far[chosen] - self.hull, clear]) - MARGIN
        late, room = self.gain["reaction"] * self.slows, np.maximum(clear, 0)
        return normal, np.sqrt(late**2 + 2 * self.slows * room) - late


def too_near(
    movers: Array, here: Array, now: Array, velocity: Array, takes: Array, *, hull: float, left: float
) -> Array:
    """Return by how much [m] the robot comes too near to a mover with each velocity; 0 if it does not.

    Args:
        movers: (m, 5) position [m], radius [m] and velocity [m/s] of each mover.
        here: (2,) position of the robot [m].
        now: (2,) its velocity [m/s].
        velocity: (n, 2) velocities [m/s].
        takes: (n,) time in which the velocity of the robot becomes this one, at a constant acceleration [s].
        hull: radius of the robot [m].
        left: time after which movers do not matter [s].
    """
    worst, time, takes = np.zeros(len(velocity)), np.minimum(STEPS, left), takes[:, None]
    turned = np.where(time < takes, time**2 / (2 * takes), time - takes / 2)
    way = time[:, None] * now + turned[..., None] * (velocity - now)[:, None]
    for m in movers:
        apart = m[:2] - here
        gap = np.hypot(*np.moveaxis(apart + time[:, None] * m[3:] - way, -1, 0)) - hull - m[2]
        allowed = min(PASSING, float(np.hypot(*apart)) - hull - m[2])
        worst = np.maximum(worst, allowed - gap.min(axis=1))
    return worst


def edges(centres: Array) -> tuple[NDArray[np.int_], NDArray[np.int_], Array]:
    """Return the pairs of neighbouring cells by number, each in both directions, and their distances [m]."""
    number, pairs = np.arange(CELLS**2).reshape(CELLS, CELLS), []
    for one, other in (
        (number[1:], number[:-1]), (number[:, 1:], number[:, :-1]),
        (number[1:, 1:], number[:-1, :-1]), (number[1:, :-1], number[:-1, 1:]),
    ):  # fmt: skip
        pairs += [(one.ravel(), other.ravel()), (other.ravel(), one.ravel())]
    first, second = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    flat = centres.reshape(-1, 2)
    return first, second, np.hypot(*(flat[first] - flat[second]).T)


def braked(velocity: Array, now: Array, normal: Array, bound: Array) -> Array:
    """Return the velocity (2,) that brakes harder where `now` exceeds a bound; see `stopping.braked`."""
    over = normal @ now - bound
    closing = (normal @ now > np.maximum(bound, 0)) * 10.0
    worst = int(np.argmax(over + closing))
    n, excess = normal[worst], max(float(over[worst]), 0.0)
    straight = now + ((velocity - now) @ n) * n
    velocity = velocity + min(excess / HARD, 1) * (straight - velocity) - BRAKE * excess * n
    for row, most in zip(normal, bound, strict=True):
        velocity = velocity - max(float(velocity @ row) - max(float(most), 0), 0) * row
    return velocity


def run(name: str, echoes: str, which: str, seed: int, *, limit: float | None = None) -> tuple[Run, SonarLaw | None]:
    """Return a run of a scenario with the law of the library or with this law."""
    scenario = load_scenario(name)
    scenario = replace(scenario, sensors=scenario.sensors.hearing(echoes), time_limit=limit or scenario.time_limit)
    vehicle = load_vehicle(scenario.vehicle)
    law = build_law(
        default_law(vehicle), sonar=True, equipment=scenario.sensors.on(vehicle["radius"]), actuators=vehicle.actuators
    )
    own = SonarLaw(scenario, vehicle, law, echoes, which) if which in MAPS else None
    gains = load_gains("default")
    return simulate(scenario, vehicle, gains=gains, law=law, sensing="sonar", seed=seed, stepper=own), own


def reason(one: Run, own: SonarLaw | None) -> str:
    """Return where a run ended, and what the map knew of the nearest obstacle."""
    rows = one.record
    here, shapes = rows.eta[-1, :2], [body.shape for body in rows.obstacles[-1]]
    k = int(np.argmin(rows.clearance))
    told = f"least {rows.clearance[k]:.3f} m at {rows.time[k]:.1f} s; "
    told += f"seed {one.seed}: {one.metrics.stopped_because} at {one.metrics.time_s:.1f} s"
    told += f", ({here[0]:.2f}, {here[1]:.2f}) m"
    told += f", speed {np.hypot(*rows.nu[-1, :2]):.2f} m/s, true clearance {rows.clearance[-1]:.3f} m"
    if own is not None:
        believed = np.hypot(*(own.map.surface(here) - here).T).min(initial=np.inf) - own.hull
        own_place = rows.law_state[-1][one.law.state.slice("own_position")][:2]
        told += f", map {believed:.3f} m, obstacles {float(distances(shapes, here)) - own.hull:.3f} m"
        told += f", error of the position {np.hypot(*(own_place - here)):.3f} m"
    return told


def main(words: list[str]) -> int:
    """Run the comparison and print its table."""
    parser = argparse.ArgumentParser(prog="closed.py", description="Compare laws by sonar in the closed loop.")
    parser.add_argument("--quick", action="store_true", help="3 s of one run in pool-static")
    parser.add_argument("--seeds", type=int, default=5, help="runs of each row (default 5)")
    parser.add_argument("--scenario", choices=SCENARIOS, help="only this scenario")
    parser.add_argument("--echoes", choices=tuple(ECHOES), help="only this echo model")
    parser.add_argument("--law", choices=LAWS, help="only this law")
    parser.add_argument("--why", action="store_true", help="say how each run ended that did not arrive")
    options = parser.parse_args(words)
    if options.seeds < 1:
        parser.error("--seeds: must be at least 1")
    print(HEAD)
    for name in [options.scenario] if options.scenario else SCENARIOS[: 1 if options.quick else None]:
        for echoes in [options.echoes] if options.echoes else MODELS[: 1 if options.quick else None]:
            for which in [options.law] if options.law else LAWS[1 if options.quick else 0 : 2]:
                seeds, limit = (1, 3.0) if options.quick else (options.seeds, None)
                runs = [run(name, echoes, which, seed, limit=limit) for seed in range(seeds)]
                ends = [one.metrics for one, _ in runs]
                took = np.array([end.time_s for end in ends if end.reached])
                hit = sum(end.stopped_because == "collision" for end in ends)
                times = f"{took.mean():.1f} | {np.median(took):.1f} | {took.max():.1f}" if len(took) else "- | - | -"
                least = min(end.min_clearance_m for end in ends)
                print(
                    f"| `{name}` | {echoes} | {which} | {seeds} | {len(took)} | {hit} | {seeds - len(took) - hit} "
                    f"| {times} | {least:.3f} |",
                    flush=True,
                )
                for one, own in runs:
                    if options.why and not one.metrics.reached:
                        print(f"  {reason(one, own)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Sensors of the closed loop as CasADi expressions: sonars, position measurement, and messages about obstacles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from math import gcd

import casadi as ca

from surctl.ir import Layout, Port
from surctl.marine.control import CONTACT_SLOTS, Law
from surctl.marine.control.closing import thrust_bounds
from surctl.marine.guidance import PASSED
from surctl.marine.sensing import BaseStation, FaultChances
from surctl.marine.sensing.localisation.base_station import delayed_symbols
from surctl.marine.sensing.sonar.echo import Beam, beam_of, echo_range, echo_samples
from surctl.marine.sensing.sonar.faults import SLOT, fault_ports, faulty_samples
from surctl.marine.sensing.sonar.returns import (
    ECHO_KEY,
    certain_range_symbols,
    firing_block_symbols,
    uniform_symbols,
    weak_range_symbols,
)
from surctl.marine.sensing.sonar.solids import SolidWalls
from surctl.marine.simulation.batch.structure import Body, Structure
from surctl.marine.simulation.metrics import AT_LIMIT, MOVING, NEAR_TARGET, SIGN, TUBE
from surctl.marine.simulation.sensors import FIRING, FiringPlan, firing_plan
from surctl.noise import NOISE_STATE, draw_normals, draw_uniforms

VARIATIONS = ("surge_n", "sway_n", "heave_n", "yaw_n_m")
"""Axes of the thrust and their units, as in the names of the metrics."""

SUMS = (
    ("sum_square", "m^2", "sum of the squared horizontal distance to the path"),
    ("sum_error", "m^2", "sum of the squared distance to the path outside avoidance"),
    ("count_error", "1", "number of control steps outside avoidance"),
    ("sum_effort", "N", "sum of the magnitude of the horizontal thrust command"),
    ("sum_jump", "N^2", "sum of the squared change of the horizontal thrust command"),
    ("count_saturated", "1", "number of control steps with a thrust command at its limit"),
    ("most_away", "m", "largest horizontal distance to the path"),
    ("most_past", "m", "largest overshoot past the target"),
    ("most_thrust", "1", "largest thrust command as a share of its limit"),
    ("length", "m", "length of the path that the robot travelled"),
    *((f"sum_{name}", "N or N m", "sum of the absolute changes of one thrust command") for name in VARIATIONS),
    *((f"signs_{name}", "1", "number of sign changes of one thrust command") for name in VARIATIONS),
    *((f"limited_{name}", "1", "number of control steps with one thrust command at its limit") for name in VARIATIONS),
    ("sum_energy", "N^1.5", "sum of the magnitudes of the force commands to the power 1.5"),
    ("sum_needed", "N", "sum of the drag along the path"),
    ("count_moving", "1", "number of control steps in which the robot moves"),
    ("count_crab", "1", "number of control steps in which the robot moves and does not avoid an obstacle"),
    ("sum_crab", "rad", "sum of the absolute crab angle in these steps"),
    ("sum_heading", "rad^2", "sum of the squared heading error while the robot moves"),
    ("most_crab", "rad", "largest crab angle in these steps"),
)
"""State variables of a run for its metrics: name, unit, meaning."""


def counted(
    old: Mapping[str, ca.SX],
    w: Mapping[str, ca.SX],
    tau: ca.SX,
    status: ca.SX,
    avoiding: ca.SX,
    to_target: ca.SX,
    gap: ca.SX,
    square: ca.SX,
    tangent: ca.SX,
    path_depth: ca.SX,
    on_last: ca.SX,
) -> dict[str, ca.SX]:
    """Return the sums, counts and maxima from which the metrics follow, updated for the present control step.

    `metrics.METRICS` defines the metrics. `square` is the squared distance to the path [m²], `tangent` the direction of
    its segment (2, 1), `path_depth` its z [m]. `on_last` is 1 while the robot is on the last segment of its path.
    """
    place, depth = old["plant"][:2], old["plant"][2]
    away = ca.sqrt(square)
    excluded = ca.logic_or(avoiding, ca.logic_and(old["away"], away > TUBE))
    first = old["step"] < 0.5
    thrust, step = tau[:2], place - old["last_place"]
    change = ca.if_else(first, 0, ca.fabs(tau - old["last_thrust"]))
    least, largest = thrust_bounds(w)
    limit = ca.if_else(tau > 0, largest, -least)
    signs = ca.if_else(ca.fabs(tau) > SIGN * limit, ca.if_else(tau > 0, 1, -1), old["last_signs"])
    past = ca.if_else(ca.logic_and(on_last, gap <= NEAR_TARGET), ca.dot(to_target, w["leg"]), 0)
    force = ca.fabs(tau[:3])
    # an axis without a limit of its own has no share: its force is 0, or that of a rudder that turns the craft
    limited = limit > 0
    share = ca.if_else(limited, ca.fabs(tau) / ca.if_else(limited, limit, 1), 0)
    return {
        "away": excluded,
        "last_thrust": tau,
        "last_signs": signs,
        "sum_square": old["sum_square"] + square,
        "sum_error": old["sum_error"] + ca.if_else(excluded, 0, square + (depth - path_depth) ** 2),
        "count_error": old["count_error"] + ca.logic_not(excluded),
        "sum_effort": old["sum_effort"] + ca.sqrt(ca.sumsqr(thrust)),
        "sum_jump": old["sum_jump"] + ca.if_else(first, 0, ca.sumsqr(change[:2])),
        "count_saturated": old["count_saturated"] + _modulo(status, 2),
        "most_away": ca.fmax(old["most_away"], away),
        "most_past": ca.fmax(old["most_past"], past),
        "most_thrust": ca.fmax(old["most_thrust"], ca.mmax(share)),
        "length": old["length"] + ca.if_else(first, 0, ca.sqrt(ca.sumsqr(step))),
        **{f"sum_{name}": old[f"sum_{name}"] + change[k] for k, name in enumerate(VARIATIONS)},
        **{
            f"signs_{n}": old[f"signs_{n}"] + (signs[k] * old["last_signs"][k] < -0.5) for k, n in enumerate(VARIATIONS)
        },
        **{f"limited_{n}": old[f"limited_{n}"] + (share[k] >= AT_LIMIT) for k, n in enumerate(VARIATIONS)},
        "sum_energy": old["sum_energy"] + ca.sum1(force * ca.sqrt(force)),
        **_directions(old, w, tangent, excluded),
    }


def _directions(old: Mapping[str, ca.SX], w: Mapping[str, ca.SX], tangent: ca.SX, excluded: ca.SX) -> dict[str, ca.SX]:
    """Return the sums about crab angle, heading error and drag along the path segment with direction `tangent`."""
    psi, u, v = old["plant"][3], old["plant"][4], old["plant"][5]
    hull = ca.vertcat(ca.cos(psi), ca.sin(psi))
    ahead, left = ca.dot(hull, tangent), tangent[0] * hull[1] - tangent[1] * hull[0]  # cos and sin of the heading error
    speed = ca.fmax(u * ahead - v * left - ca.dot(w["current"], tangent), 0)
    moving = u**2 + v**2 > (MOVING * w["cruise"]) ** 2
    counts = ca.logic_and(moving, ca.logic_not(excluded))
    crab, off = ca.fabs(ca.atan2(v, u)), ca.atan2(left, ahead)
    return {
        "sum_needed": old["sum_needed"] + w["linear_drag"][0] * speed + w["quadratic_drag"][0] * speed**2,
        "count_moving": old["count_moving"] + moving,
        "count_crab": old["count_crab"] + counts,
        "sum_crab": old["sum_crab"] + ca.if_else(counts, crab, 0),
        "sum_heading": old["sum_heading"] + ca.if_else(moving, off**2, 0),
        "most_crab": ca.fmax(old["most_crab"], ca.if_else(counts, crab, 0)),
    }


def path_tangent(waypoints: ca.SX, leg: ca.SX, along: ca.SX, on_last: ca.SX) -> ca.SX:
    """Return the unit direction (2, 1) of the current segment, or of the next segment past its end.

    `leg` is the number of the segment among the `waypoints`, and `along` the arc length on it [m]; as
    `Follower.directions`.
    """
    chords = [waypoints[k + 1, :].T - waypoints[k, :].T for k in range(waypoints.shape[0] - 1)]
    here, following = chords[0], chords[1]
    for k in range(1, len(chords)):
        there = leg > k - 0.5
        here = ca.if_else(there, chords[k], here)
        following = ca.if_else(there, chords[min(k + 1, len(chords) - 1)], following)
    passed = ca.logic_and(ca.logic_not(on_last), along >= ca.sqrt(ca.sumsqr(here)) * PASSED)
    chord = ca.if_else(passed, following, here)
    return chord / ca.sqrt(ca.fmax(ca.sumsqr(chord), 1e-12))


def path_square(waypoints: ca.SX, leg: ca.SX, point: ca.SX) -> ca.SX:
    """Return the squared distance [m²] from `point` to the path near the current segment (number `leg`).

    The distance is the smallest distance to the current segment and its two neighbours. A segment between two equal
    waypoints counts as a point.
    """
    best = ca.SX(1e30)
    for k in range(waypoints.shape[0] - 1):
        a, b = waypoints[k, :].T, waypoints[k + 1, :].T
        chord = b - a
        along = ca.dot(point - a, chord) / ca.fmax(ca.sumsqr(chord), 1e-12)
        square = ca.sumsqr(point - a - ca.fmin(ca.fmax(along, 0), 1) * chord)
        best = ca.fmin(best, ca.if_else(ca.fabs(leg - k) < 1.5, square, 1e30))
    return best


def _modulo(number: ca.SX, period: int) -> ca.SX:
    """Return an integer modulo a period."""
    return number - period * ca.floor(number / period)


class Listening:
    """The sensors of a compiled loop: sonars, base station, and measurement of the robot's own state.

    The base station sends messages about the moving obstacles.
    """

    def __init__(self, structure: Structure, law: Law) -> None:
        self.structure, self.law = structure, law

    def ports(self) -> tuple[Port, ...]:
        """Return the entries (name, size, unit) that the sensors add to the state of a run."""
        array = self.structure.equipment.array
        return (
            *self.echoes.ports,
            Port("fresh", (array.size,), "1", "1 if an echo of the sonar arrived since the last step"),
            Port("noise", (NOISE_STATE,), "1", "state of the noise generator"),
            *self.late.ports,
        )

    def parameters(self) -> tuple[Port, ...]:
        """Return the entries (name, size, unit) that the sensors add to the parameters of a run."""
        structure, ports = self.structure, list[Port]()
        if structure.draws_echoes:
            ports = [
                Port("echo_key", (ECHO_KEY,), "1", "key of the random numbers of weak echoes, see echo_keys"),
                Port("echo_numbers", (len(structure.bodies),), "1", "number of each obstacle's first weak echo"),
            ]
        if structure.may_fail:
            chances = (len(FaultChances.kinds()),)
            ports += [
                Port("fault_slots", (structure.faults, SLOT), "SI", "scheduled sonar faults, see fault_slots"),
                Port("fault_chances", chances, "1", "fault probabilities per firing, see FaultChances"),
            ]
        return tuple(port for port in ports if port.size)

    @cached_property
    def echoes(self) -> Layout:
        """State entries (name, size, unit) that store the last echoes of each sonar and the state of its faults."""
        array = self.structure.equipment.array
        return Layout(fault_ports(array, delays=self.structure.delays, prefix="sonar_"))

    @cached_property
    def late(self) -> Layout:
        """State entries (name, size, unit) that store delayed measurements until the law receives them."""
        if self.law.perception is None:
            return Layout(())
        own, station = self.structure.equipment.own, self.structure.equipment.station
        fixes, messages = own.fixes.late(self.law.dt) if own else 0, station.messages.late(self.law.dt)
        ports = (
            Port("places", (fixes, 3), "m", "last positions, newest first"),
            Port(
                "messages",
                (messages, self.structure.slots * 6),
                "m, m/s, 1",
                "last states of the moving obstacles, newest first",
            ),
        )
        return Layout(tuple(port for port in ports if port.size))

    @property
    def normals(self) -> int:
        """Number of normally distributed random numbers for the sonar firings of one control step (an even number)."""
        count = self._instants * self.wide * self.structure.equipment.array.samples
        return count + count % 2

    @property
    def uniforms(self) -> int:
        """Number of uniform random numbers for one control step; at least 1, so that the array is not empty."""
        return 2 * self._instants * self.wide if self.structure.may_fail else 1

    @property
    def _instants(self) -> int:
        return round(self.law.dt / FIRING)

    @cached_property
    def _plan(self) -> FiringPlan:
        return firing_plan(self.structure.equipment.array)

    @property
    def wide(self) -> int:
        """Largest number of sonars that fire at one instant."""
        return len(self._plan.sensors[0])

    def draw(self, noise: ca.SX, out: dict[str, ca.SX], *, movers: ca.SX | None = None) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Draw the noise of one control step: for the sonars, the robot's own state, then every moving obstacle.

        The sonars' noise goes to `out`. The results are the noise of the own-state measurement and of the base
        station's message, and the number that decides whether the message is lost. `movers` is the number of moving
        obstacles if it differs between runs; absent obstacles use no random numbers.
        """
        count = self.normals
        if movers is None:
            normals, after = draw_normals(noise, count + 8 + 4 * self.structure.slots)
        else:
            normals, after = draw_normals(noise, count + 8)
            further = after
            for k in range(self.structure.slots):
                four, further = draw_normals(further, 4)
                normals, after = ca.vertcat(normals, four), ca.if_else(movers > k, further, after)
        out["normals"], out["uniforms"] = normals[:count], ca.SX(0)
        if self.structure.may_fail:
            out["uniforms"], after = draw_uniforms(after, self.uniforms)
        out["noise_next"] = after
        return normals[count : count + 6], normals[count + 7 : -1], normals[count + 6]

    def measurements(
        self,
        state: Mapping[str, ca.SX],
        eta: ca.SX,
        nu: ca.SX,
        rows: ca.SX,
        own_noise: ca.SX,
        noise: ca.SX,
        loss: ca.SX,
        out: dict[str, ca.SX],
    ) -> dict[str, ca.SX]:
        """Return the measurements of camera, IMU and base station, by the name of the law's input."""
        equipment, dt, step = self.structure.equipment, self.law.dt, state["step"]
        own, station = equipment.own, equipment.station
        if self.law.perception is None:
            spread = [own.position_sd, own.position_sd, own.position_sd, own.yaw_sd] if own else [0.0] * 4
            inputs = {"eta": eta + ca.DM(spread) * own_noise[:4], "nu": nu}
            if "contacts" in self.law.inputs:
                observed = (_observed(station, rows[k, :], noise[k, :]) for k in range(rows.shape[0]))
                inputs["contacts"] = ca.vertcat(ca.SX(0, 6), *observed)
            return inputs
        inputs = {}
        if "contacts" in self.law.inputs:
            then = flat(rows)
            if "messages" in state:
                then, out["messages"] = delayed_symbols(state["messages"], then)
            shaped = ca.reshape(then, 6, rows.shape[0]).T
            inputs["contacts"], inputs["contacts_fresh"] = station.message_symbols(
                shaped, step, noise=noise, chance=loss, dt=dt
            )
        if own is None:
            return {**inputs, "eta": eta, "nu": nu}
        place = eta[:3]
        if "places" in state:
            # before the first step the robot was at its present position
            past = ca.if_else(step > 0.5, state["places"], ca.repmat(place.T, state["places"].shape[0], 1))
            place, out["places"] = delayed_symbols(past, place)
        inputs["fix"], inputs["fix_fresh"] = own.fix_symbols(place, step, noise=own_noise[:4], dt=dt)
        inputs["yaw"], inputs["yaw_rate"] = own.imu_symbols(eta, nu, noise=own_noise[4:])
        return inputs

    def instant(
        self,
        w: Mapping[str, ca.SX],
        bodies: Sequence[Body],
        plant: ca.SX,
        echoes: Mapping[str, ca.SX],
        step: ca.SX,
        numbers: Mapping[str, ca.SX],
        *,
        instant: int,
    ) -> tuple[dict[str, ca.SX], ca.SX]:
        """Return the stored echoes after one firing instant, and (sonars, 1): 1 for a sonar whose echo arrived."""
        structure, plan, wide = self.structure, self._plan, self.wide
        array, samples = structure.equipment.array, structure.equipment.array.samples
        after = {name: value for name, value in echoes.items() if name.startswith("sonar_")}
        fresh = [ca.SX(0)] * array.size
        period = plan.period // gcd(plan.period, self._instants)  # control steps
        turn = _modulo(step, period)
        for k in range(wide):
            turns = [plan.sensors[(t * self._instants + instant) % plan.period][k] for t in range(period)]
            listed = [0 if i is None else i for i in turns]
            beam = beam_of(array, listed, turn, position=plant[:2], heading=plant[3], hull_radius=w["world_hull"])
            at = (instant * wide + k) * samples
            noise, sensor = numbers["normals"][at : at + samples], ca.SX(0)
            for t, i in enumerate(listed):
                sensor = ca.if_else(turn == t, i, sensor)
            certain = numbers["echo"][k] if "echo" in numbers else None
            distance = self._distance(w, bodies, beam, plant[2], sensor, step * self._instants + instant, certain)
            if structure.may_fail:
                at = 2 * (instant * wide + k)
                arrival = faulty_samples(
                    array,
                    after,
                    sensor,
                    time=step * self.law.dt + instant * FIRING,
                    distance=distance,
                    noise=noise,
                    slots=w["fault_slots"] if structure.faults else ca.SX.zeros(0, SLOT),
                    chances=w["fault_chances"],
                    uniforms=numbers["uniforms"][at : at + 2],
                    delays=structure.delays,
                    prefix="sonar_",
                )
                now, arrived = arrival.state, arrival.arrived
            else:
                row, last = echo_samples(array, distance, noise=noise).T, after["sonar_last"]
                rows = [ca.if_else(sensor == i, row, last[i, :]) for i in range(array.size)]
                now, arrived = {"sonar_last": ca.vertcat(*rows)}, ca.SX(1)
            silent = [t for t, i in enumerate(turns) if i is None]
            for t in silent:  # no sonar fires
                now = {name: ca.if_else(turn == t, after[name], value) for name, value in now.items()}
                arrived = ca.if_else(turn == t, 0, arrived)
            after |= now
            fresh = [ca.fmax(flag, ca.logic_and(sensor == i, arrived)) for i, flag in enumerate(fresh)]
        return after, ca.vertcat(*fresh)

    def _distance(
        self,
        w: Mapping[str, ca.SX],
        bodies: Sequence[Body],
        beam: Beam,
        z: ca.SX,
        sensor: ca.SX,
        instant: ca.SX,
        certain: ca.SX | None,
    ) -> ca.SX:
        # distance [m] of the first detected echo; `instant` counts the firing instants of the run; `certain` is the
        # distance of the first certain echo if it is measured elsewhere
        array, surfaces = self.structure.equipment.array, self.structure.surfaces
        walls, solids = SolidWalls(w["walls"]), [body.solid for body in bodies]
        if surfaces is None:
            return echo_range(array, beam, [*solids, walls]) if certain is None else certain
        upright = list(zip(solids, surfaces.obstacles, strict=True))
        nearest = certain
        if nearest is None:
            nearest = certain_range_symbols(array, beam, upright, walls, z=z, surfaces=surfaces)
        if not (surfaces.weak or surfaces.corners):
            return nearest
        key, numbers = ca.SX.zeros(ECHO_KEY), ca.SX.zeros(len(upright))
        if surfaces.weak:
            key, numbers = w["echo_key"], w["echo_numbers"]
        uniform = partial(uniform_symbols, key, firing_block_symbols(key, instant, sensor))
        numbered = [(numbers[k], *pair) for k, pair in enumerate(upright)]
        return ca.fmin(nearest, weak_range_symbols(array, beam, numbered, walls, surfaces=surfaces, uniform=uniform))


def slots(rows: Sequence[ca.SX], near: Sequence[ca.SX], most: int = CONTACT_SLOTS) -> ca.SX:
    """Return the obstacle points for the law (k, 6): all `rows`, or the `most` nearest ones in unchanged order."""
    if len(rows) <= most:
        return ca.vertcat(ca.SX(0, 6), *rows)
    slots, filled = [ca.SX.zeros(1, 6) for _ in range(most)], ca.SX(0)
    for k, row in enumerate(rows):
        ahead = [near[j] <= near[k] if j < k else near[j] < near[k] for j in range(len(rows)) if j != k]
        chosen = sum(ahead, start=ca.SX(0)) < most
        slots = [ca.if_else(ca.logic_and(chosen, filled == at), row, slot) for at, slot in enumerate(slots)]
        filled += chosen
    return ca.vertcat(*slots)


def _observed(station: BaseStation, row: ca.SX, noise: ca.SX) -> ca.SX:
    # (1, 6), with noise, but without delay
    spread = ca.horzcat(station.position_sd * noise[:2], 0, station.velocity_sd * noise[2:], 0)
    return ca.if_else(row[5], row + spread, ca.SX.zeros(1, 6))


def flat(matrix: ca.SX) -> ca.SX:
    """Return a matrix as a column vector in row-major order."""
    return ca.reshape(matrix.T, -1, 1)

"""Sensors of the closed loop as CasADi expressions: sonar firings, noise, late position fixes, late messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from math import gcd

import casadi as ca

from surctl.ir import Layout, Port
from surctl.marine.control import CONTACT_SLOTS, Law
from surctl.marine.sensing import FaultChances
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
from surctl.marine.simulation.sensors import FIRING, FiringPlan, firing_plan
from surctl.noise import NOISE_STATE, draw_normals, draw_uniforms


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
                observed = [ca.SX(0, 6)]
                for k in range(rows.shape[0]):  # with noise, but without delay
                    place, velocity = station.position_sd * noise[k, :2], station.velocity_sd * noise[k, 2:]
                    measured = rows[k, :] + ca.horzcat(place, 0, velocity, 0)
                    observed.append(ca.if_else(rows[k, 5], measured, ca.SX.zeros(1, 6)))
                inputs["contacts"] = ca.vertcat(*observed)
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
        turn = step - period * ca.floor(step / period)
        surfaces, walls, solids = structure.surfaces, SolidWalls(w["walls"]), [body.solid for body in bodies]

        def echo_distance(beam: Beam, sensor: ca.SX, certain: ca.SX | None) -> ca.SX:
            # distance [m] of the first detected echo; that of the first certain echo may be measured elsewhere
            if surfaces is None:
                return echo_range(array, beam, [*solids, walls]) if certain is None else certain
            upright = list(zip(solids, surfaces.obstacles, strict=True))
            nearest = certain
            if nearest is None:
                nearest = certain_range_symbols(array, beam, upright, walls, z=plant[2], surfaces=surfaces)
            if not (surfaces.weak or surfaces.corners):
                return nearest
            key, firsts = ca.SX.zeros(ECHO_KEY), ca.SX.zeros(len(upright))
            if surfaces.weak:
                key, firsts = w["echo_key"], w["echo_numbers"]
            block = firing_block_symbols(key, step * self._instants + instant, sensor)
            numbered = [(firsts[k], *pair) for k, pair in enumerate(upright)]
            uniform = partial(uniform_symbols, key, block)
            weak = weak_range_symbols(array, beam, numbered, walls, surfaces=surfaces, uniform=uniform)
            return ca.fmin(nearest, weak)

        for k in range(wide):
            turns = [plan.sensors[(t * self._instants + instant) % plan.period][k] for t in range(period)]
            listed = [0 if i is None else i for i in turns]
            beam = beam_of(array, listed, turn, position=plant[:2], heading=plant[3], hull_radius=w["world_hull"])
            at = (instant * wide + k) * samples
            noise, sensor = numbers["normals"][at : at + samples], ca.SX(0)
            for t, i in enumerate(listed):
                sensor = ca.if_else(turn == t, i, sensor)
            distance = echo_distance(beam, sensor, numbers["echo"][k] if "echo" in numbers else None)
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


def flat(matrix: ca.SX) -> ca.SX:
    """Return a matrix as a column vector in row-major order."""
    return ca.reshape(matrix.T, -1, 1)

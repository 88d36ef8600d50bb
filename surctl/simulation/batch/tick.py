"""One control period of the closed loop as a block: world, sensing, law, plant and metrics in one state.

What `run.simulate` does with objects is stated here in symbols, so that a whole run can be compiled, differentiated
or sent through CasADi's machine. The two are written independently and compared by the tests.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from math import gcd
from typing import Any

import casadi as ca

from surctl.control import CONTACT_SLOTS, PARAMETERS, Law, build_law
from surctl.control.build import LawName
from surctl.guidance import MAX_WAYPOINTS, AvoidanceForm
from surctl.ir import Call, Layout, Port, Program, Routine, lower, nearby_angles, shared_divisors
from surctl.priority import Mode
from surctl.sensing import (
    NOISE_STATE,
    SLOT,
    BaseStation,
    Equipment,
    FaultChances,
    SolidWalls,
    beam_of,
    delayed_symbols,
    draw_normals,
    draw_uniforms,
    echo_range,
    fault_ports,
    faulty_samples,
    heard_samples,
)
from surctl.simulation.batch.bodies import ABSENT, Body, BodyKind, body_at, body_size
from surctl.simulation.batch.counting import SUMS, counted, modulo
from surctl.simulation.metrics import HALT, STOPS
from surctl.simulation.run import Sensing, advance
from surctl.simulation.sensors import FIRING, FiringPlan, firing_plan
from surctl.vehicle import PLANT_DISTURBANCE, PLANT_PARAMETERS, PLANT_STATE

__all__ = ["Loop", "Structure", "build_loop"]

_OPTIONS = {"cse": True}
_HEADING = PLANT_STATE.slice("eta").start + 3
_FINITE = 1e300


@dataclass(frozen=True)
class Structure:
    """What of a case is fixed in the compiled loop; everything else is a number of a run.

    Attributes:
        equipment: what is sensed with; the sonars' hull counts only if they have mounts.
        faults: number of slots for told faults; `delays` if one of them may be a delay.
        chances: whether faults may strike by chance.
    """

    law: LawName
    avoidance: AvoidanceForm
    mode: Mode
    sensing: Sensing
    bodies: tuple[BodyKind, ...]
    equipment: Equipment = field(default_factory=Equipment)
    faults: int = 0
    chances: bool = False
    delays: bool = False

    @property
    def may_fail(self) -> bool:
        """Whether a sonar may fail."""
        return self.faults > 0 or self.chances

    @property
    def movers(self) -> int:
        """Number of moving obstacles."""
        return self.bodies.count("mover")

    @property
    def slots(self) -> int:
        """Moving obstacles that a message of the base station holds."""
        return min(CONTACT_SLOTS, self.movers)

    @property
    def contacts(self) -> int:
        """Number of obstacles that the law is told of."""
        return min(CONTACT_SLOTS, self.movers if self.sensing == "sonar" else len(self.bodies))


@dataclass(frozen=True, eq=False)
class Loop:
    """The closed loop of a structure.

    Attributes:
        law: what is flown.
        state: layout of a run's state; its first entry `done` ends the run.
        parameters: layout of a run's parameters.
        tick: (state, parameters) → next state; one control period.
    """

    structure: Structure
    law: Law
    state: Layout
    parameters: Layout
    tick: Routine


@cache
def build_loop(structure: Structure) -> Loop:
    """Assemble the loop of a structure once."""
    law = build_law(  # no slot more than there are obstacles, no filter that hears nothing
        structure.law,
        avoidance=structure.avoidance,
        mode=structure.mode,
        contacts=structure.contacts,
        sonar=structure.sensing == "sonar",
        equipment=structure.equipment,
    )
    state, parameters = Layout(_state_ports(law, structure)), Layout(_parameter_ports(structure))
    builder = _Builder(structure, law, state, parameters)
    sense, between, close = builder.sense(), builder.between(), builder.close()
    # the heading of a stage is near that at the beginning: within 25 ms the hull turns little
    move = shared_divisors(nearby_angles(lower(advance()), source=0, entry=_HEADING))
    made = [tuple(name for name, _ in program.outputs) for program in (sense, between, close)]
    steps = (
        Call(sense, ("s", "w"), made[0]),
        Call(law.block, ("x", "u", "p"), ("tau", "x_next", "status", "telemetry")),
        Call(move, ("plant", "tau", "d0", "plant_p"), ("plant_between",)),
        Call(between, tuple(name for name, _ in between.inputs), made[1]),
        Call(move, ("plant_between", "tau", "d1", "plant_p"), ("plant_next",)),
        Call(close, tuple(name for name, _ in close.inputs), made[2]),
    )
    size = (("s", state.size), ("w", parameters.size))
    return Loop(structure, law, state, parameters, Routine("tick", size, steps, made[2]))


def _parameter_ports(structure: Structure) -> tuple[Port, ...]:
    world = (
        Port("plant", (PLANT_PARAMETERS.size,), "SI", "the vehicle that is flown, as PLANT_PARAMETERS"),
        Port("world_hull", (1,), "m", "its hull radius"),
        Port("reach", (1,), "m", "distance to the target that counts as arrived"),
        Port("ticks", (1,), "1", "most control periods of the run"),
        Port("leg", (2,), "1", "unit direction of the path's last leg in {E}"),
        Port("current", (2,), "m/s", "current in {E}"),
        Port("wave", (4,), "N, rad/s, rad", "amplitude along x and y of {E}, rate, phase"),
    )
    bodies = (Port(f"body{k}", (body_size(kind),), "SI", kind) for k, kind in enumerate(structure.bodies))
    failing = (
        Port("fault_slots", (structure.faults, SLOT), "SI", "told faults, see fault_slots"),
        Port("fault_chances", (len(FaultChances.kinds()),), "1", "per firing, see FaultChances"),
    )
    return (*PARAMETERS, *world, *bodies, *(port for port in failing if structure.may_fail and port.size))


def _state_ports(law: Law, structure: Structure) -> tuple[Port, ...]:
    heard = (
        *fault_ports(structure.equipment.array, delays=structure.delays, prefix="sonar_"),
        Port("fresh", (structure.equipment.array.size,), "1", "1 where a sonar's firing arrived since the last tick"),
        Port("noise", (NOISE_STATE,), "1", "state of the noise generator"),
        *_late_ports(law, structure),
    )
    return (
        Port("done", (1,), "1", "1 when the run has ended"),
        Port("tick", (1,), "1", "number of the control period"),
        Port("plant", (PLANT_STATE.size,), "SI", "PLANT_STATE"),
        Port("law", (law.state.size,), "SI", "the law's state"),
        *(heard if structure.sensing == "sonar" else ()),
        Port("clear", (1,), "1", "1 once the hull was clear of the walls"),
        Port("least", (1,), "m", "least clearance", ABSENT),
        *((Port("halted", (1,), "1", "control periods for which the law has stood halted"),) if law.senses else ()),
        Port("stop", (1,), "1", "why the run ended, see STOPS"),
        Port("away", (1,), "1", "1 during an avoidance interval"),
        Port("last_place", (2,), "m", "x, y at the last tick"),
        Port("last_thrust", (2,), "N", "F_u, F_v at the last tick"),
        *(Port(name, (1,), unit, meaning) for name, unit, meaning in SUMS),
    )


def _late_ports(law: Law, structure: Structure) -> tuple[Port, ...]:
    """What the base station measured and has not sent yet."""
    if law.senses is None:
        return ()
    own, station = structure.equipment.own, structure.equipment.station
    fixes, messages = own.fixes.late(law.dt) if own else 0, station.messages.late(law.dt)
    ports = (
        Port("places", (fixes, 3), "m", "last positions, newest first"),
        Port("messages", (messages, structure.slots * 6), "m, m/s, 1", "last states of the moving obstacles"),
    )
    return tuple(port for port in ports if port.size)


class _Builder:
    """The three programs around the law and the plant."""

    def __init__(self, structure: Structure, law: Law, state: Layout, parameters: Layout) -> None:
        self.structure, self.law, self.state, self.parameters = structure, law, state, parameters
        self.sonar = structure.sensing == "sonar"

    def sense(self) -> Program:
        """World and first firing at the tick; what the law and the plant are given."""
        s, state = self.state.symbols("s")
        w, given = self.parameters.symbols("w")
        tick, dt = state["tick"], self.law.dt
        time = tick * dt
        bodies = self._bodies(given, time)
        eta, nu = state["plant"][:4], state["plant"][4:8]
        out: dict[str, ca.SX] = {"x": state["law"], "p": w[: PARAMETERS.size]}
        inputs: dict[str, ca.SX] = {"eta": eta, "nu": nu}
        if self.sonar:
            own, drawn, loss = self._drawn(state["noise"], out)
            heard, arrived = self._instant(given, bodies, state["plant"], state, tick, out, instant=0)
            inputs = {"samples": heard["sonar_last"], "fresh": ca.fmax(state["fresh"], arrived)}
            out["heard"] = self._heard.join(heard)
            movers = [b for b in bodies if b.moving]
            rows = _slots([b.contact(eta[:2]) for b in movers], [b.clearance(eta[:2]) for b in movers])
            inputs |= self._told(state, eta, nu, rows, own, ca.reshape(drawn, 4, self.structure.slots).T, loss, out)
        else:
            out |= {name: ca.SX(0) for name in ("noise_next", "normals", "uniforms", "heard")}
            if bodies:
                inputs["contacts"] = _slots(
                    [b.contact(eta[:2]) for b in bodies], [b.clearance(eta[:2]) for b in bodies]
                )
        out["u"] = self.law.inputs.join(inputs)
        out["plant"], out["plant_p"] = state["plant"], given["plant"]
        out["d0"], out["d1"] = self._disturbance(given, time), self._disturbance(given, time + FIRING)
        out["tick"] = tick
        out["clearance"] = _clearances(bodies, given, eta[:2])
        out["late"] = ca.vertcat(ca.SX(0, 1), *(_flat(out.pop(name)) for name in self._late if name in out))
        return _lowered("sense", {"s": s, "w": w}, out)

    @property
    def _late(self) -> tuple[str, ...]:
        return tuple(port.name for port in _late_ports(self.law, self.structure)) if self.sonar else ()

    def _told(
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
        """What camera, IMU and base station tell, as `run._Loop._told`."""
        own, station, dt, tick = (
            self.structure.equipment.own,
            self.structure.equipment.station,
            self.law.dt,
            state["tick"],
        )
        if self.law.senses is None:
            spread = [own.position_sd, own.position_sd, own.position_sd, own.yaw_sd] if own else [0.0] * 4
            told = {"eta": eta + ca.DM(spread) * own_noise[:4], "nu": nu}
            if rows.shape[0]:
                told["contacts"] = ca.vertcat(
                    *(_observed(station, rows[k, :], noise[k, :]) for k in range(rows.shape[0]))
                )
            return told
        told = {}
        if rows.shape[0]:
            then = _flat(rows)
            if "messages" in state:
                then, out["messages"] = delayed_symbols(state["messages"], then)
            shaped = ca.reshape(then, 6, rows.shape[0]).T
            told["contacts"], told["contacts_fresh"] = station.message_symbols(
                shaped, tick, noise=noise, chance=loss, dt=dt
            )
        if own is None:
            return {**told, "eta": eta, "nu": nu}
        place = eta[:3]
        if "places" in state:
            # before the first step it was where it is
            past = ca.if_else(tick > 0.5, state["places"], ca.repmat(place.T, state["places"].shape[0], 1))
            place, out["places"] = delayed_symbols(past, place)
        told["fix"], told["fix_fresh"] = own.fix_symbols(place, tick, noise=own_noise[:4], dt=dt)
        told["yaw"], told["yaw_rate"] = own.imu_symbols(eta, nu, noise=own_noise[4:])
        return told

    def _drawn(self, noise: ca.SX, out: dict[str, ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Draw what a tick needs, see `run._Drawn`: for own state, message and its loss; for the firings into `out`."""
        count = self._instants * self._wide * self.structure.equipment.array.samples
        count += count % 2
        drawn, after = draw_normals(noise, count + 8 + 4 * self.structure.slots)
        out["normals"], out["uniforms"] = drawn[:count], ca.SX(0)
        if self.structure.may_fail:
            out["uniforms"], after = draw_uniforms(after, 2 * self._instants * self._wide)
        out["noise_next"] = after
        return drawn[count : count + 6], drawn[count + 7 : -1], drawn[count + 6]

    @cached_property
    def _late_layout(self) -> Layout:
        return Layout(tuple(self.state.port(name) for name in self._late))

    @property
    def _instants(self) -> int:
        return round(self.law.dt / FIRING)

    @cached_property
    def _plan(self) -> FiringPlan:
        return firing_plan(self.structure.equipment.array)

    @property
    def _wide(self) -> int:
        return len(self._plan.sensors[0])

    @cached_property
    def _heard(self) -> Layout:
        return Layout(fault_ports(self.structure.equipment.array, delays=self.structure.delays, prefix="sonar_"))

    def between(self) -> Program:
        """Second instant of firing and clearances, 25 ms after the tick."""
        w, given = self.parameters.symbols("w")
        structure, wide = self.structure, self._wide
        sizes = {"plant_between": PLANT_STATE.size, "tick": 1, "normals": 1, "uniforms": 1, "heard": 1}
        if self.sonar:
            count = self._instants * wide * structure.equipment.array.samples
            sizes |= {"normals": count + count % 2, "heard": self._heard.size}
            sizes["uniforms"] = 2 * self._instants * wide if structure.may_fail else 1
        v = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        plant = v["plant_between"]
        bodies = self._bodies(given, v["tick"] * self.law.dt + FIRING)
        heard, fresh = v["heard"], ca.SX(0)
        if self.sonar:
            after, fresh = self._instant(given, bodies, plant, self._heard.split(heard), v["tick"], v, instant=1)
            heard = self._heard.join(after)
        near = _clearances(bodies, given, plant[:2])
        return _lowered("between", {"w": w, **v}, {"heard_next": heard, "fresh_next": fresh, "clearance_between": near})

    def _instant(
        self,
        w: Mapping[str, ca.SX],
        bodies: Sequence[Body],
        plant: ca.SX,
        heard: Mapping[str, ca.SX],
        tick: ca.SX,
        drawn: Mapping[str, ca.SX],
        *,
        instant: int,
    ) -> tuple[dict[str, ca.SX], ca.SX]:
        """What has been heard after one instant of firing, and (sensors, 1) 1 for those whose firing arrived."""
        structure, plan, wide = self.structure, self._plan, self._wide
        array, taken = structure.equipment.array, structure.equipment.array.samples
        after = {name: value for name, value in heard.items() if name.startswith("sonar_")}
        fresh = [ca.SX(0)] * array.size
        period = plan.period // gcd(plan.period, self._instants)  # ticks
        turn = modulo(tick, period)
        for k in range(wide):
            turns = [plan.sensors[(t * self._instants + instant) % plan.period][k] for t in range(period)]
            listed = [0 if i is None else i for i in turns]
            beam = beam_of(array, listed, turn, position=plant[:2], heading=plant[3], hull_radius=w["world_hull"])
            distance = echo_range(array, beam, [*(body.solid for body in bodies), SolidWalls(w["walls"])])
            at = (instant * wide + k) * taken
            noise, sensor = drawn["normals"][at : at + taken], ca.SX(0)
            for t, i in enumerate(listed):
                sensor = ca.if_else(turn == t, i, sensor)
            if structure.may_fail:
                at = 2 * (instant * wide + k)
                arrival = faulty_samples(
                    array,
                    after,
                    sensor,
                    time=tick * self.law.dt + instant * FIRING,
                    distance=distance,
                    noise=noise,
                    slots=w["fault_slots"] if structure.faults else ca.SX.zeros(0, SLOT),
                    chances=w["fault_chances"],
                    uniforms=drawn["uniforms"][at : at + 2],
                    delays=structure.delays,
                    prefix="sonar_",
                )
                now, arrived = arrival.state, arrival.arrived
            else:
                row, last = heard_samples(array, distance, noise=noise).T, after["sonar_last"]
                rows = [ca.if_else(sensor == i, row, last[i, :]) for i in range(array.size)]
                now, arrived = {"sonar_last": ca.vertcat(*rows)}, ca.SX(1)
            silent = [t for t, i in enumerate(turns) if i is None]
            for t in silent:  # nobody's turn
                now = {name: ca.if_else(turn == t, after[name], value) for name, value in now.items()}
                arrived = ca.if_else(turn == t, 0, arrived)
            after |= now
            fresh = [ca.fmax(flag, ca.logic_and(sensor == i, arrived)) for i, flag in enumerate(fresh)]
        return after, ca.vertcat(*fresh)

    def close(self) -> Program:
        """Judge the tick, count the metrics, and put the next state together."""
        s, old = self.state.symbols("s")
        w, given = self.parameters.symbols("w")
        law, sonar = self.law, self.sonar
        symbols = {
            "clearance": 2,
            "clearance_between": 2,
            "tau": 4,
            "x_next": law.state.size,
            "status": 1,
            "telemetry": law.outputs.size - 4,
            "plant_next": PLANT_STATE.size,
            "heard_next": self._heard.size if sonar else 1,
            "fresh_next": self.structure.equipment.array.size if sonar else 1,
            "late": sum(self.state.port(name).size for name in self._late),
            "noise_next": NOISE_STATE if sonar else 1,
        }
        v = {name: ca.SX.sym(name, size) for name, size in symbols.items()}
        place = old["plant"][:2]
        clear, clearance = _with_walls(old["clear"], v["clearance"])
        total = ca.sum1(v["tau"]) + ca.sum1(v["x_next"]) + v["status"] + ca.sum1(v["telemetry"])
        to_target = place - given["waypoints"][MAX_WAYPOINTS - 1, :].T
        gap = ca.sqrt(ca.sumsqr(to_target))
        collided = clearance <= 0
        reached = ca.logic_and(ca.logic_not(collided), gap <= given["reach"])
        broken = ca.logic_not(ca.fabs(total) <= _FINITE)
        standing, stop = self._standing(old, v["telemetry"])
        stop = ca.if_else(broken, _code("fault"), stop)
        stop = ca.if_else(reached, _code("reached"), ca.if_else(collided, _code("collision"), stop))
        ended = stop > 0
        last = old["tick"] + 1 >= given["ticks"]
        clear_between, between = _with_walls(clear, v["clearance_between"])
        least = ca.fmin(old["least"], clearance)

        new: dict[str, ca.SX] = {
            "done": ca.logic_or(ended, last),
            "tick": ca.if_else(ca.logic_or(ended, last), old["tick"], old["tick"] + 1),
            "plant": v["plant_next"],
            "law": v["x_next"],
            "clear": clear_between,
            "least": ca.if_else(ended, least, ca.fmin(least, between)),
            "stop": stop,
            "last_place": place,
        }
        if sonar:
            new |= {**self._heard.split(v["heard_next"]), "fresh": v["fresh_next"], "noise": v["noise_next"]}
            new |= self._late_layout.split(v["late"]) | standing
        tau, status = ca.if_else(broken, 0, v["tau"]), ca.if_else(broken, 0, v["status"])
        avoiding = v["telemetry"][law.telemetry_slice("avoiding")] > 0.5
        new |= counted(old, given, tau, status, ca.if_else(broken, 0, avoiding), to_target, gap)
        return _lowered("close", {"s": s, "w": w, **v}, {"s_next": self.state.join(new)})

    def _standing(self, old: Mapping[str, ca.SX], telemetry: ca.SX) -> tuple[dict[str, ca.SX], ca.SX]:
        """For how long the law has halted, if it ever does, and the code of `halted` once that is too long."""
        if self.law.senses is None:
            return {}, ca.SX(0)
        now = telemetry[self.law.telemetry_slice("halted")] > 0.5
        count = ca.if_else(now, old["halted"] + 1, 0)
        return {"halted": count}, ca.if_else(count >= round(HALT / self.law.dt), _code("halted"), 0)

    def _bodies(self, w: Mapping[str, ca.SX], time: ca.SX) -> list[Body]:
        return [body_at(kind, w[f"body{k}"], time) for k, kind in enumerate(self.structure.bodies)]

    @staticmethod
    def _disturbance(w: Mapping[str, ca.SX], time: ca.SX) -> ca.SX:
        push = ca.sin(w["wave"][2] * time + w["wave"][3]) * w["wave"][:2]
        return PLANT_DISTURBANCE.join(
            {"current": ca.vertcat(w["current"], 0), "force": ca.vertcat(push, ca.SX.zeros(2))}
        )


def _clearances(bodies: Sequence[Body], w: Mapping[str, ca.SX], position: ca.SX) -> ca.SX:
    """(2, 1): hull to the nearest obstacle, hull to the nearest wall [m]."""
    nearest = ca.SX(ABSENT)
    for body in bodies:
        nearest = ca.fmin(nearest, body.clearance(position) - w["world_hull"])
    walls = w["walls"]
    across = ca.fmin(ca.fmin(position[0] - walls[0], walls[1] - position[0]), position[1] - walls[2])
    return ca.vertcat(nearest, ca.fmin(across, walls[3] - position[1]) - w["world_hull"])


def _with_walls(clear: ca.SX, clearances: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Whether the hull was ever clear of the walls, and the clearance: walls count from then on."""
    now = ca.logic_or(clear, clearances[1] > 0)
    return now, ca.if_else(now, ca.fmin(clearances[0], clearances[1]), clearances[0])


def _slots(rows: Sequence[ca.SX], near: Sequence[ca.SX]) -> ca.SX:
    """The law's contacts, (k, 6): all rows, or the `CONTACT_SLOTS` nearest ones in their order."""
    if len(rows) <= CONTACT_SLOTS:
        return ca.vertcat(ca.SX(0, 6), *rows)
    slots, taken = [ca.SX.zeros(1, 6) for _ in range(CONTACT_SLOTS)], ca.SX(0)
    for k, row in enumerate(rows):
        ahead = [near[j] <= near[k] if j < k else near[j] < near[k] for j in range(len(rows)) if j != k]
        chosen = sum(ahead, start=ca.SX(0)) < CONTACT_SLOTS
        slots = [ca.if_else(ca.logic_and(chosen, taken == at), row, slot) for at, slot in enumerate(slots)]
        taken += chosen
    return ca.vertcat(*slots)


def _observed(station: BaseStation, row: ca.SX, noise: ca.SX) -> ca.SX:
    """A contact (1, 6) as the base station tells it at once."""
    spread = ca.horzcat(station.position_sd * noise[:2], 0, station.velocity_sd * noise[2:], 0)
    return ca.if_else(row[5], row + spread, ca.SX.zeros(1, 6))


def _code(reason: str) -> float:
    return float(STOPS.index(reason))


def _flat(matrix: ca.SX) -> ca.SX:
    """Row by row."""
    return ca.reshape(matrix.T, -1, 1)


def _lowered(name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, Any]) -> Program:
    made = [ca.densify(ca.SX(value)) for value in outputs.values()]
    return lower(ca.Function(name, list(inputs.values()), made, list(inputs), list(outputs), _OPTIONS))

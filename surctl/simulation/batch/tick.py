"""One control period of the closed loop as a block: world, sensing, law, plant and metrics in one state.

What `run.simulate` does with objects is stated here in symbols, so that a whole run can be compiled, differentiated
or sent through CasADi's machine. The two are written independently and compared by the tests.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca

from surctl.control import CONTACT_SLOTS, PARAMETERS, Law, build_law
from surctl.control.build import LawName
from surctl.guidance import MAX_WAYPOINTS, AvoidanceForm
from surctl.ir import Call, Layout, Port, Program, Routine, lower, nearby_angles, shared_divisors
from surctl.priority import Mode
from surctl.sensing import (
    NOISE_STATE,
    BaseStation,
    OwnState,
    SolidWalls,
    SonarArray,
    beam_of,
    draw_normals,
    echo_range,
    heard_samples,
)
from surctl.simulation.batch.bodies import ABSENT, Body, BodyKind, body_at, body_size
from surctl.simulation.batch.counting import SUMS, counted, modulo
from surctl.simulation.metrics import STOPS
from surctl.simulation.run import FIRING, Sensing, advance
from surctl.vehicle import PLANT_DISTURBANCE, PLANT_PARAMETERS, PLANT_STATE

__all__ = ["Loop", "Structure", "build_loop"]

_OPTIONS = {"cse": True}
_HEADING = PLANT_STATE.slice("eta").start + 3
_ARRAY = SonarArray()
_FINITE = 1e300


@dataclass(frozen=True)
class Structure:
    """What of a case is fixed in the compiled loop; everything else is a number of a run."""

    law: LawName
    avoidance: AvoidanceForm
    mode: Mode
    sensing: Sensing
    bodies: tuple[BodyKind, ...]

    @property
    def movers(self) -> int:
        """Number of moving obstacles."""
        return self.bodies.count("mover")

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
        Call(between, ("w", "plant_between", "samples", "noise_between", "tick"), made[1]),
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
    return (*PARAMETERS, *world, *bodies)


def _state_ports(law: Law, structure: Structure) -> tuple[Port, ...]:
    heard = (
        Port("samples", (_ARRAY.size, _ARRAY.samples), "m", "last samples of each sonar", _ARRAY.maximum),
        Port("noise", (NOISE_STATE,), "1", "state of the noise generator"),
    )
    return (
        Port("done", (1,), "1", "1 when the run has ended"),
        Port("tick", (1,), "1", "number of the control period"),
        Port("plant", (PLANT_STATE.size,), "SI", "PLANT_STATE"),
        Port("law", (law.state.size,), "SI", "the law's state"),
        *(heard if structure.sensing == "sonar" else ()),
        Port("clear", (1,), "1", "1 once the hull was clear of the walls"),
        Port("least", (1,), "m", "least clearance", ABSENT),
        Port("stop", (1,), "1", "why the run ended, see STOPS"),
        Port("away", (1,), "1", "1 during an avoidance interval"),
        Port("last_place", (2,), "m", "x, y at the last tick"),
        Port("last_thrust", (2,), "N", "F_u, F_v at the last tick"),
        *(Port(name, (1,), unit, meaning) for name, unit, meaning in SUMS),
    )


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
            drawn, out["noise_next"] = draw_normals(state["noise"], 2 * _ARRAY.samples + 4 + 4 * self.structure.movers)
            first, own = drawn[: _ARRAY.samples], 2 * _ARRAY.samples
            out["noise_between"] = drawn[_ARRAY.samples : own]
            out["samples"] = _flat(self._fired(given, bodies, state["plant"], state["samples"], tick, first))
            inputs["eta"] = eta + ca.DM(_own_state_spread()) * drawn[own : own + 4]
            inputs["samples"] = ca.reshape(out["samples"], _ARRAY.samples, _ARRAY.size).T
            inputs["fresh"] = _fresh(tick)
            movers = ca.reshape(drawn[own + 4 :], 4, self.structure.movers).T
            rows = [_observed(b.contact(eta[:2]), movers[k, :]) for k, b in enumerate(b for b in bodies if b.moving)]
        else:
            out |= {"noise_next": ca.SX(0), "noise_between": ca.SX(0), "samples": ca.SX(0)}
            rows = [b.contact(eta[:2]) for b in bodies]
        near = [b.clearance(eta[:2]) for b in bodies if b.moving or not self.sonar]
        if rows:
            inputs["contacts"] = _slots(rows, near)
        out["u"] = self.law.inputs.join(inputs)
        out["plant"], out["plant_p"] = state["plant"], given["plant"]
        out["d0"], out["d1"] = self._disturbance(given, time), self._disturbance(given, time + FIRING)
        out["tick"] = tick
        out["clearance"] = _clearances(bodies, given, eta[:2])
        return _lowered("sense", {"s": s, "w": w}, out)

    def between(self) -> Program:
        """Second firing and clearances, 25 ms after the tick."""
        w, given = self.parameters.symbols("w")
        plant, tick = ca.SX.sym("plant_between", PLANT_STATE.size), ca.SX.sym("tick")
        count, taken = (_ARRAY.size * _ARRAY.samples, _ARRAY.samples) if self.sonar else (1, 1)
        samples, noise = ca.SX.sym("samples", count), ca.SX.sym("noise_between", taken)
        bodies = self._bodies(given, tick * self.law.dt + FIRING)
        after = samples
        if self.sonar:
            shaped = ca.reshape(samples, _ARRAY.samples, _ARRAY.size).T
            after = _flat(self._fired(given, bodies, plant, shaped, tick, noise, second=True))
        inputs = {"w": w, "plant_between": plant, "samples": samples, "noise_between": noise, "tick": tick}
        return _lowered(
            "between", inputs, {"samples_next": after, "clearance_between": _clearances(bodies, given, plant[:2])}
        )

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
            "samples_next": _ARRAY.size * _ARRAY.samples if sonar else 1,
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
        stop = ca.if_else(broken, _code("fault"), 0)
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
            shaped = ca.reshape(v["samples_next"], _ARRAY.samples, _ARRAY.size).T
            new |= {"samples": shaped, "noise": v["noise_next"]}
        tau, status = ca.if_else(broken, 0, v["tau"]), ca.if_else(broken, 0, v["status"])
        avoiding = v["telemetry"][law.telemetry_slice("avoiding")] > 0.5
        new |= counted(old, given, tau, status, ca.if_else(broken, 0, avoiding), to_target, gap)
        return _lowered("close", {"s": s, "w": w, **v}, {"s_next": self.state.join(new)})

    def _bodies(self, w: Mapping[str, ca.SX], time: ca.SX) -> list[Body]:
        return [body_at(kind, w[f"body{k}"], time) for k, kind in enumerate(self.structure.bodies)]

    @staticmethod
    def _disturbance(w: Mapping[str, ca.SX], time: ca.SX) -> ca.SX:
        push = ca.sin(w["wave"][2] * time + w["wave"][3]) * w["wave"][:2]
        return PLANT_DISTURBANCE.join(
            {"current": ca.vertcat(w["current"], 0), "force": ca.vertcat(push, ca.SX.zeros(2))}
        )

    @staticmethod
    def _fired(
        w: Mapping[str, ca.SX],
        bodies: Sequence[Body],
        plant: ca.SX,
        samples: ca.SX,
        tick: ca.SX,
        noise: ca.SX,
        *,
        second: bool = False,
    ) -> ca.SX:
        """Samples (sensors, samples) after the first or second firing of a tick."""
        turns = [_ARRAY.order[k] for k in range(int(second), _ARRAY.size, 2)]
        turn = modulo(tick, len(turns))
        hull = w["world_hull"]
        beam = beam_of(_ARRAY, turns, turn, position=plant[:2], heading=plant[3], hull_radius=hull)
        distance = echo_range(_ARRAY, beam, [*(body.solid for body in bodies), SolidWalls(w["walls"])])
        heard = heard_samples(_ARRAY, distance, noise=noise)
        rows = [samples[i, :] for i in range(_ARRAY.size)]
        for k, sensor in enumerate(turns):
            rows[sensor] = ca.if_else(turn == k, heard.T, rows[sensor])
        return ca.vertcat(*rows)


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
        return ca.vertcat(*rows)
    slots, taken = [ca.SX.zeros(1, 6) for _ in range(CONTACT_SLOTS)], ca.SX(0)
    for k, row in enumerate(rows):
        ahead = [near[j] <= near[k] if j < k else near[j] < near[k] for j in range(len(rows)) if j != k]
        chosen = sum(ahead, start=ca.SX(0)) < CONTACT_SLOTS
        slots = [ca.if_else(ca.logic_and(chosen, taken == at), row, slot) for at, slot in enumerate(slots)]
        taken += chosen
    return ca.vertcat(*slots)


def _observed(row: ca.SX, noise: ca.SX) -> ca.SX:
    """A contact (1, 6) as the base station tells it."""
    station = BaseStation()
    spread = ca.horzcat(station.position_sd * noise[:2], 0, station.velocity_sd * noise[2:], 0)
    return ca.if_else(row[5], row + spread, ca.SX.zeros(1, 6))


def _own_state_spread() -> list[float]:
    own = OwnState()
    return [own.position_sd, own.position_sd, own.position_sd, own.yaw_sd]


def _fresh(tick: ca.SX) -> ca.SX:
    """(sensors, 1): who has fired since the last control tick: the second firing of the last, the first of this."""
    period = _ARRAY.size // 2
    flags = [ca.SX(0)] * _ARRAY.size
    for k in range(period):
        here = modulo(tick, period) == k
        flags[_ARRAY.order[2 * k]] += here
        before = _ARRAY.order[(2 * k - 1) % _ARRAY.size]
        flags[before] += ca.logic_and(here, tick > 0.5)
    return ca.vertcat(*flags)


def _code(reason: str) -> float:
    return float(STOPS.index(reason))


def _flat(matrix: ca.SX) -> ca.SX:
    """Row by row."""
    return ca.reshape(matrix.T, -1, 1)


def _lowered(name: str, inputs: Mapping[str, ca.SX], outputs: Mapping[str, Any]) -> Program:
    made = [ca.densify(ca.SX(value)) for value in outputs.values()]
    return lower(ca.Function(name, list(inputs.values()), made, list(inputs), list(outputs), _OPTIONS))

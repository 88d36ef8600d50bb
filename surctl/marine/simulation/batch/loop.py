"""One control period of the closed loop as CasADi expressions; when a run ends: arrival, contact, fault, dead end.

The module writes the loop as CasADi expressions: whole runs are compiled or run in CasADi's virtual machine, and
`simulation.loop` steps a single run through the same programs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import casadi as ca

from surctl.ir import Block, Call, Layout, Port, Program, Recording, Routine, fold, lower, lower_named
from surctl.ir.elementary import nearby_angles
from surctl.ir.folding import shared_divisors
from surctl.marine.control import WORKING, Law, build_law, law_options
from surctl.marine.guidance import FOLLOWING, MAX_WAYPOINTS, ROW, follow
from surctl.marine.simulation.batch.listening import Listening, flat, slots
from surctl.marine.simulation.batch.structure import AROUND, BODY_SIZES, FIRST, Body, Mission, Structure
from surctl.marine.simulation.metrics import (
    ABSENT,
    COUNTED,
    STANDSTILL,
    STOPPED_LIMIT,
    STOPS,
    counted,
    path_square,
    path_tangent,
)
from surctl.marine.simulation.physics import advance
from surctl.marine.simulation.sensors import FIRING
from surctl.marine.simulation.thruster_faults import fin_excess
from surctl.marine.simulation.world import LONGEST
from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_STATE, plant_layout, plant_state
from surctl.noise import NOISE_STATE

_HEADING = PLANT_STATE.slice("eta").start + 3
_FINITE = 1e300


@dataclass(frozen=True, eq=False)
class Loop:
    """The closed loop for one loop structure (the part of a setup that is fixed at compilation), with its law.

    `state` and `parameters` are layouts of a run's vectors; the run ends when the first entry of the state, `done`,
    becomes 1.
    """

    structure: Structure
    law: Law
    state: Layout
    parameters: Layout

    @cached_property
    def step(self) -> Routine:
        """Function that simulates one control period: from a run's state and parameters it computes the next state."""
        law, state, parameters = self.law, self.state, self.parameters
        builder = _Builder(self.structure, law, state, parameters)
        end = _called(builder.close())
        # the headings of all RK4 stages are near the first: the hull turns little within 25 ms
        move = shared_divisors(nearby_angles(lower(advance(self.structure.form)), source=0, entry=_HEADING))
        steps = (
            *(builder.mission.steps(state, parameters) if builder.mission else ()),
            _called(builder.sense()),
            Call(law.block, ("x", "u", "p"), ("tau", "x_next", "status", "telemetry")),
            _called(builder.drive()),
            Call(move, ("plant", "thrust", "d0", "plant_p"), ("plant_between",)),
            _called(builder.between()),
            Call(move, ("plant_between", "thrust", "d1", "plant_p"), ("plant_next",)),
            end,
        )
        return Routine("step", (("s", state.size), ("w", parameters.size)), steps, end.results)

    def calls(self, *, measured: bool) -> dict[str, Block]:
        """Return the programs of `step` except law, thrusters and plant, for a single run that keeps the law's state.

        The state of such a loop has no entry `law`, see `loop_of`. With `measured`, the distances of the sonars' first
        certain echoes [m] are inputs: `echo` of `sense` and of `between`.
        """
        builder = _Builder(self.structure, self.law, self.state, self.parameters, measured=measured)
        fed = builder.mission.programs(self.state, self.parameters) if builder.mission else ()
        listed = (*fed, builder.sense(), builder.between(), builder.close())
        return {block.name: block for block in listed}


def _called(program: Block) -> Call:
    # with the values of its names
    return Call(program, tuple(name for name, _ in program.inputs), tuple(name for name, _ in program.outputs))


@cache
def loop_of(structure: Structure, law: Law, *, single: bool = False) -> Loop:
    """Return the loop of a law; that of a `single` run has no law state, which the run keeps itself."""
    state = [port for port in _state_ports(law, structure) if not (single and port.name == "law")]
    return Loop(structure, law, Layout(tuple(state)), Layout(_parameter_ports(law, structure)))


@cache
def build_loop(structure: Structure) -> Loop:
    """Return the closed loop of a loop structure; the result is cached, and its step is built when it is first used."""
    law = build_law(  # no more slots than obstacles, and no filter without input
        structure.law, contacts=structure.contacts, sonar=structure.sensing == "sonar", equipment=structure.equipment,
        moving=structure.moving, depths=structure.depths, actuators=structure.actuators, **law_options(structure),
    )  # fmt: skip
    return loop_of(structure, law)


def _parameter_ports(law: Law, structure: Structure) -> tuple[Port, ...]:
    world = (
        Port(
            "plant", (plant_layout(structure.form).size,), "SI", "parameters of the simulated vehicle, see plant_layout"
        ),
        Port("world_hull", (1,), "m", "hull radius of the simulated vehicle"),
        Port("arrival_radius", (1,), "m", "distance to the target that counts as arrived"),
        Port("legs", (1,), "1", "number of legs of the path"),
        Port("visited", (1,), "m", "distance to a corner that counts as a visit; 0 if corners may be skipped"),
        Port("steps", (1,), "1", "largest number of control periods of the run"),
        Port("leg", (2,), "1", "unit direction of the path's last leg in {E}"),
        Port("current", (2,), "m/s", "current in {E}"),
        Port("wave", (4,), "N, rad/s, rad", "wave force: amplitude along x and y of {E}, rate, phase"),
        Port("drift", (4,), "N, rad/s, rad", "slow drift force: amplitude along x and y of {E}, rate, phase"),
        Port("thrust_gain", (4,), "1", "ratio of delivered to commanded thrust, per axis"),
        Port("thrust_bias", (4,), "N, N m", "bias of the delivered thrust, per axis"),
    )
    bodies = (Port(f"body{k}", (BODY_SIZES[kind],), "SI", kind) for k, kind in enumerate(structure.bodies))
    heights = Port("heights", (len(structure.bodies), 2), "m", "z of each obstacle's bottom and top")
    allowed = Port("depths", (2,), "m", "lowest and highest z that the hull may use")
    upright = (*((heights,) if structure.heights else ()), *((allowed,) if structure.depths else ()))
    there = [Port("there", (len(structure.bodies),), "1", "1 if the obstacle is in the water")]
    optional = there if structure.optional else []
    thrusters = [law.inputs.port(WORKING)] if WORKING in law.inputs else []
    listed = (*law.gains, *world, *bodies, *optional, *thrusters, *upright, *Listening(structure, law).parameters())
    mission = _mission_of(structure, law)
    return (*listed, *mission.parameters(Layout(listed))) if mission else listed


def _mission_of(structure: Structure, law: Law) -> Mission | None:
    return Mission(law, structure.points, rises=structure.rises) if structure.points else None


def _state_ports(law: Law, structure: Structure) -> tuple[Port, ...]:
    return (
        Port("done", (1,), "1", "1 when the run has ended"),
        Port("step", (1,), "1", "number of the control period"),
        Port("plant", (plant_state(structure.form).size,), "SI", "state of the plant, see plant_state"),
        Port("law", (law.state.size,), "SI", "the law's state"),
        *(Listening(structure, law).ports() if structure.sensing == "sonar" else ()),
        Port("clear", (1,), "1", "1 after the hull was clear of the walls once"),
        Port("least", (1,), "m", "smallest clearance so far", ABSENT),
        *((Port("stopped", (1,), "1", "control periods since the law stopped"),) if law.perception else ()),
        *((Port("standing", (1,), "1", "control periods since the law gave up"),) if "trapped" in law.outputs else ()),
        Port("stop", (1,), "1", "reason why the run ended, see STOPS"),
        Port("away", (1,), "1", "1 during an avoidance interval"),
        Port("last_place", (2,), "m", "x, y at the last control step"),
        Port("last_thrust", (4,), "N, N m", "thrust command at the last control step"),
        Port("last_signs", (4,), "1", "sign of each thrust command when it was last above 1 % of its limit"),
        *((FIRST,) if structure.points else ()),
        *FOLLOWING,
        *COUNTED,
    )


class _Builder:
    def __init__(
        self, structure: Structure, law: Law, state: Layout, parameters: Layout, *, measured: bool = False
    ) -> None:
        self.structure, self.law, self.state, self.parameters = structure, law, state, parameters
        self.measured, self.alone = measured and structure.sensing == "sonar", "law" not in state
        self.sonar, self.listening = structure.sensing == "sonar", Listening(structure, law)
        self.mission = _mission_of(structure, law)

    def sense(self) -> Program:
        # world, first sonar firing, inputs of the law and the plant
        s, state = self.state.symbols("s")
        w, parameters = self.parameters.symbols("w")
        step, dt = state["step"], self.law.dt
        time = step * dt
        bodies = self.structure.bodies_at(parameters, time)
        eta, nu = state["plant"][:4], state["plant"][4:8]
        out: dict[str, ca.SX] = {}
        if not (self.mission or self.alone):
            out = {"x": state["law"], "p": w[: self.law.gains.size]}
        echo = {"echo": ca.SX.sym("echo", self.listening.wide)} if self.measured else {}
        inputs: dict[str, ca.SX] = {"eta": eta, "nu": nu}
        near = self._beside(parameters, bodies, eta)
        if self.sonar:
            movers_there = None  # if the number of moving obstacles is the same constant in all runs
            if self.structure.optional:
                kinds = enumerate(self.structure.bodies)
                there = (parameters["there"][k] > 0.5 for k, kind in kinds if kind == "mover")
                movers_there = sum(there, start=ca.SX(0))
            own, message_noise, loss = self.listening.draw(state["noise"], out, movers=movers_there)
            numbers = {**out, **echo}
            echoes, arrived = self.listening.instant(parameters, near, state["plant"], state, step, numbers, instant=0)
            inputs = {"samples": echoes["sonar_last"], "fresh": ca.fmax(state["fresh"], arrived)}
            out["echoes"] = self.listening.echoes.join(echoes)
            movers = [b for b in bodies if b.moving]
            rows = slots([b.contact(eta[:2]) for b in movers], [b.clearance(eta[:2]) for b in movers])
            noise = ca.reshape(message_noise, 4, self.structure.slots).T
            inputs |= self.listening.measurements(state, eta, nu, rows, own, noise, loss, out)
        else:
            out |= {name: ca.SX(0) for name in ("noise_next", "normals", "uniforms", "echoes")}
            if "contacts" in self.law.inputs:
                inputs["contacts"] = obstacle_points(near, eta, self.law.inputs.port("contacts").shape[0])
        if "contacts" in inputs:
            rows = inputs["contacts"]
            empty = self.law.inputs.port("contacts").shape[0] - rows.shape[0]
            inputs["contacts"] = ca.vertcat(rows, ca.SX.zeros(empty, 6))
        if WORKING in self.law.inputs:
            inputs[WORKING] = parameters[WORKING]
        if "column" in self.law.inputs:
            inputs["column"] = free_column(bodies, parameters, eta) if self.structure.depths else ca.SX.zeros(2)
        out["u"] = self.law.inputs.join(inputs)
        out["plant"], out["plant_p"] = state["plant"], parameters["plant"]
        out["d0"], out["d1"] = (PLANT_DISTURBANCE.join(pushed(parameters, at)) for at in (time, time + FIRING))
        out["step"] = step
        out["clearance"] = clearances(bodies, parameters, eta[:3])
        out["late"] = ca.vertcat(ca.SX(0, 1), *(flat(out.pop(port.name)) for port in self._late if port.name in out))
        return lower_named("sense", {"s": s, "w": w, **echo}, out)

    @property
    def _late(self) -> Layout:
        return self.listening.late if self.sonar else Layout(())

    def drive(self) -> Program:
        # from the law's command to the thrust with the errors of the scenario; with fins, a fin gives the force of its
        # deflection at the speed through the water, as in `Thrusters.achieved`
        w, known = self.parameters.symbols("w")
        tau, inputs, actuators = ca.SX.sym("tau", 4), dict[str, ca.SX](), self.structure.actuators
        delivered = tau
        if actuators is not None and actuators.fins:
            sizes = {"plant": plant_state(self.structure.form).size, "telemetry": self.law.outputs.size - 4}
            inputs = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
            forces, commands = (
                inputs["telemetry"][self.law.telemetry_slice(name)] for name in ("thruster_force", "thruster_command")
            )
            psi = inputs["plant"][3]
            along = ca.dot(ca.vertcat(ca.cos(psi), ca.sin(psi)), known["current"])
            speed = ca.fmax(inputs["plant"][4] - along, 0)
            delivered += fin_excess(actuators, forces, commands, speed * speed)
        thrust = delivered * known["thrust_gain"] + known["thrust_bias"]
        return lower_named("drive", {"w": w, "tau": tau, **inputs}, {"thrust": thrust})

    def between(self) -> Program:
        # second sonar firing and clearances, 25 ms after the beginning of the control step
        w, parameters = self.parameters.symbols("w")
        sizes = dict.fromkeys(("plant_between", "step", "normals", "uniforms", "echoes"), 1)
        sizes["plant_between"] = plant_state(self.structure.form).size
        if self.sonar:
            listening = self.listening
            sizes |= {"normals": listening.normals, "uniforms": listening.uniforms, "echoes": listening.echoes.size}
            sizes |= {"echo": listening.wide} if self.measured else {}
        v = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        plant = v["plant_between"]
        bodies = self.structure.bodies_at(parameters, v["step"] * self.law.dt + FIRING)
        echoes, fresh = v["echoes"], ca.SX(0)
        if self.sonar:
            before = self.listening.echoes.split(echoes)
            audible = self._beside(parameters, bodies, plant)
            after, fresh = self.listening.instant(parameters, audible, plant, before, v["step"], v, instant=1)
            echoes = self.listening.echoes.join(after)
        near = clearances(bodies, parameters, plant[:3])
        return lower_named(
            "between", {"w": w, **v}, {"echoes_next": echoes, "fresh_next": fresh, "clearance_between": near}
        )

    def close(self) -> Block:
        # the reason if the run ends, the metrics, and the next state
        s, old = self.state.symbols("s")
        w, parameters = self.parameters.symbols("w")
        law, sonar = self.law, self.sonar
        symbols = {
            "clearance": 2,
            "clearance_between": 2,
            "tau": 4,
            **({"total": 1} if self.alone else {"x_next": law.state.size}),
            "status": 1,
            "telemetry": law.outputs.size - 4,
            "plant_next": plant_state(self.structure.form).size,
            "echoes_next": self.listening.echoes.size if sonar else 1,
            "fresh_next": self.structure.equipment.array.size if sonar else 1,
            "late": self._late.size,
            "noise_next": NOISE_STATE if sonar else 1,
            **({"first_next": 1} | dict.fromkeys(AROUND, ROW) if self.mission else {}),
        }
        v = {name: ca.SX.sym(name, size) for name, size in symbols.items()}
        place = old["plant"][:2]
        clear, free = with_walls(old["clear"], v["clearance"])
        with Recording() as recording:
            total = (
                v["total"]
                if self.alone
                else fold("total", lambda total, entry: total + entry, v["status"], v["x_next"])
            )
        total += ca.sum1(v["tau"]) + ca.sum1(v["telemetry"])
        to_target = place - parameters["waypoints"][MAX_WAYPOINTS - 1, :].T
        gap = ca.sqrt(ca.sumsqr(to_target))
        end_depth = parameters["depth"] + (parameters["mission"][-1, 2] if self.structure.rises else 0)
        level = not (self.structure.depths or self.structure.rises)
        left = gap if level else ca.sqrt(gap**2 + (old["plant"][2] - end_depth) ** 2)
        collided = free <= 0
        near, path_depth = parameters["waypoints"], parameters["depth"]
        if self.mission:
            following, near, here, path_depth = self.mission.progress(old, parameters, v)
        else:
            following = follow(old, near, parameters["legs"], place, visit=parameters["visited"])
            here = following["leg"]
        on_last = following["leg"] > parameters["legs"] - 1.5
        arrived = ca.logic_and(on_last, left <= parameters["arrival_radius"])
        reached = ca.logic_and(ca.logic_not(collided), arrived)
        broken = ca.logic_not(ca.fabs(total) <= _FINITE)
        standing, stop = self._standing(old, v["telemetry"])
        stop = ca.if_else(broken, _code("fault"), stop)
        stop = ca.if_else(reached, _code("reached"), ca.if_else(collided, _code("collision"), stop))
        ended = stop > 0
        last = old["step"] + 1 >= parameters["steps"]
        clear_between, _ = with_walls(clear, v["clearance_between"])
        least = ca.fmin(old["least"], ca.mmin(v["clearance"]))

        new: dict[str, ca.SX] = {
            "done": ca.logic_or(ended, last),
            "step": ca.if_else(ca.logic_or(ended, last), old["step"], old["step"] + 1),
            "plant": v["plant_next"],
            **({} if self.alone else {"law": v["x_next"]}),
            "clear": clear_between,
            "least": ca.if_else(ended, least, ca.fmin(least, ca.mmin(v["clearance_between"]))),
            "stop": stop,
            "last_place": place,
        }
        if sonar:
            new |= {**self.listening.echoes.split(v["echoes_next"]), "fresh": v["fresh_next"], "noise": v["noise_next"]}
            new |= self._late.split(v["late"])
        new |= {**standing, **following, **({"first": v["first_next"]} if self.mission else {})}
        tau, status = ca.if_else(broken, 0, v["tau"]), ca.if_else(broken, 0, v["status"])
        avoiding = v["telemetry"][law.telemetry_slice("avoiding")] > 0.5
        square, tangent = path_square(near, here, place), path_tangent(near, here, following["along"], on_last)
        avoiding = ca.if_else(broken, 0, avoiding)
        new |= counted(old, parameters, tau, status, avoiding, to_target, gap, square, tangent, path_depth, on_last)
        return recording.block("close", {"s": s, "w": w, **v}, {"s_next": self.state.join(new)})

    def _standing(self, old: Mapping[str, ca.SX], telemetry: ca.SX) -> tuple[dict[str, ca.SX], ca.SX]:
        """Return the number of control periods in which the law gave up or stopped, and the stop code of the run.

        The code is 0 until a number of periods reaches its limit.
        """
        law, counts, stop = self.law, {}, ca.SX(0)
        if "trapped" in law.outputs:
            counts["standing"] = old["standing"] + (telemetry[law.telemetry_slice("trapped")] > 0.5)
            stop = ca.if_else(counts["standing"] >= round(STANDSTILL / law.dt), _code("dead end"), stop)
        if law.perception is not None:
            now = telemetry[law.telemetry_slice("stopped")] > 0.5
            counts["stopped"] = ca.if_else(now, old["stopped"] + 1, 0)
            stop = ca.if_else(counts["stopped"] >= round(STOPPED_LIMIT / law.dt), _code("standstill"), stop)
        return counts, stop

    @staticmethod
    def _beside(w: Mapping[str, ca.SX], bodies: Sequence[Body], plant: ca.SX) -> list[Body]:
        return [body.beside(plant[2], w["world_hull"]) for body in bodies]


def pushed(w: Mapping[str, ca.SX], time: ca.SX) -> dict[str, ca.SX]:
    """Return current and force of the water at a time [s], by name as in `PLANT_DISTURBANCE`."""
    waves, slow = (ca.sin(w[name][2] * time + w[name][3]) * w[name][:2] for name in ("wave", "drift"))
    force = waves + slow
    return {"current": ca.vertcat(w["current"], 0), "force": ca.vertcat(force, ca.SX.zeros(2))}


def obstacle_points(bodies: Sequence[Body], eta: ca.SX, count: int) -> ca.SX:
    """Return the obstacles as input of the law (count, 6): the nearest ones, then empty rows."""
    rows = slots([b.contact(eta[:2]) for b in bodies], [b.clearance(eta[:2]) for b in bodies], count)
    return ca.vertcat(rows, ca.SX.zeros(count - rows.shape[0], 6))


def clearances(bodies: Sequence[Body], w: Mapping[str, ca.SX], position: ca.SX) -> ca.SX:
    """Return the clearances (2, 1) [m] of the hull to the nearest obstacle and to the nearest wall."""
    nearest = ca.SX(ABSENT)
    for body in bodies:
        nearest = ca.fmin(nearest, body.clearance(position) - w["world_hull"])
    walls = w["walls"]
    across = ca.fmin(ca.fmin(position[0] - walls[0], walls[1] - position[0]), position[1] - walls[2])
    return ca.vertcat(nearest, ca.fmin(across, walls[3] - position[1]) - w["world_hull"])


def free_column(bodies: Sequence[Body], w: Mapping[str, ca.SX], place: ca.SX) -> ca.SX:
    """Return the free water (2, 1) [m] above and below the hull."""
    above = below = ca.SX(LONGEST)
    for body in bodies:
        over, under = body.over_and_under(place[:3], w["world_hull"])
        above, below = ca.fmin(above, over), ca.fmin(below, under)
    top, bottom = place[2] + w["world_hull"], place[2] - w["world_hull"]
    allowed = ca.vertcat(ca.fmin(above, w["depths"][1] - top), ca.fmin(below, bottom - w["depths"][0]))
    return ca.fmax(allowed, 0)


def with_walls(clear: ca.SX, clearances: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return whether the hull was clear of the walls once, and the clearance [m] that decides on a collision.

    A hull that starts inside a wall does not collide with the walls until it was clear of them.
    """
    now = ca.logic_or(clear, clearances[1] > 0)
    return now, ca.if_else(now, ca.fmin(clearances[0], clearances[1]), clearances[0])


def _code(reason: str) -> float:
    return float(STOPS.index(reason))

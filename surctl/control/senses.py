"""From what the sensors say to what the decision is told: a step of its own, with its own state.

Range filter of every sonar, then the map of `sensing.local_map`, whose nearest marks become contacts beside those of
the base station. What walls or known obstacles explain is not marked.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, cos, sin

import casadi as ca

from surctl.control.ports import PARAMETERS
from surctl.ir import Block, Call, Layout, Port, Program, Routine, lower
from surctl.sensing import LocalMap, SonarArray, expected_range
from surctl.sensing.estimate import turned
from surctl.sensing.local_map import SLOT

__all__ = ["CELLS_A_HULL", "Senses", "build_senses"]

CELLS_A_HULL = 4.0
"""Cells of the map in a hull radius (*chosen*): 6.75 cm in the tank, 5 cm in the pool."""

_TOLERANCE = 0.10  # [m] by which an echo may be shorter than a known thing's and still be its own

_REACH = 0.5
_GRAIN = 0.71  # cells; half a cell's diagonal


@dataclass(frozen=True, eq=False)
class Senses:
    """What runs before the decision.

    Attributes:
        state: layout of its state.
        inputs: layout of what it is given.
        told: layout of what it tells the decision.
        block: (state, inputs, parameters) → (next state, told).
    """

    state: Layout
    inputs: Layout
    told: Layout
    block: Block


def build_senses(array: SonarArray, inputs: Layout, told: Layout, *, dt: float) -> Senses:
    """Assemble it for an array.

    Args:
        array: the sonars as the law believes them.
        inputs: `eta`, `nu`, `contacts`, `samples`, `fresh`.
        told: see `ports.scan_inputs`.
        dt: control period [s].
    """
    slots = min(array.size, ceil(dt / array.firing_period - 1e-9))
    chart = LocalMap(dt=dt, slots=slots)
    state = Layout(
        (Port("recent", (array.size, 3), "m", "last readings, newest first", array.maximum), *chart.ports("map_"))
    )
    split, feel = _split(state, inputs), _feel(array, chart, inputs, dt=dt)
    tell = _tell(array, chart, inputs, told)
    steps = (
        Call(split, ("x", "u"), ("recent", "cells", "corner")),
        Call(feel, ("recent", "u", "p"), ("recent_next", "place", "slots", "heard")),
        Call(
            chart.routine(), ("cells", "corner", "place", "slots"), ("cells_next", "corner_next", "marked", "unknown")
        ),
        Call(tell, ("u", "p", "marked", "unknown", "heard"), ("told",)),
        Call(_join(state), ("recent_next", "cells_next", "corner_next"), ("x_next",)),
    )
    sizes = (("x", state.size), ("u", inputs.size), ("p", PARAMETERS.size))
    return Senses(state, inputs, told, Routine("senses", sizes, steps, ("x_next", "told")))


def _split(state: Layout, inputs: Layout) -> Program:
    x, u = ca.SX.sym("x", state.size), ca.SX.sym("u", inputs.size)
    return _lowered("split", {"x": x, "u": u}, {port.name: x[state.slice(port.name)] for port in state})


def _join(state: Layout) -> Program:
    parts = {port.name: ca.SX.sym(port.name, port.size) for port in state}
    return _lowered("join", parts, {"x_next": ca.vertcat(*parts.values())})


def _feel(array: SonarArray, chart: LocalMap, inputs: Layout, *, dt: float) -> Program:
    n = array.size
    recent = ca.SX.sym("recent", 3 * n)
    u, given = inputs.symbols("u")
    p, known = PARAMETERS.symbols("p")
    told = given.get("contacts", ca.SX.zeros(0, 6))
    position, psi, hull = given["eta"][:2], given["eta"][3], known["hull"]
    heading = ca.vertcat(ca.cos(psi), ca.sin(psi))
    edge = hull / CELLS_A_HULL
    rows, heard, firings = [], [], []
    old = ca.reshape(recent, 3, n).T
    for i in range(n):
        reading = ca.sum1(given["samples"][i, :].T) / array.samples
        fresh = given["fresh"][i] > 0.5
        axis = turned(heading, array.azimuths[i])
        velocity = ca.vertcat(
            heading[0] * given["nu"][0] - heading[1] * given["nu"][1],
            heading[1] * given["nu"][0] + heading[0] * given["nu"][1],
        )
        closing = ca.dot(velocity, axis)
        moved = old[i, :].T - dt * closing
        after = ca.if_else(fresh, ca.vertcat(reading, moved[:2]), moved)
        rows.append(after)
        walls = expected_range(
            position,
            heading,
            walls=known["walls"],
            discs=told[:, :3],
            valid=told[:, 5],
            azimuth=array.azimuths[i],
            hull_radius=hull,
            half_angle=array.half_angle,
            maximum=array.maximum,
        )
        clear = ca.fmin(ca.fmin(after[0], after[1]), after[2])
        echo = ca.logic_and(reading < array.maximum - 0.1, reading < walls - _TOLERANCE)
        bound = 0.03
        apex = position + hull * axis
        blind = reading <= array.minimum + 0.5 * array.resolution
        firings.append(
            [
                fresh,
                ca.vertcat(
                    apex,
                    axis,
                    cos(array.half_angle),
                    sin(array.half_angle),
                    ca.fmax(clear - bound - _GRAIN * edge, 0),
                    ca.if_else(blind, 0, ca.fmax(reading - bound - 0.5 * edge, 0)),
                    ca.if_else(echo, reading + bound + 0.5 * edge, -1),
                    reading + _REACH * edge + 0.01,
                ),
            ]
        )
        heard.append(ca.vertcat(reading, bound, 1, 0, axis))
    size = sum(k for _, k, _ in SLOT)
    slots = [ca.vertcat(ca.SX.zeros(size - 2), -1, 0) for _ in range(chart.slots)]
    count = ca.SX(0)
    for fresh, firing in firings:
        for s in range(chart.slots):
            slots[s] = ca.if_else(ca.logic_and(fresh, count == s), firing, slots[s])
        count += fresh
    place = ca.vertcat(position, hull, edge)
    return _lowered(
        "feel",
        {"recent": recent, "u": u, "p": p},
        {"recent_next": ca.vertcat(*rows), "place": place, "slots": ca.vertcat(*slots), "heard": ca.vertcat(*heard)},
    )


def _tell(array: SonarArray, chart: LocalMap, inputs: Layout, told: Layout) -> Program:
    u, given = inputs.symbols("u")
    p, known = PARAMETERS.symbols("p")
    marked, unknown = ca.SX.sym("marked", 3 * chart.sectors), ca.SX.sym("unknown", 3 * chart.sectors)
    heard = ca.SX.sym("heard", 6 * array.size)
    position, edge = given["eta"][:2], known["hull"] / CELLS_A_HULL
    far = 1e5
    rows = given.get("contacts", ca.SX.zeros(0, 6))
    contacts = [rows[k, :] for k in range(rows.shape[0])]
    blank = []
    for k in range(chart.sectors):
        at = marked[3 * k : 3 * k + 3]
        there = at[2] < far
        row = ca.horzcat((position + at[:2]).T, 0.71 * edge, 0, 0, 1)
        contacts.append(ca.if_else(there, row, ca.SX.zeros(1, 6)))
        at = unknown[3 * k : 3 * k + 3]
        there = at[2] < far
        distance = ca.sqrt(ca.if_else(there, at[2], 1))
        blank.append(
            ca.if_else(
                there, ca.horzcat((at[:2] / distance).T, distance - known["hull"] - 0.5 * edge), ca.DM([[0, 0, 100]])
            )
        )
    values = {
        "eta": given["eta"],
        "nu": given["nu"],
        "contacts": ca.vertcat(*contacts),
        "unknown": ca.vertcat(*blank),
        "heard": ca.reshape(heard, 6, array.size).T,
    }
    inputs_ = {"u": u, "p": p, "marked": marked, "unknown": unknown, "heard": heard}
    return _lowered("tell", inputs_, {"told": told.join(values)})


def _lowered(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> Program:
    made = [ca.densify(ca.SX(value)) for value in outputs.values()]
    return lower(ca.Function(name, list(inputs.values()), made, list(inputs), list(outputs), {"cse": True}))

"""The smallest laws, a flight of one, and their bundles: shared by the tests of guard, proof and mutants."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from surctl.export import Bundle, Records
from surctl.export.contract import Exportable
from surctl.export.envelope import anywhere, as_records
from surctl.ir import Block, Call, Gather, Layout, Loop, Port, Real, Routine, lower
from surctl.marine.control import build_law, load_gains
from surctl.marine.export import build_bundle, closed_form, operating_envelope
from surctl.marine.simulation import law_numbers, load_scenario, simulate
from surctl.marine.vehicle import Vehicle, load_vehicle
from tests.export.standin import StandIn

SCENARIO = "pool-ahead"


@cache
def vehicle() -> Vehicle:
    return load_vehicle(load_scenario(SCENARIO).vehicle)


@cache
def exported(real: Real = "float32") -> tuple[Exportable, Bundle, Records]:
    """The law with constant gains, its bundle, and a recorded flight."""
    mission, law = load_scenario(SCENARIO), build_law("closed_form")
    gains = load_gains("default")
    shipped = closed_form(law, real=real, constants=law_numbers(mission, gains, vehicle()))
    within = operating_envelope(law, mission, vehicle(), shipped.gains)
    bundle = build_bundle(shipped, {}, real=real, envelope=within)
    record = simulate(mission, vehicle(), gains=gains, law=law, sensing="truth", seed=0).record
    flight = Records(record.law_state, record.law_input, np.zeros((len(record.law_state), 0)))
    return shipped, bundle, as_records(shipped, flight)


@dataclass(frozen=True, eq=False)
class Searching(StandIn):
    """A law of three steps over nine rows; `function` is of no use."""

    routine: Routine

    @property
    def block(self) -> Block:
        return self.routine


@cache
def searching() -> tuple[Exportable, Bundle]:
    """A law that searches and remembers numbers of any size: the thrust of the first row that fits, within limits.

    Nine rows are filled, the index of one is found, the input is read at that index, and what is remembered is added.
    The project's laws that search have a thousand times the operations (`analysis/18_export_benchmark`).
    """
    state = Layout((Port("memory", (4,), "N", "thrust so far"),))
    inputs = Layout((Port("rows", (9, 4), "N, N, N, N m", "thrusts to choose from"),))
    outputs = Layout((Port("tau", (4,), "N, N, N, N m", "thrust, body frame"),))
    row, found, at, done = ca.SX.sym("row", 4), ca.SX.sym("found"), ca.SX.sym("at"), ca.SX.sym("done")
    scale = lower(ca.Function("scale", [row], [3.0 * row - row[0]]))
    fits = ca.logic_and(done < 0.5, row[0] > row[1])
    look = lower(
        ca.Function("look", [at, found, done, row], [ca.if_else(fits, at, found), ca.if_else(fits, 1.0, done)])
    )
    x, none = ca.SX.sym("x", 4), ca.SX(0, 1)
    limit = ca.SX(vehicle().thrust_limit)
    wanted = 2.0 * x - 3.0 * row  # no number where both overflow
    tau = ca.fmin(ca.fmax(wanted, -limit), limit)
    decide = lower(
        ca.Function("decide", [x, row], [tau, 0.5 * wanted, ca.if_else(ca.fabs(wanted[0]) > limit[0], 1.0, 0.0), none])
    )
    start = lower(ca.Function("start", [x], [ca.SX(0), ca.SX(0)]))
    routine = Routine(
        "searches",
        (("x", 4), ("u", 36), ("p", 0)),
        (
            Loop(scale, 9, (), ("scaled",), sliced=("u",)),
            Call(start, ("x",), ("first", "open")),
            Loop(look, 9, ("first", "open"), ("chosen", "known"), sliced=("scaled",), index=True, until=1),
            Gather("u", "chosen", 4, "best"),
            Call(decide, ("x", "best"), ("tau", "next", "status", "telemetry")),
        ),
        ("tau", "next", "status", "telemetry"),
    )
    law = Searching("surctl_searches", 0.05, state, inputs, Layout(()), outputs, ca.Function("none", [x], [x]), routine)
    return law, build_bundle(law, {}, real="float32", envelope=anywhere(law).fitted(law, "float32"))

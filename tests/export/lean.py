"""The smallest laws, a flight of one, and their bundles: shared by the tests of guard, proof and mutants."""

from __future__ import annotations

from functools import cache

import numpy as np

from surctl.control import build_law, load_gains
from surctl.export import Bundle, Records, as_records, build_bundle, closed_form, flight_envelope
from surctl.export.contract import Exportable
from surctl.ir import Real
from surctl.simulation import law_numbers, load_scenario, simulate
from surctl.vehicle import Vehicle, load_vehicle

SCENARIO = "pool-ahead"


@cache
def vehicle() -> Vehicle:
    return load_vehicle(load_scenario(SCENARIO).vehicle)


@cache
def exported(real: Real = "float32") -> tuple[Exportable, Bundle, Records]:
    """The law with constant gains, its bundle, and a recorded flight."""
    mission, law = load_scenario(SCENARIO), build_law("lean")
    gains = load_gains("default")
    shipped = closed_form(law, real=real, constants=law_numbers(mission, gains, vehicle()))
    within = flight_envelope(law, mission, vehicle(), shipped.gains)
    bundle = build_bundle(shipped, {}, real=real, envelope=within)
    record = simulate(mission, vehicle(), gains=gains, law=law, sensing="truth", seed=0).record
    flight = Records(record.law_state, record.law_input, np.zeros((len(record.law_state), 0)))
    return shipped, bundle, as_records(shipped, flight)


@cache
def searching() -> tuple[Exportable, Bundle]:
    """A law that searches and remembers: mode projected, told one obstacle that stands."""
    mission, law = load_scenario(SCENARIO), build_law("guarded", mode="projected", contacts=1, moving=False)
    gains = load_gains("default")
    shipped = closed_form(law, real="float32", constants=law_numbers(mission, gains, vehicle()))
    within = flight_envelope(law, mission, vehicle(), shipped.gains)
    return shipped, build_bundle(shipped, {}, real="float32", envelope=within)

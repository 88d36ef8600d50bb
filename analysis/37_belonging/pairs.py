"""Pairs of an accepted certificate and a bundle to which it belongs, of every kind."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from surctl.export import Bundle
from surctl.export import bundle as core
from surctl.export.supplement import PlantLists
from surctl.ir import Block, Layout, Port
from surctl.lyapunov import Problem, continuous_dynamics, solve
from surctl.marine.control import Law, build_law, law_source, load_gains
from surctl.marine.export import build_bundle
from surctl.marine.export.origin import origin_of
from surctl.marine.simulation import law_numbers, load_scenario
from surctl.marine.tuning import derived_gains
from surctl.marine.vehicle import Vehicle, load_vehicle
from surctl.marine.verification import claims
from surctl.system import Action, Controller, Plant, System
from surctl.verification import prove
from surctl.verification.formula import parse, variable

STORED = Path(__file__).resolve().parents[2] / "tests" / "certcheck"
VEHICLES = ("sur540-flooded", "bluerov2-vonbenzon", "bluerov2-heavy", "rexrov")
MISSION = load_scenario("pool-behind")
TRUTH = ("truth",)
SOURCES = (
    *((f"region-{name}", TRUTH) for name in ("cruise-20-soft", "turning-20-current", "turning-20-curved-fast",
      "turning-20-scale", "turning-20-rest", "turning-20-rexrov", "turning", "turning-20-lag", "turning-20-sampled",
      "turning-lag")),
    *((f"region-{name}", ("truth", "sonar")) for name in ("cruise-20", "turning-20", "turning-20-curved")),
    *((f"braking-{name}", ("truth", "sonar")) for name in ("simple-20", "inertia-ranges", "inertia-20-axes",
      "inertia-20-movers", "inertia-20-unequal")),
)  # fmt: skip
"""Stored certificates, and with which sensing their law is exported."""

INEQUALITIES = ("v1-corrected", "course-corrected", "m-norm-corrected", "braking-keeps", "braking-mass")


@dataclass(frozen=True)
class Pair:
    """A certificate and the bundle of its controller."""

    name: str
    certificate: Mapping[str, Any]
    bundle: Bundle


@cache
def vehicles() -> dict[str, Vehicle]:
    """Return the vehicles of the pairs by their digest."""
    return {vehicle.digest(): vehicle for vehicle in map(load_vehicle, VEHICLES)}


@cache
def laws() -> dict[str, Mapping[str, Any]]:
    """Return the options of the laws of the pairs by their digest."""
    choices: tuple[Mapping[str, Any], ...] = (
        {}, {"barrier": "inertia"}, {"barrier": "inertia", "movers": "barrier"}
    )  # fmt: skip
    return {build_law(**options).block.digest(): options for options in choices}


@cache
def blocks() -> dict[str, Block]:
    """Return the instruction lists of the laws of the pairs by their digest."""
    laws_ = [build_law(**options) for options in (*laws().values(), {"law": "steered"})]
    return {law.block.digest(): law.block for law in (*laws_, *(build().controller for build, *_ in _OWN))}


def numbers_for(claim: Mapping[str, Any], law: Law, vehicle: Vehicle) -> dict[str, np.ndarray]:
    """Return the gains of the library, with those that the claim states and with a spin that it covers."""
    stated = claim.get("law") or {}
    speeds = {key: stated[key] for key in ("cruise", "cap") if key in stated}
    gains = load_gains("default").with_own(law_source(law.ref).gains)
    values = {
        k: np.array(v) for k, v in law.gains.unpack(law_numbers(replace(MISSION, **speeds), gains, vehicle)).items()
    }
    for name in stated.keys() & values.keys() - {"mass", "linear_drag", "quadratic_drag", "stopping"}:
        values[name][:] = stated[name]
    if "margin_m" in stated:
        values["margin"][:], values["cap"][:] = stated["margin_m"], stated["cap_m_per_s"]
    turn = (
        claim["encounter"]["turn_rad_per_s"] if "encounter" in claim else claim["vehicle"].get("yaw_rate_rad_per_s", 1)
    )
    values["spin"][:] = min(turn, values["spin"][0])
    return values


def robots() -> Iterator[Pair]:
    """Yield the pairs of a stored certificate and the bundle of its law."""
    for source, sensings in SOURCES:
        document = json.loads((STORED / f"{source}.json").read_text(encoding="utf-8"))
        claim = document["claim"]
        vehicle, options = vehicles()[claim["sha256_vehicle"]], laws()[claim["sha256_law"]]
        for sensing in sensings:
            sonar = {"sonar": True, "equipment": MISSION.sensors.on(vehicle["radius"])} if sensing == "sonar" else {}
            law = build_law(**options, **sonar)
            values = numbers_for(claim, law, vehicle)
            yield Pair(f"{source} {sensing}", document, build_bundle(law, values, origin=origin_of(law, vehicle)))


def heading_loops() -> Iterator[Pair]:
    """Yield the pairs of a certificate of the heading loop and the bundle of the law `steered`."""
    for name, cruise, file in (("otter", 1.1, "region-steered-20"), ("remus100", 1.5, "region-steered-20-remus100")):
        law, vehicle = build_law("steered"), load_vehicle(name)
        gains = derived_gains(vehicle.at_speed(cruise), cruise=cruise).with_own(law_source("steered").gains)
        mission = replace(MISSION, cruise=cruise, cap=round(cruise * 0.22 / 0.15, 9))
        values = law.gains.unpack(law_numbers(mission, gains, vehicle))
        document = json.loads((STORED / f"{file}.json").read_text(encoding="utf-8"))
        yield Pair(f"steered {name}", document, build_bundle(law, values, origin=origin_of(law, vehicle)))


def inequalities() -> Iterator[Pair]:
    """Yield the pairs of a proved inequality of the library and a bundle with its gains."""
    vehicle, gains = load_vehicle("sur540-flooded"), load_gains("default")
    truth = build_law(barrier="inertia")
    sonar = build_law(barrier="inertia", sonar=True, equipment=MISSION.sensors.on(vehicle["radius"]))
    stated = gains.values | {"speed": MISSION.cruise, "speed_max": MISSION.cap}
    for name in INEQUALITIES:
        (claim,) = claims(stated, [name], vehicle=vehicle)
        certificate = prove(claim, slack=1e-9).certificate
        assert certificate is not None, name
        for sensing, law in (("truth", truth), ("sonar", sonar)):
            values = law.gains.unpack(law_numbers(MISSION, gains, vehicle))
            bundle = build_bundle(law, values, origin=origin_of(law, vehicle))
            yield Pair(f"{name} {sensing}", certificate, bundle)


def pendulum() -> System:
    """A pendulum with a law that integrates."""
    import casadi as ca

    angle, rate = Port("angle", (1,), "rad", "from below"), Port("rate", (1,), "rad/s", "its rate")
    numbers = (("gravity", "1/s^2", 1.5), ("mass", "kg", 2.0), ("damping", "1/s", 0.3))
    plant = Plant(
        "pendulum", Layout((angle, rate)), Layout((Port("torque", (1,), "N m", "at the pivot"),)),
        lambda x, f, d, p: {"angle": x["rate"], "rate": f["torque"] / p["mass"] - p["gravity"] * ca.sin(x["angle"])
                            - p["damping"] * x["rate"]},
        parameters=Layout(tuple(Port(name, (1,), unit, "of the pendulum", value) for name, unit, value in numbers)),
    )  # fmt: skip
    k = Port("k", (2,), "N m, N m s", "gains", 8.0)
    law = Controller("pd", 0.02, plant.state, plant.inputs,
                     lambda x, u, p: -p["k"][0] * u["angle"] - p["k"][1] * u["rate"], gains=Layout((k,)))  # fmt: skip
    return System(plant, law)


def cart() -> System:
    """A cart that drives itself away from its place, held against a reference."""
    place, goal = Port("place", (1,), "m", "of the cart"), Port("goal", (1,), "m", "reference")
    speed = Port("speed", (1,), "m/s", "of the cart")
    plant = Plant("cart", Layout((place,)), Layout((speed,)), lambda x, f, d, p: p["a"] * x["place"] ** 3 + f["speed"],
                  parameters=Layout((Port("a", (1,), "1/(m^2 s)", "drive", 1.0),)))  # fmt: skip
    gain = Layout((Port("k", (1,), "1/s", "gain", 2.0),))
    law = Controller("hold", 0.01, Layout((place, goal)), plant.inputs,
                     lambda x, u, p: p["k"] * (u["goal"] - u["place"]), gains=gain)  # fmt: skip
    return System(plant, law)


def integrating() -> System:
    """The same cart without its drive, with a law that integrates."""
    place, speed = Port("place", (1,), "m", "of the cart"), Port("speed", (1,), "m/s", "of the cart")
    plant = Plant("tank", Layout((place,)), Layout((speed,)), lambda x, f, d, p: f["speed"] - 0.5 * x["place"])
    law = Controller(
        "pi", 0.05, plant.state, plant.inputs,
        lambda x, u, p: Action(-p["k"] * u["place"] - p["k_i"] * x["sum"], {"sum": x["sum"] + 0.05 * u["place"]}),
        state=Layout((Port("sum", (1,), "m s", "integral"),)),
        gains=Layout((Port("k", (1,), "1/s", "gain", 2.0), Port("k_i", (1,), "1/s^2", "integral gain", 1.0))),
    )  # fmt: skip
    return System(plant, law)


_PENDULUM = (pendulum, {"angle": (-0.5, 0.5), "rate": (-1.0, 1.0)})
_CART = (cart, {"place": (-1.0, 1.0)})
_TANK = (integrating, {"place": (-1.0, 1.0), "controller.sum": (-1.0, 1.0)})
_OWN: tuple[tuple[Any, ...], ...] = (
    (*_PENDULUM, {}, "lyapunov", "6*angle^2 + rate^2 + angle*rate"),
    (*_PENDULUM, {"plant.mass": (1.8, 2.2)}, "lyapunov", "6*angle^2 + rate^2 + angle*rate"),
    (*_CART, {}, "lyapunov", "place^2"),
    (*_CART, {"k": (1.9, 2.1)}, "lyapunov", "place^2"),
    (*_TANK, {}, "lyapunov", "place^2 + 0.5*place*controller_sum + controller_sum^2"),
    (*_CART, {}, "barrier", "place^2 - 0.5"),
    (*_CART, {"plant.a": (0.9, 1.1)}, "barrier", "place^2 - 0.5"),
    (*_TANK, {}, "barrier", "place^2 + 0.5*place*controller_sum + controller_sum^2 - 0.5"),
)


def own_systems() -> Iterator[Pair]:
    """Yield the pairs of a certificate about a system of one's own and the bundle of its controller."""
    for build, within, ranges, kind, text in _OWN:
        system = build()
        dynamics = continuous_dynamics(system, within, ranges=ranges)
        known = {name: variable(name) for name in dynamics.names}

        def read(text: str, known: Mapping[str, Any] = known) -> Any:
            return parse(text, known)

        law = system.controller
        lists = PlantLists(system.plant, system.plant.parameters.pack())
        bundle = core.build_bundle(law, law.gains.unpack(law.gains.pack()), supplement=lists)
        if kind == "lyapunov":
            problem = Problem(dynamics, "lyapunov", read(text), 0.2)
        else:
            sets = (read(f"{text} + 0.25"),), (read(f"0.3 - ({text})"),)
            problem = Problem(dynamics, "barrier", read(text), initial=sets[0], unsafe=sets[1], multiplier=read("-0.5"))
        yield Pair(f"{kind} {dynamics.name} {' '.join(ranges)}".strip(), solve(problem).document, bundle)


def pairs() -> Iterator[Pair]:
    """Yield all pairs."""
    yield from robots()
    yield from heading_loops()
    yield from inequalities()
    yield from own_systems()

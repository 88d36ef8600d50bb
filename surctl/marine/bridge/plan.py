"""A session's plan from a scenario and a vehicle: the law is built, exported as C and compiled here."""

from __future__ import annotations

from math import radians

from surctl.export import ExportedController
from surctl.marine.bridge.axes import Mapping, mode_of
from surctl.marine.bridge.bridge import Plan
from surctl.marine.bridge.limits import Limits
from surctl.marine.bridge.site import Site
from surctl.marine.control import Gains, build_law, default_law, law_source
from surctl.marine.export import build_bundle, closed_form, operating_envelope
from surctl.marine.simulation import Scenario, law_numbers
from surctl.marine.tuning import gains_for
from surctl.marine.vehicle import Vehicle

__all__ = ["plan_session"]


def plan_session(
    scenario: Scenario,
    vehicle: Vehicle,
    *,
    gains: Gains | None = None,
    law: str | None = None,
    sonar: bool = False,
    mode: str = "alt_hold",
    site: Site | None = None,
    full_rate: float = radians(45.0),
    limits: Limits | None = None,
) -> Plan:
    """Return the plan of a session.

    Args:
        scenario: the mission.
        vehicle: the vehicle.
        gains: gains of the law; default: those of the vehicle.
        law: reference of the law; default: that of the vehicle.
        sonar: whether the law measures obstacles by sonars; else it knows those of the scenario and those that report.
        mode: the autopilot's mode in which the bridge steers, a key of `MODES`.
        site: place of the autopilot's NED frame in {E}; default: both frames have one origin, x points east.
        full_rate: yaw rate [rad/s] at full deflection.
        limits: time-outs.

    Raises:
        InputError: mission, mode and law do not fit.
        ToolMissing: there is no C compiler.

    Example:
        >>> from surctl.marine.bridge import plan_session
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> plan = plan_session(load_scenario("pool-behind"), load_vehicle("sur400"), law="closed_form")
        >>> plan.mapping.mode.name, plan.controller.bundle.name
        ('alt_hold', 'surctl_closed_form')
    """
    reference = law or default_law(vehicle)
    built = build_law(
        reference,
        sonar=sonar,
        equipment=scenario.sensors.on(vehicle["radius"]),
        depths=scenario.depths is not None,
        actuators=vehicle.actuators,
    )
    tuned = gains or gains_for(None, vehicle, cruise=scenario.cruise, own=law_source(reference).gains)[0]
    p = law_numbers(scenario, tuned.with_own(law_source(reference).gains), vehicle)
    within = operating_envelope(built, scenario, vehicle, built.gains, tuned=p)
    bundle = build_bundle(closed_form(built), built.gains.unpack(p), envelope=within)
    controller = ExportedController(built, bundle)
    mapping = Mapping.of(vehicle, mode_of(mode), full_rate=full_rate)
    return Plan(scenario, vehicle, built, controller, mapping, site or Site(), limits or Limits())

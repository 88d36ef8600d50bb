"""The subject of an assessment of the robot: a vehicle with its law, gains, speeds and missions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from surctl.assessment.assessment import Line, Part
from surctl.marine.assessment.loop import loop_part
from surctl.marine.assessment.motion import contact_part, region_part, runs_part
from surctl.marine.control import Barrier, Gains, Movers, build_law, default_law, law_source
from surctl.marine.guidance import Guidance
from surctl.marine.simulation import Run, Scenario, Sensing, simulate
from surctl.marine.vehicle import Vehicle
from surctl.marine.verification.linear import cap_above

__all__ = ["Mission"]


@dataclass(frozen=True, eq=False)
class Mission:
    """A vehicle with its law, gains and speeds, and the scenarios in which it runs.

    Attributes:
        vehicle, gains: the vehicle, also the model of the law, and the gains.
        cruise, cap: cruise speed and speed limit [m/s].
        law: reference of the law; empty: the default law of the vehicle.
        guidance: guidance of the law.
        scenarios: the missions.
        dt: control period [s]; None: that of the law.
        uncertainty: relative error of mass and drag; None: the ranges of the vehicle file, or the default ranges.
        sensing: what the law measures in the missions; None: sonar, if the law can use it.
        hulls: vehicle of each scenario; empty: the vehicle.
        runs: runs of the missions, if they were simulated before.
        extra: for each of these runs, whether it does not count; empty: all count.
        barrier, movers: options of the law, as for `build_law`.
    """

    vehicle: Vehicle
    gains: Gains
    cruise: float
    cap: float
    law: str = ""
    guidance: Guidance = "los"
    scenarios: tuple[Scenario, ...] = ()
    dt: float | None = None
    uncertainty: float | None = None
    sensing: Sensing | None = None
    hulls: tuple[Vehicle, ...] = ()
    runs: tuple[Run, ...] | None = None
    extra: tuple[bool, ...] = ()
    barrier: Barrier = "simple"
    movers: Movers = "predict"

    @property
    def name(self) -> str:
        """Name of the vehicle."""
        return self.vehicle.name

    @property
    def period(self) -> float:
        """Control period [s]."""
        return build_law(self.law_ref).dt if self.dt is None else self.dt

    @property
    def law_ref(self) -> str:
        """Reference of the law."""
        return self.law or default_law(self.vehicle)

    def parts(self) -> Mapping[str, Callable[[], Part]]:
        """Return the parts of the assessment; those about missions only if there is one."""
        about: dict[str, Any] = {"vehicle": self.vehicle, "gains": self.gains, "law": self.law_ref}
        parts: dict[str, Callable[[], Part]] = {
            "loop": self._loop,
            "region": partial(region_part, **about, cruise=self.cruise, cap=self.cap),
        }
        if self.scenarios:
            parts["no contact"] = partial(
                contact_part,
                tuple(zip(self.scenarios, self.hulls or [self.vehicle] * len(self.scenarios), strict=True)),
                self.gains,
                law=self.law_ref,
                sonar=self.sensed == "sonar",
                barrier=self.barrier,
                movers=self.movers,
                spread=self.uncertainty,
            )
            parts["runs"] = lambda: runs_part(self._runs(), extra=self.extra)
        return parts

    def _loop(self) -> Part:
        part = loop_part(
            self.vehicle,
            self.gains,
            law=self.law_ref,
            cruise=self.cruise,
            dt=self.dt,
            guidance=self.guidance,
            uncertainty=self.uncertainty,
            missions=self.scenarios,
        )
        mode = part.source.mode
        text = None if mode is None else cap_above(self.vehicle, mode.bearable, cap=self.cap)
        return part if text is None else part._replace(lines=(*part.lines, Line(None, text, "cap", counts=False)))

    @property
    def sensed(self) -> Sensing:
        """What the law measures in the missions."""
        return self.sensing or ("sonar" if "sonar" in law_source(self.law_ref).sensing else "truth")

    def _runs(self) -> tuple[Run, ...]:
        if self.runs is not None:
            return self.runs
        hulls = self.hulls or [self.vehicle] * len(self.scenarios)
        return tuple(self._run(*each) for each in zip(self.scenarios, hulls, strict=True))

    def _run(self, scenario: Scenario, vehicle: Vehicle) -> Run:
        options: dict[str, Any] = {"guidance": self.guidance, "barrier": self.barrier, "movers": self.movers}
        if self.sensed == "sonar":
            sensors = scenario.sensors.on(vehicle["radius"])
            options |= {"sonar": True, "equipment": sensors, "depths": scenario.depths is not None}
        law = build_law(self.law_ref, actuators=vehicle.actuators, **options)
        return simulate(scenario, vehicle, gains=self.gains, law=law, sensing=self.sensed)

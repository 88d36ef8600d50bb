"""The bridge, one call each period: when the law steps, arrival, restarts of the autopilot, refused missions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import cos, hypot, inf, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export import ExportedController
from surctl.marine.bridge.inputs import Inputs, Site
from surctl.marine.bridge.session import (
    Clock,
    Limits,
    Phase,
    Session,
    after_arrival,
    after_beat,
    after_estimate,
    after_law,
    after_time,
    sending,
)
from surctl.marine.bridge.wire import (
    Attitude,
    Axes,
    Beat,
    Event,
    Gone,
    Mapping,
    Position,
    Ranges,
    Reply,
    Text,
    Wire,
    mode_of,
)
from surctl.marine.control import Gains, Law, default_law, law_source
from surctl.marine.export import build_bundle, closed_form, operating_envelope
from surctl.marine.simulation import Scenario, law_numbers, vehicle_law
from surctl.marine.tuning import gains_for
from surctl.marine.vehicle import Vehicle

Vector = NDArray[np.float64]

_BEAT, _TIME, _RATES = 1.0, 0.1, 2.0  # [s] between heartbeats, TIMESYNC requests, requests of rates
_RATE, _BEATS = 40.0, 5.0  # [Hz] of attitude and position, and of the heartbeat
_REPEATED = 6  # times that a neutral command is sent in a period, because one may be lost
_BLIND = 0.3  # [s] longest time by which the present estimate is moved on for the delay of the command


@dataclass(frozen=True, eq=False)
class Plan:
    """What a session is to do, and with what.

    Attributes:
        law, controller: the law in Python, whose layouts the exported law has, and the latter in this process.
        mapping: thrust to stick axes, in the mode of the session.
        site: place of the autopilot's frame in {E}.
    """

    scenario: Scenario
    vehicle: Vehicle
    law: Law
    controller: ExportedController
    mapping: Mapping
    site: Site = field(default_factory=Site)
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        """Raise InputError for a mission that has to be fed, or a depth that the mode cannot follow."""
        if self.scenario.path.fed:
            raise InputError(
                "has more than 8 points, or a speed, depth or corner of a leg: the bridge cannot pass these to the law",
                file=self.scenario.source,
                key="path_m",
                remedy="give at most 8 points, and legs without speed_m_per_s, depth_m and corner",
            )
        if self.mapping.mode.name == "alt_hold" and self.scenario.depths is not None:
            problem = "needs a mode in which the law controls the depth"
            raise InputError(problem, file=self.scenario.source, key="depths_m", remedy="use --mode manual or guided")


@dataclass(frozen=True, eq=False)
class Moment:
    """One control period, for recordings.

    Attributes:
        phase, why: phase of the session, and the reason.
        eta, nu: pose (4,) and velocity (4,) that the law got, or the newest; None before the first.
        age: age of the estimate [s]; inf before the first.
        status: status of the law's step; None if it made none.
        tau: thrust (4,) of the law [N, N m]; 0 if it made no step.
        telemetry: telemetry of the law's step; None if it made none.
        axes: stick axes that were sent; None if nothing was sent.
        contacts: (k, 6) obstacles that the law knows, as rows x, y, radius, vx, vy, valid.
        u: inputs of the law's step; None if it made none.
    """

    time: float
    phase: Phase
    why: str
    eta: Vector | None
    nu: Vector | None
    age: float
    status: int | None
    tau: Vector
    telemetry: Vector | None
    axes: Axes | None
    contacts: Vector
    u: Vector | None = None


class Bridge:
    """A session between a law and an autopilot.

    Call `hear` with each datagram, and `period` once in each control period; send what it returns.

    Attributes:
        plan: what the session is to do.
        wire: encoder and decoder of the frames.
        session: state of the session.
        clock: the autopilot's clock.
        moment: the newest control period; None before the first.
        texts: (time, text) for the operator: changes of phase, and texts of the autopilot.
        arrived: whether the vehicle has reached the end of the path since the operator armed it.
    """

    def __init__(self, plan: Plan, wire: Wire) -> None:
        self.plan, self.wire = plan, wire
        self.session, self.clock = Session(), Clock()
        self.inputs = Inputs(plan.law, plan.scenario, plan.vehicle, plan.site)
        self.moment: Moment | None = None
        self.texts: list[tuple[float, str]] = []
        self.follower = plan.scenario.follower()
        self._due = {"beat": -inf, "time": -inf, "rates": -inf}
        self._sample, self._began = 0, False
        self.arrived = False
        self._takes: dict[type, Callable[[Any, float], None]] = {
            Beat: self._beat,
            Reply: lambda event, now: self._set_clock(self.clock.reply(now, sent=event.sent, boot=event.boot)),
            Position: self._position,
            Attitude: partial(self._own, self.inputs.attitude),
            Ranges: self._ranges,
            Gone: lambda event, _: self.inputs.gone(event.system),
            Text: lambda event, now: self.texts.append((now, f"autopilot: {event.text}")),
        }

    def hear(self, data: bytes, now: float) -> Sequence[Event]:
        """Take a datagram that arrived at `now` [s], and return its events."""
        events = self.wire.events(data)
        for event in events:
            self._takes[type(event)](event, now)
        return events

    def period(self, now: float) -> list[bytes]:
        """Run the control period that begins at `now` [s], and return the frames to send."""
        plan, mode = self.plan, self.plan.mapping.mode
        self._sample = max(self._sample + 1, int(now / plan.law.dt + 1e-6) + 1)  # counts missed periods too
        before = self.session
        silent = self.inputs.silent(now, longest=plan.limits.obstacle)
        self.session = after_time(
            self.session,
            now,
            clock=self.clock,
            steering_mode=mode.number,
            obstacle=silent,
            limits=plan.limits,
            dt=plan.law.dt,
        )
        frames = self._supervision(now)
        axes: Axes | None = None
        step = None
        if self.session.phase == "steering":
            axes, step = self._steer(now)
        what = sending(self.session, now, limits=plan.limits)
        if what == "neutral":
            axes = self._neutral()
        elif what == "nothing":
            axes = None
        self._changed(before, now)
        self.moment = self._moment(now, axes, step)
        if axes is not None:
            times = _REPEATED if what == "neutral" else 1
            frames += [frame for _ in range(times) for frame in self.wire.control(axes)]
        return frames

    def neutral(self) -> list[bytes]:
        """Return the frames that command no thrust, for the end of a session."""
        return self.wire.control(self._neutral())

    @property
    def active(self) -> bool:
        """Whether the bridge sends commands now."""
        return self.moment is not None and self.moment.axes is not None

    def _neutral(self) -> Axes:
        return Axes(velocity=(0.0, 0.0, 0.0)) if self.plan.mapping.mode.name == "guided" else Axes()

    def _supervision(self, now: float) -> list[bytes]:
        frames = []
        if now >= self._due["beat"]:
            frames.append(self.wire.heartbeat())
            self._due["beat"] = now + _BEAT
        if self.session.phase == "waiting":
            return frames
        if now >= self._due["time"]:
            frames.append(self.wire.request_time(now))
            self._due["time"] = now + _TIME
        if now >= self._due["rates"]:
            frames += self.wire.request_rates(_RATE, beats=_BEATS)
            self._due["rates"] = now + _RATES
        return frames

    def _steer(self, now: float) -> tuple[Axes, tuple[Vector, int, Vector, Vector]]:
        plan = self.plan
        if not self._began:
            plan.controller.reset()
            self._began = True
        u = self.inputs.vector(now + min(0.5 * self.clock.trip, _BLIND))
        done = plan.controller.step(u, self._sample)
        self.session = after_law(self.session, now, status=done.status, limits=plan.limits)
        step = (u, done.status, done.tau, done.telemetry)
        known = self.inputs.estimate
        assert known is not None
        pose, _ = known.at(now)
        self.follower.move(*pose[:2].tolist())
        if self.follower.last and self._left(pose) <= plan.scenario.arrival_radius:
            self.session, self.arrived = after_arrival(self.session, now), True
        good = done.status >= 0 and bool(np.isfinite(done.tau).all()) and self.session.phase == "steering"
        if not good:
            return self._neutral(), step
        reference = done.telemetry[plan.law.telemetry_slice("nu_reference")]
        if plan.mapping.mode.name == "guided":
            return self._velocity(reference, pose), step
        return plan.mapping.axes(done.tau, yaw_rate=float(reference[3])), step

    def _velocity(self, reference: Vector, pose: Vector) -> Axes:
        if not np.isfinite(reference).all():
            return self._neutral()
        c, s = cos(pose[3]), sin(pose[3])
        u, v, w, r = reference.tolist()
        north, east, down = self.plan.site.velocity([c * u - s * v, s * u + c * v, w]).tolist()
        return Axes(velocity=(north, east, down), yaw_rate=-r)

    def _left(self, pose: Vector) -> float:
        scenario = self.plan.scenario
        level = hypot(*(pose[:2] - scenario.target).tolist())
        return level if scenario.depths is None else hypot(level, float(pose[2]) - scenario.end_depth)

    def _beat(self, event: Beat, now: float) -> None:
        if not event.sub:
            if self.session.phase == "waiting":
                self.session = self.session.to("waiting", now, "the autopilot is not ArduSub")
            return
        before = self.session
        steering_mode = self.plan.mapping.mode.number
        self.session = after_beat(self.session, now, armed=event.armed, mode=event.mode, steering_mode=steering_mode)
        if self.session.permitted and not before.permitted:
            self._began = self.arrived = False
            self.follower = self.plan.scenario.follower()
        self._changed(before, now)

    def _set_clock(self, clock: Clock) -> None:
        if clock.restarts != self.clock.restarts:
            self.inputs.forget()
        self.clock = clock

    def _stamped(self, boot: float, now: float) -> float | None:
        self._set_clock(self.clock.stamped(now, boot))
        measured = self.clock.measured(boot)
        return None if measured is None else min(measured, now)

    def _position(self, event: Position, now: float) -> None:
        if event.system != self.wire.target:
            self.inputs.obstacle(event, now)
        else:
            self._own(self.inputs.position, event, now)

    def _own(self, take: Callable[[Any, float], None], event: Position | Attitude, now: float) -> None:
        # a measurement of the vehicle's own motion
        measured = self._stamped(event.boot, now)
        if measured is not None:
            take(event, measured)
            known = self.inputs.estimate
            if known is not None:
                self.session = after_estimate(self.session, known.measured)

    def _ranges(self, event: Ranges, now: float) -> None:
        measured = now if event.boot is None else self._stamped(event.boot, now)
        if measured is not None and now - measured <= self.plan.limits.estimate:
            self.inputs.ranges(event, measured)

    def _changed(self, before: Session, now: float) -> None:
        after = self.session
        if (before.phase, before.why) != (after.phase, after.why):
            self.texts.append((now, f"{after.phase}: {after.why}" if after.why else after.phase))

    def _moment(self, now: float, axes: Axes | None, step: tuple[Vector, int, Vector, Vector] | None) -> Moment:
        known = self.inputs.estimate
        eta, nu = (None, None) if known is None else known.at(now)
        age = inf if known is None else now - known.measured
        contacts = np.zeros((0, 6))
        if step is not None and "contacts" in self.plan.law.inputs:
            contacts = step[0][self.plan.law.inputs.slice("contacts")].reshape(-1, 6)
        u, status, tau, telemetry = step if step is not None else (None, None, np.zeros(4), None)
        return Moment(
            now, self.session.phase, self.session.why, eta, nu, age, status, tau, telemetry, axes, contacts, u
        )


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
        gains: gains of the law; default: those of the vehicle.
        law: reference of the law; default: that of the vehicle.
        sonar: whether the law measures obstacles by sonars; else it knows those of the scenario and those that report.
        mode: the autopilot's mode in which the bridge steers, a key of `MODES`.
        site: place of the autopilot's NED frame in {E}; default: both frames have one origin, x points east.
        full_rate: yaw rate [rad/s] at full deflection.

    Raises:
        InputError: mission, mode and law do not fit.
        ToolMissing: there is no C compiler.
    """
    reference = law or default_law(vehicle)
    built = vehicle_law(vehicle, reference, scenario, sonar=sonar)
    tuned = gains or gains_for(None, vehicle, cruise=scenario.cruise, own=law_source(reference).gains)[0]
    p = law_numbers(scenario, tuned.with_own(law_source(reference).gains), vehicle)
    within = operating_envelope(built, scenario, vehicle, built.gains, tuned=p)
    bundle = build_bundle(closed_form(built), built.gains.unpack(p), envelope=within)
    controller = ExportedController(built, bundle)
    mapping = Mapping.of(vehicle, mode_of(mode), full_rate=full_rate)
    return Plan(scenario, vehicle, built, controller, mapping, site or Site(), limits or Limits())

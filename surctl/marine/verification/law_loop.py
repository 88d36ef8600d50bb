"""The linear loop of any law about a cruise or a run's steady motion, also at its worst corner; refused motions.

The loop of a law that tracks a path, about a straight cruise, is that of `cruise_loop`. Any other law, and any law
about a steady motion of a run, is differentiated by central differences of its control step, so the linear loop needs
no model of the law. All quantities are deviations from that motion; plant and delay are those of `cruise_loop`.

A state of the law belongs to the loop if the measurements change it and it changes the thrust. An axis that the law
leaves alone (heave without heave force), and a coordinate that changes nothing (the position along a wall that is
followed), do not belong to the loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.allocation import allocate
from surctl.marine.control import Gains, Law, law_source
from surctl.marine.simulation import Run, Scenario
from surctl.marine.vehicle import Vehicle, plant_parameters, trim_thrust
from surctl.marine.vehicle.linearise import STATE_NAMES, check_cruise
from surctl.marine.verification.corners import NOMINAL, Corners, corners
from surctl.marine.verification.cruise_loop import (
    COUPLED,
    FAR,
    NEUTRAL,
    CruisePoint,
    assembled,
    cruise_loop,
    each_loop,
    has_cruise_loop,
    in_loop,
    law_numbers,
)
from surctl.own_code import label
from surctl.system import LinearLoop
from surctl.verification.sampled_margins import LoopCorners, SampledLoop, corners_of

Array = NDArray[np.float64]


_WINDOW = 2.0  # [s] for which a motion must be steady
_VELOCITY = (2e-3, 2e-3, 2e-3, 5e-3)  # largest range of u, v, w [m/s] and r [rad/s] over the window
_HEADING = np.deg2rad(1.0)
_THRUST = 0.02  # largest range of a thrust command, as a share of its limit
_FULL = 0.999  # share of the thrust limit from which a thrust is at its limit
_REST = 0.01  # [m/s] below it, the direction of a motion is noise
_TURN = 5e-3  # [rad/s] a motion that turns faster has no time-invariant linear loop


@dataclass(frozen=True, eq=False)
class OperatingPoint:
    """A steady motion of a run: what the law had as state, inputs and parameters, and how the hull moved.

    Attributes:
        x, u, p: the law's state, inputs and parameters.
        nu: velocity u, v, w [m/s], r [rad/s], over ground.
        heading: ψ [rad].
        text: the place, as text.
        current: horizontal velocity (2,) of the water in {E} [m/s].
    """

    x: Array
    u: Array
    p: Array
    nu: Array
    heading: float
    text: str
    current: tuple[float, float] = (0.0, 0.0)

    @property
    def speed(self) -> float:
        """Horizontal speed [m/s]."""
        return float(np.hypot(*self.nu[:2]))

    @property
    def course(self) -> float:
        """Direction of the motion over ground [rad]; that of the hull at rest."""
        return self.heading + (float(np.arctan2(self.nu[1], self.nu[0])) if self.speed > _REST else 0.0)


def steady_motion(run: Run) -> OperatingPoint:
    """Return the steadiest 2 s of a run, if velocity, heading and thrust are constant there.

    If the robot moves steadily at half the cruise speed or more at some time, this motion is returned and not a rest.

    Args:
        run: a run of a law for exact obstacle positions, on the plant of `surctl`.

    Raises:
        InputError: the run has no steady motion of 2 s; the message states what varied least.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario, simulate
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import steady_motion
        >>> run = simulate(load_scenario("tank-static"), load_vehicle("sur400"), gains=load_gains("default"))
        >>> point = steady_motion(run)
        >>> round(point.speed, 2)
        0.22
    """
    record = run.record
    middle = steadiest(record.eta, record.nu, record.tau, law=run.law, scenario=run.scenario, p=record.law_parameters)
    return operating_point(
        run.scenario, record.time[middle], record.eta[middle], record.nu[middle],
        x=record.law_state[middle], u=record.law_input[middle], p=record.parameters_at(middle),
    )  # fmt: skip


def steadiest(eta: Array, nu: Array, tau: Array, *, law: Law, scenario: Scenario, p: Array) -> int:
    """Return the control step in the middle of the steadiest 2 s of a run; see `steady_motion`.

    Args:
        eta, nu, tau: (n, 4) pose, velocity and commanded thrust at each control step.
        law: the law of the run.
        scenario: the scenario of the run.
        p: the law's parameters.

    Raises:
        InputError: as for `steady_motion`.
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    steps = round(_WINDOW / law.dt)
    limits = np.maximum(p[law.gains.slice("thrust_limit")], 1e-12)
    signals = np.column_stack([nu / _VELOCITY, np.unwrap(eta[:, 3]) / _HEADING, tau / (_THRUST * limits)])
    if len(signals) <= steps:
        raise InputError(f"ended after {(len(signals) - 1) * law.dt:g} s", key=scenario.name, remedy=_REMEDY)
    within = partial(_over_windows, steps + 1)
    ranges = within(maximum_filter1d, signals) - within(minimum_filter1d, signals)  # 1 at the largest steady range
    most = np.abs(tau) >= _FULL * limits  # nothing controls an axis whose thrust is at its limit
    full = within(maximum_filter1d, most.astype(float)) > 0
    worst = np.where(full.any(axis=1), np.inf, ranges.max(axis=1))
    fast = np.hypot(*nu[steps:, :2].T) >= 0.5 * scenario.cruise
    moving = fast & (worst <= 1.0)
    k = int(np.argmin(np.where(moving, worst, np.inf) if moving.any() else worst))
    middle = k + steps // 2  # its end may have left the steady motion
    if not worst[k] <= 1.0:
        which = ("u", "v", "w", "r", "the heading", "surge thrust", "sway thrust", "heave thrust", "yaw thrust")
        k = int(np.argmin(ranges.max(axis=1)))
        if ranges[k].max() <= 1.0 and full[k].any():
            problem = f"has no steady motion that is controlled: {which[5 + int(np.argmax(full[k]))]} is at its limit"
            raise InputError(problem, key=scenario.name, remedy="give a lower speed, or less current")
        varied, by = which[int(np.argmax(ranges[k]))], ranges[k].max()
        problem = f"has no steady motion: in its steadiest {_WINDOW:g} s, {varied} varies {by:.2g} times too much"
        raise InputError(problem, key=scenario.name, remedy=_REMEDY)
    if abs(nu[middle, 3]) > _TURN:
        problem = f"turns at {nu[middle, 3]:.2g} rad/s where it is steady, so its linear loop varies with time"
        raise InputError(problem, key=scenario.name, remedy=_REMEDY)
    return middle


def _over_windows(width: int, extreme: Callable[..., Array], signals: Array) -> Array:
    # (windows, signals) extreme of each signal over each window
    return extreme(signals, width, axis=0)[width // 2 : width // 2 + len(signals) - width + 1]


def operating_point(
    scenario: Scenario, time: float, eta: Array, nu: Array, *, x: Array, u: Array, p: Array
) -> OperatingPoint:
    """Return the steady motion at a time [s] of a run, where the law has x, u and p."""
    heading = float(eta[3])
    moves = ", ".join(f"{name} {value + 0.0:.3g}" for name, value in zip("uvw", np.round(nu[:3], 4), strict=True))
    when = f"at {time:.1f} s of {scenario.name}"
    text = f"the steady motion {when} ({moves} m/s, heading {np.rad2deg(heading):.0f} deg)"
    return OperatingPoint(x, u, p, nu.copy(), heading, text, scenario.disturbance.current_m_per_s)


_REMEDY = "give a scenario with a longer straight part"


_STEP = 1e-6  # of the central differences
_KINK = 0.01  # relative difference of one-sided derivatives that is reported


@dataclass(frozen=True, eq=False)
class LawLoop(SampledLoop):
    """The linear sampled loop of a law about a cruise or a steady motion.

    Attributes:
        law: name of the law.
        cruise: cruise speed U [m/s].
        place: the motion about which the loop is linearised, as text; empty: the straight cruise.
        free: coordinates that change nothing; they are left out.
        kink: difference of the one-sided derivatives of the law there, relative to their size; 0 if it is smooth.
    """

    law: str = ""
    cruise: float = 0.0
    place: str = ""
    free: tuple[str, ...] = ()
    kink: float = 0.0

    @property
    def head(self) -> str:
        """Of what the loop is, as text."""
        return f"sampled loop of law {self.law} {f'about {self.place}' if self.place else f'at {self.cruise:g} m/s'}"

    def notes(self) -> list[str]:
        """Return lines of text about what the loop leaves out, and about derivatives that jump."""
        notes = ["  x is the position along the motion, y the position to its left"] if self.place else []
        notes += [f"  left out, because nothing depends on it: {', '.join(self.free)}"] if self.free else []
        if self.kink > _KINK:
            slopes = f"the derivatives of the law to both sides differ by {self.kink:.0%}"
            notes.append(f"  caution: {slopes} there; the margins are those of their mean")
        return notes

    def to_dict(self) -> dict[str, Any]:
        """Return the stability of the loop as plain data for JSON."""
        about = {"law": self.law, "cruise_m_per_s": self.cruise, "place": self.place or None}
        return {**about, **super().to_dict(), "free": list(self.free), "kink": self.kink}


def law_loop(
    law: Law,
    vehicle: Vehicle,
    gains: Gains,
    *,
    cruise: float,
    model: Vehicle | None = None,
    at: OperatingPoint | None = None,
) -> LawLoop:
    """Return the linear sampled loop of a law about a straight cruise, or about a steady motion.

    Args:
        law: a law for exact obstacle positions, without sonars.
        vehicle: the plant.
        gains: the gains of the law; gains of its own that are missing have their defaults.
        cruise: cruise speed U [m/s], > 0.
        model: the controller's model of the vehicle; default: the vehicle itself.
        at: a steady motion (`steady_motion`), in place of the cruise; it fixes the law's gains and model, and its speed
            replaces `cruise`.

    Raises:
        InputError: the law uses sonars, or the vehicle cannot cruise at that speed.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import law_loop
        >>> loop = law_loop(build_law("paper"), load_vehicle("sur400"), load_gains("default"), cruise=0.15)
        >>> loop.stable, [m.name for m in loop.margins]
        (True, ['surge', 'sway', 'heave', 'yaw', 'x', 'y', 'z', 'psi', 'u', 'v', 'w', 'r'])
    """
    _check_positions(law)
    if at is None and _tracks(law):
        linear = cruise_loop(vehicle, gains.values, cruise=cruise, dt=law.dt, model=model, law=law.ref)
        return LawLoop(linear, label(law.ref), cruise)
    at = cruise_motion(law, vehicle, gains, cruise=cruise, model=model) if at is None else at
    return _loop(law, vehicle, at, _differentiated(law, at))


def _check_positions(law: Law) -> None:
    if "samples" in law.inputs:
        raise InputError("uses sonars", key="law", value=law.name, remedy="build it with sonar=False")


def _tracks(law: Law) -> bool:
    return law_source(law.ref).steering is None and has_cruise_loop(law.ref, law.guidance)


def cruise_motion(
    law: Law, vehicle: Vehicle, gains: Gains, *, cruise: float, model: Vehicle | None = None
) -> OperatingPoint:
    """Return the straight cruise as a motion, for `law_loop` by differences; for the arguments see there."""
    check_cruise(vehicle, cruise)
    p = law_numbers(model or vehicle, gains.with_own(law_source(law.ref).gains), cruise=cruise)
    nu, x = np.array([cruise, 0.0, 0.0, 0.0]), law.initial_state()
    x[law.state.slice("progress")] = FAR  # arc length of the path's middle
    if "surge" in law.state:  # in a cruise, a law that predicts its speed through the water has found it
        x[law.state.slice("surge")] = cruise
    return OperatingPoint(x, law.inputs.pack({"eta": np.zeros(4), "nu": nu}), p, nu, 0.0, "")


Slopes = tuple[tuple[Array, Array, Array, Array], float, float]


def _loop(law: Law, vehicle: Vehicle, at: OperatingPoint, slopes: Slopes) -> LawLoop:
    # without the coordinates on which nothing depends
    matrices, kink, axis = slopes
    along, ahead = _turned(axis).T @ at.current, _turned(at.heading).T @ at.current
    loops, free = assembled(
        plant_parameters(vehicle)[None], at.nu[None], tuple(m[None] for m in matrices), law, form=vehicle.form,
        dt=law.dt, psi=at.heading - axis, current=along,
        delivered=delivered(vehicle, at.nu - np.array([*ahead, 0.0, 0.0])),
    )  # fmt: skip
    return LawLoop(loops[0], label(law.ref), at.speed, at.text, tuple(STATE_NAMES[k] for k in free), kink)


def delivered(vehicle: Vehicle, nu: Array) -> Array:
    """Return the derivative (4, 4) of the force and yaw moment that the thrusters deliver by the command of the law.

    It is the identity, unless a command moves another axis too: a rudder pushes sideways when it turns the craft. `nu`
    is the velocity through the water.
    """
    if vehicle.actuators is None:
        return np.eye(4)
    trim = np.where(vehicle.thrust_limit > 0, trim_thrust(vehicle, nu), 0.0)
    scale = 1e-4 * vehicle.actuators.largest
    steps = [
        allocate(vehicle.actuators, trim + sign * scale * e, speed=float(nu[0])).achieved
        for e in np.eye(4)
        for sign in (1.0, -1.0)
    ]
    J = np.column_stack([(steps[2 * k] - steps[2 * k + 1]) / (2 * scale) for k in range(4)])
    return np.eye(4) if np.abs(J - np.eye(4)).max() < COUPLED**0.5 else J


def _turned(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def _differentiated(law: Law, at: OperatingPoint) -> Slopes:
    """Return A, B, C, D of z⁺ = A z + B y and thrust = C z + D y, the relative difference of one-sided derivatives, and
    the direction of x [rad].

    The thrust is the command of the law before an allocation to thrusters, whose effect `delivered` gives.
    y = (x, y, z, ψ, u, v, w, r), with x along the motion over ground and y to its left; where the law depends on one
    direction alone, such as the distance from a line, that direction is the nearer of both, exactly.
    """
    size, count = law.state.size, law.inputs.size
    turned = np.eye(8)
    turned[:2, :2] = _turned(at.course)
    directions = np.zeros((size + 8, size + count))
    directions[:size, :size] = np.eye(size)
    for k, name in ((0, "eta"), (4, "nu")):
        directions[size:, size:][:, law.inputs.slice(name)] = turned[k : k + 4].T

    def outputs(step: Array) -> Array:
        done = law.step(at.x + step[:size], at.u + step[size:], at.p)
        desired = done.tau if law.actuators is None else done.telemetry[law.telemetry_slice("tau_desired")]
        return np.concatenate([done.x_next, desired])

    here = outputs(np.zeros(size + count))
    ahead = np.array([(outputs(_STEP * direction) - here) / _STEP for direction in directions]).T
    behind = np.array([(here - outputs(-_STEP * direction)) / _STEP for direction in directions]).T
    J = (ahead + behind) / 2
    kink = float(np.abs(ahead[size:] - behind[size:]).max() / max(np.abs(J[size:]).max(), COUPLED))
    inside = in_loop(J[:size, :size], J[:size, size:], J[size:, :size])  # the progress along a path may be outside
    angle = _neutral(J[[*inside, *range(size, len(J))], size : size + 2])
    J[:, size : size + 2] @= _turned(angle)
    return (J[:size, :size], J[:size, size:], J[size:, :size], J[size:, size:]), kink, at.course + angle


def _neutral(slopes: Array) -> float:
    # angle [rad], within a right angle, by which x and y are turned so that the law depends on one of them alone
    _, sizes, directions = np.linalg.svd(slopes, full_matrices=False)
    if not (sizes[0] > COUPLED and sizes[1] <= NEUTRAL * sizes[0]):
        return 0.0
    quarter = 0.5 * np.pi
    return float((np.arctan2(directions[0, 1], directions[0, 0]) + 0.5 * quarter) % quarter - 0.5 * quarter)


def law_corners(
    law: Law,
    vehicle: Vehicle | Corners,
    gains: Gains,
    *,
    cruise: float,
    model: Vehicle | None = None,
    at: OperatingPoint | None = None,
    proved: bool = True,
) -> LoopCorners:
    """Return the loop of a law about a straight cruise for the nominal plant and the worst corner of its parameters.

    With `at`, every loop is linearised about that steady motion. Corners whose thrust cannot hold the speed are left
    out.

    Args:
        law, gains, cruise, model, at: as for `law_loop`.
        vehicle: the vehicles, the nominal one first; of one vehicle, the corners that `corners` returns.
        proved: whether the disk margin is proved between frequencies, in ten times the time.

    Raises:
        InputError: as for `law_loop`, of the nominal vehicle.

    Example:
        >>> from surctl.marine.control import build_law
        >>> from surctl.marine.tuning import derived_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import law_corners
        >>> boat = load_vehicle("otter")
        >>> result = law_corners(build_law("steered"), boat, derived_gains(boat, cruise=0.77), cruise=0.77)
        >>> result.stable, round(result.nominal.disk, 2), result.corner
        (True, 0.66, 'mass +5%, drag -20%')
    """
    tried = vehicle if isinstance(vehicle, Corners) else corners(vehicle)
    craft, plants = tried.vehicles[0], tried.others.values()
    if at is None and _tracks(law):
        nominal = law_loop(law, craft, gains, cruise=cruise, model=model)
        points = [CruisePoint(plant, model or craft, gains.values, cruise) for plant in plants]
        loops = each_loop(points, dt=law.dt, law=law.ref)
    else:
        _check_positions(law)
        motion = cruise_motion(law, craft, gains, cruise=cruise, model=model) if at is None else at
        slopes = _differentiated(law, motion)  # the law's model is the same at each

        def loop(plant: Vehicle) -> LinearLoop | None:
            try:
                if at is None:
                    check_cruise(plant, cruise)
                return _loop(law, plant, motion, slopes).linear
            except InputError:  # the thrust cannot hold the speed
                return None

        nominal, loops = _loop(law, craft, motion, slopes), list(map(loop, plants))
    named = list(zip(tried.others, loops, strict=True))
    return corners_of(nominal, named, name=NOMINAL, of=tried.held(named, cruise), proved=proved)

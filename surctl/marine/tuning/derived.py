"""Gains derived from a vehicle (formulae, then a search for the margins), the bearable speed, and default gains.

The formulae give the bandwidths of the inner loops from the delay of the thrust, and everything else from the inner
loops, the thrust, the hull and the cruise speed. Each formula is a line of `rule`. A search changes k_v, k_r and k_psi
until the nominal loop has a margin at thrust commands and measured pose together, and then, if needed, until disk and
delay margin at the worst corners of the vehicle's ranges are at least `LEAST_DISK_MARGIN` and `LEAST_DELAY_MARGIN`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir.cache import stored_numbers
from surctl.marine.control import GAINS, Gains, GainSpec, build_law, default_law, law_source, load_gains
from surctl.marine.simulation import vehicle_law
from surctl.marine.vehicle import LIBRARY, Vehicle, load_vehicle, steady_speed
from surctl.marine.vehicle.linearise import check_cruise
from surctl.marine.verification import law_corners
from surctl.marine.verification.corners import corners
from surctl.marine.verification.cruise_loop import POSE, THRUSTS, CruisePoint, cruise_groups
from surctl.verification.linear import LEAST_DISK_MARGIN, screened_peaks
from surctl.verification.loops import LEAST_DELAY_MARGIN
from surctl.verification.sampled_margins import delays_at, open_loop

Array = NDArray[np.float64]

DEPENDENT = ("k_v", "k_r", "k_psi", "k1", "k2", "lookahead", "wait", "margin", "reaction", "brake", "kappa", "spin")
"""The gains that `rule` computes from the vehicle; the first three can be changed by a search."""

_PHASE = 0.55  # k τ of a velocity loop k / (s (1 + T s)) e^(−1.5 h s): phase margin near 60 deg, disk margin near 0.75
_FASTEST = 5.0  # [1/s] a faster loop only amplifies the noise of the measured velocity
_FULL_THRUST = 0.15  # share of U: velocity error at which a velocity loop may reach full thrust
_OUTER = 5.0  # ratio of inner and outer bandwidths: the outer loop costs the inner loop about 11 deg of phase
_HEADING = 2.5  # the same for yaw and heading
_ABOVE_MUNK = 2.0  # ratio of k_r k_psi and the square of the Munk rate
_BRAKE = 0.7  # share of the thrust for braking; the rest is for Coriolis forces and errors of the model
_HULLS = 4.0  # look-ahead in hull radii
_GAP, _LEAST_GAP = 0.2, 0.05  # stand-off in hull radii, and the least [m]: errors of position and ranges
_PATIENCE, _LENGTHS = 60.0, 40.0  # [s], and hull radii of cruise without progress


def munk_rate(vehicle: Vehicle, cruise: float) -> float:
    """Return p = U √((m22 − m11)/m44) [1/s], at which the Munk moment turns an uncontrolled hull; 0 if m22 ≤ m11.

    A hull that moves along the path with heading error ψ has the sway velocity v = −U ψ, and the moment
    (m11 − m22) u v = (m22 − m11) U² ψ increases ψ.
    """
    return cruise * float(np.sqrt(max(vehicle["m22"] - vehicle["m11"], 0.0) / vehicle["m44"]))


def top_speed(vehicle: Vehicle) -> float:
    """Return the speed [m/s] at full surge thrust, at most 10 m/s."""
    return min(steady_speed(vehicle["Fu_max"], vehicle["Xu"], vehicle["Xuu"]), 10.0)


def held_speed(vehicle: Vehicle) -> float:
    """Return the largest speed [m/s] that a law holds, whose thrust ahead is limited to that astern; at most 10 m/s."""
    return min(steady_speed(float(vehicle.thrust_limit[0]), vehicle["Xu"], vehicle["Xuu"]), 10.0)


def inner_start(vehicle: Vehicle, *, cruise: float, dt: float) -> Array:
    """Return k_v, k_r and k_psi (3,) [1/s] of the formulae.

    - k_v = 0.55/τ leaves a phase margin of about 60° after lag, computation and sampling; and a velocity error of 15 %
      of U must not yet command full thrust.
    - k_r = 0.55/τ likewise; k_psi = k_r/2.5, but a heading error of 1 rad must not need more than the full yaw moment,
      k_psi ≤ √(Fr_max/m44).
    - Munk moment: yaw and heading together have the stiffness k_r k_psi, which must exceed p² (`munk_rate`) twice: both
      are raised in proportion until it does.
    """
    lag = vehicle["thrust_lag"] + 1.5 * dt
    fastest = min(_PHASE / lag, _FASTEST)
    k_v = min(fastest, _acceleration(vehicle) / (_FULL_THRUST * cruise))
    k_r = fastest
    k_psi = min(k_r / _HEADING, float(np.sqrt(vehicle["Fr_max"] / vehicle["m44"])))
    raised = max(1.0, float(np.sqrt(_ABOVE_MUNK * munk_rate(vehicle, cruise) ** 2 / (k_r * k_psi))))
    return np.array([k_v, raised * k_r, raised * k_psi])


def rule(vehicle: Vehicle, inner: Array, *, cruise: float, dt: float) -> dict[str, float]:
    """Return every gain by name, from k_v, k_r and k_psi (3,) and the vehicle.

    - k1, k2 = k_v/5 (separation of the loops), at most a/U: from the distance U/k1, at which the commanded speed is U,
      full thrust can stop the vehicle. Without heave thrust, k2 has no effect.
    - lookahead = 4 R at least (two hull lengths), 5 U/k_v at least (U/lookahead is the bandwidth of the cross-track
      loop), U²/a at least (distance in which full thrust turns the velocity into a new leg). wait = lookahead.
    - margin = 0.2 R, at least 0.05 m; reaction = τ + 0.2/k_v (lag, sampling, and the part of the velocity loop's
      response that passes before it brakes); brake = 0.7 of the thrust. The law itself divides by the larger mass.
    - kappa = k1: the avoidance is as fast as the tracking. spin ≤ half the yaw rate of full moment, 0.45 rad/s.
    - patience = 60 s, at least 40 R/U; ilos_sigma = U/4; alos_gamma = 1/(4 lookahead²): the estimates of the current
      are slower than the cross-track loop.
    - k_i = 0: guidance integrates the velocity. The gains of sensors do not depend on the vehicle.
    """
    k_v, k_r, k_psi = (float(value) for value in inner)
    horizontal, vertical = _acceleration(vehicle), vehicle["Fw_max"] / vehicle["m33"]
    radius, lag = vehicle["radius"], vehicle["thrust_lag"] + 1.5 * dt
    k1 = min(k_v / _OUTER, horizontal / cruise)
    lookahead = max(_HULLS * radius, _OUTER * cruise / k_v, cruise**2 / horizontal)
    return {
        "k1": k1,
        "k2": min(k_v / _OUTER, vertical / cruise) if vertical > 0 else k_v / _OUTER,
        "lookahead": lookahead,
        "ilos_sigma": cruise / 4,
        "alos_gamma": 0.25 / lookahead**2,
        "wait": lookahead,
        "patience": max(_PATIENCE, _LENGTHS * radius / cruise),
        "k_psi": k_psi,
        "spin": min(0.45, vehicle.steady_yaw(1.0, cruise) / 2),
        "k_v": k_v,
        "k_r": k_r,
        "k_i": 0.0,
        "margin": max(_GAP * radius, _LEAST_GAP),
        "reaction": lag + 0.2 / k_v,
        "brake": _BRAKE,
        "kappa": k1,
        "k3": 1.0,
        "delta": 0.0,
        "lambda1": 3.0,
        "lms_step": 0.5,
        "beta_max": 0.2,
    }


def _acceleration(vehicle: Vehicle) -> float:
    # [m/s²] full thrust of the weaker horizontal axis that has thrust, by the larger mass; as in the law's braking
    forces = [force for force in (vehicle["Fu_max"], vehicle["Fv_max"]) if force > 0]
    return min(forces) / max(vehicle["m11"], vehicle["m22"])


_TARGET = 0.42  # nominal margin at commands and measurements together at which the first search stops
_ABOVE = 1.15  # searches stop at this multiple of a least margin: grids miss it by 10 %, and corners have less
_CORNERS = 3  # most corners that the second search adds, the worst one each time
_FACTORS = (1.6, 1.25, 1.1)  # of the three gains in the neighbourhoods of the search
_NEIGHBOURS = np.array(  # exponents of the factor for k_v, k_r, k_psi
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 1], [0, 1, -1], [1, 1, 1]]
)
_NEIGHBOURS = np.vstack([_NEIGHBOURS, -_NEIGHBOURS]).astype(float)
_LEAST, _MOST = np.array([0.7, 0.5, 0.5]), np.array([2.0, 4.0, 4.0])  # bounds of the search, as shares of the formulae
_ROUNDS = 4  # largest number of neighbourhoods for each factor
_SLOW = 0.25  # share of the cruise speed at which the margin is checked too
_UNSTABLE = 1e-3  # margin of an unstable loop in the search


def searched_inner(vehicle: Vehicle, cruise: float, dt: float, near: Array | None = None) -> tuple[Array, float]:
    """Return the inner gains (3,) of the formulae, or better ones, and the least share of a required margin they have.

    The share is that at the worst corners. The first search raises the nominal margins. If the share is below 1 then, a
    second one raises it. `near` is the result at a similar speed.
    """
    start = inner_start(vehicle, cruise=cruise, dt=dt)
    best, factors = (start, _FACTORS) if near is None else (near, _FACTORS[1:])

    def nominal(inner: Array, above: float) -> Array:
        return _margins(vehicle, inner, cruise, dt, above=above)

    best = _climbed(nominal, start, best, factors)
    share, plant = _corner_share(vehicle, best, cruise, dt)
    plants = [vehicle]
    for _ in range(_CORNERS):
        if share >= 1.0 or plant in plants:
            break
        plants.append(plant)

        def uncertain(inner: Array, _: float, plants: Sequence[Vehicle] = tuple(plants)) -> Array:
            each = [_estimates(vehicle, inner, cruise, dt, speed=cruise, plant=one) for one in plants]
            return np.asarray(np.min(each, axis=0))

        tried = _climbed(uncertain, start, best, _FACTORS)
        reached, plant = _corner_share(vehicle, tried, cruise, dt)
        if reached > share:
            best, share = tried, reached
    return best, share


def _climbed(value: Callable[[Array, float], Array], start: Array, best: Array, factors: Sequence[float]) -> Array:
    """Return inner gains (3,) with a larger value, searched from `best`.

    The search goes to the best neighbour until the value 1 is reached or none is better; then the steps become smaller.
    The gains stay within `_LEAST` and `_MOST` times those of the formulae, `start`.
    """
    reached = float(value(best[None], 0.0)[0])
    for factor in factors:
        for _ in range(_ROUNDS):
            if reached >= 1.0:
                return best
            around = np.clip(best * factor**_NEIGHBOURS, start * _LEAST, start * _MOST)
            values = value(around, reached)
            at = int(np.argmax(values))
            if values[at] <= reached:
                break
            best, reached = around[at], float(values[at])
    return best


def _corner_share(vehicle: Vehicle, inner: Array, cruise: float, dt: float) -> tuple[float, Vehicle]:
    tried, gains = corners(vehicle), _named(vehicle, inner, cruise, dt)
    least = law_corners(build_law(dt=dt), tried, gains, cruise=cruise, proved=False)
    return min(least.shares), tried.vehicle(least.weakest)


def _margins(vehicle: Vehicle, inner: Array, cruise: float, dt: float, *, above: float) -> Array:
    """Return estimates (n,) of the nominal margins of gain sets (n, 3), as shares of those at which a search stops.

    The share is the least of two speeds; the second speed is evaluated only where the first share is larger than
    `above`. An unstable loop gets a number below 0.001 that is the larger, the slower its pole grows.
    """
    worst = _estimates(vehicle, inner, cruise, dt, speed=cruise)
    better = np.flatnonzero(worst > max(above, _UNSTABLE))
    if better.size:
        worst[better] = np.minimum(worst[better], _estimates(vehicle, inner[better], cruise, dt, speed=_SLOW * cruise))
    return worst


def _estimates(
    vehicle: Vehicle, inner: Array, cruise: float, dt: float, *, speed: float, plant: Vehicle | None = None
) -> Array:
    # disk margin of the vehicle at both places together; of a plant, the lesser of both places
    points = [CruisePoint(plant or vehicle, vehicle, rule(vehicle, one, cruise=cruise, dt=dt), speed) for one in inner]
    ((_, loops),) = cruise_groups(points, dt=dt)
    thrusts, pose = ([name for name in names if name in loops.channels()] for names in (THRUSTS, POSE))
    places = ([*thrusts, *pose],) if plant is None else (thrusts, pose)
    peaks = np.max([screened_peaks(open_loop(loops, *signals)) for signals in places], axis=0)
    growth, stable = np.maximum(loops.slowest_per_s, 0.0), np.isfinite(peaks)
    least = _TARGET if plant is None else _ABOVE * LEAST_DISK_MARGIN
    shares = np.where(stable, 1 / peaks / least, _UNSTABLE / (1 + growth))
    if stable.any():
        late = delays_at(loops[stable], [*thrusts, *pose]).min(axis=0) / (_ABOVE * LEAST_DELAY_MARGIN)
        shares[stable] = np.minimum(shares[stable], np.maximum(late, _UNSTABLE))
    return shares


TUNED_FOR = ("sur400", "sur400-tilting", "sur540-flooded", "sur540-light", "sur540-tilting")
"""The built-in vehicles for which the gain set `default` was chosen."""

_DT = 0.05  # [s] control period of the built-in laws
_CRUISE_SHARE = 0.35  # cruise speed as a share of the top speed, if no mission states one
_HELD = 0.9  # largest share of the top speed for which gains are derived
_MUNK_DELAY = 0.34  # product of Munk rate and delay at which the margin is about reached
_BRACKET, _BEARABLE_STEPS = 1.2, 6
_LOWERED = 10  # largest number of times that the result is lowered by 2 %
# ratio and number of the speeds tried for a craft without sway force, and bisections that follow (0.5 %)
_SLOWER, _SLOWER_SPEEDS, _SLOWER_STEPS = 0.85, 15, 5  # down to a tenth


REQUIRED = f"a disk margin of {LEAST_DISK_MARGIN:g} and a delay margin of {LEAST_DELAY_MARGIN:g} s"
"""The required margins, as text."""


@dataclass(frozen=True)
class Derivation:
    """Gains derived from a vehicle, with the margin that they reach.

    Attributes:
        gains: the gain set; its provenance states vehicle, speed and margin.
        vehicle: name of the vehicle.
        cruise: cruise speed [m/s] for which the gains were derived.
        dt: control period [s].
        disk_margin: disk margin at the cruise speed and the worst corner of the vehicle's ranges; 0 if unstable.
        delay_margin_s: least delay margin [s] of one loop alone, likewise.
        bearable: largest speed [m/s] found, at most `cruise`, with both least margins; 0 if none.
        searched: whether the formulae alone did not suffice and the search changed the gains.
        munk: growth rate [1/s] of the turn that the Munk moment causes without control; 0 if m22 ≤ m11.
    """

    gains: Gains
    vehicle: str
    cruise: float
    dt: float
    disk_margin: float
    delay_margin_s: float
    bearable: float
    searched: bool
    munk: float

    @property
    def reached(self) -> bool:
        """Whether the gains have the required disk margin and delay margin at the cruise speed."""
        return _enough(self.disk_margin, self.delay_margin_s)

    def lines(self) -> list[str]:
        """Return one line about the gains; if the margin is missed, a second line with the bearable speed."""
        head = f"gains {self.gains.provenance}"
        if self.reached:
            return [head]
        where = f"up to at least {self.bearable:.3g} m/s" if self.bearable > 0 else "at no speed"
        return [head, f"  warning: derived gains reach {REQUIRED} {where}; for {self.cruise:.3g} m/s, {self.remedy}"]

    @property
    def warning(self) -> str:
        """Return the warning of `lines` without its indent; empty if the margin is reached."""
        return "" if self.reached else self.lines()[1].strip()

    def shown(self) -> list[tuple[str, float]]:
        """Return names and values of the gains that depend on the vehicle."""
        return [(name, self.gains[name]) for name in DEPENDENT]

    @property
    def remedy(self) -> str:
        """Return which numbers of the vehicle limit the margin, as a text that says what to change."""
        faster = f"shorten the thrust lag or the control period of {self.dt:g} s"
        if self.munk <= 0:
            return faster
        return f"{faster}, raise m44, or bring m22 nearer to m11 (Munk moment: {self.munk:.2g} 1/s)"

    def to_dict(self) -> dict[str, Any]:
        """Return the derivation as plain data for JSON."""
        return {
            "vehicle": self.vehicle,
            "cruise_m_per_s": self.cruise,
            "disk_margin": self.disk_margin,
            "required": LEAST_DISK_MARGIN,
            "delay_margin_s": self.delay_margin_s,
            "required_delay_s": LEAST_DELAY_MARGIN,
            "reached": self.reached,
            "bearable_m_per_s": self.bearable,
            "searched": self.searched,
            "munk_per_s": self.munk,
            "gains": dict(self.gains.values),
        }


def default_cruise(vehicle: Vehicle) -> float:
    """Return the cruise speed [m/s] where no mission states one: 35 % of the speed at full surge thrust.

    Example:
        >>> from surctl.marine.tuning import default_cruise
        >>> from surctl.marine.vehicle import load_vehicle
        >>> [round(default_cruise(load_vehicle(name)), 2) for name in ("bluerov2-wu", "bluerov2-vonbenzon")]
        [0.48, 0.17]
    """
    return float(f"{min(_CRUISE_SHARE * top_speed(vehicle), _HELD * held_speed(vehicle)):.2g}")


def derived_gains(vehicle: Vehicle, *, cruise: float) -> Gains:
    """Return the gains that follow from a vehicle at a cruise speed [m/s]; see `derive_gains`.

    Example:
        >>> from surctl.marine.tuning import derived_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> gains = derived_gains(load_vehicle("bluerov2-vonbenzon"), cruise=0.17)
        >>> gains.name, gains.provenance
        ('derived', 'derived from the vehicle bluerov2-vonbenzon at 0.17 m/s, disk margin ...')
    """
    return derive_gains(vehicle, cruise=cruise).gains


def derive_gains(vehicle: Vehicle, *, cruise: float, dt: float = _DT) -> Derivation:
    """Derive gains from mass, drag, thrust, lag and hull of a vehicle, control period and cruise speed.

    The formulae are those of `rule`. If they miss the margins (see the module), a search over k_v, k_r and
    k_psi in fixed steps follows; the result depends on nothing but the arguments. If no gains have the margin, the
    result has the gains with the largest margin, and the largest speed at which the margin is reached.

    Args:
        vehicle: the vehicle, used both as plant and as the controller's model.
        cruise: cruise speed U [m/s].
        dt: control period [s].

    Raises:
        InputError: the thrust cannot hold the cruise speed, or an argument is not greater than 0.

    Example:
        >>> from surctl.marine.tuning import derive_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> fast = derive_gains(load_vehicle("bluerov2-wu"), cruise=0.47)
        >>> fast.reached, 0.3 < fast.bearable < 0.4
        (False, True)
    """
    for key, value in (("cruise", cruise), ("dt", dt)):
        if not (np.isfinite(value) and value > 0):
            raise InputError("must be greater than 0", key=key, value=value, remedy="correct it")
    check_cruise(vehicle, cruise)
    case = vehicle.name, vehicle.digest(), float(cruise), float(dt)
    if case not in _known:
        numbers: Any = stored_numbers(["surctl"], case, lambda: asdict(_derivation(vehicle, *case[2:])))
        _known[case] = Derivation(**(numbers | {"gains": Gains(**numbers["gains"])}))
    return _known[case]


def has_tuned(vehicle: Vehicle) -> bool:
    """Return whether the gain set `default` was chosen for a vehicle with these parameters."""
    return vehicle.digest() in _tuned_digests()


def gains_for(
    word: str | None, vehicle: Vehicle, *, cruise: float, own: Mapping[str, GainSpec] | None = None
) -> tuple[Gains, Derivation | None]:
    """Return the gains of a command: the named set, else `default` for the vehicles it was chosen for, else derived.

    A vehicle that cannot hold the cruise speed gets the gains of 90 % of the largest speed that it holds.

    Args:
        word: name or file of the gain set, or None if none is named.
        vehicle: the vehicle.
        cruise: cruise speed [m/s].
        own: gains of a law of the user's own, as in `load_gains`.

    Example:
        >>> from surctl.marine.tuning import gains_for
        >>> from surctl.marine.vehicle import load_vehicle
        >>> gains_for(None, load_vehicle("sur400"), cruise=0.15)[0].name
        'default'
        >>> gains_for(None, load_vehicle("bluerov2-vonbenzon"), cruise=0.15)[0].name
        'derived'
    """
    if word is not None or has_tuned(vehicle):
        return load_gains(word or "default", own=own), None
    try:
        derivation = derive_gains(vehicle, cruise=cruise)
    except InputError as error:
        if error.key != "cruise" or not cruise > 0:
            raise
        slower = derive_gains(vehicle, cruise=min(cruise, _HELD * held_speed(vehicle)))
        provenance = f"{slower.gains.provenance}; the thrust cannot hold {cruise:g} m/s"
        derivation = replace(slower, gains=replace(slower.gains, provenance=provenance))
    return (derivation.gains.with_own(own) if own else derivation.gains), derivation


def shared_gains(
    word: str | None, pairs: Sequence[tuple[Vehicle, float]], *, own: Mapping[str, GainSpec] | None = None
) -> tuple[Gains, Derivation | None]:
    """Return one gain set for several vehicles, each with its cruise speed [m/s]; see `gains_for`.

    If none is named, gains are derived at the largest speed if all vehicles are the same; different vehicles share the
    set `default`.
    """
    vehicle = pairs[0][0]
    if word is None and any(one.digest() != vehicle.digest() for one, _ in pairs):
        return load_gains("default", own=own), None
    return gains_for(word, vehicle, cruise=max(cruise for _, cruise in pairs), own=own)


@lru_cache(maxsize=1)
def _tuned_digests() -> frozenset[str]:
    return frozenset(load_vehicle(str(LIBRARY / f"{name}.toml")).digest() for name in TUNED_FOR)


_known: dict[tuple[str, str, float, float], Derivation] = {}  # of this process


def _derivation(vehicle: Vehicle, cruise: float, dt: float) -> Derivation:
    vehicle = vehicle.at_speed(cruise)
    if vehicle["Fv_max"] == 0:
        return _steered(vehicle, cruise, dt)
    inner, _ = searched_inner(vehicle, cruise, dt)
    searched = bool(np.any(inner != inner_start(vehicle, cruise=cruise, dt=dt)))
    least = law_corners(build_law(dt=dt), vehicle, _named(vehicle, inner, cruise, dt), cruise=cruise)
    margins = float(np.nan_to_num(least.disk)), least.delay.delay_s
    bearable = cruise if least.enough else _bearable(vehicle, cruise, dt, inner)
    gains = _named(vehicle, inner, cruise, dt, margins)
    return Derivation(gains, vehicle.name, cruise, dt, *margins, bearable, searched, munk_rate(vehicle, cruise))


def _enough(disk: float, delay: float) -> bool:
    return disk >= LEAST_DISK_MARGIN and delay >= LEAST_DELAY_MARGIN


def _named(
    vehicle: Vehicle, inner: Array, cruise: float, dt: float, margins: tuple[float, float] = (np.nan, np.nan)
) -> Gains:
    values, (disk, delay) = rule(vehicle, inner, cruise=cruise, dt=dt), margins
    reached = f"disk margin {disk:.2f}" if disk > 0 else "UNSTABLE"
    reached += "" if disk >= LEAST_DISK_MARGIN else f" (below {LEAST_DISK_MARGIN:g})"
    if 0 < delay < LEAST_DELAY_MARGIN:
        reached += f", delay margin {delay:.2f} s (below {LEAST_DELAY_MARGIN:g} s)"
    provenance = f"derived from the vehicle {vehicle.name} at {cruise:.3g} m/s, {reached}"
    return Gains("derived", {name: values[name] for name in GAINS}, provenance)


def _steered(vehicle: Vehicle, cruise: float, dt: float) -> Derivation:
    """Return the derivation for a craft without sway force: the formulae, checked by the sampled loop of its law."""

    def margins(speed: float) -> tuple[float, float]:
        law = default_law(vehicle)
        gains = _named(vehicle, inner_start(vehicle.at_speed(speed), cruise=speed, dt=dt), speed, dt)
        own = gains.with_own(law_source(law).gains)
        loops = law_corners(vehicle_law(vehicle, law, dt=dt), vehicle, own, cruise=speed)
        return float(np.nan_to_num(loops.disk)), loops.delay.delay_s

    reached, bearable = margins(cruise), cruise
    if not _enough(*reached):
        slower = [float(f"{cruise * _SLOWER**k:.3g}") for k in range(1, _SLOWER_SPEEDS)]
        bearable = next((speed for speed in slower if _enough(*margins(speed))), 0.0)
        high = min(bearable / _SLOWER, cruise)
        for _ in range(_SLOWER_STEPS if bearable > 0 else 0):
            at = float(f"{(bearable + high) / 2:.3g}")
            bearable, high = (at, high) if _enough(*margins(at)) else (bearable, at)
    gains = _named(vehicle, inner_start(vehicle, cruise=cruise, dt=dt), cruise, dt, reached)
    return Derivation(gains, vehicle.name, cruise, dt, *reached, bearable, False, munk_rate(vehicle, cruise))


def _bearable(vehicle: Vehicle, cruise: float, dt: float, inner: Array) -> float:
    """Return the largest speed [m/s] below `cruise` at which derived gains have the margin; 0 if there is none.

    The first speed tried makes the Munk moment as fast as the delay of the loop allows by experience; steps of 20 %
    lead to a bracket, and bisection refines it.
    """
    low, high = 0.0, cruise
    delay = vehicle["thrust_lag"] + 1.5 * dt
    speed = min(_MUNK_DELAY * cruise / max(munk_rate(vehicle, cruise) * delay, 1e-9), cruise / _BRACKET)
    for _ in range(_BEARABLE_STEPS):
        inner, share = searched_inner(vehicle, speed, dt, inner if high < cruise else None)
        low, high = (speed, high) if share >= 1.0 else (low, speed)
        if low == 0.0:
            speed = high / _BRACKET
        elif high > _BRACKET * low:
            speed = min(low * _BRACKET, (low + high) / 2)
        else:
            speed = (low + high) / 2
    speed = float(np.floor(low * 1000) / 1000)
    for _ in range(_LOWERED):  # without a similar speed to start from, the search may end elsewhere
        if speed <= 0 or searched_inner(vehicle, speed, dt)[1] >= 1.0:
            return speed
        speed = float(np.floor(speed * 980) / 1000)
    return 0.0

"""Gains that follow from a vehicle: explicit formulae, a check by the margins of the loop, and a small search.

The formulae give the bandwidths of the inner loops from the delay of the thrust, and everything else from the inner
loops, the thrust, the hull and the cruise speed. Each formula is a line of `rule`. A search changes k_v, k_r and k_psi
until the nominal loop has a margin at thrust commands and measured pose together, and then, if needed, until the disk
margin at the worst corner of the vehicle's ranges is at least `LEAST_DISK_MARGIN`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir.cache import stored_numbers
from surctl.marine.control import GAINS, Gains, GainSpec, build_law, default_law, law_source, load_gains
from surctl.marine.tuning.hashed import HashedVehicle
from surctl.marine.tuning.inner_search import searched_inner
from surctl.marine.tuning.vehicle_rule import DEPENDENT, held_speed, inner_start, munk_rate, rule, top_speed
from surctl.marine.vehicle import LIBRARY, Vehicle, load_vehicle
from surctl.marine.vehicle.linearise import check_cruise
from surctl.marine.verification import law_corners
from surctl.marine.verification.linear import corner_margin
from surctl.verification.linear import LEAST_DISK_MARGIN

__all__ = [
    "Derivation",
    "default_cruise",
    "derive_gains",
    "derived_gains",
    "gains_for",
    "has_tuned",
    "shared_gains",
]

TUNED_FOR = ("sur400", "sur400-tilting", "sur540-flooded", "sur540-light", "sur540-tilting")
"""The built-in vehicles for which the gain set `default` was chosen."""

_DT = 0.05  # [s] control period of the built-in laws
_CRUISE_SHARE = 0.35  # cruise speed as a share of the top speed, if no mission states one
_HELD = 0.9  # largest share of the top speed for which gains are derived
_MUNK_DELAY = 0.34  # product of Munk rate and delay at which the margin is about reached
_BRACKET, _BEARABLE_STEPS = 1.2, 6
_LOWERED = 10  # largest number of times that the result is lowered by 2 %
# ratio and number of the speeds tried for a craft without sway force, and bisections that follow (0.5 %)
_SLOWER, _SLOWER_SPEEDS, _SLOWER_STEPS = 0.85, 9, 5

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Derivation:
    """Gains derived from a vehicle, with the margin that they reach.

    Attributes:
        gains: the gain set; its provenance states vehicle, speed and margin.
        vehicle: name of the vehicle.
        cruise: cruise speed [m/s] for which the gains were derived.
        dt: control period [s].
        disk_margin: disk margin at the cruise speed and the worst corner of the vehicle's ranges; 0 if unstable.
        bearable: largest speed [m/s] found, at most `cruise`, with the least disk margin; 0 if none.
        searched: whether the formulae alone did not suffice and the search changed the gains.
        munk: growth rate [1/s] of the turn that the Munk moment causes without control; 0 if m22 ≤ m11.
    """

    gains: Gains
    vehicle: str
    cruise: float
    dt: float
    disk_margin: float
    bearable: float
    searched: bool
    munk: float

    @property
    def reached(self) -> bool:
        """Whether the gains have the required disk margin at the cruise speed."""
        return self.disk_margin >= LEAST_DISK_MARGIN

    def lines(self) -> list[str]:
        """Return one line about the gains; if the margin is missed, a second line with the bearable speed."""
        head = f"gains {self.gains.provenance}"
        if self.reached:
            return [head]
        where = f"up to at least {self.bearable:.3g} m/s" if self.bearable > 0 else "at no speed"
        return [
            head,
            f"  warning: derived gains reach {LEAST_DISK_MARGIN:g} {where}; for {self.cruise:.3g} m/s, {self.remedy}",
        ]

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


def derived_gains(vehicle: Vehicle, *, cruise: float, dt: float = _DT) -> Gains:
    """Return the gains that follow from a vehicle at a cruise speed [m/s]; see `derive_gains`.

    Example:
        >>> from surctl.marine.tuning import derived_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> gains = derived_gains(load_vehicle("bluerov2-vonbenzon"), cruise=0.17)
        >>> gains.name, gains.provenance
        ('derived', 'derived from the vehicle bluerov2-vonbenzon at 0.17 m/s, disk margin ...')
    """
    return derive_gains(vehicle, cruise=cruise, dt=dt).gains


def derive_gains(vehicle: Vehicle, *, cruise: float, dt: float = _DT) -> Derivation:
    """Derive gains from mass, drag, thrust, lag and hull of a vehicle, control period and cruise speed.

    The formulae are those of `vehicle_rule.rule`. If they miss the margins (see the module), a search over k_v, k_r and
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
        >>> fast.reached, 0.3 < fast.bearable < 0.36
        (False, True)
    """
    for key, value in (("cruise", cruise), ("dt", dt)):
        if not (np.isfinite(value) and value > 0):
            raise InputError("must be greater than 0", key=key, value=value, remedy="correct it")
    check_cruise(vehicle, cruise)
    return _derive(HashedVehicle(vehicle), float(cruise), float(dt))


def has_tuned(vehicle: Vehicle) -> bool:
    """Return whether the gain set `default` was chosen for a vehicle with these parameters.

    Example:
        >>> from surctl.marine.tuning import has_tuned
        >>> from surctl.marine.vehicle import load_vehicle
        >>> [has_tuned(load_vehicle(name)) for name in ("sur400", "bluerov2-wu")]
        [True, False]
    """
    return vehicle.digest() in _tuned_digests()


def gains_for(
    word: str | None, vehicle: Vehicle, *, cruise: float, own: Mapping[str, GainSpec] | None = None, dt: float = _DT
) -> tuple[Gains, Derivation | None]:
    """Return the gains of a command: the named set, else `default` for the vehicles it was chosen for, else derived.

    A vehicle that cannot hold the cruise speed gets the gains of 90 % of the largest speed that it holds.

    Args:
        word: name or file of the gain set, or None if none is named.
        vehicle: the vehicle.
        cruise: cruise speed [m/s].
        own: gains of a law of the user's own, as in `load_gains`.
        dt: control period [s].

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
        derivation = derive_gains(vehicle, cruise=cruise, dt=dt)
    except InputError as error:
        if error.key != "cruise" or not cruise > 0:
            raise
        slower = derive_gains(vehicle, cruise=min(cruise, _HELD * held_speed(vehicle)), dt=dt)
        provenance = f"{slower.gains.provenance}; the thrust cannot hold {cruise:g} m/s"
        derivation = replace(slower, gains=replace(slower.gains, provenance=provenance))
    return (derivation.gains.with_own(own) if own else derivation.gains), derivation


def shared_gains(
    word: str | None, pairs: Sequence[tuple[Vehicle, float]], *, own: Mapping[str, GainSpec] | None = None
) -> tuple[Gains, Derivation | None]:
    """Return one gain set for several vehicles, each with its cruise speed [m/s]; see `gains_for`.

    If none is named, gains are derived at the largest speed if all vehicles are the same; different vehicles share the
    set `default`.

    Example:
        >>> from surctl.marine.tuning import shared_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> boat = load_vehicle("bluerov2-vonbenzon")
        >>> shared_gains(None, [(boat, 0.15), (boat, 0.1)])[1].cruise
        0.15
        >>> shared_gains(None, [(boat, 0.15), (load_vehicle("sur400"), 0.15)])[0].name
        'default'
    """
    vehicle = pairs[0][0]
    if word is None and any(one.digest() != vehicle.digest() for one, _ in pairs):
        return load_gains("default", own=own), None
    return gains_for(word, vehicle, cruise=max(cruise for _, cruise in pairs), own=own)


@lru_cache(maxsize=1)
def _tuned_digests() -> frozenset[str]:
    return frozenset(load_vehicle(str(LIBRARY / f"{name}.toml")).digest() for name in TUNED_FOR)


@lru_cache(maxsize=64)
def _derive(hashed: HashedVehicle, cruise: float, dt: float) -> Derivation:
    key = (*hashed.key, cruise, dt)
    numbers: Any = stored_numbers(["surctl"], key, lambda: asdict(_derivation(hashed, cruise, dt)))
    return Derivation(**(numbers | {"gains": Gains(**numbers["gains"])}))


def _derivation(hashed: HashedVehicle, cruise: float, dt: float) -> Derivation:
    if (vehicle := hashed.vehicle.at_speed(cruise))["Fv_max"] == 0:
        return _steered(vehicle, cruise, dt)
    inner, _ = searched_inner(vehicle, cruise, dt)
    searched = bool(np.any(inner != inner_start(vehicle, cruise=cruise, dt=dt)))
    values = rule(vehicle, inner, cruise=cruise, dt=dt)
    margin = float(np.nan_to_num(corner_margin(vehicle, values, cruise=cruise, dt=dt, proved=True).margin))
    bearable = _bearable(vehicle, cruise, dt, inner) if margin < LEAST_DISK_MARGIN else cruise
    gains = _named(vehicle, inner, cruise, dt, margin)
    return Derivation(gains, vehicle.name, cruise, dt, margin, bearable, searched, munk_rate(vehicle, cruise))


def _named(vehicle: Vehicle, inner: Array, cruise: float, dt: float, margin: float) -> Gains:
    values = rule(vehicle, inner, cruise=cruise, dt=dt)
    reached = f"disk margin {margin:.2f}" if margin > 0 else "UNSTABLE"
    reached += "" if margin >= LEAST_DISK_MARGIN else f", below {LEAST_DISK_MARGIN:g}"
    provenance = f"derived from the vehicle {vehicle.name} at {cruise:.3g} m/s, {reached}"
    return Gains("derived", {name: values[name] for name in GAINS}, provenance)


def _steered(vehicle: Vehicle, cruise: float, dt: float) -> Derivation:
    """Return the derivation for a craft without sway force: the formulae, checked by the sampled loop of its law."""

    def margin(speed: float) -> float:
        law = default_law(vehicle)
        gains = _named(vehicle, inner_start(vehicle.at_speed(speed), cruise=speed, dt=dt), speed, dt, 1.0)
        loops = law_corners(build_law(law, dt=dt), vehicle, gains.with_own(law_source(law).gains), cruise=speed)
        return float(np.nan_to_num(loops.disk))

    reached, bearable = margin(cruise), cruise
    if reached < LEAST_DISK_MARGIN:
        slower = [float(f"{cruise * _SLOWER**k:.3g}") for k in range(1, _SLOWER_SPEEDS)]
        bearable = next((speed for speed in slower if margin(speed) >= LEAST_DISK_MARGIN), 0.0)
        high = min(bearable / _SLOWER, cruise)
        for _ in range(_SLOWER_STEPS if bearable > 0 else 0):
            at = float(f"{(bearable + high) / 2:.3g}")
            bearable, high = (at, high) if margin(at) >= LEAST_DISK_MARGIN else (bearable, at)
    gains = _named(vehicle, inner_start(vehicle, cruise=cruise, dt=dt), cruise, dt, reached)
    return Derivation(gains, vehicle.name, cruise, dt, reached, bearable, False, munk_rate(vehicle, cruise))


def _bearable(vehicle: Vehicle, cruise: float, dt: float, inner: Array) -> float:
    """Return the largest speed [m/s] below `cruise` at which derived gains have the margin; 0 if there is none.

    The first speed tried makes the Munk moment as fast as the delay of the loop allows by experience; steps of 20 %
    lead to a bracket, and bisection refines it.
    """
    low, high = 0.0, cruise
    delay = vehicle["thrust_lag"] + 1.5 * dt
    speed = min(_MUNK_DELAY * cruise / max(munk_rate(vehicle, cruise) * delay, 1e-9), cruise / _BRACKET)
    for _ in range(_BEARABLE_STEPS):
        inner, margin = searched_inner(vehicle, speed, dt, inner if high < cruise else None)
        low, high = (speed, high) if margin >= LEAST_DISK_MARGIN else (low, speed)
        if low == 0.0:
            speed = high / _BRACKET
        elif high > _BRACKET * low:
            speed = min(low * _BRACKET, (low + high) / 2)
        else:
            speed = (low + high) / 2
    speed = float(np.floor(low * 1000) / 1000)
    for _ in range(_LOWERED):  # without a similar speed to start from, the search may end elsewhere
        if speed <= 0 or searched_inner(vehicle, speed, dt)[1] >= LEAST_DISK_MARGIN:
            return speed
        speed = float(np.floor(speed * 980) / 1000)
    return 0.0

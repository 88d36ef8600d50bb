"""Thrust and velocities of the law as the autopilot's normalised stick axes.

ArduSub maps a stick deflection to motor outputs linearly. The deflection n of an axis is found from the thrust F and
the largest thrust F_max of the axis in the vehicle file (astern: the largest thrust astern). Without thrusters in the
file, n = F / F_max. If all thrusters of the file have one curve f from command to share of the largest force, then
n = f⁻¹(F / F_max), which is exact while one axis acts alone; a small thrust begins at the edge of the dead band.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, radians

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.marine.vehicle import Thruster, Vehicle

__all__ = ["MODES", "Axes", "Mapping", "Mode", "mode_of"]

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Mode:
    """A mode of ArduSub in which the bridge can steer.

    Attributes:
        name: name for options.
        number: ArduSub's number of the mode (`custom_mode` of its heartbeat).
        thrust: axes that are thrusts, as indices of surge, sway, heave, yaw.
        rate: whether the yaw axis is a yaw rate.
        what: who controls what.
    """

    name: str
    number: int
    thrust: tuple[int, ...]
    rate: bool
    what: str


MODES: dict[str, Mode] = {
    "alt_hold": Mode("alt_hold", 2, (0, 1), True, "surge and sway by thrust, yaw rate; the autopilot holds its depth"),
    "manual": Mode("manual", 19, (0, 1, 2, 3), False, "all four axes by thrust; nothing holds roll and pitch"),
    "guided": Mode("guided", 4, (), True, "velocity and yaw rate; the autopilot controls all axes"),
}
"""Modes by name. In `alt_hold` the heave stick is neutral: the operator brings the vehicle to the mission's depth."""


def mode_of(name: str, *, key: str = "--mode") -> Mode:
    """Return a mode by name; InputError if there is no such mode.

    Example:
        >>> from surctl.marine.bridge import mode_of
        >>> mode_of("alt_hold").number
        2
    """
    if name not in MODES:
        raise InputError("is not known", key=key, value=name, remedy=nearest(name, MODES))
    return MODES[name]


@dataclass(frozen=True)
class Axes:
    """Deflections in [−1, 1]: ahead, to the right, upwards, and clockwise seen from above (the signs of ArduSub).

    In the mode `guided`, `velocity` (3,) is the desired velocity in NED [m/s] and `yaw_rate` the yaw rate clockwise
    [rad/s]; else it is None.
    """

    ahead: float = 0.0
    right: float = 0.0
    up: float = 0.0
    clockwise: float = 0.0
    velocity: tuple[float, float, float] | None = None
    yaw_rate: float = 0.0

    @property
    def neutral(self) -> bool:
        """Whether every deflection and every velocity is 0."""
        return not any((self.ahead, self.right, self.up, self.clockwise, self.yaw_rate, *(self.velocity or ())))


@dataclass(frozen=True, eq=False)
class Mapping:
    """Maps the law's outputs to stick axes for one vehicle and mode.

    Attributes:
        mode: the autopilot's mode.
        limits: least and largest thrust (2, 4) [N, N m] in surge, sway, heave, yaw.
        thruster: a thruster whose curve, as shares of its largest force, is that of all thrusters; None: linear.
        full_rate: yaw rate [rad/s] at full deflection, 45° times ArduSub's parameter ACRO_YAW_P.

    Example:
        >>> from surctl.marine.bridge import Mapping, mode_of
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mapping = Mapping.of(load_vehicle("sur540-flooded"), mode_of("alt_hold"))
        >>> mapping.axes([2.5, 1.0, 0.0, 0.1], yaw_rate=0.1)  # N, N, N, N m; rad/s
        Axes(ahead=0.5, right=-0.2, up=0.0, clockwise=-0.127..., velocity=None, yaw_rate=0.0)
    """

    mode: Mode
    limits: Vector
    thruster: Thruster | None = None
    full_rate: float = radians(45.0)

    @classmethod
    def of(cls, vehicle: Vehicle, mode: Mode, *, full_rate: float = radians(45.0)) -> Mapping:
        """Return the mapping for a vehicle.

        Raises:
            InputError: the full yaw rate is not a positive number.
        """
        if not (isfinite(full_rate) and full_rate > 0):
            raise InputError("is not a yaw rate", key="full_rate", value=full_rate, remedy="give rad/s, above 0")
        limits = vehicle.thrust_range
        if vehicle.actuators is not None:
            limits = np.array([-vehicle.actuators.most, vehicle.actuators.most])
        return cls(mode, limits, _common(vehicle), full_rate)

    def axes(self, tau: Vector, *, yaw_rate: float = 0.0) -> Axes:
        """Return the stick axes of a thrust (4,) [N, N m] in {B}, and of a yaw rate [rad/s] for modes that take it.

        A number that is not finite makes every axis neutral.
        """
        numbers = [*(float(v) for v in tau), float(yaw_rate)]
        if not all(map(isfinite, numbers)):
            return Axes()
        sticks = [self._stick(axis, numbers[axis]) if axis in self.mode.thrust else 0.0 for axis in range(4)]
        if self.mode.rate:
            sticks[3] = _within(yaw_rate / self.full_rate)
        ahead, left, up, turn = sticks
        return Axes(ahead, 0.0 - left, up, 0.0 - turn)

    def thrust(self, axes: Axes) -> Vector:
        """Return the thrust (4,) [N, N m] of stick axes, as the motors give it; 0 on axes that are not thrusts."""
        sticks = (axes.ahead, -axes.right, axes.up, -axes.clockwise)
        return np.array([self._force(k, n) if k in self.mode.thrust else 0.0 for k, n in enumerate(sticks)])

    def _stick(self, axis: int, force: float) -> float:
        largest = float(self.limits[1, axis] if force > 0 else -self.limits[0, axis])
        if largest <= 0.0:
            return 0.0
        share = _within(force / largest)
        one = self.thruster
        return share if one is None else one.command(share * (one.forward if share > 0 else one.reverse))

    def _force(self, axis: int, stick: float) -> float:
        one, share = self.thruster, stick
        if one is not None:
            force = one.force(stick)
            share = force / (one.forward if force > 0 else one.reverse)
        return share * float(self.limits[1, axis] if share > 0 else -self.limits[0, axis])


def _within(value: float) -> float:
    return min(1.0, max(-1.0, value))


def _common(vehicle: Vehicle) -> Thruster | None:
    # a thruster that stands for all; None if they differ, or if one pushes in one direction only, swivels or is a fin
    thrusters = vehicle.actuators.thrusters if vehicle.actuators is not None else ()
    if not thrusters or any(t.reverse <= 0.0 or t.fin is not None or t.swivel is not None for t in thrusters):
        return None
    shapes = [[(c, round(f / (t.forward if f > 0 else t.reverse), 9)) for c, f in t.curve] for t in thrusters]
    return thrusters[0] if all(shape == shapes[0] for shape in shapes) else None

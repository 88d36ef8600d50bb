"""Which parameters of a vehicle are fitted to a log, in which units, and which motion each of them needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle.identification.rates import FITTED
from surctl.marine.vehicle.parameters import Parameter, Vehicle
from surctl.marine.vehicle.specs import AXES, TERMS

__all__ = [
    "AXIS_OF",
    "CENTRE",
    "CONSTANT_FORCE",
    "FITTED",
    "MASS_OF",
    "OFFSETS",
    "axes_of",
    "masses_of",
    "names_of",
    "scale_of",
    "with_all_constants",
]

CONSTANT_FORCE = ("X0", "Y0", "Z0", "N0")
"""Constant force on the vehicle along its own axes [N] and constant yaw moment [N m]: net buoyancy, trim, a tether."""

CENTRE = ("xg", "yg", "zg")
"""Centre of gravity of a vehicle that rolls and pitches. Weight, buoyancy and centre of buoyancy are not fitted: a log
shows only the moment of both forces, i.e. the distance of the two centres, and the net buoyancy, which is Z0."""

OFFSETS = (*CONSTANT_FORCE, *CENTRE)
"""Parameters that may be 0 and are then no term of the vehicle."""

_MASSES = dict(zip("uvwrpq", (*FITTED[:4], "mpp", "mqq"), strict=True))
_OF_LETTER = _MASSES | dict(zip("XYZNKM", _MASSES.values(), strict=True)) | dict(zip("1234", FITTED[:4], strict=True))

MASS_OF = dict(zip(FITTED[4:12], 2 * FITTED[:4], strict=True)) | {
    "Kp": "mpp", "Kpp": "mpp", "Mq": "mqq", "Mqq": "mqq",
}  # fmt: skip
"""The mass on the axis of each drag parameter that acts against its own axis."""

AXIS_OF = dict(zip(_MASSES.values(), AXES, strict=True))
"""The name of the axis of each mass."""

_COUPLING = 0.1  # scale of a coupling whose start value is 0, as a share of the parameters on the axes
_CENTRE = 0.2  # scale of a distance from the origin, as a share of the radius of the hull

Array = NDArray[np.float64]


def _offsets(vehicle: Vehicle) -> tuple[str, ...]:
    return OFFSETS if vehicle.form.tilts else CONSTANT_FORCE


def with_all_constants(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with all offsets as terms; those that it does not have are 0."""
    zeros = {k: Parameter(0.0, TERMS[k].unit, None, "") for k in _offsets(vehicle)}
    parameters = zeros | dict(vehicle.parameters)
    order = [k for k in (*vehicle.parameters, *zeros) if k in parameters]
    return replace(vehicle, parameters={k: parameters[k] for k in dict.fromkeys(order)})


def names_of(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of all parameters of a vehicle that are fitted: equation (3), couplings, offsets.

    A vehicle without thrust lag keeps a lag of 0.
    """
    couplings = [k for k in vehicle.form.terms if TERMS[k].table in ("inertia", "drag")]
    lagged = vehicle["thrust_lag"] > 0
    return (*(k for k in FITTED if k != "thrust_lag" or lagged), *couplings, *_offsets(vehicle))


def masses_of(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of the masses and moments of inertia on the axes of a vehicle: four, or six if it tilts."""
    return tuple(_MASSES.values())[: 6 if vehicle.form.tilts else 4]


def axes_of(name: str) -> frozenset[str]:
    """Return the names of the masses on the axes whose motion a mass, drag or coupling needs; none for other names."""
    if name in OFFSETS or name == "thrust_lag":
        return frozenset()
    return frozenset(_OF_LETTER[c] for c in name.removeprefix("m"))


def scale_of(vehicle: Vehicle, name: str, thrust: Array) -> float:
    """Return the size of a change of a parameter, in its SI unit.

    Args:
        vehicle: the start vehicle with all offsets.
        name: the parameter.
        thrust: (4,) largest thrust on each axis.
    """
    value = abs(vehicle[name])
    if name in CONSTANT_FORCE:
        return float(thrust[CONSTANT_FORCE.index(name)])
    if name in CENTRE:
        return max(value, _CENTRE * vehicle["radius"])
    if value > 0:
        return value
    if name[0] == "m":
        one, other = (_OF_LETTER[c] for c in name[1:])
        of_axes = np.sqrt(vehicle[one] * vehicle[other])
    else:  # a drag whose start value is 0 is scaled by the quadratic drag of its axis, or its linear drag
        mass = _OF_LETTER[name[0]]
        of_axes = max(abs(vehicle[k]) for k, axis in MASS_OF.items() if axis == mass and k in vehicle.parameters)
    return max(_COUPLING * float(of_axes), 1e-3)

"""A spherical vehicle from size, mass and thrust (`from-geometry`), and how deep a hull floats at the surface."""

from __future__ import annotations

from math import pi

from surctl.errors import InputError, check_number
from surctl.marine.vehicle.parameters import Parameter, Vehicle
from surctl.marine.vehicle.specs import PARAMETERS

_DRAG = (0.4, 1.0)  # range of drag coefficients of spheres with openings and fittings
_THRUST = 0.15  # relative difference between the thrust in a bollard test and at speed
_LINEAR = 0.03  # [m/s] speed at which linear and quadratic drag are equal
_YAW_DRAG = 0.7  # quadratic yaw drag over rho R^5 for a shell with fins and holes; a smooth sphere has nearly none
_LARGEST = 5.0  # [m] largest plausible diameter; a larger number is probably in centimetres
_YAW_LINEAR = 0.3  # [rad/s] ratio of linear to quadratic yaw drag


def sphere(
    name: str,
    *,
    diameter: float,
    dry_mass: float,
    thrust: float,
    yaw_thrust: float,
    flooded: float = 0.75,
    drag_coefficient: float = 0.52,
    thrust_lag: float = 0.3,
    density: float = 1000.0,
) -> Vehicle:
    """Return a spherical vehicle from its geometry; every derived parameter has a range and a provenance.

    The mass including added mass is m + f (3/2 ρV − m), with dry mass m, flooded fraction f, water density ρ and volume
    V. For f = 1, all water inside the shell moves with the shell, and the added mass is that of a sphere, ½ρV (Fossen
    2021, ch. 8). For f = 0, water passes freely through the shell. The moment of inertia is 2/5 (m + f (ρV − m)) R²
    with the radius R, as for a solid sphere without added mass. The quadratic drag is ½ρ C_d πR² in surge and sway, and
    1.5 times this value in heave. Linear drag and yaw drag are design choices, because no formula of this kind exists
    for linear drag or yaw drag.

    Args:
        name: name of the vehicle.
        diameter: diameter of the hull [m].
        dry_mass: mass in air, without water inside [kg].
        thrust: largest force in surge, sway and heave [N].
        yaw_thrust: largest moment about z [N m].
        flooded: flooded fraction f, 0 to 1; the derived ranges use fractions from half of `flooded` to 1.
        drag_coefficient: drag coefficient C_d, which refers to the frontal area.
        thrust_lag: time constant of the first-order thrust lag [s].
        density: density of the water [kg/m³].

    Raises:
        InputError: a number is not finite or not positive, the flooded fraction is outside 0 to 1, or the robot is
            heavier than the water that it displaces.

    Example:
        >>> from surctl.marine.vehicle import sphere
        >>> ball = sphere("scout", diameter=0.3, dry_mass=4.0, thrust=8.0, yaw_thrust=0.6)
        >>> round(ball["m11"], 1), [round(end, 1) for end in ball.parameters["m11"].range]
        (16.9, [10.5, 21.2])
    """
    for what, value, unit in (
        ("diameter", diameter, "m"), ("dry mass", dry_mass, "kg"), ("thrust", thrust, "N"),
        ("yaw thrust", yaw_thrust, "N m"), ("drag coefficient", drag_coefficient, "a number"),
        ("density", density, "kg/m^3"),
    ):  # fmt: skip
        check_number(what, value, unit=unit)
    check_number("thrust lag", thrust_lag, unit="s", zero=True)
    if diameter > _LARGEST:
        raise InputError("is too large for a small robot", key="diameter", value=diameter, remedy="give it in metres")
    if not 0 <= flooded <= 1:
        raise InputError("must lie between 0 and 1", key="flooded", value=flooded, remedy="1 means a full shell")
    radius = diameter / 2
    displaced = density * 4 / 3 * pi * radius**3
    if dry_mass > displaced:
        problem = f"sinks: a sphere of {diameter:g} m displaces {displaced:.3g} kg"
        remedy = "check the diameter (in m) and the mass (in kg)"
        raise InputError(problem, key="dry mass", value=dry_mass, remedy=remedy)

    def mass(f: float) -> float:
        return dry_mass + f * (1.5 * displaced - dry_mass)

    def moment(f: float) -> float:
        return 0.4 * (dry_mass + f * (displaced - dry_mass)) * radius**2

    def drag(cd: float) -> float:
        return 0.5 * density * cd * pi * radius**2

    least = flooded / 2
    coefficients = min(_DRAG[0], drag_coefficient), max(_DRAG[1], drag_coefficient)
    quadratic, yaw = drag(drag_coefficient), _YAW_DRAG * density * radius**5
    inertia = f"derived: m + f (1.5 rho V - m) of {dry_mass:g} kg in air, f = {flooded:g}; range f {least:g} to 1"
    drags = f"derived: 0.5 rho Cd A, Cd = {drag_coefficient:g}; range Cd {coefficients[0]:g} to {coefficients[1]:g}"
    linear = f"chosen: equal to the quadratic drag at {_LINEAR:g} m/s"
    turning = f"chosen: {_YAW_DRAG:g} rho R^5 for a shell with fins and holes"
    limits = f"given; the range is ±{_THRUST:.0%}"
    surge = (quadratic, (drag(coefficients[0]), drag(coefficients[1])), drags)
    stretched = (1.5 * surge[0], (1.5 * surge[1][0], 1.5 * surge[1][1]), f"{drags}; 1.5 times in heave")
    # each parameter: value, range, provenance
    numbers: dict[str, tuple[float, tuple[float, float] | None, str]] = {
        "radius": (radius, None, f"given: diameter {diameter:g} m"),
        **dict.fromkeys(("m11", "m22", "m33"), (mass(flooded), (mass(least), mass(1.0)), inertia)),
        "m44": (moment(flooded), (moment(least), moment(1.0)), "derived: 2/5 (m + f (rho V - m)) R^2, f as for m11"),
        **dict.fromkeys(("Xu", "Yv"), (_LINEAR * quadratic, (0.0, 3 * _LINEAR * quadratic), linear)),
        "Zw": (1.5 * _LINEAR * quadratic, (0.0, 4.5 * _LINEAR * quadratic), linear),
        "Nr": (_YAW_LINEAR * yaw, (0.05 * yaw, yaw), f"chosen: {_YAW_LINEAR:g} of Nrr"),
        **dict.fromkeys(("Xuu", "Yvv"), surge),
        "Zww": stretched,
        "Nrr": (yaw, (0.2 * yaw, 3 * yaw), turning),
        **dict.fromkeys(("Fu_max", "Fv_max", "Fw_max"), (thrust, _around(thrust), limits)),
        "Fr_max": (yaw_thrust, _around(yaw_thrust), limits),
        "thrust_lag": (thrust_lag, None, "given" if thrust_lag != 0.3 else "chosen: small thrusters"),
    }
    parameters = {
        key: Parameter(value, PARAMETERS[key].unit, bounds, said) for key, (value, bounds, said) in numbers.items()
    }
    note = f"Sphere of {diameter:g} m, {dry_mass:g} kg in air, flooded fraction {flooded:g}"
    return Vehicle(name, note, parameters).with_values({})


def _around(value: float) -> tuple[float, float]:
    return (1 - _THRUST) * value, (1 + _THRUST) * value


GRAVITY = 9.81
"""Acceleration of gravity [m/s²]."""

WATER = 1000.0
"""Density of the water [kg/m³]."""


def missing_buoyancy(radius: float, z: float) -> float:
    """Return the weight [N] of the water that a sphere with its centre at z [m] lacks, because a part is above 0."""
    height = min(max(z + radius, 0.0), 2 * radius)
    return WATER * GRAVITY * pi * height * height * (3 * radius - height) / 3


def floating_depth(radius: float, force: float) -> float:
    """Return z [m] at which the missing buoyancy of a spherical hull equals a force ≥ 0 [N], which holds it there."""
    low, high = -radius, radius
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if missing_buoyancy(radius, middle) < force else (low, middle)
    return low

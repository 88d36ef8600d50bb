"""The force of the water on a hull in MuJoCo, compiled to C; options of `--plant mujoco:KEY=VALUE`, refusals.

MuJoCo integrates a rigid body with the mass m and the inertia I, without added mass. The vehicle file states the whole
inertia matrix M of rigid body and water. Where M is that of the rigid body, MuJoCo has all of it. Otherwise the
remainder Δ = M − diag(m, I) acts through the force of the water. With the load F on the hull and the momenta P = M ν,
Kirchhoff's equations (Fossen 2021, equation 6.44) are M ν̇ = F − k(M, ν), where k is the rate of the momenta because the
frame turns. MuJoCo computes diag(m, I) ν̇ = f − k(diag(m, I), ν), so the force must be f = F − k(Δ, ν) − Δ ν̇ with
ν̇ = M⁻¹ (F − k(M, ν)). This solves for the acceleration in the same instant; a force that follows from an acceleration
of the step before would diverge where the added mass exceeds the mass. A contact meets the mass m alone.

The velocity ν is that through the water. A constant current does not change m ν̇, because the frame that moves with the
water is inertial.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import pi, sqrt
from typing import TYPE_CHECKING, Annotated, Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from surctl.errors import InputError, mistakes_in, nearest
from surctl.files import Strict, validate
from surctl.ir import Program, lower_named
from surctl.marine.vehicle import GRAVITY, WATER, Actuators, PlantForm, Vehicle, plant_layout, plant_parameters
from surctl.marine.vehicle.dynamics import constant_force, drag_of, inertia_matrix, planar_turning, point_of
from surctl.tasks.task import planar_rotation

if TYPE_CHECKING:
    from surctl.marine.simulation import Scenario

# How MuJoCo simulates a vehicle: degrees of freedom, drag model, water surface, and rays of the sonars


_PLANTS = ("own", "mujoco")
_FORM = "write --plant mujoco or --plant mujoco:KEY=VALUE,..."
_BOX = "write LENGTHxWIDTHxHEIGHT in m, such as 1.2x0.6x0.4"
_UNLIKE = 20.0  # largest ratio of a side of a box to the diameter in the vehicle file, and of this to a side
_SWITCHES = ("floor", "surface_echo")


def _sides(value: object) -> object:
    """Return length, width and height [m] of a text such as 1.2x0.6x0.4; another value as it is."""
    if not isinstance(value, str):
        return value
    try:
        length, width, height = map(float, value.split("x"))
    except ValueError:
        raise ValueError(f"is not a box; {_BOX}") from None
    return length, width, height


_Side = Annotated[float, Field(ge=1e-3, le=1e3)]


class EngineOptions(Strict):
    """The choices of a simulation in MuJoCo that a vehicle file does not make.

    Attributes:
        dof: degrees of freedom: 6, or 4 without roll and pitch. 0: 6 for a vehicle file with `[attitude]`, else 4.
        drag: `axis`: the drag of the vehicle file; `speed`: its quadratic drag on each axis of translation grows with
            the speed |v| instead of that axis' own velocity; `ellipsoid`: MuJoCo's fluid model of a sphere instead of
            the quadratic drag of the file.
        surface: share in [0, 1] of the displacement of the part of the hull above the water that is missing as
            buoyancy: 1 if the hull keeps its water, the dry mass over the displaced mass if it drains, 0 without a
            surface.
        box: length, width and height [m] of a hull that is a box about its centre; None: a sphere with the radius of
            the file. It decides the missing buoyancy and, with six degrees of freedom, the righting moment of the
            water surface; contacts remain those of the sphere.
        ballast: `path`: the vehicle is ballasted to float at the depth of the path; `none`: it is not.
        rays: `cone`: rays in a cone in space, which rolls and pitches with the hull; `fan`: rays in a horizontal fan.
        count: number of rays of a sonar.
        floor, surface_echo: whether the sonars receive echoes from the floor and from the water surface.
        step: longest step of the integration [s].

    Example:
        >>> from surctl.marine.engine import EngineOptions
        >>> EngineOptions(surface=1.0).text()
        'surface=1.0'
    """

    dof: Annotated[Literal[0, 4, 6], BeforeValidator(lambda v: int(v) if v in ("4", "6") else v)] = 0
    drag: Literal["axis", "speed", "ellipsoid"] = "axis"
    surface: float = Field(default=0.0, ge=0, le=1)
    box: Annotated[tuple[_Side, _Side, _Side] | None, BeforeValidator(_sides)] = None
    ballast: Literal["path", "none"] = "path"
    rays: Literal["cone", "fan"] = "cone"
    count: int = Field(default=200, ge=8, le=100_000)
    floor: bool = False
    surface_echo: bool = False
    step: float = Field(default=0.0125, ge=1e-4, le=0.025)

    @model_validator(mode="after")
    def _afloat(self) -> EngineOptions:
        for key in ("box", "ballast") if self.surface == 0 else ():
            if getattr(self, key) not in (None, "path"):
                raise ValueError(f"{key} needs a water surface; add surface=1.0, or drop {key}")
        return self

    def of(self, vehicle: Vehicle) -> EngineOptions:
        """Return the options for a vehicle, with its degrees of freedom.

        Raises:
            InputError: the vehicle has no roll and pitch, but `dof` is 6; or the sides of the box are not in m.
        """
        if self.dof == 6 and not vehicle.form.tilts:
            problem = f"needs weight, buoyancy and inertia of roll and pitch, which {vehicle.name} does not state"
            remedy = "add [attitude], mpp and mqq to the file, use sur540-tilting or sur400-tilting, or dof=4"
            raise InputError(problem, key="dof", value=6, remedy=remedy)
        width = 2 * vehicle["radius"]
        if self.box is not None and not all(width / _UNLIKE <= side <= width * _UNLIKE for side in self.box):
            problem = f"is not plausible in m for {vehicle.name}, whose file has a diameter of {width:g} m"
            raise InputError(problem, key="--plant mujoco:box", value=_written(self.box), remedy=_BOX)
        return self.model_copy(update={"dof": self.dof or (6 if vehicle.form.tilts else 4)})

    @property
    def unheard(self) -> tuple[str, ...]:
        """Names of the options that are not the default and concern sonars only."""
        usual = EngineOptions()
        return tuple(key for key in ("rays", "count", *_SWITCHES) if getattr(self, key) != getattr(usual, key))

    def text(self) -> str:
        """Return all options that differ from their defaults as one text, which `parse_plant` reads."""
        usual = EngineOptions()
        return ",".join(f"{key}={_written(value)}" for key, value in self if value != getattr(usual, key))


def _written(value: Any) -> str:
    if isinstance(value, tuple):
        return "x".join(map(str, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def parse_plant(text: str) -> EngineOptions | None:
    """Return the options of a plant on the command line: `mujoco`, `mujoco:KEY=VALUE,…`; None for `own`."""
    name, colon, rest = text.partition(":")
    if name not in _PLANTS:
        raise InputError("is not known", key="--plant", value=text, remedy=nearest(name, _PLANTS))
    if name == "own":
        if colon:
            raise InputError("has no options", key="--plant", value=text, remedy="write --plant own")
        return None
    values: dict[str, str] = {}
    for part in rest.split(",") if colon else ():
        key, equals, value = part.partition("=")
        if not equals:
            problem = "has no value" if part else "has an option that is empty"
            raise InputError(problem, key="--plant", value=part or text, remedy=_FORM)
        if key in values:
            raise InputError("is there twice", key=f"--plant mujoco:{key}", value=value, remedy="write it once")
        values[key] = value
    with mistakes_in(None, "--plant mujoco:"):
        return validate(values, EngineOptions, file=None)


_GAUSS = ((-sqrt(0.15), 5 / 18), (0.0, 8 / 18), (sqrt(0.15), 5 / 18))  # places and weights on (-1/2, 1/2)
_TILTING = set("KMpq")
_LINEAR, _ANGULAR = [0, 1, 2], [4, 5, 3]  # places of (u, v, w) and (p, q, r) in (u, v, w, r, p, q)


@dataclass(frozen=True, eq=False)
class Body:
    """A hull as MuJoCo has it: what of the inertia matrix is the rigid body's, and which water force remains.

    Attributes:
        form: the optional terms of the vehicle that act with these degrees of freedom.
        mass: mass of the rigid body [kg].
        inertia: its moments of inertia about x, y, z [kg m²].
        parameters: the vehicle's parameters with the layout `plant_layout(form)`.
        coupled: whether a part of the inertia matrix is left to the force of the water.
        actuators: the thrusters, which act beside the total thrust, or None.
    """

    options: EngineOptions
    form: PlantForm
    mass: float
    inertia: tuple[float, float, float]
    parameters: NDArray[np.float64]
    coupled: bool
    actuators: Actuators | None = None


def body_of(vehicle: Vehicle, options: EngineOptions) -> Body:
    """Return the rigid body of a vehicle in MuJoCo."""
    options = options.of(vehicle)
    names = [name for name in vehicle.form.terms if options.dof == 6 or not set(name) & _TILTING]
    form = PlantForm.of(names)
    full = plant_layout(vehicle.form).unpack(plant_parameters(vehicle))
    retained = [name in names for name in vehicle.form.terms]
    if names:
        full["terms"] = full["terms"][retained]
    parameters = plant_layout(form).pack({port.name: full[port.name] for port in plant_layout(form).ports})
    matrix = vehicle.inertia
    mass = float(np.diag(matrix)[:3].min())
    yaw = float(matrix[3, 3])
    turning = (float(matrix[4, 4]), float(matrix[5, 5]), yaw) if options.dof == 6 else (yaw, yaw, yaw)
    if 2 * max(turning) > sum(turning):  # no rigid body has such moments
        turning = (min(turning),) * 3
    mine = [mass, mass, mass, turning[2], turning[0], turning[1]]
    size = options.dof
    coupled = not np.array_equal(matrix[:size, :size], np.diag(mine[:size]))
    return Body(options, form, mass, turning, parameters, coupled, vehicle.actuators)


def environment(body: Body, scenario: Scenario, hull: float) -> NDArray[np.float64]:
    """Return the input `e` (17,) of `fluid_program` without an outer force, for a hull with this radius [m]."""
    options = body.options
    ballast = scenario.depth if options.ballast == "path" else -2 * max(hull, *(options.box or (0,)))
    current = scenario.disturbance.current_m_per_s
    box = options.box or (0.0, 0.0, 0.0)
    return np.array([*current, 0, 0, 0, 0, 0, hull, options.surface, ballast, body.mass, *body.inertia, *box])


def fluid_program(body: Body) -> Program:
    """Return the instruction list of the force of the water on a hull, in MuJoCo's generalised coordinates.

    Its inputs are `q` and `v` (positions and velocities of MuJoCo), `thrust` (4 + N,) after the lag (surge, sway, heave
    and yaw, then the force components of the thrusters), the vehicle's parameters `p`, and `e` (17,): current (3,)
    [m/s], outer force (3,) in {E} and yaw moment, hull radius, share of the missing buoyancy, depth to which the hull
    is ballasted, mass and moments of inertia of the rigid body, and the sides of a hull that is a box.
    """
    options = body.options
    return _program(body.form, options.dof, options.drag, body.coupled, options.box is not None, body.actuators)


@cache
def _program(form: PlantForm, dof: int, drag: str, coupled: bool, boxed: bool, actuators: Actuators | None) -> Program:
    from surctl.robot.kinematics import rotation_of  # this import takes long

    q, v = ca.SX.sym("q", 7 if dof == 6 else 4), ca.SX.sym("v", dof)
    single = np.zeros((6, 0)) if actuators is None else np.hstack([one.columns for one in actuators.thrusters])
    thrust, e = ca.SX.sym("thrust", 4 + single.shape[1]), ca.SX.sym("e", 17)
    flat, p = plant_layout(form).symbols("p")
    terms = {name: p["terms"][k] for k, name in enumerate(form.terms)}
    current, outer, yaw = e[:3], e[3:6], e[6]
    radius, share, ballast = e[7], e[8], e[9]
    rotation = rotation_of(ca.vertcat(q[4:], q[3])) if dof == 6 else ca.diagcat(planar_rotation(q[3]), 1)
    through = rotation.T @ (v[:3] - current)
    nu = ca.vertcat(through, v[5], v[3], v[4]) if dof == 6 else ca.vertcat(through, v[3])

    load = -_drag(nu, p, form, drag)
    level = rotation[:2, 0] / ca.norm_2(rotation[:2, 0])
    forces = constant_force(p, form)
    ahead = ca.vertcat(ca.horzcat(level[0], -level[1]), ca.horzcat(level[1], level[0])) @ forces[:2]
    lift = terms.get("buoyancy", ca.SX(0)) - terms.get("weight", ca.SX(0))
    up = rotation[2, :].T
    density = share * WATER * GRAVITY
    if boxed:
        volume, arm = _emerged_box(q[2], up, e[14:])
        afloat, _ = _emerged_box(ballast, ca.SX([0, 0, 1]), e[14:])
    else:
        volume, arm, afloat = _emerged(q[2], radius), ca.SX.zeros(3), _emerged(ballast, radius)
    world = outer + ca.vertcat(ahead, forces[2]) + ca.vertcat(0, 0, lift - density * (volume - afloat))
    moment = (yaw + forces[3]) * up - density * ca.cross(arm, up)
    arm_moment = ca.SX.zeros(3)  # moment of the thrust about the origin
    if dof == 6:
        moment += ca.cross(terms["buoyancy"] * point_of(terms, "b") - terms["weight"] * point_of(terms, "g"), up)
        arm_moment = ca.cross(point_of(terms, "t"), thrust[:3])
    load += _wrench(rotation.T @ world, moment, dof)
    if coupled:
        apart = ca.DM(single) @ thrust[4:]
        pushing = _wrench(thrust[:3] + apart[:3], arm_moment + ca.vertcat(0, 0, thrust[3]) + apart[3:], dof)
        mine = ca.diag(ca.vertcat(e[10], e[10], e[10], e[13], e[11], e[12])[:dof])
        whole = inertia_matrix(p, form)
        rest = whole - mine
        factors = ca.ldl(whole)
        rate = ca.ldl_solve(load + pushing - _turned(whole @ nu, nu, dof), *factors)
        load = load - _turned(rest @ nu, nu, dof) - rest @ rate
    force = rotation @ load[:3]
    generalised = ca.vertcat(force, load[4], load[5], load[3]) if dof == 6 else ca.vertcat(force, load[3])
    inputs = {"q": q, "v": v, "thrust": thrust, "p": flat, "e": e}
    return lower_named("fluid", inputs, {"force": generalised})


def _wrench(force: ca.SX, moment: ca.SX, dof: int) -> ca.SX:
    # in the order of ν: (X, Y, Z, N, K, M), or (X, Y, Z, N)
    return ca.vertcat(force, moment[2], *([moment[0], moment[1]] if dof == 6 else []))


def _turned(momentum: ca.SX, nu: ca.SX, dof: int) -> ca.SX:
    # k(M, ν): rate of the momenta because the frame of the hull turns and moves
    if dof == 4:
        return planar_turning(momentum, nu)
    linear, angular = momentum[_LINEAR], momentum[_ANGULAR]
    velocity, spin = nu[_LINEAR], nu[_ANGULAR]
    return _wrench(ca.cross(spin, linear), ca.cross(spin, angular) + ca.cross(velocity, linear), dof)


def _drag(nu: ca.SX, p: dict[str, ca.SX], form: PlantForm, model: str) -> ca.SX:
    drag, own = drag_of(nu, p, form), p["quadratic_drag"][:3] * nu[:3]
    if model == "speed":
        drag[:3] += own * (ca.norm_2(nu[:3]) - ca.fabs(nu[:3]))
    elif model == "ellipsoid":
        drag[:3] -= own * ca.fabs(nu[:3])
    return drag


def _emerged(z: ca.SX, radius: ca.SX) -> ca.SX:
    height = ca.fmin(ca.fmax(z + radius, 0), 2 * radius)
    return pi * height * height * (3 * radius - height) / 3


def _emerged_box(z: ca.SX, up: ca.SX, sides: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the volume above the water of a box about the origin, and its first moment (3,) in the frame of the hull.

    Nine columns along the box's height at the points of Gauss's rule: exact while the water line crosses the four
    sides alone. `up` is the vertical in the frame of the hull; beyond 84 degrees of tilt it counts as 84 degrees.
    """
    volume, first = ca.SX(0), ca.SX.zeros(3)
    rising = ca.fmax(up[2], 0.1)
    for a, share_a in _GAUSS:
        for b, share_b in _GAUSS:
            x, y = a * sides[0], b * sides[1]
            top = z + up[0] * x + up[1] * y + rising * sides[2] / 2
            height = ca.fmin(ca.fmax(top / rising, 0), sides[2])
            part = share_a * share_b * sides[0] * sides[1] * height
            volume += part
            first += part * ca.vertcat(x, y, (sides[2] - height) / 2)
    return volume, first

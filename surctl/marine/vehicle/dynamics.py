"""The dynamics, equation (3): current, limits and lag of thrust, roll, pitch; the steady speed at a force and drag.

A vehicle may have further terms (`PlantForm`): a full inertia matrix, drag on one axis by the velocity of another one,
constant forces, and less thrust astern than ahead. The momentum is then M ν, and the body that turns at r about the
vertical axis feels C(ν)ν = (−r p_y, r p_x, 0, u p_y − v p_x) with (p_x, p_y) the first two entries of M ν (Kirchhoff's
equations; Fossen 2021, equation 6.44). Each form is a function of its own, so equation (3) costs no more than before.

Added mass is part of the inertia matrix that the model inverts. A model that instead feeds back the added-mass force
from a delayed acceleration diverges if the added mass exceeds the dry mass, as the added mass of this robot does.

The velocity of the plant stays that of the heading frame (x ahead and y to the left, both horizontal, z up), because
laws, sensors and metrics are about that frame; roll φ, pitch θ and the angular velocities p, q of the hull follow as
four more states. The forces are computed in the frame of the hull: Kirchhoff's equations with the momenta M ν (Fossen
2021, equation 6.44), drag, and the restoring forces (section 4.1). The rotation from the hull to the heading frame is
R_y(θ) R_x(φ). With y to the left, a positive pitch lowers the bow. Roll and pitch must stay below 90°.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from math import inf, nan, sqrt

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, NotApplicable, nearest
from surctl.ir import Layout, Port
from surctl.marine.vehicle.parameters import Vehicle
from surctl.marine.vehicle.specs import PlantForm
from surctl.tasks import ThrustLimit
from surctl.tasks.task import Expression, checked_column, jacobian, planar_rotation

_TILT_STATE = Layout((Port("tilt", (4,), "rad, rad/s", "roll, pitch, and angular velocities p, q of the hull"),))
"""Further states of a vehicle that rolls and pitches."""

_LINEAR, _ANGULAR = [0, 1, 2], [4, 5, 3]  # places of (u, v, w) and (p, q, r) in a velocity (u, v, w, r, p, q)


def _to_heading(roll: ca.SX, pitch: ca.SX) -> ca.SX:
    """Return the matrix R_y(θ) R_x(φ), 3×3, that rotates vectors from the frame of the hull to the heading frame."""
    c, s = ca.cos(roll), ca.sin(roll)
    about_x = ca.vertcat(ca.horzcat(1, 0, 0), ca.horzcat(0, c, -s), ca.horzcat(0, s, c))
    c, s = ca.cos(pitch), ca.sin(pitch)
    about_y = ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))
    return about_y @ about_x


def _hull_load(
    nu: ca.SX, momentum: ca.SX, thrust: ca.SX, outer: ca.SX, rotation: ca.SX, terms: Mapping[str, ca.SX]
) -> ca.SX:
    """Return the load M ν̇ (6,) [N, N m] on the hull without its drag, in the order of ν = (u, v, w, r, p, q).

    All vectors but `outer`, the force (3,) and moment about the vertical (1,) in the heading frame, are in the frame of
    the hull; `momentum` is M ν (6,).
    """
    linear, angular = momentum[_LINEAR], momentum[_ANGULAR]
    velocity, turning = nu[_LINEAR], nu[_ANGULAR]
    up = rotation[2, :].T  # the vertical
    weight, buoyancy = terms["weight"], terms["buoyancy"]
    force = thrust[:3] + rotation.T @ outer[:3] + (buoyancy - weight) * up - ca.cross(turning, linear)
    moment = ca.cross(buoyancy * point_of(terms, "b") - weight * point_of(terms, "g"), up) + outer[3] * up
    moment += ca.cross(point_of(terms, "t"), thrust[:3]) - ca.cross(turning, angular) - ca.cross(velocity, linear)
    return ca.vertcat(force, moment[2] + thrust[3], moment[:2])


def point_of(terms: Mapping[str, ca.SX], letter: str) -> ca.SX:
    """Return the point (3,) [m] of gravity `g`, buoyancy `b` or thrust `t` in the frame of the hull."""
    return ca.vertcat(*(terms.get(f"{axis}{letter}", ca.SX(0)) for axis in "xyz"))


def _tilted_rate(
    nu: ca.SX, tilt: ca.SX, current: ca.SX, acceleration: Callable[[ca.SX, ca.SX], ca.SX]
) -> tuple[ca.SX, ca.SX]:
    """Return ν̇ (4,) of the heading frame and the rate (4,) of `_TILT_STATE`.

    `nu` is over ground, and the current (3,) is constant in the world and irrotational, both in the heading frame.
    `tilt` is roll, pitch, p, q. `acceleration` returns the rate (6,) of the velocity through the water (6,) in the
    frame of the hull, from that velocity and the result of `_to_heading`.
    """
    roll, pitch, p, q = (tilt[k] for k in range(4))
    rotation, yaw = _to_heading(roll, pitch), nu[3]
    r = (yaw * ca.cos(pitch) - q * ca.sin(roll)) / ca.cos(roll)
    turning = ca.vertcat(p, q, r)
    roll_rate, pitch_rate = p + yaw * ca.sin(pitch), q * ca.cos(roll) - r * ca.sin(roll)
    velocity = rotation.T @ (nu[:3] - current)
    rates = acceleration(ca.vertcat(velocity, r, p, q), rotation)
    # the rate in the world, seen from the heading frame, which turns at the yaw rate about the vertical
    linear = rotation @ (rates[:3] + ca.cross(turning, velocity)) - yaw * ca.vertcat(-nu[1], nu[0], 0)
    spin = rates[5] * ca.sin(roll) + q * ca.cos(roll) * roll_rate
    spin += rates[3] * ca.cos(roll) - r * ca.sin(roll) * roll_rate
    angular = spin / ca.cos(pitch) + yaw * ca.sin(pitch) / ca.cos(pitch) * pitch_rate
    return ca.vertcat(linear, angular), ca.vertcat(roll_rate, pitch_rate, rates[4:])


PLANT_STATE = Layout(
    (
        Port("eta", (4,), "m, rad", "position x, y, z and heading psi in {E}"),
        Port("nu", (4,), "m/s, rad/s", "ground velocity u, v, w and yaw rate r in {B}"),
        Port("tau", (4,), "N, N m", "thrust after its lag, in {B}"),
    )
)
PLANT_DISTURBANCE = Layout(
    (
        Port("current", (3,), "m/s", "current in {E}, constant and irrotational"),
        Port("force", (4,), "N, N m", "disturbance force in {E} and yaw moment"),
    )
)
PLANT_PARAMETERS = Layout(
    (
        Port("mass", (4,), "kg, kg m^2", "diagonal of M: rigid-body and added mass"),
        Port("linear_drag", (4,), "N s/m, N m s", "linear drag Xu, Yv, Zw, Nr"),
        Port("quadratic_drag", (4,), "N s^2/m^2, N m s^2", "quadratic drag Xuu, Yvv, Zww, Nrr"),
        Port("thrust_limit", (4,), "N, N m", "largest thrust on each axis, in both directions"),
        Port("thrust_lag", (1,), "s", "time constant of the first-order thrust lag; 0 for none"),
    )
)


PAPER = PlantForm()
"""Equation (3) of the paper, without optional terms."""


def plant_layout(form: PlantForm = PAPER) -> Layout:
    """Return the layout of the plant's parameters: `PLANT_PARAMETERS`, followed by the optional terms of the form.

    Example:
        >>> from surctl.marine.vehicle import PlantForm, plant_layout
        >>> plant_layout().size, plant_layout(PlantForm(("m24", "Yr"))).port("terms").shape
        (17, (2,))
    """
    if not form.terms:
        return PLANT_PARAMETERS
    return Layout((*PLANT_PARAMETERS.ports, Port("terms", (len(form.terms),), "SI", ", ".join(form.terms))))


def plant_state(form: PlantForm = PAPER) -> Layout:
    """Return the layout of the plant's state: `PLANT_STATE`, and `_TILT_STATE` if the vehicle rolls and pitches.

    Example:
        >>> from surctl.marine.vehicle import PlantForm, plant_state
        >>> plant_state().size, plant_state(PlantForm(("mpp", "mqq", "weight", "buoyancy"))).size
        (12, 16)
    """
    return Layout((*PLANT_STATE.ports, *_TILT_STATE.ports)) if form.tilts else PLANT_STATE


def plant_parameters(vehicle: Vehicle) -> NDArray[np.float64]:
    """Return the parameters of a vehicle as a flat vector with the layout `plant_layout(vehicle.form)`.

    The vector has 17 entries, and one more for each optional term of the vehicle.

    Example:
        >>> from surctl.marine.vehicle import PLANT_PARAMETERS, load_vehicle, plant_parameters
        >>> numbers = plant_parameters(load_vehicle("sur400"))
        >>> numbers.size, PLANT_PARAMETERS.split(numbers)["mass"].tolist()
        (17, [50.0, 50.0, 50.0, 0.6])
    """
    form = vehicle.form
    values: dict[str, object] = {
        "mass": vehicle.mass,
        "linear_drag": vehicle.linear_drag,
        "quadratic_drag": vehicle.quadratic_drag,
        "thrust_limit": vehicle.delivered_limit,
        "thrust_lag": vehicle["thrust_lag"],
    }
    if form.terms:
        values["terms"] = [vehicle[name] for name in form.terms]
    return plant_layout(form).pack(values)


def _terms(p: dict[str, ca.SX], form: PlantForm) -> dict[str, ca.SX]:
    return {name: p["terms"][k] for k, name in enumerate(form.terms)}


def drag_of(nu: ca.SX, p: dict[str, ca.SX], form: PlantForm) -> ca.SX:
    """Return D(ν)ν (4,), or (6,) with roll and pitch [N, N m], for the velocity ν through the water."""
    terms = _terms(p, form)
    drag = ca.vertcat(_damping_force(nu[:4], p), ca.SX.zeros(nu.numel() - 4))
    for axis, by, name in form.drag():
        drag[axis] += terms[name] * (nu[by[0]] if len(by) == 1 else ca.fabs(nu[by[0]]) * nu[by[1]])
    return drag


def inertia_matrix(p: dict[str, ca.SX], form: PlantForm) -> ca.SX:
    """Return M (4, 4), or (6, 6) with roll and pitch, from the parameters by name."""
    inertia = ca.diagcat(ca.diag(p["mass"]), ca.SX(2, 2)) if form.tilts else ca.diag(p["mass"])
    terms = _terms(p, form)
    for i, j, name in form.inertia():
        inertia[i, j] = inertia[j, i] = terms[name]
    return inertia


def _load(nu: ca.SX, p: dict[str, ca.SX], form: PlantForm) -> ca.SX:
    # C(ν)ν + D(ν)ν (4,) [N, N m] for the velocity ν through the water, without roll and pitch
    drag = drag_of(nu, p, form)
    if not form.inertia():
        return _coriolis_force(nu, p) + drag
    return planar_turning(inertia_matrix(p, form) @ nu, nu) + drag


def planar_turning(momentum: ca.SX, nu: ca.SX) -> ca.SX:
    """Return C(ν)ν (4,) [N, N m] from the momenta M ν (4,) of a body without roll and pitch."""
    turning = nu[0] * momentum[1] - nu[1] * momentum[0]
    return ca.vertcat(-nu[3] * momentum[1], nu[3] * momentum[0], 0, turning)


def constant_force(p: dict[str, ca.SX], form: PlantForm) -> ca.SX:
    """Return the constant force (4,) [N, N m] in the heading frame from the parameters by name."""
    force, terms = ca.SX.zeros(4), _terms(p, form)
    for axis, name in form.constant():
        force[axis] += terms[name]
    return force


def _acceleration(load: ca.SX, p: dict[str, ca.SX], form: PlantForm) -> ca.SX:
    # M⁻¹ load, by LDLᵀ, in which the zeros of M cost nothing
    if not form.inertia():
        return load / p["mass"]
    diagonal, transposed, permutation = ca.ldl(inertia_matrix(p, form))
    return ca.ldl_solve(load, diagonal, transposed, permutation)


def _tilted(
    nu: ca.SX, tilt: ca.SX, current: ca.SX, thrust: ca.SX, outer: ca.SX, p: dict[str, ca.SX], form: PlantForm
) -> tuple[ca.SX, ca.SX]:
    # ν̇ and the rate of roll, pitch, p, q; `outer` is the force of waves and the like in the heading frame
    terms, inertia = _terms(p, form), inertia_matrix(p, form)

    def acceleration(through: ca.SX, rotation: ca.SX) -> ca.SX:
        load = _hull_load(through, inertia @ through, thrust, outer, rotation, terms) - drag_of(through, p, form)
        return _acceleration(load, p, form)

    return _tilted_rate(nu, tilt, current, acceleration)


def _damping_force(nu: ca.SX, p: dict[str, ca.SX]) -> ca.SX:
    """Return the drag D(ν)ν (4,) of equation (3): the sum of linear and quadratic drag on each axis [N, N m]."""
    return p["linear_drag"] * nu + p["quadratic_drag"] * nu * ca.fabs(nu)


def _coriolis_force(nu: ca.SX, p: dict[str, ca.SX]) -> ca.SX:
    """Return the Coriolis term C(ν)ν (4,) of a diagonal M: (−m22 v r, m11 u r, 0, (m22 − m11) u v) [N, N m]."""
    m = p["mass"]
    return ca.vertcat(-m[1] * nu[1] * nu[3], m[0] * nu[0] * nu[3], 0, (m[1] - m[0]) * nu[0] * nu[1])


@dataclass(frozen=True)
class Plant:
    """The differential equation of a vehicle, with every parameter as an input.

    Attributes:
        ode: function that computes ẋ (n,) from state x (n,), tau_command (4,), disturbance d (7,) and parameters p;
            `plant_state`, `PLANT_DISTURBANCE` and `plant_layout` name their entries; n is 12, with roll and pitch 16.
        jacobians: function with the arguments of `ode` that computes exact ∂ẋ/∂x (n, n) and ∂ẋ/∂tau_command (n, 4).
    """

    ode: ca.Function
    jacobians: ca.Function


def build_plant(form: PlantForm = PAPER) -> Plant:
    """Return the differential equation of a vehicle; without optional terms, equations (1)–(3) of the paper.

    A constant irrotational current enters as ν_r = ν − ν_c in every hydrodynamic and inertial term (Fossen 2021,
    property 10.1). In the body frame {B}, the current vector ν_c rotates at −r, opposite to the vehicle's yaw rate r.

    Example:
        >>> from surctl.marine.vehicle import PLANT_DISTURBANCE, PLANT_STATE
        >>> from surctl.marine.vehicle import build_plant, load_vehicle, plant_parameters
        >>> craft = load_vehicle("otter")
        >>> x, still = PLANT_STATE.pack({"nu": [0.7, 0.1, 0.0, 0.2]}), PLANT_DISTURBANCE.pack()
        >>> rate = build_plant(craft.form).ode(x, [0, 0, 0, 0], still, plant_parameters(craft))
        >>> rate[4:8].full().ravel().round(3).tolist()  # m/s², rad/s²
        [-0.848, -0.108, 0.0, -0.776]
    """
    return _plant(form)


@cache
def _plant(form: PlantForm) -> Plant:
    x, state = plant_state(form).symbols("x")
    d, disturbance = PLANT_DISTURBANCE.symbols("d")
    p, parameters = plant_layout(form).symbols("p")
    command = ca.SX.sym("tau_command", 4)
    nu, psi = state["nu"], state["eta"][3]

    limit, lag = parameters["thrust_limit"], parameters["thrust_lag"]
    least = -limit
    for axis, name in form.reverse():
        least[axis] = -_terms(parameters, form)[name]
    saturated = ca.fmin(ca.fmax(command, least), limit)
    lagged = lag > 0
    thrust = ca.if_else(lagged, state["tau"], saturated)
    thrust_rate = ca.if_else(lagged, (saturated - state["tau"]) / ca.fmax(lag, 1e-3), 0)

    to_body = planar_rotation(psi).T
    current = ca.vertcat(to_body @ disturbance["current"][:2], disturbance["current"][2], 0)
    current_rate = ca.vertcat(nu[3] * current[1], -nu[3] * current[0], 0, 0)
    force = ca.vertcat(to_body @ disturbance["force"][:2], disturbance["force"][2:])
    nu_r = nu - current
    if form.tilts:
        outer = force + constant_force(parameters, form)
        moved, tilted = _tilted(nu, state["tilt"], current[:3], thrust, outer, parameters, form)
        rate = ca.vertcat(jacobian(psi) @ nu, moved, thrust_rate, tilted)
    elif form.terms:
        load = thrust + force + constant_force(parameters, form) - _load(nu_r, parameters, form)
        rate = ca.vertcat(jacobian(psi) @ nu, _acceleration(load, parameters, form) + current_rate, thrust_rate)
    else:  # in the order of equation (3), so that the results of the paper's plant keep their bits
        load = thrust + force - _coriolis_force(nu_r, parameters) - _damping_force(nu_r, parameters)
        rate = ca.vertcat(jacobian(psi) @ nu, load / parameters["mass"] + current_rate, thrust_rate)

    names = ["x", "tau_command", "d", "p"]
    arguments = [x, command, d, p]
    return Plant(
        ca.Function("ode", arguments, [rate], names, ["rate"]),
        ca.Function("jacobians", arguments, [ca.jacobian(rate, x), ca.jacobian(rate, command)], names, ["A", "B"]),
    )


def check_equation_3(vehicle: Vehicle, *, reverse: bool = False) -> None:
    """Raise NotApplicable if the vehicle has optional terms, because a claim about equation (3) does not cover them.

    With `reverse`, the claim covers less thrust astern than ahead.
    """
    form = vehicle.form
    terms = [name for name in form.terms if not (reverse and name in [limit for _, limit in form.reverse()])]
    if terms:
        listed = ", ".join(terms[:4]) + (" and further terms" if len(terms) > 4 else "")
        raise NotApplicable(f"it has {listed}, and the claim assumes equation (3) of the paper, without them")


def trim_thrust(vehicle: Vehicle, nu: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the trim thrust τ = C(ν)ν + D(ν)ν (4,) [N, N m], which holds the body velocity ν (4,) in still water.

    The constant forces of the vehicle are subtracted. A vehicle that rolls and pitches has the trim thrust at the
    attitude that it takes up.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.vehicle import load_vehicle, trim_thrust
        >>> trim_thrust(load_vehicle("sur400"), np.array([0.15, 0.0, 0.0, 0.2])).round(3).tolist()
        [0.964, 1.5, 0.0, 0.064]
    """
    return np.asarray(trim_function(vehicle.form)(nu, plant_parameters(vehicle))[0]).reshape(4)


@cache
def trim_function(form: PlantForm = PAPER) -> ca.Function:
    """Return a CasADi function of (ν, p) that computes trim thrust (4,), and `_TILT_STATE` (4,) of that motion or 0.

    ν and p may have one column for each plant.
    """
    flat, parameters = plant_layout(form).symbols("p")
    velocity = ca.SX.sym("nu", 4)
    if not form.tilts:
        trim = _load(velocity, parameters, form) - constant_force(parameters, form)
        return ca.Function("trim", [velocity, flat], [trim, ca.SX.zeros(4)])
    free = ca.SX.sym("free", 8)  # thrust, attitude
    outer = constant_force(parameters, form)
    moved, tilted = _tilted(velocity, free[4:], ca.SX.zeros(3), free[:4], outer, parameters, form)
    missed = ca.Function("missed", [free, velocity, flat], [ca.vertcat(moved, tilted)])
    solver = ca.rootfinder("solver", "newton", missed, {"error_on_fail": False, "abstol": 1e-12})
    arguments = ca.MX.sym("nu", 4), ca.MX.sym("p", flat.numel())
    root = solver(ca.MX.zeros(8), *arguments)
    return ca.Function("trim", list(arguments), [root[:4], root[4:]])


def steady_speed(force: float, linear: float, quadratic: float) -> float:
    """Return the speed u [m/s] at which the drag X u + X₂ u² equals the force F ≥ 0 [N].

    The speed is u = 2 F / (X + √(X² + 4 X₂ F)), with F = `force`, X = `linear` and X₂ = `quadratic`.

    It is NaN for numbers that are NaN, or for which there is no such speed.

    Example:
        >>> from surctl.marine.vehicle import load_vehicle, steady_speed
        >>> boat = load_vehicle("sur400")
        >>> round(steady_speed(boat["Fu_max"], boat["Xu"], boat["Xuu"]), 3)  # m/s at full thrust
        0.379
    """
    inner = linear * linear + 4 * quadratic * force
    root = linear + sqrt(inner) if inner >= 0 else nan
    if root == 0:
        return 0.0 if quadratic else inf
    return 2 * force / root


_NEEDED = ("mass", "linear_drag", "quadratic_drag", "thrust_limit")


def plant_thrust_limit(
    nu: Expression,
    parameters: Mapping[str, Expression],
    *,
    dt: Expression,
    water: Expression = (0.0, 0.0, 0.0),
    force: Expression = (0.0, 0.0, 0.0, 0.0),
    name: str = "thrust",
) -> ThrustLimit:
    """Return the thrust limit for the Coriolis and drag forces of the vehicle model.

    Args:
        nu: (4,) present velocity over ground in the body frame {B} [m/s, rad/s].
        parameters: `mass`, `linear_drag`, `quadratic_drag` and `thrust_limit`, each (4,), as numbers or SX; see
            `PLANT_PARAMETERS`. Other parameters are ignored.
        dt: time in which the vehicle is to reach v [s].
        water: (3,) velocity of the water in {B} [m/s], that is, the current rotated from the earth frame to {B}.
            Forces depend on the velocity relative to the water, and the water's velocity rotates in {B} at the
            negative yaw rate.
        force: (4,) known force on the vehicle in {B} [N, N m].
        name: name of the limit.

    Raises:
        InputError: a parameter is missing, or `ThrustLimit` rejects a value.

    Example:
        >>> from surctl.marine.vehicle import PLANT_PARAMETERS, load_vehicle, plant_parameters, plant_thrust_limit
        >>> numbers = PLANT_PARAMETERS.unpack(plant_parameters(load_vehicle("sur400")))
        >>> limit = plant_thrust_limit([0.1, 0, 0, 0], numbers, dt=0.05)
        >>> [row.name for row in limit.rows()]
        ['thrust.Fu', 'thrust.Fv', 'thrust.Fw', 'thrust.Fr']
    """
    for key in _NEEDED:
        if key not in parameters:
            raise InputError("is missing", key=f"limit {name}: {key}", remedy=nearest(key, parameters))
    p = {key: checked_column(f"limit {name}: {key}", parameters[key], 4, finite=True) for key in _NEEDED}
    velocity = checked_column(f"limit {name}: nu", nu, 4, finite=True)
    current = checked_column(f"limit {name}: water", water, 3, finite=True)
    relative = velocity - ca.vertcat(current, 0)
    turning = ca.vertcat(velocity[3] * current[1], -velocity[3] * current[0], 0, 0)
    load = _coriolis_force(relative, p) + _damping_force(relative, p) - p["mass"] * turning
    load -= checked_column(f"limit {name}: force", force, 4, finite=True)
    most = p["thrust_limit"]
    return ThrustLimit(velocity, p["mass"], load=load, lower=-most, upper=most, dt=dt, name=name)

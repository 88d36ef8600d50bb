"""The linear loop of a law about a straight cruise, for many vehicles, gains, speeds at once; states of lag, rudder.

The law that runs is differentiated: the derivatives of its list of instructions about the cruise are one expression of
its parameters, which is evaluated at all points together. The plant is continuous, with thrust lag; thrust commands are
held over a control period and computed one period before they act. All quantities are deviations from a cruise along x
at the speed U, far from the ends of the path, obstacles and walls.

A state of the law belongs to the loop if the measurements change it and it changes the thrust. An axis that the law
leaves alone (heave without heave force), and a coordinate that changes nothing, do not belong to the loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.ir.symbolic import on_columns
from surctl.marine.control import PATH_FOLLOWING, Gains, Law, build_law, law_source, load_gains
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import Path
from surctl.marine.vehicle import PLANT_PARAMETERS, PlantForm, Vehicle, plant_parameters
from surctl.marine.vehicle.dynamics import trim_function
from surctl.marine.vehicle.linearise import (
    SIGNAL_UNITS,
    STATE_NAMES,
    TILT_NAMES,
    can_hold,
    check_cruise,
    plant_jacobians,
)
from surctl.system import entry_labels
from surctl.system.linear_loop import LinearLoop, LoopNames, delayed

Array = NDArray[np.float64]

THRUSTS, POSE = ("surge", "sway", "heave", "yaw"), STATE_NAMES[:4]
"""Signals at which loops are opened: the thrust commands, and the measured x, y, z, ψ."""

LINEAR_GAINS = ("k1", "k2", "k_psi", "k_r", "k_v", "lookahead")

TRACKING_LAW = "guarded"
"""A law whose loop about a straight cruise is that of every law for which `has_cruise_loop` holds."""

FAR = 1e6  # [m]
_PATH = Path(np.array([[-FAR, 0.0], [FAR, 0.0]]))
_SITE = (-2 * FAR, 2 * FAR, -2 * FAR, 2 * FAR)
COUPLED = 1e-9  # largest derivative that counts as none
NEUTRAL = 1e-4  # the same for x and y, as a share of the larger: the heading of a run is not exact
_HEADROOM = 1.5  # speed cap over the cruise speed: the cap must not act in a cruise
AXES = len(THRUSTS)


def has_cruise_loop(law: str, guidance: str) -> bool:
    """Return whether a law with a guidance tracks a straight cruise with the loop that `LINEAR_GAINS` determine.

    Guidance with an internal state has gains of its own.
    """
    return guidance == "los" and PATH_FOLLOWING in law_source(law).parts


def cruise_loop(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    law: str = TRACKING_LAW,
) -> LinearLoop:
    """Return the loop of a plant and a law, linearised at the cruise speed.

    Args:
        vehicle: the plant.
        gains: the gains by name; those of `LINEAR_GAINS` must be among them, and k_i [1/s²] for integral action.
        cruise: cruise speed U [m/s], > 0.
        dt: control period [s], > 0.
        model: the controller's model of the vehicle; default the vehicle itself.
        law: a law for which `has_cruise_loop` holds.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot cruise at that speed or has no sway force.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import cruise_loop
        >>> loop = cruise_loop(load_vehicle("sur400"), load_gains("default").values, cruise=0.15, dt=0.05)
        >>> loop.stable, loop.transition.shape, round(float(loop.rates.real.max()), 2)
        (True, (16, 16), -0.22)
    """
    _check_positive({"cruise": cruise, "dt": dt})
    for craft in (vehicle, model or vehicle):
        if not craft["Fv_max"] > 0:
            problem = f"the law moves in any direction, but {craft.name} has no sway force"
            raise InputError(problem, key="Fv_max", value=craft["Fv_max"], remedy="use law_loop with the law steered")
    check_cruise(vehicle, cruise)
    ((_, loops),) = cruise_groups([CruisePoint(vehicle, model or vehicle, gains, cruise)], dt=dt, law=law)
    return loops[0]


class CruisePoint(NamedTuple):
    """A vehicle, the controller's model of it, gains by name as for `cruise_loop`, and a cruise speed [m/s]."""

    plant: Vehicle
    model: Vehicle
    gains: Mapping[str, float]
    cruise: float


def cruise_groups(
    points: Sequence[CruisePoint], *, dt: float, law: str = TRACKING_LAW, most: int | None = None
) -> Iterator[tuple[NDArray[np.intp], LinearLoop]]:
    """Yield the points whose plant holds the speed, in groups with equal states, and their loops along a leading axis.

    Args:
        points: the points; the plants have equal optional terms.
        dt: control period [s].
        law: a law for which `has_cruise_loop` holds.
        most: largest number of points in a group.

    Raises:
        InputError: a gain is missing or not positive.
    """
    plants, numbers = np.array([plant_parameters(point.plant) for point in points]), []
    known: dict[tuple[int, int, float], Array] = {}  # the corners of a vehicle have one law
    for point in points:
        key = id(point.model), id(point.gains), point.cruise
        if key not in known:
            known[key] = law_numbers(point.model, _law_gains(law, point), cruise=point.cruise)
        numbers.append(known[key])
    lagged = plants[:, PLANT_PARAMETERS.slice("thrust_lag")][:, 0] > 0
    kind = lagged + 2 * np.array([point.gains.get("k_i", 0.0) > 0 for point in points])
    form, speed, built = points[0].plant.form, np.array([point.cruise for point in points]), build_law(law)
    able = _held(plants, speed, form)
    for group in (np.flatnonzero(able & (kind == k)) for k in range(4)):
        for at in (group[k : k + (most or len(points))] for k in range(0, len(group), most or len(points))):
            A, B, C, D = law_slopes(built, np.array([numbers[k] for k in at]))
            nu = np.zeros((len(at), 4))
            nu[:, 0] = speed[at]
            ratio, eye = dt / built.dt, np.eye(built.state.size)  # the law's state changes in proportion to the period
            slopes = eye + ratio * (A - eye), ratio * B, C, D
            yield at, assembled(plants[at], nu, slopes, built, form=form, dt=dt)[0]


def each_loop(points: Sequence[CruisePoint], *, dt: float, law: str = TRACKING_LAW) -> list[LinearLoop | None]:
    """Return the loop of each point, None if its plant cannot hold the speed; for the arguments see `cruise_groups`."""
    loops: list[LinearLoop | None] = [None] * len(points)
    for at, group in cruise_groups(points, dt=dt, law=law) if points else ():
        for k, place in enumerate(at.tolist()):
            loops[place] = group[k]
    return loops


def _law_gains(law: str, point: CruisePoint) -> Gains:
    # a cruise far from everything depends on no gains but those of `LINEAR_GAINS` and k_i
    for name in LINEAR_GAINS:
        if name not in point.gains:
            raise InputError("gain is missing", key=name, remedy=nearest(name, point.gains))
    _check_positive({"cruise": point.cruise})
    return _some_gains(law).with_values(
        {name: point.gains[name] for name in (*LINEAR_GAINS, "k_i") if name in point.gains}
    )


@cache
def _some_gains(law: str) -> Gains:
    return load_gains("default", own=law_source(law).gains)


def assembled(
    plants: Array,
    nu: Array,
    slopes: tuple[Array, ...],
    law: Law,
    *,
    form: PlantForm,
    dt: float,
    psi: float = 0.0,
    current: Sequence[float] | Array = (0.0, 0.0),
    delivered: Array | None = None,
) -> tuple[LinearLoop, list[int]]:
    """Return the loops of n plants and a law about steady motions, and which coordinates nothing depends on.

    The thrusts act one period late; those that wait are the last states of the law.

    Args:
        plants, nu, psi, form, current: the plants and their motions, as for `plant_jacobians`.
        slopes: A, B, C and D (n, …) of z⁺ = A z + B y and thrust = C z + D y, as `law_slopes`.
        law: the law.
        dt: control period [s].
        delivered: derivative (4, 4) of the delivered thrust by the command of one law, whose loop is then without
            coordinates on which nothing depends; None: the command is delivered, and all coordinates matter.
    """
    (A, plant_B, _), (Az, By, Cz, D) = plant_jacobians(plants, nu, psi=psi, form=form, current=current), slopes
    J = np.eye(AXES) if delivered is None else delivered
    B = plant_B @ J
    Cz, D, acting = _thrust_rows(Cz, D, plants[:, PLANT_PARAMETERS.slice("thrust_limit")])
    pushed = np.abs(J[:, acting]).max(axis=1, initial=0.0) > COUPLED
    moving = _moving_states(A, pushed, lagged=bool(plants[0, PLANT_PARAMETERS.slice("thrust_lag")][0] > 0))
    free = [] if delivered is None else _free(A[0], By[0], Cz[0], D[0], Az[0], [k for k in moving if k < 4])
    moving = [k for k in moving if k not in free]
    outputs, driven = [k for k in moving if k < 8], np.flatnonzero(acting).tolist()
    own = in_loop(Az, By[..., outputs], Cz)

    def part(matrix: Array, rows: Sequence[int], columns: Sequence[int]) -> Array:
        return matrix[:, list(rows), :][..., list(columns)]

    def none(rows: Sequence[Any]) -> Array:
        return np.zeros((len(plants), len(rows), 0))

    axes, names = [THRUSTS[k] for k in driven], (*STATE_NAMES, *TILT_NAMES)
    measured, inner = [names[k] for k in outputs], entry_labels(law.state)
    measures = np.tile(np.eye(len(names))[np.ix_(outputs, moving)], (len(plants), 1, 1))
    plant = part(A, moving, moving), part(B, moving, driven), none(moving), measures, none(outputs)
    direct = part(Az, own, own), part(By, own, outputs), none(own), part(Cz, driven, own), part(D, driven, outputs)
    units = [(f"command.{axis}", "N m" if axis == "yaw" else "N") for axis in axes]
    units += [(f"measured.{name}", SIGNAL_UNITS[name]) for name in measured]
    pose = tuple(name for name in measured if name in POSE)
    labels = LoopNames(
        "craft", law.name, tuple(names[k] for k in moving),
        (*(inner[k] for k in own), *(f"late_{axis}" for axis in axes)), tuple(axes), tuple(axes), tuple(measured),
        units=tuple(units), places=(("commands", tuple(axes)), *([("measurements", pose)] if pose else [])),
    )  # fmt: skip
    return LinearLoop(plant, delayed((*direct, none(axes))), labels, dt), free


def _thrust_rows(C: Array, D: Array, limits: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    # C and D (…, 4, n) of the thrust without axes that have no limit (…, 4), and whether each axis acts (4,)
    can = limits.reshape(-1, AXES).max(axis=0)[:, None] > 0
    C, D = C * can, D * can
    sizes = np.abs(np.concatenate([C, D], axis=-1))
    return C, D, sizes.reshape(-1, AXES, sizes.shape[-1]).max(axis=(0, 2)) > COUPLED


def _held(plants: Array, cruise: ArrayLike, form: PlantForm) -> NDArray[np.bool_]:
    # whether the thrust of each plant (n, …) holds its cruise speed [m/s], a number or (n,)
    nu = np.zeros((len(plants), 4))
    nu[:, 0] = cruise
    trim = np.asarray(trim_function(form)(nu.T, plants.T)[0]).T
    most = plants[:, PLANT_PARAMETERS.slice("thrust_limit")]
    least = -most  # a copy
    for axis, name in form.reverse():
        least[:, axis] = -plants[:, PLANT_PARAMETERS.size + form.terms.index(name)]
    return can_hold(trim, least, most)


def _moving_states(A: Array, acting: Array, *, lagged: bool) -> list[int]:
    # places of the states of plants A (…, n, n) that belong to the loop, for axes (4,) that act, with or without lag
    tilt = range(len(STATE_NAMES), A.shape[-1])
    # x, y and psi follow the surge, sway and yaw motion; the depth, and heave without coupling, stand alone
    coupled = bool((A[..., [4, 5, 7, *tilt], 6] != 0).any())
    apart = [] if acting[2] else [2] if coupled else [2, 6]
    return [*(k for k in range(8) if k not in apart), *(8 + k for k in range(AXES) if lagged and acting[k]), *tilt]


def _free(A: Array, By: Array, Cz: Array, D: Array, Az: Array, coordinates: Sequence[int]) -> list[int]:
    # coordinates on which neither the law nor another state depends
    slope = np.abs(np.vstack([By[in_loop(Az, By, Cz)], D])).max(axis=0)
    felt = slope > np.maximum(COUPLED, np.where(np.arange(8) < 2, NEUTRAL * slope[:2].max(), 0.0))
    free: list[int] = []
    while True:
        others = [k for k in range(len(A)) if k not in free]
        more = [
            k for k in coordinates if k not in free and not felt[k] and not A[[o for o in others if o != k], k].any()
        ]
        if not more:
            return sorted(free)
        free += more


def law_numbers(model: Vehicle, gains: Gains, *, cruise: float) -> Array:
    """Return the law's parameters for a straight cruise in the middle of a path without end."""
    return law_parameters(gains, model, path=_PATH, depth=0.0, cruise=cruise, cap=_HEADROOM * cruise, walls=_SITE)


def law_slopes(law: Law, numbers: Array) -> tuple[Array, Array, Array, Array]:
    """Return A, B, C and D of z⁺ = A z + B y and thrust = C z + D y about a cruise, for parameters (n, …) of the law.

    y = (x, y, z, ψ, u, v, w, r); each of the matrices has a leading axis (n,).
    """
    size = law.state.size
    flat = _slopes(law)(numbers.T)[0].T
    J = flat.reshape(len(numbers), size + 8, size + AXES).swapaxes(1, 2)
    return J[:, :size, :size], J[:, :size, size:], J[:, size:, :size], J[:, size:, size:]


@lru_cache(maxsize=8)
def _slopes(law: Law) -> Callable[[Array], list[Array]]:
    # derivatives of the law at a cruise, column by column, as a function of its parameters
    p = ca.SX.sym("p", law.gains.size)
    numbers = ca.SX(p)
    for name, value in (("waypoints", _PATH.slots), ("walls", _SITE), ("depth", 0.0), ("launch", 0.0), ("visit", 0.0)):
        place = law.gains.slice(name)
        numbers[place.start : place.stop] = ca.DM(np.ravel(value, order="C"))
    z, y, start = ca.SX.sym("z", law.state.size), ca.SX.sym("y", 8), law.initial_state()
    cruise = p[law.gains.slice("cruise").start]
    start[law.state.slice("progress")] = FAR  # arc length of the path's middle
    at = ca.SX(ca.DM(start))
    if "surge" in law.state:  # in a cruise, a law that predicts its speed through the water has found it
        at[law.state.slice("surge").start] = cruise
    inputs = ca.SX(ca.DM(law.inputs.pack()))
    for k, name in ((0, "eta"), (4, "nu")):
        place = law.inputs.slice(name)
        inputs[place.start : place.stop] = y[k : k + 4]
    tau, following, *_ = law.function.expand()(z, inputs, numbers)
    whole = ca.jacobian(ca.vertcat(following, tau), ca.vertcat(z, y))
    slopes = ca.Function("slopes", [z, y, p], [ca.densify(whole)])
    about = ca.SX(8, 1)
    about[4] = cruise
    return on_columns(ca.Function("cruise", [p], [ca.vec(slopes(at, about, p))]))


def in_loop(A: Array, B: Array, C: Array) -> list[int]:
    """Return the states of a law, or of any of several, that the measurements reach and that reach the thrust."""
    n = A.shape[-1]
    links = np.abs(A).reshape(-1, n, n).max(axis=0, initial=0.0) > COUPLED
    reached = np.abs(B).reshape(-1, n, B.shape[-1]).max(axis=(0, 2), initial=0.0) > COUPLED
    reaches = np.abs(C).reshape(-1, C.shape[-2], n).max(axis=(0, 1), initial=0.0) > COUPLED
    for _ in range(n):
        reached = reached | (links @ reached)
        reaches = reaches | (links.T @ reaches)
    return [int(k) for k in np.flatnonzero(reached & reaches)]


def _check_positive(values: Mapping[str, float]) -> None:
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise InputError("must be greater than 0", key=name, value=float(value), remedy="correct it")

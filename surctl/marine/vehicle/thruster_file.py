"""Tables `[[thruster]]` and `[allocation]` of a vehicle file: keys, refusals; largest force on each axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isclose, radians
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from surctl.errors import InputError, mistakes_in, nearest
from surctl.files import Quantity, Strict, validate
from surctl.marine.vehicle.specs import AXES
from surctl.marine.vehicle.thrusters import (
    DEFAULT_ORDER,
    ORDERS,
    Actuators,
    Attainable,
    Fin,
    Swivel,
    Thruster,
    attainable,
)

_MOST = 16
_UNIT = 0.01  # allowed error of the length of a unit vector, because files round its entries
_FORM = 'write "44 N"'
_LIFT = "N s^2/m^2"
_LARGEST, _FARTHEST = 1e9, 1e6  # [N] of any thruster, [m]
_STALL = 45.0  # [deg] beyond it no blade has lift in proportion to its deflection


class _SwivelTable(Strict):
    axis: tuple[float, float, float]
    range_deg: tuple[float, float]
    rate_deg_per_s: float | None = Field(default=None, gt=0)


class _FinTable(Strict):
    lift: Quantity
    limit_deg: float


class _ThrusterTable(Strict):
    name: str = Field(min_length=1)
    at_m: tuple[float, float, float]
    direction: tuple[float, float, float] = Field(alias="push")
    forward: Quantity | None = None
    reverse: Quantity | None = None
    dead_band: float = Field(default=0.0, ge=0, lt=1)
    curve: tuple[tuple[float, float], ...] | None = None
    lag: Quantity | None = None
    swivel: _SwivelTable | None = None
    fin: _FinTable | None = None
    provenance: str = Field(min_length=1)


class _AllocationTable(Strict):
    order: tuple[str, ...] = DEFAULT_ORDER


class _Tables(Strict):
    thruster: tuple[_ThrusterTable, ...] = ()
    allocation: _AllocationTable | None = None


def read_actuators(thrusters: Sequence[Any], allocation: Mapping[str, Any] | None, *, source: str) -> Actuators | None:
    """Return the thrusters of a vehicle file, or None if it has none; `source` is the file's name in error messages."""
    data = {"thruster": list(thrusters), **({} if allocation is None else {"allocation": dict(allocation)})}
    tables = validate(data, _Tables, file=source)
    if not tables.thruster:
        if tables.allocation is not None:
            raise InputError("needs thrusters", file=source, key="allocation", remedy="add [[thruster]] tables")
        return None
    if len(tables.thruster) > _MOST:
        raise InputError(f"has more than {_MOST} entries", file=source, key="thruster", value=len(tables.thruster))
    read: list[Thruster] = []
    for k, table in enumerate(tables.thruster):
        with mistakes_in(source, f"thruster.{k}."):
            read.append(_thruster(table, names=[one.name for one in read]))
    order = DEFAULT_ORDER if tables.allocation is None else tables.allocation.order
    with mistakes_in(source, "allocation.order"):
        _check_order(order)
    return Actuators(tuple(read), order)


def common_lag(thrusters: Sequence[Any], *, known: float | None, source: str) -> float | None:
    """Return the time constant [s] that the tables state for all thrusters, or None if no table states one."""
    lag = known
    for k, table in enumerate(validate({"thruster": list(thrusters)}, _Tables, file=source).thruster):
        if table.lag is None:
            continue
        with mistakes_in(source, f"thruster.{k}.lag"):
            own = table.lag.within("s").value
        if not own >= 0 or (lag is not None and not isclose(own, lag, rel_tol=1e-9, abs_tol=1e-12)):
            raise InputError(
                "differs from the lag of the other thrusters or of [thrust]; thrusters with different lags would turn "
                "a force command into another direction for a while, which the plant does not model",
                file=source,
                key=f"thruster.{k}.lag",
                value=f"{own:g} s",
                remedy="give all thrusters one lag, of the slowest",
            )
        lag = own
    return lag


def axis_limits(actuators: Actuators, speed: float) -> NDArray[np.float64]:
    """Return the largest value (4,) [N, N m] on each axis alone, in both directions, at a forward speed [m/s]."""
    ends = axis_ends(actuators, speed)
    return np.minimum(-ends[:, 0], ends[:, 1])


def axis_ends(actuators: Actuators, speed: float = 1.0, *, failed: Sequence[str] = ()) -> NDArray[np.float64]:
    """Return (4, 2): least and largest force or moment on each axis alone [N, N m], at a forward speed [m/s].

    Fins count in yaw only: at rest they give no force. A rudder pushes sideways when it turns the craft, so yaw is the
    largest moment with 0 on the axes that other thrusters serve, whatever the force on the others.
    """
    on = np.array([float(name not in failed) for name in actuators.names])
    shares = on * actuators.shares(speed)
    if not actuators.fins:
        return _alone(attainable(actuators), shares)
    fixed = np.array([float(thruster.fin is None) for thruster in actuators.thrusters])
    ends = _alone(attainable(actuators), on * fixed)
    axes = tuple(axis for axis in range(4) if ends[axis, 0] < 0 < ends[axis, 1] or axis == _YAW)
    ends[_YAW] = _alone(attainable(actuators, axes), shares)[axes.index(_YAW)]
    return ends


def _alone(forces: Attainable, shares: NDArray[np.float64]) -> NDArray[np.float64]:
    ends = forces.intervals(working=shares)
    ends[np.abs(ends) < 1e-9 * forces.unit] = 0.0
    return ends


_YAW = 3


def _thruster(table: _ThrusterTable, *, names: Sequence[str]) -> Thruster:
    if table.name in names:
        raise InputError("names two thrusters", key="name", value=table.name, remedy="rename one of them")
    if not table.name.isprintable() or set(table.name) & set(":,= "):
        raise InputError("is not a name", key="name", value=table.name, remedy="use letters and digits, such as T1")
    if not max(map(abs, table.at_m)) <= _FARTHEST:
        problem = f"must be finite and within {_FARTHEST:g} m"
        raise InputError(problem, key="at_m", value=list(table.at_m), remedy="give the place in m")
    direction = _unit(table.direction, "push")
    if table.fin is not None:
        return _finned(table, table.fin, direction)
    if table.forward is None or table.reverse is None:
        raise InputError(
            "is missing", key="forward" if table.forward is None else "reverse", remedy=f'{_FORM}; a rudder has "fin"'
        )
    forward, reverse = _newtons(table.forward, "forward"), _newtons(table.reverse, "reverse")
    if forward <= 0:
        raise InputError(
            "gives no thrust: it must be greater than 0", key="forward", value=forward, remedy="turn `push` round"
        )
    if reverse < 0:
        raise InputError(
            "must be at least 0", key="reverse", value=reverse, remedy='give the magnitude; "0 N" for a water jet'
        )
    swivel = None if table.swivel is None else _swivel(table.swivel, direction, reverse)
    curve = _curve(table, forward, reverse)
    return Thruster(table.name, table.at_m, direction, forward, reverse, curve, swivel, table.provenance)


def _finned(table: _ThrusterTable, fin: _FinTable, direction: tuple[float, float, float]) -> Thruster:
    for key in ("forward", "reverse", "curve", "swivel", "dead_band"):
        if getattr(table, key) not in (None, 0.0):
            problem = "does not go with a fin, whose force follows from its lift and its deflection"
            raise InputError(problem, key=key, value=key, remedy=f"remove {key}")
    with mistakes_in(None, "fin.lift"):
        lift = fin.lift.within(_LIFT).value
    if not lift <= _LARGEST:
        raise InputError(f"must be at most {_LARGEST:g} {_LIFT}", key="fin.lift", value=lift, remedy="correct it")
    if lift <= 0:
        remedy = "give the force per (m/s)^2 and rad, and turn `push` round if it is negative"
        raise InputError("must be greater than 0", key="fin.lift", value=lift, remedy=remedy)
    if not 0 < fin.limit_deg <= _STALL:
        problem = f"must be greater than 0 and at most {_STALL:g}"
        remedy = "give the largest deflection to one side, below the stall angle"
        raise InputError(problem, key="fin.limit_deg", value=fin.limit_deg, remedy=remedy)
    if abs(direction[0]) > _UNIT:
        remedy = "give the normal of the blade in its middle position, such as [0, 1, 0]"
        raise InputError("is not across the hull", key="push", value=list(direction), remedy=remedy)
    blade = Fin(lift, radians(fin.limit_deg))
    most = blade.lift * blade.limit
    curve = ((-1.0, -most), (0.0, 0.0), (1.0, most))
    return Thruster(table.name, table.at_m, direction, most, most, curve, None, table.provenance, blade)


def _newtons(quantity: Quantity, key: str) -> float:
    with mistakes_in(None, key):
        force = quantity.within("N").value
    if not abs(force) <= _LARGEST:
        raise InputError(f"must be at most {_LARGEST:g} N", key=key, value=force, remedy="correct it")
    return force


def _unit(vector: tuple[float, float, float], key: str) -> tuple[float, float, float]:
    length = float(np.linalg.norm(vector))
    if abs(length - 1) > _UNIT:
        problem = "has no direction" if length == 0 and key == "push" else f"has length {length:.4g}, not 1"
        raise InputError(problem, key=key, value=list(vector), remedy="give a unit vector (forward, left, up)")
    x, y, z = (np.array(vector) / length).tolist()
    return x, y, z


def _swivel(table: _SwivelTable, direction: tuple[float, float, float], reverse: float) -> Swivel:
    axis = _unit(table.axis, "swivel.axis")
    if abs(float(np.dot(axis, direction))) > _UNIT:
        raise InputError(
            "is not at right angles to push", key="swivel.axis", value=list(axis), remedy="turn the axis or push"
        )
    exact = np.array(axis) - np.dot(axis, direction) * np.array(direction)
    x, y, z = (exact / np.linalg.norm(exact)).tolist()
    low, high = table.range_deg
    width = high - low
    if not (0 < width <= 180 or width == 360):
        problem = "must be up to 180 deg wide, or 360: the forces of any other range form no convex set"
        raise InputError(problem, key="swivel.range_deg", value=[low, high], remedy="give a narrower range")
    if reverse != 0:
        problem = "must be 0 N with a swivel: a sector and its opposite form no convex set"
        raise InputError(problem, key="reverse", value=f"{reverse:g} N", remedy='write "0 N", or remove the swivel')
    rate = None if table.rate_deg_per_s is None else radians(table.rate_deg_per_s)
    return Swivel((x, y, z), (radians(low), radians(high)), rate)


def _curve(table: _ThrusterTable, forward: float, reverse: float) -> tuple[tuple[float, float], ...]:
    if table.curve is None:
        band = table.dead_band
        points = [(-1.0, -reverse), (-band, 0.0), (band, 0.0), (1.0, forward)]
        return tuple(dict.fromkeys(points[1:] if reverse == 0 else points))
    curve = table.curve
    commands, forces = np.array(curve).T if len(curve) > 1 else (np.zeros(1), np.zeros(1))
    if len(curve) < 2 or np.any(np.diff(commands) <= 0) or np.any(np.diff(forces) < 0):
        raise InputError(
            "is not monotone", key="curve", value=[list(p) for p in curve], remedy="let command and force both increase"
        )
    flat = (np.diff(forces) == 0) & (forces[1:] != 0)
    if flat.any():
        k = int(np.flatnonzero(flat)[0])
        problem = f"is flat at {forces[k]:g} N: several commands give the same force"
        remedy = "only the dead band, at 0 N, may be flat"
        raise InputError(problem, key="curve", value=[list(curve[k]), list(curve[k + 1])], remedy=remedy)
    starts = -1.0 if reverse > 0 else float(commands[0])
    zero = float(np.interp(0.0, commands, forces))
    if commands[0] != starts or commands[0] > 0 or commands[-1] != 1 or zero != 0:
        problem = "must begin at command -1 (a water jet: at most 0), end at 1 and give 0 N at command 0"
        raise InputError(problem, key="curve", value=[list(p) for p in curve], remedy="add these points")
    for key, stated, end in (("forward", forward, forces[-1]), ("reverse", reverse, -forces[0])):
        if not isclose(stated, end, rel_tol=1e-6, abs_tol=1e-9):
            raise InputError(
                f"the curve ends at {abs(end):g} N", key=key, value=f"{stated:g} N", remedy="make them equal"
            )
    edges = commands[forces == 0]
    if table.dead_band and not isclose(float(edges.max(initial=0.0)), table.dead_band, rel_tol=1e-6):
        problem = f"the curve is 0 N up to command {edges.max(initial=0.0):g}"
        raise InputError(problem, key="dead_band", value=table.dead_band, remedy="make them equal, or remove dead_band")
    pinned = [list(point) for point in curve]
    pinned[-1][1], pinned[0][1] = forward, -reverse
    if reverse == 0:
        pinned[0][1] = 0.0
    return tuple((float(c), float(f)) for c, f in pinned)


def _check_order(order: tuple[str, ...]) -> None:
    for name in order:
        if name not in ORDERS:
            raise InputError("is not a level", value=name, remedy=nearest(name, ORDERS))
    if order[-1:] != ("effort",) or order.count("effort") > 1 or len(order) < 2:
        raise InputError("must end with effort", value=list(order), remedy='write ["yaw", "force", "effort"]')
    axes = [axis for name in order for axis in ORDERS[name]]
    for axis, name in enumerate(AXES[:4]):
        if axes.count(axis) != 1:
            how = "twice" if axes.count(axis) else "in no level"
            raise InputError(f"names {name} {how}", value=list(order), remedy="name each axis once")

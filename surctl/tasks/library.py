"""Functions that return common tasks: position, depth, heading, velocity, clearance, distance, line of sight."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import casadi as ca

from surctl.errors import InputError
from surctl.tasks.task import Expression, Task, checked_column, is_symbol

_NEAR = 1e-6
"""Distance [m] below which a direction is undefined; its derivative is then 0 and not NaN."""


def position_task(
    eta: ca.SX, target: Expression, *, rate: Expression = 0.0, gain: Expression = 1.0, name: str = "position"
) -> Task:
    """Return a task whose σ is the position (x, y) or (x, y, z) [m] in {E}, depending on the length of `target`.

    {E} is the earth frame, `rate` the desired velocity [m/s] in {E}, and `gain` the convergence gain [1/s].

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import position_task
        >>> eta = ca.SX.sym("eta", 4)
        >>> task = position_task(eta, [3.0, 0.0], gain=0.5)
        >>> rate = ca.Function("rate", [eta], [task.reference()])
        >>> rate([1.0, 0.5, 0, 0]).full().ravel().round(3).tolist()  # m/s in {E}
        [1.0, -0.25]
    """
    column = _vector(name, "target", target, (2, 3))
    return _of_pose(name, eta)(sigma=eta[: column.numel()], target=column, rate=rate, gain=gain, unit="m")


def depth_task(
    eta: ca.SX, z_d: Expression, *, rate: Expression = 0.0, gain: Expression = 1.0, name: str = "depth"
) -> Task:
    """Return a task whose σ is the height z [m], positive upwards, so a depth of 0.15 m is z_d = −0.15.

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import depth_task
        >>> eta = ca.SX.sym("eta", 4)
        >>> task = depth_task(eta, -0.15, gain=0.5)
        >>> rate = ca.Function("rate", [eta], [task.reference()])
        >>> rate([0, 0, -0.35, 0]).full().ravel().round(3).tolist()  # m/s, upwards
        [0.1]
    """
    return _of_pose(name, eta)(sigma=eta[2], target=z_d, rate=rate, gain=gain, unit="m")


def heading_task(
    eta: ca.SX, psi_d: Expression, *, rate: Expression = 0.0, gain: Expression = 1.0, name: str = "heading"
) -> Task:
    """Return a task whose σ is the heading ψ [rad], counter-clockwise from x; the robot turns by the smaller angle.

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import heading_task
        >>> eta = ca.SX.sym("eta", 4)
        >>> task = heading_task(eta, 3.0, gain=0.5)
        >>> rate = ca.Function("rate", [eta], [task.reference()])
        >>> rate([0, 0, 0, -3.0]).full().ravel().round(3).tolist()  # rad/s, by the smaller angle
        [-0.142]
    """
    return _of_pose(name, eta)(sigma=eta[3], target=psi_d, rate=rate, gain=gain, angular=True, unit="rad")


def velocity_task(eta: ca.SX, v_world: Expression, *, name: str = "velocity") -> Task:
    """Return a task that prescribes the horizontal velocity `v_world` (2,) [m/s] in the earth frame {E}, no position.

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import velocity_task
        >>> eta = ca.SX.sym("eta", 4)
        >>> task = velocity_task(eta, [0.1, 0.05])
        >>> rate = ca.Function("rate", [eta], [task.reference()])
        >>> rate([1.0, 0.5, 0, 0]).full().ravel().round(3).tolist()
        [0.1, 0.05]
    """
    return _of_pose(name, eta)(sigma=eta[:2], target=eta[:2], rate=_vector(name, "v_world", v_world, (2,)), unit="m")


def clearance_task(
    eta: ca.SX, echo_point: Expression, *, margin: Expression, gain: Expression = 1.0, name: str = "clearance"
) -> Task:
    """Return the avoidance task of one sensor, equation (17) of the paper with erratum E1: clearance σ from an echo.

    σ [m] is the distance from the echo point minus `margin`, and the task drives σ to 0. Its Jacobian is [−cos(φ − ψ),
    −sin(φ − ψ), 0, 0], where ψ is the heading and φ is the bearing of the echo point (2,) [m] in the earth frame {E}.
    `margin` [m] is the anti-collision radius.

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import clearance_task
        >>> eta = ca.SX.sym("eta", 4)
        >>> task = clearance_task(eta, [1.0, 0.0], margin=0.5, gain=0.4)
        >>> rate = ca.Function("rate", [eta], [task.reference()])
        >>> rate([0.8, 0, 0, 0]).full().ravel().round(3).tolist()  # m/s, away from the echo
        [0.12]
    """
    task = _of_pose(name, eta)
    sigma = _distance(eta, _vector(name, "echo_point", echo_point, (2,))) - _scalar(name, "margin", margin)
    return task(sigma=sigma, gain=gain, unit="m")


def distance_task(
    eta: ca.SX, point: Expression, *, distance: Expression, gain: Expression = 1.0, name: str = "distance"
) -> Task:
    """Return a task that holds the robot at the horizontal distance `distance` [m] from `point` (2,) [m].

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import distance_task
        >>> eta = ca.SX.sym("eta", 4)
        >>> task = distance_task(eta, [2.0, 0.0], distance=1.0, gain=0.5)
        >>> rate = ca.Function("rate", [eta], [task.reference()])
        >>> rate([0, 0, 0, 0]).full().ravel().round(3).tolist()  # m/s, negative: towards the point
        [-0.5]
    """
    task = _of_pose(name, eta)
    sigma = _distance(eta, _vector(name, "point", point, (2,)))
    return task(sigma=sigma, target=_scalar(name, "distance", distance), gain=gain, unit="m")


def line_of_sight_task(eta: ca.SX, point: Expression, *, gain: Expression = 1.0, name: str = "line_of_sight") -> Task:
    """Return a task that turns the bow towards `point` (2,) [m]; σ is the angle [rad] from the bow to the point.

    If the robot is at the point itself, this angle is undefined; the task then uses the direction of the x axis.

    Example:
        >>> import casadi as ca
        >>> from surctl.tasks import line_of_sight_task
        >>> eta = ca.SX.sym("eta", 4)
        >>> task = line_of_sight_task(eta, [1.0, 1.0], gain=0.6)
        >>> rate = ca.Function("rate", [eta], [task.reference()])
        >>> rate([0, 0, 0, 0]).full().ravel().round(3).tolist()  # rad/s, rate of the bearing
        [-0.471]
    """
    task = _of_pose(name, eta)
    offset = _vector(name, "point", point, (2,)) - eta[:2]
    near = ca.sumsqr(offset) < _NEAR**2
    bearing = ca.atan2(ca.if_else(near, 0.0, offset[1]), ca.if_else(near, 1.0, offset[0]))
    return task(sigma=bearing - eta[3], gain=gain, angular=True, unit="rad")


def _of_pose(name: str, eta: ca.SX) -> Callable[..., Task]:
    """Return a function that builds a task of the pose of a vehicle; raise InputError if `eta` is none."""
    if not is_symbol(eta) or eta.shape[0] != 4:
        remedy = 'write eta = ca.SX.sym("eta", 4) for x, y, z and heading, or a Task with your own sigma and kinematics'
        raise InputError("is not an SX symbol of shape (4, 1)", key=f"task {name}: eta", remedy=remedy)
    return partial(Task, name=name, eta=eta, kinematics="vehicle")


def _distance(eta: ca.SX, point: ca.SX) -> ca.SX:
    return ca.sqrt(ca.fmax(ca.sumsqr(point - eta[:2]), _NEAR**2))


def _vector(name: str, field: str, value: Expression, sizes: tuple[int, ...]) -> ca.SX:
    return checked_column(f"task {name}: {field}", value, *sizes)


def _scalar(name: str, field: str, value: Expression) -> ca.SX:
    return _vector(name, field, value, (1,))

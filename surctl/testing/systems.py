"""Check whether a user's plant or controller gives finite numbers, equal in CasADi and as instruction list."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.ir import Block, Layout, Port, on_vectors, replay
from surctl.system import NONFINITE, Controller, Cost, Plant, System
from surctl.system.controller import step_results
from surctl.system.parts import not_finite
from surctl.testing.ranges import CheckFailed, checked_count, checked_type

Array: TypeAlias = NDArray[np.float64]

_LIBM_ERROR = 1e-9  # the instruction list has polynomials in place of libm functions
_STEP = 1e-6


@dataclass(frozen=True)
class SystemReport:
    """Properties of a plant or controller that passed the check.

    Attributes:
        name: name of the plant or controller.
        samples: number of random points.
        form_error: largest difference between the instruction list and CasADi, relative to 1 + |value|.
        derivative_error: difference between CasADi's Jacobian and central differences, relative to 1 + |J|: the
            median over the points; 0 for a controller.
        digest: SHA-256 of what the plant or controller computes.
    """

    name: str
    samples: int
    form_error: float
    derivative_error: float
    digest: str


def check_plant(
    plant: Plant,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    samples: int = 200,
    smooth: float = 1e-4,
    seed: int = 0,
) -> SystemReport:
    """Check a plant at random points: derivatives and outputs are finite, CasADi and instruction list agree.

    Args:
        ranges: lowest and highest value of the entries of a port, by port name. Without it, states, inputs and
            disturbances lie in [-1, 1], and parameters have their nominal values.
        smooth: largest accepted error of the Jacobian with respect to the state, relative to 1 + |J|; the median over
            the points counts, so that isolated corners (limits, |x|) pass.

    Raises:
        CheckFailed: the plant fails; the message states where.
        InputError: a range names no port, or is no range.

    Example:
        >>> from surctl.testing import cart_system, check_plant
        >>> check_plant(cart_system().plant).form_error
        0.0
    """
    checked_count("samples", samples)
    checked_type(plant, Plant, key="check_plant")
    what = f"plant {plant.name}"
    layouts = {"x": plant.state, "f": plant.inputs, "d": plant.disturbances, "p": plant.parameters}
    points = _points(layouts, ranges or {}, fixed={"p"}, count=samples, seed=seed)
    symbols = [ca.SX.sym(name, layout.size) for name, layout in layouts.items()]
    x_, _, d_, p_ = symbols
    measure = ca.Function("measure", [x_, d_, p_], [plant.measurement(x_, d_, p_)])
    rates, outputs = [("derivative of", plant.state)], [("measured output", plant.measurements)]
    error = max(
        _compare(what, plant.block, plant.function, layouts, points, rates),
        _compare(what, plant.measured, measure, layouts, {name: points[name] for name in ("x", "d", "p")}, outputs),
    )
    slope_of = ca.densify(ca.jacobian(plant.function(*symbols), symbols[0]))
    slope, jacobian = on_vectors(plant.function), on_vectors(ca.Function("J", symbols, [slope_of]))
    worst = []
    for k in range(samples):
        x, *others = (points[name][k] for name in layouts)
        exact = jacobian(x, *others)[0].reshape(plant.state.size, -1, order="F")
        steps = _STEP * (1 + np.abs(x))
        columns = [(slope(x + h, *others)[0] - slope(x - h, *others)[0]) / (2 * h.sum()) for h in np.diag(steps)]
        difference = np.abs(exact - np.column_stack(columns))
        worst.append(float((difference / (1 + np.abs(exact))).max()))
    if np.median(worst) > smooth:
        k = int(np.argsort(worst)[samples // 2])
        raise CheckFailed(what, f"the Jacobian is off by {worst[k]:.2g}", at=_at(layouts, points, k))
    return SystemReport(plant.name, samples, error, float(np.median(worst)), plant.digest())


def check_controller(
    controller: Controller,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    samples: int = 200,
    seed: int = 0,
) -> SystemReport:
    """Check a controller at random points: finite results, no negative status, CasADi and instruction list agree.

    Args:
        ranges: lowest and highest value of the entries of a port, by port name. Without it, states and inputs lie in
            [-1, 1], and gains have their nominal values.

    Raises:
        CheckFailed: the controller fails; the message states where.
        InputError: a range names no port, or is no range.

    Example:
        >>> from surctl.testing import cart_system, check_controller
        >>> check_controller(cart_system().controller, ranges={"speed": (-3, 3)}).samples
        200
    """
    checked_count("samples", samples)
    checked_type(controller, Controller, key="check_controller")
    what = f"controller {controller.name}"
    layouts = {"x": controller.state, "u": controller.inputs, "p": controller.gains}
    points = _points(layouts, ranges or {}, fixed={"p"}, count=samples, seed=seed)
    symbols = [ca.SX.sym(name, layout.size) for name, layout in layouts.items()]
    action = ca.Function("action", symbols, list(controller.action(*symbols)))
    error = _compare(what, controller.block, action, layouts, points, step_results(controller))
    for k in range(samples):
        step = controller.step(*(points[name][k] for name in layouts))
        if step.status < 0:
            raise CheckFailed(what, f"the status is {step.status}", at=_at(layouts, points, k))
    bad = controller.step(*(np.full(layout.size, np.nan) for layout in layouts.values()))
    if controller.inputs.size and (bad.status != NONFINITE or np.any(bad.tau != 0)):
        raise CheckFailed(what, "an input that is not a number gives a command")
    return SystemReport(controller.name, samples, error, 0.0, controller.block.digest())


def _points(
    layouts: Mapping[str, Layout], ranges: Mapping[str, tuple[float, float]], *, fixed: set[str], count: int, seed: int
) -> dict[str, Array]:
    ports = [port.name for layout in layouts.values() for port in layout]
    for name, ends in ranges.items():
        if name not in ports:
            raise InputError("is not a port", key=f"ranges.{name}", remedy=nearest(name, ports))
        if not (np.isfinite(ends).all() and ends[0] <= ends[1]):
            raise InputError("is not a range", key=f"ranges.{name}", value=ends, remedy="give (lowest, highest)")
    rng = np.random.default_rng(seed)
    points = {}
    for key, layout in layouts.items():
        values = np.tile(layout.pack(), (count, 1))
        for port in layout:
            if port.name in ranges or key not in fixed:
                low, high = ranges.get(port.name, (-1.0, 1.0))
                values[:, layout.slice(port.name)] = rng.uniform(low, high, (count, port.size))
        points[key] = values
    return points


def _compare(
    what: str,
    block: Block,
    direct: ca.Function,
    layouts: Mapping[str, Layout],
    points: Mapping[str, Array],
    results: Sequence[tuple[str, Layout]],
) -> float:
    """Return the largest relative difference between the instruction list and CasADi with C library functions."""
    listed = replay(block, *points.values())
    function = on_vectors(direct.expand())
    largest = 0.0
    for k in range(len(next(iter(points.values())))):
        direct_results = function(*(values[k] for values in points.values()))
        for table, expected, (kind, layout) in zip(listed, direct_results, results, strict=True):
            row = table[k]
            if lost := not_finite([(kind, layout, row + expected)]):
                raise CheckFailed(what, f"{lost} is not finite", at=_at(layouts, points, k))
            if row.size:
                largest = max(largest, float((np.abs(row - expected) / (1 + np.abs(expected))).max()))
        if largest > _LIBM_ERROR:
            raise CheckFailed(what, f"instruction list and CasADi differ by {largest:.2g}", at=_at(layouts, points, k))
    return largest


def _at(layouts: Mapping[str, Layout], points: Mapping[str, Array], k: int) -> str:
    return ", ".join(
        f"{port.name} = {np.round(points[key][k][layouts[key].slice(port.name)], 4).tolist()}"
        for key in points
        for port in layouts[key]
    )


_SPEED, _FORCE = Port("speed", (1,), "m/s", "of the cart", 1.0), Port("force", (1,), "m/s^2", "over the mass")
_COSTS: Mapping[str, Cost] = {"way": Cost(lambda s: s.x["speed"], "integral", "m")}


def cart_system(k: float = 1.0, *, costs: Mapping[str, Cost] = _COSTS) -> System:
    """Return the system of the examples: a cart that rolls at 1 m/s and is braked at 10 Hz with the gain k [1/s].

    The plant has the state `speed` and the command `force` over its mass; the gain `k` can be changed.

    Example:
        >>> from surctl.system import run_system
        >>> from surctl.testing import cart_system
        >>> round(run_system(cart_system(), 2.0).figures["way"], 2)
        0.88
    """
    cart = Plant("cart", Layout((_SPEED,)), Layout((_FORCE,)), lambda x, f, d, p: {"speed": f["force"]})
    gains = Layout((Port("k", (1,), "1/s", "gain", k),))
    brake = Controller(
        "brake", 0.1, Layout((_SPEED,)), Layout((_FORCE,)), lambda x, u, p: -p["k"] * u["speed"], gains=gains
    )
    return System(cart, brake, costs=costs)

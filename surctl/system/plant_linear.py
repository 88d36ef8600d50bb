"""Linearisation of a plant alone about a point, with exact Jacobians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError
from surctl.ir import Layout
from surctl.system.parts import entry_labels
from surctl.system.plant import Plant

__all__ = ["linearise_plant", "plant_matrices", "plant_slopes", "state_space"]

Array = NDArray[np.float64]


def linearise_plant(
    plant: Plant,
    x: Mapping[str, ArrayLike] | ArrayLike = (),
    f: Mapping[str, ArrayLike] | ArrayLike = (),
    *,
    d: Mapping[str, ArrayLike] | ArrayLike = (),
    p: Mapping[str, ArrayLike] | ArrayLike = (),
) -> Any:
    """Return the linear plant about a point as `control.StateSpace`, for a design without a controller, such as LQR.

    Its inputs are actuator commands, then disturbances; its outputs are the measured outputs; all have the names of the
    plant's ports. The point need not be an equilibrium.

    Args:
        plant: the plant.
        x: state at the point: values by port name, or a flat vector; a port without a value has its default.
        f: actuator commands, in the same way.
        d: disturbances, in the same way.
        p: parameters, in the same way.

    Raises:
        InputError: a name or size does not fit the plant, or a derivative is not finite at the point.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Plant, linearise_plant
        >>> angle, rate = Port("angle", (1,), "rad", "from upright"), Port("rate", (1,), "rad/s", "angular rate")
        >>> torque = Port("torque", (1,), "1/s^2", "over the inertia")
        >>> pendulum = Plant(
        ...     "pendulum", Layout((angle, rate)), Layout((torque,)),
        ...     lambda x, f, d, p: {"angle": x["rate"], "rate": 9.81 * ca.sin(x["angle"]) + f["torque"]},
        ... )
        >>> hanging = linearise_plant(pendulum, {"angle": 3.14159265})
        >>> hanging.A.round(2).tolist(), hanging.input_labels
        ([[0.0, 1.0], [-9.81, 0.0]], ['torque'])
    """
    layouts = {"x": plant.state, "f": plant.inputs, "d": plant.disturbances, "p": plant.parameters}
    point = [_flat(layouts[name], part, name) for name, part in zip("xfdp", (x, f, d, p), strict=True)]
    matrices = plant_matrices(plant, *point)
    if not all(np.isfinite(matrix).all() for matrix in matrices):
        raise InputError("has no finite derivatives at this point", key=plant.name, remedy="choose another point")
    return state_space(plant, matrices)


def plant_matrices(plant: Plant, x: Array, f: Array, d: Array, p: Array) -> tuple[Array, ...]:
    """Return (A, B, E, C, D) of a plant about a flat point: x' = A x + B f + E d and y = C x + D d."""
    return tuple(np.array(m) for m in plant_slopes(plant).call([x, f, d, p]))


def plant_slopes(plant: Plant) -> ca.Function:
    """Return the function of x, f, d and p that computes the matrices of `plant_matrices`."""
    layouts = {"x": plant.state, "f": plant.inputs, "d": plant.disturbances, "p": plant.parameters}
    x, f, d, p = (ca.SX.sym(name, layout.size) for name, layout in layouts.items())
    rate, y = plant.derivative(x, f, d, p), plant.measurement(x, d, p)
    jacobians = [ca.jacobian(rate, v) for v in (x, f, d)] + [ca.jacobian(y, v) for v in (x, d)]
    return ca.Function("plant", [x, f, d, p], jacobians)


def state_space(plant: Plant, matrices: Sequence[Array]) -> Any:
    """Return matrices (A, B, E, C, D) of a plant as `control.StateSpace` with the names of its ports."""
    import control  # takes seconds to import

    A, B, E, C, D = matrices
    return control.ss(
        A, np.hstack([B, E]), C, np.hstack([np.zeros((len(C), B.shape[1])), D]), states=entry_labels(plant.state),
        inputs=[*entry_labels(plant.inputs), *entry_labels(plant.disturbances)],
        outputs=entry_labels(plant.measurements, "measured "), name=plant.name,
    )  # fmt: skip


def _flat(layout: Layout, values: Mapping[str, ArrayLike] | ArrayLike, key: str) -> Array:
    if isinstance(values, Mapping):
        return layout.pack(values)
    vector = np.asarray(values, dtype=float).reshape(-1)
    if not vector.size:
        return layout.pack()
    if vector.size != layout.size:
        raise InputError(f"has {vector.size} numbers", key=key, remedy=f"give {layout.size}, or values by port name")
    return vector

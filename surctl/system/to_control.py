"""Plants, controllers and linear loops of surctl as systems of python-control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.system.controller import SampledController
from surctl.system.linear_loop import LinearLoop
from surctl.system.loop import System
from surctl.system.parts import entry_labels
from surctl.system.plant import Plant

__all__ = ["to_control"]

Array = NDArray[np.float64]


def to_control(part: Any) -> Any:
    """Return a plant or controller as `control.NonlinearIOSystem`, and a linear loop as `control.StateSpace`.

    The inputs of a plant are its commands, then its disturbances; those of a controller are its inputs. Gains and
    parameters have their default values.

    Raises:
        InputError: the object is none of these.

    Example:
        >>> import control
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Plant, to_control
        >>> level, flow = Port("level", (1,), "m", "of the water"), Port("flow", (1,), "m/s", "inflow over the area")
        >>> tank = Plant("tank", Layout((level,)), Layout((flow,)), lambda x, f, d, p: f["flow"] - x["level"])
        >>> control.linearize(to_control(tank), [1.0], [1.0]).poles().real
        array([-1.])
    """
    import control  # takes seconds to import

    if isinstance(part, LinearLoop):
        return part.closed()
    if isinstance(part, Plant):
        return _plant_system(part)
    if isinstance(part, System) or not hasattr(part, "block"):
        remedy = "give a Plant, a Controller or a linear loop; linearise(system) is one"
        raise InputError(f"is a {type(part).__name__}", key="part", remedy=remedy)
    law: SampledController = part
    gains = law.gains.pack()

    def after(t: float, x: Array, u: Array, params: Mapping[str, Any]) -> Array:
        return law.step(x, u, gains).x_next

    def output(t: float, x: Array, u: Array, params: Mapping[str, Any]) -> Array:
        step = law.step(x, u, gains)
        return np.concatenate([step.tau, step.telemetry])

    return control.nlsys(
        after, output, dt=law.dt, name=law.name, inputs=entry_labels(law.inputs), outputs=entry_labels(law.outputs),
        states=entry_labels(law.state),
    )  # fmt: skip


def _plant_system(plant: Plant) -> Any:
    import control  # takes seconds to import

    p, size = plant.parameters.pack(), plant.inputs.size
    x, d = ca.SX.sym("x", plant.state.size), ca.SX.sym("d", plant.disturbances.size)
    measure = ca.Function("measure", [x, d], [plant.measurement(x, d, ca.SX(ca.DM(p)))])

    def rate(t: float, x: Array, u: Array, params: Mapping[str, Any]) -> Array:
        return np.array(plant.function(x, u[:size], u[size:], p)).reshape(-1)

    def output(t: float, x: Array, u: Array, params: Mapping[str, Any]) -> Array:
        return np.array(measure(x, u[size:])).reshape(-1)

    return control.nlsys(
        rate, output, name=plant.name, states=entry_labels(plant.state),
        inputs=[*entry_labels(plant.inputs), *entry_labels(plant.disturbances)],
        outputs=entry_labels(plant.measurements, "measured "),
    )  # fmt: skip

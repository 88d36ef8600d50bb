"""When the commands of a run do not respond: at a limit, or in a dead zone."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.system.linear import law_function
from surctl.system.loop import System, once_per_system
from surctl.system.parts import entry_labels
from surctl.system.record import Record

__all__ = ["unresponsive"]


def unresponsive(record: Record) -> dict[str, float]:
    """Return, by label of the command, the share of control instants at which it does not respond.

    A command does not respond where its derivatives by all inputs and states of the controller are 0, such as at a
    limit. Commands that never depend on them are left out.

    Args:
        record: a run of a system.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Controller, Plant, System, run_system, unresponsive
        >>> speed, force = Port("speed", (1,), "m/s", "of the cart", 3.0), Port("force", (1,), "m/s^2", "over the mass")
        >>> cart = Plant("cart", Layout((speed,)), Layout((force,)), lambda x, f, d, p: {"speed": f["force"]})
        >>> law = Controller("hold", 0.1, Layout((speed,)), Layout((force,)), lambda x, u, p: -ca.fmin(u["speed"], 1))
        >>> round(unresponsive(run_system(System(cart, law), 10.0))["force"], 2)
        0.21
    """
    slopes, depends = _slopes(record.system)
    z, u, gains = record.controller
    sizes: NDArray[np.float64] = np.array(slopes.map(len(u))(z.T, u.T, np.tile(gains[:, None], len(u))))
    labels = entry_labels(record.system.commands)
    return {name: float(np.mean(row == 0.0)) for name, row, acts in zip(labels, sizes, depends, strict=True) if acts}


@once_per_system
def _slopes(system: System) -> tuple[ca.Function, list[bool]]:
    # sum of the sizes of the derivatives of each command, and whether there are any
    controller = system.controller
    law = law_function(controller)
    z, u, p = (
        ca.SX.sym(n, v.size)
        for n, v in zip("zup", (controller.state, controller.inputs, controller.gains), strict=True)
    )
    J = ca.jacobian(law(z, u, p)[0], ca.vertcat(z, u))
    rows = set(J.sparsity().row())
    return ca.Function("slopes", [z, u, p], [ca.sum2(ca.fabs(J))]), [k in rows for k in range(J.shape[0])]

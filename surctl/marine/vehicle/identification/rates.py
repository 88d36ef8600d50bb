"""The rate of the plant and its slopes, evaluated for many rows of a log at once."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle.dynamics import PLANT_DISTURBANCE, build_plant, plant_layout, plant_state
from surctl.marine.vehicle.specs import PlantForm

__all__ = ["FITTED", "Repeated", "Slope", "places", "stepper"]

FITTED = (
    "m11", "m22", "m33", "m44", "Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr", "thrust_lag",
)  # fmt: skip
"""Parameters of equation (3) that can be identified from a log."""

Array = NDArray[np.float64]


class Repeated:
    """A CasADi function evaluated for many columns, as a chain or each column alone; arrays have one row per column."""

    def __init__(self, function: ca.Function, *, chain: bool) -> None:
        self._function, self._chain = function, chain
        self._built: dict[int, ca.Function] = {}

    def __call__(self, *arguments: Array) -> list[Array]:
        """Return the results for arguments with one row per column."""
        count = len(arguments[-1])
        if count not in self._built:
            if len(self._built) > 8:
                self._built.clear()
            self._built[count] = (self._function.mapaccum if self._chain else self._function.map)(count)
        function = self._built[count]
        held = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        results = [np.empty((count, function.nnz_out(k) // count)) for k in range(function.n_out())]
        buffer, evaluate = function.buffer()
        for k, argument in enumerate(held):
            buffer.set_arg(k, memoryview(argument))  # type: ignore[call-arg, arg-type]  # the stubs lack this form
        for k, result in enumerate(results):
            buffer.set_res(k, memoryview(result))  # type: ignore[call-arg, arg-type]  # likewise
        evaluate()
        return results


class Slope:
    """The derivatives of the rate by the state x and by the parameters p, of which CasADi computes the nonzeros."""

    def __init__(self, inputs: list[ca.SX], slopes: list[ca.SX]) -> None:
        self._places = [(slope.sparsity().row(), slope.sparsity().get_col()) for slope in slopes]
        self._widths = [slope.shape[1] for slope in slopes]
        nonzeros = [slope[slope.sparsity().find()] for slope in slopes]
        both = ca.SX.sym("all", inputs[2].numel() + inputs[3].numel())
        split = ca.vertsplit(both, [0, inputs[2].numel(), both.numel()])
        alone = ca.Function("alone", inputs, nonzeros)
        whole = ca.Function("slope", [*inputs[:2], both], list(alone(*inputs[:2], *split)), {"cse": True})
        self._nonzeros = Repeated(whole, chain=False)

    def __call__(self, x: Array, thrust: Array, p: Array) -> tuple[Array, Array]:
        """Return the derivatives by x (m, s, s) and by p (m, s, k) at m states."""
        over_x, over_p = (np.zeros((len(x), x.shape[1], width)) for width in self._widths)
        for full, flat, (rows, columns) in zip(
            (over_x, over_p), self._nonzeros(x, thrust, p), self._places, strict=True
        ):
            full[:, rows, columns] = flat
        return over_x, over_p


def places(form: PlantForm, names: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Return the places of the fitted parameters in the plant's parameter vector, and the places of all others."""
    layout = plant_layout(form)
    at = {k: layout.slice("thrust_lag").start for k in ("thrust_lag",)}
    for port, keys in (("mass", FITTED[:4]), ("linear_drag", FITTED[4:8]), ("quadratic_drag", FITTED[8:12])):
        at |= {k: layout.slice(port).start + j for j, k in enumerate(keys)}
    at |= {k: layout.slice("terms").start + j for j, k in enumerate(form.terms)}
    fitted = [at[k] for k in names]
    return fitted, [k for k in range(layout.size) if k not in fitted]


@cache
def stepper(form: PlantForm, names: tuple[str, ...]) -> tuple[Repeated, Slope]:
    """Return one integration step (RK4) of the plant in still water, and the slopes of the rate.

    The step has the arguments of a chain: the state x (s,), a flag and a new initial state (s,), which replaces x if
    the flag is 1, thrust (4,), p and dt; it returns the next state. The vector p holds the parameters `names`, then the
    other entries of the plant's parameter vector. The slopes are those by x and by the parameters `names`.
    """
    fitted, others = places(form, names)
    order = plant_state(form).size
    x, thrust, dt = ca.SX.sym("x", order), ca.SX.sym("thrust", 4), ca.SX.sym("dt")
    p, known = ca.SX.sym("p", len(fitted)), ca.SX.sym("known", len(others))
    entries = dict(zip((*fitted, *others), (*ca.vertsplit(p), *ca.vertsplit(known)), strict=True))
    plant = ca.vertcat(*(entries[k] for k in range(len(entries))))
    ode = build_plant(form).ode

    def rate(state: ca.SX) -> ca.SX:
        return ode(state, thrust, ca.DM.zeros(PLANT_DISTURBANCE.size), plant)

    k1 = rate(x)
    k2 = rate(x + dt / 2 * k1)
    k3 = rate(x + dt / 2 * k2)
    k4 = rate(x + dt * k3)
    after = ca.Function("after", [x, thrust, p, known, dt], [x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)], {"cse": True})
    flag, begin = ca.SX.sym("flag"), ca.SX.sym("begin", order)
    chosen = ca.if_else(flag > 0, begin, x)
    both = ca.vertcat(p, known)
    inputs = [x, flag, begin, thrust, ca.SX.sym("all", both.numel()), dt]
    step = ca.Function(
        "step",
        inputs,
        [after(chosen, thrust, *ca.vertsplit(inputs[4], [0, len(fitted), both.numel()]), dt)],
        {"cse": True},
    )
    return Repeated(step, chain=True), Slope([x, thrust, p, known], [ca.jacobian(rate(x), x), ca.jacobian(rate(x), p)])

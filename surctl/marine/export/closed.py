"""Rewrite a law for a target: sin, cos, atan2 and solver tolerances for its precision, optionally constant gains."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.export.contract import Around, Exportable
from surctl.ir import Block, Call, Layout, Port, Program, Real, Step, lower, reads, replay, with_constants, without_libm
from surctl.marine.control import NONFINITE, Law, LawStep, in_real

__all__ = ["ClosedForm", "closed_form"]

Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ClosedForm(Around):
    """A law without perception, rewritten for a target.

    Attributes:
        law: the original law.
        block: the code that computes thrust tau, next state x_next, status and telemetry from state x, inputs u and
            gains p; for a law in closed form this code is an instruction list.
        gains: names and sizes of the gains p; empty if the gains became constants.
        constants: gains that became constants (np,), in the order of the law's gains; None if the gains stayed inputs.
    """

    law: Law
    block: Block
    gains: Layout
    constants: Vector | None = None

    @cached_property
    def constant_table(self) -> tuple[tuple[Port, Vector], ...]:
        """Return the name, size and values of every gain that became a constant."""
        if self.constants is None:
            return ()
        return tuple((port, self.constants[self.law.gains.slice(port.name)]) for port in self.law.gains)

    def initial_state(self) -> Vector:
        """Return the controller state before the first step (nx,)."""
        return self.law.initial_state()

    def step(self, x: Vector, u: Vector, p: Vector) -> LawStep:
        """Run one step; if an input or a result is not finite, return tau = 0, x_next = x and status NONFINITE."""
        if all(np.isfinite(v).all() for v in (x, u, p)):
            parts = [np.asarray(part, dtype=np.float64) for part in replay(self.block, x, u, p)]
            if all(np.isfinite(part).all() for part in parts):
                return LawStep(parts[0], parts[1], int(parts[2][0]), parts[3])
        return LawStep(np.zeros(4), np.array(x, dtype=float), NONFINITE, np.zeros(self.outputs.size - 4))


def closed_form(law: Law, *, real: Real = "float64", constants: Vector | None = None) -> Exportable:
    """Return the law rewritten for a target, or the law itself if nothing has to change.

    For a law that is not in closed form, `in_real` sets the solver tolerances to those of the target's precision.

    Args:
        law: the law.
        real: precision of the target; in float32, shorter polynomials of float accuracy compute sin, cos and atan2.
        constants: gains (np,) that become constants of the code; values that follow from these constants are computed
            at export. None leaves the gains as inputs.

    Raises:
        InputError: constants are given for a law with perception, or their number is not np.

    Example:
        >>> from surctl.marine.control import build_law, load_gains
        >>> from surctl.marine.export import closed_form
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> mission, vehicle, gains = load_scenario("pool-behind"), load_vehicle("sur400"), load_gains("default")
        >>> law, p = build_law("closed_form"), law_numbers(mission, gains, vehicle)
        >>> shipped = closed_form(law, real="float32", constants=p)
        >>> law.gains.size, shipped.gains.size, shipped.block.operations < law.block.operations
        (70, 0, True)
    """
    closed = law.mode == "nsb" and law.perception is None and law.base is None
    if law.perception is not None and constants is not None:
        raise InputError(
            "are only for laws without perception",
            key="constant-gains",
            remedy="set --sensing truth, or omit this option",
        )
    if not closed:
        single = in_real(law, real)
        if constants is None:
            return single
        return ClosedForm(law, _without_gains(single.block, constants), Layout(()), np.array(constants, dtype=float))
    if real == "float64" and constants is None:
        return law
    block = without_libm(law.stages.closed, real)
    if constants is None:
        return ClosedForm(law, block, law.gains)
    return ClosedForm(law, _without_gains(block, constants), Layout(()), np.array(constants, dtype=float))


def _without_gains(block: Block, constants: Vector) -> Block:
    # the constants replace the third input, which is then empty
    x, u, p = block.inputs
    folded = _with_constant_input(block, 2, constants)
    return replace(folded, inputs=(x, u, (p[0], 0)))


def _with_constant_input(block: Block, at: int, constants: Vector) -> Block:
    """Return a block in which constants replace one input; if a loop reads this input, the constants form an array."""
    name = block.inputs[at][0]
    left = tuple(entry for k, entry in enumerate(block.inputs) if k != at)
    if isinstance(block, Program):
        folded = with_constants(block, at, [float(v) for v in constants])
        moved = [
            replace(i, args=(i.args[0] - (i.args[0] > at), *i.args[1:])) if i.op == "input" else i
            for i in folded.instructions
        ]
        return replace(folded, inputs=left, instructions=tuple(moved))
    steps: list[Step] = []
    for step in block.steps:
        if isinstance(step, Call) and name in step.args:
            here = step.args.index(name)
            args = tuple(arg for k, arg in enumerate(step.args) if k != here)
            steps.append(Call(_with_constant_input(step.block, here, constants), args, step.results))
        else:
            steps.append(step)
    if any(name in reads(step) for step in steps):
        values = ca.SX(ca.DM(constants))
        steps.insert(0, Call(lower(ca.Function(f"{block.name}_constants", [], [values], [], [name])), (), (name,)))
    return replace(block, inputs=left, steps=tuple(steps))

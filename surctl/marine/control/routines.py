"""Functions that combine the parts of a law (perception, `pre`, priority solver, `post`) into one routine."""

from __future__ import annotations

from dataclasses import replace

from surctl.ir import Block, Call, Layout, Real, Routine, rearranged, without_libm
from surctl.marine.control.allocated import with_allocation
from surctl.marine.control.law import Law
from surctl.marine.control.layers import forgetting
from surctl.marine.control.perception import PerceptionStage
from surctl.marine.control.ports import PARAMETERS
from surctl.priority import Fallback, LevelShape, Mode, priority_step
from surctl.priority.solver.precision import FLOAT32, FLOAT64

__all__ = ["in_real", "limited", "sensing"]

_MEMORY = ("carried", "reported", "flags")
_PRECISIONS = {"float64": FLOAT64, "float32": FLOAT32}


def limited(
    mode: Mode,
    pre: Block,
    post: Block,
    *,
    levels: tuple[tuple[str, int, str], ...],
    rows: int,
    fallback: Fallback = "exact",
    real: Real = "float64",
) -> Block:
    """Return the routine that runs `pre`, the priority solver with tolerances for number type `real`, and `post`."""
    shapes = tuple(LevelShape(count) for _, count, _ in levels)
    # the law does not report which limit rows limit task 1, so `named` is off
    step = priority_step(
        mode, n=4, levels=shapes, rows=rows, precision=_PRECISIONS[real], named=False, confirm=False, fallback=fallback
    )
    solution = tuple(f"step_{name}" for name, _ in step.outputs)
    results = tuple(name for name, _ in post.outputs)
    steps = (
        Call(pre, ("x", "u", "p"), ("J", "reference", "rows", "box", *_MEMORY)),
        Call(step, ("J", "reference", "reference", "rows", "box"), solution),
        Call(post, ("u", "p", *_MEMORY, "step_v", "step_status"), results),
    )
    return Routine("law", pre.inputs, steps, results)


def sensing(decide: Block, state: Layout, perception: PerceptionStage) -> Routine:
    """Return the routine that runs perception, then the decision; `state` is the layout of the decision's state."""
    whole = Layout((*state.ports, *perception.state.ports))
    own, size = state.size, whole.size
    apart = rearranged("apart", {"x": size}, {"decided": [("x", 0, own)], "sensed": [("x", own, size)]})
    parts = {"decided": own, "tau": 4, "sensed": perception.state.size - 4}
    together = rearranged("together", parts, {"x_next": [(name, 0, size) for name, size in parts.items()]})
    anew = ("anew",) if "changing" in state else ()
    gains = dict(decide.inputs)["p"]
    shared, first = ("p",), tuple[Call, ...]()
    if gains > PARAMETERS.size:  # a law with gains of its own, which perception does not know
        cut = rearranged("shared", {"p": gains}, {"shared": [("p", 0, PARAMETERS.size)]})
        shared, first = ("shared",), (Call(cut, ("p",), ("shared",)),)
    steps = (
        *first,
        Call(apart, ("x",), ("decided", "sensed")),
        *(Call(forgetting(state), ("decided",), (name,)) for name in anew),
        Call(perception.block, ("sensed", "u", *shared, *anew), ("sensed_next", "decision_inputs")),
        Call(decide, ("decided", "decision_inputs", "p"), ("tau", "decided_next", "status", "telemetry")),
        Call(together, ("decided_next", "tau", "sensed_next"), ("x_next",)),
    )
    sizes = (("x", whole.size), ("u", perception.inputs.size), ("p", gains))
    return Routine("law", sizes, steps, ("tau", "x_next", "status", "telemetry"))


def in_real(law: Law, real: Real) -> Law:
    """Return the law with the solver tolerances, and the polynomials for sin, cos and atan2, of number type `real`.

    With the tolerances for double, the solver would never stop in float, because the rounding errors of float exceed
    these tolerances. Without allocation to thrusters, a law in mode nsb or lexicographic is returned unchanged, because
    it uses no solver tolerances.

    Example:
        >>> import numpy as np
        >>> from surctl.marine.control import build_law, in_real, load_gains
        >>> from surctl.ir import replay
        >>> from surctl.marine.simulation import law_numbers, load_scenario
        >>> from surctl.marine.vehicle import load_vehicle
        >>> law = build_law("paper", mode="projected", contacts=1)
        >>> p = law_numbers(load_scenario("pool-behind"), load_gains("default"), load_vehicle("sur400"))
        >>> inputs = [v[None] for v in (law.initial_state(), law.inputs.pack({"eta": [1.2, 0.8, -0.15, 0.5]}), p)]
        >>> for variant, real in ((law, np.float64), (in_real(law, "float32"), np.float32)):
        ...     tau = replay(variant.block, *inputs, real=real)[0]
        ...     print(tau.dtype, [round(float(f), 2) for f in tau[0, [0, 1]]])
        float64 [5.0, 0.88]
        float32 [5.0, 0.88]
    """
    if real == "float64":
        return law
    if law.base is not None and law.actuators is not None:
        base = in_real(law.base, real)
        if base.mode == "nsb" and base.perception is None:
            base = replace(base, block=without_libm(base.stages.closed, real))
        return with_allocation(base, law.actuators, real=real)
    if law.mode not in ("filter", "projected"):
        return law
    block = limited(
        law.mode,
        law.stages.pre,
        law.stages.post,
        levels=law.levels,
        rows=len(law.rows),
        fallback=law.fallback,
        real=real,
    )
    decide = without_libm(block, real)
    if law.perception is None:
        return replace(law, block=decide)
    own = Layout(law.state.ports[: -len(law.perception.state.ports)])
    return replace(law, block=sensing(decide, own, law.perception))

"""The factorisation of the active normals in module `dual_step` as loops, for many unknowns."""

from __future__ import annotations

import casadi as ca

from surctl.ir import Call, Gather, Loop, Program, Routine, lower

__all__ = ["against_slots"]


def against_slots(d: int) -> Routine:
    """Return the routine that splits a normal into a combination of the active normals and the rest.

    Inputs: normals (d·d,), numbers (d,), as in `iteration`; normal (d,). Outputs: rest (d,), the part of the normal
    outside the span of the active normals; r (d,), the coefficients of the combination, 0 for an empty slot.
    """
    zeros = [ca.densify(ca.SX.zeros(size)) for size in (d * d, d, d)]
    a, b = ca.SX.sym("a", d), ca.SX.sym("b", d)
    steps = (
        Call(lower(ca.Function("no_slots", [], zeros)), (), ("Q_none", "inverse_none", "none")),
        Loop(
            _column(d), d, ("Q_none", "inverse_none"), ("Q", "inverse", "R"), sliced=("normals", "numbers"), index=True
        ),
        Loop(_outside(d), d, ("normal",), ("rough", "part"), sliced=("Q", "inverse")),
        Loop(_outside(d), d, ("rough",), ("rest", "more"), sliced=("Q", "inverse")),
        Call(lower(ca.Function("inside", [a, b], [a + b])), ("part", "more"), ("inside",)),
        Loop(_back(d), d, ("inside",), ("r",), fixed=("R",), index=True),
    )  # fmt: skip
    return Routine(f"against_{d}", (("normals", d * d), ("numbers", d), ("normal", d)), steps, ("rest", "r"))


def _outside(d: int) -> Program:
    """Return a program that subtracts from a vector its component along q and returns its factor; inverse is 1/‖q‖²."""
    vector, q, inverse = ca.SX.sym("vector", d), ca.SX.sym("q", d), ca.SX.sym("inverse")
    part = ca.dot(q, vector) * inverse
    return lower(ca.Function("outside_slot", [vector, q, inverse], [vector - part * q, part]))


def _column(d: int) -> Routine:
    """Return the routine for column number `turn` of Q and R; columns of Q that are not yet computed are 0."""
    q, number, turn = ca.SX.sym("q", d), ca.SX.sym("number"), ca.SX.sym("turn")
    used = number != 0
    inverse = ca.if_else(used, 1 / ca.if_else(used, ca.dot(q, q), 1), 0)
    at, old, old_inverse = ca.SX.sym("at"), ca.SX.sym("old", d), ca.SX.sym("old_inverse")
    new, new_inverse, here = ca.SX.sym("new", d), ca.SX.sym("new_inverse"), ca.eq(at, turn)
    placed = [ca.if_else(here, new, old), ca.if_else(here, new_inverse, old_inverse)]
    place = lower(ca.Function("place_slot", [at, old, old_inverse, turn, new, new_inverse], placed))
    steps = (
        Loop(_outside(d), d, ("column",), ("q", "R"), sliced=("Q", "inverse")),
        Call(lower(ca.Function("inverse_square", [q, number], [inverse])), ("q", "number"), ("q_inverse",)),
        Loop(
            place, d, (), ("Q_next", "inverse_next"), sliced=("Q", "inverse"), fixed=("turn", "q", "q_inverse"),
            index=True,
        ),
    )  # fmt: skip
    inputs = (("turn", 1), ("Q", d * d), ("inverse", d), ("column", d), ("number", 1))
    return Routine(f"slot_column_{d}", inputs, steps, ("Q_next", "inverse_next", "R"))


def _back(d: int) -> Routine:
    """Return the routine for one step of the back substitution R r = inside, from the last column to the first."""
    turn, r, column = ca.SX.sym("turn"), ca.SX.sym("r", d), ca.SX.sym("column", d)
    index = lower(ca.Function("from_the_end", [turn], [d - 1 - turn]))
    entry = sum((ca.if_else(ca.eq(turn, d - 1 - i), r[i], 0) for i in range(d)), ca.SX(0))
    reduced = lower(ca.Function("back", [turn, r, column], [r - column * entry]))
    steps = (
        Call(index, ("turn",), ("at",)),
        Gather("R", "at", d, "column"),
        Call(reduced, ("turn", "r", "column"), ("r_next",)),
    )
    return Routine(f"back_{d}", (("turn", 1), ("r", d), ("R", d * d)), steps, ("r_next",))

"""One compiled step for each priority mode, which computes a finite velocity from any tasks and limits.

nsb: the NSB law, equation (16) of the paper, as projections from the lowest level to level 1, without limits.
filter: the velocity that satisfies the limits and is nearest to the velocity of nsb.
projected: the projections of nsb from the lowest level to level 2, then the projection on level 1 within the limits.
lexicographic: strict priority within the limits, by the kernel in package `hierarchy`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.ir import Call, Loop, Program, Routine, Step, lower
from surctl.priority.compiled.confirmation import confirmation
from surctl.priority.compiled.last_projection import last_projection
from surctl.priority.compiled.level_shape import LevelShape, StackShape
from surctl.priority.compiled.sweep import HUGE, gate, into, sweep, swept
from surctl.priority.hierarchy.kernel import hierarchy
from surctl.priority.settings import Fallback, Mode, Settings, check_fallback
from surctl.priority.solver.fallback import CLAMPED, MET, safe_step
from surctl.priority.solver.precision import FLOAT64, Precision

__all__ = ["LEAST_DAMPING", "OUTPUTS", "priority_step"]

LEAST_DAMPING = 1e-3  # of the last projection: its rows shrink with λ/‖J‖; the kernel must not call them parallel

OUTPUTS = ("v", "active", "multipliers", "opening", "status", "count", "target")
"""Names of the outputs of a step, in order."""

_RAW = tuple(f"{name}_raw" for name in OUTPUTS)
_STACK = ("J", "lower", "upper")


def priority_step(
    mode: Mode,
    *,
    n: int,
    levels: tuple[LevelShape, ...],
    rows: int,
    sweeps: int = 1,
    damping: float = 0.0,
    precision: Precision = FLOAT64,
    named: bool = True,
    confirm: bool = True,
    fallback: Fallback = "exact",
) -> Routine:
    """Return the routine that computes the velocity v of one control period for a priority mode.

    Inputs: J (K·n,), the Jacobians of all levels, K rows together, stored row by row, highest priority first; lower,
    upper (K,), the bounds of J v, equal for a level with one desired value; rows (m·(n + 3),), m constraint rows lower
    ≤ a·v ≤ upper of any length, the bounds of the box included, each stored as a (n,), lower, upper, soft (1 if the row
    may be relaxed when rows contradict each other); box (2n,), lower and upper bounds to which v is clipped at the end.
    An unused row is all zeros with infinite bounds.

    Outputs: v (n,), the velocity; active (n,), signed numbers of the active constraint rows, from 1 (+ at the upper
    bound, − at the lower bound, 0 for an unused entry), the rows that limit a task first; multipliers (n,), Lagrange
    multipliers of the active rows, for rows of length 1, in min ½‖J v − x‖² if the row limits a task, otherwise in min
    ½‖v − target‖²; opening (1,), the amount by which the bounds of soft rows are moved outwards; status (1,): MET
    (level 1 is met as well as its Jacobian allows), LIMITED (level 1 is met as well as the constraint rows allow),
    RELAXED (soft rows are relaxed), CLAMPED (v is only clipped to the box), BOUNDED (the bounded fallback was used; no
    active rows are reported), or UNCONFIRMED (see below); count (1,), number of iterations; target (n,), the velocity
    that v approaches as far as level 1 and the limits allow.

    The projection on a set-based level leaves a velocity w unchanged if J w is inside the bounds, and otherwise moves w
    to the nearest bound; so v does not jump. In mode lexicographic, the numbers m + 1, m + 2, … in `active` denote
    set-based levels at their bounds, in the order of the levels. In mode nsb, the status is MET if v is finite, v
    ignores limits and box, and target is v.

    UNCONFIRMED replaces MET, LIMITED and RELAXED if v satisfies the limits but was not shown to be optimal: the
    residual of a strict level, the distance to the target, or the opening may be more than `optimality.LOSS`·(1 +
    value) above the least possible. This check runs after the solver and uses only its result (module `confirmation`);
    the kernel of mode lexicographic has its own (module `hierarchy.proof`).

    With damping λ, every projection of a velocity w on a level minimises λ²‖z − w‖² + ‖J z − x‖² over z; in mode
    projected this includes the last projection, within the limits. The result is exact while ‖J‖ of the first level is
    below 5e4·λ; for a larger ‖J‖, rounding errors exceed the terms with λ.

    The status is CLAMPED, with v = 0 clipped to the box, if J, lower or upper contains a NaN or a number above 1e300
    (J: above 1e140), if lower ≠ upper for a level with one desired value, or, in all modes but nsb, if a constraint row
    is longer than 1e150.

    Args:
        mode: the priority law, as described in the module docstring.
        n: number of velocities.
        levels: number of Jacobian rows and kind of each level.
        rows: number of constraint rows m, at least 1.
        sweeps: number of sweeps over all levels; each sweep starts from the velocity of the previous sweep. 1 in mode
            lexicographic.
        damping: λ [unit of J]; 0 in mode lexicographic.
        precision: tolerances of the solver in modes filter and projected, for the number type with which the routine
            runs; the other modes use the tolerances for double.
        named: if False, mode projected does not list in `active` the constraint rows that limit task 1, which saves
            time.
        confirm: if False, the status is never UNCONFIRMED in modes filter and projected, which saves time. The bounded
            fallback, tolerances for float and mode nsb have no such check; mode lexicographic always has it.
        fallback: "exact", or "bounded" for modes filter and projected without damping. If limits and task 1 are
            incompatible, or need more than 4 iterations, "bounded" computes a velocity that is not optimal, at constant
            cost; see module `solver.bounded`.

    Raises:
        InputError: the mode is unknown, or n, `rows`, a level or a setting is out of range; the message names the
            level.

    Example:
        >>> import numpy as np
        >>> from surctl.ir import replay
        >>> from surctl.priority import LevelShape, priority_step
        >>> step = priority_step("projected", n=2, levels=(LevelShape(2),), rows=1)
        >>> wall, box = [1.0, 0.0, -np.inf, 0.1, 1.0], [-1.0, -1.0, 1.0, 1.0]
        >>> v, active, *_ = replay(step, [1.0, 0.0, 0.0, 1.0], [0.3, 0.4], [0.3, 0.4], wall, box)
        >>> v.round(3).tolist(), active.tolist()  # held back by row 1 at its upper bound
        ([0.1, 0.4], [1.0, 0.0])
    """
    shape, settings = (
        StackShape(n, levels),
        _Settings(mode, sweeps, damping, precision=precision, named=named, fallback=fallback),
    )
    if mode == "projected" and 0.0 < damping < LEAST_DAMPING:
        raise InputError(
            "is too small for a compiled projection",
            key="damping",
            value=damping,
            remedy=f"give 0, or {LEAST_DAMPING:g} and more",
        )
    if not isinstance(rows, int | np.integer) or rows < 1:
        raise InputError("must be a whole number of at least 1", key="rows", value=rows, remedy="give 1 or more")
    inputs = (*shape.inputs, ("rows", rows * (n + 3)), ("box", 2 * n))
    if mode == "lexicographic":
        kernel = hierarchy(shape, rows)
        return Routine(f"{mode}_step", inputs, (Call(kernel, tuple(name for name, _ in inputs), OUTPUTS),), OUTPUTS)
    steps = _MODES[mode](shape, rows, settings)
    start = Call(gate(shape), _STACK, ("sound", "zero", "none"))
    finish = _finish(n, boxed=mode != "nsb")
    if mode == "nsb" or not confirm or fallback != "exact" or precision != FLOAT64:
        end: tuple[Step, ...] = (Call(finish, (*_RAW, "sound", "box"), OUTPUTS),)
    else:
        last = confirmation(
            shape, rows, strict=int(mode == "projected"), damping=damping if mode == "projected" else 0.0
        )
        raw = tuple("status_found" if name == "status" else name for name in OUTPUTS)
        checked = (*_STACK, "rows", "v", "opening", "status_found", "target")
        end = (Call(finish, (*_RAW, "sound", "box"), raw), Call(last, checked, ("status",)))
    return Routine(f"{mode}_step", inputs, (start, *steps, *end), OUTPUTS)


@dataclass(frozen=True)
class _Settings(Settings):
    precision: Precision = FLOAT64
    named: bool = True
    fallback: Fallback = "exact"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_fallback(self.fallback, mode=self.mode, damping=self.damping)


def _nsb(shape: StackShape, rows: int, settings: _Settings) -> tuple[Step, ...]:
    return (*swept(shape, settings), Call(_unlimited(shape.n), ("swept",), _RAW))


def _filter(shape: StackShape, rows: int, settings: _Settings) -> tuple[Step, ...]:
    inputs = ("swept", "zero", "none", "rows", "box")
    last = Call(_with_target(shape.n), ("swept",), (_RAW[-1],))
    return (
        *swept(shape, settings),
        Call(safe_step(shape.n, 1, rows, precision=settings.precision, fallback=settings.fallback), inputs, _RAW[:-1]),
        last,
    )


def _projected(shape: StackShape, rows: int, settings: _Settings) -> tuple[Step, ...]:
    """Return the steps of mode projected: each sweep projects v on the levels from the lowest to 2, then on level 1."""
    n, damping, fixed = shape.n, settings.damping, (*_STACK, "rows", "box")
    carried = (("v", n), ("active", n), ("multipliers", n), ("opening", 1), ("status", 1), ("count", 1), ("target", n))
    after = tuple(f"{name}_next" for name in OUTPUTS)
    last = last_projection(
        shape, rows, damping=damping, precision=settings.precision, named=settings.named, fallback=settings.fallback
    )
    turn = Routine(
        "sweep_within",
        (*carried, *shape.inputs, ("rows", rows * (n + 3)), ("box", 2 * n)),
        (
            Call(sweep(shape, damping=damping, highest=1), ("v", *_STACK), (after[-1],)),
            Call(last, (after[-1], "count", *fixed), after[:-1]),
        ),
        after,
    )
    state = ("zero", "zero", "zero", "none", "none", "none", "zero")
    if settings.sweeps == 1:
        return (Call(turn, (*state, *fixed), _RAW),)
    return (Loop(turn, settings.sweeps, state, _RAW, fixed=fixed),)


_MODES: Mapping[Mode, Callable[[StackShape, int, _Settings], tuple[Step, ...]]] = MappingProxyType(
    {"nsb": _nsb, "filter": _filter, "projected": _projected}
)


def _with_target(n: int) -> Program:
    target = ca.SX.sym("target", n)
    return lower(ca.Function("copy", [target], [target]))


def _unlimited(n: int) -> Program:
    v = ca.SX.sym("v", n)
    empty, none = ca.SX.zeros(n), ca.SX.zeros(1)
    return lower(ca.Function("unlimited", [v], [v, empty, empty, none, ca.SX(MET), none, v]))


def _finish(n: int, *, boxed: bool) -> Program:
    # if v is not finite, the result is 0 moved into the box
    flat = [ca.SX.sym(name, size) for name, size in zip(OUTPUTS, (n, n, n, 1, 1, 1, n), strict=True)]
    v, active, multipliers, opening, status, count, target = flat
    sound, box = ca.SX.sym("sound"), ca.SX.sym("box", 2 * n)
    good = sound
    for entry in [*ca.vertsplit(v), *ca.vertsplit(target)]:
        good = ca.if_else(ca.fabs(entry) <= HUGE, good, 0)
    rest = into(ca.SX.zeros(n), box[:n], box[n:])
    inside = into(v, box[:n], box[n:]) if boxed else v
    solved = ca.logic_and(good, status != CLAMPED)
    outputs = [
        ca.if_else(good, inside, rest),
        ca.if_else(solved, active, 0),
        ca.if_else(solved, multipliers, 0),
        ca.if_else(solved, opening, 0),
        ca.if_else(good, status, CLAMPED),
        count,
        ca.if_else(good, target, 0),
    ]
    return lower(ca.Function("solution", [*flat, sound, box], list(map(ca.densify, outputs))))

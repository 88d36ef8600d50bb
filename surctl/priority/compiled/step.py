"""One compiled tick a mode: a stack, rows and a box in, a finite velocity out, whatever the numbers.

nsb          the sweep of projections (16); knows no rows.
filter       the point of the rows nearest to it.
projected    the sweep down to level 2, then the last projection, that of level 1, inside the rows (`last_projection`).
lexicographic strict priority inside the rows (`compiled_cascade`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import casadi as ca
import numpy as np

from surctl.errors import InputError
from surctl.ir import Call, Loop, Program, Routine, Step, lower
from surctl.priority.compiled.cascade import cascade
from surctl.priority.compiled.last_projection import last_projection
from surctl.priority.compiled.level_shape import LevelShape, StackShape
from surctl.priority.compiled.sweep import HUGE, gate, into, sweep, swept
from surctl.priority.settings import Fallback, Mode, Settings, check_fallback
from surctl.priority.solver.fallback import CLAMPED, MET, safe_step
from surctl.priority.solver.precision import FLOAT64, Precision

__all__ = ["OUTPUTS", "priority_step"]

_LEAST_DAMPING = 1e-3  # of the last projection: its rows shrink with λ/‖J‖, down to what the kernel calls parallel

OUTPUTS = ("v", "active", "multipliers", "opening", "status", "count", "target")
"""Names of a tick's outputs, in order."""

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
    fallback: Fallback = "exact",
) -> Routine:
    """(J (K·n,), lower (K,), upper (K,), rows (m·(n + 3),), box (2n,)) → the tick's answer; K rows in all levels.

    J is row by row, highest priority first; lower = upper for a level that asks for a value. rows: a (n,), lower,
    upper, soft (1: may open when the rows contradict each other), of any length, those of the box among them; a row
    of zeros between infinite bounds is none. box: lower (n,), upper (n,), into which v is moved at the end.

    Outputs: v (n,); active (n,), signed row numbers from 1 (+ at the upper bound, − at the lower, 0 none), first
    those that hold a task back, with multipliers (n,) of ½‖J v − x‖² for these and of ½‖v − target‖² for the others,
    for rows of length 1; opening (1,) of the soft rows; status (1,): MET (level 1 is met as well as its Jacobian
    can), LIMITED (as well as the rows allow), RELAXED (soft rows opened), CLAMPED (only moved into the box), or BOUNDED
    (what a bounded ladder has in place of the two before that, without active rows); count (1,), iterations; target
    (n,), the point from which the last projection started.

    A set-based level keeps w where it is inside its bounds and moves it to the nearest bound otherwise: no switch, no
    jump. In mode lexicographic one that is met is row m + 1, m + 2, … of those that bind (in the order of the levels).
    In mode nsb the status is MET whenever (16) has a finite value, v knows neither rows nor box, and target is v.

    With damping λ every projection is min λ²‖z − w‖² + ‖J z − x‖², in mode projected the last one too (inside the
    rows): exact while ‖J‖ of the first level is below 5e4·λ; beyond, the rows it shares with λ are lost to rounding.
    A number in J, lower or upper that is none (or above 1e300, in J above 1e140), or a value with lower ≠ upper:
    CLAMPED, and v is 0 moved into the box; also in the modes with rows where one is longer than 1e150.

    Args:
        mode: the law.
        n: velocities.
        levels: their sizes.
        rows: m, at least 1.
        sweeps: how often the sweep is made, each from the last result; 1 in mode lexicographic.
        damping: λ [unit of J]; 0 in mode lexicographic.
        precision: tolerances of the least-distance problems in modes filter and projected, those of the type of numbers
            that the routine is run with; the other modes have those of double.
        named: False in mode projected leaves out of `active` what holds task 1 back: v and status take less then.
        ladder: exact, or for modes filter and projected without damping, bounded: where rows and task 1 cannot all be
            kept, or not within 4 iterations, an answer of constant cost, see `solver.bounded`.

    Raises:
        InputError: an unknown mode, a size or a number out of range; it names the level.

    Example:
        >>> import numpy as np
        >>> from surctl.ir import replay
        >>> from surctl.priority import LevelShape, priority_tick
        >>> tick = priority_tick("projected", n=2, levels=(LevelShape(2),), rows=1)
        >>> wall, box = [1.0, 0.0, -np.inf, 0.1, 1.0], [-1.0, -1.0, 1.0, 1.0]
        >>> v, active, *_ = replay(tick, [1.0, 0.0, 0.0, 1.0], [0.3, 0.4], [0.3, 0.4], wall, box)
        >>> v.round(3).tolist(), active.tolist()  # held back by row 1 at its upper bound
        ([0.1, 0.4], [1.0, 0.0])
    """
    shape, settings = (
        StackShape(n, levels),
        _Settings(mode, sweeps, damping, precision=precision, named=named, fallback=fallback),
    )
    if mode == "projected" and 0.0 < damping < _LEAST_DAMPING:
        raise InputError(
            "is too small for a compiled projection",
            key="damping",
            value=damping,
            remedy=f"give 0, or {_LEAST_DAMPING:g} and more",
        )
    if not isinstance(rows, int | np.integer) or rows < 1:
        raise InputError("must be at least 1, and whole", key="rows", value=rows, remedy="a row of zeros is none")
    steps = _MODES[mode](shape, rows, settings)
    inputs = (*shape.inputs, ("rows", rows * (n + 3)), ("box", 2 * n))
    start = Call(gate(shape), _STACK, ("sound", "zero", "none"))
    end = Call(_finish(n, boxed=mode != "nsb"), (*_RAW, "sound", "box"), OUTPUTS)
    return Routine(f"{mode}_step", inputs, (start, *steps, end), OUTPUTS)


@dataclass(frozen=True)
class _Settings(Settings):
    """With what a compiled tick has beside: see `priority_tick`."""

    precision: Precision = FLOAT64
    named: bool = True
    fallback: Fallback = "exact"

    def __post_init__(self) -> None:
        """Check also that there is such a ladder."""
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
    """Turns of: the sweep of the lower levels from the last v, then the last projection."""
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


def _lexicographic(shape: StackShape, rows: int, settings: _Settings) -> tuple[Step, ...]:
    return (Call(cascade(shape, rows), (*_STACK, "rows", "box", "sound"), _RAW),)


_MODES: Mapping[Mode, Callable[[StackShape, int, _Settings], tuple[Step, ...]]] = MappingProxyType(
    {"nsb": _nsb, "filter": _filter, "projected": _projected, "lexicographic": _lexicographic}
)


def _with_target(n: int) -> Program:
    target = ca.SX.sym("target", n)
    return lower(ca.Function("copy", [target], [target]))


def _unlimited(n: int) -> Program:
    """v → the outputs of a tick that no row shapes."""
    v = ca.SX.sym("v", n)
    empty, none = ca.SX.zeros(n), ca.SX.zeros(1)
    return lower(ca.Function("unlimited", [v], [v, empty, empty, none, ca.SX(MET), none, v]))


def _finish(n: int, *, boxed: bool) -> Program:
    """(the outputs, sound, box) → the outputs, finite: 0 moved into the box where the stack or its sweep is not."""
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

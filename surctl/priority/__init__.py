"""Priority laws: the null-space-based behavioural (NSB) law of the paper, and quadratic programmes with limits.

`solve` runs the compiled step of its mode. With `backend=` it runs the reference solver instead, which shares no code
with the step. Four modes exist, for these reasons: nsb is the law of the paper, which others are compared with; filter
is the safety filter that is added to a law that exists; projected is that of the built-in laws, the fastest with
limits, with a bounded fallback and float for small processors; lexicographic is strict priority on all levels.

The status of a solution, in `solve` (and the name of the stage in a compiled step, where it differs), says what v is:

* optimal (met), limited: v is optimal for the mode; limited, if the limits prevent the first task from being met.
* relaxed: optimal too, but some limits had to be relaxed or moved, and are named with the amount.
* unconfirmed: v satisfies the limits but was not shown to be optimal, which is rare except near singularities.
* clamped: v is only clipped to the velocity bounds. bounded: v comes from the bounded fallback of a compiled step.

Every solution that limits affect is checked after the solver. It is optimal if the residual r of each strict level is
at most 1e-7·(s + r) above the smallest that the limits and the levels above allow, with s = max(1, largest |entry of
J|), and if the same holds, with s = 1, for the distance to the target and for the least relaxation of the limits. The
bound includes what rounding errors of the problem may change. See modules `optimality`, `solver.kernel` and
`hierarchy.search`.

Limits that cross are handled by one rule, in `build_problem`, `assemble` and compiled steps:

1. Bounds lower > upper of one row of `assemble` become the value between them that is nearest to 0. So a velocity never
   exceeds a bound that allows 0, such as an actuator limit. (`build_problem` refuses numbers lower > upper.)
2. Of actuator limits on a single velocity that exclude each other, the earlier one is harder; the later one becomes the
   point nearest to it that the earlier ones allow. So write physical limits first, dampers after them.
3. Barrier and set limits that contradict the others are relaxed together, by the least uniform amount for rows of
   length 1.
4. Other actuator limits that contradict each other: the status is clamped.

The limits of rules 1 to 3 are named in `relaxed`, and in `moved` of an assembled step.
"""

from __future__ import annotations

from surctl.priority.compiled.assemble import AssembledStep, Assembly, assemble
from surctl.priority.compiled.step import PriorityStep, priority_step
from surctl.priority.compiled.sweep import nsb_symbolic
from surctl.priority.problem import Level, PriorityProblem, Row, build_problem
from surctl.priority.reference import nsb, nsb_sweep
from surctl.priority.settings import Fallback, Mode, Settings, check_fallback
from surctl.priority.shapes import LevelShape
from surctl.priority.solver.fallback import safe_step
from surctl.priority.solving import PrioritySolution, PriorityTimeline, solve

__all__ = [
    "AssembledStep",
    "Assembly",
    "Fallback",
    "Level",
    "LevelShape",
    "Mode",
    "PriorityProblem",
    "PrioritySolution",
    "PriorityStep",
    "PriorityTimeline",
    "Row",
    "Settings",
    "assemble",
    "build_problem",
    "check_fallback",
    "nsb",
    "nsb_sweep",
    "nsb_symbolic",
    "priority_step",
    "safe_step",
    "solve",
]

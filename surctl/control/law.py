"""The law: filter, guidance, tasks, priority and velocity control as one object with explicit state.

`function` is the closed form that is generated as C; `pre` and `post` are the same law cut open at the priority
solver, for the modes that need a QP. Python, C, verification and tuning all see these expressions and no others.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple, get_args

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.control.laws import DECISION_PORTS, guarded_law, paper_law
from surctl.control.perception import perceive, perception_ports
from surctl.control.ports import INPUTS, PARAMETERS
from surctl.control.reference import path_wish
from surctl.control.velocity import velocity_control
from surctl.errors import InputError, nearest
from surctl.guidance import FORMS, AvoidanceForm
from surctl.ir import Layout, Port
from surctl.priority import Level, Mode, PriorityProblem, PrioritySolution, Row, nsb_symbolic, solve

__all__ = ["DEGRADED", "LAW_NAMES", "MODES", "NONFINITE", "SATURATED", "SWITCHED", "Law", "LawStep", "build_law"]

LawName = Literal["guarded", "paper"]
LAW_NAMES: tuple[LawName, ...] = get_args(LawName)
MODES: tuple[Mode, ...] = get_args(Mode)

SATURATED, SWITCHED, DEGRADED = 1, 2, 4
NONFINITE = -2

_YAW_SHARE = 0.85  # share of the yaw thrust that the heading task may plan with
_CLIMB = 0.1  # [m/s] largest heave command

TELEMETRY = (
    Port("tau", (4,), "N, N m", "thrust command F_u, F_v, F_w, F_r in {B}"),
    Port("nu_wanted", (4,), "m/s, rad/s", "velocity that the priority solver asked for, in {B}"),
    Port("path_error", (2,), "m", "x_e and y_e of (8)"),
    Port("avoiding", (1,), "1", "1 while a contact changes the wish"),
    Port("nearest", (1,), "m", "smallest clearance that the law knows of"),
    Port("ranges", (4,), "m", "filtered sonar ranges"),
)


class LawStep(NamedTuple):
    """One control step.

    Attributes:
        tau: (4,) [N, N m] in {B}.
        x_next: next state, flat.
        status: 0, bits `SATURATED`, `SWITCHED`, `DEGRADED`, or `NONFINITE` (then tau is 0 and the state stays).
        telemetry: flat, the ports of `Law.outputs` after tau.
        solution: of the priority solver, for modes that call one.
    """

    tau: NDArray[np.float64]
    x_next: NDArray[np.float64]
    status: int
    telemetry: NDArray[np.float64]
    solution: PrioritySolution | None = None


@dataclass(frozen=True, eq=False)
class Law:
    """A controller: (state, input, gains) → (τ, next state, status).

    Attributes:
        name: C identifier.
        avoidance: form of (20).
        mode: priority mode; `nsb` runs `function`, the others run `pre`, the priority solver and `post`.
        dt: control period [s].
        state, inputs, gains, outputs: layouts of the flat vectors.
        function: (x, u, p) → (tau, x_next, status, telemetry), closed form (16).
        pre: (x, u, p) → (stacked J, stacked references, barrier rows, barrier bounds, velocity box (4,)).
        post: (x, u, p, nu_wanted) → as `function`.
        levels: (name, rows) of each priority level, highest first.
        barriers: names of the barrier rows.
    """

    name: str
    avoidance: AvoidanceForm
    mode: Mode
    dt: float
    state: Layout
    inputs: Layout
    gains: Layout
    outputs: Layout
    function: ca.Function
    pre: ca.Function
    post: ca.Function
    levels: tuple[tuple[str, int], ...]
    barriers: tuple[str, ...]

    def initial_state(self) -> NDArray[np.float64]:
        """State before the first step."""
        return self.state.pack()

    def step(self, x: NDArray[np.float64], u: NDArray[np.float64], p: NDArray[np.float64]) -> LawStep:
        """One step. NaN never becomes a command: a non-finite number anywhere gives zero thrust, `NONFINITE`."""
        if not (np.isfinite(x).all() and np.isfinite(u).all() and np.isfinite(p).all()):
            return self._fail_safe(x)
        solution = None
        if self.mode == "nsb":
            result = self.function(x, u, p)
        else:
            solution = solve(self.problem(x, u, p), mode=self.mode)
            result = self.post(x, u, p, solution.v)
        parts = [np.asarray(r, dtype=float).reshape(-1) for r in result]
        if not all(np.isfinite(part).all() for part in parts):
            return self._fail_safe(x)
        tau, x_next, status, telemetry = parts
        return LawStep(tau, x_next, int(status[0]), telemetry, solution)

    def telemetry_slice(self, name: str) -> slice:
        """Where an output port lies in the telemetry, which leaves tau out."""
        where = self.outputs.slice(name)
        return slice(where.start - 4, where.stop - 4)

    def problem(self, x: NDArray[np.float64], u: NDArray[np.float64], p: NDArray[np.float64]) -> PriorityProblem:
        """The priority problem of one tick, as data with names on every row."""
        J, reference, rows, bounds, box = (np.asarray(m, dtype=float) for m in self.pre(x, u, p))
        levels, at = [], 0
        for name, count in self.levels:
            levels.append(Level(name, J[at : at + count], reference[at : at + count, 0]))
            at += count
        limits = [
            Row(f"velocity.{axis}", "actuator", a, -float(m), float(m))
            for axis, a, m in zip("uvwr", np.eye(4), box.reshape(-1), strict=True)
        ]
        limits += [
            Row(name, "barrier", a, -np.inf, float(b))
            for name, a, b in zip(self.barriers, rows, bounds.reshape(-1), strict=True)
        ]
        # built by this class from finite numbers: the checks of build_problem were made once, at assembly
        return PriorityProblem(tuple(levels), tuple(limits))

    def _fail_safe(self, x: NDArray[np.float64]) -> LawStep:
        return LawStep(np.zeros(4), np.array(x, dtype=float), NONFINITE, np.zeros(self.outputs.size - 4))


@cache
def build_law(
    law: LawName = "guarded", *, avoidance: AvoidanceForm = "corrected", mode: Mode = "nsb", dt: float = 0.05
) -> Law:
    """Assemble a law once; the gains stay symbols.

    Args:
        law: `guarded`, or the printed stack `paper`.
        avoidance: form of (20); `guarded` is built on `corrected` and takes no other.
        mode: `nsb` (closed form, can be exported), or one with limits: `filter`, `projected`, `lexicographic`.
        dt: control period [s].

    Raises:
        InputError: an unknown name, or a form that the law does not take.
    """
    for key, value, known in (("law", law, LAW_NAMES), ("avoidance", avoidance, FORMS), ("priority-mode", mode, MODES)):
        if value not in known:
            raise InputError("is not known", key=key, value=value, remedy=nearest(str(value), known))
    if law == "guarded" and avoidance != "corrected":
        raise InputError(
            "law guarded is built on the corrected form",
            key="avoidance",
            value=avoidance,
            remedy="compare the forms with law paper",
        )
    state = _state_layout(dt)
    x, xs = state.symbols("x")
    u, us = INPUTS.symbols("u")
    p, ps = PARAMETERS.symbols("p")
    wanted = ca.SX.sym("nu_wanted", 4)

    eta = us["eta"]
    wish = path_wish(eta, xs["progress"], ps, dt=dt)
    seen = perceive(xs, us, ps, dt=dt)
    decision = (
        guarded_law(wish, seen, xs, eta, ps)
        if law == "guarded"
        else paper_law(avoidance, wish, seen, xs, eta, ps, dt=dt)
    )

    finish = _Finish(xs, us, ps, dt)
    nearest_clearance = ca.SX(100)
    for contact in seen.all:
        nearest_clearance = ca.fmin(nearest_clearance, contact.clearance)
    extra = {
        "path_error": ca.vertcat(wish.x_e, wish.y_e),
        "avoiding": decision.avoiding,
        "nearest": nearest_clearance,
        "ranges": seen.ranges,
    }
    carried = {**seen.state, **decision.state, "progress": wish.progress}
    outputs = Layout(TELEMETRY)

    def close(nu_wanted: ca.SX) -> list[ca.SX]:
        tau, integral, saturated, clamped = finish.thrust(nu_wanted)
        switched = ca.logic_not(decision.state["side"] == xs["side"])
        status = SATURATED * saturated + SWITCHED * switched + DEGRADED * decision.degraded
        full = outputs.join({"tau": tau, "nu_wanted": clamped, **extra})
        return [tau, state.join({**carried, "integral": integral}), status, full[4:]]

    names = ["x", "u", "p"], ["tau", "x_next", "status", "telemetry"]
    options = {"cse": True}
    nsb = nsb_symbolic([(J, r) for _, J, r in decision.levels])
    rows = [row for limit in decision.rows for row in limit.rows()]
    return Law(
        name=f"surctl_{law}",
        avoidance=avoidance,
        mode=mode,
        dt=dt,
        state=state,
        inputs=INPUTS,
        gains=PARAMETERS,
        outputs=outputs,
        function=ca.Function("law", [x, u, p], close(nsb), *names, options),
        pre=ca.Function(
            "pre",
            [x, u, p],
            [
                ca.densify(ca.vertcat(*(J for _, J, _ in decision.levels))),
                ca.densify(ca.vertcat(*(r for _, _, r in decision.levels))),
                ca.densify(ca.vertcat(*(row.a for row in rows))) if rows else ca.SX(0, 4),
                ca.densify(ca.vertcat(*(row.upper for row in rows))) if rows else ca.SX(0, 1),
                ca.vertcat(ps["cap"], ps["cap"], _CLIMB, _yaw_limit(ps)),
            ],
            options,
        ),
        post=ca.Function("post", [x, u, p, wanted], close(wanted), [*names[0], "nu_wanted"], names[1], options),
        levels=tuple((name, int(J.shape[0])) for name, J, _ in decision.levels),
        barriers=tuple(row.name for row in rows),
    )


def _state_layout(dt: float) -> Layout:
    return Layout(
        (
            Port("progress", (1,), "m", "arc length of the path's target"),
            Port("integral", (4,), "m/s^2, rad/s^2", "integral action of the velocity loops"),
            *DECISION_PORTS,
            *perception_ports(dt),
        )
    )


def _yaw_limit(p: dict[str, ca.SX]) -> ca.SX:
    """Yaw rate [rad/s] that 85 % of the yaw thrust holds."""
    moment, linear, quadratic = _YAW_SHARE * p["thrust_limit"][3], p["linear_drag"][3], p["quadratic_drag"][3]
    root = ca.sqrt(linear * linear + 4 * quadratic * moment)
    # the form without a difference of near-equal numbers, and defined without quadratic drag
    return 2 * moment / ca.fmax(linear + root, 1e-6)


@dataclass(frozen=True)
class _Finish:
    """Last stage: limit the wanted velocity, then velocity control."""

    x: dict[str, ca.SX]
    u: dict[str, ca.SX]
    p: dict[str, ca.SX]
    dt: float

    def thrust(self, wanted: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        p = self.p
        speed = ca.sqrt(ca.sumsqr(wanted[:2]))
        horizontal = wanted[:2] * ca.fmin(1, p["cap"] / ca.fmax(speed, 1e-6))
        turn = _yaw_limit(p)
        clamped = ca.vertcat(
            horizontal,
            ca.fmin(ca.fmax(wanted[2], -_CLIMB), _CLIMB),
            ca.fmin(ca.fmax(wanted[3], -turn), turn),
        )
        tau, integral, saturated = velocity_control(
            clamped, self.u["nu"], self.x["integral"], p, k_v=p["k_v"], k_r=p["k_r"], k_i=p["k_i"], dt=self.dt
        )
        return tau, integral, saturated, clamped

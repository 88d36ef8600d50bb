"""Function `build_law`, which assembles a law from perception, guidance, tasks, priority and velocity control."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cache
from typing import cast, get_args

import casadi as ca

from surctl.control.baselines import Situation
from surctl.control.closed_form import CLOSED_FORM_PORTS, DAMPING, known_obstacle
from surctl.control.closing import CLIMB, Closing, Memory, yaw_limit
from surctl.control.dead_end import DEAD_END_PORTS, dead_end_next, standing
from surctl.control.decision import DECISION_PORTS, Decision, Scan
from surctl.control.echoes import perceive, perception_ports
from surctl.control.law import (
    DEGRADED,
    DEPTH_PORT,
    SWITCHED,
    TELEMETRY,
    TRAPPED,
    TRAPPED_PORT,
    Law,
    Stages,
    scan_telemetry,
)
from surctl.control.layers import LAYER_PORTS, aimed_depth
from surctl.control.perception import PerceptionStage, build_perception
from surctl.control.ports import (
    CONTACT_SLOTS,
    DEFAULT_ARRAY,
    PARAMETERS,
    SECTORS,
    law_inputs,
    scan_inputs,
    sonar_inputs,
)
from surctl.control.reference import learnt, path_following
from surctl.control.registry import LAW_NAMES, LAWS, LawName
from surctl.control.routines import limited, sensing
from surctl.control.stopping import BARRIER_NAMES, MOVERS, Barrier, Movers
from surctl.control.stored import law_bytes, law_from
from surctl.errors import InputError, SurctlError, nearest
from surctl.guidance import FORMS, AvoidanceForm, Guidance, check_guidance
from surctl.ir import Layout, Port, Recording, cached_bytes, fold, source_digest, tabulated, without_libm
from surctl.priority import Fallback, Mode, check_fallback, nsb_symbolic
from surctl.sensing import Equipment
from surctl.tasks import LimitRow, VelocityBox

__all__ = ["MODES", "build_law"]

DEFAULT_EQUIPMENT = Equipment()
MODES: tuple[Mode, ...] = get_args(Mode)

_STEP_INPUTS = ("J", "reference", "rows", "box")


_SOURCES = tuple(
    f"surctl.{name}" for name in ("control", "errors", "guidance", "ir", "priority", "sensing", "tasks", "vehicle")
)
"""Packages whose source code determines the instructions of a law."""


def build_law(
    law: str = "guarded",
    *,
    avoidance: str = "corrected",
    mode: str = "nsb",
    dt: float = 0.05,
    contacts: int = CONTACT_SLOTS,
    sonar: bool = False,
    equipment: Equipment = DEFAULT_EQUIPMENT,
    moving: bool = True,
    guidance: str = "los",
    barrier: str = "simple",
    movers: str = "predict",
    depths: bool = False,
    fallback: str = "exact",
) -> Law:
    """Return a law, assembled in this call or taken from the cache; the gains remain inputs of the law.

    Args:
        law: `guarded`, the paper's law `paper`, `closed_form`, or a textbook law: `apf`, `dwa`, `vo`, `cbf`.
        avoidance: form of equation (20); all laws except `paper` accept only `corrected`.
        mode: priority mode: `nsb` ignores limits; `filter`, `projected` and `lexicographic` respect them.
        dt: control period [s].
        contacts: number of slots for known obstacles; the number does not change the result as long as there is a slot
            for each known obstacle.
        sonar: whether the law uses the sonars; a law without sonars needs true obstacle positions as input.
        equipment: the sensors that a law with sonars assumes; the law `paper` always uses the paper's four sonars.
        moving: whether known obstacles may move; False gives the same result as long as no obstacle moves.
        guidance: path following: `los`, `ilos` or `alos`; `ilos` and `alos` adapt to a steady disturbance (see
            `guidance.crosstrack`).
        barrier: bound of law `guarded` on its closing speed. `simple` uses the braking distance s²/(2a) + s t.
            `inertia` uses the closed form of `guidance.braking` for the worst case of the vehicle's parameter ranges.
            With sonars and `inertia`, the robot cannot pass through the pool, where clearances are a few centimetres.
        movers: how law `guarded` avoids moving obstacles. `predict` predicts their paths and evades sideways; `barrier`
            uses only the barrier.
        depths: whether `guarded` may leave a dead end at another depth; then the law needs the free water above and
            below as input `column` (see `control.layers`). All other laws always stay at the path's depth.
        fallback: what modes `filter` and `projected` do if they cannot satisfy all limits and task 1: `exact` or
            `bounded`; `bounded` gives a safe result within a fixed number of operations and sets `DEGRADED` in the
            status.

    Raises:
        InputError: a name is unknown, or the law does not support the chosen option.

    Example:
        >>> from surctl.control import build_law
        >>> law = build_law("closed_form")
        >>> law.name, law.mode, law.outputs.ports[0].name
        ('surctl_closed_form', 'nsb', 'tau')
        >>> build_law() is build_law("guarded", dt=0.05)  # built once
        True
    """
    names: tuple[tuple[str, str, tuple[str, ...]], ...] = (
        ("law", law, LAW_NAMES),
        ("avoidance", avoidance, FORMS),
        ("priority-mode", mode, MODES),
        ("barrier", barrier, BARRIER_NAMES),
        ("movers", movers, MOVERS),
    )
    for key, value, known in names:
        if value not in known:
            raise InputError("is not known", key=key, value=value, remedy=nearest(str(value), known))
        if key in ("barrier", "movers") and law != "guarded" and value != known[0]:
            raise InputError(f"law {law} has no such option", key=key, value=value, remedy="use law guarded")
    check_guidance(guidance)
    check_fallback(fallback, mode=mode)
    if law != "paper" and avoidance != "corrected":
        raise InputError(
            f"law {law} accepts only the corrected form",
            key="avoidance",
            value=avoidance,
            remedy="use law paper to compare the forms",
        )
    if law == "paper" and sonar and equipment.array != DEFAULT_ARRAY:
        raise InputError("law paper always has the four sonars of the paper", key="array", remedy="use law guarded")
    depths = depths and law == "guarded"
    if law == "closed_form":
        if sonar or mode != "nsb":
            raise InputError(
                "law closed_form uses no sensors and respects no limits",
                key="sensing" if sonar else "priority-mode",
                remedy="set --sensing truth and --priority-mode nsb",
            )
        contacts = 1
    return _cached_law(
        _Configuration(
            cast("LawName", law),
            cast("AvoidanceForm", avoidance),
            cast("Mode", mode),
            dt,
            contacts,
            sonar,
            equipment,
            moving,
            cast("Guidance", guidance),
            cast("Barrier", barrier),
            cast("Movers", movers),
            depths,
            cast("Fallback", fallback),
        )
    )


@dataclass(frozen=True)
class _Configuration:
    # checked arguments of `build_law`; equal arguments give the same law object
    law: LawName
    avoidance: AvoidanceForm
    mode: Mode
    dt: float
    contacts: int
    sonar: bool
    equipment: Equipment
    moving: bool
    guidance: Guidance
    barrier: Barrier
    movers: Movers
    depths: bool
    fallback: Fallback


@cache
def _cached_law(chosen: _Configuration) -> Law:
    try:
        sources = source_digest(*_SOURCES)
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify a cached law
        return _built(chosen)
    built: list[Law] = []

    def build() -> bytes:
        built.append(_built(chosen))
        return law_bytes(built[0])

    key = hashlib.sha256(f"{sources}\0{chosen!r}".encode()).hexdigest()
    stored = cached_bytes(key, ".law", build)
    return built[0] if built else law_from(stored)


def _built(c: _Configuration) -> Law:
    if c.law == "paper" or not c.sonar:
        decision_inputs = law_inputs(c.contacts, sonar=c.sonar, depths=c.depths)
        return _decide(c, decision_inputs, sonar=c.sonar, moving=c.moving)
    decision_inputs = scan_inputs(c.contacts + SECTORS, sensors=c.equipment.array.size, depths=c.depths)
    inputs = sonar_inputs(c.equipment, contacts=c.contacts, depths=c.depths)
    return _with_perception(
        _decide(c, decision_inputs), build_perception(c.equipment, inputs, decision_inputs, dt=c.dt)
    )


def _with_perception(decide: Law, perception: PerceptionStage) -> Law:
    state = Layout((*decide.state.ports, *perception.state.ports))
    block = sensing(decide.block, decide.state, perception)
    return replace(decide, state=state, inputs=perception.inputs, block=block, perception=perception)


def _decide(chosen: _Configuration, inputs: Layout, *, sonar: bool = False, moving: bool = True) -> Law:
    """Return the law without perception; for a law that scans with sonars, this is the part after perception.

    In a law with perception, the decision assumes that every contact may move.
    """
    law, avoidance, mode, dt, guidance = chosen.law, chosen.avoidance, chosen.mode, chosen.dt, chosen.guidance
    barrier, movers, fallback = chosen.barrier, chosen.movers, chosen.fallback
    scans = "unknown" in inputs
    depths, closed_form = "column" in inputs, law == "closed_form"
    decided = CLOSED_FORM_PORTS if closed_form else DECISION_PORTS
    state = _state_layout(dt, guidance, gives_up=law == "guarded", sonar=sonar, depths=depths, decided=decided)
    listed = scan_telemetry(inputs.port("sonars").shape[0]) if scans else TELEMETRY
    outputs = Layout((*listed, *((TRAPPED_PORT,) if "trapped" in state else ()), *((DEPTH_PORT,) if depths else ())))
    x, xs = state.symbols("x")
    u, us = inputs.symbols("u")
    p, ps = PARAMETERS.symbols("p")
    with Recording() as recording:
        desired = path_following(us["eta"], xs["progress"], ps, dt=dt, guidance=guidance, memory=xs.get("drift"))
        if "trapped" in xs:
            desired = standing(desired, xs, us["eta"], ps)
        parameters, layer_depth = ps, ps["depth"]
        if depths:
            layer_depth, aimed = aimed_depth(xs, us["eta"], us["nu"], us["column"], ps)
            parameters = {**ps, "depth": aimed}
        perceived = known_obstacle(us, ps) if closed_form else perceive(xs, us, ps, dt=dt)
        scan = Scan(us["unknown"], us["sonars"], us["placed"]) if scans else None
        decision = LAWS[law](
            Situation(
                avoidance, desired, perceived, xs, us["eta"], us["nu"], parameters, dt, scan, moving, barrier, movers
            )
        )
        clearances = tabulated([[contact.clearance] for contact in perceived.all], 1)
        nearest_clearance = fold("nearest", ca.fmin, ca.SX(100), clearances)
        unknown = {"tau": ca.SX.zeros(4), "nu_reference": ca.SX.zeros(4)}
        reported = {
            "path_error": ca.vertcat(desired.x_e, desired.y_e),
            "avoiding": decision.avoiding,
            "nearest": nearest_clearance,
            "ranges": perceived.ranges,
        }
        if scans:
            sonars = us["sonars"]
            reported |= {
                "ranges": sonars[:, 0],
                "bounds": sonars[:, 1],
                "healthy": sonars[:, 2],
                "stopped": decision.stopped,
            }
        carried = {**perceived.state, **decision.state, "progress": desired.progress, "integral": xs["integral"]}
        if "drift" in xs:
            carried["drift"] = learnt(guidance, desired, xs["drift"], us["eta"], us["nu"], decision.avoiding, ps, dt=dt)
        if "trapped" in xs:
            depth_inputs = us["nu"], us.get("column")
            dead_end = dead_end_next(
                desired, perceived.known if moving else (), xs, us["eta"], decision.stopped, ps, *depth_inputs, dt=dt
            )
            carried |= dead_end
            reported["trapped"] = dead_end["trapped"]
        if depths:
            reported["depth_reference"] = layer_depth
            # while the law follows another depth, the distance to the path is not a tracking error
            reported["avoiding"] = ca.logic_or(reported["avoiding"], ca.fabs(xs["layer"]) > 0)
        flags = SWITCHED * ca.logic_not(decision.state["side"] == xs["side"]) + DEGRADED * decision.degraded
        flags += TRAPPED * reported.get("trapped", 0)
        memory = Memory(state.join(carried), outputs.join({**unknown, **reported})[8:], flags)

    rows = _rows(decision, ps)
    levels = tuple((level.name, int(level.J.shape[0]), level.unit) for level in decision.levels)
    nsb = nsb_symbolic(
        [(level.J, level.reference) for level in decision.levels], damping=DAMPING if closed_form else 0.0
    )
    close = Closing(state, outputs, u, us, p, ps, dt)
    arguments = {"x": x, "u": u, "p": p}
    closed = recording.block("law", arguments, close.outputs_of(memory, nsb, ca.SX(0)))
    step_inputs = dict(zip(_STEP_INPUTS, _step_inputs(decision, rows, ps), strict=True))
    pre = recording.block("pre", arguments, {**step_inputs, **memory._asdict()})
    post = close.block()
    return Law(
        name=f"surctl_{law}",
        avoidance=avoidance,
        mode=mode,
        dt=dt,
        state=state,
        inputs=inputs,
        gains=PARAMETERS,
        outputs=outputs,
        # without libm functions such as sin, every compiler and processor gives identical results
        block=without_libm(
            closed if mode == "nsb" else limited(mode, pre, post, levels=levels, rows=len(rows), fallback=fallback)
        ),
        stages=Stages(lambda: closed, lambda: pre, lambda: post),
        levels=levels,
        rows=tuple(row.name for row in rows),
        guidance=guidance,
        barrier=barrier,
        movers=movers,
        fallback=fallback,
    )


def _rows(decision: Decision, p: dict[str, ca.SX]) -> list[LimitRow]:
    # first the rows of the velocity box, then those of the barriers: l ≤ a·v ≤ u
    most = ca.vertcat(p["cap"], p["cap"], CLIMB, yaw_limit(p))
    return [*VelocityBox(-most, most).rows(), *(row for limit in decision.rows for row in limit.rows())]


def _step_inputs(decision: Decision, rows: list[LimitRow], p: dict[str, ca.SX]) -> list[ca.SX]:
    # J row by row; references; limit rows (a, lower, upper, whether the row may be relaxed); velocity box
    flat = [ca.vertcat(row.a.T, row.lower, row.upper, row.kind != "actuator") for row in rows]
    box = [ca.vertcat(*(getattr(row, side) for row in rows[:4])) for side in ("lower", "upper")]
    J = ca.vertcat(*(level.J for level in decision.levels))
    outputs = [
        ca.vec(J.T),
        ca.vertcat(*(level.reference for level in decision.levels)),
        ca.vertcat(*flat),
        ca.vertcat(*box),
    ]
    return [ca.densify(output) for output in outputs]


def _state_layout(
    dt: float, guidance: Guidance, *, gives_up: bool, sonar: bool, depths: bool, decided: tuple[Port, ...]
) -> Layout:
    unit = {"ilos": "s", "alos": "1"}.get(guidance, "")
    memory = (Port("drift", (1,), unit, f"estimate of guidance {guidance} for a steady disturbance"),) if unit else ()
    return Layout(
        (
            Port("progress", (1,), "m", "arc length of the target point on the path"),
            Port("integral", (4,), "m/s^2, rad/s^2", "integral action of the velocity loops"),
            *memory,
            *(DEAD_END_PORTS if gives_up else ()),
            *(LAYER_PORTS if depths else ()),
            *decided,
            *perception_ports(dt, sonar=sonar),
        )
    )

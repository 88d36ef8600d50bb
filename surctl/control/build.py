"""Assemble a law from its parts: perception, guidance, tasks, priority, velocity control."""

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
"""What the text of a law depends on."""


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
    """Assemble a law once; the gains stay symbols.

    Args:
        law: `guarded`, the printed stack `paper`, or a textbook law: `apf`, `dwa`, `vo`, `cbf` (`control.baselines`).
        avoidance: form of (20); all but `paper` take `corrected` alone.
        mode: `nsb`, which knows no limits, or one that keeps them: `filter`, `projected`, `lexicographic`.
        dt: control period [s].
        contacts: slots for known obstacles; a law with fewer does the same as long as they suffice.
        sonar: whether it listens to the sonars; without them it needs true positions.
        equipment: what a law with sonars believes it senses with; `paper` has the paper's four sonars.
        moving: whether a known obstacle may move; without that it does the same as long as none does.
        guidance: how the path is followed: `los`, or with memory against a steady push, `ilos` or `alos`, see
            `guidance.crosstrack`.
        barrier: of `guarded`, how fast it lets itself come nearer: `simple`, s²/(2a) + s t, or `inertia`, the closed
            form of `guidance.braking` at the worst of the vehicle's ranges.
            With sonars `inertia` does not get through the pool, where there are centimetres only.
        movers: what `guarded` does about what moves: `predict` its way and sidestep, or keep the `barrier` to it too.
        depths: whether `guarded` may leave a dead end by another depth; it is then told of the water above and below
            (`column`, see `control.layers`). Other laws keep to the path's depth.
        ladder: of modes `filter` and `projected`, where limits and task 1 cannot all be kept: `exact`, or `bounded`,
            with a safe answer within a fixed number of operations; the status has `DEGRADED` then.

    Raises:
        InputError: an unknown name, or a form that the law does not take.

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
            raise InputError(f"law {law} has none", key=key, value=value, remedy="fly law guarded")
    check_guidance(guidance)
    check_fallback(fallback, mode=mode)
    if law != "paper" and avoidance != "corrected":
        raise InputError(
            f"law {law} takes the corrected form only",
            key="avoidance",
            value=avoidance,
            remedy="compare the forms with law paper",
        )
    if law == "paper" and sonar and equipment.array != DEFAULT_ARRAY:
        raise InputError("law paper has the four sonars of the paper", key="array", remedy="fly law guarded")
    depths = depths and law == "guarded"
    if law == "closed_form":
        if sonar or mode != "nsb":
            raise InputError(
                "law closed_form senses nothing, and keeps no limits",
                key="sensing" if sonar else "priority-mode",
                remedy="--sensing truth, --priority-mode nsb",
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
    """The arguments of `build_law` once they are checked: laws of equal ones are one."""

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
    """The law from the cache on disk, where an earlier process with the same sources has built it."""
    try:
        sources = source_digest(*_SOURCES)
    except SurctlError:  # no sources, or they changed under this process: what is built is not known by them
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
    """The whole law: what the senses tell, decided on."""
    state = Layout((*decide.state.ports, *perception.state.ports))
    block = sensing(decide.block, decide.state, perception)
    return replace(decide, state=state, inputs=perception.inputs, block=block, perception=perception)


def _decide(chosen: _Configuration, inputs: Layout, *, sonar: bool = False, moving: bool = True) -> Law:
    """The law, or what of it comes after the senses; there everything may move."""
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
            # as beside the path: what is flown there is no error of following it
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
        # the same bytes from every compiler on every processor
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
    """The velocity box, then the barriers."""
    most = ca.vertcat(p["cap"], p["cap"], CLIMB, yaw_limit(p))
    return [*VelocityBox(-most, most).rows(), *(row for limit in decision.rows for row in limit.rows())]


def _step_inputs(decision: Decision, rows: list[LimitRow], p: dict[str, ca.SX]) -> list[ca.SX]:
    """J row by row, references, rows (a, lower, upper, may open), box."""
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
    memory = (Port("drift", (1,), unit, f"what guidance {guidance} has learnt of a steady push"),) if unit else ()
    return Layout(
        (
            Port("progress", (1,), "m", "arc length of the path's target"),
            Port("integral", (4,), "m/s^2, rad/s^2", "integral action of the velocity loops"),
            *memory,
            *(DEAD_END_PORTS if gives_up else ()),
            *(LAYER_PORTS if depths else ()),
            *decided,
            *perception_ports(dt, sonar=sonar),
        )
    )

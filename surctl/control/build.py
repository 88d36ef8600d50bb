"""Assemble a law from its parts: perception, guidance, tasks, priority, velocity control."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cache
from typing import cast, get_args

import casadi as ca

from surctl.control.baselines import Situation
from surctl.control.closing import CLIMB, Closing, Memory, yaw_limit
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
from surctl.control.lean import DAMPING, LEAN_PORTS, told_obstacle
from surctl.control.ports import (
    CONTACT_SLOTS,
    DEFAULT_ARRAY,
    PARAMETERS,
    SECTORS,
    law_inputs,
    scan_inputs,
    sonar_inputs,
)
from surctl.control.reference import learnt, path_wish
from surctl.control.registry import LAW_NAMES, LAWS, LawName
from surctl.control.routines import limited, sensing
from surctl.control.senses import Senses, build_senses
from surctl.control.stopping import BARRIER_NAMES, MOVERS, Barrier, Movers
from surctl.control.stored import law_bytes, law_from
from surctl.control.trap import TRAP_PORTS, standing, trap_next
from surctl.errors import InputError, SurctlError, nearest
from surctl.guidance import FORMS, AvoidanceForm, Guidance, check_guidance
from surctl.ir import Layout, Port, Recording, cached_bytes, fold, source_digest, tabulated, without_libm
from surctl.priority import Ladder, Mode, check_ladder, nsb_symbolic
from surctl.sensing import Equipment
from surctl.tasks import LimitRow, VelocityBox

__all__ = ["MODES", "build_law"]

DEFAULT_EQUIPMENT = Equipment()
MODES: tuple[Mode, ...] = get_args(Mode)

_TICK_INPUTS = ("J", "wanted", "rows", "box")


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
    ladder: str = "exact",
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
        >>> law = build_law("lean")
        >>> law.name, law.mode, law.outputs.ports[0].name
        ('surctl_lean', 'nsb', 'tau')
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
    check_ladder(ladder, mode=mode)
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
    if law == "lean":
        if sonar or mode != "nsb":
            raise InputError(
                "law lean senses nothing, and keeps no limits",
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
            cast("Ladder", ladder),
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
    ladder: Ladder


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
        told = law_inputs(c.contacts, sonar=c.sonar, depths=c.depths)
        return _decide(c, told, sonar=c.sonar, moving=c.moving)
    told = scan_inputs(c.contacts + SECTORS, sensors=c.equipment.array.size, depths=c.depths)
    given = sonar_inputs(c.equipment, contacts=c.contacts, depths=c.depths)
    return _with_senses(_decide(c, told), build_senses(c.equipment, given, told, dt=c.dt))


def _with_senses(decide: Law, senses: Senses) -> Law:
    """The whole law: what the senses tell, decided on."""
    state = Layout((*decide.state.ports, *senses.state.ports))
    block = sensing(decide.block, decide.state, senses)
    return replace(decide, state=state, inputs=senses.inputs, block=block, senses=senses)


def _decide(chosen: _Configuration, inputs: Layout, *, sonar: bool = False, moving: bool = True) -> Law:
    """The law, or what of it comes after the senses; there everything may move."""
    law, avoidance, mode, dt, guidance = chosen.law, chosen.avoidance, chosen.mode, chosen.dt, chosen.guidance
    barrier, movers, ladder = chosen.barrier, chosen.movers, chosen.ladder
    scans = "unknown" in inputs
    depths, lean = "column" in inputs, law == "lean"
    decided = LEAN_PORTS if lean else DECISION_PORTS
    state = _state_layout(dt, guidance, gives_up=law == "guarded", sonar=sonar, depths=depths, decided=decided)
    listed = scan_telemetry(inputs.port("heard").shape[0]) if scans else TELEMETRY
    outputs = Layout((*listed, *((TRAPPED_PORT,) if "trapped" in state else ()), *((DEPTH_PORT,) if depths else ())))
    x, xs = state.symbols("x")
    u, us = inputs.symbols("u")
    p, ps = PARAMETERS.symbols("p")
    with Recording() as recording:
        wish = path_wish(us["eta"], xs["progress"], ps, dt=dt, guidance=guidance, memory=xs.get("drift"))
        if "trapped" in xs:
            wish = standing(wish, xs, us["eta"], ps)
        asked, layer_depth = ps, ps["depth"]
        if depths:
            layer_depth, aimed = aimed_depth(xs, us["eta"], us["nu"], us["column"], ps)
            asked = {**ps, "depth": aimed}
        seen = told_obstacle(us, ps) if lean else perceive(xs, us, ps, dt=dt)
        scan = Scan(us["unknown"], us["heard"], us["placed"]) if scans else None
        decision = LAWS[law](
            Situation(avoidance, wish, seen, xs, us["eta"], us["nu"], asked, dt, scan, moving, barrier, movers)
        )
        clearances = tabulated([[contact.clearance] for contact in seen.all], 1)
        nearest_clearance = fold("nearest", ca.fmin, ca.SX(100), clearances)
        unknown = {"tau": ca.SX.zeros(4), "nu_wanted": ca.SX.zeros(4)}
        told = {
            "path_error": ca.vertcat(wish.x_e, wish.y_e),
            "avoiding": decision.avoiding,
            "nearest": nearest_clearance,
            "ranges": seen.ranges,
        }
        if scans:
            heard = us["heard"]
            told |= {"ranges": heard[:, 0], "bounds": heard[:, 1], "healthy": heard[:, 2], "halted": decision.halted}
        carried = {**seen.state, **decision.state, "progress": wish.progress, "integral": xs["integral"]}
        if "drift" in xs:
            carried["drift"] = learnt(guidance, wish, xs["drift"], us["eta"], us["nu"], decision.avoiding, ps, dt=dt)
        if "trapped" in xs:
            told_of = us["nu"], us.get("column")
            trap = trap_next(wish, seen.known if moving else (), xs, us["eta"], decision.halted, ps, *told_of, dt=dt)
            carried |= trap
            told["trapped"] = trap["trapped"]
        if depths:
            told["wanted_depth"] = layer_depth
            # as beside the path: what is flown there is no error of following it
            told["avoiding"] = ca.logic_or(told["avoiding"], ca.fabs(xs["layer"]) > 0)
        flags = SWITCHED * ca.logic_not(decision.state["side"] == xs["side"]) + DEGRADED * decision.degraded
        flags += TRAPPED * told.get("trapped", 0)
        memory = Memory(state.join(carried), outputs.join({**unknown, **told})[8:], flags)

    rows = _rows(decision, ps)
    levels = tuple((level.name, int(level.J.shape[0]), level.unit) for level in decision.levels)
    nsb = nsb_symbolic([(level.J, level.reference) for level in decision.levels], damping=DAMPING if lean else 0.0)
    close = Closing(state, outputs, u, us, p, ps, dt)
    given = {"x": x, "u": u, "p": p}
    closed = recording.block("law", given, close.outputs_of(memory, nsb, ca.SX(0)))
    tick = dict(zip(_TICK_INPUTS, _tick_inputs(decision, rows, ps), strict=True))
    pre = recording.block("pre", given, {**tick, **memory._asdict()})
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
            closed if mode == "nsb" else limited(mode, pre, post, levels=levels, rows=len(rows), ladder=ladder)
        ),
        stages=Stages(lambda: closed, lambda: pre, lambda: post),
        levels=levels,
        rows=tuple(row.name for row in rows),
        guidance=guidance,
        barrier=barrier,
        movers=movers,
        ladder=ladder,
    )


def _rows(decision: Decision, p: dict[str, ca.SX]) -> list[LimitRow]:
    """The velocity box, then the barriers."""
    most = ca.vertcat(p["cap"], p["cap"], CLIMB, yaw_limit(p))
    return [*VelocityBox(-most, most).rows(), *(row for limit in decision.rows for row in limit.rows())]


def _tick_inputs(decision: Decision, rows: list[LimitRow], p: dict[str, ca.SX]) -> list[ca.SX]:
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
            *(TRAP_PORTS if gives_up else ()),
            *(LAYER_PORTS if depths else ()),
            *decided,
            *perception_ports(dt, sonar=sonar),
        )
    )

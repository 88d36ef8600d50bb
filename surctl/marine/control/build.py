"""Function `build_law`: a law assembled or from the cache, options that it refuses, its form for 32-bit numbers.

A law is pickled in the cache. Only files of the cache are unpickled: they belong to this user, nobody else can write
them, and the cache checks a digest of their bytes; it also holds the libraries that this process loads.
"""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, cast, get_args

import casadi as ca

from surctl.errors import InputError, SurctlError, check_known, mistakes_in
from surctl.ir import Block, Call, Layout, Real, Recording, Routine, fold, tabulated, without_libm
from surctl.ir.c99 import rearranged
from surctl.ir.cache import cached_bytes, source_digest
from surctl.marine.control.closing import CLIMB, Closing, Memory, yaw_limit
from surctl.marine.control.dead_end import aimed_depth, dead_end_next, forgetting, standing
from surctl.marine.control.decision import Decision, Scan, Situation, TaskLevel, perceive
from surctl.marine.control.law import (
    DEGRADED,
    DEPTH_PORT,
    PRECISIONS,
    SWITCHED,
    TELEMETRY,
    TRAPPED,
    TRAPPED_PORT,
    Law,
    Stages,
    scan_telemetry,
    with_allocation,
)
from surctl.marine.control.perception import PerceptionStage, build_perception
from surctl.marine.control.ports import (
    CONTACT_SLOTS,
    DEFAULT_ARRAY,
    PARAMETERS,
    SECTORS,
    law_inputs,
    parameter_ports,
    scan_inputs,
    sonar_inputs,
)
from surctl.marine.control.reference import learnt, path_following
from surctl.marine.control.registry import SONARLESS, law_ref, law_source
from surctl.marine.control.source import LawSource, decision_of, perceived_by, state_layout, thrust_of
from surctl.marine.control.stopping import BARRIER_NAMES, MOVERS, Barrier, Movers
from surctl.marine.guidance import FORMS, AvoidanceForm, Guidance
from surctl.marine.guidance.tracking import check_guidance
from surctl.marine.sensing import Equipment
from surctl.marine.vehicle import Actuators
from surctl.own_code import is_own, label, own_file
from surctl.priority import Fallback, LevelShape, Mode, check_fallback, nsb_symbolic, priority_step
from surctl.tasks import LimitRow, VelocityBox


def _limit_rows(decision: Decision, p: dict[str, ca.SX]) -> list[LimitRow]:
    """Return the limits l ≤ a·ν ≤ u: first the four of the velocity box, then those of the barriers."""
    most = ca.vertcat(p["cap"], p["cap"], CLIMB, yaw_limit(p))
    return [*VelocityBox(-most, most).rows(), *(row for limit in decision.rows for row in limit.rows())]


def _solver_inputs(levels: Sequence[TaskLevel], rows: Sequence[LimitRow]) -> dict[str, ca.SX]:
    """Return J by rows, the references, the limits (a, lower, upper, may be relaxed?), and the velocity box."""
    flat = [ca.vertcat(row.a.T, row.lower, row.upper, row.kind != "actuator") for row in rows]
    inputs = {
        "J": ca.vec(ca.vertcat(*(level.J for level in levels)).T),
        "reference": ca.vertcat(*(level.reference for level in levels)),
        "rows": ca.vertcat(*flat),
        "box": ca.vertcat(*(getattr(row, side) for side in ("lower", "upper") for row in rows[:4])),
    }
    return {name: ca.densify(value) for name, value in inputs.items()}


_STAGES = ("closed", "pre", "post")


def _pickled(block: Block) -> bytes:
    block.digest()  # stored with the block, so that no process computes it again
    return pickle.dumps(block)


def law_bytes(law: Law) -> bytes:
    """Return the law, and those of its stages that are built, as bytes that `law_from` can read."""
    law.block.digest()
    stages = {name: _pickled(getattr(law.stages, name)) for name in _STAGES if name in law.stages.__dict__}
    return pickle.dumps((replace(law, stages=None), stages))  # type: ignore[arg-type]  # `law_from` adds them


def law_from(stored: bytes, other: Callable[[str], Block]) -> Law:
    """Load a law from the bytes of `law_bytes`; each of its stages is loaded when it is first used.

    `other` returns a stage by name that the bytes do not contain; it is called when that stage is needed.
    """
    law: Law
    stages: dict[str, bytes]
    law, stages = pickle.loads(stored)
    load = {name: partial(pickle.loads, stages[name]) if name in stages else partial(other, name) for name in _STAGES}
    return replace(law, stages=Stages(**load))


_MEMORY = ("carried", "reported", "flags")


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
    step = priority_step(mode, n=4, levels=shapes, rows=rows, precision=PRECISIONS[real], fallback=fallback)
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
    these tolerances. Without allocation to thrusters, a law in mode nsb is returned unchanged, because it uses no
    solver tolerances.
    """
    if real == "float64":
        return law
    if law.base is not None and law.actuators is not None:
        base = in_real(law.base, real)
        if base.mode == "nsb" and base.perception is None:
            base = replace(base, block=without_libm(base.stages.closed, real))
        return with_allocation(base, law.actuators, real=real)
    if law.mode == "nsb":
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


DEFAULT_EQUIPMENT = Equipment()
MODES: tuple[Mode, ...] = get_args(Mode)

LAW_SOURCES = tuple(
    f"surctl.{name}"
    for name in (
        *("errors", "ir", "priority", "tasks"),
        *("marine.control", "marine.guidance", "marine.sensing", "marine.vehicle"),
    )
)
"""Packages whose source code determines the instruction list of a law."""


def law_options(subject: Any) -> dict[str, Any]:
    """Return the options of `build_law` that a law, and whatever describes one, has as attributes of the same names.

    Example:
        >>> from surctl.marine.control import build_law, law_options
        >>> law_options(build_law(barrier="inertia"))["barrier"]
        'inertia'
    """
    return {name: getattr(subject, name) for name in ("avoidance", "mode", "guidance", "barrier", "movers")}


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
    actuators: Actuators | None = None,
) -> Law:
    """Build a law, or load it from the cache; the values of its gains are inputs of the law, not part of it.

    Args:
        law: `guarded`, `calm` (`guarded` by sonar with smoothed commands), `steered`, the paper's law `paper`,
            `closed_form`, or FILE.py:FUNCTION (see `law_ref`).
        avoidance: form of the avoidance velocity, equation (20) of the paper; all laws except `paper` accept only
            `corrected`.
        mode: priority mode: `nsb` ignores limits; `filter`, `projected` and `lexicographic` respect them.
        dt: control period [s].
        contacts: number of known obstacles that the law's input can hold; a larger number than needed does not change
            the commands.
        sonar: whether the law uses the sonars; a law without sonars needs true obstacle positions as input.
        equipment: the sensors that a law with sonars assumes; the law `paper` always uses the paper's four sonars.
        moving: whether known obstacles may move; if no obstacle moves, the commands are equal with True and False.
        guidance: path following: `los`, `ilos` or `alos`; `ilos` and `alos` adapt to a steady disturbance (see
            `guidance.tracking`).
        barrier: bound of law `guarded` on its closing speed s. `simple` uses the braking distance s²/(2a) + s t with
            the deceleration a and the reaction time t. `inertia` uses the closed form of `guidance.braking` for the
            worst case of the vehicle's parameter ranges. With sonars and `inertia`, the robot cannot pass through the
            pool, where clearances are a few centimetres.
        movers: how law `guarded` avoids moving obstacles. `predict` predicts their paths and evades sideways; `barrier`
            only limits the closing speed.
        depths: whether law `guarded` may leave a dead end at another depth; if so, its input `column` must give the
            free water above and below the hull (see `control.dead_end`). All other laws stay at the path's depth.
        fallback: how modes `filter` and `projected` proceed if they cannot satisfy all limits and task 1: `exact` or
            `bounded`. `bounded` computes a safe command in a fixed number of operations and sets `DEGRADED` in the
            status.
        actuators: the vehicle's thrusters (`vehicle.actuators`). The law then allocates its thrust to them: `tau` is
            the force that they achieve together, and the outputs contain their forces and commands (see
            `control.law`). None: `tau` is the commanded force, limited on each axis.

    Raises:
        InputError: a name is unknown, or the law does not support the chosen option.

    Example:
        >>> from surctl.marine.control import build_law
        >>> law = build_law("closed_form")
        >>> law.name, law.mode, law.outputs.ports[0].name
        ('surctl_closed_form', 'nsb', 'tau')
        >>> build_law() is build_law("guarded", dt=0.05)  # built once
        True
    """
    law = law_ref(law)
    source, called = law_source(law), label(law)
    names: tuple[tuple[str, str, tuple[str, ...]], ...] = (
        ("avoidance", avoidance, FORMS),
        ("priority-mode", mode, MODES),
        ("barrier", barrier, BARRIER_NAMES),
        ("movers", movers, MOVERS),
    )
    for key, value, known in names:
        check_known(value, known, key=key)
        if key in ("barrier", "movers") and key not in source.options and value != known[0]:
            raise InputError(f"law {called} has no such option", key=key, value=value, remedy="use law guarded")
    check_guidance(guidance)
    check_fallback(fallback, mode=mode)
    if "avoidance" not in source.options and avoidance != "corrected":
        problem = f"law {called} accepts only the corrected form"
        raise InputError(problem, key="avoidance", value=avoidance, remedy="use law paper to compare the forms")
    if sonar and not source.scans and equipment.assumed.array != DEFAULT_ARRAY:
        raise InputError(f"law {called} always has the four sonars of the paper", key="array", remedy="use law guarded")
    kind = "sonar" if sonar else "truth"
    for key, value, supported in (("sensing", kind, source.sensing), ("priority-mode", mode, source.modes or MODES)):
        if value not in supported:
            why = f", because {SONARLESS}" if key == "sensing" and source.steering is not None else ""
            problem = f"law {called} supports only {' and '.join(supported)}{why}"
            raise InputError(problem, key=key, value=value, remedy=f"set --{key} {supported[0]}")
    contacts = contacts if source.slots is None else source.slots
    depths = depths and "depths" in source.options
    chosen = _Configuration(
        law, cast("AvoidanceForm", avoidance), cast("Mode", mode), dt, contacts, sonar, equipment.assumed, moving,
        cast("Guidance", guidance), cast("Barrier", barrier), cast("Movers", movers), depths,
        cast("Fallback", fallback),
    )  # fmt: skip
    built = _cached_law(chosen)
    return built if actuators is None else with_allocation(built, actuators)


@dataclass(frozen=True)
class _Configuration:
    """The arguments of `build_law` after their check; for equal arguments, `build_law` returns the same law object."""

    law: str
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
    """Return the law from the cache on disk, or build it if no process with this source code has stored it.

    A law of the user's own is built again in every process, because the modules that its file imports may have changed.
    """
    if is_own(chosen.law):
        with mistakes_in(own_file(chosen.law)):
            own = _built(chosen)
            _ = own.stages.pre  # the limit rows of the user's law are checked too, in every mode
            return own
    try:
        sources = source_digest(*LAW_SOURCES)
    except SurctlError:  # the source code is missing or changed since the import, so it cannot identify a cached law
        return _built(chosen)
    built: list[Law] = []

    def build() -> bytes:
        built.append(_built(chosen))
        return law_bytes(built[0])

    def part(name: str) -> Block:
        stage: Block = pickle.loads(
            cached_bytes(key, f".{name}", lambda: _pickled(getattr(_built(chosen).stages, name)))
        )
        return stage

    key = hashlib.sha256(f"{sources}\0{chosen!r}".encode()).hexdigest()
    stored = cached_bytes(key, ".law", build)
    return built[0] if built else law_from(stored, part)


def build_law_of(source: LawSource) -> Law:
    """Build the law of a source for exact obstacle positions, in its first priority mode; the law is not cached."""
    mode = (source.modes or MODES)[0]
    contacts = CONTACT_SLOTS if source.slots is None else source.slots
    truth = (0.05, contacts, False, DEFAULT_EQUIPMENT, True)
    chosen = _Configuration(source.name, "corrected", mode, *truth, "los", "simple", "predict", False, "exact")
    return _decide(source, chosen, law_inputs(contacts, sonar=False))


def _built(c: _Configuration) -> Law:
    source = law_source(c.law)
    if not (c.sonar and source.scans):
        decision_inputs = law_inputs(c.contacts, sonar=c.sonar, depths=c.depths)
        return _decide(source, c, decision_inputs, sonar=c.sonar, moving=c.moving)
    decision_inputs = scan_inputs(c.contacts + SECTORS, sensors=c.equipment.array.size, depths=c.depths)
    inputs = sonar_inputs(c.equipment, contacts=c.contacts, depths=c.depths)
    noise = {"model_noise": source.model_noise, "acceleration_noise": source.acceleration_noise}
    decide = _decide(source, c, decision_inputs)
    perception = build_perception(c.equipment, inputs, decision_inputs, dt=c.dt, **noise)
    state = Layout((*decide.state.ports, *perception.state.ports))
    block = sensing(decide.block, decide.state, perception)
    return replace(decide, state=state, inputs=perception.inputs, block=block, perception=perception)


def _decide(
    source: LawSource, chosen: _Configuration, inputs: Layout, *, sonar: bool = False, moving: bool = True
) -> Law:
    """Return the law without perception; if the law has a sonar map, this is the part that runs after perception.

    In a law with perception, the decision assumes that every obstacle may move.
    """
    avoidance, mode, dt, guidance = chosen.avoidance, chosen.mode, chosen.dt, chosen.guidance
    barrier, movers, fallback = chosen.barrier, chosen.movers, chosen.fallback
    scans, depths = "unknown" in inputs, "column" in inputs
    limit = chosen.equipment.search_limit if scans else None
    state = state_layout(source, dt, guidance, sonar=sonar, depths=depths, limited=limit is not None)
    listed = scan_telemetry(inputs.port("sonars").shape[0]) if scans else TELEMETRY
    outputs = Layout((*listed, *((TRAPPED_PORT,) if "trapped" in state else ()), *((DEPTH_PORT,) if depths else ())))
    x, xs = state.symbols("x")
    u, us = inputs.symbols("u")
    gains = parameter_ports(source.gains)
    p, ps = gains.symbols("p")
    with Recording() as recording:
        eta, nu = us["eta"], us["nu"]
        steering = None if source.steering is None else source.steering(ps)
        guided = ps if steering is None else steering.guided(ps)
        desired = path_following(
            eta, xs["progress"], guided, dt=dt, guidance=guidance, memory=xs.get("drift"), steering=steering
        )
        if "trapped" in xs:
            desired = standing(desired, xs, eta, ps)
        parameters, layer_depth = ps, ps["depth"]
        if depths:
            layer_depth, aimed = aimed_depth(xs, eta, nu, us["column"], ps)
            parameters = {**ps, "depth": aimed}
        perceived = perceive(xs, us, ps, dt=dt) if source.perceive is None else perceived_by(source, us, ps, chosen.law)
        scan = Scan(us["unknown"], us["sonars"], us["placed"], us["echoed"]) if scans else None
        situation = Situation(
            avoidance, desired, perceived, xs, eta, nu, parameters, dt, scan, moving, barrier, movers, steering
        )
        decision = decision_of(source, situation, chosen.law)
        levels = decision.task_levels()
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
        carried = {
            **{port.name: xs[port.name] for port in source.ports},
            **perceived.state,
            **decision.state,
            "progress": desired.progress,
            "integral": xs["integral"],
        }
        if "drift" in xs:
            carried["drift"] = learnt(guidance, desired, xs["drift"], eta, nu, decision.avoiding, guided, dt=dt)
        if "trapped" in xs:
            known = perceived.known if moving else ()
            dead_end = dead_end_next(
                desired, known, xs, eta, decision.stopped, ps, nu, us.get("column"), dt=dt, limit=limit
            )
            carried |= dead_end
            reported["trapped"] = dead_end["trapped"]
        if depths:
            reported["depth_reference"] = layer_depth
            # while the law follows another depth, the distance to the path is not a tracking error
            reported["avoiding"] = ca.logic_or(reported["avoiding"], ca.fabs(xs["layer"]) > 0)
        switched = ca.logic_not(carried["side"] == xs["side"]) if "side" in xs else 0
        flags = SWITCHED * switched + DEGRADED * decision.degraded
        flags += TRAPPED * reported.get("trapped", 0)
        memory = Memory(state.join(carried), outputs.join({**unknown, **reported})[8:], flags)

    rows = _limit_rows(decision, ps)
    nsb = nsb_symbolic([(level.J, level.reference) for level in levels], damping=source.damping)
    close = Closing(state, outputs, u, us, p, ps, dt, thrust_of(source, chosen.law))
    arguments = {"x": x, "u": u, "p": p}

    def closed() -> Block:
        return recording.block("law", arguments, close.outputs_of(memory, nsb, ca.SX(0)))

    def pre() -> Block:
        return recording.block("pre", arguments, {**_solver_inputs(levels, rows), **memory._asdict()})

    stages = Stages(closed, pre, close.block)
    shapes = tuple((level.name, int(level.J.shape[0]), level.unit) for level in levels)
    return Law(
        name=source.name,
        ref=chosen.law,
        avoidance=avoidance,
        mode=mode,
        dt=dt,
        state=state,
        inputs=inputs,
        gains=gains,
        outputs=outputs,
        # without libm functions such as sin, every compiler and processor gives identical results
        block=without_libm(
            stages.closed
            if mode == "nsb"
            else limited(mode, stages.pre, stages.post, levels=shapes, rows=len(rows), fallback=fallback)
        ),
        stages=stages,
        levels=shapes,
        rows=tuple(row.name for row in rows),
        guidance=guidance,
        barrier=barrier,
        movers=movers,
        fallback=fallback,
    )

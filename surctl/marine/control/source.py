"""`LawSource`, what distinguishes one law from the others; checks of what a user's law states and returns."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast, get_args

import casadi as ca

from surctl.errors import InputError, check_known, mistakes_in, nearest
from surctl.ir import Layout, Port
from surctl.ir.c99 import identifier
from surctl.marine.control.closing import Thrust
from surctl.marine.control.dead_end import DEAD_END_PORTS, LAYER_PORTS, SEARCH_PORT
from surctl.marine.control.decision import (
    DECISION_PORTS,
    Decision,
    Perception,
    Situation,
    TaskLevel,
    perception_ports,
)
from surctl.marine.control.gains import GainSpec
from surctl.marine.control.ports import PARAMETERS
from surctl.marine.control.steering import Steering
from surctl.marine.guidance import Guidance
from surctl.marine.sensing import OwnStateFilter
from surctl.own_code import called, is_own, own_file
from surctl.priority import Mode
from surctl.system.parts import expression, symbolic
from surctl.tasks import Task

PATH_FOLLOWING, AVOIDANCE, BARRIER = "path following", "avoidance (20)", "barrier"
"""Parts of a law for which the library has claims and linear models: path following by equations (8)–(12) of the paper,
in a linear cascade with velocity control; avoidance by equation (20); the barrier on closing speeds."""

_VELOCITIES = 4
_OPTIONS = ("avoidance", "barrier", "movers", "depths")  # of build_law
_ALWAYS = frozenset({"progress", "integral", "drift"})
_LATCHED = frozenset(port.name for port in DECISION_PORTS)


@dataclass(frozen=True, eq=False)
class LawSource:
    """Decision, state, gains and supported options of a law; all laws use the same code for the rest of the loop.

    Attributes:
        name: name of the law, a C identifier; prefix of exported files.
        decide: function from the symbolic `Situation` of a control step to the law's `Decision`.
        gains: gains of this law in addition to `GAINS`, each with a default.
        state: entries (name, size, initial value) of this law's state; `decide` returns their next values in
            `Decision.state`.
        thrust: velocity controller (see `closing.Thrust`); None: the default, with drag feedforward, proportional and
            integral action.
        sensing: kinds of sensing that the law supports, `truth` (exact positions) and `sonar`.
        modes: priority modes that the law supports; None: all modes.
        options: which of the options `avoidance`, `barrier`, `movers` and `depths` of `build_law` the law supports.
        latches: whether the law remembers on which side it passes an obstacle, in the state entries `side`, `blocker`
            and `last_velocity`.
        scans: whether the law, if it uses sonars, builds a map from the vehicle's own sonar array; if not, it uses the
            four sonars of the paper, without a map.
        gives_up: whether the law recognises dead ends.
        slots: number of known obstacles that the input holds, if the law fixes this number.
        perceive: function that returns the `Perception` from inputs and parameters, if the law does not use the shared
            perception.
        damping: damping of the closed-form null-space projection, equation (16) of the paper.
        steering: for a law that needs no sway force, the function from its parameters to the abilities of a craft
            steered by heading and speed; None: the law moves in any direction, so it needs a sway force.
        model_noise: error of the vehicle model that the own-state filter assumes [s^0.5], see `OwnStateFilter`.
        acceleration_noise: acceleration noise that this filter always assumes [m/s^1.5].
        parts: parts of the law for which the library has claims and linear models; empty if there are none.

    Raises:
        InputError: a name is not a C identifier or is reserved, or a gain has no default within its bounds.

    Example:
        >>> from surctl.marine.control import Decision, GainSpec, LawSource
        >>> from surctl.tasks import Task, depth_task
        >>> def decide(s):
        ...     y, keep = s.eta[1], s.p["keep"]
        ...     wall = Task(name="wall", eta=s.eta, sigma=y, target=keep, gain=0.4, unit="m", kinematics="vehicle")
        ...     return Decision([wall, depth_task(s.eta, s.p["depth"], gain=s.p["k2"])])
        >>> LawSource("wall", decide, gains={"keep": GainSpec("m", "distance from the wall", default=0.5)}).name
        'wall'
    """

    name: str
    decide: Callable[[Situation], Decision]
    gains: Mapping[str, GainSpec] = field(default_factory=dict)
    state: tuple[Port, ...] = ()
    thrust: Thrust | None = None
    sensing: tuple[str, ...] = ("truth", "sonar")
    modes: tuple[Mode, ...] | None = None
    options: frozenset[str] = frozenset()
    latches: bool = True
    scans: bool = True
    gives_up: bool = False
    slots: int | None = None
    perceive: Callable[[Mapping[str, ca.SX], Mapping[str, ca.SX]], Perception] | None = None
    damping: float = 0.0
    steering: Callable[[Mapping[str, ca.SX]], Steering] | None = None
    model_noise: float = OwnStateFilter.model_noise
    acceleration_noise: float = OwnStateFilter.acceleration_noise
    parts: frozenset[str] = frozenset()

    @property
    def forces(self) -> tuple[str, ...]:
        """Return the thrust limits of a vehicle that must be greater than 0 for this law."""
        return ("Fu_max", "Fr_max") if self.steering is not None else ("Fu_max", "Fv_max", "Fr_max")

    @property
    def ports(self) -> tuple[Port, ...]:
        """Return the state entries that `decide` computes: those of `latches`, if True, then the law's own."""
        return (*(DECISION_PORTS if self.latches else ()), *self.state)

    def __post_init__(self) -> None:
        identifier(self.name)
        for name in ("decide", "thrust", "perceive", "steering"):
            if not callable(function := getattr(self, name)) and (function is not None or name == "decide"):
                key = f"{self.name}.{name}"
                raise InputError(f"is of type {type(function).__name__}", key=key, remedy="give a function")
        gains, state = cast("object", self.gains), cast("object", self.state)
        if not isinstance(gains, Mapping):
            remedy = 'write {"name": GainSpec(…)}'
            raise InputError(f"is of type {type(gains).__name__}", key=f"{self.name}.gains", remedy=remedy)
        _check_words("sensing", self.sensing, ("truth", "sonar"), self.name)
        _check_words("options", self.options, _OPTIONS, self.name)
        if self.modes is not None:
            _check_words("modes", self.modes, get_args(Mode), self.name)
        if isinstance(state, Port):
            raise InputError("is one port", key=f"{self.name}.state", remedy="write (port,)")
        for port in self.state:
            if not isinstance(port, Port):
                raise InputError("is not a Port", key=f"{self.name}.state", value=type(port).__name__)
            if min(port.shape, default=1) < 1:
                raise InputError(
                    "has no entries", key=f"{self.name}.state", value=port.name, remedy="give a shape of 1 or more"
                )
            reserved = _ALWAYS | _LATCHED if self.latches else _ALWAYS
            _check_port(port.name, port.unit, where=f"{self.name}.state", reserved=reserved)
        Layout(self.ports)  # refuses two of one name
        for name, spec in self.gains.items():
            where = f"{self.name}.gains"
            if not isinstance(spec, GainSpec):
                raise InputError("is not a GainSpec", key=f"{where}.{name}", value=type(spec).__name__)
            _check_port(name, spec.unit, where=where, reserved=frozenset(port.name for port in PARAMETERS))
            spec.check_default(f"{where}.{name}")


def _check_words(key: str, words: object, known: Collection[str], name: str) -> None:
    """Raise InputError unless `words` is a tuple, list or set of known words."""
    if not isinstance(words, tuple | list | set | frozenset):
        remedy = f'write ("{next(iter(sorted(known)))}",)'
        raise InputError("is not a tuple of texts", key=f"{name}.{key}", value=words, remedy=remedy)
    for word in words:
        check_known(word, known, key=f"{name}.{key}")


def _check_port(name: str, unit: str, *, where: str, reserved: frozenset[str]) -> None:
    with mistakes_in(None, where):
        identifier(name)
    if name in reserved:
        raise InputError("is a gain, state or input of every law", key=where, value=name, remedy="choose another name")
    if not unit.strip():
        raise InputError("has no unit", key=f"{where}.{name}", remedy='give its unit, "1" if it has none')


def state_layout(
    source: LawSource, dt: float, guidance: Guidance, *, sonar: bool, depths: bool, limited: bool
) -> Layout:
    """Return the layout of the state of a law without perception; `limited` says whether the law has a search limit."""
    unit = {"ilos": "s", "alos": "1"}.get(guidance, "")
    memory = (Port("drift", (1,), unit, f"estimate of guidance {guidance} for a steady disturbance"),) if unit else ()
    return Layout(
        (
            Port("progress", (1,), "m", "arc length of the target point on the path"),
            Port("integral", (4,), "m/s^2, rad/s^2", "integral action of the velocity loops"),
            *memory,
            *(DEAD_END_PORTS if source.gives_up else ()),
            *((SEARCH_PORT,) if source.gives_up and limited else ()),
            *(LAYER_PORTS if depths else ()),
            *source.ports,
            *perception_ports(dt, sonar=sonar),
        )
    )


def decision_of(source: LawSource, situation: Situation, reference: str) -> Decision:
    """Return the law's decision; an error in a law of the user's own is reported in one line that names its file."""
    if not is_own(reference):
        return source.decide(situation)
    decision = called(reference, symbolic, source.decide, situation)
    return _checked_decision(decision, source, file=own_file(reference))


def perceived_by(source: LawSource, u: Mapping[str, ca.SX], p: Mapping[str, ca.SX], reference: str) -> Perception:
    """Return the law's own perception; an error in a law of the user's own is reported in one line with its file."""
    assert source.perceive is not None
    return called(reference, symbolic, source.perceive, u, p) if is_own(reference) else source.perceive(u, p)


def thrust_of(source: LawSource, reference: str) -> Thrust | None:
    """Return the law's velocity controller; one from the user is wrapped in checks of its returned values."""
    thrust = source.thrust
    if thrust is None or not is_own(reference):
        return thrust

    def checked(*arguments: Any) -> tuple[ca.SX, ca.SX]:
        returned = called(reference, symbolic, thrust, *arguments)
        return _checked_thrust(returned, source, file=own_file(reference))

    return checked


def _checked_decision(decision: object, source: LawSource, *, file: object) -> Decision:
    """Return the decision, as expressions, if it has the shapes, units and names of its law; else raise InputError."""

    def fail(problem: str, key: str, remedy: str) -> InputError:
        return InputError(problem, file=file, key=f"{source.name}.{key}", remedy=remedy)

    if not isinstance(decision, Decision):
        raise fail(f"returned {type(decision).__name__}, not Decision", "decide", "return Decision([task, …])")
    if isinstance(cast("object", decision.levels), Task | TaskLevel):
        raise fail("is one task", "levels", "write Decision([task])")
    decision = replace(decision, levels=tuple(decision.levels))
    if not decision.levels:
        raise fail("has no task", "levels", "give at least one task or TaskLevel")
    for level in decision.levels:
        if not isinstance(level, (Task, TaskLevel)):
            raise fail(f"contains {type(level).__name__}", "levels", "give surctl.tasks.Task or TaskLevel")
    for level in called(str(file), decision.task_levels):
        rows = level.J.shape[0]
        if level.J.shape[1] != _VELOCITIES or level.reference.shape != (rows, 1) or not 0 < rows <= _VELOCITIES:
            shapes = f"J {level.J.shape} and reference {level.reference.shape}"
            raise fail(f"level {level.name} has {shapes}", "levels", "give J (k, 4) and reference (k, 1), k = 1…4")
    for row in decision.rows:
        if not hasattr(row, "rows"):
            raise fail(f"contains {type(row).__name__}", "rows", "give surctl.tasks.HalfPlane or a barrier's rows")
    values: dict[str, Any] = {"state": {}}
    for name, shape in (("velocity", (2, 1)), ("avoiding", (1, 1)), ("degraded", (1, 1)), ("stopped", (1, 1))):
        values[name] = _symbolic(getattr(decision, name), source, name, file=file)
        if values[name].shape != shape:
            raise fail(f"has shape {values[name].shape}", name, f"give {shape}")
    known = {port.name: port for port in source.ports}
    for name, value in decision.state.items():
        if name not in known:
            raise fail("is not a state port of this law", f"state.{name}", f"{nearest(name, known)}")
        values["state"][name] = after = _symbolic(value, source, f"state.{name}", file=file)
        if after.numel() != known[name].size:
            raise fail(f"has {after.numel()} numbers", f"state.{name}", f"give {known[name].size}")
    return replace(decision, **values)


def _symbolic(value: Any, source: LawSource, key: str, *, file: object) -> ca.SX:
    with mistakes_in(file):
        return expression(value, key=f"{source.name}.{key}")


def _checked_thrust(returned: object, source: LawSource, *, file: object) -> tuple[ca.SX, ca.SX]:
    """Return `returned` (from a law's function `thrust`) if it is a thrust (4, 1) and a next state (4, 1)."""
    remedy = "return (thrust (4, 1), next state (4, 1))"
    if not isinstance(returned, tuple) or len(returned) != 2:
        raise InputError(f"returned {type(returned).__name__}", file=file, key=f"{source.name}.thrust", remedy=remedy)
    thrust, following = (_symbolic(part, source, "thrust", file=file) for part in returned)
    if thrust.shape != (_VELOCITIES, 1) or following.shape != (_VELOCITIES, 1):
        shapes = f"returned shapes {thrust.shape} and {following.shape}"
        raise InputError(shapes, file=file, key=f"{source.name}.thrust", remedy=remedy)
    return thrust, following

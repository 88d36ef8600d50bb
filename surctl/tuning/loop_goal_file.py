"""Keys of goals about the loop in goals files: `[[goals]]` with `type`, and `[[points]]` with operating points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field

from surctl.errors import InputError, mistakes_in, nearest
from surctl.files import Quantity, Strict
from surctl.tuning.loop_frequency_goals import Effort, LoopShape, MaxGain, Rejection, SensitivityBound, Tracking
from surctl.tuning.loop_goals import Bound, LoopGoal, Profile
from surctl.tuning.loop_time_goals import Margins, Overshoot, Poles, Settling, StepRejection, StepTracking

Side = Literal["both", "above", "below"]


class LoopGoalTable(Strict):
    """Keys of a `[[goals]]` table with `type`; `LOOP_GOAL_KEYS` says which of them a type has."""

    name: str = Field(min_length=1)
    type: str
    kind: Literal["hard", "soft"] = "soft"
    points: tuple[str, ...] = ()
    at: str | tuple[str, ...] = ()
    source: str | None = Field(default=None, alias="from")
    end: str | None = Field(default=None, alias="to")
    frequency_rad_per_s: tuple[float, ...] | None = None
    gain: tuple[float, ...] | None = None
    gain_db: tuple[float, ...] | None = None
    attenuation: float | tuple[float, ...] | None = None
    at_most: Quantity | None = None
    band_db: float = 3.0
    side: Side = "both"
    response_s: float | None = None
    steady_error: float = 0.01
    peak_error: float = 1.0
    time_constant_s: float | None = None
    natural_frequency_rad_per_s: float | None = None
    damping: float | None = None
    decay_per_s: float = 0.0
    fastest_rad_per_s: float | None = None
    gain_margin: float = 0.0
    phase_margin_deg: float = 0.0
    delay_margin_s: float = 0.0
    disk_margin: float = 0.0


class PointTable(Strict):
    """Content of a `[[points]]` table: an operating point, that is, numbers of the system by name."""

    name: str = Field(min_length=1)
    values: dict[str, float | tuple[float, ...]]


_COMMON = {"name", "type", "kind", "points"}
_BETWEEN = {"source", "end"}
_PROFILE = {"frequency_rad_per_s", "gain", "gain_db"}
LOOP_GOAL_KEYS: Mapping[str, frozenset[str]] = {
    "loop_shape": frozenset({"at", *_PROFILE, "band_db", "side"}),
    "sensitivity": frozenset({"at", "at_most", *_PROFILE}),
    "rejection": frozenset({"at", "frequency_rad_per_s", "attenuation"}),
    "gain": frozenset({*_BETWEEN, "at_most", *_PROFILE}),
    "effort": frozenset({*_BETWEEN, "at_most", *_PROFILE}),
    "tracking": frozenset({*_BETWEEN, "response_s", "steady_error", "peak_error"}),
    "overshoot": frozenset({*_BETWEEN, "at_most"}),
    "settling": frozenset({*_BETWEEN, "at_most"}),
    "step_tracking": frozenset({*_BETWEEN, "time_constant_s", "natural_frequency_rad_per_s", "damping", "at_most"}),
    "step_rejection": frozenset({*_BETWEEN, "at_most"}),
    "poles": frozenset({"decay_per_s", "damping", "fastest_rad_per_s"}),
    "margins": frozenset({"at", "gain_margin", "phase_margin_deg", "delay_margin_s", "disk_margin"}),
}
"""Types of goals about the loop, with the keys of their tables."""


def loop_goal(table: LoopGoalTable) -> LoopGoal:
    """Build the goal that a table describes; an InputError names the key."""
    key = f"goals.{table.name}"
    if table.type not in LOOP_GOAL_KEYS:
        remedy = nearest(table.type, LOOP_GOAL_KEYS)
        raise InputError("is not a type of goal", key=f"{key}.type", value=table.type, remedy=remedy)
    allowed = LOOP_GOAL_KEYS[table.type]
    shown = {"source": "from", "end": "to"}
    for name in sorted(table.model_fields_set - _COMMON):
        if name not in allowed:
            known = ", ".join(sorted(shown.get(one, one) for one in allowed))
            problem = f"is not a key of a goal of type {table.type}"
            raise InputError(problem, key=f"{key}.{shown.get(name, name)}", remedy=f"it has: {known}")
    for name in ("at", "source", "end"):
        if name in allowed and not getattr(table, name):
            raise InputError("is missing", key=f"{key}.{shown.get(name, name)}", remedy="name a signal of the loop")
    try:
        return _BUILDERS[table.type](table, {"name": table.name, "kind": table.kind, "points": table.points})
    except InputError as error:
        whole = error.key if error.key and error.key.startswith(key) else f"{key}.{error.key}"
        raise InputError(error.problem, key=whole, value=error.value, remedy=error.remedy) from None


def check_points(goals: tuple[LoopGoal, ...], points: Mapping[str, Any]) -> None:
    """Raise InputError if a goal names an operating point that does not exist."""
    for goal in goals:
        for name in goal.points:
            if name not in points:
                remedy = nearest(name, points) if points else "add a [[points]] table"
                raise InputError(
                    "is not an operating point", key=f"goals.{goal.name}.points", value=name, remedy=remedy
                )


def _bound(table: LoopGoalTable, unit: str | None = "1") -> Bound:
    # one number, or a profile by points
    profile = table.gain if table.gain_db is None else tuple(10 ** (np.array(table.gain_db) / 20))
    several = table.gain is not None and table.gain_db is not None
    idle = table.at_most is not None and table.frequency_rad_per_s is not None
    if (profile is None) == (table.at_most is None) or several or idle:
        remedy = "give at_most, or frequency_rad_per_s with gain or gain_db"
        raise InputError("needs one bound", key="at_most", remedy=remedy)
    if profile is not None:
        return _profile(table, profile)
    return _most(table, unit)


def _profile(table: LoopGoalTable, values: tuple[float, ...]) -> Profile:
    if table.frequency_rad_per_s is None:
        raise InputError("is missing", key="frequency_rad_per_s", remedy="give a frequency for each value")
    return Profile(table.frequency_rad_per_s, tuple(float(value) for value in values))


def _most(table: LoopGoalTable, unit: str | None) -> float:
    if table.at_most is None:
        raise InputError("is missing", key="at_most", remedy='write at_most = { value = ..., unit = "..." }')
    with mistakes_in(None, "at_most.unit"):
        return (table.at_most if unit is None else table.at_most.within(unit)).value


def _shape(table: LoopGoalTable, about: dict[str, Any]) -> LoopGoal:
    bound = _bound(table)
    if not isinstance(bound, Profile):
        raise InputError("is missing", key="gain", remedy="give frequency_rad_per_s with gain or gain_db")
    return LoopShape(**about, at=_at(table), target=bound, band_db=table.band_db, side=table.side)


def _rejection(table: LoopGoalTable, about: dict[str, Any]) -> LoopGoal:
    factor = table.attenuation
    if factor is None:
        raise InputError("is missing", key="attenuation", remedy="give a factor, or one for each frequency")
    bound: Bound = _profile(table, factor) if isinstance(factor, tuple) else factor
    return Rejection(**about, at=_at(table), attenuation=bound)


def _gain(kind: type[MaxGain]) -> Callable[[LoopGoalTable, dict[str, Any]], LoopGoal]:
    def build(table: LoopGoalTable, about: dict[str, Any]) -> LoopGoal:
        unit = "" if table.at_most is None else table.at_most.unit
        return kind(**about, **_path(table), at_most=_bound(table, None), unit=unit)

    return build


def _tracking(table: LoopGoalTable, about: dict[str, Any]) -> LoopGoal:
    if table.response_s is None:
        raise InputError("is missing", key="response_s", remedy="give the response time [s]")
    errors: dict[str, Any] = {"steady_error": table.steady_error, "peak_error": table.peak_error}
    return Tracking(**about, **_path(table), response_s=table.response_s, **errors)


def _model(table: LoopGoalTable, about: dict[str, Any]) -> LoopGoal:
    import control  # takes seconds to import

    lag, w, zeta = table.time_constant_s, table.natural_frequency_rad_per_s, table.damping
    if (lag is None) == (w is None) or (w is None) != (zeta is None):
        remedy = "give time_constant_s, or natural_frequency_rad_per_s and damping"
        raise InputError("needs one reference model", key="time_constant_s", remedy=remedy)
    for key, value in (("time_constant_s", lag), ("natural_frequency_rad_per_s", w), ("damping", zeta)):
        if value is not None and not value > 0:
            raise InputError("must be greater than 0", key=key, value=value, remedy="correct it")
    if w is None or zeta is None:
        model = control.tf([1.0], [lag, 1.0])
    else:
        model = control.tf([w**2], [1.0, 2 * zeta * w, w**2])
    most = 0.1 if table.at_most is None else _most(table, "1")
    return StepTracking(**about, **_path(table), model=model, at_most=most)


def _poles(table: LoopGoalTable, about: dict[str, Any]) -> LoopGoal:
    fastest = np.inf if table.fastest_rad_per_s is None else table.fastest_rad_per_s
    return Poles(**about, decay_per_s=table.decay_per_s, damping=table.damping or 0.0, fastest_rad_per_s=fastest)


def _margins(table: LoopGoalTable, about: dict[str, Any]) -> LoopGoal:
    least: dict[str, Any] = {"gain": table.gain_margin, "phase_deg": table.phase_margin_deg}
    return Margins(**about, at=_at(table), **least, delay_s=table.delay_margin_s, disk=table.disk_margin)


def _at(table: LoopGoalTable) -> tuple[str, ...]:
    return (table.at,) if isinstance(table.at, str) else table.at


def _path(table: LoopGoalTable) -> dict[str, Any]:
    return {"source": table.source, "end": table.end}


_BUILDERS: Mapping[str, Callable[[LoopGoalTable, dict[str, Any]], LoopGoal]] = {
    "loop_shape": _shape,
    "sensitivity": lambda table, about: SensitivityBound(**about, at=_at(table), at_most=_bound(table)),
    "rejection": _rejection,
    "gain": _gain(MaxGain),
    "effort": _gain(Effort),
    "tracking": _tracking,
    "overshoot": lambda table, about: Overshoot(**about, **_path(table), at_most=_most(table, "1")),
    "settling": lambda table, about: Settling(**about, **_path(table), at_most=_most(table, "s")),
    "step_tracking": _model,
    "step_rejection": lambda table, about: StepRejection(
        **about, **_path(table), at_most=_most(table, None), unit="" if table.at_most is None else table.at_most.unit
    ),
    "poles": _poles,
    "margins": _margins,
}

"""Keys of goals about the loop in goals files: `[[goals]]` with `type`, and `[[points]]` with operating points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, fields
from typing import Any, Literal

import numpy as np
from pydantic import Field as Key

from surctl.errors import InputError, check_known, mistakes_in, nearest
from surctl.files import Quantity, Strict
from surctl.tuning.loop_frequency_goals import Effort, LoopShape, MaxGain, Rejection, SensitivityBound, Tracking
from surctl.tuning.loop_goals import Bound, LoopGoal, Profile
from surctl.tuning.loop_time_goals import Margins, Overshoot, Poles, Settling, StepRejection, StepTracking

Side = Literal["both", "above", "below"]


class LoopGoalTable(Strict):
    """Keys of a `[[goals]]` table with `type`; `LOOP_GOAL_KEYS` says which of them a type has."""

    name: str = Key(min_length=1)
    type: str
    kind: Literal["hard", "soft"] = "soft"
    points: tuple[str, ...] = ()
    at: str | tuple[str, ...] = ()
    source: str | None = Key(default=None, alias="from")
    end: str | None = Key(default=None, alias="to")
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

    name: str = Key(min_length=1)
    values: dict[str, float | tuple[float, ...]]


_TYPES: Mapping[str, type[LoopGoal]] = {
    kind.TYPE: kind
    for kind in (
        LoopShape, SensitivityBound, Rejection, MaxGain, Effort, Tracking, Overshoot, Settling, StepTracking,
        StepRejection, Poles, Margins,
    )
}  # fmt: skip
_COMMON = {"name", "kind", "points"}
_PROFILE = ("frequency_rad_per_s", "gain", "gain_db")
_KEYS: Mapping[str, tuple[str, ...]] = {  # of a field whose keys have other names than the field
    "target": _PROFILE,
    "attenuation": ("attenuation", "frequency_rad_per_s"),
    "model": ("time_constant_s", "natural_frequency_rad_per_s", "damping"),
    "unit": (),  # that of at_most
    "gain": ("gain_margin",),
    "phase_deg": ("phase_margin_deg",),
    "delay_s": ("delay_margin_s",),
    "disk": ("disk_margin",),
}
_SHOWN = {"source": "from", "end": "to", "target": "gain"}
_REMEDIES = {
    "at_most": 'write at_most = { value = ..., unit = "..." }',
    "target": "give frequency_rad_per_s with gain or gain_db",
    "attenuation": "give a factor, or one for each frequency",
    "response_s": "give the response time [s]",
}


def _keys(one: Field[Any]) -> tuple[str, ...]:
    return _KEYS.get(one.name, (one.name, *(_PROFILE if one.type == "Bound" else ())))


LOOP_GOAL_KEYS: Mapping[str, frozenset[str]] = {
    name: frozenset(key for one in fields(kind) if one.name not in _COMMON for key in _keys(one))
    for name, kind in _TYPES.items()
}
"""Types of goals about the loop, with the keys of their tables."""


def loop_goal(table: LoopGoalTable) -> LoopGoal:
    """Build the goal that a table describes; an InputError names the key."""
    key = f"goals.{table.name}"
    check_known(table.type, _TYPES, "is not a type of goal", key=f"{key}.type")
    allowed, kind = LOOP_GOAL_KEYS[table.type], _TYPES[table.type]
    for name in sorted(table.model_fields_set - _COMMON - {"type"}):
        if name not in allowed:
            known = ", ".join(sorted(_SHOWN.get(one, one) for one in allowed))
            problem = f"is not a key of a goal of type {table.type}"
            raise InputError(problem, key=f"{key}.{_SHOWN.get(name, name)}", remedy=f"it has: {known}")
    try:
        values = {one.name: _value(table, kind, one) for one in fields(kind)}
        for one in fields(kind):
            if values[one.name] in (None, "", ()) and one.default is MISSING:
                remedy = _REMEDIES.get(one.name, "name a signal of the loop")
                raise InputError("is missing", key=_SHOWN.get(one.name, one.name), remedy=remedy)
        return kind(**{name: value for name, value in values.items() if value is not None})
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


def _value(table: LoopGoalTable, kind: type[LoopGoal], one: Field[Any]) -> Any:
    """Return the value of a field of a goal of this kind; None: it keeps its default."""
    if one.name in _BUILT:
        return _BUILT[one.name](table)
    if one.name != "at_most":
        (name,) = _keys(one)
        return getattr(table, name)
    unit = None if "unit" in {other.name for other in fields(kind)} else kind.UNIT
    return _bound(table, unit) if one.type == "Bound" else _most(table, unit)


def _bound(table: LoopGoalTable, unit: str | None) -> Bound | None:
    # one number, or a profile by points
    profile, most = _target(table), _most(table, unit)
    idle = most is not None and table.frequency_rad_per_s is not None
    if (profile is None) == (most is None) or idle:
        remedy = "give at_most, or frequency_rad_per_s with gain or gain_db"
        raise InputError("needs one bound", key="at_most", remedy=remedy)
    return profile or most


def _profile(table: LoopGoalTable, values: tuple[float, ...]) -> Profile:
    if table.frequency_rad_per_s is None:
        raise InputError("is missing", key="frequency_rad_per_s", remedy="give a frequency for each value")
    return Profile(table.frequency_rad_per_s, tuple(float(value) for value in values))


def _target(table: LoopGoalTable) -> Profile | None:
    if table.gain is not None and table.gain_db is not None:
        raise InputError("is given twice", key="gain", remedy="give gain or gain_db")
    values = table.gain if table.gain_db is None else tuple(10 ** (np.array(table.gain_db) / 20))
    return None if values is None else _profile(table, values)


def _most(table: LoopGoalTable, unit: str | None) -> float | None:
    if table.at_most is None:
        return None
    with mistakes_in(None, "at_most.unit"):
        return (table.at_most if unit is None else table.at_most.within(unit)).value


def _attenuation(table: LoopGoalTable) -> Bound | None:
    return _profile(table, table.attenuation) if isinstance(table.attenuation, tuple) else table.attenuation


def _model(table: LoopGoalTable) -> Any:
    import control  # takes seconds to import

    lag, w, zeta = table.time_constant_s, table.natural_frequency_rad_per_s, table.damping
    if (lag is None) == (w is None) or (w is None) != (zeta is None):
        remedy = "give time_constant_s, or natural_frequency_rad_per_s and damping"
        raise InputError("needs one reference model", key="time_constant_s", remedy=remedy)
    for key, value in (("time_constant_s", lag), ("natural_frequency_rad_per_s", w), ("damping", zeta)):
        if value is not None and not value > 0:
            raise InputError("must be greater than 0", key=key, value=value, remedy="correct it")
    if w is None or zeta is None:
        return control.tf([1.0], [lag, 1.0])
    return control.tf([w**2], [1.0, 2 * zeta * w, w**2])


_BUILT: Mapping[str, Callable[[LoopGoalTable], Any]] = {
    "at": lambda table: (table.at,) if isinstance(table.at, str) else table.at,
    "target": _target,
    "attenuation": _attenuation,
    "model": _model,
    "unit": lambda table: None if table.at_most is None else table.at_most.unit,
}

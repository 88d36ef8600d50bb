"""Goals files: keys of `[[goals]]` and `[[points]]`; goals on costs of runs; linear goals beyond a run at a limit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field as Key

from surctl.errors import InputError, check_known, check_once, mistakes_in, nearest
from surctl.files import Quantity, Strict, load_model, pick
from surctl.system import System
from surctl.tuning.loop_goal_types import STEPS, TYPES
from surctl.tuning.loop_goals import Bound, LoopGoal, Profile, check_points
from surctl.verification.loops import worst_place

if TYPE_CHECKING:
    from surctl.assessment import Assessment

LIBRARY = Path(__file__).parent / "library"

Over = Literal["worst", "mean"]
Plants = Literal["all", "nominal"]
Kind = Literal["hard", "soft"]
Sense = Literal["at most", "at least"]


class GoalTable(Strict):
    """Content of a `[[goals]]` table in a goals file or a study file: a goal about a metric, or about the loop.

    With `type`, it is a goal about the loop, and `LOOP_GOAL_KEYS` says which keys it has.
    """

    name: str = Key(min_length=1)
    type: str | None = None
    kind: Kind = "soft"
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
    side: Literal["both", "above", "below"] = "both"
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
    metric: str | None = None
    at_least: Quantity | None = None
    over: Over = "worst"
    cases: tuple[str, ...] = ()
    plants: Plants = "all"
    cruise_m_per_s: tuple[float, ...] | None = None

    def bound(self, unit: str | None) -> tuple[Sense, Quantity]:
        """Return the sense and the bound of a goal about a metric, in its unit; None: in the stated one.

        Raises:
            InputError: there is no bound, there are two, or its unit is not one of the metric.
        """
        bounds: Mapping[Sense, Quantity | None] = {"at most": self.at_most, "at least": self.at_least}
        stated = [(sense, bound) for sense, bound in bounds.items() if bound is not None]
        if len(stated) != 1:
            remedy = 'write at_most = { value = ..., unit = "..." }, or at_least'
            raise InputError("needs one bound", key=f"goals.{self.name}", remedy=remedy)
        [(sense, bound)] = stated
        with mistakes_in(None, f"goals.{self.name}.{sense.replace(' ', '_')}.unit"):
            return sense, bound if unit is None else bound.within(unit)


class PointTable(Strict):
    """Content of a `[[points]]` table: an operating point, that is, numbers of the system by name."""

    name: str = Key(min_length=1)
    values: dict[str, float | tuple[float, ...]]

    def numbers(self) -> dict[str, Any]:
        """Return the numbers by name, as in `run_numbers`."""
        return {name: [list(value)] if isinstance(value, tuple) else value for name, value in self.values.items()}


TWICE: Mapping[str, str] = {"problem": "is the name of two goals", "key": "goals.name", "remedy": "rename one"}
"""What is wrong with the tables of goals of which two have the same name, see `check_once`."""


class GoalsFile(Strict):
    """Content of a goals file."""

    kind: Literal["goals"]
    name: str = Key(min_length=1)
    note: str = ""
    points: tuple[PointTable, ...] = ()
    goals: tuple[GoalTable, ...] = Key(min_length=1)


Array = NDArray[np.float64]

GOALS = "goals"
"""Name of the objective of a search that minimises the largest normalised value of the soft goals."""

NO_NUMBERS: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class RunGoal:
    """A bound on one number of the runs, such as a cost of a system.

    Attributes:
        name: name of the goal in tables and plots.
        metric: name of the number.
        unit: unit of `limit`.
        limit: the bound.
        sense: "at most" or "at least": on which side of the limit the number must lie.
        kind: a hard goal must be met; the normalised value of a soft goal is minimised.
        over: "worst" if every run must meet the limit, "mean" if the mean of the runs must meet it. Costs of a system
            are means over the cases of its tuning.
        cases: names of the cases to which the goal applies; if empty, it applies to all.
        plants: "all", or "nominal" to exclude runs with another plant than that of the case (property Models of
            systune).

    Example:
        >>> import numpy as np
        >>> from surctl.tuning import RunGoal
        >>> RunGoal("quick", "settling", "s", 4.0).normalised(np.array([3.0, 6.0])).tolist()
        [0.75, 1.5]
    """

    name: str
    metric: str
    unit: str
    limit: float
    sense: Sense = "at most"
    kind: Kind = "soft"
    over: Over = "worst"
    cases: tuple[str, ...] = ()
    plants: Plants = "all"

    @property
    def linear(self) -> bool:
        """Whether the metric describes the linear loop; a linear metric does not depend on the seed."""
        return False

    @property
    def part(self) -> str:
        """Part of the assessment with the metric, for a goal that is checked at the end of a tuning."""
        return "loop"

    @property
    def columns(self) -> Mapping[str, float | None]:
        """Place of each column of figures that the goal bounds, by its name; a place is a number, or None."""
        return {self.metric: None}

    def worst(self, table: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return two arrays, each shaped like a column: the worst value over the places, and its place, or NaN."""
        each = np.stack([table[name] for name in self.columns])
        ill = self.badness(each)
        place = np.array([np.nan if at is None else at for at in self.columns.values()])
        return np.take_along_axis(each, ill.argmax(axis=0)[None], axis=0)[0], place[worst_place(ill)]

    def place_text(self, place: float) -> str:
        """Return at which place the goal is worst, for a table; empty without places."""
        return ""

    def place_dict(self, place: float) -> dict[str, Any]:
        """Return the place as plain data for JSON."""
        return {}

    @property
    def absent(self) -> str:
        """Return the text for a metric without a value."""
        return "undefined" if self.linear else "no value"

    @property
    def sign(self) -> str:
        """The sense as a sign."""
        return "≤" if self.sense == "at most" else "≥"

    def badness(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the metric values with the sign for which larger is worse (shape unchanged); NaN becomes inf."""
        figure = np.asarray(values, dtype=float)
        return np.where(np.isnan(figure), np.inf, figure if self.sense == "at most" else -figure)

    def normalised(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the normalised metric values (shape unchanged): at most 1 if the goal is met, larger if worse.

        The normalised value is metric / limit for a goal `at most` with a positive limit. For every other goal, it is
        limit / metric. The quotient limit / metric is inf for a metric that is 0 or on the wrong side of 0. NaN gives
        inf.
        """
        figure, limit = np.asarray(values, dtype=float), self.limit
        if self.sense == "at most" and limit > 0:
            out = figure / limit
        else:
            # a metric below a negative limit corresponds to a metric above a positive limit
            size, bound = (figure, limit) if limit > 0 else (-figure, -limit)
            out = np.full(figure.shape, np.inf)
            np.divide(bound, size, out=out, where=size > 0)
        return np.where(np.isnan(figure), np.inf, out)

    def to_dict(self) -> dict[str, Any]:
        """The goal as plain data for JSON."""
        bound = {"metric": self.metric, "unit": self.unit, "limit": self.limit, "sense": self.sense}
        return {"name": self.name, **bound, "kind": self.kind, "over": self.over}


_COMMON = {"name", "type", "kind", "points", "plants", "cruise_m_per_s"}
_OF_METRICS = ("metric", "at_least", "over", "cases")
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
    for name, kind in TYPES.items()
}
"""Types of goals about the loop, with the keys of their tables."""


def loop_goal(table: GoalTable) -> LoopGoal:
    """Build the goal that a table describes; an InputError names the key."""
    key, problem = f"goals.{table.name}", f"is not a key of a goal of type {table.type}"
    for name in _OF_METRICS:
        if name in table.model_fields_set:
            raise InputError(problem, key=f"{key}.{name}", remedy="leave it out, or drop type")
    check_known(table.type, TYPES, "is not a type of goal", key=f"{key}.type")
    allowed, kind = LOOP_GOAL_KEYS[str(table.type)], TYPES[str(table.type)]
    for name in sorted(table.model_fields_set - _COMMON - allowed):
        known = ", ".join(sorted(_SHOWN.get(one, one) for one in allowed))
        raise InputError(problem, key=f"{key}.{_SHOWN.get(name, name)}", remedy=f"it has: {known}")
    try:
        values = {one.name: _value(table, kind, one) for one in fields(kind)}
        for one in fields(kind):
            if values[one.name] in (None, "", ()) and one.default is MISSING:
                remedy = _REMEDIES.get(one.name, "name a signal of the loop")
                raise InputError("is missing", key=_SHOWN.get(one.name, one.name), remedy=remedy)
        return kind(**{name: value for name, value in values.items() if value is not None})
    except InputError as error:
        raise error.inside(
            None, error.key if error.key and error.key.startswith(key) else f"{key}.{error.key}"
        ) from None


def _value(table: GoalTable, kind: type[LoopGoal], one: Field[Any]) -> Any:
    """Return the value of a field of a goal of this kind; None: it keeps its default."""
    if one.name in _BUILT:
        return _BUILT[one.name](table)
    if one.name != "at_most":
        (name,) = _keys(one)
        return getattr(table, name)
    unit = None if "unit" in {other.name for other in fields(kind)} else kind.UNIT
    return _bound(table, unit) if one.type == "Bound" else _most(table, unit)


def _bound(table: GoalTable, unit: str | None) -> Bound | None:
    # one number, or a profile by points
    profile, most = _target(table), _most(table, unit)
    idle = most is not None and table.frequency_rad_per_s is not None
    if (profile is None) == (most is None) or idle:
        remedy = "give at_most, or frequency_rad_per_s with gain or gain_db"
        raise InputError("needs one bound", key="at_most", remedy=remedy)
    return profile or most


def _profile(table: GoalTable, values: tuple[float, ...]) -> Profile:
    if table.frequency_rad_per_s is None:
        raise InputError("is missing", key="frequency_rad_per_s", remedy="give a frequency for each value")
    return Profile(table.frequency_rad_per_s, tuple(float(value) for value in values))


def _target(table: GoalTable) -> Profile | None:
    if table.gain is not None and table.gain_db is not None:
        raise InputError("is given twice", key="gain", remedy="give gain or gain_db")
    values = table.gain if table.gain_db is None else tuple(10 ** (np.array(table.gain_db) / 20))
    return None if values is None else _profile(table, values)


def _most(table: GoalTable, unit: str | None) -> float | None:
    if table.at_most is None:
        return None
    with mistakes_in(None, "at_most.unit"):
        return (table.at_most if unit is None else table.at_most.within(unit)).value


def _attenuation(table: GoalTable) -> Bound | None:
    return _profile(table, table.attenuation) if isinstance(table.attenuation, tuple) else table.attenuation


def _model(table: GoalTable) -> Any:
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


_BUILT: Mapping[str, Callable[[GoalTable], Any]] = {
    "at": lambda table: (table.at,) if isinstance(table.at, str) else table.at,
    "target": _target,
    "attenuation": _attenuation,
    "model": _model,
    "unit": lambda table: None if table.at_most is None else table.at_most.unit,
}


def load_loop_goals(path: Path | str) -> tuple[tuple[LoopGoal, ...], dict[str, dict[str, Any]]]:
    """Load the goals about the loop from a goals file, and its operating points by name (values as in `run_numbers`).

    Raises:
        InputError: the file is unreadable, or a goal is wrong or about a metric of the robot's runs.

    Example:
        >>> from pathlib import Path
        >>> from surctl.tuning import load_loop_goals
        >>> text = '''kind = "goals"
        ... name = "tank"
        ... [[points]]
        ... name = "rain"
        ... values = { "disturbance.rain" = 0.1 }
        ... [[goals]]
        ... name = "robust"
        ... type = "sensitivity"
        ... at = "flow"
        ... at_most = { value = 1.6, unit = "1" }
        ... '''
        >>> _ = Path("tank.toml").write_text(text)
        >>> goals, points = load_loop_goals("tank.toml")
        >>> goals[0].name, points
        ('robust', {'rain': {'disturbance.rain': 0.1}})
    """
    goals, points, _ = load_system_goals(path, None)
    return goals, points


def load_system_goals(
    path: Path | str, system: System | None
) -> tuple[tuple[LoopGoal, ...], dict[str, dict[str, Any]], tuple[RunGoal, ...]]:
    """Load the goals of a system: those about the loop, the operating points by name, and those about costs of runs.

    A goal with `metric`, the name of a cost of the system, bounds this cost.

    Raises:
        InputError: as for `load_loop_goals`, or the system has no such cost.
    """
    path = pick(str(path), LIBRARY, what="goals")
    content = load_model(path, GoalsFile)
    with mistakes_in(path):
        check_once((table.name for table in content.goals), **TWICE)
        runs = tuple(_run_goal(table, system) for table in content.goals if table.type is None)
        check_once(
            (p.name for p in content.points), "is the name of two points", key="points.name", remedy="rename one"
        )
        points = {point.name: point.numbers() for point in content.points}
        goals = tuple(loop_goal(table) for table in content.goals if table.type is not None)
        check_points(goals, points)
    return goals, points, runs


def _run_goal(table: GoalTable, system: System | None) -> RunGoal:
    key = f"goals.{table.name}"
    if system is None:
        problem, remedy = "is about a run", "write type = ..., see the guide `Tune the gains`"
        raise InputError(problem, key=f"{key}.metric", value=table.metric, remedy=remedy)
    cost = table.metric or ""
    if cost not in system.costs:
        remedy = nearest(cost, system.costs) if system.costs else "give System(..., costs={...})"
        raise InputError("is not a cost of the system", key=f"{key}.metric", value=cost, remedy=remedy)
    for name in sorted(table.model_fields_set - {"name", "metric", "at_most", "at_least", "kind"}):
        raise InputError("is not a key of a goal on a cost", key=f"{key}.{name}", remedy="leave it out")
    sense, bound = table.bound(system.costs[cost].unit)
    if not (np.isfinite(bound.value) and bound.value > 0):
        where = f"{key}.{sense.replace(' ', '_')}"
        raise InputError("must be finite and greater than 0", key=where, value=bound.value, remedy="correct it")
    return RunGoal(table.name, cost, bound.unit, bound.value, sense, table.kind, "mean")


_ACTIVE = 0.01
"""Share of time at a limit above which a step response of the linear loop does not describe a run."""

_STEP_METRICS = ("settling_time_s.", "overshoot.")


def not_representative(
    goals: Sequence[RunGoal], after: Assessment, *, command: str, run: str, remedy: str
) -> list[str]:
    """Return a line that says that linear goals do not describe a run; nothing if no limit is active.

    Args:
        goals: the goals of a tuning; those about a step response of the linear loop count.
        after: the assessment of the tuned gains, whose figure `limited_share` is the share of time at a limit.
        command, run: what is at its limit, and in which run; `{}` stands for the place of the figure.
        remedy: how the goal is asked of the run.
    """
    names = [
        goal.name
        for goal in goals
        if goal.metric.startswith(_STEP_METRICS) or isinstance(getattr(goal, "loop", None), STEPS)
    ]
    limited = after.figures.get("limited_share")
    if not names or limited is None or not limited.value > _ACTIVE:
        return []
    at = f"{command} is at its limit {limited.value:.0%} of {run}".format(limited.where)
    return [f"not representative: {', '.join(names)} (linear): {at}; {remedy}"]

"""Goals of a linear loop of any system, as in MATLAB's TuningGoal: profile, bound, value; operating points, scores.

Each goal computes one number from a `LinearLoop`; its normalised value is at most 1 if the goal is met. An unstable
loop meets no goal.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from numbers import Real
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, mistakes_in, nearest
from surctl.plotted import Plotted
from surctl.system import LinearLoop, System, linearise
from surctl.units import in_unit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Profile:
    """A function of frequency by points, with straight lines between them on logarithmic axes.

    A goal with a profile is judged between the first and the last frequency.

    Attributes:
        frequency: frequencies [rad/s], ascending.
        value: positive values at these frequencies, as factors (not dB).
    """

    frequency: tuple[float, ...]
    value: tuple[float, ...]

    def __post_init__(self) -> None:
        omega, value = np.array(self.frequency, dtype=float), np.array(self.value, dtype=float)
        if omega.size < 2 or omega.shape != value.shape:
            remedy = "give a value for each of two or more frequencies"
            raise InputError(f"has {omega.size} frequencies and {value.size} values", key="profile", remedy=remedy)
        if not (np.isfinite(omega).all() and (omega > 0).all() and (np.diff(omega) > 0).all()):
            raise InputError("is not ascending and positive", key="frequency_rad_per_s", value=self.frequency)
        if not (np.isfinite(value).all() and (value > 0).all()):
            raise InputError("is not positive", key="profile", value=self.value, remedy="give factors, not dB")

    def __call__(self, omega: Array) -> Array:
        """Return the values (k,) at frequencies (k,) [rad/s]; NaN outside of the profile."""
        at = np.interp(np.log(omega), np.log(self.frequency), np.log(self.value), left=np.nan, right=np.nan)
        return np.asarray(np.exp(at), dtype=float)


Bound: TypeAlias = "float | Profile | Callable[[Any], Any]"
"""A bound over frequency: one number, a `Profile`, or a python-control system, whose magnitude is the bound."""


@dataclass(frozen=True, eq=False)
class LoopView:
    """The curve that a goal judges, with its bounds, for a picture.

    Attributes:
        axis: what x is: frequency [rad/s], time [s], or the real part of poles [rad/s].
        x, y: (k,) the curve; for poles, real and imaginary part.
        quantity: what y is, with its unit.
        lower, upper: (k,) bounds of y, NaN where there is none.
        region: for poles, least decay rate [1/s], least damping ratio and largest natural frequency [rad/s].
    """

    axis: Literal["frequency", "time", "poles"]
    x: Array
    y: Array
    quantity: str
    lower: Array | None = None
    upper: Array | None = None
    region: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class Judgement:
    """How well one loop meets one goal.

    Attributes:
        value: the number that the goal bounds, at the place that decides.
        unit: its unit.
        limit: the bound at that place.
        normalised: at most 1 if the goal is met; inf for an unstable loop.
        view: the judged curve; None for an unstable loop, and for margins.
        where: the place that decides, as text.
    """

    value: float
    unit: str
    limit: float
    normalised: float
    view: LoopView | None = field(default=None, repr=False)
    where: str = ""

    @property
    def met(self) -> bool:
        """Whether the goal is met."""
        return self.normalised <= 1


@dataclass(frozen=True, kw_only=True)
class LoopGoal(ABC):
    """Base class of all goals for a linear loop.

    Attributes:
        name: name of the goal in tables and pictures.
        kind: a hard goal must be met; the normalised value of a soft goal is minimised.
        points: names of the operating points at which the goal is judged; empty: at all of them.
    """

    TYPE: ClassVar[str] = ""
    UNIT: ClassVar[str] = "1"
    """Unit of the bound, unless the goal states one of its own."""

    name: str
    kind: Literal["hard", "soft"] = "soft"
    points: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            key = f"goals.{self.name}.{one.name}"
            bound = one.type == "Bound" and not isinstance(value, Real | Profile) and not callable(value)
            number = one.type == "float" and not isinstance(value, Real)
            if bound or number:
                raise InputError("is not a number", key=key, value=value, remedy="correct it")
            unset = value == one.default if isinstance(value, Real) else True
            if not unset and not (np.isfinite(value) and value > 0):
                raise InputError("must be finite and greater than 0", key=key, value=value, remedy="correct it")

    def judge(self, loop: LinearLoop) -> Judgement:
        """Return how well a loop meets the goal.

        Raises:
            InputError: the goal names a signal that the loop does not have.
        """
        with mistakes_in(None, f"goals.{self.name}."):
            self._check(loop)
            if not loop.stable:
                return Judgement(np.nan, "1", np.nan, np.inf, None, f"the loop is {loop.stability.lower()}")
            return self._judged(loop)

    def to_dict(self) -> dict[str, Any]:
        """Return the goal as plain data for JSON."""
        about = {field.name: getattr(self, field.name) for field in fields(self)}
        plain = {key: _plain(value) for key, value in about.items()}
        return {"name": plain.pop("name"), "type": self.TYPE, **plain}

    @abstractmethod
    def _check(self, loop: LinearLoop) -> None:
        """Raise InputError if a signal of the goal is not in the loop."""

    @abstractmethod
    def _judged(self, loop: LinearLoop) -> Judgement:
        """Return how well a stable loop meets the goal."""


def _plain(value: Any) -> Any:
    if isinstance(value, Profile):
        return {"frequency_rad_per_s": list(value.frequency), "value": list(value.value)}
    if isinstance(value, tuple):
        return list(value)
    return value if isinstance(value, str | float | int | None) else str(value)


@dataclass(frozen=True, kw_only=True)
class Opened(LoopGoal):
    """Base of the goals about the loop opened at signals.

    Attributes:
        at: labels of commands or measured outputs; several of them are opened at once.
    """

    at: str | tuple[str, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "at", self.openings)

    def _check(self, loop: LinearLoop) -> None:
        loop.opened(*self.openings)

    @property
    def openings(self) -> tuple[str, ...]:
        """Labels of the signals, also if one label was given."""
        return (self.at,) if isinstance(self.at, str) else self.at


@dataclass(frozen=True, kw_only=True)
class Between(LoopGoal):
    """Base of the goals about the closed loop from one signal to another.

    Attributes:
        source: label of a reference, a disturbance, a measured output or a command. A measured output stands for its
            setpoint, a command for a load that adds to it, see `LinearLoop.transfer`.
        end: label of a measured output or of a command.
    """

    source: str
    end: str

    def _check(self, loop: LinearLoop) -> None:
        loop.transferred([self.source], [self.end])

    @property
    def _path(self) -> str:
        return f"{self.source} to {self.end}"

    def _scale(self, loop: LinearLoop, unit: str, *, over_source: bool) -> tuple[float, str]:
        """Return the factor from the loop's own unit to a stated unit, and the unit to show.

        Args:
            loop: the loop; it may know the units of its signals.
            unit: stated unit of the bound; empty: the loop's own.
            over_source: the bound is about the end over the source, not about the end alone.

        Raises:
            InputError: the stated unit has another dimension than the signals.
        """
        end, source = loop.unit(self.end, ("measured", "command")), loop.unit(self.source)
        own = end if not over_source else "1" if end == source else f"({end})/({source})"
        if not unit or not end or (over_source and not source):
            return 1.0, unit or own if end and source else unit or "1"
        with mistakes_in(None, "at_most.unit"):
            return 1 / in_unit(1.0, unit, own), unit


# Goals judged at several operating points of a system; the worst point decides


@dataclass(frozen=True, eq=False)
class Score:
    """One goal judged at one operating point.

    Attributes:
        goal: the goal.
        point: name of the operating point.
        judgement: its value, bound, normalised value and curve.
    """

    goal: LoopGoal
    point: str
    judgement: Judgement

    def __str__(self) -> str:
        """Return the goal, its normalised value, its value and bound, and the operating point, in one line."""
        one = self.judgement
        unit = "" if one.unit == "1" else f" {one.unit}"
        value = "no value" if one.value != one.value else f"{one.value:.4g}{unit} for {one.limit:.4g}"
        mark = "met    " if one.met else "NOT MET"
        place = f", {one.where}" if one.where else ""
        return f"{mark} {self.goal.name} ({self.goal.kind}): {one.normalised:.3f}, {value}{place}; {self.point}"

    def to_dict(self) -> dict[str, Any]:
        """Return the score as plain data for JSON."""
        one = self.judgement
        numbers = {"value": one.value, "unit": one.unit, "limit": one.limit, "normalised": one.normalised}
        return {"goal": self.goal.name, "kind": self.goal.kind, "point": self.point, **numbers, "where": one.where}


@dataclass(frozen=True, eq=False)
class LoopScores(Plotted):
    """The scores of all goals at all operating points; `plot()` draws each goal with its violated region.

    Attributes:
        scores: the scores, goal by goal.
    """

    PLOT = "surctl.report.page_parts:plot_loop_goals"

    scores: tuple[Score, ...]

    @property
    def met(self) -> bool:
        """Whether every hard goal is met at every one of its points."""
        return all(score.judgement.met for score in self.scores if score.goal.kind == "hard")

    def worst(self) -> tuple[Score, ...]:
        """Return, for each goal, the score at its worst operating point."""
        best: dict[str, Score] = {}
        for score in self.scores:
            known = best.get(score.goal.name)
            if known is None or score.judgement.normalised > known.judgement.normalised:
                best[score.goal.name] = score
        return tuple(best.values())

    def lines(self) -> list[str]:
        """Return a line of text for each goal, at its worst operating point."""
        return [str(score) for score in self.worst()]


def check_points(goals: Sequence[LoopGoal], points: Mapping[str, Any]) -> None:
    """Raise InputError if a goal names an operating point that does not exist."""
    for goal in goals:
        for name in goal.points:
            if name not in points:
                key, remedy = f"goals.{goal.name}.points", nearest(name, points) if points else "add a [[points]] table"
                raise InputError("is not an operating point", key=key, value=name, remedy=remedy)


def operating_loops(system: System, points: Mapping[str, Mapping[str, ArrayLike]]) -> dict[str, LinearLoop]:
    """Return the linear loop of a system at each operating point, by its name.

    Args:
        system: the closed loop.
        points: numbers of each operating point by name, as in `run_numbers`; without points, the system's own numbers.

    Raises:
        InputError: a point has no equilibrium, or `run_numbers` rejects its numbers.

    Example:
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import operating_loops
        >>> loops = operating_loops(cart_system(2.0), {"soft": {"k": 1.0}, "stiff": {"k": 4.0}})
        >>> {name: round(float(abs(loop.poles()[0])), 2) for name, loop in loops.items()}
        {'soft': 0.9, 'stiff': 0.6}
    """
    loops: dict[str, LinearLoop] = {}
    for name, values in (points or {"nominal": {}}).items():
        try:
            loops[name] = linearise(system, values)
        except InputError as error:
            raise InputError(error.problem, key=f"point {name}: {error.key}", remedy=error.remedy) from None
    return loops


def judge_loops(goals: Sequence[LoopGoal], loops: Mapping[str, LinearLoop]) -> LoopScores:
    """Return the score of every goal at each of its operating points.

    Raises:
        InputError: a goal names a signal or an operating point that does not exist.

    Example:
        >>> from surctl.system import linearise
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import Margins, SensitivityBound, judge_loops
        >>> peak = SensitivityBound(name="peak", at="force", at_most=2.0)
        >>> goals = [peak, Margins(name="phase", at="force", phase_deg=60.0)]
        >>> for line in judge_loops(goals, {"nominal": linearise(cart_system(2.0))}).lines():
        ...     print(line)
        met     peak (soft): 0.556, 1.111 for 2, at 31.4 rad/s; nominal
        met     phase (soft): 0.712, 84.26 deg for 60, phase margin 84.3 deg at force; nominal
    """
    check_points(goals, loops)
    return LoopScores(
        tuple(
            Score(goal, name, goal.judge(loop))
            for goal in goals
            for name, loop in loops.items()
            if not goal.points or name in goal.points
        )
    )

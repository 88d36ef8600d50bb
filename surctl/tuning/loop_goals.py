"""Goals of a linear loop of any system, as in MATLAB's TuningGoal: profile, value, bound and its unit, signals.

Each goal computes one number from a `LinearLoop`; its normalised value is at most 1 if the goal is met. An unstable
loop meets no goal.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from numbers import Real
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.system import LinearLoop
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
        try:
            self._check(loop)
            if not loop.stable:
                return Judgement(np.nan, "1", np.nan, np.inf, None, f"the loop is {loop.stability.lower()}")
            return self._judged(loop)
        except InputError as error:
            raise InputError(
                error.problem, key=f"goals.{self.name}.{error.key}", value=error.value, remedy=error.remedy
            ) from None

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
        try:
            return 1 / in_unit(1.0, unit, own), unit
        except InputError as error:
            raise InputError(error.problem, key="at_most.unit", value=unit, remedy=error.remedy) from None

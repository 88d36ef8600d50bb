"""Goals about the frequency response of a linear loop: shape, sensitivity, rejection, gain, effort, tracking."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.system import LinearLoop
from surctl.tuning.loop_goals import Between, Bound, Judgement, LoopView, Opened, Profile
from surctl.tuning.loop_responses import frequencies, loop_gains, response, sensitivities_at

Array = NDArray[np.float64]
_TINY = 1e-12
_SIDES = ("both", "above", "below")


@dataclass(frozen=True, kw_only=True)
class LoopShape(Opened):
    """The loop gain |L| follows a target within a band, as `TuningGoal.LoopShape`.

    Attributes:
        target: the target of the loop gain over frequency.
        band_db: largest distance from the target [dB].
        side: "both"; "above" if the gain may only not fall below the band (least loop gain at low frequencies);
            "below" if it may only not rise above the band (roll-off).

    Example:
        >>> from surctl.system import linearise
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import LoopShape
        >>> from surctl.tuning.loop_goals import Profile
        >>> goal = LoopShape(name="integrator", at=("force",), target=Profile((0.01, 1.0), (200.0, 2.0)), band_db=1.0)
        >>> goal.judge(linearise(cart_system(2.0))).met
        True
    """

    TYPE: ClassVar[str] = "loop_shape"

    target: Bound
    band_db: float = 3.0
    side: Literal["both", "above", "below"] = "both"

    def _check(self, loop: LinearLoop) -> None:
        super()._check(loop)
        if self.side not in _SIDES:
            raise InputError("is not a side", key="side", value=self.side, remedy=f"write one of: {', '.join(_SIDES)}")

    def _judged(self, loop: LinearLoop) -> Judgement:
        omega, target = _grid(loop, self.openings, self.target, zeros=self.side != "below")
        least, largest = loop_gains(loop, self.openings, omega)
        low, high = (-20 * np.log10(np.maximum(least / target, _TINY)), 20 * np.log10(largest / target))
        off = {"both": np.maximum(low, high), "above": low, "below": high}[self.side]
        k = int(np.nanargmax(off))
        factor = 10 ** (self.band_db / 20)
        lower = None if self.side == "below" else target / factor
        upper = None if self.side == "above" else target * factor
        shown = least if self.side == "above" else largest
        view = LoopView("frequency", omega, shown, "|L| [1]", lower, upper)
        share = max(float(off[k]), 0.0) / self.band_db
        return Judgement(float(off[k]), "dB", self.band_db, share, view, f"at {omega[k]:.3g} rad/s")


@dataclass(frozen=True, kw_only=True)
class SensitivityBound(Opened):
    """The sensitivity |S| stays below a bound over frequency, as `TuningGoal.Sensitivity`.

    Attributes:
        at_most: bound of the largest singular value of S.
    """

    TYPE: ClassVar[str] = "sensitivity"

    at_most: Bound

    def _judged(self, loop: LinearLoop) -> Judgement:
        omega, bound = _grid(loop, self.openings, self.at_most)
        return _below(omega, sensitivities_at(loop, self.openings, omega)[0], bound, "|S| [1]")


@dataclass(frozen=True, kw_only=True)
class Rejection(Opened):
    """Disturbances at a signal are attenuated by at least a factor, as `TuningGoal.Rejection`.

    Attributes:
        attenuation: least factor of attenuation, 1/|S|, over frequency.
    """

    TYPE: ClassVar[str] = "rejection"

    attenuation: Bound

    def _judged(self, loop: LinearLoop) -> Judgement:
        omega, factor = _grid(loop, self.openings, self.attenuation)
        return _below(omega, sensitivities_at(loop, self.openings, omega)[0], 1 / factor, "|S| [1]")


@dataclass(frozen=True, kw_only=True)
class MaxGain(Between):
    """The magnitude |T| from one signal to another stays below a bound over frequency, as `TuningGoal.Gain`.

    Attributes:
        at_most: bound of the magnitude.
        unit: unit of the bound, such as "N m/deg"; empty: that of the end over that of the source.
    """

    TYPE: ClassVar[str] = "gain"

    at_most: Bound
    unit: str = ""

    def _check(self, loop: LinearLoop) -> None:
        super()._check(loop)
        self._scale(loop, self.unit, over_source=True)

    def _judged(self, loop: LinearLoop) -> Judgement:
        factor, unit = self._scale(loop, self.unit, over_source=True)
        omega, bound = _grid(loop, (), self.at_most)
        size = factor * np.abs(response(loop.transferred([self.source], [self.end]), omega, loop.dt)[:, 0, 0])
        return _below(omega, size, bound, f"|T| [{unit}]", unit)


@dataclass(frozen=True, kw_only=True)
class Effort(MaxGain):
    """The magnitude from a reference, setpoint or disturbance to a command stays below a bound over frequency.

    From a setpoint, this is |K S|.
    """

    TYPE: ClassVar[str] = "effort"

    def _check(self, loop: LinearLoop) -> None:
        super()._check(loop)
        label = self.end.removeprefix("command.")
        if label not in loop.names.commands or (label in loop.names.outputs and label == self.end):
            remedy = f"name one of: {', '.join(f'command.{one}' for one in loop.names.commands)}"
            raise InputError("is not a command", key="to", value=self.end, remedy=remedy)


@dataclass(frozen=True, kw_only=True)
class Tracking(Between):
    """The relative error |1 - T| stays below a bound that rises with frequency, as `TuningGoal.Tracking`.

    The bound is |(e_p s + e_0 w)/(s + w)| with w = 2/response time, e_0 = `steady_error` and e_p = `peak_error`.

    Attributes:
        response_s: response time [s].
        steady_error: largest error of a constant reference, as a share; greater than 0.
        peak_error: largest error over all frequencies, as a share.
    """

    TYPE: ClassVar[str] = "tracking"

    response_s: float
    steady_error: float = 0.01
    peak_error: float = 1.0

    def _judged(self, loop: LinearLoop) -> Judgement:
        omega = frequencies(loop)
        w, s = 2 / self.response_s, 1j * omega
        bound = np.abs((self.peak_error * s + self.steady_error * w) / (s + w))
        T = response(loop.transferred([self.source], [self.end]), omega, loop.dt)[:, 0, 0]
        return _below(omega, np.abs(1 - T), bound, "|error| [1]")


def _grid(loop: LinearLoop, at: Sequence[str], bound: Bound, *, zeros: bool = False) -> tuple[Array, Array]:
    """Return the frequencies at which a bound is judged, and its values there.

    Raises:
        InputError: the bound lies wholly outside of the loop's frequencies.
    """
    omega = frequencies(loop, at, zeros=zeros)
    if isinstance(bound, Profile):
        inside = [w for w in bound.frequency if w < np.pi / loop.dt]
        ends = [*inside, *np.geomspace(min(inside, default=1.0), max(inside, default=1.0), 100)]
        omega = np.unique(np.concatenate([omega, ends]))
        value = bound(omega)
    elif callable(bound):
        value = _magnitude(bound, omega, loop.dt)
    else:
        value = np.full(len(omega), float(bound))
    judged = np.isfinite(value) & (value > 0)
    if not judged.any():
        remedy = f"bound frequencies below {np.pi / loop.dt:.4g} rad/s, half of the control frequency"
        raise InputError("bounds no frequency of the loop", key="frequency_rad_per_s", remedy=remedy)
    return omega[judged], value[judged]


def _magnitude(bound: Callable[[Any], Any], omega: Array, dt: float) -> Array:
    # of a python-control system, in continuous or in discrete time, or of another function of s
    if getattr(bound, "isdtime", lambda strict: False)(strict=True):
        own = getattr(bound, "dt", None)
        if own is not True and abs(float(own or 0) - dt) > 1e-9 * dt:
            remedy = f"give it in continuous time, or with the control period {dt:g} s"
            raise InputError("has another control period than the loop", key="bound", value=own, remedy=remedy)
        at = np.exp(1j * omega * dt)
    else:
        at = 1j * omega
    value = np.abs(np.asarray(bound(at), dtype=complex))
    if value.size != omega.size:
        remedy = "give a system with one input and one output"
        raise InputError(f"has {value.size // omega.size} entries, expected 1", key="bound", remedy=remedy)
    return np.asarray(value.reshape(-1), dtype=float)


def _below(omega: Array, size: Array, bound: Array, quantity: str, unit: str = "1") -> Judgement:
    share = size / bound
    k = int(np.argmax(share))
    view = LoopView("frequency", omega, size, quantity, upper=bound)
    return Judgement(float(size[k]), unit, float(bound[k]), float(share[k]), view, f"at {omega[k]:.3g} rad/s")

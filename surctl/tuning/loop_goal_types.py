"""Goals about a linear loop: its frequency response, step responses, poles and margins, as in MATLAB's TuningGoal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.system import LinearLoop
from surctl.tuning.loop_goals import Between, Bound, Judgement, LoopGoal, LoopView, Opened, Profile
from surctl.tuning.loop_responses import (
    REMAINDER,
    frequencies,
    held_step,
    loop_gains,
    rates,
    response,
    sensitivities_at,
    step_series,
)
from surctl.verification.sampled_margins import system_margins

Array = NDArray[np.float64]
_TINY = 1e-12
_SIDES = ("both", "above", "below")
_BAND = 0.02  # of the final value, as in step_info of python-control
_UNIT = 1e-3  # largest distance from 1 of the gain of a reference model at frequency 0
_RESTS = 1e-6  # a final value below this share of the peak counts as 0


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


@dataclass(frozen=True, kw_only=True)
class Overshoot(Between):
    """The response to a step exceeds its final value by at most a share, as `TuningGoal.Overshoot`.

    Attributes:
        at_most: largest overshoot as a share of the final value, such as 0.1 for 10 %.
    """

    TYPE: ClassVar[str] = "overshoot"

    at_most: float

    def _judged(self, loop: LinearLoop) -> Judgement:
        time, value, final = step_series(loop, self.source, self.end)
        if _returns(value, final):
            raise InputError("returns to 0 after a step", key="to", value=self._path, remedy="use step_rejection")
        share = value / final
        over = max(float(share.max()) - 1, 0.0)
        view = LoopView("time", time, share, "response / final value [1]", upper=_flat(time, 1 + self.at_most))
        at = f"at {time[int(share.argmax())]:.3g} s"
        return Judgement(over, "1", self.at_most, over / self.at_most, view, at)


@dataclass(frozen=True, kw_only=True)
class Settling(Between):
    """The response to a step stays within 2 % of its final value from a time on.

    If the response returns to 0, as after a disturbance, the band is 2 % of its peak. The value is 0 if there is no
    response.

    Attributes:
        at_most: longest settling time [s].
    """

    TYPE: ClassVar[str] = "settling"
    UNIT: ClassVar[str] = "s"

    at_most: float

    def _judged(self, loop: LinearLoop) -> Judgement:
        time, value, final = step_series(loop, self.source, self.end)
        scale = float(np.abs(value).max()) if _returns(value, final) else abs(final)
        duration, late = _settling_time(time, value, final, scale), time >= self.at_most
        lower, upper = (np.where(late, final + sign * _BAND * scale, np.nan) for sign in (-1, 1))
        view = LoopView("time", time, value, self.end, lower, upper)
        return Judgement(duration, "s", self.at_most, duration / self.at_most, view, "2 % band")


@dataclass(frozen=True, kw_only=True)
class StepTracking(Between):
    """The response to a step follows that of a reference model, as `TuningGoal.StepTracking`.

    The value is the gap |y - y_ref|/|1 - y_ref|, with |·| the root of the sum of squares over time, until the slowest
    modes of loop and model have decayed to 1e-4.

    Attributes:
        model: reference model, a stable python-control system in continuous time with one input, one output and the
            gain 1 at frequency 0.
        at_most: largest gap.

    Example:
        >>> import control
        >>> from surctl.system import linearise
        >>> from surctl.testing import cart_system
        >>> from surctl.tuning import StepTracking
        >>> model = control.tf([2.0], [1.0, 2.0])
        >>> goal = StepTracking(name="as a lag", source="measured.speed", end="speed", model=model, at_most=0.2)
        >>> goal.judge(linearise(cart_system(2.0))).met
        True
    """

    TYPE: ClassVar[str] = "step_tracking"

    model: Any
    at_most: float = 0.1

    def _check(self, loop: LinearLoop) -> None:
        super()._check(loop)
        self._matrices()

    def _matrices(self) -> tuple[Array, Array, Array, Array]:
        import control  # takes seconds to import

        model, remedy = self.model, "give a stable model in continuous time, such as control.tf([1], [2, 1])"
        try:
            whole = control.ss(model)
        except (TypeError, ValueError) as error:
            raise InputError(
                f"is not a model with a proper transfer function ({error})", key="model", remedy=remedy
            ) from None
        problems = {
            "is in discrete time": whole.isdtime(strict=True),
            f"has {whole.ninputs} inputs and {whole.noutputs} outputs": (whole.ninputs, whole.noutputs) != (1, 1),
            "has no state": not whole.nstates,
            "is unstable": bool(whole.nstates) and not np.real(whole.poles()).max() < 0,
        }
        wrong = [problem for problem, holds in problems.items() if holds]
        if not wrong and not abs(float(np.real(whole.dcgain())) - 1) < _UNIT:
            wrong, remedy = [f"has the gain {np.real(whole.dcgain()):.4g} at frequency 0"], "scale it to the gain 1"
        if wrong:
            raise InputError(wrong[0], key="model", remedy=remedy)
        return whole.A, whole.B, whole.C, whole.D

    def _judged(self, loop: LinearLoop) -> Judgement:
        model = self._matrices()
        slowest = float(np.min(-np.linalg.eigvals(model[0]).real))
        time, value, _ = step_series(loop, self.source, self.end, least_s=-np.log(REMAINDER) / slowest)
        reference = held_step(model, time)
        free = float(np.linalg.norm(1 - reference))
        gap = float(np.linalg.norm(value - reference)) / free if free > 0 else np.inf
        allowance = self.at_most * free / np.sqrt(len(time))  # a constant gap of this size is at the bound
        view = LoopView("time", time, value, self.end, reference - allowance, reference + allowance)
        return Judgement(gap, "1", self.at_most, gap / self.at_most, view, "relative gap to the model")


@dataclass(frozen=True, kw_only=True)
class StepRejection(Between):
    """Bound on the response to a step disturbance, like `TuningGoal.StepRejection` in MATLAB.

    Attributes:
        at_most: largest magnitude of the response, in units of the end for a step of one unit of the source.
        unit: unit of the bound; empty: that of the end.
    """

    TYPE: ClassVar[str] = "step_rejection"

    at_most: float
    unit: str = ""

    def _check(self, loop: LinearLoop) -> None:
        super()._check(loop)
        self._scale(loop, self.unit, over_source=False)

    def _judged(self, loop: LinearLoop) -> Judgement:
        factor, unit = self._scale(loop, self.unit, over_source=False)
        time, value, _ = step_series(loop, self.source, self.end)
        value = factor * value
        peak, k = float(np.abs(value).max()), int(np.abs(value).argmax())
        view = LoopView("time", time, value, self.end, _flat(time, -self.at_most), _flat(time, self.at_most))
        return Judgement(peak, unit, self.at_most, peak / self.at_most, view, f"at {time[k]:.3g} s")


@dataclass(frozen=True, kw_only=True)
class Poles(LoopGoal):
    """The poles of the closed loop lie in a region, as `TuningGoal.Poles`; z is mapped to s = log(z)/dt.

    Attributes:
        decay_per_s: least decay rate -Re(s) [1/s].
        damping: least damping ratio -Re(s)/|s| of complex poles.
        fastest_rad_per_s: largest |s| [rad/s].
    """

    TYPE: ClassVar[str] = "poles"

    decay_per_s: float = 0.0
    damping: float = 0.0
    fastest_rad_per_s: float = np.inf

    def _check(self, loop: LinearLoop) -> None:
        if not (self.decay_per_s > 0 or self.damping > 0 or np.isfinite(self.fastest_rad_per_s)):
            raise InputError("bounds nothing", key="poles", remedy="give decay_per_s, damping or fastest_rad_per_s")
        if self.damping > 1:
            remedy = "give a damping ratio up to 1; a real pole has 1"
            raise InputError("is greater than 1", key="damping", value=self.damping, remedy=remedy)

    def _judged(self, loop: LinearLoop) -> Judgement:
        poles = rates(loop)
        decay, size = float(np.min(-poles.real, initial=np.inf)), np.abs(poles)
        complex_ones = np.abs(poles.imag) > 1e-9 * np.maximum(size, 1e-12)
        damping = float(np.min(-poles.real[complex_ones] / size[complex_ones], initial=1.0))
        fastest = float(size.max(initial=0.0))
        checks = [
            (self.decay_per_s / decay, decay, self.decay_per_s, "decay rate", "1/s"),
            (self.damping / damping if damping > 0 else np.inf, damping, self.damping, "damping ratio", "1"),
            (fastest / self.fastest_rad_per_s, fastest, self.fastest_rad_per_s, "natural frequency", "rad/s"),
        ]
        worst = max(checks, key=lambda check: check[0])
        view = LoopView(
            "poles", poles.real, poles.imag, "imaginary part [rad/s]",
            region=(self.decay_per_s, self.damping, self.fastest_rad_per_s),
        )  # fmt: skip
        share, value, limit, what, unit = worst
        text = f"{what} {value:.3g}" + ("" if unit == "1" else f" {unit}")
        return Judgement(value, unit, limit, float(share), view, text)


@dataclass(frozen=True, kw_only=True)
class Margins(Opened):
    """Gain, phase, delay and disk margin of every loop, opened one at a time, as `TuningGoal.Margins`.

    Attributes:
        gain: least gain margin, a factor greater than 1; a margin downwards counts too.
        phase_deg: least phase margin [deg].
        delay_s: least delay margin [s].
        disk: least disk margin α, 0 to 2.
    """

    TYPE: ClassVar[str] = "margins"

    gain: float = 0.0
    phase_deg: float = 0.0
    delay_s: float = 0.0
    disk: float = 0.0

    def _check(self, loop: LinearLoop) -> None:
        super()._check(loop)
        if not max(self.gain, self.phase_deg, self.delay_s, self.disk) > 0:
            raise InputError("bounds nothing", key="margins", remedy="give gain, phase_deg, delay_s or disk")
        if self.gain and not self.gain > 1:
            raise InputError("is not greater than 1", key="gain", value=self.gain, remedy="give a factor, such as 2")

    def _judged(self, loop: LinearLoop) -> Judgement:
        checks: list[tuple[float, float, float, str, str]] = []
        for m in system_margins(loop, *self.openings):
            both = min(m.gain_margin, 1 / m.least_gain if m.least_gain > 0 else np.inf)
            if self.gain:  # in dB, so that twice the margin is half the normalised value
                share = np.log(self.gain) / np.log(both) if both > 1 else np.inf
                checks.append((float(share), both, self.gain, f"gain margin {both:.3g} at {m.name}", "1"))
            for least, value, what, unit in (
                (self.phase_deg, m.phase_margin_deg, "phase margin", "deg"),
                (self.delay_s, m.delay_margin_s, "delay margin", "s"),
                (self.disk, m.disk_margin, "disk margin", "1"),
            ):
                if least:
                    text = f"{what} {value:.3g}{'' if unit == '1' else f' {unit}'} at {m.name}"
                    checks.append((least / value if value > 0 else np.inf, value, least, text, unit))
        share, value, limit, text, unit = max(checks, key=lambda check: check[0])
        return Judgement(value, unit, limit, share, None, text)


def _settling_time(time: Array, value: Array, final: float, scale: float) -> float:
    """Return the time [s] from which a response stays within 2 % of `scale` about its final value."""
    if not scale > 0:
        return 0.0
    outside = np.flatnonzero(np.abs(value - final) >= _BAND * scale)
    if not outside.size:
        return 0.0
    return float(time[min(int(outside[-1]) + 1, len(time) - 1)])


def _returns(value: Array, final: float) -> bool:
    return abs(final) <= _RESTS * float(np.abs(value).max(initial=0.0))


def _flat(time: Array, level: float) -> Array:
    return np.full(len(time), level)


STEPS = (Overshoot, Settling, StepTracking, StepRejection)
"""Goals about a step response."""

TYPES: Mapping[str, type[LoopGoal]] = {
    kind.TYPE: kind
    for kind in (LoopShape, SensitivityBound, Rejection, MaxGain, Effort, Tracking, *STEPS, Poles, Margins)
}
"""Types of goals about the loop, by the name in a goals file."""

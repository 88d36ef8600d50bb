"""The model that is fitted to a log: the simulated motion of each section of the log, and its sensitivities.

A section is a part of the log without a gap, of at most one minute. Each section has its own initial state, so that an
error of the model does not accumulate over the whole log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.dynamics import plant_parameters, plant_state
from surctl.marine.vehicle.identification.fitted import (
    CONSTANT_FORCE,
    masses_of,
    names_of,
    scale_of,
    with_all_constants,
)
from surctl.marine.vehicle.identification.rates import places, stepper
from surctl.marine.vehicle.motion_log import LOG_MOTION, LOG_TILT, MotionLog
from surctl.marine.vehicle.parameters import Vehicle

__all__ = ["LONGEST", "Model", "Section", "drift_sections_of", "sections_of"]

LONGEST = 60.0
"""Longest section [s]."""

_LONGEST_DRIFT = 20.0  # [s] longest section if the constant force drifts, unless it has too few rows

_STEP = 0.05  # [s] integration step
_STEPS_PER_ROW, _LONGEST_STEP = 5, 0.2  # of a log with few rows per second, whose steps are longer; and their limit [s]
_LEAST_LAG = 0.02  # [s] smallest thrust lag; a smaller one would need shorter integration steps
_PRIOR = 2.0  # prior standard deviation of the relative change of a parameter
_LOOSE = 1e3  # [m, rad, m/s, rad/s] prior standard deviation of the motion at the start of a section
_GAP, _GAP_FACTOR = 0.5, 5.0  # a gap is longer than this [s] and than this many median periods
_LEAST_ROWS = 20  # rows of a section
_DRIFT = 0.2  # prior standard deviation of a drifting constant force, as a share of the largest thrust
_HEADING, _THRUST = 3, slice(8, 12)  # places in the state
_AT_ONCE = 60_000  # integration steps whose sensitivities are in memory at the same time

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Section:
    """A part of a log without a gap.

    Attributes:
        rows: the range of its rows in the log.
        dt: (m,) lengths of the integration steps [s].
        thrust: (m, 4) commanded thrust of each step.
        at: (n,) number of steps before each row.
    """

    rows: slice
    dt: Array
    thrust: Array
    at: NDArray[np.int64]

    def part(self, first: int, rows: int) -> Section:
        """Return at most `rows` rows of the section from the row `first` on."""
        at = self.at[first : first + rows]
        steps = slice(int(at[0]), int(at[-1]))
        start = self.rows.start + first
        return Section(slice(start, start + len(at)), self.dt[steps], self.thrust[steps], at - at[0])


def sections_of(log: MotionLog, *, longest: float = LONGEST) -> tuple[Section, ...]:
    """Return the sections of a log that have enough rows with motion, each of at most `longest` seconds.

    Raises:
        InputError: no part of the log between its gaps is long enough.
    """
    step = np.diff(log.time)
    gap = step > max(_GAP, _GAP_FACTOR * float(np.median(step)))
    sections = []
    for start, stop in _runs(gap, len(log.time)):
        duration = float(log.time[stop - 1] - log.time[start])
        parts = max(int(np.ceil(duration / longest)), 1)
        cuts = np.searchsorted(log.time[start:stop], log.time[start] + duration * np.arange(parts + 1) / parts)
        cuts[-1] = stop - start
        for one, other in zip(start + cuts[:-1], start + cuts[1:], strict=True):
            if other - one >= _LEAST_ROWS and np.isfinite(log.motion[one:other]).any():
                sections.append(_section(log, int(one), int(other)))
    period = float(np.median(step))
    if not sections and (_LEAST_ROWS - 1) * period > longest:
        raise InputError(
            f"has rows {period:.3g} s apart (median); a fit needs {_LEAST_ROWS} rows in {longest:g} s",
            file=log.source,
            key="t_s",
            remedy="is the time in ms? name the column t_ms, or set log.time_unit in the map",
        )
    if not sections:
        raise InputError(
            f"has no part of {_LEAST_ROWS} rows without a gap",
            file=log.source,
            key="t_s",
            remedy=f"give a log without a gap of more than {max(_GAP, _GAP_FACTOR * period):.3g} s",
        )
    return tuple(sections)


def drift_sections_of(log: MotionLog) -> tuple[Section, ...]:
    """Return the sections of a log, each with a constant force of its own: of 20 s, or longer if they have few rows.

    Raises:
        InputError: no part of the log between its gaps is long enough.
    """
    rows = 2 * _LEAST_ROWS  # a part that is a little longer than this is halved
    longest = max(_LONGEST_DRIFT, rows * float(np.median(np.diff(log.time))))
    return sections_of(log, longest=longest)


def _runs(gap: NDArray[np.bool_], rows: int) -> list[tuple[int, int]]:
    ends = np.flatnonzero(gap) + 1
    return list(zip([0, *ends.tolist()], [*ends.tolist(), rows], strict=True))


def _section(log: MotionLog, start: int, stop: int) -> Section:
    step = np.diff(log.time[start:stop])
    longest = min(max(_STEP, float(np.median(step)) / _STEPS_PER_ROW), _LONGEST_STEP)
    parts = np.maximum(np.ceil(step / longest - 1e-9).astype(int), 1)
    return Section(
        slice(start, stop),
        np.repeat(step / parts, parts),
        np.repeat(log.thrust[start : stop - 1], parts, axis=0),
        np.concatenate([[0], np.cumsum(parts)]),
    )


class Model:
    """The residuals of a log as a function of the vector θ of fitted quantities.

    θ contains the changes of the parameters `names`, in units of `scale`, and for each section the state (s,) of the
    plant at its start. The measured motion has c columns. Without roll and pitch, s is 12 and c is 8; with them, s is
    16 and c is 12. If the constant force drifts, the state is followed by the difference (4,) of the section's constant
    force from that of the vehicle in its middle, and by the further difference (4,) at its end [N, N m].
    """

    def __init__(self, log: MotionLog, start: Vehicle, sections: tuple[Section, ...], *, drift: bool = False) -> None:
        self.log, self.sections, self.drift = log, sections, drift
        whole = with_all_constants(start)
        self.names, self.masses = names_of(whole), masses_of(whole)
        layout = plant_state(whole.form)
        self.order = layout.size
        self.local = self.order + (8 if drift else 0)  # entries of θ for each section
        self._force = np.array([self.names.index(k) for k in CONSTANT_FORCE])
        self.columns = (*LOG_MOTION, *LOG_TILT) if whole.form.tilts else LOG_MOTION
        self.outputs = np.r_[0:8, 12:16] if whole.form.tilts else np.arange(8)  # places of the columns in the state
        self.motion = log.motion[:, : len(self.columns)]
        self.thrust = np.abs(start.thrust_range).max(axis=0)
        self.thrust[self.thrust == 0.0] = 1.0
        self.start = np.array([whole[k] for k in self.names])
        self.scale = np.array([scale_of(whole, k, self.thrust) for k in self.names])
        self.present = np.isfinite(self.motion)
        self._couplings = [(i, j, self.names.index(k)) for i, j, k in whole.form.inertia() if i != j]
        self._step, self._slope = stepper(whole.form, self.names)
        flat = plant_parameters(_unlimited(whole))
        self._known = flat[places(whole.form, self.names)[1]]
        # masses are positive; an estimate of a drag may be negative, otherwise its interval would be wrong
        self.low = np.full(len(self.names), -np.inf)
        self.low[[self.names.index(k) for k in self.masses]] = -0.95
        if "thrust_lag" in self.names:
            self.low[self.names.index("thrust_lag")] = min(_LEAST_LAG / start["thrust_lag"] - 1.0, -1e-3)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.names)

    def values(self, theta: Array) -> dict[str, float]:
        """Return the parameters by name, in SI units."""
        return dict(zip(self.names, (self.start + self.scale * theta[: self.size]).tolist(), strict=True))

    def begin(self, sections: tuple[Section, ...]) -> Array:
        """Return θ with unchanged parameters, and each section's first measured motion and first command."""
        parts = [np.zeros(self.size)]
        for section in sections:
            motion, present = self.motion[section.rows], self.present[section.rows]
            state = np.zeros(self.order)
            state[self.outputs] = [motion[p, k][0] if p.any() else 0.0 for k, p in enumerate(present.T)]
            state[_THRUST] = self.log.thrust[section.rows.start]
            parts.append(np.pad(state, (0, self.local - self.order)))
        return np.concatenate(parts)

    def states(self, theta: Array, sections: tuple[Section, ...]) -> list[Array]:
        """Return for each section the simulated states (m + 1, s) after each integration step."""
        lengths = np.array([len(s.dt) for s in sections])
        total = int(lengths.sum())
        p = self._rows(theta, sections)
        flag, start, initial = np.zeros((total, 1)), np.zeros((total, self.order)), self._initial(theta, sections)
        firsts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        flag[firsts], start[firsts] = 1.0, initial
        thrust, dt = np.vstack([s.thrust for s in sections]), np.concatenate([s.dt for s in sections])
        (after,) = self._step(np.zeros(self.order), flag, start, thrust, p, dt[:, None])
        return [
            np.vstack([begin, after[k : k + n]])
            for k, n, begin in zip(firsts.tolist(), lengths.tolist(), initial, strict=True)
        ]

    def misfit(self, theta: Array, sections: tuple[Section, ...]) -> list[Array]:
        """Return for each section simulated minus measured motion (n, c); 0 where no measurement exists."""
        return [self._difference(s, x) for s, x in zip(sections, self.states(theta, sections), strict=True)]

    def _difference(self, section: Section, states: Array) -> Array:
        present = self.present[section.rows]
        measured = np.where(present, self.motion[section.rows], 0.0)
        return np.where(present, states[section.at][:, self.outputs] - measured, 0.0)

    def turned_back(self, theta: Array, sections: tuple[Section, ...]) -> Array:
        """Return θ with whole turns added to the headings at the start of sections, so that they fit best."""
        turned = theta.copy()
        own = turned[self.size :].reshape(-1, self.local)
        for k, (section, error) in enumerate(zip(sections, self.misfit(theta, sections), strict=True)):
            present = self.present[section.rows][:, _HEADING]
            if present.any():
                own[k, _HEADING] -= 2.0 * np.pi * np.round(error[present, _HEADING].mean() / (2.0 * np.pi))
        return turned

    def cost(self, theta: Array, noise: Array, sections: tuple[Section, ...]) -> float:
        """Return half the sum of the squared residuals, with the prior.

        The cost is inf if the simulation diverges, or if the inertia matrix is not positive definite.
        """
        if not self._possible(theta):
            return float("inf")
        with np.errstate(over="ignore", invalid="ignore"):
            data = sum(float(np.sum((e / noise) ** 2)) for e in self.misfit(theta, sections))
            mean, weight = self.prior(sections)
            cost = 0.5 * (data + float(np.sum((theta - mean) ** 2 * weight)))
        return cost if np.isfinite(cost) else float("inf")

    def _possible(self, theta: Array) -> bool:
        if not self._couplings:
            return True
        p = self._parameters(theta)
        inertia = np.diag(p[[self.names.index(k) for k in self.masses]])
        for i, j, at in self._couplings:
            inertia[i, j] = inertia[j, i] = p[at]
        return bool(np.linalg.eigvalsh(inertia)[0] > 0)

    def prior(self, sections: tuple[Section, ...]) -> tuple[Array, Array]:
        """Return the mean of θ before the log is known, and the weight 1/σ² of each entry.

        The prior holds unobservable entries near their start: unchanged parameters, initial thrust as commanded.
        """
        weight = np.full(self.order, _LOOSE**-2.0)
        weight[_THRUST] = self.thrust**-2.0
        weight = np.concatenate([weight, np.tile((_DRIFT * self.thrust) ** -2.0, (self.local - self.order) // 4)])
        return self.begin(sections), np.concatenate([np.full(self.size, _PRIOR**-2.0), np.tile(weight, len(sections))])

    def slopes(self, theta: Array, noise: Array, sections: tuple[Section, ...]) -> list[tuple[Array, Array]]:
        """Return for each section the residuals (n, c) and their derivatives (n, c, p + local), divided by the noise.

        The derivatives are those by the parameters and by the section's own entries of θ; where no measurement
        exists, both are 0.
        """
        results: dict[int, tuple[Array, Array]] = {}
        states = self.states(theta, sections)
        for group in _groups(sections):
            chosen = tuple(sections[k] for k in group)
            p = self._rows(theta, sections, only=group)
            over_x, over_p = self._sensitivities([(sections[k], states[k]) for k in group], p)
            for k, rows in zip(group, self._propagated(chosen, over_x, over_p), strict=True):
                present = self.present[sections[k].rows]
                left = self._difference(sections[k], states[k]) / noise
                results[k] = (left, np.where(present[:, :, None], rows / noise[:, None], 0.0))
        return [results[k] for k in range(len(sections))]

    def _parameters(self, theta: Array) -> Array:
        # the fitted parameters, then the other entries of the plant's parameter vector
        return np.concatenate([self.start + self.scale * theta[: self.size], self._known])

    def _rows(self, theta: Array, sections: tuple[Section, ...], only: Sequence[int] | None = None) -> Array:
        # the parameters of each step of some sections, by default of all
        p = self._parameters(theta)
        chosen = range(len(sections)) if only is None else only
        rows = np.tile(p, (sum(len(sections[k].dt) for k in chosen), 1))
        if self.drift:
            own = theta[self.size :].reshape(-1, self.local)[:, self.order :]
            force = [own[k, :4] + np.outer(_through(sections[k]), own[k, 4:]) for k in chosen]
            rows[:, self._force] += np.vstack(force)
        return rows

    def _initial(self, theta: Array, sections: tuple[Section, ...]) -> Array:
        return theta[self.size : self.size + self.local * len(sections)].reshape(-1, self.local)[:, : self.order]

    def _sensitivities(self, parts: list[tuple[Section, Array]], p: Array) -> tuple[list[Array], list[Array]]:
        """Return ∂x⁺/∂x (m, s, s) and ∂x⁺/∂θ (m, s, p) of each step, with drift (m, s, p + 8) of each section.

        Within a step, the derivatives of the rate are those in its middle, so the results have second order in dt.
        """
        x = np.vstack([(states[:-1] + states[1:]) / 2 for _, states in parts])
        thrust, dt = np.vstack([s.thrust for s, _ in parts]), np.concatenate([s.dt for s, _ in parts])
        rate_x, rate_p = self._slope(x, thrust, p)
        if self.drift:
            force = rate_p[:, :, self._force]
            through = np.concatenate([_through(s) for s, _ in parts])[:, None, None]
            rate_p = np.concatenate([rate_p * self.scale, force, force * through], axis=-1)
        else:
            rate_p *= self.scale
        rate_x *= dt[:, None, None]
        rate_p *= dt[:, None, None]
        half = rate_x @ rate_x / 2
        over_x = np.eye(self.order) + rate_x + half + half @ rate_x / 3
        integral = np.eye(self.order) + rate_x / 2 + half / 3
        cuts = np.cumsum([len(s.dt) for s, _ in parts])[:-1]
        return np.split(over_x, cuts), np.split(integral @ rate_p, cuts)

    def _propagated(self, sections: tuple[Section, ...], over_x: list[Array], over_p: list[Array]) -> list[Array]:
        # derivatives (n, c, p + local) of the motion at the rows of each section, all sections at the same time
        order, states = sorted(range(len(sections)), key=lambda k: -len(sections[k].dt)), self.order
        longest, size = len(sections[order[0]].dt), self.size + self.local
        here = np.zeros((len(order), states, size))
        here[:, :, self.size : self.size + states] = np.eye(states)
        stack_x, stack_p = (np.zeros((longest, len(order), states, width)) for width in (states, size - states))
        for place, k in enumerate(order):
            stack_x[: len(over_x[k]), place], stack_p[: len(over_p[k]), place] = over_x[k], over_p[k]
        lengths = np.array([len(sections[k].dt) for k in order])
        active = np.sum(lengths[:, None] > np.arange(longest), axis=0).tolist()
        history = np.empty((longest + 1, len(order), len(self.columns), size))
        history[0] = here[:, self.outputs]
        for m in range(longest):
            n = active[m]
            here[:n] = stack_x[m, :n] @ here[:n]
            here[:n, :, : self.size] += stack_p[m, :n, :, : self.size]
            if self.drift:
                here[:n, :, self.size + states :] += stack_p[m, :n, :, self.size :]
            history[m + 1] = here[:, self.outputs]
        return [history[sections[k].at, order.index(k)] for k in range(len(sections))]


def _through(section: Section) -> Array:
    # (m,) the middle of each step, from −1 at the start of the section to 1 at its end
    end = np.cumsum(section.dt)
    return np.asarray(2.0 * (end - section.dt / 2) / end[-1] - 1.0)


def _groups(sections: tuple[Section, ...]) -> list[list[int]]:
    # sections whose sensitivities fit in memory together
    groups: list[list[int]] = [[]]
    for k, section in enumerate(sections):
        if groups[-1] and sum(len(sections[j].dt) for j in groups[-1]) + len(section.dt) > _AT_ONCE:
            groups.append([])
        groups[-1].append(k)
    return groups


def _unlimited(vehicle: Vehicle) -> Vehicle:
    # the thrust in the log is not limited again
    limits = [k for k in vehicle.parameters if k.endswith(("_max", "_reverse")) and k[0] == "F"]
    changed = {k: replace(vehicle.parameters[k], value=1e12, range=None) for k in limits}
    return replace(vehicle, parameters={**vehicle.parameters, **changed})

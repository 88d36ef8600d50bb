"""The model that is fitted to a log: the simulated motion of each section of the log, and its sensitivities.

A section is a part of the log without a gap, of at most one minute. Each section has its own initial state, so that an
error of the model does not accumulate over the whole log.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.vehicle.dynamics import plant_parameters
from surctl.vehicle.identification.rates import FITTED, places, stepper
from surctl.vehicle.motion_log import MotionLog
from surctl.vehicle.parameters import Parameter, Vehicle
from surctl.vehicle.specs import TERMS

__all__ = [
    "CONSTANT_FORCE",
    "FITTED",
    "MASS_OF",
    "Model",
    "Section",
    "axes_of",
    "names_of",
    "sections_of",
    "with_all_constants",
]

CONSTANT_FORCE = ("X0", "Y0", "Z0", "N0")
"""Constant force on the vehicle along its own axes [N] and constant yaw moment [N m]: net buoyancy, trim, a tether."""

MASS_OF = dict(zip(FITTED[4:12], 2 * FITTED[:4], strict=True))
"""The mass on the axis of each drag parameter."""

_STEP = 0.05  # [s] integration step
_STEPS_PER_ROW, _LONGEST_STEP = 5, 0.2  # of a log with few rows per second, whose steps are longer; and their limit [s]
_LEAST_LAG = 0.02  # [s] smallest thrust lag; a smaller one would need shorter integration steps
_PRIOR = 2.0  # prior standard deviation of the relative change of a parameter
_LOOSE = 1e3  # [m, rad, m/s, rad/s] prior standard deviation of the motion at the start of a section
_GAP, _GAP_FACTOR = 0.5, 5.0  # a gap is longer than this [s] and than this many median periods
_LONGEST = 60.0  # [s] longest section
_LEAST_ROWS = 20  # rows of a section
_AT_ONCE = 60_000  # integration steps whose sensitivities are in memory at the same time
_COUPLING = 0.1  # scale of a coupling whose start value is 0, as a share of the parameters on the axes

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


def sections_of(log: MotionLog) -> tuple[Section, ...]:
    """Return the sections of a log that have enough rows with motion.

    Raises:
        InputError: no part of the log between its gaps is long enough.
    """
    step = np.diff(log.time)
    gap = step > max(_GAP, _GAP_FACTOR * float(np.median(step)))
    sections = []
    for start, stop in _runs(gap, len(log.time)):
        duration = float(log.time[stop - 1] - log.time[start])
        parts = max(int(np.ceil(duration / _LONGEST)), 1)
        cuts = np.searchsorted(log.time[start:stop], log.time[start] + duration * np.arange(parts + 1) / parts)
        cuts[-1] = stop - start
        for one, other in zip(start + cuts[:-1], start + cuts[1:], strict=True):
            if other - one >= _LEAST_ROWS and np.isfinite(log.motion[one:other]).any():
                sections.append(_section(log, int(one), int(other)))
    if not sections:
        raise InputError(
            f"has no part of {_LEAST_ROWS} rows without a gap",
            file=log.source,
            key="t_s",
            remedy=f"give a log without a gap of more than {max(_GAP, _GAP_FACTOR * float(np.median(step))):.3g} s",
        )
    return tuple(sections)


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

    θ contains the changes of the parameters `names`, in units of `scale`, and for each section the motion (8,) and the
    thrust (4,) at its start.
    """

    def __init__(self, log: MotionLog, start: Vehicle, sections: tuple[Section, ...]) -> None:
        self.log, self.sections = log, sections
        whole = with_all_constants(start)
        self.names = names_of(whole)
        self.thrust = np.abs(start.thrust_range).max(axis=0)
        self.thrust[self.thrust == 0.0] = 1.0
        self.start = np.array([whole[k] for k in self.names])
        self.scale = np.array([_scale(whole, k, self.thrust) for k in self.names])
        self.present = np.isfinite(log.motion)
        self._step, self._slope = stepper(whole.form, self.names)
        flat = plant_parameters(_unlimited(whole))
        self._known = flat[places(whole.form, self.names)[1]]
        # masses are positive; an estimate of a drag may be negative, otherwise its interval would be wrong
        self.low = np.full(len(self.names), -np.inf)
        self.low[:4] = -0.95
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
            motion, present = self.log.motion[section.rows], self.present[section.rows]
            first = [motion[p, k][0] if p.any() else 0.0 for k, p in enumerate(present.T)]
            parts += [np.array(first), self.log.thrust[section.rows.start]]
        return np.concatenate(parts)

    def states(self, theta: Array, sections: tuple[Section, ...]) -> list[Array]:
        """Return for each section the simulated states (m + 1, 12) after each integration step."""
        lengths = np.array([len(s.dt) for s in sections])
        total = int(lengths.sum())
        p = self._parameters(theta)
        flag, start, initial = np.zeros((total, 1)), np.zeros((total, 12)), self._initial(theta, sections)
        firsts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        flag[firsts], start[firsts] = 1.0, initial
        thrust, dt = np.vstack([s.thrust for s in sections]), np.concatenate([s.dt for s in sections])
        (after,) = self._step(np.zeros(12), flag, start, thrust, np.broadcast_to(p, (total, len(p))), dt[:, None])
        return [
            np.vstack([begin, after[k : k + n]])
            for k, n, begin in zip(firsts.tolist(), lengths.tolist(), initial, strict=True)
        ]

    def misfit(self, theta: Array, sections: tuple[Section, ...]) -> list[Array]:
        """Return for each section simulated minus measured motion (n, 8); 0 where no measurement exists."""
        return [self._difference(s, x) for s, x in zip(sections, self.states(theta, sections), strict=True)]

    def _difference(self, section: Section, states: Array) -> Array:
        present = self.present[section.rows]
        measured = np.where(present, self.log.motion[section.rows], 0.0)
        return np.where(present, states[section.at, :8] - measured, 0.0)

    def cost(self, theta: Array, noise: Array, sections: tuple[Section, ...]) -> float:
        """Return half the sum of the squared residuals, with the prior; inf if the simulation diverges."""
        with np.errstate(over="ignore", invalid="ignore"):
            data = sum(float(np.sum((e / noise) ** 2)) for e in self.misfit(theta, sections))
            mean, weight = self.prior(sections)
            cost = 0.5 * (data + float(np.sum((theta - mean) ** 2 * weight)))
        return cost if np.isfinite(cost) else float("inf")

    def prior(self, sections: tuple[Section, ...]) -> tuple[Array, Array]:
        """Return the mean of θ before the log is known, and the weight 1/σ² of each entry.

        The prior holds unobservable entries near their start: unchanged parameters, initial thrust as commanded.
        """
        weight = np.concatenate([np.full(8, _LOOSE**-2.0), self.thrust**-2.0])
        return self.begin(sections), np.concatenate([np.full(self.size, _PRIOR**-2.0), np.tile(weight, len(sections))])

    def slopes(self, theta: Array, noise: Array, sections: tuple[Section, ...]) -> list[tuple[Array, Array]]:
        """Return for each section the residuals (n, 8) and their derivatives (n, 8, p + 12), divided by the noise.

        The derivatives are those by the parameters and by the initial state of the section; where no measurement
        exists, both are 0.
        """
        p = self._parameters(theta)
        results: dict[int, tuple[Array, Array]] = {}
        states = self.states(theta, sections)
        for group in _groups(sections):
            over_x, over_p = self._sensitivities([(sections[k], states[k]) for k in group], p)
            for k, rows in zip(group, self._propagated([sections[k] for k in group], over_x, over_p), strict=True):
                present = self.present[sections[k].rows]
                left = self._difference(sections[k], states[k]) / noise
                results[k] = (left, np.where(present[:, :, None], rows / noise[:, None], 0.0))
        return [results[k] for k in range(len(sections))]

    def _parameters(self, theta: Array) -> Array:
        # the fitted parameters, then the other entries of the plant's parameter vector
        return np.concatenate([self.start + self.scale * theta[: self.size], self._known])

    def _initial(self, theta: Array, sections: tuple[Section, ...]) -> Array:
        return theta[self.size : self.size + 12 * len(sections)].reshape(-1, 12)

    def _sensitivities(self, parts: list[tuple[Section, Array]], p: Array) -> tuple[list[Array], list[Array]]:
        """Return ∂x⁺/∂x (m, 12, 12) and ∂x⁺/∂θ (m, 12, p) of each step of each section.

        Within a step, the derivatives of the rate are those in its middle, so the results have second order in dt.
        """
        x = np.vstack([(states[:-1] + states[1:]) / 2 for _, states in parts])
        thrust, dt = np.vstack([s.thrust for s, _ in parts]), np.concatenate([s.dt for s, _ in parts])
        rate_x, rate_p = self._slope(x, thrust, np.broadcast_to(p, (len(x), len(p))))
        rate_x *= dt[:, None, None]
        rate_p *= self.scale * dt[:, None, None]
        half = rate_x @ rate_x / 2
        over_x = np.eye(12) + rate_x + half + half @ rate_x / 3
        integral = np.eye(12) + rate_x / 2 + half / 3
        cuts = np.cumsum([len(s.dt) for s, _ in parts])[:-1]
        return np.split(over_x, cuts), np.split(integral @ rate_p, cuts)

    def _propagated(self, sections: list[Section], over_x: list[Array], over_p: list[Array]) -> list[Array]:
        # derivatives (n, 8, p + 12) of the motion at the rows of each section, all sections at the same time
        order = sorted(range(len(sections)), key=lambda k: -len(sections[k].dt))
        longest, size = len(sections[order[0]].dt), self.size + 12
        here = np.zeros((len(order), 12, size))
        here[:, :, self.size :] = np.eye(12)
        stack_x, stack_p = np.zeros((longest, len(order), 12, 12)), np.zeros((longest, len(order), 12, self.size))
        for place, k in enumerate(order):
            stack_x[: len(over_x[k]), place], stack_p[: len(over_p[k]), place] = over_x[k], over_p[k]
        active = [sum(len(sections[k].dt) > m for k in order) for m in range(longest)]
        history = np.empty((longest + 1, len(order), 8, size))
        history[0] = here[:, :8]
        for m in range(longest):
            n = active[m]
            here[:n] = stack_x[m, :n] @ here[:n]
            here[:n, :, : self.size] += stack_p[m, :n]
            history[m + 1] = here[:, :8]
        return [history[sections[k].at, order.index(k)] for k in range(len(sections))]


def _groups(sections: tuple[Section, ...]) -> list[list[int]]:
    # sections whose sensitivities fit in memory together
    groups: list[list[int]] = [[]]
    for k, section in enumerate(sections):
        if groups[-1] and sum(len(sections[j].dt) for j in groups[-1]) + len(section.dt) > _AT_ONCE:
            groups.append([])
        groups[-1].append(k)
    return groups


def with_all_constants(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with all constant forces as terms; those that it does not have are 0."""
    zeros = {k: Parameter(0.0, TERMS[k].unit, None, "") for k in CONSTANT_FORCE}
    parameters = zeros | dict(vehicle.parameters)
    order = [k for k in (*vehicle.parameters, *CONSTANT_FORCE) if k in parameters]
    return replace(vehicle, parameters={k: parameters[k] for k in dict.fromkeys(order)})


def names_of(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of all parameters of a vehicle that are fitted: equation (3), couplings, constant force.

    A vehicle without thrust lag keeps a lag of 0.
    """
    couplings = [k for k in vehicle.form.terms if TERMS[k].table in ("inertia", "drag")]
    lagged = vehicle["thrust_lag"] > 0
    return (*(k for k in FITTED if k != "thrust_lag" or lagged), *couplings, *CONSTANT_FORCE)


def axes_of(name: str) -> frozenset[str]:
    """Return the names of the masses on the axes whose motion a mass, drag or coupling needs; none for other names."""
    if name in CONSTANT_FORCE or name == "thrust_lag":
        return frozenset()
    if name[0] == "m":
        return frozenset(f"m{axis}{axis}" for axis in name[1:])
    letters = {"X": 1, "Y": 2, "Z": 3, "N": 4} | dict(zip("uvwr", range(1, 5), strict=True))
    return frozenset(f"m{letters[c]}{letters[c]}" for c in name)


def _scale(vehicle: Vehicle, name: str, thrust: Array) -> float:
    # size of a change of a parameter
    value = abs(vehicle[name])
    if name in CONSTANT_FORCE:
        return float(thrust[CONSTANT_FORCE.index(name)])
    if value > 0:
        return value
    quadratic = {"X": "Xuu", "Y": "Yvv", "Z": "Zww", "N": "Nrr"}
    if name[0] == "m":
        of_axes = np.sqrt(vehicle["m" + 2 * name[1]] * vehicle["m" + 2 * name[2]])
    else:  # a drag whose start value is 0 is scaled by the quadratic drag of its axis
        of_axes = vehicle[quadratic[name[0]]]
    return max(_COUPLING * float(of_axes), 1e-3)


def _unlimited(vehicle: Vehicle) -> Vehicle:
    # the thrust in the log is not limited again
    limits = [k for k in vehicle.parameters if k.endswith(("_max", "_reverse")) and k[0] == "F"]
    changed = {k: replace(vehicle.parameters[k], value=1e12, range=None) for k in limits}
    return replace(vehicle, parameters={**vehicle.parameters, **changed})

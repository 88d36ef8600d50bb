"""The model that is fitted to a log: sections without gaps, simulated motion, drifting force, turns of the heading.

A section is a part of the log without a gap, of at most one minute. Each section has its own initial state, so that an
error of the model does not accumulate over the whole log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.marine.vehicle.dynamics import PLANT_DISTURBANCE, build_plant, plant_layout, plant_parameters, plant_state
from surctl.marine.vehicle.motion_log import LOG_MOTION, LOG_TILT, MotionLog
from surctl.marine.vehicle.parameters import Parameter, Vehicle
from surctl.marine.vehicle.specs import AXES, TERMS, PlantForm
from surctl.system.plant import runge_kutta

FITTED = (
    "m11", "m22", "m33", "m44", "Xu", "Yv", "Zw", "Nr", "Xuu", "Yvv", "Zww", "Nrr", "thrust_lag",
)  # fmt: skip
"""Parameters of equation (3) that can be identified from a log."""

Array = NDArray[np.float64]


class Repeated:
    """A CasADi function evaluated for many columns, as a chain or each column alone; arrays have one row per column."""

    def __init__(self, function: ca.Function, *, chain: bool) -> None:
        self._function, self._chain = function, chain
        self._built: dict[int, ca.Function] = {}

    def __call__(self, *arguments: Array) -> list[Array]:
        """Return the results for arguments with one row per column."""
        count = len(arguments[-1])
        if count not in self._built:
            if len(self._built) > 8:
                self._built.clear()
            self._built[count] = (self._function.mapaccum if self._chain else self._function.map)(count)
        function = self._built[count]
        held = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        results = [np.empty((count, function.nnz_out(k) // count)) for k in range(function.n_out())]
        buffer, evaluate = function.buffer()
        for k, argument in enumerate(held):
            buffer.set_arg(k, memoryview(argument))  # type: ignore[call-arg, arg-type]  # the stubs lack this form
        for k, result in enumerate(results):
            buffer.set_res(k, memoryview(result))  # type: ignore[call-arg, arg-type]  # likewise
        evaluate()
        return results


class Slope:
    """The derivatives of the rate by the state x and by the parameters p, of which CasADi computes the nonzeros."""

    def __init__(self, inputs: list[ca.SX], slopes: list[ca.SX]) -> None:
        self._places = [(slope.sparsity().row(), slope.sparsity().get_col()) for slope in slopes]
        self._widths = [slope.shape[1] for slope in slopes]
        nonzeros = [slope[slope.sparsity().find()] for slope in slopes]
        both = ca.SX.sym("all", inputs[2].numel() + inputs[3].numel())
        split = ca.vertsplit(both, [0, inputs[2].numel(), both.numel()])
        alone = ca.Function("alone", inputs, nonzeros)
        whole = ca.Function("slope", [*inputs[:2], both], list(alone(*inputs[:2], *split)), {"cse": True})
        self._nonzeros = Repeated(whole, chain=False)

    def __call__(self, x: Array, thrust: Array, p: Array) -> tuple[Array, Array]:
        """Return the derivatives by x (m, s, s) and by p (m, s, k) at m states."""
        over_x, over_p = (np.zeros((len(x), x.shape[1], width)) for width in self._widths)
        for full, flat, (rows, columns) in zip(
            (over_x, over_p), self._nonzeros(x, thrust, p), self._places, strict=True
        ):
            full[:, rows, columns] = flat
        return over_x, over_p


def _places(form: PlantForm, names: tuple[str, ...]) -> tuple[list[int], list[int]]:
    """Return the places of the fitted parameters in the plant's parameter vector, and the places of all others."""
    layout = plant_layout(form)
    at = {k: layout.slice("thrust_lag").start for k in ("thrust_lag",)}
    for port, keys in (("mass", FITTED[:4]), ("linear_drag", FITTED[4:8]), ("quadratic_drag", FITTED[8:12])):
        at |= {k: layout.slice(port).start + j for j, k in enumerate(keys)}
    at |= {k: layout.slice("terms").start + j for j, k in enumerate(form.terms)}
    fitted = [at[k] for k in names]
    return fitted, [k for k in range(layout.size) if k not in fitted]


@cache
def stepper(form: PlantForm, names: tuple[str, ...]) -> tuple[Repeated, Slope]:
    """Return one integration step (RK4) of the plant in still water, and the slopes of the rate.

    From the state x (s,), a flag and an initial state (s,) that replaces x if the flag is 1, thrust (4,), p and dt, the
    step returns the next state. The vector p holds the parameters `names`, then the other entries of the plant's
    parameter vector. The slopes are those by x and by the parameters `names`.
    """
    fitted, others = _places(form, names)
    order = plant_state(form).size
    x, thrust, dt = ca.SX.sym("x", order), ca.SX.sym("thrust", 4), ca.SX.sym("dt")
    p, known = ca.SX.sym("p", len(fitted)), ca.SX.sym("known", len(others))
    entries = dict(zip((*fitted, *others), (*ca.vertsplit(p), *ca.vertsplit(known)), strict=True))
    plant = ca.vertcat(*(entries[k] for k in range(len(entries))))
    ode = build_plant(form).ode

    def rate(state: ca.SX) -> ca.SX:
        return ode(state, thrust, ca.DM.zeros(PLANT_DISTURBANCE.size), plant)

    following = runge_kutta(lambda state, _: rate(state), x, dt)
    after = ca.Function("after", [x, thrust, p, known, dt], [following], {"cse": True})
    flag, begin = ca.SX.sym("flag"), ca.SX.sym("begin", order)
    chosen = ca.if_else(flag > 0, begin, x)
    both = ca.vertcat(p, known)
    inputs = [x, flag, begin, thrust, ca.SX.sym("all", both.numel()), dt]
    step = ca.Function(
        "step",
        inputs,
        [after(chosen, thrust, *ca.vertsplit(inputs[4], [0, len(fitted), both.numel()]), dt)],
        {"cse": True},
    )
    return Repeated(step, chain=True), Slope([x, thrust, p, known], [ca.jacobian(rate(x), x), ca.jacobian(rate(x), p)])


CONSTANT_FORCE = ("X0", "Y0", "Z0", "N0")
"""Constant force on the vehicle along its own axes [N] and constant yaw moment [N m]: net buoyancy, trim, a tether."""

CENTRE = ("xg", "yg", "zg")
"""Centre of gravity of a vehicle that rolls and pitches. Weight, buoyancy and centre of buoyancy are not fitted: a log
shows only the moment of both forces, i.e. the distance of the two centres, and the net buoyancy, which is Z0."""

OFFSETS = (*CONSTANT_FORCE, *CENTRE)
"""Parameters that may be 0 and are then no term of the vehicle."""

_MASSES = dict(zip("uvwrpq", (*FITTED[:4], "mpp", "mqq"), strict=True))
_OF_LETTER = _MASSES | dict(zip("XYZNKM", _MASSES.values(), strict=True)) | dict(zip("1234", FITTED[:4], strict=True))

MASS_OF = dict(zip(FITTED[4:12], 2 * FITTED[:4], strict=True)) | {
    "Kp": "mpp", "Kpp": "mpp", "Mq": "mqq", "Mqq": "mqq",
}  # fmt: skip
"""The mass on the axis of each drag parameter that acts against its own axis."""

AXIS_OF = dict(zip(_MASSES.values(), AXES, strict=True))
"""The name of the axis of each mass."""

_COUPLING = 0.1  # scale of a coupling whose start value is 0, as a share of the parameters on the axes
_CENTRE = 0.2  # scale of a distance from the origin, as a share of the radius of the hull


def _offsets(vehicle: Vehicle) -> tuple[str, ...]:
    return OFFSETS if vehicle.form.tilts else CONSTANT_FORCE


def with_all_constants(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with all offsets as terms; those that it does not have are 0."""
    zeros = {k: Parameter(0.0, TERMS[k].unit, None, "") for k in _offsets(vehicle)}
    parameters = zeros | dict(vehicle.parameters)
    order = [k for k in (*vehicle.parameters, *zeros) if k in parameters]
    return replace(vehicle, parameters={k: parameters[k] for k in dict.fromkeys(order)})


def names_of(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of all parameters of a vehicle that are fitted: equation (3), couplings, offsets.

    A vehicle without thrust lag keeps a lag of 0.
    """
    couplings = [k for k in vehicle.form.terms if TERMS[k].table in ("inertia", "drag")]
    lagged = vehicle["thrust_lag"] > 0
    return (*(k for k in FITTED if k != "thrust_lag" or lagged), *couplings, *_offsets(vehicle))


def axes_of(name: str) -> frozenset[str]:
    """Return the names of the masses on the axes whose motion a mass, drag or coupling needs; none for other names."""
    if name in OFFSETS or name == "thrust_lag":
        return frozenset()
    return frozenset(_OF_LETTER[c] for c in name.removeprefix("m"))


def _scale_of(vehicle: Vehicle, name: str, thrust: Array) -> float:
    """Return the size of a change of a parameter, in its SI unit; `thrust` (4,) is the largest on each axis."""
    value = abs(vehicle[name])
    if name in CONSTANT_FORCE:
        return float(thrust[CONSTANT_FORCE.index(name)])
    if name in CENTRE:
        return max(value, _CENTRE * vehicle["radius"])
    if value > 0:
        return value
    if name[0] == "m":
        one, other = (_OF_LETTER[c] for c in name[1:])
        of_axes = np.sqrt(vehicle[one] * vehicle[other])
    else:  # a drag whose start value is 0 is scaled by the quadratic drag of its axis, or its linear drag
        mass = _OF_LETTER[name[0]]
        of_axes = max(abs(vehicle[k]) for k, axis in MASS_OF.items() if axis == mass and k in vehicle.parameters)
    return max(_COUPLING * float(of_axes), 1e-3)


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


@dataclass(frozen=True, eq=False)
class LogSection:
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

    def part(self, first: int, rows: int) -> LogSection:
        """Return at most `rows` rows of the section from the row `first` on."""
        at = self.at[first : first + rows]
        steps = slice(int(at[0]), int(at[-1]))
        start = self.rows.start + first
        return LogSection(slice(start, start + len(at)), self.dt[steps], self.thrust[steps], at - at[0])


def sections_of(log: MotionLog, *, longest: float = LONGEST) -> tuple[LogSection, ...]:
    """Return the sections of a log that have enough rows with motion, each of at most `longest` seconds."""
    step = np.diff(log.time)
    ends = (np.flatnonzero(step > max(_GAP, _GAP_FACTOR * float(np.median(step)))) + 1).tolist()
    sections = []
    for start, stop in zip([0, *ends], [*ends, len(log.time)], strict=True):
        duration = float(log.time[stop - 1] - log.time[start])
        parts = max(int(np.ceil(duration / longest)), 1)
        cuts = np.searchsorted(log.time[start:stop], log.time[start] + duration * np.arange(parts + 1) / parts)
        cuts[-1] = stop - start
        for one, other in zip(start + cuts[:-1], start + cuts[1:], strict=True):
            if other - one >= _LEAST_ROWS and np.isfinite(log.motion[one:other]).any():
                sections.append(_section(log, int(one), int(other)))
    period = float(np.median(step))
    if not sections and (_LEAST_ROWS - 1) * period > longest:
        problem = f"has rows {period:.3g} s apart (median); a fit needs {_LEAST_ROWS} rows in {longest:g} s"
        remedy = "is the time in ms? name the column t_ms, or set log.time_unit in the map"
        raise InputError(problem, file=log.source, key="t_s", remedy=remedy)
    if not sections:
        remedy = f"give a log without a gap of more than {max(_GAP, _GAP_FACTOR * period):.3g} s"
        raise InputError(f"has no part of {_LEAST_ROWS} rows without a gap", file=log.source, key="t_s", remedy=remedy)
    return tuple(sections)


def drift_sections_of(log: MotionLog) -> tuple[LogSection, ...]:
    """Return the sections of a log, each with a constant force of its own: of 20 s, or longer if they have few rows."""
    rows = 2 * _LEAST_ROWS  # a part that is a little longer than this is halved
    longest = max(_LONGEST_DRIFT, rows * float(np.median(np.diff(log.time))))
    return sections_of(log, longest=longest)


def _section(log: MotionLog, start: int, stop: int) -> LogSection:
    step = np.diff(log.time[start:stop])
    longest = min(max(_STEP, float(np.median(step)) / _STEPS_PER_ROW), _LONGEST_STEP)
    parts = np.maximum(np.ceil(step / longest - 1e-9).astype(int), 1)
    return LogSection(
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

    def __init__(
        self, log: MotionLog, start: Vehicle, sections: tuple[LogSection, ...], *, drift: bool = False
    ) -> None:
        self.log, self.sections, self.drift = log, sections, drift
        whole = with_all_constants(start)
        self.names = names_of(whole)
        self.masses = tuple(_MASSES.values())[: 6 if whole.form.tilts else 4]  # and moments of inertia, on the axes
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
        self.scale = np.array([_scale_of(whole, k, self.thrust) for k in self.names])
        self.present = np.isfinite(self.motion)
        self._couplings = [(i, j, self.names.index(k)) for i, j, k in whole.form.inertia() if i != j]
        self._step, self._slope = stepper(whole.form, self.names)
        flat = plant_parameters(_unlimited(whole))
        self._known = flat[_places(whole.form, self.names)[1]]
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

    def begin(self, sections: tuple[LogSection, ...]) -> Array:
        """Return θ with unchanged parameters, and each section's first measured motion and first command."""
        parts = [np.zeros(self.size)]
        for section in sections:
            motion, present = self.motion[section.rows], self.present[section.rows]
            state = np.zeros(self.order)
            state[self.outputs] = [motion[p, k][0] if p.any() else 0.0 for k, p in enumerate(present.T)]
            state[_THRUST] = self.log.thrust[section.rows.start]
            parts.append(np.pad(state, (0, self.local - self.order)))
        return np.concatenate(parts)

    def states(self, theta: Array, sections: tuple[LogSection, ...]) -> list[Array]:
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

    def misfit(self, theta: Array, sections: tuple[LogSection, ...]) -> list[Array]:
        """Return for each section simulated minus measured motion (n, c); 0 where no measurement exists."""
        return [self._difference(s, x) for s, x in zip(sections, self.states(theta, sections), strict=True)]

    def _difference(self, section: LogSection, states: Array) -> Array:
        present = self.present[section.rows]
        measured = np.where(present, self.motion[section.rows], 0.0)
        return np.where(present, states[section.at][:, self.outputs] - measured, 0.0)

    def turned_back(self, theta: Array, sections: tuple[LogSection, ...]) -> Array:
        """Return θ with whole turns added to the headings at the start of sections, so that they fit best."""
        turned = theta.copy()
        own = turned[self.size :].reshape(-1, self.local)
        for k, (section, error) in enumerate(zip(sections, self.misfit(theta, sections), strict=True)):
            present = self.present[section.rows][:, _HEADING]
            if present.any():
                own[k, _HEADING] -= 2.0 * np.pi * np.round(error[present, _HEADING].mean() / (2.0 * np.pi))
        return turned

    def cost(self, theta: Array, noise: Array, sections: tuple[LogSection, ...]) -> float:
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

    def prior(self, sections: tuple[LogSection, ...]) -> tuple[Array, Array]:
        """Return the mean of θ before the log is known, and the weight 1/σ² of each entry.

        The prior holds unobservable entries near their start: unchanged parameters, initial thrust as commanded.
        """
        weight = np.full(self.order, _LOOSE**-2.0)
        weight[_THRUST] = self.thrust**-2.0
        weight = np.concatenate([weight, np.tile((_DRIFT * self.thrust) ** -2.0, (self.local - self.order) // 4)])
        return self.begin(sections), np.concatenate([np.full(self.size, _PRIOR**-2.0), np.tile(weight, len(sections))])

    def slopes(self, theta: Array, noise: Array, sections: tuple[LogSection, ...]) -> list[tuple[Array, Array]]:
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

    def _rows(self, theta: Array, sections: tuple[LogSection, ...], only: Sequence[int] | None = None) -> Array:
        # the parameters of each step of some sections, by default of all
        p = self._parameters(theta)
        chosen = range(len(sections)) if only is None else only
        rows = np.tile(p, (sum(len(sections[k].dt) for k in chosen), 1))
        if self.drift:
            own = theta[self.size :].reshape(-1, self.local)[:, self.order :]
            force = [own[k, :4] + np.outer(_through(sections[k]), own[k, 4:]) for k in chosen]
            rows[:, self._force] += np.vstack(force)
        return rows

    def _initial(self, theta: Array, sections: tuple[LogSection, ...]) -> Array:
        return theta[self.size : self.size + self.local * len(sections)].reshape(-1, self.local)[:, : self.order]

    def _sensitivities(self, parts: list[tuple[LogSection, Array]], p: Array) -> tuple[list[Array], list[Array]]:
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

    def _propagated(self, sections: tuple[LogSection, ...], over_x: list[Array], over_p: list[Array]) -> list[Array]:
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


def _through(section: LogSection) -> Array:
    # (m,) the middle of each step, from −1 at the start of the section to 1 at its end
    end = np.cumsum(section.dt)
    return np.asarray(2.0 * (end - section.dt / 2) / end[-1] - 1.0)


def _groups(sections: tuple[LogSection, ...]) -> list[list[int]]:
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

"""The linear loop of a law about a straight cruise, for many vehicles, gains and speeds at once; delay margins.

The law that runs is differentiated: the derivatives of its list of instructions about the cruise are one expression of
its parameters, which is evaluated at all points together. The plant is continuous, with thrust lag; thrust commands are
held over a control period and computed one period before they act. All quantities are deviations from a cruise along x
at the speed U, far from the ends of the path, obstacles and walls.

A state of the law belongs to the loop if the measurements change it and it changes the thrust. An axis that the law
leaves alone (heave without heave force), and a coordinate that changes nothing, do not belong to the loop.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.ir.symbolic import on_columns
from surctl.marine.control import PATH_FOLLOWING, Gains, Law, build_law, law_source, load_gains
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import Path
from surctl.marine.vehicle import PLANT_PARAMETERS, PlantForm, Vehicle, plant_parameters
from surctl.marine.vehicle.linearise import STATE_NAMES, TILT_NAMES, check_cruise, plant_jacobians
from surctl.system.linear_loop import LinearLoop, LoopNames, delayed, eigenvalues
from surctl.verification.loops import BrokenLoop, LoopMargins, crossings_of, delays_of, margins_from, state_blocks

Array = NDArray[np.float64]

THRUSTS, POSE = ("surge", "sway", "heave", "yaw"), STATE_NAMES[:4]
"""Signals at which loops are opened: the thrust commands, and the measured x, y, z, ψ."""

LOOP_NAMES = (*THRUSTS, "along_track", "cross_track", "depth", "heading")

LINEAR_GAINS = ("k1", "k2", "k_psi", "k_r", "k_v", "lookahead")

TRACKING_LAW = "guarded"
"""A law whose loop about a straight cruise is that of every law for which `has_cruise_loop` holds."""

FAR = 1e6  # [m]
_PATH = Path(np.array([[-FAR, 0.0], [FAR, 0.0]]))
_SITE = (-2 * FAR, 2 * FAR, -2 * FAR, 2 * FAR)
COUPLED = 1e-9  # largest derivative that counts as none
NEUTRAL = 1e-4  # the same for x and y, as a share of the larger: the heading of a run is not exact
_HEADROOM = 1.5  # speed cap over the cruise speed: the cap must not act in a cruise
AXES = len(THRUSTS)
_EDGE = 1e-9  # [1/s] a pole this near to the imaginary axis counts as on it
_DEADBEAT = 1e-9  # least modulus of a pole z: a signal that is gone after a period has the pole z = 0


def has_cruise_loop(law: str, guidance: str) -> bool:
    """Return whether a law with a guidance tracks a straight cruise with the loop that `LINEAR_GAINS` determine.

    Guidance with an internal state has gains of its own.
    """
    return guidance == "los" and PATH_FOLLOWING in law_source(law).parts


@dataclass(frozen=True, eq=False)
class CruiseLoop(LinearLoop):
    """The linear loop of a cruise; a leading axis of the matrices holds several loops.

    The commands are the thrusts [N, N m], the outputs x, y, z, ψ, u, v, w, r. The thrust commands that wait are the
    last states of the law.

    Attributes:
        direct: the law without delay, with matrices as in `law`.
        delay: whole periods between a measurement and its thrust.
    """

    direct: tuple[Array, ...] = field(kw_only=True)
    delay: int = field(kw_only=True)

    @classmethod
    def of(
        cls, plant: tuple[Array, ...], direct: tuple[Array, ...], names: LoopNames, dt: float | Array, delay: int = 1
    ) -> CruiseLoop:
        """Return the loop of a plant and a law without delay, whose states are the first in `names`.

        `dt` is the control period [s], a number or (…).
        """
        late = [f"late_{axis}" for _ in range(delay) for axis in names.commands]
        names = replace(names, controller_states=(*names.controller_states[: direct[0].shape[-1]], *late))
        return cls(plant, delayed(direct, delay), names, dt, direct=direct, delay=delay)  # type: ignore[arg-type]

    def __getitem__(self, chosen: int | NDArray[np.intp] | NDArray[np.bool_] | None) -> CruiseLoop:
        """Return the loops at indices of the leading axis; None adds a leading axis."""
        plant, law, direct = (tuple(m[chosen] for m in part) for part in (self.plant, self.law, self.direct))
        return replace(self, plant=plant, law=law, direct=direct)

    def resampled(self, dt: float | Array, delay: int = 1) -> CruiseLoop:
        """Return the loop at another control period [s], over which the law's state changes in proportion."""
        return CruiseLoop.of(self.plant, _at_period(self.direct, np.asarray(dt) / self.dt), self.names, dt, delay)

    @cached_property
    def rates(self) -> NDArray[np.complex128]:
        """The closed-loop poles (…, n) as continuous rates s = ln(z)/dt [rad/s], the slowest first."""
        closed = self.transition
        z = np.linalg.eigvals(closed).astype(complex) if closed.ndim == 2 else eigenvalues(closed)
        poles = np.log(np.where(np.abs(z) < _DEADBEAT, _DEADBEAT, z)) / np.asarray(self.dt)[..., None]
        return np.take_along_axis(poles, np.argsort(-poles.real, axis=-1, kind="stable"), axis=-1)

    @property
    def decays(self) -> NDArray[np.bool_]:
        """Whether every closed-loop pole decays, (…)."""
        return np.asarray(self.rates[..., 0].real < -_EDGE)

    @property
    def stable(self) -> bool:
        """Whether every closed-loop pole of every loop decays."""
        return bool(self.decays.all())


def cruise_loop(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    law: str = TRACKING_LAW,
) -> CruiseLoop:
    """Return the loop of a plant and a law, linearised at the cruise speed.

    Args:
        vehicle: the plant.
        gains: the gains by name; those of `LINEAR_GAINS` must be among them, and k_i [1/s²] for integral action.
        cruise: cruise speed U [m/s], > 0.
        dt: control period [s], > 0.
        model: the controller's model of the vehicle; default the vehicle itself.
        law: a law for which `has_cruise_loop` holds.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot cruise at that speed or has no sway force.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import cruise_loop
        >>> loop = cruise_loop(load_vehicle("sur400"), load_gains("default").values, cruise=0.15, dt=0.05)
        >>> loop.stable, loop.transition.shape, round(float(loop.rates.real.max()), 2)
        (True, (16, 16), -0.22)
    """
    check_positive({"cruise": np.atleast_1d(cruise)})
    for craft in (vehicle, model or vehicle):
        if not craft["Fv_max"] > 0:
            problem = f"the law moves in any direction, but {craft.name} has no sway force"
            raise InputError(problem, key="Fv_max", value=craft["Fv_max"], remedy="use law_loop with the law steered")
    check_cruise(vehicle, cruise)
    known = {name: float(value) for name, value in gains.items()}
    return cruise_loops([vehicle], known, cruise=cruise, dt=dt, model=model or vehicle, law=law)[0]


def cruise_loops(
    plants: Sequence[Vehicle] | Array,
    gains: Mapping[str, ArrayLike],
    *,
    cruise: ArrayLike,
    dt: float,
    model: Vehicle,
    believed: Array | None = None,
    law: str = TRACKING_LAW,
    form: PlantForm | None = None,
) -> CruiseLoop:
    """Build the loops of n points at once; see `cruise_loop`.

    All n loops must have the same order: all or none have thrust lag, and all or none have integral action.

    Args:
        plants: n vehicles with equal optional terms, or (n, …) plant parameters in the order of `plant_parameters`; the
            caller must check that the thrust of each plant suffices for the cruise speed.
        gains: the gains by name, each a number or (n,).
        cruise: cruise speed U [m/s], a number or (n,).
        dt: control period [s].
        model: the controller's model.
        believed: (n, …) parameters of the controller's model where they differ from those of `model`.
        law: a law for which `has_cruise_loop` holds.
        form: the optional terms that all plants have; default: those of the vehicles in `plants`, or of the model.

    Raises:
        InputError: a gain is missing or not positive, or the loops have different orders.
    """
    if isinstance(plants, np.ndarray):
        plant, form = plants, form or model.form
    else:
        plant, form = np.array([plant_parameters(each) for each in plants]), form or plants[0].form
    values = {name: np.asarray(value, dtype=float) for name, value in gains.items()}
    (count,) = np.broadcast_shapes((len(plant),), np.shape(cruise), *(v.shape for v in values.values()))
    plant = np.broadcast_to(plant, (count, plant.shape[1]))
    speed = np.broadcast_to(np.asarray(cruise, dtype=float), (count,))
    for name in LINEAR_GAINS:
        if name not in values:
            raise InputError("gain is missing", key=name, remedy=nearest(name, values))
    check_positive({**{name: np.atleast_1d(values[name]) for name in LINEAR_GAINS}, "cruise": speed})
    check_positive({"dt": np.atleast_1d(dt)})
    k_i = np.broadcast_to(values.get("k_i", np.zeros(1)), (count,))
    if not np.all(np.isfinite(k_i) & (k_i >= 0)):
        raise InputError("must be at least 0", key="k_i", value=float(np.min(k_i)), remedy="correct it")
    lag = plant[:, PLANT_PARAMETERS.slice("thrust_lag")][:, 0]
    for key, value in (("thrust_lag", lag), ("k_i", k_i)):
        if np.any(value > 0) != np.all(value > 0):
            remedy = "build them in separate calls: their loops have different orders"
            raise InputError("is 0 at some points and positive at others", key=key, remedy=remedy)
    built = build_law(law)
    Az, By, Cz, D = law_slopes(built, _numbers(built, model, values, speed, believed))
    nu = np.zeros((count, 4))
    nu[:, 0] = speed
    A, B, _ = plant_jacobians(plant, nu, form=form)
    names = (*STATE_NAMES, *TILT_NAMES)
    moving = moving_states(A, np.abs(D).max(axis=(0, 2)) > COUPLED, lagged=bool(lag[0] > 0))
    own = in_loop(Az, By, Cz)
    inner = [port.name for port in built.state.ports for _ in range(port.size)]
    labels = LoopNames(
        "the cruise", built.name, tuple(names[k] for k in moving), tuple(inner[k] for k in own), THRUSTS, THRUSTS,
        STATE_NAMES[:8],
    )  # fmt: skip
    none, outputs = (
        [np.zeros((count, size, 0)) for size in (len(own), AXES, len(moving), 8)],
        np.zeros((8, len(moving))),
    )
    for at, k in enumerate(moving):
        outputs[k : k + 1, at] = 1.0  # no row for thrust and tilt
    C = np.tile(outputs, (count, 1, 1))
    direct = Az[:, own][:, :, own], By[:, own], none[0], Cz[:, :, own], D, none[1]
    matrices = A[:, moving][:, :, moving], B[:, moving], none[2], C, none[3]
    return CruiseLoop.of(matrices, _at_period(direct, np.asarray(dt) / built.dt), labels, dt)


def _at_period(law: tuple[Array, ...], ratio: Array) -> tuple[Array, ...]:
    # the law with a control period that is `ratio` (…) times as long
    Az, By, Br, Cz, D, Dr = law
    eye, ratio = np.eye(Az.shape[-1]), ratio[..., None, None]
    return eye + ratio * (Az - eye), ratio * By, Br, Cz, D, Dr


def moving_states(A: Array, acting: ArrayLike, *, lagged: bool) -> list[int]:
    """Return the places of a plant's states, of A (…, n, n), that belong to the loop.

    Args:
        acting: whether the law commands the thrust of each axis, (4,).
        lagged: whether the thrust lags behind its command.
    """
    acting, tilt = np.asarray(acting), range(len(STATE_NAMES), A.shape[-1])
    # x, y and psi follow the surge, sway and yaw motion; the depth, and heave without coupling, stand alone
    coupled = bool((A[..., [4, 5, 7, *tilt], 6] != 0).any())
    apart = [] if acting[2] else [2] if coupled else [2, 6]
    return [*(k for k in range(8) if k not in apart), *(8 + k for k in range(AXES) if lagged and acting[k]), *tilt]


def _numbers(law: Law, model: Vehicle, gains: Mapping[str, Array], cruise: Array, believed: Array | None) -> Array:
    # (n, …) parameters of the law; a cruise far from everything depends on no gains but those in `gains`
    layout, row = law.gains, law_numbers(model, _some_gains(law.ref), cruise=float(cruise[0]))
    numbers = np.tile(row, (len(cruise), 1))
    own = plant_parameters(model)
    rows = np.tile(own, (len(cruise), 1)) if believed is None else believed
    linear = rows[:, PLANT_PARAMETERS.slice("linear_drag")].copy()
    for axis, name in model.form.ahead():  # as in `Vehicle.drag_at`
        linear[:, axis] += rows[:, PLANT_PARAMETERS.size + model.form.terms.index(name)] * cruise
    limits = PLANT_PARAMETERS.slice("thrust_limit")
    columns: dict[str, Array] = {
        **{name: value for name, value in gains.items() if name in layout},
        "mass": rows[:, PLANT_PARAMETERS.slice("mass")],
        "linear_drag": linear,
        "quadratic_drag": rows[:, PLANT_PARAMETERS.slice("quadratic_drag")],
        "thrust_limit": np.where(rows[:, limits] == own[limits], row[layout.slice("thrust_limit")], rows[:, limits]),
        "cruise": cruise,
        "cap": _HEADROOM * cruise,
    }
    for name, value in columns.items():
        place = numbers[:, layout.slice(name)]
        place[:] = value if value.ndim == 2 else np.broadcast_to(value, (len(cruise),))[:, None]
    return numbers


@cache
def _some_gains(law: str) -> Gains:
    return load_gains("default", own=law_source(law).gains)


def law_numbers(model: Vehicle, gains: Gains, *, cruise: float) -> Array:
    """Return the law's parameters for a straight cruise in the middle of a path without end."""
    return law_parameters(gains, model, path=_PATH, depth=0.0, cruise=cruise, cap=_HEADROOM * cruise, walls=_SITE)


def law_slopes(law: Law, numbers: Array) -> tuple[Array, Array, Array, Array]:
    """Return A, B, C and D of z⁺ = A z + B y and thrust = C z + D y about a cruise, for parameters (n, …) of the law.

    y = (x, y, z, ψ, u, v, w, r); each of the matrices has a leading axis (n,).
    """
    size = law.state.size
    flat = _slopes(law)(numbers.T)[0].T
    J = flat.reshape(len(numbers), size + 8, size + AXES).swapaxes(1, 2)
    return J[:, :size, :size], J[:, :size, size:], J[:, size:, :size], J[:, size:, size:]


@lru_cache(maxsize=8)
def _slopes(law: Law) -> Callable[[Array], list[Array]]:
    # derivatives of the law at a cruise, column by column, as a function of its parameters
    p = ca.SX.sym("p", law.gains.size)
    numbers = ca.SX(p)
    for name, value in (("waypoints", _PATH.slots), ("walls", _SITE), ("depth", 0.0), ("launch", 0.0), ("visit", 0.0)):
        place = law.gains.slice(name)
        numbers[place.start : place.stop] = ca.DM(np.ravel(value, order="C"))
    z, y, start = ca.SX.sym("z", law.state.size), ca.SX.sym("y", 8), law.initial_state()
    cruise = p[law.gains.slice("cruise").start]
    start[law.state.slice("progress")] = FAR  # arc length of the path's middle
    at = ca.SX(ca.DM(start))
    if "surge" in law.state:  # in a cruise, a law that predicts its speed through the water has found it
        at[law.state.slice("surge").start] = cruise
    inputs = ca.SX(ca.DM(law.inputs.pack()))
    for k, name in ((0, "eta"), (4, "nu")):
        place = law.inputs.slice(name)
        inputs[place.start : place.stop] = y[k : k + 4]
    tau, following, *_ = law.function.expand()(z, inputs, numbers)
    whole = ca.jacobian(ca.vertcat(following, tau), ca.vertcat(z, y))
    slopes = ca.Function("slopes", [z, y, p], [ca.densify(whole)])
    about = ca.SX(8, 1)
    about[4] = cruise
    return on_columns(ca.Function("cruise", [p], [ca.vec(slopes(at, about, p))]))


def in_loop(A: Array, B: Array, C: Array) -> list[int]:
    """Return the states of a law, or of any of several, that the measurements reach and that reach the thrust."""
    n = A.shape[-1]
    links = np.abs(A).reshape(-1, n, n).max(axis=0, initial=0.0) > COUPLED
    reached = np.abs(B).reshape(-1, n, B.shape[-1]).max(axis=(0, 2), initial=0.0) > COUPLED
    reaches = np.abs(C).reshape(-1, C.shape[-2], n).max(axis=(0, 1), initial=0.0) > COUPLED
    for _ in range(n):
        reached = reached | (links @ reached)
        reaches = reaches | (links.T @ reaches)
    return [int(k) for k in np.flatnonzero(reached & reaches)]


def check_positive(values: Mapping[str, Array]) -> None:
    """Raise InputError for the first value that is not finite or not greater than 0."""
    for name, entries in values.items():
        wrong = entries[~(np.isfinite(entries) & (entries > 0))]
        if wrong.size:
            raise InputError("must be greater than 0", key=name, value=float(wrong[0]), remedy="correct it")


# One loop at a time


def broken_loops(loops: CruiseLoop) -> list[BrokenLoop]:
    """Return the eight loops of `LOOP_NAMES` for several cruise loops."""
    closed, dt = loops.transition, float(np.max(loops.dt))
    blocks = state_blocks(closed)
    poles = [np.linalg.eigvals(closed[:, block[:, None], block]).astype(complex) for block in blocks]
    broken = []
    for A, b, *_ in (loops.opened(signal) for signal in (*THRUSTS, *POSE)):
        # the set of states on which this loop acts
        where = next((k for k, block in enumerate(blocks) if np.any(b[:, block] != 0)), 0)
        block = blocks[where]
        opened = np.linalg.eigvals(A[:, block[:, None], block]).astype(complex)
        broken.append(BrokenLoop(poles[where], opened, dt))
    return broken


def loop_margins(
    vehicle: Vehicle,
    gains: Mapping[str, float],
    *,
    cruise: float,
    dt: float,
    model: Vehicle | None = None,
    law: str = TRACKING_LAW,
) -> tuple[LoopMargins, ...]:
    """Return the stability margins of the eight loops about cruise; see the module for the linear model.

    The loops `surge`, `sway`, `heave` and `yaw` are opened at the thrust command while guidance stays closed: their
    margins bound a delay or gain error of this thrust. The loops `along_track`, `cross_track`, `depth` and `heading`
    are opened at the measured x_e, y_e, z_e, ψ: their margins bound a delay or gain error of this measurement.

    Args:
        vehicle: the vehicle.
        gains: k1, k2, k_psi, k_r, k_v [1/s], lookahead [m]; k_i [1/s²] for integral action.
        cruise: cruise speed U [m/s].
        dt: control period [s].
        model: the controller's model of the vehicle; default the vehicle itself.
        law: a law for which `has_cruise_loop` holds.

    Raises:
        InputError: a gain is missing or not positive, or the vehicle cannot hold the cruise speed.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.vehicle import load_vehicle
        >>> from surctl.marine.verification import loop_margins
        >>> for loop in loop_margins(load_vehicle("sur400"), load_gains("default").values, cruise=0.15, dt=0.05)[:3]:
        ...     print(f"{loop.name}: {loop.phase_margin_deg:.0f} deg, {loop.delay_margin_s:.2f} s")
        surge: 56 deg, 0.70 s
        sway: 55 deg, 0.69 s
        heave: 49 deg, 0.61 s
    """
    loop = cruise_loop(vehicle, gains, cruise=cruise, dt=dt, model=model, law=law)
    highest = np.pi / dt  # the Nyquist frequency: a sampled controller does not act above it
    if not loop.stable:
        return tuple(LoopMargins.unstable(name) for name in LOOP_NAMES)
    return tuple(
        margins_from(name, crossings_of(one, highest=highest))
        for name, one in zip(LOOP_NAMES, broken_loops(loop[None]), strict=True)
    )


def least_delay(groups: Sequence[CruiseLoop]) -> tuple[float, str, tuple[int, int]]:
    """Return the least delay margin [s] of one loop alone, the loop, and the vehicle: group, and index in it.

    The margin is 0 if one of the loops is unstable.
    """
    least = []
    for k, group in enumerate(groups):
        delays = loop_delays(group)
        loop, at = np.unravel_index(int(np.argmin(delays)), delays.shape)
        least.append((float(delays[loop, at]), LOOP_NAMES[loop], (k, int(at))))
    return min(least)


def loop_delays(loops: CruiseLoop) -> Array:
    """Return the delay margins (8, n) [s] of the loops of `LOOP_NAMES` of n vehicles; 0 for an unstable vehicle."""
    highest = np.pi / float(np.max(loops.dt))
    return np.array([np.where(loops.decays, delays_of(loop, highest=highest), 0.0) for loop in broken_loops(loops)])

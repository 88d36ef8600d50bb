"""The sampled loop of any law about a straight cruise, linearised numerically from the law that runs.

The law is differentiated by central differences of its control step, so the linear loop needs no model of the law. All
quantities are deviations from a cruise along x at the speed U, far from the ends of the path, obstacles and walls: the
same place as in `cascade`. The plant is continuous, with thrust lag; thrust commands are held over a control period and
computed one period before they act.

A state of the law belongs to the loop if the measurements change it and it changes the thrust. An axis that the law
leaves alone (heave without heave force) does not belong to the loop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.allocation import allocate
from surctl.control import Gains, Law, law_parameters, law_source
from surctl.errors import InputError
from surctl.guidance import Path
from surctl.ir import Layout, Port
from surctl.own_code import label
from surctl.system import Action, Controller, Linearisation, Plant, System, linearise
from surctl.vehicle import PLANT_PARAMETERS, Vehicle, plant_jacobians, plant_parameters, trim_thrust
from surctl.vehicle.linearise import SIGNAL_UNITS, STATE_NAMES, TILT_NAMES, check_cruise
from surctl.verification.linear.disk import DiskMargin
from surctl.verification.margins import LoopMargins
from surctl.verification.sampled_margins import system_disk_margin, system_margins

Array = NDArray[np.float64]

__all__ = ["LawLoop", "law_loop"]

_AXES = ("surge", "sway", "heave", "yaw")
_HEADROOM = 1.5  # speed cap over the cruise speed: the cap must not act in a cruise
_FAR = 1e6  # [m]
_STEP = 1e-6  # of the central differences
_COUPLED = 1e-9  # largest derivative that counts as none


@dataclass(frozen=True, eq=False)
class LawLoop:
    """The linear sampled loop of a law about a cruise.

    Attributes:
        law: name of the law.
        cruise: cruise speed U [m/s].
        linear: the loop, with the thrust commands and the measurements as signals.
    """

    law: str
    cruise: float
    linear: Linearisation

    @cached_property
    def poles(self) -> NDArray[np.complex128]:
        """Poles z of the closed loop, largest first."""
        return self.linear.poles()

    @cached_property
    def margins(self) -> tuple[LoopMargins, ...]:
        """Margins of each loop, opened at a thrust command or a measurement."""
        return system_margins(self.linear)

    @cached_property
    def disk(self) -> DiskMargin:
        """Disk margin of all thrust commands together."""
        return system_disk_margin(self.linear, *(port.name for port in self.linear.system.commands))

    @property
    def stable(self) -> bool:
        """Whether every pole lies inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1))

    def lines(self) -> list[str]:
        """Return lines of text with the margins of each loop."""
        head = f"sampled loop of law {self.law} at {self.cruise:g} m/s, linearised numerically: "
        if not self.stable:
            return [f"{head}UNSTABLE, largest pole |z| = {abs(self.poles[0]):.5f}"]
        lines = [f"{head}stable, disk margin of all thrust loops {self.disk.guaranteed:.2f}"]
        for m in self.margins:
            gain = f"gain {m.least_gain:.2g} to {m.gain_margin:.2g}"
            phase = "phase never lost" if np.isinf(m.phase_margin_deg) else f"phase {m.phase_margin_deg:.0f} deg"
            delay = "" if np.isinf(m.delay_margin_s) else f", delay {m.delay_margin_s:.2f} s"
            lines.append(f"  loop {m.name}: {gain}, {phase}{delay}, disk {m.disk_margin:.2f}")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return the stability of the loop as plain data for JSON."""
        return {
            "law": self.law,
            "cruise_m_per_s": self.cruise,
            "stable": self.stable,
            "largest_pole": float(np.abs(self.poles[0])),
        }


def law_loop(law: Law, vehicle: Vehicle, gains: Gains, *, cruise: float, model: Vehicle | None = None) -> LawLoop:
    """Return the linear sampled loop of a law about a straight cruise.

    Args:
        law: a law for exact obstacle positions, without sonars.
        vehicle: the plant.
        gains: the gains of the law; gains of its own that are missing have their defaults.
        cruise: cruise speed U [m/s], > 0.
        model: the controller's model of the vehicle; default: the vehicle itself.

    Raises:
        InputError: the law uses sonars, or the vehicle cannot cruise at that speed.

    Example:
        >>> from surctl.control import build_law, load_gains
        >>> from surctl.vehicle import load_vehicle
        >>> from surctl.verification import law_loop
        >>> loop = law_loop(build_law("vo"), load_vehicle("sur400"), load_gains("default"), cruise=0.15)
        >>> loop.stable, [m.name for m in loop.margins]
        (True, ['surge', 'sway', 'heave', 'yaw', 'x', 'y', 'z', 'psi', 'u', 'v', 'w', 'r'])
    """
    if "samples" in law.inputs:
        raise InputError("uses sonars", key="law", value=law.name, remedy="build it with sonar=False")
    nu, gains = np.array([cruise, 0.0, 0.0, 0.0]), gains.with_own(law_source(law.ref).gains)
    check_cruise(vehicle, cruise)
    system = _system(law, vehicle, law_numbers(law, model or vehicle, gains, cruise=cruise), nu)
    return LawLoop(label(law.ref), cruise, linearise(system))


def law_numbers(law: Law, model: Vehicle, gains: Gains, *, cruise: float) -> Array:
    """Return the law's parameters for a straight cruise in the middle of a path without end."""
    path = Path(np.array([[-_FAR, 0.0], [_FAR, 0.0]]))
    site = (-2 * _FAR, 2 * _FAR, -2 * _FAR, 2 * _FAR)
    return law_parameters(gains, model, path=path, depth=0.0, cruise=cruise, cap=_HEADROOM * cruise, walls=site)


def _system(law: Law, vehicle: Vehicle, p: Array, nu: Array) -> System:
    form = vehicle.form
    (A,), (B,), _ = plant_jacobians(plant_parameters(vehicle)[None], nu[None], form=form)
    B = B @ _delivered(vehicle, nu)
    Az, By, C, D = _differentiated(law, p, nu)
    acting = [bool(np.abs(row).max() > _COUPLED) for row in np.hstack([C, D])]
    lagged = float(plant_parameters(vehicle)[PLANT_PARAMETERS.slice("thrust_lag")][0]) > 0
    tilt = range(len(STATE_NAMES), len(A))
    # x, y and psi follow the surge, sway and yaw motion; the depth, and heave without coupling, stand alone
    coupled = A[[4, 5, 7, *tilt], 6].any()
    apart = [] if acting[2] else [2] if coupled else [2, 6]
    moving = [k for k in range(8) if k not in apart]
    thrusts = [8 + k for k in range(4) if lagged and acting[k]]
    included, driven = [*moving, *thrusts, *tilt], [k for k in range(4) if acting[k]]
    states = [(*STATE_NAMES, *TILT_NAMES)[k] for k in included]
    A, B = A[np.ix_(included, included)], B[np.ix_(included, driven)]
    own = _in_loop(Az, By[:, moving], C)
    Az, By, C, D = Az[np.ix_(own, own)], By[np.ix_(own, moving)], C[np.ix_(driven, own)], D[np.ix_(driven, moving)]
    names, axes = states[: len(moving)], [_AXES[k] for k in driven]
    # a state of the law may have several entries, so the loop names them by number
    inner = [f"law_{k}" for k in range(len(own))] + [f"late_{axis}" for axis in axes]
    zero = np.zeros((len(driven), len(driven)))
    law_A = np.block([[Az, np.zeros((len(own), len(driven)))], [C, zero]])
    law_B = np.vstack([By, D])
    law_C = np.hstack([np.zeros((len(driven), len(own))), np.eye(len(driven))])

    def ode(x: Any, f: Any, d: Any, q: Any) -> dict[str, ca.SX]:
        return _named(states, ca.SX(A @ _stacked(x, states) + B @ _stacked(f, axes)))

    def step(x: Any, u: Any, q: Any) -> Any:
        held = _stacked(x, inner)
        after = law_A @ held + law_B @ _stacked(u, names)
        return Action(_named(axes, ca.SX(law_C @ held)), _named(inner, ca.SX(after)))

    thrust = _layout(axes, {axis: "N m" if axis == "yaw" else "N" for axis in axes})
    plant = Plant(
        "craft",
        _layout(states, SIGNAL_UNITS),
        thrust,
        ode,
        outputs=_layout(names, SIGNAL_UNITS),
        measure=lambda x, d, q: {name: x[name] for name in names},
    )
    return System(
        plant, Controller("law", law.dt, _layout(names, SIGNAL_UNITS), thrust, step, state=_layout(inner, {}))
    )


def _delivered(vehicle: Vehicle, nu: Array) -> Array:
    """Return the derivative (4, 4) of the force and yaw moment that the thrusters deliver by the command of the law.

    It is the identity, unless a command moves another axis too: a rudder pushes sideways when it turns the craft.
    """
    if vehicle.actuators is None:
        return np.eye(4)
    trim = np.where(vehicle.thrust_limit > 0, trim_thrust(vehicle, nu), 0.0)
    scale = 1e-4 * vehicle.actuators.largest
    steps = [
        allocate(vehicle.actuators, trim + sign * scale * e, speed=float(nu[0])).achieved
        for e in np.eye(4)
        for sign in (1.0, -1.0)
    ]
    J = np.column_stack([(steps[2 * k] - steps[2 * k + 1]) / (2 * scale) for k in range(4)])
    return np.eye(4) if np.abs(J - np.eye(4)).max() < _COUPLED**0.5 else J


def _differentiated(law: Law, p: Array, nu: Array) -> tuple[Array, Array, Array, Array]:
    """Return A, B, C, D of z⁺ = A z + B y and thrust = C z + D y, with y = (x, y, z, ψ, u, v, w, r)."""
    x, size = law.initial_state(), law.state.size
    at = law.inputs.pack({"eta": np.zeros(4), "nu": nu})

    x[law.state.slice("progress")] = _FAR  # arc length of the path's middle
    if "surge" in law.state:  # in a cruise, a law that predicts its speed through the water has found it
        x[law.state.slice("surge")] = nu[0]
    indices = np.arange(law.inputs.size)
    measured = np.concatenate([indices[law.inputs.slice(name)] for name in ("eta", "nu")])
    columns = []
    for which, k in [*((0, k) for k in range(size)), *((1, int(k)) for k in measured)]:
        results = []
        for sign in (1.0, -1.0):
            z, u = x.copy(), at.copy()
            (z, u)[which][k] += sign * _STEP
            step = law.step(z, u, p)
            results.append(np.concatenate([step.x_next, step.tau]))
        columns.append((results[0] - results[1]) / (2 * _STEP))
    J = np.array(columns).T
    return J[:size, :size], J[:size, size:], J[size:, :size], J[size:, size:]


def _in_loop(A: Array, B: Array, C: Array) -> list[int]:
    # states that the measurements reach, and that reach the thrust
    links = np.abs(A) > _COUPLED
    reached, reaches = (np.abs(B) > _COUPLED).any(axis=1), (np.abs(C) > _COUPLED).any(axis=0)
    for _ in range(len(A)):
        reached = reached | (links @ reached)
        reaches = reaches | (links.T @ reaches)
    return [int(k) for k in np.flatnonzero(reached & reaches)]


def _layout(names: Sequence[str], units: Mapping[str, str]) -> Layout:
    return Layout(tuple(Port(name, (1,), units.get(name, "1"), "deviation from the cruise") for name in names))


def _stacked(parts: Mapping[str, ca.SX], names: Sequence[str]) -> ca.SX:
    return ca.vertcat(*(parts[name] for name in names)) if names else ca.SX.zeros(0, 1)


def _named(names: Sequence[str], column: ca.SX) -> dict[str, ca.SX]:
    return {name: column[k] for k, name in enumerate(names)}

"""A sampled linear loop with named signals: transfer functions, poles (marginal, unstable), and python-control."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError, nearest
from surctl.plotted import Plotted

Array = NDArray[np.float64]

# Independent parts of linear loops, each computed once: the axes of a vehicle, and corners that differ elsewhere


def independent(coupled: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Return the indices of a square pattern (n, n) in groups; entries outside of the groups' blocks are False."""
    reached = coupled | coupled.T | np.eye(len(coupled), dtype=bool)
    while (further := reached @ reached).sum() > reached.sum():
        reached = further
    return [np.flatnonzero(group) for group in np.unique(reached, axis=0)]


def distinct(*matrices: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where each distinct one of k tuples of matrices (k, …) occurs first, and which of these each equals."""
    rows = np.concatenate([m.reshape(len(m), -1) for m in matrices], axis=1) + 0.0  # no negative zeros
    known: dict[bytes, int] = {}
    first, which = np.unique([known.setdefault(row.tobytes(), k) for k, row in enumerate(rows)], return_inverse=True)
    return first, which


def eigenvalues(matrices: Array) -> NDArray[np.complex128]:
    """Return the eigenvalues (k, n) of k matrices (k, n, n), in no order."""
    values = np.empty(matrices.shape[:2], dtype=complex)
    for group in independent((matrices != 0).any(axis=0)):
        block = matrices[:, group[:, None], group]
        first, which = distinct(block)
        values[:, group] = np.linalg.eigvals(block[first])[which]
    return values


def blockwise(function: Callable[[Array], Array], matrices: Array) -> Array:
    """Return a matrix function, such as the exponential, of k matrices (k, n, n) from those of their blocks."""
    values = np.zeros_like(matrices)
    for group in independent((matrices != 0).any(axis=0)):
        block = matrices[:, group[:, None], group]
        first, which = distinct(block)
        values[:, group[:, None], group] = function(block[first])[which]
    return values


Matrices = tuple[Array, Array, Array, Array]
EDGE = 1e-9  # a pole this near to the unit circle counts as on it
_DEADBEAT = 1e-9  # least modulus of a pole with a rate of its own

KINDS = ("reference", "disturbance", "command", "measured")
"""Kinds of signals; `kind.LABEL` names a signal where the label alone is ambiguous."""


@dataclass(frozen=True)
class LoopNames:
    """Labels of all signals of a loop.

    Attributes:
        plant, controller, states, controller_states: names of both parts, and labels of their states.
        inputs: labels of the plant's actuator inputs, each of which takes the command with its label.
        commands: labels of the controller's commands.
        outputs: labels of the measured outputs.
        references, disturbances: labels of the external inputs.
        units: (kind.LABEL, unit) of commands, measured outputs, references and disturbances; empty: not known.
        places: name and signals of each place at which all loops are opened at once to judge them; empty: the commands
            that the plant takes, and the measured outputs that the controller uses.
    """

    plant: str
    controller: str
    states: tuple[str, ...]
    controller_states: tuple[str, ...]
    inputs: tuple[str, ...]
    commands: tuple[str, ...]
    outputs: tuple[str, ...]
    references: tuple[str, ...] = ()
    disturbances: tuple[str, ...] = ()
    units: tuple[tuple[str, str], ...] = ()
    places: tuple[tuple[str, tuple[str, ...]], ...] = ()

    def of_kind(self, kind: str) -> tuple[str, ...]:
        """Return the labels of the signals of one of the `KINDS`."""
        kinds = {"reference": self.references, "disturbance": self.disturbances, "measured": self.outputs}
        return kinds.get(kind, self.commands)


@dataclass(frozen=True, eq=False)
class LinearLoop(Plotted):
    """A linear loop of a plant, in continuous time or sampled, and a controller in discrete time.

    `plot()` draws |L|, |S| and |T|, the Nyquist curve, steps and poles. A leading axis of the matrices holds several
    loops with equal signals and states, for `transition`, `rates` and `opened`.

    Attributes:
        plant: matrices (A, B, E, C, D_d) of the plant, with x' = A x + B f + E d and y = C x + D_d d, for command f,
            disturbance d and measured output y. If `sampled`, x' is x one control period later.
        law: matrices (A, B_y, B_r, C, D_y, D_r) of the controller, with z⁺ = A z + B_y y + B_r r and command = C z +
            D_y y + D_r r, for controller state z and reference r.
        names: labels of all signals.
        dt: control period [s].
        sampled: whether the plant is in discrete time, because sampled sensors or actuators belong to it.
    """

    PLOT = "surctl.report.page_parts:plot_loop"

    plant: tuple[Array, ...]
    law: tuple[Array, ...]
    names: LoopNames
    dt: float
    sampled: bool = field(default=False, kw_only=True)

    def __getitem__(self, chosen: int | NDArray[np.intp] | NDArray[np.bool_] | None) -> Self:
        """Return the loops at indices of the leading axis; None adds a leading axis."""
        plant, law = (tuple(m[chosen] for m in part) for part in (self.plant, self.law))
        return replace(self, plant=plant, law=law)

    @staticmethod
    def stacked(loops: Sequence[LinearLoop]) -> LinearLoop:
        """Return several loops with equal signals and states as one, along a leading axis."""
        plant, law = (tuple(map(np.stack, zip(*parts, strict=True)))
                      for parts in ([loop.plant for loop in loops], [loop.law for loop in loops]))  # fmt: skip
        return LinearLoop(plant, law, loops[0].names, loops[0].dt, sampled=loops[0].sampled)

    def plant_system(self) -> Any:
        """Return the plant as `control.StateSpace`, from actuator commands and disturbances to measured outputs."""
        A, B, E, C, D = self.plant
        names = self.names
        return _state_space(
            (A, np.hstack([B, E]), C, np.hstack([np.zeros((len(C), B.shape[1])), D])), self.dt if self.sampled else 0,
            (names.states, (*names.inputs, *names.disturbances), _measured(names.outputs)), names.plant,
        )  # fmt: skip

    def controller_system(self) -> Any:
        """Return the controller as discrete-time `control.StateSpace`, from measurements and references to commands."""
        A, By, Br, C, Dy, Dr = self.law
        names = self.names
        return _state_space(
            (A, np.hstack([By, Br]), C, np.hstack([Dy, Dr])), self.dt,
            (names.controller_states, (*_measured(names.outputs), *names.references), names.commands),
            names.controller,
        )  # fmt: skip

    def closed(self) -> Any:
        """Return the closed loop as discrete-time `control.StateSpace`, exact at the control instants.

        The inputs are references and disturbances, which are constant over a control period; the outputs are the
        measured outputs and the commands.

        Raises:
            InputError: the loop has no inputs.
        """
        names = self.names
        sources = [f"reference.{label}" for label in names.references]
        sources += [f"disturbance.{label}" for label in names.disturbances]
        if not sources:
            raise InputError("has neither references nor disturbances", key="closed", remedy="call poles()")
        ends = [*(f"measured.{label}" for label in names.outputs), *(f"command.{label}" for label in names.commands)]
        labels = (self.states(), (*names.references, *names.disturbances), (*_measured(names.outputs), *names.commands))
        return _state_space(self.transferred(sources, ends), self.dt, labels, "closed loop")

    def transfer(self, sources: str | Sequence[str], ends: str | Sequence[str]) -> Any:
        """Return the closed loop between chosen signals as discrete-time `control.StateSpace`.

        Args:
            sources: labels of references, of disturbances, of measured outputs (a change of the setpoint, which is
                subtracted from what the controller reads) or of commands (a load that is added to the command).
            ends: labels of measured outputs or commands. Where a label names several signals, write `reference.LABEL`,
                `disturbance.LABEL`, `measured.LABEL` or `command.LABEL`.

        Raises:
            InputError: a label names no such signal.
        """
        sources, ends = _listed(sources), _listed(ends)
        labels = [[label.replace(".", " ") for label in part] for part in (sources, ends)]  # as python-control demands
        return _state_space(self.transferred(sources, ends), self.dt, (self.states(), *labels), "closed loop")

    def transferred(self, sources: Sequence[str], ends: Sequence[str]) -> Matrices:
        """Return the matrices (A, B, C, D) of the closed loop that `transfer` returns."""
        _, Bd, Ed = self._sampled_plant
        C, D = self.plant[3:]
        By, Br, Cz, Dy, Dr = self.law[1:]
        nothing = np.zeros((len(By), Bd.shape[1]))
        enters = {  # kind → columns of (x, z), of the measured outputs, of the commands
            "reference": (np.vstack([Bd @ Dr, Br]), np.zeros((len(C), Dr.shape[1])), Dr),
            "disturbance": (np.vstack([Ed + Bd @ Dy @ D, By @ D]), D, Dy @ D),
            "command": (np.vstack([Bd, nothing]), np.zeros((len(C), len(Cz))), np.zeros((len(Cz), len(Cz)))),
            "measured": (-np.vstack([Bd @ Dy, By]), np.zeros((len(C), len(C))), -Dy),
        }
        leaves = {"measured": np.hstack([C, np.zeros((len(C), len(By)))]), "command": np.hstack([Dy @ C, Cz])}
        starts = [self._place(source, KINDS) for source in sources]
        stops = [self._place(end, ("measured", "command")) for end in ends]
        B = np.column_stack([enters[kind][0][:, k] for kind, k in starts])
        through = np.array(
            [[enters[kind][1 + (to == "command")][row, k] for kind, k in starts] for to, row in stops], dtype=float
        )
        return self.transition, B, np.vstack([leaves[to][row] for to, row in stops]), through

    def loop(self, *openings: str) -> Any:
        """Return the loop transfer function L(z), opened at the given signals only, as `control.StateSpace`.

        Args:
            openings: labels of commands or measured outputs at which the loop is opened; a label is the port's name,
                with [i] if the port has several entries. Each opening is one channel of L, from the signal injected
                behind the opening to the signal that returns, under negative feedback.

        Raises:
            InputError: no opening is given, or an opening is unknown.
        """
        back = [f"{name} back" for name in openings]
        return _state_space(self.opened(*openings), self.dt, (self.states(), openings, back), "loop")

    def opened(self, *openings: str) -> Matrices:
        """Return the matrices (A, B, C, D) of the opened loop that `loop` returns."""
        commands, outputs = self.names.commands, self.names.outputs
        if not openings:
            raise InputError("is missing", key="opening", remedy="name a command or a measured output")
        for name in openings:
            if name not in (*commands, *outputs):
                remedy = nearest(name, (*commands, *outputs))
                raise InputError("is not a signal of the loop", key="opening", value=name, remedy=remedy)
        if len(set(openings)) < len(openings):
            double = next(name for k, name in enumerate(openings) if name in openings[:k])
            raise InputError("is opened twice", key="opening", value=double, remedy="name each signal once")
        at_command = np.array([[float(name == label) for label in commands] for name in openings])
        at_output = np.array(
            [[float(name == label and name not in commands) for label in outputs] for name in openings]
        )
        Ad, Bd, _ = self._sampled_plant
        C = self.plant[3]
        Az, By, _, Cz, Dy, _ = self.law
        # at a loop opening, the channel's own signal is cut, and the injected signal replaces it
        keep_f, keep_y = (
            np.eye(len(commands)) - at_command.T @ at_command,
            np.eye(len(outputs)) - at_output.T @ at_output,
        )
        measured, enters = keep_y @ C, at_output.T
        f_x, f_z, f_e = Dy @ measured, Cz, Dy @ enters
        A = np.block([[Ad + Bd @ keep_f @ f_x, Bd @ keep_f @ f_z], [By @ measured, Az]])
        B = np.concatenate([Bd @ (keep_f @ f_e + at_command.T), By @ enters], axis=-2)
        back = np.concatenate([at_command @ f_x + at_output @ C, at_command @ f_z], axis=-1)
        return A, B, -back, -(at_command @ f_e)

    def channels(self) -> list[str]:
        """Return the labels of signals at which the loop can be opened: every command, then every measured output."""
        commands = self.names.commands
        return [*commands, *(name for name in self.names.outputs if name not in commands)]

    def poles(self) -> NDArray[np.complex128]:
        """Return the poles z of the sampled closed loop, largest first.

        The loop is stable if all poles lie inside the unit circle.
        """
        return self._poles

    @cached_property
    def rates(self) -> NDArray[np.complex128]:
        """The closed-loop poles (…, n) as continuous rates s = ln(z)/dt [rad/s], the slowest first.

        A pole z = 0, of a signal that is gone after a period, has a large negative rate.
        """
        closed = self.transition
        z = np.linalg.eigvals(closed).astype(complex) if closed.ndim == 2 else eigenvalues(closed)
        rates = np.asarray(np.log(np.where(np.abs(z) < _DEADBEAT, _DEADBEAT, z)) / self.dt, dtype=complex)
        return np.take_along_axis(rates, np.argsort(-rates.real, axis=-1, kind="stable"), axis=-1)

    @property
    def slowest_per_s(self) -> Array:
        """The largest real part (…) of a rate [1/s]; -inf for a loop without memory."""
        return np.asarray(self.rates.real.max(axis=-1, initial=-np.inf))

    @property
    def decays(self) -> NDArray[np.bool_]:
        """Whether every pole of each loop (…) lies inside the unit circle, by more than rounding."""
        return np.asarray(self.slowest_per_s * self.dt < -EDGE)

    @property
    def stable(self) -> bool:
        """Whether every pole of every loop lies inside the unit circle, by more than rounding."""
        return bool(self.decays.all())

    @property
    def places(self) -> dict[str, tuple[str, ...]]:
        """Signals at which all loops are opened at once, by name of the place; see `LoopNames.places`."""
        return dict(self.names.places) or self.used

    @property
    def used(self) -> dict[str, tuple[str, ...]]:
        """The commands that the plant takes, and the measured outputs that the controller uses, if there are any."""
        names, (_, by_y, _, _, d_y, _) = self.names, self.law
        used = np.abs(np.concatenate([by_y, d_y], axis=-2)).reshape(-1, len(names.outputs)).max(axis=0, initial=0.0) > 0
        commands = tuple(name for name in names.commands if name in names.inputs) or names.commands
        measured = tuple(name for name, use in zip(names.outputs, used, strict=True) if use)
        return {what: labels for what, labels in (("commands", commands), ("measurements", measured)) if labels}

    @cached_property
    def marginal(self) -> tuple[str, ...]:
        """States that do not return after a disturbance although no state grows: their poles are on the unit circle.

        Empty for a stable loop, and for a loop with a growing state, such as one with a double integrator.
        """
        A, poles = self.transition, self.poles()
        left, moved = poles[np.abs(poles) >= 1 - EDGE], np.zeros(len(A))
        if np.abs(left).max(initial=0.0) > 1 + EDGE:
            return ()
        while left.size:
            near = np.abs(left - left[0]) <= np.sqrt(EDGE)
            _, sizes, directions = np.linalg.svd(A - left[0] * np.eye(len(A)))
            free = directions[sizes <= EDGE * max(1.0, sizes[0])]
            if len(free) < near.sum():  # without an eigenvector for each pole, a state grows with time
                return ()
            moved, left = np.maximum(moved, np.abs(free).max(axis=0)), left[~near]
        return tuple(label for label, size in zip(self.states(), moved, strict=True) if size > np.sqrt(EDGE))

    @property
    def stability(self) -> Literal["stable", "marginal", "UNSTABLE"]:
        """Whether the poles are inside the unit circle, or on it without a growing state, or neither."""
        return "stable" if self.stable else "marginal" if self.marginal else "UNSTABLE"

    def states(self) -> list[str]:
        """Return the labels of the plant states, then of the controller states."""
        return [*self.names.states, *(f"controller {label}" for label in self.names.controller_states)]

    def unit(self, label: str, kinds: Sequence[str] = KINDS) -> str:
        """Return the unit of a signal of these kinds, named as in `transfer`; empty if it is not known.

        Raises:
            InputError: there is no such signal.
        """
        kind, k = self._place(label, kinds)
        return dict(self.names.units).get(f"{kind}.{self.names.of_kind(kind)[k]}", "")

    def _place(self, label: str, kinds: Sequence[str]) -> tuple[str, int]:
        # kind and index of a signal
        known = {kind: self.names.of_kind(kind) for kind in KINDS}
        prefix, dot, rest = label.partition(".")
        if dot and prefix in kinds and rest in known[prefix]:
            return prefix, known[prefix].index(rest)
        for kind in (k for k in ("reference", "disturbance", "measured", "command") if k in kinds):
            if label in known[kind]:
                return kind, known[kind].index(label)
        every = [name for kind in kinds for name in (*known[kind], *(f"{kind}.{one}" for one in known[kind]))]
        raise InputError("is not a signal of the loop", key="signal", value=label, remedy=nearest(label, every))

    @cached_property
    def _sampled_plant(self) -> tuple[Array, Array, Array]:
        # (A_d, B_d, E_d) over one control period, driven by the commands and the disturbances
        if self.sampled:
            A, B, E, _, _ = self.plant
            return A, B, E
        return held_plant(self.plant[0], self.plant[1] @ self._selection(), self.plant[2], self.dt)

    @cached_property
    def transition(self) -> Array:
        """The matrix (…, n, n) of the closed loop from one control instant to the next, of plant and controller states.

        Raises:
            InputError: a number of the matrix is too large for a double.
        """
        Ad, Bd, _ = self._sampled_plant
        Az, By, _, Cz, Dy, _ = self.law
        C = self.plant[3]
        closed = np.block([[Ad + Bd @ Dy @ C, Bd @ Cz], [By @ C, Az]])
        if not np.isfinite(closed).all():
            remedy = "correct the largest and the smallest of its parameters and gains"
            raise InputError("is not finite", key=f"the linear loop of {self.names.plant}", remedy=remedy)
        return closed

    @cached_property
    def _poles(self) -> NDArray[np.complex128]:
        poles = np.linalg.eigvals(self.transition).astype(complex)
        return poles[np.argsort(-np.abs(poles), kind="stable")]

    def _selection(self) -> Array:
        # (plant inputs, commands): 1 where an actuator takes a command
        names = self.names
        chosen = [[float(name == label) for label in names.commands] for name in names.inputs]
        return np.array(chosen).reshape(len(names.inputs), len(names.commands))


def held_plant(A: Array, B: Array, E: Array, dt: float | Array) -> tuple[Array, Array, Array]:
    """Return A_d, B_d and E_d of x⁺ = A_d x + B_d f + E_d d after `dt` [s] with constant inputs f and d, exact."""
    from scipy.linalg import expm

    inputs = np.concatenate([A, B, E], axis=-1)
    n, size = inputs.shape[-2:]
    whole = np.zeros((*inputs.shape[:-2], size, size))
    whole[..., :n, :] = inputs * np.asarray(dt)[..., None, None]
    held = (expm(whole) if whole.ndim == 2 else blockwise(expm, whole))[..., :n, :]
    if not np.isfinite(held).all():
        remedy = "check units and sizes of the parameters"
        raise InputError("changes too fast for floating-point numbers", key="the linear plant", remedy=remedy)
    return held[..., :n], held[..., n : n + B.shape[-1]], held[..., n + B.shape[-1] :]


def delayed(law: tuple[Array, ...]) -> tuple[Array, ...]:
    """Return the matrices of a controller, as in `LinearLoop`, whose commands are one period late.

    The commands that wait are states of it, after its own.
    """
    Az, By, Br, Cz, Dy, Dr = law
    many, (m, k) = Cz.shape[:-2], Cz.shape[-2:]
    A, C = np.zeros((*many, k + m, k + m)), np.zeros((*many, m, k + m))
    A[..., :k, :k], A[..., k:, :k], C[..., k:] = Az, Cz, np.eye(m)
    entering = [np.concatenate([B, D], axis=-2) for B, D in ((By, Dy), (Br, Dr))]
    return A, entering[0], entering[1], C, 0 * Dy, 0 * Dr


def _state_space(matrices: Matrices, dt: float, labels: tuple[Sequence[str], ...], name: str) -> Any:
    import control  # takes seconds to import

    states, inputs, outputs = (list(part) for part in labels)
    return control.ss(*matrices, dt, states=states, inputs=inputs, outputs=outputs, name=name)


def _measured(outputs: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"measured {label}" for label in outputs)


def _listed(labels: str | Sequence[str]) -> list[str]:
    return [labels] if isinstance(labels, str) else list(labels)

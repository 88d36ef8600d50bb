"""Systems of python-control as plants, controllers and closed loops, or why they are refused; the way back."""

from __future__ import annotations

import re
import unicodedata
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.system.controller import Action, Controller, SampledController
from surctl.system.linear_loop import LinearLoop
from surctl.system.loop import System
from surctl.system.parts import entry_labels
from surctl.system.plant import Plant
from surctl.units import is_number

# A state space of a transfer function with several inputs and outputs (python-control needs slycot for it)


Array = NDArray[np.float64]

_RANK = 1e-12  # smaller singular values of columns of length 1 are rounding


def state_space(system: Any) -> Any:
    """Return the `control.StateSpace` of a linear system, minimal up to rounding for a matrix of transfer functions.

    Each column of the matrix gives one controllable canonical form for each of its denominators (Kailath 1980, section
    6.4). States that no input moves or that no output shows are removed, since a controller could not stabilise them.

    Raises:
        TypeError, ValueError: the system is not proper or not real.
    """
    import control  # takes seconds to import
    from scipy.linalg import block_diag, matrix_balance

    if not isinstance(system, control.TransferFunction) or control.issiso(system):
        return control.ss(system)
    forms: list[tuple[Array, Array, Array]] = []
    D = np.zeros((system.noutputs, system.ninputs))
    for j in range(system.ninputs):
        columns: dict[tuple[float, ...], dict[int, Array]] = {}  # numerators by denominator and row
        for i in range(system.noutputs):
            den, num = (np.trim_zeros(np.asarray(part[i][j], dtype=float), "f") for part in (system.den, system.num))
            if len(num) > len(den):
                raise ValueError("transfer function is not proper")
            padded = np.concatenate([np.zeros(len(den) - len(num)), num])
            columns.setdefault(tuple((den / den[0]).tolist()), {})[i] = padded / den[0]
        for denominator, rows in columns.items():
            a, order = np.array(denominator[1:]), len(denominator) - 1
            B, C = np.zeros((order, system.ninputs)), np.zeros((system.noutputs, order))
            B[:1, j] = 1.0
            for i, numerator in rows.items():
                C[i], D[i, j] = numerator[1:] - numerator[0] * a, numerator[0]
            forms.append((np.vstack([-a, np.eye(order)[:-1]])[:order], B, C))
    A, B, C = block_diag(*(f[0] for f in forms)), np.vstack([f[1] for f in forms]), np.hstack([f[2] for f in forms])
    A, T = matrix_balance(A)
    A, B, C = _reached(A, np.linalg.solve(T, B), C @ T)
    A, C, B = (m.T for m in _reached(A.T, C.T, B.T))  # the states that the outputs show
    names = {"inputs": system.input_labels, "outputs": system.output_labels, "name": system.name}
    return control.ss(A, B, C, D, system.dt, **names)


def _reached(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    # restricted to the smallest subspace that has the columns of B and is invariant under A
    size, step = np.linalg.norm(B, axis=0), A / max(float(np.linalg.norm(A)), np.finfo(float).tiny)
    basis = _range(B[:, size > 0] / size[size > 0])
    while (larger := _range(np.hstack([basis, step @ basis]))).shape[1] > basis.shape[1]:
        basis = larger
    return basis.T @ A @ basis, basis.T @ B, C @ basis


def _range(matrix: Array) -> Array:
    # an orthonormal basis of the span of columns of length 1, or less where they matter less
    left, values, _ = np.linalg.svd(matrix, full_matrices=False)
    return left[:, values > _RANK]


_LABEL = re.compile(r"(?P<name>[^\[\]]+?)(?:\[(?P<entry>\d+)\])?(?:\s*\[(?P<unit>[^\]]+)\])?$")
_ALIKE = 1e-9


def from_control(system: Any, controller: Any = None, *, dt: float | None = None) -> Any:
    """Return a python-control system as a `Plant`, a `Controller`, or with a controller as a `System`.

    A system in continuous time becomes a plant, whose inputs are the commands; a system in discrete time, or a single
    system with `dt`, becomes a controller, whose outputs are the commands. Signals keep their names; `x[0]`, `x[1]`
    become one port x with two entries, and a label such as "speed [m/s]" states a unit.

    If the controller's inputs have names of the plant's outputs, they are connected by name, and all others are
    references. Otherwise the controller acts on the errors, that is, on reference minus output, as in
    `control.feedback(plant * controller)`; the references are named `ref_OUTPUT`. Outputs of the controller that do not
    have the names of the plant's inputs are connected to them in order.

    Args:
        system: `control.StateSpace`, `control.TransferFunction`, or a `control.NonlinearIOSystem` whose functions take
            CasADi expressions, as numpy functions of arrays do; with `controller`, it may be a `Plant`.
        controller: such a system, or a `Controller`, as the controller of the plant `system`.
        dt: control period [s]. A linear controller in continuous time is sampled with it by Tustin's method; a system
            in discrete time must have this period.

    Raises:
        InputError: a plant has no state, or passes inputs directly to outputs; a controller has no control period, or
            another one; the numbers of signals do not match; or functions fail on symbols.

    Example:
        >>> import control
        >>> from surctl.system import from_control, linearise
        >>> plant = control.tf([1.0], [1.0, 1.0, 0.0], name="motor")
        >>> lead = control.tf([8.0, 8.0], [1.0, 4.0], name="lead")
        >>> loop = linearise(from_control(plant, lead, dt=0.05))
        >>> loop.channels(), round(float(abs(loop.poles()[0])), 3)
        (['u', 'y'], 0.951)
    """
    if controller is not None:
        return system_from_control(system, controller, dt=dt)
    _checked(system, key="system")
    if system.isdtime(strict=True) or dt is not None:
        return controller_from_control(system, dt=dt)
    return plant_from_control(system)


def plant_from_control(system: Any) -> Plant:
    """Return a python-control system in continuous time as a plant, see `from_control`."""
    _checked(system, key="plant")
    if system.isdtime(strict=True):
        remedy = "give it in continuous time; the loop holds its inputs over a control period"
        raise InputError("is in discrete time", key=_name(system), remedy=remedy)
    states, inputs, outputs = _layouts(system)
    rate, output = _functions(system)
    if not states.size:
        raise InputError("has no state", key=_name(system), remedy="put a static gain into the controller")
    x, u = ca.SX.sym("x", states.size), ca.SX.sym("u", inputs.size)
    if ca.which_depends(output(x, u), u).count(True) if inputs.size else False:
        remedy = "give a strictly proper plant, such as one with the lag of its actuators"
        raise InputError("passes an input directly to an output", key=_name(system), remedy=remedy)
    whole = [port.name for port in states] == [port.name for port in outputs]
    identical = whole and bool(ca.is_equal(ca.simplify(output(x, u)), x, 3))
    return Plant(
        _name(system),
        state=states,
        inputs=inputs,
        ode=lambda x, f, d, p: rate(_stacked(x, states), _stacked(f, inputs)),
        outputs=Layout(()) if identical else outputs,
        measure=None if identical else lambda x, d, p: output(_stacked(x, states), ca.SX(inputs.size, 1)),
    )


def controller_from_control(system: Any, *, dt: float | None = None) -> Controller:
    """Return a python-control system as a sampled controller, see `from_control`."""
    _checked(system, key="controller")
    period, system = _sampled(system, dt)
    states, inputs, outputs = _layouts(system)
    after, output = _functions(system)

    def law(x: Any, u: Any, p: Any) -> Action:
        z, v = _stacked(x, states), _stacked(u, inputs)
        return Action(outputs.split(output(z, v)), states.split(after(z, v)) if states.size else ())

    return Controller(_name(system), period, inputs, outputs, law, state=states)


def system_from_control(plant: Any, controller: Any, *, dt: float | None = None) -> System:
    """Return the closed loop of two python-control systems, see `from_control`."""
    craft = plant if isinstance(plant, Plant) else plant_from_control(plant)
    law = controller if isinstance(controller, Controller) else controller_from_control(controller, dt=dt)
    law = _renamed(law, craft)
    measured = craft.measurements
    if any(port.name in measured for port in law.inputs):
        return System(craft, law)
    if law.inputs.size != measured.size:
        problem = f"has {law.inputs.size} inputs, but the plant {measured.size} outputs"
        raise InputError(problem, key=law.name, remedy="give the inputs the names of the outputs that they read")
    references = Layout(tuple(Port(f"ref_{p.name}", p.shape, p.unit, f"desired {p.name}") for p in measured))
    errors = law.inputs

    def on_error(x: Any, u: Any, p: Any) -> Any:
        error = _stacked(u, references) - _stacked(u, measured)
        return law.law(x, errors.split(error), p)

    inputs = Layout((*measured, *references))
    return System(craft, Controller(law.name, law.dt, inputs, law.command, on_error, state=law.state, gains=law.gains))


def _checked(system: Any, *, key: str) -> None:
    import control  # takes seconds to import

    kinds = (control.StateSpace, control.TransferFunction, control.NonlinearIOSystem)
    if not isinstance(system, kinds):
        remedy = "give a control.StateSpace, TransferFunction or NonlinearIOSystem"
        raise InputError(f"is a {type(system).__name__}", key=key, remedy=remedy)
    if isinstance(system, control.StateSpace | control.TransferFunction):
        for matrix in _matrices(system):
            if not np.isfinite(matrix).all():
                raise InputError("has a number that is not finite", key=_name(system), remedy="correct its matrices")


def _sampled(system: Any, dt: float | None) -> tuple[float, Any]:
    # control period and system in discrete time; a static gain has any period
    import control  # takes seconds to import

    linear = isinstance(system, control.StateSpace | control.TransferFunction)
    if dt is not None and not (is_number(dt) and dt > 0):
        raise InputError("is not a positive time", key="dt", value=dt, remedy="give seconds")
    if system.isdtime(strict=True):
        own = dt if system.dt is True else float(system.dt)
        if own is None or (dt is not None and abs(dt - own) > _ALIKE * own):
            problem = "has no control period" if own is None else f"has the control period {own:g} s"
            raise InputError(problem, key=_name(system), value=dt, remedy="give its control period [s] as dt")
        return own, system
    if dt is None:
        raise InputError("has no control period", key=_name(system), remedy="give dt [s]")
    if not linear:
        remedy = "write its update for discrete time, with dt"
        raise InputError("is nonlinear and in continuous time", key=_name(system), remedy=remedy)
    whole = state_space(system)
    sampled = control.ss(whole.A, whole.B, whole.C, whole.D, dt) if not whole.nstates else None
    if sampled is None:
        sampled = control.sample_system(whole, dt, method="tustin")
    labels = {"inputs": system.input_labels, "outputs": system.output_labels, "name": system.name}
    return dt, control.ss(sampled.A, sampled.B, sampled.C, sampled.D, dt, **labels)


def _functions(system: Any) -> tuple[Callable[[ca.SX, ca.SX], ca.SX], Callable[[ca.SX, ca.SX], ca.SX]]:
    """Return the functions (x, u) → rate or next state, and (x, u) → output, of a system on CasADi expressions."""
    import control  # takes seconds to import

    if isinstance(system, control.StateSpace | control.TransferFunction):
        A, B, C, D = (ca.DM(np.asarray(m)) for m in _matrices(system))
        return (lambda x, u: ca.SX(A @ x + B @ u)), (lambda x, u: ca.SX(C @ x + D @ u))

    time = ca.SX.sym("t")

    def traced(function: Any, size: int) -> Callable[[ca.SX, ca.SX], ca.SX]:
        def call(x: ca.SX, u: ca.SX) -> ca.SX:
            arrays = [_objects(v) for v in (time, x, u)]
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # numpy functions of CasADi expressions
                    returned = function(arrays[0][0], *arrays[1:], system.params)
                flat = ca.vertcat(*_flat(returned))
            except Exception as error:
                text = " ".join(str(error).split())[:200]
                problem = f"fails on CasADi symbols ({type(error).__name__}: {text})"
                remedy = "write it with numpy functions of the entries x[0], u[0], and without if"
                raise InputError(problem, key=_name(system), remedy=remedy) from error
            if ca.depends_on(flat, time):
                remedy = "make what depends on time an input"
                raise InputError("depends on the time t", key=_name(system), remedy=remedy)
            if flat.numel() != size:
                raise InputError(f"returns {flat.numel()} numbers, expected {size}", key=_name(system))
            return flat

        return call

    output = system.outfcn or (lambda t, x, u, params: x)
    return traced(system.updfcn, system.nstates), traced(output, system.noutputs)


def _objects(vector: ca.SX) -> NDArray[np.object_]:
    # numpy would convert a list with a single expression to a number
    array = np.empty(vector.numel(), dtype=object)
    for k in range(vector.numel()):
        array[k] = vector[k]
    return array


def _flat(returned: Any) -> list[ca.SX]:
    values = returned.tolist() if isinstance(returned, np.ndarray) else returned
    if isinstance(values, list | tuple):
        return [entry for one in values for entry in _flat(one)]
    return [ca.SX(values)]


def _matrices(system: Any) -> tuple[Array, ...]:
    try:
        whole = state_space(system)
    except (TypeError, ValueError) as error:
        problem = f"has no state space ({' '.join(str(error).split())})"
        remedy = "give a proper system with real numbers, such as a derivative with a filter"
        raise InputError(problem, key=_name(system), remedy=remedy) from None
    return whole.A, whole.B, whole.C, whole.D


def _layouts(system: Any) -> tuple[Layout, Layout, Layout]:
    import control  # takes seconds to import

    states = state_space(system).state_labels if isinstance(system, control.TransferFunction) else system.state_labels
    return tuple(_layout(labels) for labels in (states, system.input_labels, system.output_labels))  # type: ignore[return-value]


def _layout(labels: Sequence[str]) -> Layout:
    """Return the ports of labels; NAME[0], NAME[1], … become one port, and others one port each."""
    parts = [_LABEL.match(label.removeprefix("measured ")) for label in labels]
    ports: list[Port] = []
    k = 0
    while k < len(labels):
        part = parts[k]
        name = _identifier(labels[k] if part is None else part["name"])
        unit = "1" if part is None or part["unit"] is None else part["unit"]
        size = 1
        if part is not None and part["entry"] == "0":
            while k + size < len(labels) and labels[k + size] == f"{part['name']}[{size}]":
                size += 1
        elif part is not None and part["entry"] is not None:
            name = f"{name}_{part['entry']}"
        ports.append(Port(name, (size,), unit, "of a python-control system"))
        k += size
    return Layout(tuple(ports))


def _identifier(text: str) -> str:
    plain = unicodedata.normalize("NFKD", text.strip()).replace("\N{COMBINING DOT ABOVE}", "dot")  # of a derivative
    plain = re.sub("[\u0300-\u036f]", "", plain)  # other accents
    letters = (c if c.isascii() else unicodedata.name(c, "_").split(" WITH ")[0].split()[-1].lower() for c in plain)
    name = re.sub(r"\W+", "_", "".join(letters), flags=re.ASCII).strip("_") or "signal"
    return f"s_{name}" if name[0].isdigit() else name


def _name(system: Any) -> str:
    return _identifier(str(system.name or "system"))


def _renamed(law: Controller, plant: Plant) -> Controller:
    """Return the controller with commands that have the names of the plant's inputs."""
    if all(port.name in law.command for port in plant.inputs):
        return law
    same = [port.name for port in plant.inputs if port.name in law.command]
    if same:
        others = ", ".join(port.name for port in plant.inputs if port.name not in law.command)
        remedy = "name a command after each of the plant's inputs, or none, so that they are connected in order"
        raise InputError(f"commands {', '.join(same)}, but not {others}", key=law.name, remedy=remedy)
    if law.command.size != plant.inputs.size:
        problem = f"commands {law.command.size} signals, but the plant has {plant.inputs.size} inputs"
        raise InputError(problem, key=law.name, remedy="give the commands the names of the plant's inputs")
    commands = law.command

    def renamed(x: Any, u: Any, p: Any) -> Action:
        act = law.law(x, u, p)
        whole = act if isinstance(act, Action) else Action(act)
        flat = commands.join(whole.command) if isinstance(whole.command, Mapping) else whole.command
        return whole._replace(command=plant.inputs.split(flat))

    return Controller(law.name, law.dt, law.inputs, plant.inputs, renamed, state=law.state, gains=law.gains)


def _stacked(parts: Mapping[str, ca.SX], layout: Layout) -> ca.SX:
    return layout.join({port.name: parts[port.name] for port in layout})


# Plants, controllers and linear loops of surctl as systems of python-control


def to_control(part: Any) -> Any:
    """Return a plant or controller as `control.NonlinearIOSystem`, and a linear loop as `control.StateSpace`.

    The inputs of a plant are its commands, then its disturbances; those of a controller are its inputs. Gains and
    parameters have their default values.

    Raises:
        InputError: the object is none of these.

    Example:
        >>> import control
        >>> from surctl.ir import Layout, Port
        >>> from surctl.system import Plant, to_control
        >>> level, flow = Port("level", (1,), "m", "of the water"), Port("flow", (1,), "m/s", "inflow over the area")
        >>> tank = Plant("tank", Layout((level,)), Layout((flow,)), lambda x, f, d, p: f["flow"] - x["level"])
        >>> control.linearize(to_control(tank), [1.0], [1.0]).poles().real
        array([-1.])
    """
    import control  # takes seconds to import

    if isinstance(part, LinearLoop):
        return part.closed()
    if isinstance(part, Plant):
        return _plant_system(part)
    if isinstance(part, System) or not hasattr(part, "block"):
        remedy = "give a Plant, a Controller or a linear loop; linearise(system) is one"
        raise InputError(f"is a {type(part).__name__}", key="part", remedy=remedy)
    law: SampledController = part
    gains = law.gains.pack()

    def after(t: float, x: Array, u: Array, params: Mapping[str, Any]) -> Array:
        return law.step(x, u, gains).x_next

    def output(t: float, x: Array, u: Array, params: Mapping[str, Any]) -> Array:
        step = law.step(x, u, gains)
        return np.concatenate([step.tau, step.telemetry])

    return control.nlsys(
        after, output, dt=law.dt, name=law.name, inputs=entry_labels(law.inputs), outputs=entry_labels(law.outputs),
        states=entry_labels(law.state),
    )  # fmt: skip


def _plant_system(plant: Plant) -> Any:
    import control  # takes seconds to import

    p, size = plant.parameters.pack(), plant.inputs.size
    x, d = ca.SX.sym("x", plant.state.size), ca.SX.sym("d", plant.disturbances.size)
    measure = ca.Function("measure", [x, d], [plant.measurement(x, d, ca.SX(ca.DM(p)))])

    def rate(t: float, x: Array, u: Array, params: Mapping[str, Any]) -> Array:
        return np.array(plant.function(x, u[:size], u[size:], p)).reshape(-1)

    def output(t: float, x: Array, u: Array, params: Mapping[str, Any]) -> Array:
        return np.array(measure(x, u[size:])).reshape(-1)

    return control.nlsys(
        rate, output, name=plant.name, states=entry_labels(plant.state),
        inputs=[*entry_labels(plant.inputs), *entry_labels(plant.disturbances)],
        outputs=entry_labels(plant.measurements, "measured "),
    )  # fmt: skip

"""One run of a system: all signals, the number that is not finite, files as CSV, .mat, netCDF."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from surctl.errors import InputError, nearest
from surctl.ir import Layout, Port
from surctl.plotted import Plotted
from surctl.recorded_write import RECORD_FORMATS, Column, write_csv, write_mat, write_netcdf
from surctl.system.controller import NONFINITE, lost_entry
from surctl.system.loop import ENDED, LOST, System, once_per_system, periods
from surctl.system.parts import entry_labels, entry_units, not_finite, undefined_operation
from surctl.system.runs import moved_state, simulate_steps
from surctl.system.values import RunNumbers, run_numbers

Array = NDArray[np.float64]

_REST = 1e-9  # smallest change of a state that counts
_NAMED = 3  # largest number of names in a message
_ROUGH, _FINE = 0.01, 1e-3  # change of a state by a step of half the length, as a share of its range: too large, aim


@dataclass(frozen=True, eq=False)
class Record(Plotted):
    """The signals of one run at its n control instants; `record["name"]` is a signal (n, size) or a metric.

    `plot()` draws states, commands and references over time.

    Attributes:
        time: (n,) times of the control instants [s].
        signals: values (n, size) of states, commands, measured outputs, references and telemetry, by port name; a
            controller state has the prefix `controller.` if a plant state has an equal name.
        status: (n,) status of each step.
        figures: value of each metric (cost) by name; NaN as in `Runs`.
        stopped: reason for the end of the run: the name of a stop of the system, "time" or "not finite".
        controller: arguments of the controller, for comparison with the exported C code: states (n, states), inputs (n,
            inputs), and gains (gains,).
        lost: for a run that ended as "not finite", the first number that is not finite, its time and the cause, if it
            is found, such as "state x[0] at 1.2 s, because of 2/0 of the plant (mass = 0)"; otherwise empty.
        rough: where the integration step is too long, and what to give; empty if steps of half the length change no
            state at the end of a control period by more than 1 % of its range in the run.
    """

    PLOT = "surctl.report.system_plots:plot_record"

    system: System
    time: Array
    signals: Mapping[str, Array]
    status: NDArray[np.int64]
    figures: Mapping[str, float]
    stopped: str
    controller: tuple[Array, Array, Array]
    lost: str = ""
    rough: str = ""

    def __getitem__(self, name: str) -> Array | float:
        known: dict[str, Array | float] = {**self.figures, **self.signals}
        if name not in known:
            raise InputError("no such signal or figure", key=name, remedy=nearest(name, known))
        return known[name]

    @property
    def duration(self) -> float:
        """Return the duration of the run [s]; a run that ended early ends at its last control instant."""
        return float(self.time[-1] + (self.system.dt if self.stopped == ENDED else 0.0))

    @property
    def at_rest(self) -> str:
        """Return what to give so that a state changes, if none does in the whole run; otherwise an empty text."""
        plant, system = self.system.plant, self.system
        if self.stopped != ENDED or any(np.ptp(self.signals[port.name], axis=0).max() > _REST for port in plant.state):
            return ""
        names = {"start": plant.state, "reference": system.references, "disturbance": plant.disturbances}
        inputs = [f"{kind}.{port.name}" for kind, ports in names.items() for port in ports]
        return f"it starts at an equilibrium: give other values of {' or '.join(inputs[:_NAMED])}"

    def ports(self, *kinds: str) -> dict[str, Port]:
        """Return the port (name, size, unit) of each signal of the given kinds, by name; by default of all kinds.

        The kinds are state, command, output, reference, telemetry and controller.
        """
        places = _places(self.system).items()
        return {name: layout.port(port) for name, (kind, layout, port) in places if kind in (kinds or _KINDS)}

    def entries(self, *kinds: str) -> list[tuple[str, str, str, Array]]:
        """Return signal, label, unit and values (n,) of each entry of the signals of the given kinds, see `ports`."""
        entries = []
        for name, port in self.ports(*kinds).items():
            alone = Layout((port,))
            labels = (label.replace(port.name, name, 1) for label in entry_labels(alone))
            entries += [(name, *each) for each in zip(labels, entry_units(alone), self.signals[name].T, strict=True)]
        return entries

    def table(self) -> dict[str, Array]:
        """Return time, all entries of all signals, and status as columns (n,), by a label with the unit."""
        return {f"{label} [{column.unit}]": column.values for label, column in self.columns().items()}

    def columns(self) -> dict[str, Column]:
        """Return time, all entries of all signals, and status with values (n,), unit and meaning, by label.

        A signal with the label `time` or `status` gets a trailing underscore.
        """
        columns = {"time": Column(self.time, "s", "time since the start")}
        ports = self.ports()
        for name, label, unit, values in self.entries():
            key, meaning = f"{label}_" if label in ("time", "status") else label, ports[name].meaning
            columns[key] = Column(values, unit, f"{label}: {meaning}" if meaning else label)
        return columns | {"status": Column(self.status.astype(float), "1", "status of the controller's steps")}


def run_system(system: System, seconds: float, values: Mapping[str, ArrayLike] | None = None) -> Record:
    """Simulate one run and record all signals; no compiler is needed, and the results equal those of `simulate_system`.

    They are equal up to rounding. A number of telemetry or of an input of the controller that is not finite ends a
    recorded run, too.

    Args:
        seconds: duration of the run [s] unless a stop ends it earlier.
        values: numbers of one run by name, see `run_numbers`.

    Raises:
        InputError: `run_numbers` finds an error, or `values` are for several runs.

    Example:
        >>> from surctl.system import run_system
        >>> from surctl.testing import cart_system
        >>> record = run_system(cart_system(), 2.0)
        >>> record["speed"][[0, 10], 0].round(3)
        array([1.   , 0.349])
    """
    numbers = run_numbers(system, values)
    if numbers.count != 1:
        raise InputError(
            f"are for {numbers.count} runs", key="values", remedy="give the values of one run, or call simulate_system"
        )
    at, run = simulate_steps(system, numbers, periods(system, seconds))
    gains, stopped = numbers.gains[0], str(run.stopped[0])
    # a step that reads or returns a number that is not finite ends the run, even if all that follows is finite
    finite = [np.isfinite(at[name]).all(axis=1) for name in _OF_STEP]
    failed = ~np.logical_and.reduce(finite) | ~np.isfinite(gains).all()
    lost, figures = "", {name: float(value[0]) for name, value in run.figures.items()}
    if failed.any() or stopped == LOST:
        last = int(failed.argmax()) if failed.any() else len(failed) - 1
        at = {name: values[: last + 1] for name, values in at.items()}
        if failed.any():
            at["tau"][last], at["k"][last], at["status"][last] = 0.0, 0.0, NONFINITE
        stopped, lost, figures = LOST, _lost(system, numbers, at), dict.fromkeys(figures, np.nan)
    tables = [at[name] for name in ("plant", "tau", "y", "r", "k", "controller")]
    return Record(
        system,
        np.arange(float(len(at["u"]))) * system.dt,
        _named(system, tables),
        at["status"][:, 0].astype(np.int64),
        figures,
        stopped,
        (at["controller"], at["u"], gains),
        lost,
        _rough(system, at, stopped),
    )


_OF_STEP = ("controller", "u", "tau", "x_next", "status", "k")  # arguments and results of the controller's step


def _rough(system: System, at: Mapping[str, Array], stopped: str) -> str:
    """Return `Record.rough`."""
    moved, finer, before = at["moved"], at["finer"], at["plant"]
    known = np.isfinite(finer)
    low, high = (each.accumulate(np.where(known, finer, before)) for each in (np.fmin, np.fmax))
    with np.errstate(all="ignore"):
        span = np.maximum(high, before[0]) - np.minimum(low, before[0])
        least = _REST * np.maximum(1.0, np.abs(before[0]))  # above the rounding of a place such as 6e6 m
        span = np.maximum(span if stopped == LOST else span[-1:], least)  # a run that is lost may end far away
        change = np.where(known, np.nan_to_num(np.abs(moved - finer) / span, nan=1.0, posinf=1.0), 0.0)
    change[-1] *= stopped in (ENDED, LOST)  # no period follows a stop
    if not change.max() > _ROUGH:
        return ""
    k = int(np.argmax(change.max(axis=1) > _ROUGH))
    i = int(change[k].argmax())
    steps = np.ceil(2 * system.substeps * (min(change.max(), 1.0) / _FINE) ** 0.25)  # the method is of fourth order
    name, unit = entry_labels(system.plant.state)[i], entry_units(system.plant.state)[i]
    text = f"the integration step is too long at {k * system.dt:.6g} s: after one control period, it gives {name} = "
    text += f"{moved[k, i]:.7g}, and half of it {finer[k, i]:.7g} {unit}; "
    return f"{text}give System(substeps={min(steps, 1000):g}), at most 1000, or make a jump in the plant smooth"


def _lost(system: System, numbers: RunNumbers, at: Mapping[str, Array]) -> str:
    """Return the first number that is not finite in the last control period of a run, its time and the cause."""
    k = len(at["u"]) - 1
    now, gains = {name: values[k] for name, values in at.items()}, numbers.gains[0]
    step = now["controller"], now["u"], gains
    costs = Layout(tuple(Port(cost, (1,), "1", "") for cost in system.costs))
    name = lost_entry(system.controller, *step) or not_finite([("cost", costs, now["costs"])])
    after = "" if name else not_finite([("state", system.plant.state, now["moved"])])
    name, later = name or after or "memory of a sensor or an actuator", bool(after)  # the state ends the period
    constants = numbers.plant[0], numbers.disturbance[0], numbers.blocks[0]
    moving = (now["plant"], now["tau"], [k * system.dt], *constants, now["memory"], now["noise"], [float(k)])
    cause = undefined_operation("law", system.controller.block, step, {2: system.controller.gains})
    cause = cause or undefined_operation("plant", _motion(system), moving, {3: system.plant.parameters})
    return f"{name} at {(k + later) * system.dt:.6g} s{cause}"


def _named(system: System, tables: list[Array]) -> dict[str, Array]:
    by_kind = dict(zip(_KINDS, tables, strict=False))
    return {name: by_kind[kind][:, layout.slice(port)] for name, (kind, layout, port) in _places(system).items()}


_KINDS = ("state", "command", "output", "reference", "telemetry", "controller")


def _places(system: System) -> dict[str, tuple[str, Layout, str]]:
    """Return kind, layout and port name of each signal, by signal name; an output with a state's name is the state.

    The output of a sensor with a state's name has the prefix `measured.`.
    """
    layouts = (
        system.plant.state, system.commands, system.measurements, system.references, system.telemetry,
        system.controller.state,
    )  # fmt: skip
    places: dict[str, tuple[str, Layout, str]] = {}
    sensed = {port.name for outputs in system.blocks.outputs["sensors"] for port in outputs}
    for kind, layout in zip(_KINDS, layouts, strict=True):
        for port in layout:
            prefix = "controller." if port.name in places and kind == "controller" else ""
            if kind == "output" and port.name in places and port.name in sensed:
                prefix = "measured."
            places.setdefault(f"{prefix}{port.name}", (kind, layout, port.name))
    return places


@once_per_system
def _motion(system: System) -> ca.Function:
    # the plant state after a period
    plant, blocks = system.plant, system.blocks
    sizes = {
        "x": plant.state.size, "command": system.commands.size, "t": 1, "p": plant.parameters.size,
        "d": plant.disturbances.size, "q": blocks.parameters.size, "memory": blocks.memory.size,
        "noise": blocks.noise, "count": 1,
    }  # fmt: skip
    x, command, t, p, d, q, memory, noise, count = symbols = [ca.SX.sym(name, n) for name, n in sizes.items()]
    constants = {"plant": p, "disturbance": d, "blocks": q}
    moved = moved_state(system, x, command, constants, t, count, memory, noise)
    return ca.Function("move", symbols, list(moved))


# Write a recorded run of a system as CSV, MATLAB's .mat or netCDF, with names, units and identity


_TEXTS = ("identity", "units", "meaning")  # names of the texts in a .mat file


def identity(system: System) -> dict[str, str]:
    """Return names, control period [s] and digests (SHA-256) of a system, for files with results."""
    return {
        "plant": system.plant.name,
        "controller": system.controller.name,
        "period_s": f"{float(system.dt)!r}",
        "controller_sha256": system.controller.block.digest(),
        "system_sha256": system.digest(),
    }


def save_record(record: Record, path: Path | str, *, about: Mapping[str, str] | None = None) -> Path:
    """Write time and all signals of a run, one row per control instant; return the path.

    The end of the name chooses the format; all formats hold the same numbers, to the last bit. CSV: a header with names
    and units, and all digits that are needed to restore each number. .mat: a column vector per signal, named by an
    identifier (`pose[0]` becomes `pose_0`), and the structs `units`, `meaning` and `identity`. netCDF-4: variables
    along the dimension `time` with the attributes `units` and `long_name`; the attributes of the file are the identity.

    Args:
        path: a file in an existing folder that ends in .csv, .mat or .nc.
        about: further texts of the identity by name, such as the origin of the system. In every case, the identity has
            the names, the digests, the gains, the costs, and why the run ended.

    Raises:
        InputError: the format is unknown, or the folder cannot be written.

    Example:
        >>> from surctl.recorded import read_recorded
        >>> from surctl.system import run_system, save_record
        >>> from surctl.testing import cart_system
        >>> file = save_record(run_system(cart_system(), 2.0), "cart.nc")
        >>> read_recorded(file).numbers("speed")[:2].round(3).tolist()
        [1.0, 0.9]
    """
    path = Path(path)
    kind = path.suffix.removeprefix(".")
    if kind not in RECORD_FORMATS:
        raise InputError("has no known format", file=path, remedy="end the name in .csv, .mat or .nc")
    if kind == "csv":
        return write_csv(path, {head: column.tolist() for head, column in record.table().items()})
    texts = identity(record.system) | _outcome(record) | dict(about or {})
    if kind == "nc":
        return write_netcdf(path, record.columns(), sizes={"time": len(record.time)}, attributes=texts)
    return write_mat(path, _identifiers(record.columns()), texts={"identity": texts})


def _outcome(record: Record) -> dict[str, str]:
    controller, costs = record.system.controller, record.system.costs
    gains = {name: np.ravel(value).tolist() for name, value in controller.gains.unpack(record.controller[2]).items()}
    figures = {
        name: {"value": value if np.isfinite(value) else None, "unit": costs[name].unit, "how": costs[name].how}
        for name, value in record.figures.items()
    }
    return {
        "stopped": record.stopped,
        "not_finite": record.lost,
        "gains": json.dumps(gains),
        "costs": json.dumps(figures),
    }


def _identifiers(columns: Mapping[str, Column]) -> dict[str, Column]:
    named: dict[str, Column] = {}
    for label, column in columns.items():
        name = re.sub(r"\W+", "_", label).strip("_")
        while name in named or name in _TEXTS:
            name += "_"
        named[name] = column
    return named

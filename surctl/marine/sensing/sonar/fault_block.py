"""Sonar faults in CasADi symbols for the compiled closed loop, with the results of `faulty`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import Port
from surctl.marine.sensing.sonar.array import SonarArray
from surctl.marine.sensing.sonar.echo import echo_samples
from surctl.marine.sensing.sonar.faults import (
    FAULT_KINDS,
    LONGEST_DELAY,
    SLACK,
    Fault,
    FaultChances,
    FaultKind,
    check_faults,
    delay_firings,
    fault_end,
)

__all__ = ["SLOT", "Arrival", "fault_ports", "fault_slots", "faulty_samples"]

SLOT = 5
"""Number of values that describe one fault: code of kind (0: none), sensor, start [s], end [s], delay [firings]."""

_NEVER = 1e30  # s


class Arrival(NamedTuple):
    """The result of `faulty_samples`, as CasADi SX expressions."""

    samples: ca.SX
    """(samples, 1) samples of the firing [m]; if none arrive, the samples that arrived last from the sensor."""
    arrived: ca.SX
    """1 if samples arrive, else 0."""
    state: dict[str, ca.SX]
    """Next state: value of each entry, by name."""


def fault_slots(array: SonarArray, faults: Sequence[Fault], count: int) -> NDArray[np.float64]:
    """Return the faults as an array (count, SLOT), one fault per row in the given order; unused rows are 0.

    Raises:
        InputError: if there are more than `count` faults, or a fault is impossible for the array.

    Example:
        >>> from surctl.marine.sensing import Fault, SonarArray, fault_slots
        >>> fault = Fault(sensor=1, kind="dropout", start_s=2.0, duration_s=0.5)
        >>> fault_slots(SonarArray(), [fault], 2).tolist()  # kind, sensor, start, end, delay
        [[1.0, 1.0, 2.0, 2.5, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0]]
    """
    if len(faults) > count:
        raise InputError(
            f"{len(faults)} are given, but at most {count} are possible", key="faults", remedy="give fewer"
        )
    check_faults(array, faults)
    slots = np.zeros((count, SLOT))
    for k, fault in enumerate(faults):
        end = min(fault_end(array, fault), _NEVER)
        slots[k] = _code(fault.kind), fault.sensor, fault.start_s, end, delay_firings(array, fault)
    return slots


def fault_ports(array: SonarArray, *, delays: bool, prefix: str = "") -> tuple[Port, ...]:
    """Return the entries (name, shape, initial value) of the fault state.

    The state consists of the samples that arrived last from each sensor and, with `delays`, of earlier samples. Each
    row of the earlier samples holds the samples of the last `LONGEST_DELAY` firings of one sensor, newest firing first.

    Example:
        >>> from surctl.marine.sensing import SonarArray, fault_ports
        >>> [(port.name, port.shape) for port in fault_ports(SonarArray(), delays=True)]  # 5 samples of 8 firings
        [('last', (4, 5)), ('history', (4, 40))]
    """
    n, samples, far = array.size, array.samples, array.maximum
    last = Port(f"{prefix}last", (n, samples), "m", "samples that arrived last from each sonar", far)
    if not delays:
        return (last,)
    meaning = "fault-free samples of each sonar's last firings, newest first"
    return (last, Port(f"{prefix}history", (n, LONGEST_DELAY * samples), "m", meaning, far))


def faulty_samples(
    array: SonarArray,
    state: Mapping[str, ca.SX],
    sensor: ca.SX,
    *,
    time: ca.SX,
    distance: ca.SX,
    noise: ca.SX,
    slots: ca.SX,
    chances: ca.SX,
    uniforms: ca.SX,
    delays: bool,
    prefix: str = "",
) -> Arrival:
    """Return the samples that arrive from one firing, and the next fault state; see `faulty`.

    Args:
        array: the sonar array.
        state: value of each entry of `fault_ports`, by name.
        sensor: index of the sensor that fires.
        time: time of the firing [s].
        distance: range to the nearest reflecting point [m], from `echo_range`.
        noise: (samples, 1) standard normal numbers.
        slots: (k, SLOT) scheduled faults from `fault_slots`; k may be 0.
        chances: (6, 1) probabilities of random faults, from `FaultChances.numbers`.
        uniforms: (2, 1) uniform numbers in (0, 1): the first selects the random fault, the second gives the value of a
            spike.
        delays: whether the state holds the samples of earlier firings; if not, no scheduled fault may be a delay.
        prefix: prefix of the names of the state's entries.

    Example:
        >>> import casadi as ca
        >>> from surctl.ir import Layout
        >>> from surctl.marine.sensing import Fault, SonarArray, fault_ports, fault_slots, faulty_samples
        >>> array, time = SonarArray(samples=1), ca.SX.sym("time")
        >>> layout = Layout(fault_ports(array, delays=False))
        >>> slots = ca.SX(fault_slots(array, [Fault(sensor=0, kind="zero", start_s=1.0)], 1))
        >>> random = {"noise": ca.SX(0.0), "chances": ca.SX.zeros(6), "uniforms": ca.SX([0.5, 0.5])}
        >>> flat, state = layout.symbols()
        >>> one = {"distance": ca.SX(1.0), "slots": slots, "delays": False}
        >>> arrival = faulty_samples(array, state, ca.SX(0), time=time, **one, **random)
        >>> samples = ca.Function("samples", [flat, time], [arrival.samples])
        >>> samples(layout.pack(), 0.5), samples(layout.pack(), 1.5)
        (DM(1.00588), DM(0))
    """
    own = echo_samples(array, distance, noise=noise)
    last = state[f"{prefix}last"]
    kind, late, start = _active_fault(slots, sensor, time)
    kind = ca.if_else(kind > 0, kind, _struck(chances, uniforms[0]))
    before = [array.order[array.order.index(i) - 1] for i in range(array.size)]
    mine = _row(sensor, [last[i, :].T for i in range(array.size)])
    choices: dict[FaultKind, ca.SX | float] = {
        "stuck": mine,
        "zero": 0.0,
        "maximum": array.maximum,
        "spike": _spike(array, uniforms[1]),
        "second_echo": echo_samples(array, 2.0 * distance, noise=noise),
        "crosstalk": _row(sensor, [last[i, :].T for i in before]),
    }
    samples = own
    for name, value in choices.items():
        samples = ca.if_else(kind == _code(name), value, samples)
    lost = ca.logic_or(kind == _code("dropout"), kind == _code("dead"))
    after = {}
    if delays:
        rows = [state[f"{prefix}history"][i, :].T for i in range(array.size)]
        delayed = kind == _code("delay")
        waiting = time - late * array.cycle < start - SLACK
        lost = ca.logic_or(lost, ca.logic_and(delayed, waiting))
        history = _row(sensor, rows)
        old = [history[k * array.samples : (k + 1) * array.samples] for k in range(LONGEST_DELAY)]
        samples = ca.if_else(delayed, _row(late - 1, old), samples)
        shifted = ca.vertcat(own, history[: -array.samples])
        after[f"{prefix}history"] = ca.vertcat(*(ca.if_else(sensor == i, shifted, row).T for i, row in enumerate(rows)))
    samples = ca.if_else(lost, mine, samples)
    after[f"{prefix}last"] = ca.vertcat(*(ca.if_else(sensor == i, samples.T, last[i, :]) for i in range(array.size)))
    return Arrival(samples, ca.logic_not(lost), after)


def _active_fault(slots: ca.SX, sensor: ca.SX, time: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    # code, delay and start; code 0 if no fault is active
    kind, late, start = ca.SX(0), ca.SX(0), ca.SX(0)
    for k in reversed(range(slots.shape[0])):
        code, whose, begin, end, firings = (slots[k, j] for j in range(SLOT))
        acts = ca.logic_and(whose == sensor, ca.logic_and(time >= begin - SLACK, time < end - SLACK))
        kind, late, start = (ca.if_else(acts, new, old) for new, old in ((code, kind), (firings, late), (begin, start)))
    return kind, late, start


def _struck(chances: ca.SX, uniform: ca.SX) -> ca.SX:
    # code 0 if no fault occurs
    passed, code, below = ca.SX(0), ca.SX(0), ca.SX(0)
    for k, kind in enumerate(FaultChances.kinds()):
        passed = passed + chances[k]
        now = uniform < passed
        code = ca.if_else(ca.logic_and(now, ca.logic_not(below)), _code(kind), code)
        below = now
    return code


def _spike(array: SonarArray, uniform: ca.SX) -> ca.SX:
    value, top = array.lowest + uniform * (array.maximum - array.lowest), float(array.top_code)
    return ca.floor(value * top / array.maximum + 0.5) * array.maximum / top


def _row(index: ca.SX, rows: Sequence[ca.SX]) -> ca.SX:
    selected = rows[0]
    for k, row in enumerate(rows[1:], 1):
        selected = ca.if_else(index == k, row, selected)
    return selected


def _code(kind: FaultKind) -> int:
    return 1 + FAULT_KINDS.index(kind)

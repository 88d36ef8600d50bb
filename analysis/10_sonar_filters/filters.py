"""The compared filters, each over many runs at once: the clearance that a law would use at every step."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import casadi as ca
import numpy as np
from echoes import ARRAY, DT, EVERY
from numpy.typing import NDArray
from streams import Stream, joined

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.ir import Layout
from surctl.marine.sensing import RangeTracker, SensorFilter
from surctl.marine.sensing.ranging.filters import StepRule
from surctl.marine.sensing.ranging.tracker import Ranging
from tests.oracles.range_filters import plain_average, plain_filter, plain_gate

Array = NDArray[np.float64]
TOGETHER = 1000  # runs
TRACKER = RangeTracker(array=ARRAY, dt=DT)
LAYOUT = Layout(TRACKER.ports())


@dataclass(frozen=True)
class Estimate:
    """Range of sensor 0 [m] and whether the filter calls it healthy, (runs, steps) each."""

    range: Array
    healthy: Array


@dataclass(frozen=True)
class Tracked(Estimate):
    """Further outputs of the tracker, (runs, steps) each."""

    bound: Array
    accepted: Array
    reading: Array
    carve: Array
    rate: Array


Found = TypeVar("Found", bound=Estimate)


def raw(stream: Stream) -> Estimate:
    """Return the newest sample."""
    return _held(stream, lambda samples: samples[..., -1])


def average(stream: Stream) -> Estimate:
    """Return the weighted average of a firing."""
    return _held(stream, plain_average)


def gated(stream: Stream) -> Estimate:
    """Return average and gate (4)–(5), with the defaults of `SensorFilter`."""
    values = plain_average(stream.run.samples[:, :, 0])
    window = np.repeat(values[:, :1], SensorFilter().window, axis=1)
    out = np.empty_like(values)
    last = values[:, 0]
    for k in range(values.shape[1]):
        value, _, after = plain_gate(window, values[:, k], lambda1=3.0, resolution=ARRAY.resolution)
        fresh = stream.fresh[:, k, 0] > 0.5
        last = np.where(fresh, value, last)
        window = np.where(fresh[:, None], after, window)
        out[:, k] = last
    return _spread(out)


def lms(rule: StepRule) -> Callable[[Stream], Estimate]:
    """Return average, gate and Algorithm 1: `SensorFilter`, which the law `paper` uses."""

    def run(stream: Stream) -> Estimate:
        filter_ = SensorFilter(array=ARRAY, step=rule)
        runs, firings = stream.run.samples.shape[:2]
        state = {port.name: np.full((runs, *port.shape), port.default) for port in filter_.ports()}
        gains = {port.name: port.default for port in filter_.gain_ports()}
        ranges, healthy = np.empty((runs, firings)), np.empty((runs, firings))
        for k in range(firings):
            found = plain_filter(filter_, state, stream.run.samples[:, k], fresh=stream.fresh[:, k], gains=gains)
            state = found.state
            ranges[:, k], healthy[:, k] = found.range_hat[:, 0], found.healthy[:, 0]
        return Estimate(_spread(ranges).range, np.repeat(healthy, EVERY, axis=1))

    return run


def _tracker_step(runs: int) -> ca.Function:
    """Return the tracker's step for many runs: state, samples, fresh, closing, expected, turn → state, `Ranging`."""
    n = ARRAY.size
    x, parts = LAYOUT.symbols("x")
    samples, turn = ca.SX.sym("s", n, ARRAY.samples), ca.SX.sym("w")
    fresh, closing, expected = (ca.SX.sym(name, n) for name in ("f", "c", "e"))
    done = TRACKER.update(parts, samples, fresh=fresh, closing=closing, expected=expected, turn=turn)
    inputs = [x, samples, fresh, closing, expected, turn]
    return ca.Function("tracker", inputs, [LAYOUT.join(done.state), *done[1:]]).map(runs)


def robust(stream: Stream) -> Tracked:
    """`RangeTracker`."""
    run = stream.run
    runs, steps, sensors = run.truth.shape
    step, state = _tracker_step(runs), np.tile(LAYOUT.pack(), (runs, 1)).T
    names = ("range", "healthy", "bound", "accepted", "reading", "carve", "rate")
    out = {name: np.empty((runs, steps)) for name in names}
    nothing = np.zeros((sensors, runs))
    for k in range(steps):
        firing, between = divmod(k, EVERY)
        samples = run.samples[:, firing].transpose(1, 0, 2).reshape(sensors, -1)
        fresh = nothing if between else stream.fresh[:, firing].T
        state, *found = step(state, samples, fresh, run.closing[:, k].T, run.expected[:, k].T, run.turn[:, k][None])
        now = dict(zip(Ranging._fields[1:], found, strict=True))
        for name in names:
            out[name][:, k] = np.asarray(now[name])[0]
    return Tracked(**out)


def each(filter_: Callable[[Stream], Found], streams: Sequence[Stream]) -> Iterator[Found]:
    """Return the filter's outputs for all runs; a few runs are computed together, which takes as long as one run."""
    size = len(streams[0].begin)
    at_once = max(1, TOGETHER // size)
    for first in range(0, len(streams), at_once):
        group = streams[first : first + at_once]
        found = filter_(joined(group))
        for k in range(len(group)):
            part = slice(k * size, (k + 1) * size)
            yield type(found)(**{name: value[part] for name, value in vars(found).items()})


FILTERS: dict[str, Callable[[Stream], Estimate]] = {
    "raw": raw,
    "average": average,
    "gate": gated,
    "LMS printed": lms("printed"),
    "LMS corrected": lms("corrected"),
    "robust": robust,
}


def _held(stream: Stream, value: Callable[[Array], Array]) -> Estimate:
    """Return one value per firing, held until the next firing arrives."""
    values, fresh = value(stream.run.samples[:, :, 0]), stream.fresh[:, :, 0] > 0.5
    index = np.maximum.accumulate(np.where(fresh, np.arange(values.shape[1]), 0), axis=1)
    return _spread(np.take_along_axis(values, index, axis=1))


def _spread(values: Array) -> Estimate:
    held = np.repeat(values, EVERY, axis=1)
    return Estimate(held, np.ones_like(held))

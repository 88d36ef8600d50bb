"""Faults of one sensor's stream, each alone, from a drawn time on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from echoes import ARRAY, EVERY, Approach
from numpy.typing import NDArray

Array = NDArray[np.float64]
FAULTS = ("dropout", "dead", "stuck", "zero", "maximum", "spike", "second echo", "crosstalk", "delay")
FIRST = 10  # firings that the sensor had to be heard at all


@dataclass(frozen=True)
class Stream:
    """What arrives of an approach.

    Attributes:
        run: the approach, with the samples that arrive.
        fresh: (runs, firings, sensors) 1 where they do.
        begin: (runs,) first firing at which the fault shows; the number of firings where there is none.
        end: (runs,) first firing after it.
    """

    run: Approach
    fresh: Array
    begin: NDArray[np.int64]
    end: NDArray[np.int64]


def honest(run: Approach) -> Stream:
    """No fault."""
    runs, firings, sensors, _ = run.samples.shape
    never = np.full(runs, firings)
    return Stream(run, np.ones((runs, firings, sensors)), never, never)


def faulty(run: Approach, fault: str, *, seed: int) -> Stream:
    """One fault of sensor 0 a run: when it begins and how long it lasts is drawn; dead and delay last."""
    rng = np.random.default_rng(seed)
    runs, firings = run.samples.shape[:2]
    samples, fresh = run.samples.copy(), np.ones(run.samples.shape[:3])
    begin = rng.integers(FIRST, firings - 10, runs)
    length = rng.integers(3, firings, runs)
    if fault == "spike":
        length[:] = 1
    elif fault in ("dead", "delay"):
        length[:] = firings
    elif fault == "dropout":
        length = rng.integers(1, 50, runs)
    end = np.minimum(begin + length, firings)
    index = np.arange(firings)
    active = (index >= begin[:, None]) & (index < end[:, None])
    own = samples[:, :, 0]
    far, shape = ARRAY.maximum, own.shape
    late = rng.integers(1, 9, runs)
    if fault in ("dropout", "dead"):
        fresh[:, :, 0] = ~active
    elif fault == "delay":
        fresh[:, :, 0] = ~(active & (index < (begin + late)[:, None]))
        source = np.where(active, np.maximum(index - late[:, None], 0), index)
        samples[:, :, 0] = own[np.arange(runs)[:, None], source]
    else:
        last = own[np.arange(runs), begin - 1]
        false = {
            "stuck": np.broadcast_to(last[:, None], shape),
            "zero": np.zeros(shape),
            "maximum": np.full(shape, far),
            "spike": np.broadcast_to(rng.uniform(0, far, runs)[:, None, None], shape),
            "second echo": np.minimum(2.0 * own, far),
            "crosstalk": samples[:, :, 1],
        }[fault]
        samples[:, :, 0] = np.where(active[..., None], false, own)
    return Stream(replace(run, samples=samples), fresh, begin, end)


def tracked(tracker, stream: Stream):
    """Ranges, bounds, health, acceptance, readings of sensor 0 over a stream, (runs, steps) each."""
    run = stream.run
    runs, steps, sensors = run.truth.shape
    state = tracker.start((runs,))
    names = ("range", "bound", "healthy", "accepted", "reading", "rate", "carve", "age")
    out = {name: np.empty((runs, steps)) for name in names}
    idle = np.zeros((runs, sensors))
    for k in range(steps):
        firing, now = divmod(k, EVERY)
        found = tracker.step(
            state,
            run.samples[:, firing],
            fresh=stream.fresh[:, firing] if now == 0 else idle,
            closing=run.closing[:, k],
            expected=run.expected[:, k],
            turn=run.turn[:, k],
        )
        state = found.state
        for name in names:
            out[name][:, k] = getattr(found, name)[:, 0]
    return out

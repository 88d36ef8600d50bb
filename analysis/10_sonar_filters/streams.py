"""Faults in the readings of one sensor, one at a time, each from a random time on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from echoes import ARRAY, EVERY, Approach
from numpy.typing import NDArray

Array = NDArray[np.float64]
FAULTS = ("dropout", "dead", "stuck", "zero", "maximum", "spike", "second echo", "crosstalk", "delay")
FIRST = 10  # firings without a fault at the start


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


def shows(stream: Stream, honest_samples: Array, *, off: Array) -> NDArray[np.int64]:
    """First firing at which the fault shows, (runs,); the number of firings where it never does.

    Nothing arrives, or what does is off the truth by more than `off` (runs, firings) [m].
    """
    run = stream.run
    firings = stream.fresh.shape[1]
    value = np.sort(run.samples[:, :, 0], axis=-1)[..., 1:-1].mean(axis=-1)
    wrong = np.abs(value - run.seen[:, ::EVERY, 0]) > off
    index = np.arange(firings)
    active = (index >= stream.begin[:, None]) & (index < stream.end[:, None])
    changed = np.any(run.samples[:, :, 0] != honest_samples[:, :, 0], axis=-1)
    seen = active & ((stream.fresh[:, :, 0] < 0.5) | (wrong & changed))
    return np.where(seen.any(axis=1), seen.argmax(axis=1), firings)


def joined(streams: Sequence[Stream]) -> Stream:
    """Join the runs of several streams."""

    def along(name: str) -> Array:
        return np.concatenate([getattr(s.run, name) for s in streams])

    fields = ("truth", "closing", "expected", "turn", "speed", "samples")
    run = Approach(time=streams[0].run.time, **{name: along(name) for name in fields})
    whole = (np.concatenate([getattr(s, name) for s in streams]) for name in ("fresh", "begin", "end"))
    return Stream(run, *whole)


def honest(run: Approach) -> Stream:
    """No fault."""
    runs, firings, sensors, _ = run.samples.shape
    never = np.full(runs, firings)
    return Stream(run, np.ones((runs, firings, sensors)), never, never)


def faulty(run: Approach, fault: str, *, seed: int) -> Stream:
    """Return runs with one fault of sensor 0: begin and duration are random; the faults dead and delay do not end."""
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

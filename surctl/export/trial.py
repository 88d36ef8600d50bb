"""Single steps on which every build is compared with Python: near recorded runs, far from them, and with NaN."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from surctl.export.contract import Exportable
from surctl.export.envelope import Envelope
from surctl.export.precision import rounded
from surctl.export.records import Records
from surctl.ir import Real

__all__ = ["MOST_NUMBERS", "trial_steps"]

Vector = NDArray[np.float64]

MOST_NUMBERS = 20_000_000
"""Largest count of numbers in all steps together; a law with a large state is tried in fewer steps."""

_SMALL, _WIDE = 1e-3, 2.0
_BROKEN = (np.nan, np.inf, -np.inf)
_TURNS = 256  # number of successive steps with the same gains


def trial_steps(
    law: Exportable,
    runs: Sequence[Records],
    count: int,
    *,
    real: Real = "float64",
    seed: int = 0,
    within: Envelope | None = None,
) -> Records:
    """Return up to `count` steps (at most `MOST_NUMBERS` numbers): recorded steps, changed in eight ways in turn.

    The eight ways are: (0) the step as recorded; (1) and (2) a recorded step at which a branch of the law changes, with
    all numbers (1) or about one number (2) replaced by the next larger or smaller float; (3) and (6) the step slightly
    perturbed; (4) the step widely perturbed; (5) some numbers replaced by 0, 1 or their negative; (7) one number NaN or
    infinite. In every second group of 256 steps, the gains change by up to 10 %.

    Args:
        law: the law.
        runs: recorded runs of the law.
        count: largest number of steps.
        real: precision of the target, which defines the next float.
        seed: seed of the random numbers.
        within: ranges that the input check accepts. Perturbed numbers stay inside these ranges, and widely perturbed
            numbers cover the whole ranges, so that the steps test the law and not only the input check.
    """
    rng = np.random.default_rng(seed)
    X = np.concatenate([run.X for run in runs])
    U = np.concatenate([run.U for run in runs])
    switches = np.flatnonzero(np.concatenate([_switches(run) for run in runs]))
    size = X.shape[1] + U.shape[1]
    count = min(count, max(1, MOST_NUMBERS // (size + runs[0].P.shape[1])))
    at = rng.integers(0, len(X), count)
    kind = np.arange(count) % 8
    if switches.size:
        edge = np.isin(kind, (1, 2))
        at[edge] = rng.choice(switches, int(edge.sum()))
    rows = rounded(np.hstack([X[at], U[at]]), real)
    _shift(rows, np.flatnonzero(kind == 1), rng, real, share=1.0)
    _shift(rows, np.flatnonzero(kind == 2), rng, real, share=1.0 / size)
    for which, spread in ((3, _SMALL), (4, _WIDE), (6, _SMALL)):
        chosen = kind == which
        part = rows[chosen]
        rows[chosen] = part + spread * (1.0 + np.abs(part)) * rng.uniform(-1.0, 1.0, part.shape)
    if within is not None:
        box = np.vstack([within.state, within.inputs])
        shaken = np.isin(kind, (3, 4, 6))
        rows[shaken] = np.clip(rows[shaken], box[:, 0], box[:, 1])
        _anywhere(rows, np.flatnonzero(kind == 4), box, rng)
    part = rows[kind == 5]
    swapped = rng.choice(3, part.shape)
    part = np.where(rng.random(part.shape) < 0.1, np.where(swapped < 2, swapped, -part), part)
    rows[kind == 5] = part
    broken = np.flatnonzero(kind == 7)
    rows[broken, rng.integers(0, size, len(broken))] = rng.choice(_BROKEN, len(broken))
    gains = np.repeat(runs[0].P[:1], count, axis=0)
    factors = rng.uniform(0.9, 1.1, (count // _TURNS + 1, gains.shape[1]))
    factors[::2] = 1.0
    gains *= np.repeat(factors, _TURNS, axis=0)[:count]
    if within is not None:
        gains = np.clip(gains, within.gains[:, 0], within.gains[:, 1])
        for pair in within.orders:
            gains[:, pair] = np.sort(gains[:, pair], axis=1)
    return Records(rows[:, : X.shape[1]], rows[:, X.shape[1] :], gains)


def _anywhere(rows: Vector, at: NDArray[np.intp], box: Vector, rng: np.random.Generator) -> None:
    # random numbers in the range, more often near the old value
    bounded = np.flatnonzero(np.abs(box).max(axis=1) < 1e30)
    low, high = box[bounded].T
    part = np.clip(rows[np.ix_(at, bounded)], low, high)
    far = rng.uniform(-1.0, 1.0, part.shape) ** 3
    rows[np.ix_(at, bounded)] = np.clip(part + np.where(far > 0, (high - part) * far, (part - low) * far), low, high)


def _switches(run: Records) -> NDArray[np.bool_]:
    # (T,): an integer of state or input changes after the step, which shows that the law switches
    rows = np.hstack([run.X, run.U])
    whole = np.all(rows == np.floor(rows), axis=0)
    flips = (rows[1:, whole] != rows[:-1, whole]).any(axis=1)
    return np.append(flips, False)


def _shift(rows: Vector, at: NDArray[np.intp], rng: np.random.Generator, real: Real, *, share: float) -> None:
    # with probability `share`, to the next float of `real` up or down
    part = rows[at].astype(np.float64 if real == "float64" else np.float32)
    up = rng.random(part.shape) < 0.5
    near = np.nextafter(part, np.where(up, np.inf, -np.inf).astype(part.dtype))
    rows[at] = np.where(rng.random(part.shape) <= share, near, part)

"""Study 20, second part: are intervals wrong because of the estimates, or because of their estimated widths?

    python analysis/20_identification/widths.py            # four minutes on an idle core
    python analysis/20_identification/widths.py --quick    # one log of half the length

The logs are those of coloured.py. Each fit begins at the true parameters, which takes a third of the time of a whole
fit and ends in the same minimum. Beside each interval stands the one that follows from the known noise.

Prints Markdown. The exit status is 0 if every statement holds, and 1 otherwise.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from coloured import CONSTANT_FORCE, FITTED, NOISE, SEED, drawn, log_of, nominal
from numpy.typing import NDArray

from surctl.marine.vehicle.identification.intervals import spread_of
from surctl.marine.vehicle.identification.model import Model, sections_of
from surctl.marine.vehicle.identification.solve import minimise

NAMES = FITTED + CONSTANT_FORCE
PERIOD = 0.02  # s, mean
INTERVALS, WIDE = 0.90, 1.2  # bars

Array = NDArray[np.float64]


def trial(seed: int, *, share: float = 1.0) -> tuple[Array, Array, Array]:
    """Return estimate minus truth, half-interval, and half-interval with known noise, each (17,) in SI units."""
    rng = np.random.default_rng([SEED, seed])
    start = nominal()
    p = drawn(start, rng)
    with _times() as times:
        log, _ = log_of(p, start, rng, share=share)
    correlation = np.array(times)
    sections = sections_of(log)
    model = Model(log, start, sections)
    truth = (np.array([dict(zip(NAMES, p, strict=True))[k] for k in model.names]) - model.start) / model.scale
    theta, noise, free = model.begin(sections), NOISE.copy(), np.ones(model.size, dtype=bool)
    theta[: model.size] = truth
    freedom = 1.0 - len(theta) / model.present.sum()
    for _ in range(3):
        theta, _ = minimise(model, theta, noise, sections, free=free)
        squares = np.sum([np.sum(e**2, axis=0) for e in model.misfit(theta, sections)], axis=0)
        noise = np.sqrt(squares / model.present.sum(axis=0) / freedom)
    parts, prior = model.slopes(theta, noise, sections), model.prior(sections)[1]
    weights = prior[: model.size], prior[model.size : model.size + model.local]
    spread = spread_of(parts, [model.present[s.rows] for s in sections], *weights)
    known = _known(parts, noise, correlation, *weights)
    return (theta[: model.size] - truth) * model.scale, spread.half_intervals() * model.scale, known * model.scale


@contextmanager
def _times() -> Iterator[list[float]]:
    # correlation times of the slow noise of each column that `log_of` draws meanwhile
    import coloured

    times: list[float] = []
    original = coloured.slow_and_white

    def noted(count: int, rng: np.random.Generator) -> Array:
        state = rng.bit_generator.state
        times.append(float(rng.uniform(0.1, 0.6)))
        rng.bit_generator.state = state
        return original(count, rng)

    coloured.slow_and_white = noted
    try:
        yield times
    finally:
        coloured.slow_and_white = original


def _known(parts: list[tuple[Array, Array]], noise: Array, times: Array, prior: Array, first: Array) -> Array:
    # half-intervals of the scaled parameters (p,) with the covariance of the noise by which the logs were made
    size, count = len(prior), 1 << (2 * max(len(e) for e, _ in parts)).bit_length()
    phi, angle = np.exp(-PERIOD / times), 2 * np.pi * np.arange(count // 2 + 1)[:, None] / count
    spectrum = (NOISE / noise) ** 2 * 0.5 * (1 + (1 - phi**2) / np.abs(1 - phi * np.exp(-1j * angle)) ** 2)
    weight = np.full(count // 2 + 1, 2.0)
    weight[[0, -1]] = 1.0
    information, meat = np.diag(prior), np.zeros((size, size))
    for _, slope in parts:
        flat = slope.reshape(-1, slope.shape[-1])
        over_p, own = flat[:, :size], flat[:, size:]
        reduced = over_p - own @ np.linalg.solve(own.T @ own + np.diag(first), own.T @ over_p)
        information += reduced.T @ reduced
        wave = np.fft.rfft(reduced.reshape(*slope.shape[:2], size), count, axis=0)
        scaled = wave * np.sqrt(weight[:, None] * spectrum / count)[:, :, None]
        meat += np.tensordot(np.conj(scaled), scaled, ((0, 1), (0, 1))).real
    inverse = np.linalg.inv(information)
    return np.asarray(1.96 * np.sqrt(np.diag(inverse @ meat @ inverse)))


def main() -> int:
    """Print the table; return 1 if a statement does not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one log of half the length")
    count, share = (1, 0.5) if parser.parse_args().quick else (200, 1.0)
    results = []
    for seed in range(count):
        results.append(trial(seed, share=share))
        if count > 1:
            sys.stderr.write(f"  {seed + 1} of {count}\n")
    error, half, known = (np.array(x) for x in zip(*results, strict=True))
    inside, with_known = (np.sum(np.abs(error) <= h, axis=0) for h in (half, known))
    wide = 1.0 / (1.96 * np.sqrt(np.mean((error / half) ** 2, axis=0)))
    print("| parameter | in its 95 % interval | in that with known noise | width over scatter |\n|---|---|---|---|")
    for name, *row in zip(NAMES, inside, with_known, wide, strict=True):
        print(f"| {name} | {row[0]} of {count} | {row[1]} of {count} | {row[2]:.2f} |")
    statements = {
        f"every parameter is in its interval in at least {INTERVALS:.0%} (least {inside.min()} of {count}; with known "
        f"noise {with_known.min()})": inside.min() >= INTERVALS * count,
        f"no interval is more than {WIDE:g} times as wide as the scatter needs ({wide.max():.2f})": wide.max() <= WIDE,
    }
    print("\n| statement | holds |\n|---|---|")
    for text, holds in statements.items():
        print(f"| {text} | {'holds' if holds else '**does not hold**'} |")
    return 0 if count == 1 or all(statements.values()) else 1


if __name__ == "__main__":
    sys.exit(main())

"""Study 20, second part: logs with a constant force, coloured noise, gaps and unequal sampling at 50 Hz.

    python analysis/20_identification/coloured.py            # half an hour on two cores
    python analysis/20_identification/coloured.py --quick    # one log of half the length
    python analysis/20_identification/coloured.py --progress fits.jsonl    # continues where an earlier run stopped

Each log is of another vehicle, drawn from ranges around a sphere with 40 N of thrust. A constant force of 8 N
acts on it. The first 60 s are fitted, the next 30 s are predicted in windows of 5 s. A second fit of the same model,
written here with SciPy's least squares and an integrator of its own, starts at the truth and predicts the same windows.

Prints Markdown. The exit status is 0 if every statement holds, and 1 otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from conclusion import concluded
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from surctl.marine.vehicle import CONSTANT_FORCE, FITTED, LOG_MOTION, MotionLog, Vehicle, identify, predict, sphere
from surctl.marine.vehicle.identification.prediction import predict_with

SEED = 2020
FITTED_S, HELD_S = 60.0, 30.0
NOISE = np.array([0.01, 0.01, 0.01, 0.02, 0.01, 0.01, 0.01, 0.02])  # m, rad, m/s, rad/s
TRIM = 8.0  # N
NAMES = FITTED + CONSTANT_FORCE
INTERVALS, WIDE, ERRORS, FILE = 0.90, 1.2, 1.05, 1.01  # bars

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """The fit to one log: truth in the intervals, and RMS errors of held-out velocities."""

    inside: dict[str, bool]
    identified: tuple[str, ...]
    error: dict[str, float]  # estimate minus truth
    half: dict[str, float]
    file: dict[str, float]  # RMS of the held-out errors, by column: of the vehicle in the file
    free: dict[str, float]  # of the fit with all parameters free
    hold: dict[str, float]  # of the last speed held
    scipy: dict[str, float] | None
    seconds: float


def nominal() -> Vehicle:
    """Return the vehicle at which every fit starts."""
    return sphere("nominal", diameter=0.54, dry_mass=7.9, thrust=40.0, yaw_thrust=4.0)


def rate(x: Array, command: Array, p: Array) -> Array:
    """Return ẋ (12, …) of equations (1)–(3) with a constant force; p (17, …) has the order of `NAMES`."""
    psi, (u, v, w, r), tau = x[3], x[4:8], x[8:12]
    m, linear, quadratic, lag, constant = p[0:4], p[4:8], p[8:12], p[12], p[13:17]
    nu = x[4:8]
    coriolis = np.array([-m[1] * v * r, m[0] * u * r, 0.0 * u, (m[1] - m[0]) * u * v])
    load = tau + constant - coriolis - linear * nu - quadratic * nu * np.abs(nu)
    c, s = np.cos(psi), np.sin(psi)
    pose = np.array([c * u - s * v, s * u + c * v, w, r])
    return np.concatenate([pose, load / m, (command - tau) / lag])


def integrated(begin: Array, command: Array, dt: Array, p: Array, parts: int) -> Array:
    """Return the states (n, 12, …) at every row, by RK4 with `parts` steps per row."""
    x, rows = begin, [begin]
    for k, step in enumerate(dt):
        force = command[k].reshape(4, *([1] * (begin.ndim - 1)))
        h = step / parts
        for _ in range(parts):
            k1 = rate(x, force, p)
            k2 = rate(x + h / 2 * k1, force, p)
            k3 = rate(x + h / 2 * k2, force, p)
            k4 = rate(x + h * k3, force, p)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        rows.append(x)
    return np.array(rows)


def drawn(start: Vehicle, rng: np.random.Generator) -> Array:
    """Return the true parameters (17,), within ±25 % of the nominal ones, and 8 N in a random direction."""
    p = np.array([start[k] for k in FITTED]) * rng.uniform(0.75, 1.25, len(FITTED))
    p[4:8] += rng.uniform(0.2, 1.0, 4) * np.array([4.0, 4.0, 4.0, 0.3])  # linear drag, which a sphere does not have
    direction = rng.normal(size=3)
    return np.concatenate([p, TRIM * direction / np.linalg.norm(direction), [rng.uniform(-0.3, 0.3)]])


def log_of(p: Array, start: Vehicle, rng: np.random.Generator, *, share: float = 1.0) -> tuple[MotionLog, MotionLog]:
    """Return the part of a log to fit, with gaps, and the part to predict; `share` shortens the log."""
    end, span = share * FITTED_S, share * (FITTED_S + HELD_S)
    dt = rng.uniform(0.01, 0.03, round(span / 0.02))
    time = np.concatenate([[0.0], np.cumsum(dt)])
    command = np.zeros((len(time), 4))
    for axis in range(4):
        changes = np.concatenate([[0.0], np.cumsum(rng.uniform(0.6, 3.0, round(span)))])
        level = rng.uniform(-1.0, 1.0, len(changes)) * start.thrust_limit[axis]
        command[:, axis] = level[np.searchsorted(changes, time, side="right") - 1]
    motion = integrated(np.concatenate([np.zeros(8), command[0]]), command, dt, p, 1)[:, :8]
    motion = motion + NOISE * np.column_stack([slow_and_white(len(time), rng) for _ in range(8)])
    kept = np.ones(len(time), dtype=bool)
    for begin in share * rng.uniform([8.0, 33.0], [25.0, 50.0]):
        kept[(time > begin) & (time < begin + rng.uniform(1.0, 4.0))] = False
    parts = [kept & (time < end), time >= end]
    fitted, held = (MotionLog(time[k], motion[k], command[k], "log") for k in parts)
    return fitted, held


def slow_and_white(count: int, rng: np.random.Generator) -> Array:
    """Return noise (count,) with standard deviation 1: half is white, half has a correlation over 0.1 to 0.6 s."""
    phi = np.exp(-0.02 / rng.uniform(0.1, 0.6))
    slow = lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], rng.normal(size=count + 500))[500:]
    return np.sqrt(0.5) * (slow + rng.normal(size=count))


def scipy_fit(log: MotionLog, start: Vehicle, truth: Array) -> dict[str, float]:
    """Fit the same model with SciPy from the true parameters: finite differences, known noise, no prior."""
    gap = np.flatnonzero(np.diff(log.time) > 0.5) + 1
    parts = [np.arange(a, b) for a, b in zip([0, *gap], [*gap, len(log.time)], strict=True)]
    scale = np.array(
        [
            max(start[k], 0.1 * start[q], 1e-3)
            for k, q in zip(FITTED, (*FITTED[:4], *FITTED[8:12] * 2, "thrust_lag"), strict=True)
        ]
    )
    scale = np.concatenate([scale, start.thrust_limit])
    first = truth / scale
    begin = [np.concatenate([log.motion[rows[0]], log.thrust[rows[0]]]) for rows in parts]
    size = len(NAMES)

    def states(columns: Array) -> Array:
        p = columns[:size] * scale[:, None]
        misfit = []
        for k, rows in enumerate(parts):
            x = columns[size + 12 * k : size + 12 * (k + 1)]
            run = integrated(x, log.thrust[rows], np.diff(log.time[rows]), p, 1)[:, :8]
            misfit.append(((run - log.motion[rows][:, :, None]) / NOISE[:, None]).reshape(-1, columns.shape[1]))
        return np.vstack(misfit)

    def residuals(theta: Array) -> Array:
        return states(theta[:, None])[:, 0]

    def jacobian(theta: Array) -> Array:
        step = 1e-6
        columns = theta[:, None] + np.hstack([step * np.eye(len(theta)), -step * np.eye(len(theta))])
        both = states(columns)
        return (both[:, : len(theta)] - both[:, len(theta) :]) / (2 * step)

    theta = np.concatenate([first, *begin])
    low = np.full(len(theta), -np.inf)
    low[:4], low[12] = 0.05, 0.05
    fit = least_squares(
        residuals, theta, jacobian, (low, np.full(len(theta), np.inf)), xtol=1e-8, ftol=1e-8, max_nfev=30
    )
    return dict(zip(NAMES, (fit.x[:size] * scale).tolist(), strict=True))


def trial(seed: int, *, compared: bool, share: float = 1.0) -> Trial:
    """Draw a vehicle and a log, fit, and predict."""
    rng = np.random.default_rng([SEED, seed])
    start = nominal()
    p = drawn(start, rng)
    fitted, held = log_of(p, start, rng, share=share)
    began = time.perf_counter()
    found = identify(fitted, start, name="fitted")
    taken = time.perf_counter() - began
    truth = dict(zip(NAMES, p.tolist(), strict=True))
    error = {k: v - truth[k] for k, (v, _) in found.estimates.items()}
    inside = {k: abs(error[k]) <= half for k, (_, half) in found.estimates.items()}
    half = {k: h for k, (_, h) in found.estimates.items()}
    own = predict(held, found.vehicle)
    free = predict_with(held, start, {k: v for k, (v, _) in found.estimates.items()})
    other = dict(predict_with(held, start, scipy_fit(fitted, start, p)).model) if compared else None
    return Trial(inside, found.identified, error, half, dict(own.model), dict(free.model), dict(own.hold), other, taken)


def _job(words: tuple[int, bool, float]) -> Trial:
    return trial(words[0], compared=words[1], share=words[2])


def trials(jobs: list[tuple[int, bool, float]], workers: int) -> Iterator[Trial]:
    """Return the trials in order; one worker computes in this process."""
    if workers == 1:
        yield from map(_job, jobs)
        return
    with get_context("spawn").Pool(workers) as pool:
        yield from pool.imap(_job, jobs)


def resumed(jobs: list[tuple[int, bool, float]], workers: int, progress: Path | None) -> Iterator[Trial]:
    """Return the trials in order; those in the file `progress` are read, each further one is appended to it."""
    if progress is None:
        yield from trials(jobs, workers)
        return
    lines = progress.read_text().splitlines() if progress.exists() else []
    compared = {seed for seed, compare, _ in jobs if compare}
    # a fit without SciPy's does not serve where the comparison is asked for
    done = {f["seed"]: f for f in map(json.loads, lines) if f["seed"] not in compared or f["scipy"]}
    fits = trials([job for job in jobs if job[0] not in done], workers)
    for seed, _, _ in jobs:
        if seed in done:
            line = {k: v for k, v in done[seed].items() if k != "seed"}
            yield Trial(**{**line, "identified": tuple(line["identified"])})
            continue
        fit = next(fits)
        with progress.open("a") as file:
            file.write(json.dumps({"seed": seed, **asdict(fit)}) + "\n")
        yield fit


def _mean(found: list[Trial], errors: Callable[[Trial], dict[str, float]], column: str) -> float:
    return float(np.sqrt(np.mean([errors(t)[column] ** 2 for t in found])))


def wide(found: list[Trial], name: str) -> float:
    """Return the width of the intervals of a parameter over the width that its scatter needs: 1.96 sd."""
    return 1.0 / (1.96 * float(np.sqrt(np.mean([(t.error[name] / t.half[name]) ** 2 for t in found]))))


def main() -> int:
    """Print the tables; return 1 if a statement does not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one log of half the length")
    parser.add_argument("--logs", type=int, default=200, help="number of logs (default 200)")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--progress", type=Path, help="file of finished fits, which a later run continues")
    given = parser.parse_args()
    count, compared = (1, 1) if given.quick else (given.logs, min(8, given.logs))
    share = 0.5 if given.quick else 1.0
    found: list[Trial] = []
    jobs = [(k, k >= count - compared, share) for k in range(count)]
    for one in resumed(jobs, given.workers, given.progress):
        found.append(one)
        if not given.quick:
            sys.stderr.write(f"  {len(found)} of {count}: {[k for k, x in one.inside.items() if not x]}\n")
    against = found[count - compared :]
    print(f"{count} logs of {share * FITTED_S:g} s at about 50 Hz, unequal sampling, two gaps, 8 N, coloured noise\n")
    print("| parameter | in its 95 % interval | width over scatter | half-interval, median | identified |")
    print("|---|---|---|---|---|")
    for name in NAMES:
        hits = sum(t.inside[name] for t in found)
        half = np.median([t.half[name] for t in found])
        told = np.mean([name in t.identified for t in found])
        print(f"| {name} | {hits} of {count} | {wide(found, name):.2f} | {half:.2g} | {told:.0%} |")
    print("\n| held-out RMS | file | fit, all free | SciPy | last speed held |\n|---|---|---|---|---|")
    worst_file = worst_scipy = 0.0
    for column in LOG_MOTION:
        file, free = (_mean(found, lambda t, k=k: getattr(t, k), column) for k in ("file", "free"))  # type: ignore[misc]
        mine = _mean(against, lambda t: t.file, column)
        other = _mean(against, lambda t: t.scipy or {}, column)
        worst_file, worst_scipy = max(worst_file, file / free), max(worst_scipy, mine / other)
        print(f"| {column} | {file:.4g} | {free:.4g} | {other:.4g} | {_mean(found, lambda t: t.hold, column):.4g} |")
    inside = float(np.mean([list(t.inside.values()) for t in found]))
    least = min(sum(t.inside[k] for t in found) for k in NAMES)
    widest = max(wide(found, k) for k in NAMES)
    statements = {
        f"the truth lies in its interval in at least {INTERVALS:.0%} ({inside:.1%} of {count * len(NAMES)})": inside
        >= INTERVALS,
        f"of each parameter in at least {INTERVALS:.0%} (least {least} of {count})": least >= INTERVALS * count,
        f"no interval is more than {WIDE:g} times as wide as the scatter needs ({widest:.2f})": widest <= WIDE,
        f"the file predicts within 1 % of the fit itself ({worst_file:.4f})": worst_file <= FILE,
        f"held-out errors are at most {ERRORS:g} times those of SciPy ({worst_scipy:.3f}, {compared} logs)": worst_scipy
        <= ERRORS,
    }
    return concluded(statements, [t.seconds for t in found], quick=given.quick)


if __name__ == "__main__":
    sys.exit(main())

"""Study 20, fourth part: how long does the fit to a log of twenty minutes at 50 Hz with ten gaps take?

    python analysis/20_identification/long.py            # two minutes
    python analysis/20_identification/long.py --quick    # 20 s of log with one gap

The log is one of those of `coloured.py`, but longer. Prints Markdown. The exit status is 0 if every statement holds,
and 1 otherwise; with `--quick`, the time is not judged.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np
from coloured import NAMES, NOISE, drawn, integrated, nominal, slow_and_white

from surctl.marine.vehicle import MotionLog, Vehicle, identify

SEED = 2022
MINUTES, GAPS = 20.0, 10
SECONDS = 60.0  # bar
LEAST = 14  # of 17 parameters in their 95 % intervals; fewer have a probability of 1 %


def log_of(p: np.ndarray, start: Vehicle, rng: np.random.Generator, *, seconds: float, gaps: int) -> MotionLog:
    """Return a log at about 50 Hz with unequal sampling and gaps of 1 to 4 s, spread over its length."""
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.01, 0.03, round(seconds / 0.02)))])
    command = np.zeros((len(times), 4))
    for axis in range(4):
        changes = np.concatenate([[0.0], np.cumsum(rng.uniform(0.6, 3.0, round(seconds)))])
        level = rng.uniform(-1.0, 1.0, len(changes)) * start.thrust_limit[axis]
        command[:, axis] = level[np.searchsorted(changes, times, side="right") - 1]
    motion = integrated(np.concatenate([np.zeros(8), command[0]]), command, np.diff(times), p, 1)[:, :8]
    motion = motion + NOISE * np.column_stack([slow_and_white(len(times), rng) for _ in range(8)])
    kept = np.ones(len(times), dtype=bool)
    for k in range(gaps):
        begin = (k + rng.uniform(0.4, 0.8)) * seconds / (gaps + 1)
        kept[(times > begin) & (times < begin + rng.uniform(1.0, 4.0))] = False
    return MotionLog(times[kept], motion[kept], command[kept], "log")


def main() -> int:
    """Print the table; return 1 if a statement does not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="20 s of log with one gap")
    quick = parser.parse_args().quick
    seconds, gaps = (20.0, 1) if quick else (60.0 * MINUTES, GAPS)
    rng, start = np.random.default_rng(SEED), nominal()
    truth = drawn(start, rng)
    log = log_of(truth, start, rng, seconds=seconds, gaps=gaps)
    wall, processor = time.perf_counter(), time.process_time()
    fit = identify(log, start, name="fitted")
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    print(f"{len(log.time)} rows over {seconds / 60:g} minutes, {gaps} gaps: {fit.sections} sections\n")
    print("| parameter | true | estimate | half-interval, 95 % | contains the true value |\n|---|---|---|---|---|")
    inside = 0
    for name, true in zip(NAMES, truth, strict=True):
        value, half = fit.estimates[name]
        inside += abs(value - true) <= half
        print(f"| {name} | {true:.4g} | {value:.4g} | {half:.2g} | {'yes' if abs(value - true) <= half else 'no'} |")
    print(f"\nThe fit took {wall:.1f} s ({processor:.1f} s of processor time).\n\n| statement | holds |\n|---|---|")
    statements = {
        f"no section contains a gap ({fit.sections} sections of at most a minute)": fit.sections >= gaps + 1,
        f"at least {LEAST} of {len(NAMES)} intervals contain the true value ({inside})": inside >= LEAST,
    }
    if not quick:
        statements[f"the fit takes at most {SECONDS:g} s ({wall:.1f} s)"] = wall <= SECONDS
    for text, holds in statements.items():
        print(f"| {text} | {'holds' if holds else '**does not hold**'} |")
    return 0 if all(statements.values()) else 1


if __name__ == "__main__":
    sys.exit(main())

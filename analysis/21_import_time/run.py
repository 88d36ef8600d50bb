"""Study 21: the time of `import surctl` and `surctl --help`, compared with `import numpy`.

    python analysis/21_import_time/run.py            # some seconds
    python analysis/21_import_time/run.py --quick    # one process of each of the first four

Prints Markdown. Processor time of whole processes, less that of a bare interpreter, taken in turns. Ends with 0 when
every bar is met, else with 1.
"""

from __future__ import annotations

import argparse
import os
import resource
import statistics
import subprocess
import sys

RUNS = 21
QUICK = 4  # of the processes below, those before the ones that load CasADi
SECONDS = 0.5
HEAVY = ("casadi", "scipy", "matplotlib", "control", "pandas", "xarray", "qpsolvers", "osqp", "marimo")

WORDS = {
    "bare interpreter": ["-c", ""],
    "import numpy": ["-c", "import numpy"],
    "import surctl": ["-c", "import surctl"],
    "surctl --help": ["-m", "surctl", "--help"],
    "surctl simulate --help": ["-m", "surctl", "simulate", "--help"],
    "surctl list": ["-m", "surctl", "list"],
}
MOST = {"import surctl": 1.2, "surctl --help": 4.0}  # times `import numpy`


def cost(words: list[str]) -> float:
    """Return user plus system time [s] of one process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONHASHSEED": "0"}
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def heavy(words: list[str]) -> list[str]:
    """Return the heavy packages that this command imports."""
    done = subprocess.run([sys.executable, "-X", "importtime", *words], check=True, capture_output=True, text=True)
    found = {line.rsplit("|", 1)[-1].strip().partition(".")[0] for line in done.stderr.splitlines() if "|" in line}
    return sorted(found & set(HEAVY))


def main() -> int:
    """Print the tables; return 1 if a limit is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help=f"one process of the first {QUICK} instead of {RUNS} of each"
    )
    given = parser.parse_args()
    runs, unused = (1, 0) if given.quick else (RUNS, 1)
    chosen = dict(list(WORDS.items())[: QUICK if given.quick else None])
    taken: dict[str, list[float]] = {name: [] for name in chosen}
    for _ in range(runs + unused):  # the first round fills the file system's cache
        for name, words in chosen.items():
            taken[name].append(cost(words))
    median = {name: statistics.median(times[unused:]) for name, times in taken.items()}
    bare = median["bare interpreter"]
    numpy = median["import numpy"] - bare
    print(f"Median of {runs} processes of each, in turns.\n")
    print("| process | processor time | less the interpreter | times `import numpy` | heavy packages |")
    print("|---|---|---|---|---|")
    good = True
    for name, words in chosen.items():
        own = median[name] - bare
        loaded = heavy(words) if name.startswith(("import surctl", "surctl")) else []
        told = ", ".join(loaded) or "none"
        print(f"| `{name}` | {median[name]:.3f} s | {own:.3f} s | {own / numpy:.2f} | {told} |")
        if name in MOST:
            good = good and median[name] <= SECONDS and own / numpy <= MOST[name] and not loaded
    print(
        f"\n{' and '.join(f'`{name}` ({most:g} times `import numpy`)' for name, most in MOST.items())}: "
        f"at most that and {SECONDS:g} s,"
    )
    print(f"nothing heavy on the way: {'met' if good else '**missed**'}.")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

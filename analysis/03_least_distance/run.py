"""Study 3: the least-distance solver on numerically hard problems, and its speed compared with DAQP's core.

    python analysis/03_least_distance/run.py [--quick] [--n 100000] [--referee 500] [--seed 0] [--no-race]

Prints Markdown. The exit status is 0 if every limit below holds, and 1 otherwise; it is 2 for a bad option, or
without a C compiler. The timing needs the DAQP that ships with CasADi; both solvers solve the same problems in one
process, alternately.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from dataclasses import astuple
from pathlib import Path

import casadi
import daqp
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the oracles are beside the tests

from surctl.errors import ToolMissing
from surctl.ir import compile_block
from surctl.ir.c99_routine import emit_block
from surctl.ir.cache import FLAGS, compiler_version, find_compiler, tuned_flags
from surctl.priority import safe_step
from surctl.priority.solver.dual_step import Space
from surctl.priority.solver.elimination import FLOAT32
from surctl.priority.solver.fallback import CLAMPED, LIMITED, MET, RELAXED, UNCONFIRMED
from surctl.priority.solver.kernel import most_iterations, search
from tests.oracles.distance_trials import FAMILIES, Trials, draw_trials, judge
from tests.oracles.least_distance import examine
from tests.priority.blocks import in_blocks

N, P, M = 4, 2, 24
CHUNK = 20_000
HERE = Path(__file__).parent
Array = NDArray[np.float64]


def main(arguments: list[str]) -> int:
    """Run both parts; return the exit status."""
    parser = argparse.ArgumentParser(description="least-distance solver: robustness and speed")
    parser.add_argument("--quick", action="store_true", help="200 problems (default of --n) and a short timing")
    parser.add_argument("--n", type=int, help="random problems; 100,000 if not given")
    parser.add_argument(
        "--referee", type=int, help="limited and relaxed problems each for the reference solver (default 500)"
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-race", action="store_true", help="skip the timing")
    options = parser.parse_args(arguments)
    count = options.n if options.n is not None else 200 if options.quick else 100_000
    checked = options.referee if options.referee is not None else 5 if options.quick else 500
    if count < 1 or options.seed < 0 or checked < 0:
        parser.error("--n is at least 1, --seed and --referee at least 0")
    try:
        find_compiler()
    except ToolMissing as missing:
        print(missing, file=sys.stderr)
        return 2
    failed = robustness(count, options.seed)
    failed = single(count, options.seed) or failed
    if checked:
        failed = lower_rungs(checked, options.seed) or failed
    if not options.no_race:
        race(count=50, rounds=2) if options.quick else race()
    return 1 if failed else 0


def robustness(count: int, seed: int) -> bool:
    """Check every limit over `count` problems; return whether any failed."""
    tick = compile_block(safe_step(N, P, M))
    worst: dict[str, float] = {}
    rungs = np.zeros((len(FAMILIES), UNCONFIRMED + 1), dtype=int)
    for at, first in enumerate(range(0, count, CHUNK)):
        trials = draw_trials(min(CHUNK, count - first), n=N, p=P, m=M, seed=seed * 1_000_003 + at)
        outputs = tick(*trials.arrays)
        for name, value in {**answers(trials, outputs), **referee(trials, outputs), **iterations(trials)}.items():
            combine = sum if name.startswith("number") else max
            worst[name] = combine((worst.get(name, 0.0), value))
        for k in range(len(FAMILIES)):
            rungs[k] += np.bincount(outputs[4][trials.features[:, k], 0].astype(int), minlength=UNCONFIRMED + 1)
    print(
        f"## {count} problems: n = {N}, {P} equalities, {M} rows, float64\n\n"
        "| feature | met | limited | relaxed | clamped | unconfirmed |"
    )
    print("|---|---|---|---|---|---|")
    for name, row in zip(FAMILIES, rungs, strict=True):
        print(f"| {name} | {row[MET]} | {row[LIMITED]} | {row[RELAXED]} | {row[CLAMPED]} | {row[UNCONFIRMED]} |")
    return compared(worst)


def compared(worst: dict[str, float]) -> bool:
    """Print the facts with their limits; return whether any failed."""
    print("\n| fact | worst | bar | |\n|---|---|---|---|")
    failed = False
    for name, value in worst.items():
        bar = BARS.get(name)
        failed = failed or (bar is not None and not value <= bar)
        word = "" if bar is None or value <= bar else "FAILED"
        print(f"| {name} | {value:.3g} | {'' if bar is None else bar} | {word} |")
    return failed


def single(count: int, seed: int) -> bool:
    """Check the same solver in float on rounded problems; return whether a limit failed."""
    tick = compile_block(safe_step(N, P, M, precision=FLOAT32), real="float32")
    double = compile_block(safe_step(N, P, M))
    worst: dict[str, float] = {}
    rungs = np.zeros((2, UNCONFIRMED + 1), dtype=int)
    for at, first in enumerate(range(0, count, CHUNK)):
        trials = draw_trials(min(CHUNK, count - first), n=N, p=P, m=M, seed=seed * 1_000_003 + 500_000 + at)
        wanted = double(
            *trials.arrays
        )  # in double as drawn: after rounding, box and box rows differ by more than the tolerance
        rounded = [array.astype(np.float32) for array in trials.arrays]
        trials = Trials(*(array.astype(np.float64) for array in rounded), trials.features)
        outputs = tick(*rounded)
        v, status, opening = outputs[0].astype(np.float64), outputs[4][:, 0], outputs[3]
        shown = status != UNCONFIRMED
        A, lower, upper, soft = trials.unit()
        value = np.einsum("kij,kj->ki", A, v)
        missed = np.maximum(value - upper, lower - value)
        both = (status == MET) & (wanted[4][:, 0] == MET)
        gap = np.abs(v - wanted[0]).max(axis=1) / (1 + np.abs(trials.target).max(axis=1))
        facts = {
            "float32: number not finite": float((~np.isfinite(np.concatenate(outputs, axis=1)).all(axis=1)).sum()),
            "float32: number outside the box": float(
                ((v < trials.box[:, :N]) | (trials.box[:, N:] < v)).any(axis=1).sum()
            ),
            "float32: number clamped": float((status == CLAMPED).sum()),
            "float32: hard row missed": float(missed[~soft].max()),
            "float32: number with a hard row missed by more than 1e-5": float(
                (np.where(soft, -1.0, missed).max(axis=1) > 1e-5).sum()
            ),
            "float32: soft row missed beyond the relaxation": float(
                (np.where(soft, missed, -1.0) - opening)[shown].max()
            ),
            "float32: difference from float64 where both meet": float(gap[both].max(initial=0.0)),
            "float32: the same without near-parallel rows": float(
                gap[both & ~trials.features[:, FAMILIES.index("parallel")]].max(initial=0.0)
            ),
            "float32: number met that float64 does not meet": float(((status == MET) & (wanted[4][:, 0] != MET)).sum()),
            "float32: number that only float64 meets": float(((status != MET) & (wanted[4][:, 0] == MET)).sum()),
            "float32: iterations over all stages": float(outputs[5].max()),
        }
        for name, value_ in facts.items():
            combine = sum if "number" in name else max
            worst[name] = combine((worst.get(name, 0.0), value_))
        rungs += [np.bincount(s.astype(int), minlength=UNCONFIRMED + 1) for s in (status, wanted[4][:, 0])]
    print(
        f"\n## {count} problems rounded to float32\n\n"
        "| in | met | limited | relaxed | clamped | unconfirmed |\n|---|---|---|---|---|---|"
    )
    for name, row in zip(("float32", "float64"), rungs, strict=True):
        print(f"| {name} | {row[MET]} | {row[LIMITED]} | {row[RELAXED]} | {row[CLAMPED]} | {row[UNCONFIRMED]} |")
    return compared(worst)


BARS = {
    "float32: number not finite": 0,
    "float32: number outside the box": 0,
    "float32: number clamped": 0,
    "float32: hard row missed": 1e-4,
    "float32: soft row missed beyond the relaxation": 1e-3,
    "number not finite": 0,
    "number clamped": 0,
    "hard row missed": 1e-9,
    "soft row missed beyond the relaxation": 1e-9,
    "KKT residual where met": 1e-8,
    "difference from DAQP where both solve": 1e-8,
    "number that DAQP solves, and we neither solve nor call unconfirmed": 0,
    **{f"{name}: relaxation above the least one": 1e-8 for name in ("limited", "relaxed")},
    **{f"{name}: task above the least one, where it is clear": 1e-8 for name in ("limited", "relaxed")},
    **{f"{name}: v away from the nearest, where it is clear": 1e-8 for name in ("limited", "relaxed")},
    "iterations of the search": most_iterations(Space(N)) - 1,
}


def answers(trials: Trials, outputs: list[Array]) -> dict[str, float]:
    """Check each solution without a second solver."""
    v, active, multipliers, opening, status, _ = outputs
    A, lower, upper, soft = trials.unit()
    value = np.einsum("kij,kj->ki", A, v)
    missed = np.maximum(value - upper, lower - value)
    met, shown = (status[:, 0] == MET) & trials.attained(v), status[:, 0] != UNCONFIRMED
    verdict = judge(trials[met], v[met], active[met], multipliers=multipliers[met])
    return {
        "number not finite": float((~np.isfinite(v).all(axis=1)).sum()),
        "number clamped": float((status == CLAMPED).sum()),
        "hard row missed": float(missed[~soft].max()),
        "soft row missed beyond the relaxation": float((np.where(soft, missed, -1.0) - opening)[shown].max()),
        "number unconfirmed": float((~shown).sum()),
        "KKT residual where met": float(verdict.worst().max()),
    }


def referee(trials: Trials, outputs: list[Array]) -> dict[str, float]:
    """Solve with DAQP at tight settings; compare its valid solutions with ours where both solve a problem."""
    A, lower, upper, _ = trials.unit()
    J = trials.J.reshape(len(A), P, N)
    length = np.linalg.norm(J, axis=2)
    length = np.where(length > 0, length, 1.0)
    rows = np.concatenate([A, J / length[..., None]], axis=1)
    low, high = (np.concatenate([b, trials.x / length], axis=1) for b in (lower, upper))
    sense = np.append(np.zeros(M), np.full(P, 5)).astype(np.intc)
    gap, missing, refused = 0.0, 0, 0
    for k, (G, a, b, goal) in enumerate(zip(rows, low, high, trials.target, strict=True)):
        y, _, flag, _ = daqp.solve(
            np.eye(N), -goal, np.ascontiguousarray(G), np.minimum(b, 1e30), np.maximum(a, -1e30), sense.copy(),
            primal_tol=1e-12,
        )  # fmt: skip
        status = outputs[4][k, 0]
        ours = status == MET
        if flag != 1 or max((G @ y - b).max(), (a - G @ y).max()) > 1e-10 * (1 + np.abs(y).max()):
            ours = ours and trials[np.array([k])].attained(outputs[0][[k]])[0]
            refused += ours
        elif not trials[np.array([k])].attained(y[None])[0]:
            continue
        elif ours:
            gap = max(gap, float(np.abs(y - outputs[0][k]).max() / (1 + np.abs(goal).max())))
        else:
            missing += status != UNCONFIRMED
    return {
        "difference from DAQP where both solve": gap,
        "number that DAQP solves, and we neither solve nor call unconfirmed": float(missing),
        "number that we solve and DAQP does not": float(refused),
    }


def lower_rungs(count: int, seed: int) -> bool:
    """Compare `count` limited and `count` relaxed solutions with a reference solver; return whether a limit failed."""
    trials = draw_trials(8 * count + 200, n=N, p=P, m=M, seed=seed * 1_000_003 + 999_983)
    outputs = compile_block(safe_step(N, P, M))(*trials.arrays)
    worst: dict[str, float] = {}
    print(f"\n## {count} limited and relaxed problems each, compared with a reference solver\n")
    print("| status | feature | problems | relaxation | task, where clear | task | v |\n|" + 7 * "---|")
    for rung, name in ((LIMITED, "limited"), (RELAXED, "relaxed")):
        chosen = np.flatnonzero(outputs[4][:, 0] == rung)[:count]
        found = np.array([astuple(one) for one in examine(trials[chosen], outputs[0][chosen], outputs[3][chosen, 0])])
        opening, task, weight, distance = found.T
        has = dict(zip(FAMILIES, trials.features[chosen].T, strict=True))
        # near-parallel rows, or a far target with task rows of different lengths, make the task ill-conditioned
        clear = (weight <= 100) & ~(has["parallel"] & (rung == RELAXED)) & ~(has["scaled"] & has["far"])
        facts = np.column_stack([opening, np.where(clear, task, 0.0), task, distance])
        for k, feature in enumerate(FAMILIES):
            shown = facts[trials.features[chosen, k]]
            cells = " | ".join(f"{value:.1e}" for value in np.nanmax(np.vstack([shown, 0 * facts[:1]]), axis=0))
            print(f"| {name} | {feature} | {len(shown)} | {cells} |")
        worst[f"{name}: relaxation above the least one"] = np.nanmax(opening)
        worst[f"{name}: task above the least one, where it is clear"] = np.nanmax(facts[:, 1])
        worst[f"{name}: task above the least one"] = np.nanmax(facts[:, 2])
        worst[f"{name}: v away from the nearest, where it is clear"] = np.nanmax(np.where(clear, distance, 0.0))
        worst[f"{name}: v away from the nearest"] = np.nanmax(distance)
        worst[f"{name}: number of tasks more than 1e-8 above"] = float((task > 1e-8).sum())
        worst[f"{name}: number that the reference solver cannot solve"] = float(np.isnan(found).any(axis=1).sum())
    return compared(worst)


def iterations(trials: Trials) -> dict[str, float]:
    """Return the most iterations of the search without the task."""
    A, lower, upper, _ = trials.unit()
    rows = in_blocks(np.concatenate([A, lower[..., None], upper[..., None]], axis=2))
    return {"iterations of the search": float(compile_block(search(Space(N), M))(rows, trials.target, [0.0])[4].max())}


def race(count: int = 2000, rounds: int = 60) -> None:
    """Time our solver and DAQP's core alternately on problems that the first stage solves; print medians."""
    if not (Path(casadi.__file__).parent / "include" / "daqp" / "api.h").exists():
        print("\nNo race: this CasADi comes without DAQP's headers.")
        return
    routine = safe_step(N, P, M)
    trials = draw_trials(20_000, n=N, p=P, m=M, seed=5, mixed=False)
    outputs = compile_block(routine)(*trials.arrays)
    chosen = np.flatnonzero(outputs[4][:, 0] == MET)[:count]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.concatenate(trials[chosen].arrays, axis=1).tofile(folder / "problems.bin")
        program = build(folder, emit_block(routine, symbol="tick", vectors=True))
        lines = subprocess.run(
            [program, folder / "problems.bin", *map(str, (N, M, P, rounds))],
            capture_output=True, text=True, check=True,
        ).stdout.splitlines()  # fmt: skip
    table = np.array([line.split() for line in lines], dtype=float)
    ours, core, whole, gap, bad = np.median(table, axis=0)
    print(f"\n## One solve in C: {len(chosen)} problems, {rounds} turns, {compiler_version()}\n")
    print(f"mean iterations {outputs[5][chosen].mean():.2f}; largest difference {gap:.1e}; failures {bad:.0f}\n")
    print("| what | ns | ours / it |\n|---|---|---|")
    print(f"| ours: scaling, elimination, search, check, box | {ours:.0f} | 1 |")
    print(f"| DAQP: search alone | {core:.0f} | {np.median(table[:, 0] / table[:, 1]):.2f} |")
    print(f"| DAQP: new data, search, solution | {whole:.0f} | {np.median(table[:, 0] / table[:, 2]):.2f} |")


def build(folder: Path, source: str) -> Path:
    """Return the program that times both solvers."""
    names = "const double *a, const double *b, const double *c, const double *d, const double *e, double *v, double *s"
    local = f"double active[{N}], multipliers[{N}], opening[1], count[1];"
    body = f"{{ {local} tick(a, b, c, d, e, v, active, multipliers, opening, s, count); }}"
    (folder / "tick.c").write_text(
        f"#include <math.h>\n{source}\nvoid surctl_tick({names});\nvoid surctl_tick({names})\n{body}\n"
    )
    home = Path(casadi.__file__).parent
    cc = find_compiler().split()
    subprocess.run([*cc, *FLAGS, *tuned_flags(), "-c", folder / "tick.c", "-o", folder / "tick.o"], check=True)
    link = ["-L", home, "-ldaqp", f"-Wl,-rpath,{home}", "-lm"]
    include = ["-I", home / "include"]
    subprocess.run([*cc, "-O2", *include, HERE / "race.c", folder / "tick.o", *link, "-o", folder / "race"], check=True)
    return folder / "race"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

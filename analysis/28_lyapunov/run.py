"""Study 28: public problems of stability and safety, found and proved; statements of known truth; and the checker.

    python analysis/28_lyapunov/run.py                  # an hour on two cores; continues where it stopped
    python analysis/28_lyapunov/run.py --first          # any region is enough: 17 minutes of one core
    python analysis/28_lyapunov/run.py --quick          # a few problems
    python analysis/28_lyapunov/run.py --only van-der-pol pendulum-friction

Every problem of `systems/` is solved within `--time-limit` seconds of processor time, and every certificate is checked.
Every statement of `statements.toml` is decided; its truth was established by other means, which the file states.
Results are saved in `results.jsonl` as they come. Prints Markdown. Status 0 if no verdict is wrong and the checker
accepts every certificate, else 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from time import process_time
from typing import Any

from surctl.certcheck import check_document
from surctl.errors import InputError
from surctl.lyapunov import Problem, load_problem, solve

HERE = Path(__file__).parent
RESULTS = HERE / "results.jsonl"
QUICK = ("coutinho-circle", "cubic-spring")
QUICK_STATEMENTS = ("discrete-linear-rate-true", "discrete-linear-rate-false")
WORKERS = 2


def decided(kind: str, name: str, problem: Problem, limit: float, first: bool) -> dict[str, Any]:
    """Return the verdict, processor times [s] and size of the certificate [bytes] of a problem."""
    began = process_time()
    try:
        decision = solve(problem, first=first, time_limit=limit)
    except InputError as error:
        verdict, reason, document = "refused", str(error), {}
    else:
        verdict, reason, document = decision.verdict, decision.reason, dict(decision.document)
    proved = process_time()
    accepted = bool(document) and check_document(document).accepted
    return {
        "kind": kind, "name": name, "states": len(problem.dynamics.states), "time": problem.dynamics.time,
        "about": problem.kind, "searched": problem.claim is None, "expected": problem.expected, "verdict": verdict,
        "accepted": accepted, "seconds": proved - began, "check_seconds": process_time() - proved,
        "bytes": len(json.dumps(document, separators=(",", ":"))) if document else 0, "reason": reason,
    }  # fmt: skip


def of_system(path: str, limit: float, first: bool) -> dict[str, Any]:
    """Decide a problem file."""
    return decided("system", Path(path).stem, load_problem(Path(path)), limit, first)


def of_statement(entry: dict[str, Any], limit: float, first: bool) -> dict[str, Any]:
    """Decide a statement about a problem file."""
    kind = ("barrier", "multiplier") if "barrier" in entry else ("function", "level", "rate")
    changes = {key: entry.get(key) for key in kind} | {"expected": "proved" if entry["truth"] else "refuted"}
    problem = load_problem(HERE / "systems" / f"{entry['system']}.toml", changes=changes)
    return decided("statement", entry["id"], problem, limit, first) | {"truth": entry["truth"]}


def results(
    names: tuple[str, ...], statements: list[dict[str, Any]], limit: float, first: bool
) -> Iterator[dict[str, Any]]:
    """Yield the results as they come; those of `results.jsonl` come first."""
    saved = [json.loads(line) for line in RESULTS.read_text().splitlines()] if RESULTS.exists() else []
    known = {(one["kind"], one["name"]) for one in saved}
    yield from (one for one in saved if one["name"] in {*names, *(s["id"] for s in statements)})
    with ProcessPoolExecutor(WORKERS) as pool:
        waiting = [
            pool.submit(of_system, str(HERE / "systems" / f"{name}.toml"), limit, first)
            for name in names
            if ("system", name) not in known
        ]
        waiting += [
            pool.submit(of_statement, s, limit, first) for s in statements if ("statement", s["id"]) not in known
        ]
        for done in as_completed(waiting):
            one = done.result()
            with RESULTS.open("a") as file:
                file.write(json.dumps(one) + "\n")
            print(f"  {one['name']}: {one['verdict']}, {one['seconds']:.0f} s", file=sys.stderr, flush=True)
            yield one


def row(one: dict[str, Any]) -> str:
    """Return the table row of a result."""
    what = f"{'V searched' if one['searched'] else 'V stated'}" if one["about"] == "lyapunov" else "barrier"
    checked = f"{one['check_seconds']:.2f} s" if one["accepted"] else ""
    return (
        f"| `{one['name']}` | {one['states']} | {one['time']} | {what} | {one['verdict']} | {one['seconds']:.1f} s "
        f"| {one['bytes'] or ''} | {checked} |"
    )


def wrong(one: dict[str, Any]) -> bool:
    """Return whether a verdict contradicts what is known, or the checker rejects a proof."""
    opposite = {"proved": "refuted", "refuted": "proved"}.get(one["verdict"]) == one["expected"]
    return opposite or (one["verdict"] == "proved" and not one["accepted"])


def main() -> int:
    """Print the tables; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true", help="a few problems, without saving")
    parser.add_argument("--only", nargs="+", default=(), metavar="NAME", help="these problems and no statements")
    parser.add_argument("--first", action="store_true", help="stop at the first level of a search that is proved")
    parser.add_argument("--time-limit", type=float, default=60.0, help="processor time for each [s]")
    asked = parser.parse_args()
    names = tuple(asked.only) or tuple(sorted(path.stem for path in (HERE / "systems").glob("*.toml")))
    statements = tomllib.loads((HERE / "statements.toml").read_text(encoding="utf-8"))["statement"]
    if asked.quick:
        some = [of_system(str(HERE / "systems" / f"{name}.toml"), asked.time_limit, asked.first) for name in QUICK]
        some += [of_statement(s, asked.time_limit, asked.first) for s in statements if s["id"] in QUICK_STATEMENTS]
    else:
        some = list(results(names, [] if asked.only else statements, asked.time_limit, asked.first))
    print("| problem | states | time | function | verdict | processor time | certificate [bytes] | check |")
    print("|---|---|---|---|---|---|---|---|")
    for kind in ("system", "statement"):
        for one in sorted((one for one in some if one["kind"] == kind), key=lambda one: str(one["name"])):
            print(row(one))
    for kind in ("system", "statement"):
        group = [one for one in some if one["kind"] == kind]
        if not group:
            continue
        clear = [one for one in group if one["verdict"] == one["expected"]]
        proofs = [one for one in group if one["accepted"]]
        slowest = max((one["check_seconds"] for one in proofs), default=0.0)
        print(
            f"\n{kind}s: {len(clear)} of {len(group)} decided ({100 * len(clear) / len(group):.0f} %), "
            f"{sum(map(wrong, group))} wrong; {len(proofs)} proofs accepted, the slowest check {slowest:.2f} s"
        )
    undecided = [one for one in some if one["verdict"] != one["expected"]]
    if undecided:
        print("\nNot decided:\n")
    for one in undecided:
        print(f"- `{one['name']}` ({one['verdict']}): {one['reason'][:200]}")
    return int(any(map(wrong, some)))


if __name__ == "__main__":
    sys.exit(main())

"""Study 28: the time of an exact certificate beside that of peers, on the same systems, in one run.

    python analysis/28_lyapunov/peers.py [--quick] [--time-limit S] [NAME…]

Every system has a stated V and level. surctl proves the whole claim (V > 0, region in the box, decrease), and its time
contains the search for a counterexample and the check of the certificate; `proof alone` is without that search, and
does the whole work in each call, with empty caches. The peers have less to do:

- Drake: V' ≤ 0 in the region, by sums of squares in floating point (Clarabel); polynomials only. `Drake, whole` states
  every inequality of surctl's certificate, with its bounds: V > 0, the faces of the box, and the decrease; its time
  does not contain the choice of the bounds;
- z3: no state of the region outside a small ball with V' ≥ 0, by exact real arithmetic; no sines;
- codac: the same as z3, by contractors and bisection;
- dReal: the same, with δ = 1e-3.

A peer that is not installed or does not load is named. Prints Markdown. A time is the least of several calls, in
processor time of this process. Status 0 if surctl proves every claim, else 1.
"""

from __future__ import annotations

import argparse
import gc
import re
import sys
import time
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from surctl.lyapunov import Stability, decide_motion, load_problem
from surctl.lyapunov.claims import Power
from surctl.lyapunov.decide import prove_motion
from surctl.verification.formula import FUNCTIONS, ordered, text_of

HERE = Path(__file__).parent
SYSTEMS = (
    "van-der-pol", "lorenz-subcritical", "haddad-chellaboina", "rigid-body-friction", "papachristodoulou-prajna-6",
    "cubic-spring", "pendulum-friction", "whirling-pendulum",
)  # fmt: skip
QUICK = ("haddad-chellaboina",)
BALL = 0.05  # radius of the ball that z3, codac and dReal leave out, in widths of the box
WIDTH = 1e-2  # least width of a box of codac
DELTA = 1e-3
REPEATS, TURNS, LONGEST = 9, 40, 1.0  # calls that are measured; no further one after this time [s]

Peer = Callable[[Stability, float], str]


def expression(text: str, symbols: dict[str, Any], functions: dict[str, Any]) -> Any:
    """Return an expression of the claim's grammar in the symbols of a peer."""
    return eval(re.sub(r"\^", "**", text), {"__builtins__": {}}, symbols | functions)


def drake(claim: Stability, limit: float) -> str:
    """Search sums of squares s with −V' − s (level − V) ≥ 0."""
    from pydrake.solvers import ClarabelSolver, MathematicalProgram
    from pydrake.symbolic import Polynomial, Variables

    d = claim.dynamics
    program = MathematicalProgram()
    x = program.NewIndeterminates(len(d.states), "x")
    symbols = {s.name: x[k] for k, s in enumerate(d.states)}
    v, change = (expression(text_of(node), symbols, {}) for node in (claim.function, d.change(claim.function)))
    degree = max(Polynomial(change).TotalDegree() - Polynomial(v).TotalDegree(), 0)
    s, _ = program.NewSosPolynomial(Variables(x), degree + degree % 2)
    program.AddSosConstraint(Polynomial(-change - s.ToExpression() * (claim.level - v), Variables(x)))
    return "feasible" if ClarabelSolver().Solve(program).is_success() else "infeasible"


def drake_whole(claim: Stability, limit: float) -> str:
    """State every inequality left ≤ right of the certificate, as right − left + Σ s · constraint with s ≥ 0."""
    from pydrake.solvers import ClarabelSolver, MathematicalProgram
    from pydrake.symbolic import Polynomial, Variables

    failed = 0
    inequalities = STATED[claim.dynamics.name]
    for fixed, free, texts in inequalities:
        known: dict[str, Any] = dict(fixed)
        program = MathematicalProgram()
        x = program.NewIndeterminates(len(free), "x")
        known |= {name: x[k] for k, name in enumerate(free)}
        left, right, *sides = (expression(text, known, {}) for text in texts)
        total = right - left
        for side in sides:
            degree = max(Polynomial(right - left).TotalDegree() - Polynomial(side).TotalDegree(), 0)
            s, _ = program.NewSosPolynomial(Variables(x), degree + degree % 2)
            total = total + s.ToExpression() * side
        program.AddSosConstraint(Polynomial(total, Variables(x)))
        failed += not ClarabelSolver().Solve(program).is_success()
    return f"{failed} of {len(inequalities)} infeasible" if failed else "feasible"


def z3(claim: Stability, limit: float) -> str:
    """Ask whether a state of the region outside the ball has V' ≥ 0."""
    import z3

    d = claim.dynamics
    symbols = {s.name: z3.Real(s.name) for s in d.states}
    solver = z3.Solver()
    solver.set("timeout", int(1000 * limit))
    for s in d.states:
        solver.add(symbols[s.name] >= s.lower, symbols[s.name] <= s.upper)
    v, change = (expression(text_of(node), symbols, {}) for node in (claim.function, d.change(claim.function)))
    solver.add(v < claim.level, change >= 0, distance(claim, symbols) >= BALL**2)
    return str(solver.check())


def distance(claim: Stability, symbols: dict[str, Any]) -> Any:
    """Return the squared distance to the equilibrium in widths of the box."""
    return sum(((symbols[s.name] - s.equilibrium) / (s.upper - s.lower)) ** 2 for s in claim.dynamics.states)


def codac(claim: Stability, limit: float) -> str:
    """Pave the states of the region outside the ball with V' ≥ 0."""
    import codac

    d = claim.dynamics
    x = codac.VectorVar(len(d.states))
    symbols = {s.name: x[k] for k, s in enumerate(d.states)}
    functions = {name: getattr(codac, name) for name in ("sin", "cos", "exp", "sqrt")}
    v, change = (expression(text_of(node), symbols, functions) for node in (claim.function, d.change(claim.function)))
    function = codac.AnalyticFunction([x], codac.vec(v, change, distance(claim, symbols)))
    wanted = codac.IntervalVector([[-codac.oo, claim.level], [0, codac.oo], [BALL**2, codac.oo]])
    box = codac.IntervalVector([[s.lower, s.upper] for s in d.states])
    left = codac.pave(box, codac.CtcInverse(function, wanted), WIDTH).boxes(codac.PavingOut.outer)
    left = [b for b in left if not b.is_empty()]
    return "empty" if not left else f"{len(left)} boxes open at a width of {WIDTH:g}"


def dreal(claim: Stability, limit: float) -> str:
    """Ask whether a state of the region outside the ball has V' ≥ 0, up to δ."""
    import dreal

    d = claim.dynamics
    symbols = {s.name: dreal.Variable(s.name) for s in d.states}
    functions = {name: getattr(dreal, name) for name in ("sin", "cos", "exp", "sqrt")}
    v, change = (expression(text_of(node), symbols, functions) for node in (claim.function, d.change(claim.function)))
    within = [bound for s in d.states for bound in (symbols[s.name] >= s.lower, symbols[s.name] <= s.upper)]
    outside = distance(claim, symbols) >= BALL**2
    model = dreal.CheckSatisfiability(dreal.And(*within, v <= claim.level, change >= 0, outside), DELTA)
    return "unsat" if model is None else "δ-sat"


Stated = list[tuple[dict[str, float], list[str], list[str]]]

STATED: dict[str, Stated] = {}
"""The inequalities of each system's certificate, by name: fixed variables, free variables, and texts."""


def stated(claim: Stability, document: Mapping[str, Any]) -> Stated:
    """Return the inequalities of a certificate, with its bounds."""
    bounds = [None if document[key] is None else Power(**document[key]) for key in ("positive", "decrease")]
    rows = []
    for each in claim.inequalities(document["scales"], *bounds):
        fixed = {v.name: v.lower for v in each.variables if v.lower == v.upper}
        free = [name for name in each.exact.names if name not in fixed]
        rows.append((fixed, free, [text_of(node) for node in each.exact.parts]))
    return rows


PEERS: dict[str, tuple[Peer, bool]] = {
    "Drake": (drake, False), "Drake, whole": (drake_whole, False),
    "z3": (z3, False), "codac": (codac, True), "dReal": (dreal, True),
}  # fmt: skip
"""The peers, and whether each knows functions that are not polynomials."""


def timed(run: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """Return the result of a call and the least processor time [s] of several, after one for imports and caches."""
    result = run() if repeats > 1 else None
    times: list[float] = []
    while len(times) < repeats and sum(times) < LONGEST:
        began = time.process_time()
        result = run()
        times.append(time.process_time() - began)
    return result, min(times)


def forget() -> None:
    """Empty all caches of functions, so that every call does the same work."""
    kind = type(lru_cache(len))
    for each in gc.get_objects():
        if isinstance(each, kind) and str(each.__module__).startswith("surctl"):
            each.cache_clear()


def alone(name: str, limit: float, *, polynomial: bool, turns: int) -> str:
    """Return the least time of the proof of a system's claim, and how many times that of `Drake, whole` it is.

    The two take turns, so that other load on the machine changes both. Every proof does the whole work anew.
    """
    own: list[float] = []
    drakes: list[float] = []
    while len(own) < turns and sum(own) < LONGEST:
        forget()
        claim = load_problem(HERE / "systems" / f"{name}.toml").claim  # a claim stores the derivative of its function
        assert isinstance(claim, Stability)
        began = time.process_time()
        proof = prove_motion(claim, time_limit=limit)
        own.append(time.process_time() - began)
        if not polynomial or proof.verdict != "proved":
            continue
        STATED[claim.dynamics.name] = stated(claim, proof.document)
        try:
            began = time.process_time()
            drake_whole(claim, limit)
            drakes.append(time.process_time() - began)
        except (ImportError, RuntimeError):  # not installed, or a division by a polynomial
            polynomial = False
    return f"{min(own):.3g} s" + (f" ({min(own) / min(drakes):.1f} x Drake, whole)" if drakes else "")


def cell(peer: Peer, claim: Stability, limit: float, ours: float, repeats: int) -> str:
    """Return the time of a peer, that time relative to surctl's, and the peer's answer."""
    try:
        answer, seconds = timed(lambda: peer(claim, limit), repeats)
    except ImportError as error:
        return f"does not load: {str(error).splitlines()[0][:60]}"
    except RuntimeError:  # Drake's answer to a division by a polynomial
        return "refused: no polynomial"
    return f"{seconds:.3g} s ({seconds / ours:.2g} x): {answer}"


def main() -> int:
    """Print the table; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true", help="one system, measured once")
    parser.add_argument("--time-limit", type=float, default=60.0, help="time for each [s]")
    parser.add_argument("names", nargs="*", metavar="NAME", help="these systems")
    asked = parser.parse_args()
    good, (repeats, turns) = True, (1, 1) if asked.quick else (REPEATS, TURNS)
    heads = ("system", "states", "surctl, exact", "proof alone", *PEERS)
    print(f"| {' | '.join(heads)} |\n" + "|---" * len(heads) + "|")
    known = {path.stem for path in (HERE / "systems").glob("*.toml")}
    for name in asked.names:
        if name not in known:
            print(f"{name}: unknown system", file=sys.stderr)
            return 2
    for name in asked.names or (QUICK if asked.quick else SYSTEMS):
        claim = load_problem(HERE / "systems" / f"{name}.toml").claim
        if not isinstance(claim, Stability):
            print(f"{name}: states no V and level, or is no claim about stability", file=sys.stderr)
            return 2
        decision, ours = timed(partial(decide_motion, claim, time_limit=asked.time_limit), repeats)
        good = good and decision.verdict == "proved"
        nodes = ordered(claim.function, claim.dynamics.change(claim.function))
        polynomial = not any(node.op in FUNCTIONS for node in nodes)
        proof = alone(name, asked.time_limit, polynomial=polynomial, turns=turns)
        cells = [
            cell(peer, claim, asked.time_limit, ours, repeats) if polynomial or every else "–"
            for peer, every in PEERS.values()
        ]
        states = len(claim.dynamics.states)
        first = f"| `{name}` | {states} | {ours:.3g} s: {decision.verdict} | {proof} | "
        print(first + " | ".join(cells) + " |", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())

"""Output of a tuning: a gain file with its provenance, and all other results as JSON."""

from __future__ import annotations

from typing import Any

from surctl import __version__
from surctl.marine.control import Gains
from surctl.marine.tuning.cegis import Tuning
from surctl.marine.tuning.goals import Goal
from surctl.marine.tuning.misses import misses, value_text
from surctl.marine.verification import speeds_text

__all__ = ["goal_rows", "summary", "tuned_gains", "tuning_dict"]

_SCORE = "the largest soft goal over its limit, or over its start value if that meets the limit; lower is better"
_LARGE = 100  # a larger normalised value only says that a run did not arrive, or that the metric is almost 0


def tuned_gains(tuning: Tuning) -> Gains:
    """Return the tuned gains and, as provenance, the goals, seeds, version, rounds and result of the tuning.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges, tune, tuned_gains
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> tuning = tune(request, trials=8, rounds=1, runs=0)
        >>> tuned = tuned_gains(tuning)
        >>> tuned.name, tuned["k_v"] > gains["k_v"], tuned["lookahead"] == gains["lookahead"]
        ('default-tuned', True, True)
        >>> print(tuned.provenance)
        chosen by hand for the built-in law, ...; tuned by surctl ...goals: soon: ...; not verified by fresh runs
    """
    request = tuning.request
    bounds = "; ".join(
        f"{g.name}: {g.over} {g.metric} {g.sense} {g.limit:g} {g.unit} ({g.kind}){_at(g)}" for g in request.goals
    )
    requested = request.conditions[: tuning.requested]
    seeds = sorted({c.seed for c in requested})
    cases = ", ".join(dict.fromkeys(c.case.name for c in requested))
    text = (
        f"{request.base.provenance}; tuned by surctl {__version__} from gains {request.base.name}, "
        f"request {request.digest[:16]}, search seed {request.seed}, {len(tuning.rounds)} round(s), "
        f"{len(requested)} runs over {cases} with seeds {seeds[0]} to {seeds[-1]} and "
        f"{len(request.conditions) - tuning.requested} counterexamples; goals: {bounds}; {_outcome(tuning)}"
    )
    values = dict(tuning.result.gains)
    return request.base.with_values(values, provenance=text, how="tuned")


def _at(goal: Goal) -> str:
    return f" at {speeds_text(goal.cruise)}" if goal.cruise else ""


def _outcome(tuning: Tuning) -> str:
    last = tuning.result
    fresh = last.verified
    missed = f"HARD GOALS NOT MET: {', '.join(tuning.unmet)}; " if tuning.unmet else ""
    checked = "not verified by fresh runs"
    if fresh is not None:
        refuted = ", ".join(last.refuted) or "nothing"
        checked = f"{fresh.runs} fresh runs with seeds {fresh.seeds[0]} to {fresh.seeds[1]} refute {refuted}"
    if tuning.conflict:
        checked += f"; not met together: {' + '.join(tuning.conflict)}"
    return missed + checked


def goal_rows(tuning: Tuning) -> list[dict[str, Any]]:
    """Return one table row per goal: its bound, and its metric and normalised value with start gains and tuned gains.

    `worst_cruise_m_per_s` is the cruise speed at which the goal is worst with the tuned gains; NaN for a goal at the
    scenario's own speed.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges, goal_rows, tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> goals = (Goal("soon", "time_s", "s", 20.0), Goal("clear", "min_clearance_m", "m", 0.08, "at least", "hard"))
        >>> tuning = tune(Request(goals, runs, gains, gain_ranges(gains, ["k_v"])), trials=8, rounds=1, runs=0)
        >>> row, _ = goal_rows(tuning)
        >>> row["name"], row["limit"], row["unit"], round(row["hand"], 2), round(row["tuned"], 1), row["met"]
        ('soon', 20.0, 's', 20.45, 19.9, True)
    """
    hand, tuned = tuning.hand.evaluation, tuning.tuned.evaluation
    return [
        goal.to_dict()
        | {
            "hand": float(hand.figure[0, j]),
            "tuned": float(tuned.figure[0, j]),
            "normalised_hand": float(hand.normalised[0, j]),
            "normalised_tuned": float(tuned.normalised[0, j]),
            "met": bool(tuned.normalised[0, j] <= 1),
            "worst_cruise_m_per_s": float(tuned.speed[0, j]),
            "better": tuning.better[j],
        }
        for j, goal in enumerate(tuning.request.goals)
    ]


def summary(tuning: Tuning) -> list[str]:
    """Return the result of a tuning as lines of text: the table of the goals, then the outcome.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges, summary, tune
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> tuning = tune(request, trials=8, rounds=1, runs=0)
        >>> lines = summary(tuning)
        >>> print(lines[1])
        soon                    soft  s             ≤ 20       20.45        19.9     1.022 → 0.995
        >>> print(lines[-1])
        after 1 round(s): not verified by fresh runs
    """
    lines = [f"{'goal':<24}{'kind':<6}{'unit':<6}{'limit':>12}{'start gains':>12}{'tuned':>12}{'normalised':>18}"]
    for goal, one in zip(tuning.request.goals, goal_rows(tuning), strict=True):
        change = " → ".join(_normalised(one[f"normalised_{which}"]) for which in ("hand", "tuned"))
        mark = "" if one["met"] else "  MISSED"
        mark += f"  worst at {one['worst_cruise_m_per_s']:g} m/s" if one["cruise_m_per_s"] else ""
        lines.append(
            f"{one['name']:<24}{one['kind']:<6}{one['unit']:<6}{goal.sign + ' ' + format(one['limit'], 'g'):>12}"
            f"{value_text(goal, one['hand']):>12}{value_text(goal, one['tuned']):>12}{change:>18}{mark}"
        )
    if any(goal.kind == "soft" for goal in tuning.request.goals):
        start = tuning.hand.evaluation.normalised[0]
        change = " → ".join(f"{pool.score(start)[0]:.3f}" for pool in (tuning.hand, tuning.tuned))
        lines += ["", f"score {change}: {_SCORE}"]
    last = tuning.result
    values = ", ".join(f"{name} = {value:.4g}" for name, value in last.gains.items())
    lines += ["", f"gains: {values}", f"after {len(tuning.rounds)} round(s): {_outcome(tuning)}"]
    return lines


def _normalised(value: float) -> str:
    return f"{value:.3f}" if value < _LARGE else f"> {_LARGE}"


def tuning_dict(tuning: Tuning) -> dict[str, Any]:
    """Return the result as plain data for `tuning.json`.

    Numbers that are not finite are converted when the file is written.

    Example:
        >>> from surctl.marine.control import load_gains
        >>> from surctl.marine.simulation import load_scenario
        >>> from surctl.marine.tuning import Goal, Request, build_cases, conditions, gain_ranges, tune, tuning_dict
        >>> gains = load_gains("default")
        >>> runs = conditions(build_cases([load_scenario("pool-behind")], gains=gains, law="closed_form"), seeds=[0])
        >>> request = Request((Goal("soon", "time_s", "s", 20.0),), runs, gains, gain_ranges(gains, ["k_v"]))
        >>> tuning = tune(request, trials=8, rounds=1, runs=0)
        >>> table = tuning_dict(tuning)
        >>> table["space"], table["goals"][0]["met"], table["best"]["feasible"], table["conflict"]
        ({'k_v': [0.375, 6.0]}, True, True, [])
    """
    request, front, best = tuning.request, tuning.front, tuning.result
    start = tuning.hand.evaluation.normalised[0]
    scores = front.score(start)
    return {
        "version": __version__,
        "request": request.digest,
        "seed": request.seed,
        "accepted": tuning.accepted,
        "unmet": list(tuning.unmet),
        "misses": [miss.to_dict() for miss in misses(tuning)],
        "goals": goal_rows(tuning),
        "space": {s.name: [s.low, s.high] for s in request.space},
        "best": {"gains": dict(best.gains), "score": best.score, "feasible": best.feasible},
        "front": [
            {
                "gains": front.gains(k),
                "score": float(scores[k]),
                "effort_n": float(front.evaluation.effort[k]),
                "normalised": front.evaluation.normalised[k].tolist(),
            }
            for k in range(len(scores))
        ],
        "rounds": [r.to_dict() for r in tuning.rounds],
        "counterexamples": [
            c.to_dict()
            for r in tuning.rounds
            for c in (*r.training, *(r.verified.counterexamples if r.verified else ()))
        ],
        "conflict": list(tuning.conflict),
    }

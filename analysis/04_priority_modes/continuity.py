"""Smooth loops of problems, and how fast the answers move along them."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.priority import Level, Mode, PriorityProblem, Row, build_problem, solve

reference = partial(solve, backend="daqp")

Array = NDArray[np.float64]


def loop(s: float, *, turning: bool, demand: float, sets: bool = False) -> PriorityProblem:
    """Return the problem at s in [0, 1]; rows become active and inactive, and never contradict the box.

    Args:
        turning: Jacobians and barriers turn; otherwise only references and bounds move.
        demand: size of the first task's reference [m/s]; up to 0.04 every point of the loop can meet it.
        sets: put a set-based task first.
    """
    a = 2 * np.pi * s
    b = a if turning else 0.7
    ahead = np.array([np.cos(b), np.sin(b), 0.0, 0.0])
    across = np.array([np.cos(2 * b), np.sin(2 * b), 0.3 * np.sin(b), 0.0])
    climb = np.array([0.2 * np.cos(b), 0.0, 1.0, 0.3 * np.sin(2 * b)])
    tasks = [
        Level("along", ahead[None], np.array([demand * (0.6 + 0.4 * np.sin(3 * a))])),
        Level("across", across[None], np.array([0.3 * np.cos(5 * a)])),
        Level("climb", climb[None], np.array([0.2 * np.sin(4 * a)])),
        Level("hold", np.eye(4), 0.1 * np.array([np.sin(a), np.cos(a), np.sin(2 * a), np.cos(3 * a)])),
    ]
    if sets:
        tasks.insert(0, Level("corridor", across[None], np.array([-0.15]), np.array([0.1 + 0.05 * np.sin(2 * a)])))
    rows = [Row(f"box{i}", "actuator", np.eye(4)[i], -0.3, 0.3) for i in range(4)]
    rows += [
        Row("wall", "barrier", np.array([np.cos(3 * b), np.sin(3 * b), 0.0, 0.0]), -np.inf, 0.15 + 0.1 * np.cos(a)),
        Row("floor", "barrier", -climb / float(np.linalg.norm(climb)), -np.inf, 0.08 + 0.06 * np.sin(a)),
    ]
    return build_problem(tasks, rows)


LOOPS: dict[str, dict[str, Any]] = {
    "references and bounds move": {"turning": False, "demand": 0.4},
    "Jacobians turn too, task 1 within reach": {"turning": True, "demand": 0.04},
    "Jacobians turn too, a set-based task first": {"turning": True, "demand": 0.4, "sets": True},
    "Jacobians turn too, task 1 out of reach": {"turning": True, "demand": 0.4},
}
SETTINGS: dict[str, dict[str, Any]] = {
    "`nsb`": {"mode": "nsb"},
    "`filter`": {"mode": "filter"},
    "`projected`": {"mode": "projected"},
    "`projected`, λ = 0.3": {"mode": "projected", "damping": 0.3},
    "`lexicographic`": {"mode": "lexicographic"},
}
MAY_JUMP = {
    ("Jacobians turn too, task 1 out of reach", "`projected`"),
    *((name, "`lexicographic`") for name in LOOPS if name != "references and bounds move"),
}
"""Loops on which mode `projected` may jump: the best corner of the limits changes when the first task's Jacobian
turns.
"""


def answer(s: float, *, where: str, how: str) -> Array:
    """Return v at one point of a loop."""
    return reference(loop(s, **LOOPS[where]), **SETTINGS[how]).v


def lipschitz(where: str, how: str, points: int) -> tuple[float, float]:
    """Return the largest |v(s + Δs) − v(s)|/Δs over a whole loop, for the given number of points and for twice as
    many.
    """
    path = np.array([answer(s, where=where, how=how) for s in np.linspace(0.0, 1.0, 2 * points + 1)])
    coarse, fine = (np.linalg.norm(np.diff(some, axis=0), axis=1).max() for some in (path[::2], path))
    return float(coarse * points), float(fine * 2 * points)


def chatter(mode: Mode, *, steps: int, dt: float = 0.02) -> int:
    """Most reversals in a row of the change of v between steps, of a point driven against and along a round obstacle.

    The obstacle is a barrier, and a set-based task before it; the goal lies behind, so that both bind for most of the
    way. A reversal is a change of more than 1e-6 against the last one: chatter would make hundreds in a row.
    """
    place, path = np.array([-2.0, 0.05]), []
    for _ in range(steps):
        distance = float(np.linalg.norm(place))
        normal = np.append(-place / distance, [0.0, 0.0])
        wall = Row("wall", "barrier", normal, -np.inf, 0.8 * (distance - 0.5))
        goal = Level("goal", np.eye(4)[:2], 0.5 * (np.array([2.0, 0.0]) - place))
        corridor = Level("corridor", normal[None], np.array([-np.inf]), np.array([0.5 * (distance - 0.5)]))
        box = [Row(f"box{i}", "actuator", np.eye(4)[i], -0.2, 0.2) for i in range(4)]
        v = reference(build_problem([corridor, goal], [*box, wall]), mode=mode).v
        place = place + dt * v[:2]
        path.append(v)
    change = np.diff(np.array(path), axis=0)
    large = np.abs(change).max(axis=1) > 1e-6
    reversed_ = (np.einsum("ij,ij->i", change[1:], change[:-1]) < 0.0) & large[1:] & large[:-1]
    longest = run = 0
    for turned in reversed_:
        run = run + 1 if turned else 0
        longest = max(longest, run)
    return longest

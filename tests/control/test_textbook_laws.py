"""The textbook laws of study 13, each from its own file: what each commands."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pathlib import Path as File
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.marine.control import CONTACT_SLOTS, DEGRADED, Law, build_law, law_ref, load_gains
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import Path
from surctl.marine.guidance.contacts import disc_contact
from surctl.marine.vehicle import load_vehicle
from surctl.system import ControllerStep

Array = NDArray[np.float64]
STUDY = File(__file__).parents[2] / "analysis" / "13_baselines"
NAMES = ("apf", "dwa", "vo", "cbf")
WISH = np.array([0.2, 0.0])
HULL, MARGIN, CAP = 0.27, 0.05, 0.22


def _module(name: str) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(STUDY)
        return import_module(name)


apf, cbf, dwa, textbook, vo = map(_module, ("apf", "cbf", "dwa", "textbook", "vo"))


@cache
def _law(name: str) -> Law:
    return build_law(law_ref(f"{name}.py:law", folder=STUDY))


def _parameters() -> Array:
    return law_parameters(
        load_gains("default"),
        load_vehicle("sur540-flooded"),
        path=Path(np.array([[0.0, 0.0], [10.0, 0.0]])),
        depth=-0.15,
        cruise=0.2,
        cap=CAP,
        walls=(-100, 100, -100, 100),
    )


def _step(
    law: Law, *contacts: tuple[float, ...], y: float = 0.0, speed: tuple[float, float] = (0.2, 0.0)
) -> ControllerStep:
    """One step on the path at x = 1, on its way."""
    rows = np.zeros((CONTACT_SLOTS, 6))
    for row, contact in zip(rows, contacts, strict=False):
        row[:] = contact
    u = law.inputs.pack({"eta": (1, y, -0.15, 0), "nu": (*speed, 0, 0), "contacts": rows})
    return law.step(law.state.pack({"progress": 1.0}), u, _parameters())


def _velocity(name: str, *contacts: tuple[float, ...], **more: Any) -> Array:
    """The commanded velocity; the hull lies along the path."""
    law = _law(name)
    return _step(law, *contacts, **more).telemetry[law.telemetry_slice("nu_reference")][:2]


def _window() -> float:
    """Half the width of the dynamic window [m/s]."""
    vehicle = load_vehicle("sur540-flooded")
    return float(dwa.HORIZON * vehicle.thrust_limit[0] / vehicle.mass[0])


def _disc(x: float, y: float, radius: float = 0.3, vx: float = 0.0, vy: float = 0.0) -> tuple[float, ...]:
    return (1 + x, y, radius, vx, vy, 1.0)


# --- each law -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_without_a_contact_the_wish_is_flown(name: str) -> None:
    law = _law(name)
    step = _step(law)
    assert step.status & DEGRADED == 0
    assert np.allclose(_velocity(name), WISH, atol=1e-12)
    assert step.telemetry[law.telemetry_slice("avoiding")][0] == 0


@pytest.mark.parametrize("name", NAMES)
def test_behind_the_robot_and_leaving_changes_nothing(name: str) -> None:
    assert np.allclose(_velocity(name, _disc(-3.5, 0.2, vx=-0.1)), WISH, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_what_stands_close_ahead_is_not_run_into(name: str) -> None:
    law = _law(name)
    step = _step(law, _disc(0.70, 0.0))  # 0.13 m of clearance
    velocity = step.telemetry[law.telemetry_slice("nu_reference")]
    # the window is no wider than what half a second of thrust changes: it brakes as hard as that
    most = 0.2 - 0.9 * _window() if name == "dwa" else 0.5 * WISH[0]
    assert velocity[0] < most
    assert step.telemetry[law.telemetry_slice("avoiding")][0] == 1


@pytest.mark.parametrize("name", ["dwa", "vo", "cbf"])
def test_an_approaching_contact_counts_more_than_one_that_stands(name: str) -> None:
    still, coming = (np.linalg.norm(_velocity(name, _disc(1.7, 0.05, vx=v)) - WISH) for v in (0.0, -0.2))
    assert coming > still + 1e-3


def test_the_field_s_push_is_firas() -> None:
    distance = HULL + 0.3 + 0.25
    rho, drift = 0.25, 0.03
    push = apf.STRENGTH * (1 / rho - 1 / apf.RANGE) / rho**2
    found = _velocity("apf", _disc(0.0, distance), speed=(0.2, drift))
    wanted = WISH - [0, push + apf.DAMPING * drift]
    wanted *= min(1.0, CAP / np.linalg.norm(wanted))
    assert push > 0 and np.allclose(found, wanted, atol=1e-12)


# --- time to contact ----------------------------------------------------------------------------------------------


@settings(max_examples=24, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_the_time_to_contact_is_when_the_simulated_discs_touch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre, moves, velocity = rng.uniform(-2, 2, 2), rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.3, 0.3, 2)
    radius, margin = rng.uniform(0, 0.5), rng.uniform(0, 0.2)
    contact = disc_contact(ca.SX([0, 0]), ca.SX(HULL), ca.SX(centre), ca.SX(radius), ca.SX(moves), ca.SX(1))
    found = float(ca.evalf(textbook.time_to_contact(ca.SX(velocity), contact, margin=ca.SX(margin))))
    times = np.linspace(0, 40, 40001)
    apart = np.linalg.norm(centre + np.outer(times, moves - velocity), axis=1) - HULL - radius - margin
    inside = np.flatnonzero(apart <= 0)
    if apart[0] <= 0:
        assert found == (0.0 if np.dot(velocity - moves, centre) > 0 else textbook.NEVER)
    elif inside.size:
        assert found == pytest.approx(times[inside[0]], abs=2e-3)
    elif apart.min() > 1e-6:
        assert found > 39.9


# --- velocity obstacle --------------------------------------------------------------------------------------------


def _forbidden(velocity: Array, contacts: list[tuple[float, ...]], *, horizon: float) -> bool:
    """Whether the discs come within the margin, by the distance of a segment from a point."""
    for x, y, radius, vx, vy, _ in contacts:
        offset, relative = np.array([x - 1, y]), velocity - [vx, vy]
        span = relative * horizon
        along = np.clip(offset @ span / max(span @ span, 1e-12), 0, 1)
        if np.linalg.norm(offset - along * span) < HULL + radius + MARGIN + vo.EXTRA - 1e-9:
            return True
    return False


@settings(max_examples=24, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_the_velocity_lies_outside_every_cone_where_a_candidate_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    contacts = []
    while len(contacts) < 3:
        x, y = rng.uniform(-2.5, 2.5, 2)
        if np.hypot(x, y) > HULL + 0.3 + MARGIN + vo.EXTRA + 0.01:
            contacts.append(_disc(x, y, 0.3, *rng.uniform(-0.15, 0.15, 2)))
    law = _law("vo")
    step = _step(law, *contacts)
    found = step.telemetry[law.telemetry_slice("nu_reference")][:2]
    fan = [
        speed * np.array([np.cos(a), np.sin(a)]) for speed in (*(s * 0.2 for s in vo.SPEEDS), CAP) for a in vo.COURSES
    ]
    free = [v for v in (*fan, np.zeros(2)) if not _forbidden(v, contacts, horizon=vo.HORIZON)]
    assert bool(step.status & DEGRADED) == (not free)
    if free:
        assert not _forbidden(found, contacts, horizon=vo.HORIZON)

        def cost(v: Array) -> float:
            return float(np.linalg.norm(v - WISH))

        # the cap ahead of the wish is no candidate
        others = [v for v in free if not np.allclose(v, [CAP, 0])]
        assert cost(found) <= min(map(cost, others)) + 1e-8


# --- barrier function ---------------------------------------------------------------------------------------------


def _nearest(wish: Array, rows: list[tuple[Array, float]], cap: float) -> tuple[Array, bool]:
    normals, bounds = np.array([n for n, _ in rows]).T, np.array([b for _, b in rows])
    v, feasible = _nearest_of(len(rows))(wish, normals, bounds, cap)
    return np.array(v, dtype=float).reshape(-1), bool(feasible)


@cache
def _nearest_of(count: int) -> ca.Function:
    """(wish, normals (2, count), bounds, cap) → (v, feasible), once for every number of rows."""
    wish, normals, bounds, cap = ca.SX.sym("w", 2), ca.SX.sym("n", 2, count), ca.SX.sym("b", count), ca.SX.sym("c")
    rows = [(normals[:, k], bounds[k]) for k in range(count)]
    return ca.Function("nearest", [wish, normals, bounds, cap], cbf.nearest_velocity(wish, rows, cap=cap))


@settings(max_examples=24, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12))
def test_the_filtered_velocity_keeps_its_rows_and_is_the_nearest(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-np.pi, np.pi, count)
    rows = [(np.array([np.cos(a), np.sin(a)]), float(rng.uniform(-0.05, 0.2))) for a in angles]
    wish = rng.uniform(-0.15, 0.15, 2)
    v, feasible = _nearest(wish, rows, CAP)
    best = _enumerated(wish, rows, CAP)
    assert feasible == (best is not None)
    assert np.linalg.norm(v) <= CAP + 1e-9
    if best is not None:
        assert all(n @ v <= bound + 1e-8 for n, bound in rows)
        assert np.linalg.norm(v - wish) <= np.linalg.norm(best - wish) + 1e-8


def _enumerated(wish: Array, rows: list[tuple[Array, float]], cap: float) -> Array | None:
    """The nearest of all places where an optimum can lie: every foot, every corner, every crossing with the circle."""
    places = [wish, wish * min(1.0, cap / np.linalg.norm(wish))]
    for i, (n, bound) in enumerate(rows):
        along = np.array([-n[1], n[0]])
        places.append(bound * n + (along @ wish) * along)
        if abs(bound) <= cap:
            half = np.sqrt(cap**2 - bound**2)
            places += [bound * n + half * along, bound * n - half * along]
        places += [np.linalg.solve(np.array([n, m]), [bound, other]) for m, other in rows[:i]]
    kept = [v for v in places if np.linalg.norm(v) <= cap + 1e-9 and all(n @ v <= bound + 1e-9 for n, bound in rows)]
    return min(kept, key=lambda v: float(np.linalg.norm(v - wish)), default=None)


def test_parallel_rows_and_rows_that_contradict_each_other() -> None:
    ahead = np.array([1.0, 0.0])
    v, feasible = _nearest(np.array([0.2, 0.1]), [(ahead, 0.1), (ahead, 0.05), (-ahead, 0.0)], CAP)
    assert feasible and np.allclose(v, [0.05, 0.1], atol=1e-12)
    v, feasible = _nearest(np.array([0.2, 0.1]), [(ahead, -0.1), (-ahead, 0.05)], CAP)
    assert not feasible and np.linalg.norm(v) <= CAP + 1e-12


def test_the_barrier_s_rows_are_kept_by_the_law_s_velocity() -> None:
    contacts = [_disc(0.75, 0.2), _disc(0.3, -0.8, vy=0.05), _disc(1.4, 0.0, vx=-0.1)]
    law = _law("cbf")
    rows = np.zeros((CONTACT_SLOTS, 6))
    rows[:3] = contacts
    u = law.inputs.pack({"eta": (1, 0, -0.15, 0), "nu": (0.2, 0, 0, 0), "contacts": rows})
    x = law.state.pack({"progress": 1.0})
    problem = law.problem(x, u, _parameters())
    velocity = law.step(x, u, _parameters()).telemetry[law.telemetry_slice("nu_reference")][:2]
    barriers = [row for row in problem.rows if row.kind == "barrier"]
    assert len(barriers) == CONTACT_SLOTS + 4
    for (cx, cy, radius, vx, vy, _), row in zip(contacts, barriers, strict=False):
        offset = np.array([cx - 1, cy])
        distance = np.linalg.norm(offset)
        clearance = distance - radius - HULL - MARGIN - cbf.EXTRA
        bound = cbf.ALPHA * clearance + np.dot([vx, vy], offset) / distance
        assert row.upper == pytest.approx(bound, abs=1e-12)
        assert np.dot(row.a[:2], velocity) <= row.upper + 1e-9

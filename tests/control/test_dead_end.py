"""Dead ends, step by step: what counts as getting on, what is waited for, and what is kept once it gave up."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.ir import Layout, Port
from surctl.marine.control import PARAMETERS, load_gains
from surctl.marine.control.dead_end import DEAD_END_PORTS, SEARCH_PORT, dead_end_next, standing
from surctl.marine.control.ports import law_parameters
from surctl.marine.control.reference import path_following
from surctl.marine.guidance import Path
from surctl.marine.guidance.contacts import disc_contact
from surctl.marine.vehicle import load_vehicle

Array = NDArray[np.float64]
DT, PATIENCE, LIMIT = 0.5, 10.0, 30.0
STATE = Layout((Port("progress", (1,), "m", "arc length of the target point on the path"), *DEAD_END_PORTS))
LIMITED = Layout((*STATE, SEARCH_PORT))
SMALL = {name: STATE.slice(name) for name in ("furthest", "searched", "stalled", "trapped")}


@cache
def _function(limit: float | None = None) -> ca.Function:
    state = STATE if limit is None else LIMITED
    x, xs = state.symbols("x")
    p, ps = PARAMETERS.symbols("p")
    eta, mover, halted = ca.SX.sym("eta", 4), ca.SX.sym("mover", 3), ca.SX.sym("stopped")
    wish = path_following(eta, xs["progress"], ps, dt=DT)
    contact = disc_contact(eta[:2], ps["hull"], mover[:2], ca.SX(0.2), ca.vertcat(mover[2], 0), ca.SX(1))
    after = {**dead_end_next(wish, [contact], xs, eta, halted, ps, dt=DT, limit=limit), "progress": xs["progress"]}
    kept = standing(wish, xs, eta, ps).velocity
    return ca.Function("dead_end", [x, eta, mover, halted, p], [state.join(after), kept, wish.velocity])


def _parameters(**gains: float) -> Array:
    return law_parameters(
        load_gains("default").with_values({"patience": PATIENCE, **gains}),
        load_vehicle("sur400"),
        path=Path(np.array([[0.0, 0.0], [9.0, 0.0]])),
        depth=-0.15,
        cruise=0.2,
        cap=0.22,
        walls=(-50.0, 50.0, -50.0, 50.0),
    )


def _fly(
    places: Array,
    *,
    mover: tuple[float, float, float] = (90, 90, 0),
    halted: float = 0,
    limit: float | None = None,
    **gains: float,
) -> Array:
    """The state after the last of the places (n, 2), one a step."""
    x, p = (STATE if limit is None else LIMITED).pack({"progress": 3.0}), _parameters(**gains)
    for place in places:
        x = np.asarray(_function(limit)(x, [*place, -0.15, 0.0], mover, halted, p)[0]).ravel()
    return x


def _told(x: Array) -> Mapping[str, Any]:
    return {name: x[where] if name == "searched" else float(x[where][0]) for name, where in SMALL.items()}


def _still(seconds: float) -> Array:
    return np.repeat([[2.0, 1.0]], round(seconds / DT) + 1, axis=0)


def test_standing_for_as_long_as_the_patience_is_a_dead_end() -> None:
    assert not _told(_fly(_still(PATIENCE - DT)))["trapped"]
    assert _told(_fly(_still(PATIENCE)))["trapped"]
    assert not _told(_fly(_still(20 * PATIENCE), patience=0.0))["trapped"]


def test_to_and_fro_within_what_was_searched_is_a_dead_end_and_a_way_on_is_none() -> None:
    n = 4 * round(PATIENCE / DT)
    swing = np.column_stack([np.full(n, 2.0), np.sin(np.arange(n) * DT)])
    assert _told(_fly(swing))["trapped"]
    along = np.column_stack([2.0 + 0.04 * DT * np.arange(n), np.zeros(n)])
    aside = np.column_stack([np.full(n, 2.0), -0.04 * DT * np.arange(n)])
    back = np.column_stack([2.0 - 0.04 * DT * np.arange(n), np.zeros(n)])
    for way in (along, aside, back):
        assert not _told(_fly(way))["trapped"]


def test_a_search_without_progress_along_the_path_ends_at_its_limit() -> None:
    """Away from the path at 0.04 m/s, it searches new places all the time."""
    n = round(LIMIT / DT) + 1  # the first place is progress
    aside = np.column_stack([np.full(n, 2.0), 0.04 * DT * np.arange(n)])
    assert not _told(_fly(aside))["trapped"]
    assert not _told(_fly(aside[:-1], limit=LIMIT))["trapped"]
    assert _told(_fly(aside, limit=LIMIT))["trapped"]
    assert _told(_fly(aside, limit=LIMIT, halted=1, patience=0.0))["trapped"], "a halt gives no time for progress"
    assert not _told(_fly(aside[:, ::-1] + [3, 0], limit=LIMIT))["trapped"], "along the path"
    assert not _told(_fly(aside, limit=LIMIT, mover=(2.0, 1.5, 0.1)))["trapped"], "it waits for what moves"
    assert not _told(_fly([8.9, 0.0] + 0 * aside, limit=LIMIT))["trapped"], "at the end of the path"
    assert _told(_fly(_still(PATIENCE), limit=LIMIT))["trapped"], "patience is as before"


def test_new_ground_counts_anew_where_the_path_was_got_on_with() -> None:
    """What was searched before the robot came further along its path may be searched again."""
    wide = np.column_stack([np.full(40, 2.0), np.linspace(-1, 1, 40)])
    on = np.array([[2.5, 0.0]])
    assert _told(_fly(np.vstack([wide, on])))["searched"] == pytest.approx([2.5, 2.5, 0, 0])


@pytest.mark.parametrize("speed", [0.0, 0.04, 0.06])
@pytest.mark.parametrize("clearance", [1.0, 2.0])
def test_what_moves_near_is_waited_for(speed: float, clearance: float) -> None:
    mover = (2.0 + 0.4 + clearance, 1.0, speed)
    waits = speed > 0.05 and clearance < 1.5
    assert bool(_told(_fly(_still(2 * PATIENCE), mover=mover))["trapped"]) is not waits


def test_halting_and_the_end_of_the_path_are_no_dead_ends() -> None:
    assert not _told(_fly(_still(5 * PATIENCE), halted=1))["trapped"]
    at_end = np.repeat([[8.9, 0.0]], round(5 * PATIENCE / DT), axis=0)
    assert not _told(_fly(at_end))["trapped"]
    before = at_end - [[0.4, 0.0]]
    assert _told(_fly(before))["trapped"]


@settings(derandomize=True, deadline=None, max_examples=20)
@given(st.integers(0, 10**6))
def test_it_is_for_good_and_the_place_is_kept(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, p = _fly(_still(PATIENCE)), _parameters()
    kept = _told(x)["searched"]
    assert kept == pytest.approx([2.0, 2.0, 1.0, 1.0])
    for place in rng.uniform(-20, 20, (20, 2)):
        after, velocity, _ = _function()(x, [*place, -0.15, 0.0], (90, 90, 0), 0, p)
        x, v = np.asarray(after).ravel(), np.asarray(velocity).ravel()
        told = _told(x)
        assert told["trapped"] == 1
        assert told["searched"] == pytest.approx(kept)
        home = np.array([2.0, 1.0]) - place
        assert np.hypot(*v) <= 0.2 + 1e-12
        assert v @ home == pytest.approx(np.hypot(*v) * np.hypot(*home))


def test_before_that_the_wish_is_left_alone() -> None:
    _, velocity, wish = _function()(
        STATE.pack({"progress": 3.0}), [2.0, 1.0, -0.15, 0.0], (90, 90, 0), 0, _parameters()
    )
    assert np.array_equal(np.asarray(velocity), np.asarray(wish))
    assert np.hypot(*np.asarray(wish).ravel()) > 0.1

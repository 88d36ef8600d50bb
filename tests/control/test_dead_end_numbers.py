"""Dead ends and layers in symbols against the plain twin: the same next state and the same aim, to 1e-12."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from surctl.ir import Layout, Port
from surctl.marine.control import PARAMETERS, load_gains
from surctl.marine.control.dead_end import (
    DEAD_END_PORTS,
    LAYER_PORTS,
    SEARCH_PORT,
    aimed_depth,
    dead_end_next,
    standing,
)
from surctl.marine.control.ports import law_parameters
from surctl.marine.control.reference import path_following
from surctl.marine.guidance import Path
from surctl.marine.guidance.contacts import disc_contact
from surctl.marine.vehicle import load_vehicle
from tests.oracles.dead_end_numbers import DeadEnd, Mission, Mover, Place, aim, dead_end_step

DT, PATIENCE, DEPTH, END, LIMIT = 0.5, 4.0, -2.0, (9.0, 0.0), 8.0
PROGRESS = Port("progress", (1,), "m", "arc length of the target point on the path")
STATES = {
    (depths, limit): Layout(
        (PROGRESS, *DEAD_END_PORTS, *(LAYER_PORTS if depths else ()), *(() if limit is None else (SEARCH_PORT,)))
    )
    for depths in (False, True)
    for limit in (None, LIMIT)
}
VEHICLE, GAINS = load_vehicle("sur540-flooded"), load_gains("default").with_values({"patience": PATIENCE})
PITCH = 2 * VEHICLE["radius"] + GAINS["margin"]


@cache
def _function(depths: bool, limit: float | None) -> ca.Function:
    state = STATES[depths, limit]
    x, xs = state.symbols("x")
    p, ps = PARAMETERS.symbols("p")
    eta, nu, mover, halted, column = (ca.SX.sym(n, k) for n, k in (("e", 4), ("n", 4), ("m", 3), ("h", 1), ("c", 2)))
    wish = path_following(eta, xs["progress"], ps, dt=DT)
    contact = disc_contact(eta[:2], ps["hull"], mover[:2], ca.SX(0.2), ca.vertcat(mover[2], 0), ca.SX(1))
    known = (wish, [contact], xs, eta, halted, ps, nu, column if depths else None)
    after = dead_end_next(*known, dt=DT, limit=limit)
    layer, depth = aimed_depth(xs, eta, nu, column, ps) if depths else (ps["depth"], ps["depth"])
    kept = ca.vertcat(standing(wish, xs, eta, ps).velocity, layer, depth)
    told = ca.vertcat(contact.clearance, xs["progress"] + wish.x_e, wish.velocity)
    joined = state.join({**after, "progress": xs["progress"]})
    return ca.Function("dead_end", [x, eta, nu, mover, halted, column, p], [joined, kept, told])


@cache
def _parameters() -> tuple[float, ...]:
    path = Path(np.array([[0.0, 0.0], END]))
    site = {"walls": (-50.0, 50.0, -50.0, 50.0), "cruise": 0.2, "cap": 0.22}
    return tuple(law_parameters(GAINS, VEHICLE, path=path, depth=DEPTH, **site).tolist())  # type: ignore[arg-type]


def _mission(limit: float | None) -> Mission:
    return Mission(
        patience=PATIENCE,
        cruise=0.2,
        margin=GAINS["margin"],
        k2=GAINS["k2"],
        reaction=GAINS["reaction"],
        hull=VEHICLE["radius"],
        depth=DEPTH,
        acceleration=GAINS["brake"] * VEHICLE["Fw_max"] / VEHICLE["m33"],
        end=END,
        search_limit=limit,
    )


def _drawn(rng: np.random.Generator, depths: bool) -> tuple[DeadEnd, Place, tuple[float, float, float], float]:
    """A state and a place near each other, with every branch in reach."""
    x, y = rng.uniform(1, 9.2), rng.uniform(-1, 1)
    sides = rng.uniform(-0.15, 0.25, 4) * [-1, 1, -1, 1]
    layer = float(rng.integers(-3, 4)) if depths else 0.0
    changing = float(rng.choice([-1, 0, 1, 2])) if depths else 0.0
    trap = DeadEnd(
        furthest=x + rng.uniform(-0.3, 0.5),
        searched=tuple(float(v) for v in np.array([x, x, y, y]) + sides),  # type: ignore[arg-type]
        stalled=rng.uniform(0, PATIENCE + 1),
        trapped=bool(rng.random() < 0.1 and changing < 0.5),
        layer=layer,
        changing=changing,
        beyond=x + rng.uniform(-1, 0.5),
        searching=rng.uniform(0, LIMIT + 1),
    )
    goal = DEPTH + PITCH * (0.0 if changing > 1.5 else layer)
    z = goal + rng.choice([0.02, 0.2, 1.0]) * rng.normal()
    speed = rng.choice([0.0, 0.02, 0.1])
    eta, nu = (x, y, z, rng.uniform(-3, 3)), (speed, 0.3 * speed, float(rng.choice([0.0, 0.05])), 0.1)
    column = tuple(float(v) for v in rng.choice([0.0, 0.3, 1.5], 2) * rng.uniform(0.5, 1.5, 2)) if depths else None
    place = Place(eta=eta, nu=nu, reached=0.0, stopped=bool(rng.random() < 0.1), column=column)  # type: ignore[arg-type]
    mover = (x + rng.choice([1.0, 2.5, 40.0]), y, float(rng.choice([0.0, 0.1])))
    return trap, place, mover, x + rng.uniform(-0.2, 0.3)


def _packed(trap: DeadEnd, layout: Layout, progress: float) -> NDArray[np.float64]:
    values = {**asdict(trap), "progress": progress}
    return layout.pack({name: value for name, value in values.items() if name in layout})


@pytest.mark.parametrize(
    ("depths", "limit"), [(False, None), (True, None), (True, LIMIT)], ids=["one depth", "depths", "limited"]
)
def test_the_symbols_and_the_plain_twin_agree(depths: bool, limit: float | None) -> None:
    rng, mission, p, state = np.random.default_rng(1), _mission(limit), _parameters(), STATES[depths, limit]
    seen: set[tuple[float, ...]] = set()
    for _ in range(600):
        trap, place, mover, progress = _drawn(rng, depths)
        x = _packed(trap, state, progress)
        column = place.column or (0.0, 0.0)
        after, kept, told = _function(depths, limit)(x, place.eta, place.nu, mover, place.stopped, column, p)
        clearance, reached, *free = np.asarray(told).ravel().tolist()
        place = Place(**{**asdict(place), "reached": reached})
        wanted = dead_end_step(trap, place, [Mover(clearance, mover[2])], mission, dt=DT)
        np.testing.assert_allclose(np.asarray(after).ravel(), _packed(wanted, state, progress), rtol=0, atol=1e-12)
        asked = aim(trap, place, mission)
        expected = [*(asked.velocity or free), asked.layer, asked.depth]
        np.testing.assert_allclose(np.asarray(kept).ravel(), expected, rtol=0, atol=1e-12)
        seen.add((trap.changing, wanted.changing, np.sign(wanted.layer - trap.layer), trap.trapped, wanted.trapped))
    # (from, to, layer, was, is): stands, goes on to a layer above and below, arrives, fails, gives up, returns, is home
    on: list[tuple[float, ...]] = [
        (0, 1, 1, 0, 0),
        (0, 1, -1, 0, 0),
        (1, -1, 0, 0, 0),
        (-1, 0, 0, 0, 0),
        (1, 1, -1, 0, 0),
        (0, 2, 0, 0, 0),
    ]
    ends: list[tuple[float, ...]] = [(2, -1, 1, 0, 0), (2, -1, -1, 0, 0), (2, 1, 0, 0, 0), (1, 0, 1, 0, 1)]
    always: list[tuple[float, ...]] = [(0, 0, 0, 0, 0), (0, 0, 0, 1, 1)]
    missing = {*always, *on, *ends} - seen if depths else {*always, (0, 0, 0, 0, 1)} - seen
    assert not missing

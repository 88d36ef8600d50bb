"""The wish at the path's end, and what counts as straying from it."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from surctl.marine.control import PARAMETERS, load_gains
from surctl.marine.control.guarded import _back_first, _strays
from surctl.marine.control.ports import law_parameters
from surctl.marine.control.reference import learnt, path_following
from surctl.marine.control.stopping import BARRIERS
from surctl.marine.guidance import Path
from surctl.marine.vehicle import load_vehicle

DT = 0.05


@cache
def _function() -> ca.Function:
    p, ps = PARAMETERS.symbols("p")
    eta, progress, velocity = ca.SX.sym("eta", 4), ca.SX.sym("progress"), ca.SX.sym("velocity", 2)
    wish = path_following(eta, progress, ps, dt=DT)
    strays = _strays(wish, velocity, BARRIERS["simple"](ps, DT))
    return ca.Function("desired", [eta, progress, velocity, p], [wish.velocity, strays, wish.arriving])


@cache
def _parameters(vehicle: str) -> tuple[float, ...]:
    made = law_parameters(
        load_gains("default"),
        load_vehicle(vehicle),
        path=Path(np.array([[0.0, 0.0], [9.0, 0.0]])),
        depth=-0.15,
        cruise=0.2,
        cap=0.22,
        walls=(-50.0, 50.0, -50.0, 50.0),
    )
    return tuple(made.tolist())


@settings(derandomize=True, deadline=None)
@given(st.floats(-1, 1), st.floats(-1, 1), st.sampled_from(["sur400", "sur540-flooded"]))
def test_the_target_is_closed_in_on_no_faster_than_the_thrusters_stop(x: float, y: float, name: str) -> None:
    """s²/(2a) + s t ≤ d, with the share of the thrust that the braking distance assumes."""
    vehicle, gains = load_vehicle(name), load_gains("default")
    found = np.asarray(_function()([9 + x, y, -0.15, 0], 9.0, [0, 0], _parameters(name))[0]).ravel()
    speed, distance = float(np.hypot(*found)), float(np.hypot(x, y))
    a = gains["brake"] * min(vehicle.thrust_limit[:2]) / max(vehicle.mass[:2])
    assert speed**2 / (2 * a) + speed * gains["reaction"] <= distance + 1e-9
    assert speed <= 0.2 + 1e-12
    assert found @ [-x, -y] == pytest.approx(speed * distance, abs=1e-12)


@pytest.mark.parametrize(
    ("y", "across", "strays"),
    [
        *((0.0, 0.03, 0), (0.0, 0.1, 1), (0.0, -0.1, 1), (0.02, -0.03, 0), (0.5, -0.1, 0), (0.05, -0.1, 1)),
        *((0.05, 0.01, 1), (-0.05, -0.01, 1), (-0.05, 0.05, 0), (0.05, 0.0, 0)),
    ],
)
def test_straying_is_further_off_where_it_is_off_or_cannot_stop_before(y: float, across: float, strays: int) -> None:
    """On the path 0.03 m/s across are stopped within 0.03 m, and 0.1 m/s from half a metre off."""
    found = _function()([4.0, y, -0.15, 0], 4.2, [0.1, across], _parameters("sur400"))
    assert float(found[1]) == strays
    assert float(found[2]) == 0


@cache
def _waiting() -> ca.Function:
    """(eta, progress, velocity, bound straight ahead, bound to the left, p) → the velocity that is left."""
    p, ps = PARAMETERS.symbols("p")
    eta, progress, velocity = ca.SX.sym("eta", 4), ca.SX.sym("progress"), ca.SX.sym("velocity", 2)
    unknown, wall = ca.SX.sym("unknown"), ca.SX.sym("wall")
    wish = path_following(eta, progress, ps, dt=DT)
    found = _back_first(wish, velocity, [(ca.SX([1, 0]), unknown)], [(ca.SX([0, 1]), wall)])
    return ca.Function("waiting", [eta, progress, velocity, unknown, wall, p], [found])


@pytest.mark.parametrize(
    ("y", "wall", "found"),
    [(-0.1, 10.0, (0.02, 0.03)), (0.1, 10.0, (0.02, 0.003)), (-0.1, 0.015, (0.01, 0.015)), (-0.1, 0.0, (0.0, 0.0))],
)
def test_who_waits_goes_back_to_the_path_meanwhile(y: float, wall: float, found: tuple[float, float]) -> None:
    """0.2 m/s ahead, where 0.02 are allowed, and 0.03 to the left: back to the path, or off it; and beside a wall."""
    made = _waiting()([4.0, y, -0.15, 0], 4.2, [0.2, 0.03], 0.02, wall, _parameters("sur400"))
    assert np.asarray(made).ravel().tolist() == pytest.approx(found, abs=1e-12)


@cache
def _learning() -> ca.Function:
    """(eta, progress, nu, avoiding, p) → the offset that `ilos` knows one period later, from 0."""
    p, ps = PARAMETERS.symbols("p")
    eta, progress, nu, avoiding = ca.SX.sym("eta", 4), ca.SX.sym("progress"), ca.SX.sym("nu", 4), ca.SX.sym("avoiding")
    memory = ca.SX(0)
    wish = path_following(eta, progress, ps, dt=DT, guidance="ilos", memory=memory)
    found = learnt("ilos", wish, memory, eta, nu, avoiding, ps, dt=DT)
    return ca.Function("learning", [eta, progress, nu, avoiding, p], [found])


@pytest.mark.parametrize(
    ("y", "across", "avoiding", "behind", "learns"),
    [
        *((0.4, 0.0, 0, 0.1, True), (0.4, 0.1, 0, 0.1, True), (0.4, -0.04, 0, 0.1, True), (0.4, -0.06, 0, 0.1, False)),
        *(
            (-0.4, 0.06, 0, 0.1, False),
            (-0.4, -0.1, 0, 0.1, True),
            (0.4, 0.0, 1, 0.1, False),
            (0.4, 0.0, 0, 0.5, False),
        ),
    ],
)
def test_nothing_is_learnt_where_an_error_is_no_push_s(
    y: float, across: float, avoiding: int, behind: float, learns: bool
) -> None:
    """0.4 m off LOS asks for at least 0.1 m/s back to the path: what does half of it returns already."""
    given = [[4.0, y, -0.15, 0], 4.0 + behind, [0.2, across, 0, 0], avoiding]
    found = float(_learning()(*given, _parameters("sur400")))
    assert found == pytest.approx(DT * 0.8 * y / (0.8**2 + y**2) if learns else 0.0, abs=1e-12)

"""The two barriers of the guarded law."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from surctl.errors import InputError
from surctl.marine.control import PARAMETERS, build_law, load_gains
from surctl.marine.control.ports import law_parameters
from surctl.marine.control.stopping import BARRIERS, BRAKE, HARD, Barrier, braked
from surctl.marine.guidance import Path
from surctl.marine.guidance.braking import Watch, brakes_of
from surctl.marine.vehicle import load_vehicle
from tests.oracles.braking_episodes import allowed_speed

VEHICLE, GAINS, DT = load_vehicle("sur540-flooded"), load_gains("default"), 0.05


@cache
def bound(barrier: Barrier) -> Any:
    p, named = PARAMETERS.symbols("p")
    d, closing = ca.SX.sym("d"), ca.SX.sym("closing")
    function = ca.Function("bound", [p, d, closing], [BARRIERS[barrier](named, DT)(d, closing)])
    numbers = law_parameters(
        GAINS, VEHICLE, path=Path(np.array([[0, 0], [1, 0]])), depth=-0.2, cruise=0.2, cap=0.22, walls=(0, 5, 0, 5)
    )
    return lambda d, closing=0.0: float(function(numbers, d, closing))


def test_the_simple_one_is_braking_from_the_speed_with_reaction_and_for_what_comes_its_way_in_that_time() -> None:
    a, t = GAINS["brake"] * VEHICLE["Fu_max"] / VEHICLE["m11"], GAINS["reaction"]
    for d, closing in ((0.4, 0.0), (0.4, -0.1), (0.4, 0.1), (1.0, -0.05)):
        s = bound("simple")(d, closing) - closing
        assert s**2 / (2 * a) + s * t == pytest.approx(d - t * max(-closing, 0), rel=1e-12)


def test_that_with_inertia_is_the_closed_form_at_the_worst_of_the_ranges() -> None:
    brakes = brakes_of(VEHICLE, share=GAINS["brake"])
    for d in (-0.1, 0.0, 0.02, 0.3, 2.0):
        for v_o in (0.0, 0.05, 0.12):
            wanted = allowed_speed(brakes, Watch(period=DT), d, obstacle=v_o)
            assert bound("inertia")(d, -v_o) == pytest.approx(wanted, abs=1e-12)
        assert bound("inertia")(d, 0.1) == pytest.approx(bound("inertia")(d) + 0.1)
    assert bound("inertia")(0.5) < bound("simple")(0.5)


def braking(now: Any, wanted: Any, bounds: Any, *, calm: float = 1.0, yields: float | None = None) -> np.ndarray:
    """`braked` in numbers; the bounds as rows of normal and speed."""
    rows = [(ca.DM(row[:2]), ca.DM(row[2])) for row in bounds]
    v, w = ca.SX.sym("v", 2), ca.SX.sym("w", 2)
    found = braked(w, v, rows, calm=calm, yields=None if yields is None else ca.SX(yields))
    return np.array(ca.Function("braked", [v, w], [found])(now, wanted)).ravel()


WALL, BESIDE, FREE = (1.0, 0.0, 0.05), (0.0, 1.0, 0.08), (-1.0, 0.0, 1.0)


def test_below_every_bound_the_wish_is_untouched() -> None:
    assert braking((0.05, 0.2), (0.04, -0.2), [WALL, FREE]) == pytest.approx((0.04, -0.2), abs=1e-15)


def test_the_faster_it_is_the_less_is_asked_for_sideways() -> None:
    for share in (0.25, 0.5, 1.0, 3.0):
        now = (0.05 + share * HARD, 0.02)
        asked = braking(now, (0.05, -0.2), [FREE, WALL])
        assert asked[0] == pytest.approx(0.05 - BRAKE * share * HARD)
        assert asked[1] == pytest.approx(-0.2 + min(share, 1.0) * 0.22)


def test_what_it_keeps_sideways_stays_within_the_next_bound() -> None:
    asked = braking((0.2, 0.1), (0.05, 0.0), [WALL, BESIDE])
    assert asked == pytest.approx((0.05 - BRAKE * 0.15, 0.08))
    assert braking((0.2, 0.1), (0.05, 0.0), [WALL])[1] == pytest.approx(0.1)


def test_what_must_be_evaded_is_evaded_while_it_brakes() -> None:
    asked = braking((0.2, 0.1), (0.05, -0.2), [WALL, BESIDE], calm=0.0)
    assert asked == pytest.approx((0.05 - BRAKE * 0.15, -0.2))


@pytest.mark.parametrize("key", ["barrier", "movers"])
def test_only_the_guarded_law_has_a_choice(key: str) -> None:
    with pytest.raises(InputError, match="did you mean") as caught:
        build_law(**{key: {"barrier": "inertial", "movers": "predicts"}[key]})
    assert caught.value.key == key
    with pytest.raises(InputError, match="law paper has no such option"):
        build_law("paper", **{key: {"barrier": "inertia", "movers": "barrier"}[key]})


CLOSE_LEFT, RIGHT = (0.0, 1.0, -0.05), (0.0, -1.0, 0.02)


def test_a_retreat_that_yields_leads_no_faster_towards_another_bound() -> None:
    """At rest between two contacts: away from the left one, which is too close, and not into the right one."""
    for yields in (None, 0.0):
        assert braking((0.0, 0.0), (0.0, -0.05), [CLOSE_LEFT, RIGHT], yields=yields)[1] < -0.2
    assert braking((0.0, 0.0), (0.1, -0.05), [CLOSE_LEFT, RIGHT], yields=1.0)[1] == pytest.approx(-0.02)


def test_bounds_that_oppose_a_retreat_on_both_sides_do_not_turn_it_back() -> None:
    """Beside a box 0.03 m away, between two unknown places: the second bound once sent the robot towards the box."""
    box = (0.2079, 0.9781, -0.02)
    unknown = [(-0.515, -0.8572, 0.0), (0.7547, -0.6561, 0.0)]
    command = braking((0.0, 0.0), (0.0, -0.05), [box, *unknown], yields=1.0)
    for *normal, bound in (box, *unknown):
        assert command @ normal <= max(bound, 0.0) + 1e-9


def test_it_brakes_first_for_what_it_closes_in_on() -> None:
    """0.02 m/s too fast to the right. A retreat from a contact ahead is missed by more, but the robot recedes there."""
    ahead = (1.0, 0.0, -0.1)
    now = (-0.01, -0.04)
    asked = braking(now, (0.0, -0.02), [ahead, RIGHT], yields=1.0)
    assert asked[1] == pytest.approx(-0.02 + BRAKE * 0.02)  # braking is along the bound that it closes in on
    assert braking(now, (0.0, -0.02), [ahead, RIGHT], yields=0.0)[1] < 0.0


@cache
def between() -> ca.Function:
    n, near, now, wanted = (ca.SX.sym(name, 2) for name in ("n", "near", "now", "wanted"))
    return ca.Function(
        "between", [n, near, now, wanted], [braked(wanted, now, [(n, near[0]), (-n, near[1])], yields=ca.SX(1))]
    )


@given(
    angle=st.floats(0.0, 2 * np.pi),
    near=st.tuples(st.floats(-0.05, 0.2), st.floats(-0.05, 0.2)),
    now=st.tuples(st.floats(-0.25, 0.25), st.floats(-0.25, 0.25)),
    wanted=st.tuples(st.floats(-0.25, 0.25), st.floats(-0.25, 0.25)),
)
def test_between_two_opposite_contacts_no_command_exceeds_a_bound(angle, near, now, wanted) -> None:
    n = np.array([np.cos(angle), np.sin(angle)])
    asked = np.array(between()(n, near, now, wanted)).ravel()
    assert n @ asked <= max(near[0], 0.0) + 1e-12 and -n @ asked <= max(near[1], 0.0) + 1e-12

"""The law as one object: names, NaN, status, and what it refuses."""

from __future__ import annotations

import functools
import keyword
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.errors import InputError
from surctl.ir import replay, to_casadi
from surctl.marine.control import (
    CONTACT_SLOTS,
    DEGRADED,
    GAINS,
    LAW_NAMES,
    MODES,
    NONFINITE,
    SATURATED,
    SWITCHED,
    Law,
    build_law,
    load_gains,
)
from surctl.marine.control.ports import law_parameters
from surctl.marine.guidance import FORMS, Path
from surctl.marine.vehicle import load_vehicle
from tests.tools import need_compiler

Array = NDArray[np.float64]
LAWS = [("guarded", "corrected"), *(("paper", form) for form in FORMS)]
C_WORDS = {"auto", "register", "double", "float", "int", "long", "short", "signed", "unsigned", "void", "volatile"}


def _parameters(*, walls: tuple[float, float, float, float] = (-100, 100, -100, 100), **gains: float) -> Array:
    return law_parameters(
        load_gains("default").with_values(gains),
        load_vehicle("sur540-flooded"),
        path=Path(np.array([[0.0, 0.0], [10.0, 0.0]])),
        depth=-0.15,
        cruise=0.2,
        cap=0.22,
        walls=walls,
    )


def _input(law: Law, *contacts: tuple[float, ...], eta: object = (1, 0, -0.15, 0), nu: object = (0, 0, 0, 0)) -> Array:
    rows = np.zeros((CONTACT_SLOTS, 6))
    for row, contact in zip(rows, contacts, strict=False):
        row[:] = contact
    return law.inputs.pack({"eta": eta, "nu": nu, "contacts": rows})


def _started(law: Law, **state: object) -> Array:
    return law.state.pack({"progress": 1.0, **state})


# --- shape --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "form"), LAWS)
def test_names_are_c_identifiers_and_sizes_agree(name: str, form: str) -> None:
    law = build_law(name, avoidance=form)
    for layout in (law.state, law.inputs, law.gains, law.outputs):
        for port in layout:
            assert re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", port.name), port.name
            assert not keyword.iskeyword(port.name)
            assert port.name not in C_WORDS
            assert port.unit
            assert port.meaning
    assert re.fullmatch(r"[a-z][a-z0-9_]*", law.name)
    assert law.function.size1_in(0) == law.state.size == law.function.size1_out(1)
    assert law.function.size1_in(1) == law.inputs.size
    assert law.function.size1_in(2) == law.gains.size
    assert law.function.size1_out(0) + law.function.size1_out(3) == law.outputs.size
    assert law.initial_state().shape == (law.state.size,)


def test_every_gain_is_a_parameter_and_the_vehicle_and_mission_follow() -> None:
    law = build_law()
    names = [port.name for port in law.gains]
    assert names[: len(GAINS)] == list(GAINS)
    values = law.gains.unpack(_parameters(k1=0.7))
    assert values["k1"][0] == 0.7
    np.testing.assert_array_equal(values["mass"], [95, 95, 95, 1.5])
    assert values["hull"][0] == 0.27
    np.testing.assert_array_equal(values["waypoints"][1:], np.tile([10.0, 0.0], (7, 1)))


def test_a_law_is_built_once() -> None:
    assert build_law() is build_law()
    assert build_law() is not build_law(mode="projected")


@pytest.mark.parametrize(
    ("kwargs", "fragment"),
    [
        ({"law": "gaurded"}, "law = 'gaurded': is not known; did you mean 'guarded'?"),
        ({"law": "paper", "avoidance": "print"}, "did you mean 'printed'?"),
        ({"mode": "projcted"}, "did you mean 'projected'?"),
        ({"law": "guarded", "avoidance": "printed"}, "use law paper to compare the forms"),
        ({"law": "guarded", "avoidance": "consistent"}, "use law paper to compare the forms"),
    ],
)
def test_what_cannot_be_built_is_refused(kwargs: dict[str, str], fragment: str) -> None:
    with pytest.raises(InputError) as caught:
        build_law(**kwargs)
    assert fragment in str(caught.value)
    assert caught.value.exit_status == 2


def test_the_choices() -> None:
    assert LAW_NAMES == ("guarded", "paper", "closed_form", "steered", "calm")
    assert MODES == ("nsb", "filter", "projected", "lexicographic")


# --- NaN never becomes a command ----------------------------------------------------------------------------------


@pytest.mark.parametrize(  # the check stands before law and mode, and each law and each mode has it
    ("name", "form", "mode"), [("guarded", "corrected", mode) for mode in MODES] + [(*LAWS[-1], "nsb")]
)
def test_a_number_that_is_not_finite_stops_the_robot(name: str, form: str, mode: str) -> None:
    """Every field of state, input and gains, one entry at a time."""
    law = build_law(name, avoidance=form, mode=mode)
    whole = [_started(law), _input(law), _parameters()]
    for which, layout in enumerate((law.state, law.inputs, law.gains)):
        for port in layout:
            at = law_slice = layout.slice(port.name)
            for entry, bad in ((at.start, np.nan), (law_slice.stop - 1, np.inf), (at.start, -np.inf)):
                vectors = [v.copy() for v in whole]
                vectors[which][entry] = bad
                step = law.step(*vectors)
                assert step.status == NONFINITE, port.name
                np.testing.assert_array_equal(step.tau, np.zeros(4))
                np.testing.assert_array_equal(step.x_next, vectors[0])
                np.testing.assert_array_equal(step.telemetry, np.zeros(law.outputs.size - 4))


def test_the_state_handed_back_after_a_fault_is_a_copy() -> None:
    law = build_law()
    x = _started(law)
    step = law.step(x, np.full(law.inputs.size, np.nan), _parameters())
    step.x_next[:] = 7
    assert x[law.state.slice("progress")][0] == 1.0


_law = functools.cache(lambda mode: build_law(mode=mode))


@settings(derandomize=True, deadline=None, max_examples=20)
@given(st.integers(0, 10**9), st.sampled_from([1.0, 1e6, 1e154, 1e300]), st.sampled_from(MODES))
def test_any_finite_numbers_give_a_finite_command_within_the_limits(seed: int, scale: float, mode: str) -> None:
    law = _law(mode)
    rng = np.random.default_rng(seed)
    x = scale * rng.standard_normal(law.state.size)
    u = scale * rng.standard_normal(law.inputs.size)
    step = law.step(x, u, _parameters())
    assert np.isfinite(step.tau).all()
    assert np.all(np.abs(step.tau) <= [5, 5, 5, 0.5])
    assert step.status == NONFINITE or np.isfinite(step.x_next).all()


# --- what it does -------------------------------------------------------------------------------------------------


def test_alone_on_its_path_it_goes_ahead() -> None:
    law = build_law()
    step = law.step(_started(law), _input(law), _parameters())
    told = law.outputs.unpack(np.concatenate([step.tau, step.telemetry]))
    np.testing.assert_allclose(told["nu_reference"], [0.2, 0, 0, 0], atol=1e-12)
    assert told["avoiding"][0] == 0
    assert told["nearest"][0] > 90
    assert step.x_next[law.state.slice("progress")][0] == pytest.approx(1.0 + 0.05 * 0.2)


def test_depth_and_heading_are_brought_back() -> None:
    law = build_law()
    step = law.step(_started(law), _input(law, eta=(1, 0, -0.25, 0.2)), _parameters())
    wanted = law.outputs.unpack(np.concatenate([step.tau, step.telemetry]))["nu_reference"]
    assert wanted[2] == pytest.approx(0.3 * 0.1)  # k2
    assert wanted[3] == pytest.approx(-0.6 * 0.2)  # k_psi
    heading = [np.cos(0.2), -np.sin(0.2)]
    np.testing.assert_allclose(wanted[:2], 0.2 * np.array(heading), atol=1e-12)  # in the body frame


def test_wanted_velocity_is_limited_to_cap_climb_and_what_the_yaw_thrust_holds() -> None:
    law = build_law()
    step = law.step(_started(law), _input(law, eta=(-3, 4, -5, 2.5)), _parameters())
    wanted = law.outputs.unpack(np.concatenate([step.tau, step.telemetry]))["nu_reference"]
    assert np.hypot(*wanted[:2]) <= 0.22 + 1e-12
    assert wanted[2] == pytest.approx(0.1)
    held = (-0.3 + np.sqrt(0.3**2 + 4 * 1.0 * 0.85 * 0.5)) / 2
    assert wanted[3] == pytest.approx(-held, rel=1e-12)


AHEAD = (2.0, 0.0, 0.27, 0.0, 0.0, 1.0)  # clearance 0.46 m


def test_an_obstacle_ahead_is_passed_with_the_obstacle_on_the_right() -> None:
    law = build_law()
    step = law.step(_started(law), _input(law, AHEAD), _parameters())
    told = law.outputs.unpack(np.concatenate([step.tau, step.telemetry]))
    assert told["avoiding"][0] == 1
    assert told["nu_reference"][1] > 0.05
    assert told["nearest"][0] == pytest.approx(0.46, abs=1e-6)
    assert step.x_next[law.state.slice("side")][0] == 1


def test_what_drifts_nearer_is_given_its_way_during_the_reaction_and_its_speed() -> None:
    law, v_o = build_law(), 0.04
    step = law.step(_started(law), _input(law, (*AHEAD[:3], -v_o, 0.0, 1.0)), _parameters())
    a, t = 0.7 * 5 / 95, load_gains("default")["reaction"]
    room = 0.46 - 0.05 - t * v_o
    bound = -a * t + np.sqrt((a * t) ** 2 + 2 * a * room) - v_o
    assert step.telemetry[0] == pytest.approx(bound, abs=1e-6)
    assert step.telemetry[1] > 0.1


def test_what_comes_head_on_is_passed_sideways() -> None:
    """No barrier on its range: at the wish's speed, on the edge of the cone that passes it at 0.05 + 0.1 m."""
    law, offset, motion = build_law(), np.array([2.0, 0.0]), np.array([-0.2, 0.0])
    step = law.step(_started(law), _input(law, (3.0, 0.0, 0.27, *motion, 1.0)), _parameters())
    wanted = step.telemetry[:2]
    relative = wanted - motion
    miss = abs(offset[0] * relative[1] - offset[1] * relative[0]) / np.hypot(*relative)
    assert np.hypot(*wanted) == pytest.approx(0.2, abs=1e-9)
    assert miss == pytest.approx(0.54 + 0.15, abs=1e-9)
    assert wanted[1] > 0  # it stays on the right


def test_what_comes_from_behind_is_outrun() -> None:
    law = build_law()
    calm = law.step(_started(law), _input(law, nu=(0.2, 0, 0, 0)), _parameters()).telemetry[:2]
    chased = (0.35, 0.0, 0.27, 0.2, 0.0, 1.0)  # 0.11 m off, as fast
    wanted = law.step(_started(law), _input(law, chased, nu=(0.2, 0, 0, 0)), _parameters()).telemetry[:2]
    np.testing.assert_allclose(calm, [0.2, 0], atol=1e-9)
    assert wanted[0] > 0.2 and abs(wanted[1]) < 1e-6


def test_an_obstacle_that_is_not_valid_is_ignored() -> None:
    law = build_law()
    step = law.step(_started(law), _input(law, (*AHEAD[:5], 0.0)), _parameters())
    np.testing.assert_array_equal(step.tau, law.step(_started(law), _input(law), _parameters()).tau)


def test_walls_hold_the_robot_back() -> None:
    law = build_law()
    p = _parameters(walls=(-100, 1.4, -100, 100))  # 0.13 m ahead of the hull
    wanted = law.step(_started(law), _input(law), p).telemetry[:4]
    a, t = 0.7 * 5 / 95, load_gains("default")["reaction"]
    allowed = -a * t + np.sqrt((a * t) ** 2 + 2 * a * (0.13 - 0.05))
    assert wanted[0] == pytest.approx(allowed, abs=1e-9)


def test_status_bits() -> None:
    assert (SATURATED, SWITCHED, DEGRADED, NONFINITE) == (1, 2, 4, -2)
    law, p = build_law(), _parameters()
    calm = _input(law, nu=(0.2, 0, 0, 0))
    assert law.step(_started(law), calm, p).status == 0
    assert law.step(_started(law), _input(law), p).status == SATURATED  # 0.2 m/s at once asks for 31 N
    assert law.step(_started(law, side=1.0), calm, p).status == SWITCHED
    first = law.step(_started(law), _input(law, AHEAD), p)
    assert first.status & SWITCHED
    again = law.step(first.x_next, _input(law, AHEAD), p)
    assert not again.status & SWITCHED  # latched
    squeezed = [(1.0 + 0.5 * np.cos(a), 0.5 * np.sin(a), 0.27, 0.0, 0.0, 1.0) for a in (0.0, 2.1, -2.1)]
    assert law.step(_started(law), _input(law, *squeezed), p).status & DEGRADED


# --- priority modes -----------------------------------------------------------------------------------------------


def test_projected_equals_nsb_when_nothing_binds() -> None:
    """Far from everything and within the velocity box: (16) in closed form, and by the QP cut into pre and post."""
    closed, cut, p = build_law(), build_law(mode="projected"), _parameters()
    rng = np.random.default_rng(11)
    moved = 0
    for _ in range(25):
        eta = [rng.uniform(1, 9), rng.uniform(-0.3, 0.3), -0.15 + rng.uniform(-0.2, 0.2), rng.uniform(-0.3, 0.3)]
        x = closed.state.pack({"progress": eta[0] + rng.uniform(0, 0.05), "integral": rng.uniform(-0.01, 0.01, 4)})
        u = _input(closed, eta=eta, nu=rng.uniform(-0.1, 0.1, 4))
        a, b = closed.step(x, u, p), cut.step(x, u, p)
        np.testing.assert_allclose(b.telemetry[:4], a.telemetry[:4], atol=1e-8)
        np.testing.assert_allclose(b.tau, a.tau, atol=1e-8 * 95 * 1.5)  # m k_v multiplies what nu_wanted differs by
        np.testing.assert_allclose(b.x_next, a.x_next, atol=1e-8)
        assert a.status == b.status
        assert not cut.explained(x, u, p).binding
        moved += bool(np.linalg.norm(a.telemetry[:3]) > 0.1)
    assert moved > 20


def test_post_of_what_the_closed_form_asks_is_the_closed_form() -> None:
    law, p = build_law(), _parameters()
    x, u = _started(law), _input(law, AHEAD, nu=(0.1, 0.02, 0, 0.1))
    pre, post = to_casadi(law.stages.pre), to_casadi(law.stages.post)
    after = post(u, p, *pre(x, u, p)[4:], law.step(x, u, p).telemetry[:4], 0)
    for a, b in zip(law.function(x, u, p), after, strict=True):
        np.testing.assert_allclose(np.asarray(a), np.asarray(b), atol=1e-12)


def test_the_problem_has_a_name_on_every_row() -> None:
    law = build_law(mode="projected")
    problem = law.problem(_started(law), _input(law, AHEAD), _parameters())
    assert [level.name for level in problem.levels] == ["velocity", "depth", "heading"]
    names = [row.name for row in problem.rows]
    assert names[:4] == ["velocity.u", "velocity.v", "velocity.w", "velocity.r"]
    assert len(names) == 4 + CONTACT_SLOTS + 4  # box, base station, walls
    assert len(set(names)) == len(names)


def test_projected_keeps_the_barriers_of_a_contact() -> None:
    law = build_law(mode="projected")
    x, u, p = _started(law), _input(law, AHEAD), _parameters()
    step, problem = law.step(x, u, p), law.problem(x, u, p)
    wanted = step.telemetry[:4]
    for row in problem.rows:
        assert row.a @ wanted <= row.upper + 1e-7, row.name
    assert law.explained(x, u, p).status == "optimal"


@pytest.mark.parametrize("mode", ["projected", "lexicographic"])  # filter: study 40
def test_the_law_in_c_is_the_replay_and_decides_as_the_solver_in_numpy(mode: str) -> None:
    """Random poses among contacts: the compiled step is the replay byte for byte, and the decision that of `solve`."""
    need_compiler()
    law, p, rng, seen = build_law(mode=mode), _parameters(), np.random.default_rng(3), set()
    for k in range(12):
        angle, far = rng.uniform(-np.pi, np.pi), rng.uniform(0.3, 1.2)
        contact = (1.0 + far * np.cos(angle), far * np.sin(angle), 0.27, *rng.uniform(-0.1, 0.1, 2), 1.0)
        nu = np.append(rng.uniform(-0.2, 0.2, 3), rng.uniform(-0.2, 0.2))
        x, u = _started(law, integral=rng.uniform(-0.01, 0.01, 4)), _input(law, contact, nu=nu)
        step, decision = law.step(x, u, p), law.explained(x, u, p)
        seen.add((decision.status, bool(decision.binding)))
        if k < 4:
            for a, b in zip(
                replay(law.block, x, u, p), (step.tau, step.x_next, [step.status], step.telemetry), strict=True
            ):
                assert np.array_equal(a, b)
        after = replay(law.stages.pre, x, u, p)[4:]
        stage = {"optimal": 1, "limited": 2}.get(decision.status, 3)
        wanted = replay(law.stages.post, u, p, *after, decision.v, [stage])
        np.testing.assert_allclose(step.tau, np.asarray(wanted[0]).ravel(), atol=1e-6)
        np.testing.assert_allclose(step.telemetry[:4], np.asarray(wanted[3]).ravel()[:4], atol=1e-8)
    assert len(seen) >= 2


# --- the printed stack --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_the_printed_stack_has_a_level_for_each_sensor_and_gives_way(form: str) -> None:
    law = build_law("paper", avoidance=form)
    assert [name for name, _, _ in law.levels] == [
        *("sensor_1", "sensor_2", "sensor_3", "sensor_4"),
        *("velocity", "depth", "heading"),
    ]
    assert law.rows == ("velocity.u", "velocity.v", "velocity.w", "velocity.r")
    free = law.step(_started(law), _input(law), _parameters())
    np.testing.assert_allclose(free.telemetry[:4], [0.2, 0, 0, 0], atol=1e-12)
    fast = _started(law, last_velocity=[0.2, 0.0])  # the window (19) starts from the last command
    near = law.step(fast, _input(law, (1.85, 0.0, 0.27, 0.0, 0.0, 1.0)), _parameters())
    # κ (l − R_OB) towards the contact, no more: clearance 0.31 less the margin of 0.05
    assert near.telemetry[0] == pytest.approx(0.3 * 0.26, abs=1e-6)
    assert near.telemetry[law.outputs.slice("avoiding").start - 4] == 1


def test_the_printed_angle_turns_the_other_way() -> None:
    """E1: an obstacle ahead on the left; counter-clockwise the course opens to its side, printed it turns about −φ."""
    contact = (1.0 + 0.8 * np.cos(0.6), 0.8 * np.sin(0.6), 0.27, 0.0, 0.0, 1.0)
    flown = {}
    for form in FORMS:
        law = build_law("paper", avoidance=form)
        x = _started(law, last_velocity=[0.0, 0.0], side=-1.0)
        step = law.step(x, _input(law, contact), _parameters(kappa=0.1))
        flown[form] = np.arctan2(*step.x_next[law.state.slice("last_velocity")][::-1])
    clearance = 0.8 - 0.27 - 0.27 - 0.05
    turn = np.pi / 2 - np.arctan2(clearance, 0.27 + 0.27 + 0.05)
    assert flown["consistent"] == pytest.approx(0.6 - turn, abs=1e-6)
    assert flown["printed"] == pytest.approx(-0.6 - turn, abs=1e-6)


@pytest.mark.parametrize(("ahead", "left", "first"), [(0.3, 0.15, "left"), (0.15, 0.3, "ahead")])
def test_sensor_sub_tasks_are_sorted_by_time_to_contact(ahead: float, left: float, first: str) -> None:
    """Heading for both at the same speed: the nearer one comes first; sensors that are silent are zero rows below."""
    law, reach = build_law("paper"), 0.27 + 0.27
    contacts = [(1.0 + reach + ahead, 0.0, 0.27, 0.0, 0.0, 1.0), (1.0, reach + left, 0.27, 0.0, 0.0, 1.0)]
    # the window (19) keeps the avoidance velocity near the last one, which points between the two
    x = _started(law, last_velocity=[0.15, 0.15])
    problem = law.problem(x, _input(law, *contacts, eta=(1, 0, -0.15, 0)), _parameters())
    rows = {"ahead": [-1.0, 0, 0, 0], "left": [0, -1.0, 0, 0]}
    second = "ahead" if first == "left" else "left"
    found = [level.J[0] for level in problem.levels[:4]]
    np.testing.assert_allclose(found, np.array([rows[first], rows[second], [0] * 4, [0] * 4], dtype=float), atol=1e-12)
    clearance = {"ahead": ahead, "left": left}
    wanted = [-0.3 * (clearance[k] - 0.05) for k in (first, second)]
    np.testing.assert_allclose([level.x[0] for level in problem.levels[:2]], wanted, atol=1e-9)


def test_three_sensor_sub_tasks_are_sorted_too() -> None:
    """Beside the robot, inside the margin, two more; it turns to the right, so that one is the more urgent of them."""
    law, reach = build_law("paper"), 0.27 + 0.27
    contacts = [(1.0 + reach + 0.3, 0.0, 0.27, 0.0, 0.0, 1.0)]
    contacts += [(1.0, side * (reach + away), 0.27, 0.0, 0.0, 1.0) for side, away in ((1, 0.02), (-1, 0.04))]
    x = _started(law, last_velocity=[0.2, 0.0], side=-1.0)
    problem = law.problem(x, _input(law, *contacts), _parameters())
    rows = [[-1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, -1.0, 0, 0], [0] * 4]
    np.testing.assert_allclose([level.J[0] for level in problem.levels[:4]], rows, atol=1e-12)


@pytest.mark.parametrize(("last", "speed"), [(0.30, 0.30 - 0.05 * 3 / 95), (0.10, 0.10 + 0.05 * 3 / 95), (0.2, 0.2)])
def test_the_avoidance_velocity_stays_in_its_window(last: float, speed: float) -> None:
    """(19): the speed changes by what the weaker axis accelerates in a period, the course by √(a/R_OB) of it."""
    law = build_law("paper")
    p = _parameters()
    p[law.gains.slice("thrust_limit")][:2] = (5.0, 3.0)
    near = _input(law, (1.85, 0.1, 0.27, 0.0, 0.0, 1.0))
    step = law.step(_started(law, last_velocity=[last, 0.0]), near, p)
    after = step.x_next[law.state.slice("last_velocity")]
    assert np.hypot(*after) == pytest.approx(speed, abs=1e-9)
    assert abs(np.arctan2(after[1], after[0])) == pytest.approx(0.05 * np.sqrt(3 / 95 / 0.59), abs=1e-9)


def test_gains_of_another_vehicle_change_the_command_but_not_the_law() -> None:
    law = build_law()
    p = _parameters()
    light = p.copy()
    light[law.gains.slice("mass")] = [50, 50, 50, 0.6]
    u = _input(law, nu=(0.19, 0, 0, 0))
    a, b = law.step(_started(law), u, p), law.step(_started(law), u, light)
    assert a.tau[0] - b.tau[0] == pytest.approx(45 * 1.5 * 0.01, rel=1e-9)


@pytest.mark.parametrize("mode", ["nsb", "projected"])
def test_a_vector_of_the_wrong_size_names_it(mode):
    law = build_law("guarded", mode=mode)
    right = {"x": law.initial_state(), "u": law.inputs.pack(), "p": law.gains.pack()}
    for name, vector in right.items():
        for wrong in (vector[:-1], vector[:0], np.stack([vector, vector]), 1j * vector, "text"):
            for call in (law.step, law.problem, law.explained):
                with pytest.raises(InputError, match=rf"surctl_guarded\.{name}"):
                    call(**{**right, name: wrong})


def test_the_problem_of_a_tick_that_the_law_refuses_is_refused():
    law = build_law("guarded", mode="projected")
    u = np.full(law.inputs.size, np.nan)
    with pytest.raises(InputError, match="not finite"):
        law.explained(law.initial_state(), u, law.gains.pack())

"""The problem as data: what is refused, printed and saved."""

import math

import numpy as np
import pytest

from surctl.errors import InputError
from surctl.priority import Level, Row, build_problem, solve

GOOD = Level("depth", np.eye(4)[2:3], np.array([0.1]))


def row(name="wall", kind="barrier", a=(1, 0, 0, 0), lower=-math.inf, upper=0.2):
    return Row(name, kind, np.array(a, dtype=float), lower, upper)


@pytest.mark.parametrize(
    ("levels", "rows", "says"),
    [
        ([], [], "no level"),
        ([GOOD, GOOD], [], "task depth: is the name of task 1 and of task 2"),
        ([GOOD], [row(), row()], "limit wall: is the name of"),
        ([GOOD, Level("odd", np.ones((1, 3)), np.ones(1))], [], "task odd: J has 3 columns"),
        ([Level("odd", np.ones((2, 4)), np.ones(1))], [], "task odd: J has shape (2, 4)"),
        ([Level("odd", np.array([[1, 1, 1, 1], [0, np.nan, 0, 0]]), np.ones(2))], [], "row 1 is not finite"),
        ([Level("odd", np.ones((2, 4)), np.array([np.inf, 1]))], [], "row 0 is not finite"),
        ([GOOD], [row(a=(1, 0, 0))], "limit wall: has 3 entries"),
        ([GOOD], [row(a=(1, 0, 0, np.nan))], "limit wall"),
        ([GOOD], [row(upper=math.nan)], "limit wall"),
        ([GOOD], [row(lower=0.3)], "exclude every velocity"),
        ([GOOD], [row(upper=-math.inf)], "exclude every velocity"),
        ([GOOD], [row(kind="actuatr")], "did you mean 'actuator'"),
    ],
)
def test_bad_problems_are_refused_by_name(levels, rows, says):
    with pytest.raises(InputError) as caught:
        build_problem(levels, rows)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_it_prints_every_row():
    text = str(build_problem([GOOD], [row()]))
    assert "depth" in text
    assert "-> 0.1" in text
    assert "wall" in text
    assert "[-inf, 0.2]" in text


def test_the_callers_arrays_are_not_shared():
    J = np.eye(4)[2:3].copy()
    problem = build_problem([Level("depth", J, np.array([0.1]))])
    J[0, 2] = 99.0
    assert problem.levels[0].J[0, 2] == 1.0


@pytest.mark.parametrize("name", ["", "two\nlines", None, 3])
def test_a_name_that_cannot_be_told_in_a_line_is_refused(name):
    with pytest.raises(InputError, match=r"name of task 2.*is not a name"):
        build_problem([Level("first", np.eye(4)[:1], np.ones(1)), Level(name, np.eye(4)[1:2], np.ones(1))])
    with pytest.raises(InputError, match=r"name of limit 1.*is not a name"):
        build_problem([Level("first", np.eye(4)[:1], np.ones(1))], [Row(name, "actuator", np.ones(4), -1.0, 1.0)])


@pytest.mark.parametrize("J", ["text", [[1.0, 2.0], [3.0]], 1j * np.eye(4)[:1]])
def test_what_is_no_number_names_the_task(J):
    with pytest.raises(InputError, match=r"task depth.*not an array of numbers"):
        build_problem([Level("depth", J, np.ones(1))])


@pytest.mark.parametrize("bound", ["high", np.ones(2), [[1.0], [2.0, 3.0]]])
def test_a_bound_that_is_no_number_names_the_limit(bound):
    with pytest.raises(InputError, match="limit wall"):
        build_problem([Level("depth", np.eye(4)[:1], np.ones(1))], [Row("wall", "barrier", np.ones(4), -1.0, bound)])


def test_a_task_and_a_limit_of_one_name_are_refused():
    with pytest.raises(InputError, match="task wall: is also the name of a limit"):
        build_problem([Level("wall", np.eye(4)[:1], np.ones(1))], [Row("wall", "barrier", np.ones(4), -1.0, 1.0)])


def test_rows_of_any_length_bound_what_they_say():
    surge = Level("surge", np.eye(4)[:1], np.array([0.5]))
    box = [row(f"box{i}", "actuator", np.eye(4)[i], -1.0, 1.0) for i in range(4)]
    for length, backend in ((1e-12, None), (1e140, None), (1e155, "daqp"), (1e300, "daqp")):
        wall = row("wall", "barrier", (length, 0, 0, 0), upper=0.1 * length)
        got = solve(build_problem([surge], [*box, wall]), backend=backend)
        assert got.v[0] == pytest.approx(0.1, abs=1e-9), length
    # shorter than 1e-15 it is a row of zeros, which is met always or never
    got = solve(build_problem([surge], [*box, row("none", "actuator", (1e-16, 0, 0, 0), -1e-17, 1e-17)]))
    assert np.allclose(got.v, [0.5, 0, 0, 0], atol=1e-12)
    assert got.is_optimal(build_problem([surge], box))


def test_rows_that_are_relaxed_are_widened_on_both_sides_and_the_others_are_not():
    rows = [row("wall", a=(2, 0, 0, 0), lower=-0.4, upper=0.2), row("edge", "actuator", (0, 1, 0, 0), -0.5, 0.5)]
    found = build_problem([GOOD], rows).limits
    wider = found.relaxed(0.25)
    assert np.array_equal(wider.lower, [-0.45, -0.5]) and np.array_equal(wider.upper, [0.35, 0.5])
    assert np.array_equal(wider.A, found.A)

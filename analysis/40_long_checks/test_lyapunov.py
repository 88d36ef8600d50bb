"""Lyapunov functions: polynomials of degree 6, and the largest level where only samples give a function."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from surctl.lyapunov import find_stability
from surctl.lyapunov.candidates import candidates
from surctl.lyapunov.equilibrium import linearisation
from surctl.lyapunov.falsified import least_level
from surctl.verification.formula import parse, variable
from tests.lyapunov import test_decide
from tests.lyapunov.test_search import TRUE_AREA, dynamics, leavers, van_der_pol


def test_the_region_of_van_der_pol_by_a_polynomial_of_degree_6_is_nearly_the_true_one() -> None:
    d = van_der_pol()
    outcome = list(candidates(d, linearisation(d), degree=6, seconds=15.0))
    assert [c.label for c in outcome] == [
        "quadratic with a fast decrease", "quadratic", "polynomial of degree 4", "polynomial of degree 6",
    ]  # fmt: skip
    assert outcome[3].volume * 36 >= 0.94 * TRUE_AREA
    bound = least_level(d, outcome[3].function)
    assert bound.confirmed
    assert bound.level == pytest.approx(1, rel=0.03)
    grid = np.linspace(-3, 3, 600)
    points = np.array(np.meshgrid(grid, grid)).reshape(2, -1)
    value = d.compiled(outcome[3].function)
    inside = np.asarray(value(points, np.zeros((0, points.shape[1])))) < 0.97 * bound.level
    assert inside.mean() * 36 >= 0.9 * TRUE_AREA
    assert leavers(d, value, 0.97 * bound.level, count=120, seconds=10.0) == 0


def test_where_the_linearisation_decides_nothing_the_largest_level_is_proved() -> None:
    d = dynamics({"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, ["-x^3 + y", "-x - y^3"])
    outcome = find_stability(d, degree=4, time_limit=20.0)
    assert outcome.verdict == "proved"
    assert outcome.ratio >= 0.9


def test_a_region_is_proved_just_below_its_least_level() -> None:
    d = dynamics({"x": (-2.0, 2.0), "y": (-2.0, 2.0)}, ["-x + y", "-y - x^3"])
    outcome = find_stability(d, degree=2, time_limit=30.0)
    assert outcome.verdict == "proved"
    assert outcome.ratio >= 0.9
    assert outcome.claim is not None and outcome.falsified is not None
    assert outcome.claim.level < outcome.falsified.level


def test_the_least_level_is_that_of_a_scan_and_its_counterexample_is_confirmed() -> None:
    d = van_der_pol()
    x = {"x": variable("x"), "y": variable("y")}
    function = parse("1.5*x^2 - x*y + y^2", x)
    bound = least_level(d, function)
    grid = np.linspace(-1.5, 1.5, 301)
    points = np.array(np.meshgrid(grid, grid)).reshape(2, -1)
    points = points[:, np.abs(points).max(axis=0) > 1e-3]  # without the equilibrium
    v, change = np.asarray(d.compiled(function, d.change(function))(points, np.zeros((0, points.shape[1]))))
    assert bound.level == pytest.approx(v[change >= 0].min(), rel=1e-2)
    assert bound.confirmed
    assert bound.cause == "decrease"
    faces = least_level(d.on({"x": (-0.5, 0.5)}), function)
    assert faces.cause == "face"
    assert faces.level == pytest.approx(1.25 * 0.5**2)  # the least value of V on x = 0.5


@pytest.mark.parametrize(("text", "change", "verdict"), test_decide.TRUE_AND_FALSE)
def test_true_claims_are_proved_and_false_ones_refuted(
    tmp_path: Path, text: str, change: tuple[str, str], verdict: str
) -> None:
    test_decide.test_true_claims_are_proved_and_false_ones_refuted(tmp_path, text, change, verdict)

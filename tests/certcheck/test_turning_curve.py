"""A turning cruise on a curve whose steady cruise is not at the target: the turning path frame moves that place too."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from surctl.certcheck import check_document
from surctl.certcheck.document import Rejected
from surctl.certcheck.turning import _flow, triangle
from surctl.certcheck.turning_claim import read_claim
from surctl.certcheck.turning_form import Form, Phase, axes_of
from surctl.certcheck.turning_matrix import Inclusion
from tests.certcheck.altering import sealed
from tests.certcheck.turning_truth import true_rate

STORED = Path(__file__).parent / "region-turning-20-curved.json"
LEVELS = (0.00118176, 0.00186853, 0.00467132, 0.0116783, 0.0291958, 0.0729894, 0.170518, 0.338609, 0.57154, 0.82, 1.0)
GROWTHS = (0.01491, 0.0128, 0.008737, 0.003772, 0.003, 0.003, *(5 * (0.0003552,)))


def document() -> dict[str, Any]:
    """A curve of 0.3/m with linear drag off by ±30 %, so that x_e* is up to 0.31 m."""
    whole = json.loads(STORED.read_text())
    vehicle, law, motion = (whole["claim"][key] for key in ("vehicle", "law", "motion"))
    vehicle |= {"drag_factor": [0.7, 1.3], "drag_asymmetry": 0.0, "mass_factor": [1.0, 1.0], "mass_asymmetry": 0.0}
    vehicle |= {"thrust_n": [50.0, 50.0], "yaw_rate_rad_per_s": 0.3}
    law |= {"k1": 0.05, "wait": 60.0, "linear_drag": [150.0, 150.0], "quadratic_drag": [0.0, 0.0]}
    motion |= {"curvature_per_m": 0.3, "offset_m": 0.8, "rate_per_s": 0.004, "ultimate_bound_m": [0.3343, 0.0325]}
    shells = [{"level": level, "growth": growth} for level, growth in zip(LEVELS, GROWTHS, strict=True)]
    P = [[1.47912304], [0.0, 1.10080079], [1.66542273, 0.0, 59.7665127], [0.0, 0.879718153, 0.0, 5.5397722]]
    whole["proof"] = {"P": P, "cells": 48, "floor": 0.00101191, "shells": shells, "trim": [0.051282, 0.0]}
    return sealed(whole)


def test_a_steady_cruise_away_from_the_target_counts_on_a_curve() -> None:
    checked = check_document(document())
    assert not checked.accepted and "between levels 0.00101191 and 0.00118176" in checked.reason
    claim, state, low = read_claim(document()["claim"]), np.array([[0.0, 0.0, 0.1, 0.0]]), np.full((1, 2), 0.7)
    boat = {"mass": np.ones((1, 2)), "linear": low, "quadratic": low, "term_mass": np.ones(1), "term": np.ones(1)}
    curve = np.array([[0.0, 0.0, 0.0, 0.03]])
    for _ in range(5000):
        state = state + 0.02 * true_rate(claim, boat, state, np.zeros(1), np.zeros(1), curve)
    assert abs(state[0, 1]) > 2 * claim.ultimate_bound[1]  # the motion ends outside of the bound


@pytest.mark.parametrize("along", [(0.0,), (0.4,), (-0.2, 0.4)])
def test_the_matrix_of_a_cell_is_that_of_the_equations(along: tuple[float, ...]) -> None:
    whole, plan = document(), np.array([[0.05, 0.0], [0.0, 0.1]])
    claim, p = read_claim(whole["claim"]), triangle(whole["proof"]["P"], 4, "P")
    form, bend, level, growth, v = Form.of(p), 0.03, 0.5, 0.01, 0.1
    axes, crossed = axes_of(np.array([[[1.0, 0.0]]]))
    turns, loops, one, two = (
        np.array([[0.0, 0.0, bend, 0.0]] * len(along)),
        np.array([[[300.0, 150.0, 120.0]]]),
        np.zeros(1),
        np.zeros((1, 2)),
    )
    at = Inclusion(
        v, 0.0, axes, crossed, np.array([[0.01, 0.01, 0.0]]), np.ones(2), turns,
        np.array(along), (loops, loops), plan[None], two, one, 0.0, 0.0, two, one, one, Phase(), np.ones((2, 1)),
    )  # fmt: skip
    met = at.losses(form, float(claim.rate), growth, level)
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    A = np.kron([[0.0, 1.0], [0.0, 0.0]], np.eye(2)) - bend * np.kron(np.eye(2), turn)
    A[2:] -= np.hstack([3.0 * plan, 2.7 * np.eye(2)])
    P = np.array([[float(entry) for entry in row] for row in p])
    decay = A.T @ P + P @ A + (float(claim.rate) + growth) * P
    for k, x in enumerate(along):
        pushed = P @ (-bend * np.concatenate([turn @ [x, 0.0], turn @ [v, 0.0]]))
        expected = -form.change @ (decay + np.outer(pushed, pushed) / level) @ form.change.T
        for (i, j), found in met.items():
            assert found.reshape(len(along))[k] == pytest.approx(expected[i, j], abs=2e-6 * np.abs(expected).max())


def test_on_a_curve_a_current_does_not_shift_the_steady_cruise() -> None:
    claim, nothing = read_claim(document()["claim"]), [[0.0, 0.0]] * 3
    assert not any(map(any, _flow(claim, nothing)))
    with pytest.raises(Rejected, match=r"a curved path, proof\.flow must be 0"):
        _flow(claim, [[0.1, 0.0], *nothing[1:]])

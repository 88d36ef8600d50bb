"""Kinematics (1)–(2)."""

from __future__ import annotations

import casadi as ca
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from surctl.marine.vehicle import jacobian, planar_rotation

_PSI = ca.SX.sym("psi")
_J = ca.Function("J", [_PSI], [ca.densify(jacobian(_PSI)), planar_rotation(_PSI)])
angles = st.floats(-20, 20)


def _at(psi: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    full, planar = _J(psi)
    return np.asarray(full), np.asarray(planar)


@settings(derandomize=True, deadline=None)
@given(angles)
def test_jacobian_as_printed(psi: float) -> None:
    c, s = np.cos(psi), np.sin(psi)
    expected = [[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(_at(psi)[0], expected, atol=1e-15)


@settings(derandomize=True, deadline=None)
@given(angles, angles)
def test_rotations_are_orthogonal_and_compose(a: float, b: float) -> None:
    r_a, r_b = _at(a)[1], _at(b)[1]
    np.testing.assert_allclose(r_a @ r_a.T, np.eye(2), atol=1e-14)
    np.testing.assert_allclose(r_a @ r_b, _at(a + b)[1], atol=1e-13)


def test_forward_and_left_in_the_world_frame() -> None:
    quarter = _at(np.pi / 2)[0]
    np.testing.assert_allclose(quarter @ [1, 0, 0, 0], [0, 1, 0, 0], atol=1e-15)  # forward points to +y
    np.testing.assert_allclose(quarter @ [0, 1, 0, 0], [-1, 0, 0, 0], atol=1e-15)  # left points to −x
    np.testing.assert_allclose(quarter @ [0, 0, 2, 3], [0, 0, 2, 3], atol=1e-15)

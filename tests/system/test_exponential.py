from __future__ import annotations

import numpy as np
import scipy.linalg

from surctl.system.linear_loop import expm


def test_it_is_that_of_scipy_at_every_size_and_norm() -> None:
    rng = np.random.default_rng(3)
    for n in (1, 2, 5, 20):
        A = rng.normal(size=(2, 6, n, n)) * 10.0 ** np.arange(-5, 1)[:, None, None]  # one batch has many scalings
        A -= 2 * n * np.eye(n) * (np.abs(A).max(axis=(-2, -1)) > 1)[..., None, None]
        np.testing.assert_allclose(expm(A), scipy.linalg.expm(A), rtol=1e-11, atol=1e-13)


def test_a_closed_form_and_numbers_that_are_not_finite() -> None:
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    both = expm(np.array([100 * np.pi * turn, np.nan * turn]))
    np.testing.assert_allclose(both[0], np.eye(2), atol=1e-12)
    assert np.isnan(both[1]).all()
    assert expm(np.zeros((0, 3, 3))).shape == (0, 3, 3)

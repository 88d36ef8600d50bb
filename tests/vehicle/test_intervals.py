"""Intervals of coloured residuals have the width of the true scatter, although the fit takes up a part of the noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle.identification.intervals import _semidefinite, spread_of
from surctl.marine.vehicle.identification.solve import products

Array = NDArray[np.float64]


def coloured(rng: np.random.Generator, shape: tuple[int, int], phi: float) -> Array:
    noise = rng.normal(size=shape)
    for k in range(1, len(noise)):
        noise[k] = phi * noise[k - 1] + np.sqrt(1.0 - phi**2) * noise[k]
    return noise


def test_intervals_are_as_wide_as_the_estimates_scatter() -> None:
    """Slow directions in two sections of two columns: the variances equal those of the known noise to a few percent."""
    rng, rows, size, phi = np.random.default_rng(3), 500, 8, 0.9
    t = np.arange(rows) / rows
    first, prior = np.full(12, 1e6), np.full(size, 1e-9)
    present = np.zeros((rows, 8), dtype=bool)
    present[:, [2, 4]] = True
    slopes = []
    for part in range(2):
        slope = np.zeros((rows, 8, size + 12))
        for j in range(size):
            slope[:, 2, j] = np.sin((2 + 1.5 * j) * np.pi * t + part + j)
            slope[:, 4, j] = np.cos((1 + 1.7 * j) * np.pi * t + 2 * part - j)
        slopes.append(slope)
    flat = np.vstack([s[:, [2, 4], :size].reshape(-1, size) for s in slopes])
    along = phi ** np.abs(np.subtract.outer(np.arange(rows), np.arange(rows)))
    weighted = np.vstack([np.tensordot(along, s[:, [2, 4], :size], 1).reshape(-1, size) for s in slopes])
    inverse = np.linalg.inv(flat.T @ flat)
    scatter = np.sqrt(np.diag(inverse @ flat.T @ weighted @ inverse))
    ratios = []
    for _ in range(16):
        noise = [coloured(rng, (rows, 2), phi) for _ in slopes]
        estimate = inverse @ flat.T @ np.vstack([e.reshape(-1, 1) for e in noise])[:, 0]
        parts = []
        for e, slope in zip(noise, slopes, strict=True):
            left = np.zeros((rows, 8))
            left[:, [2, 4]] = e - slope[:, [2, 4], :size] @ estimate
            parts.append((left, slope))
        spread = spread_of(parts, [present] * 2, prior, first)
        ratios.append(np.sqrt(np.diag(spread.covariance)) / scatter)
    assert 0.97 < np.mean(ratios) < 1.04  # 0.92 without what the fit has taken up
    assert np.mean(ratios, axis=0).min() > 0.9 and np.std(ratios) < 0.3


def test_products_of_long_matrices_are_those_at_once() -> None:
    one, other = np.random.default_rng(1).normal(size=(2, 1234, 5))
    np.testing.assert_allclose(products(one, other[:, :3]), one.T @ other[:, :3], rtol=0.0, atol=1e-10)


def test_a_covariance_with_negative_variances_becomes_semidefinite_and_another_stays() -> None:
    rng, signs = np.random.default_rng(4), set[bool]()
    for _ in range(20):
        units = 10.0 ** rng.uniform(-5, 3, 5)
        root = units[:, None] * np.linalg.cholesky(np.cov(rng.normal(size=(5, 40))))
        values, turn = rng.uniform(-0.5, 3.0, 5), np.linalg.qr(rng.normal(size=(5, 5)))[0]
        coloured = root @ (turn * values) @ turn.T @ root.T
        mended = _semidefinite(coloured, root)
        normal = (mended - coloured) / np.outer(units, units)
        assert np.linalg.eigvalsh(mended / np.outer(units, units)).min() > -1e-12
        assert np.linalg.eigvalsh(normal).min() > -1e-12  # no variance becomes smaller
        assert (np.abs(normal).max() < 1e-12) == (values.min() >= 0)
        signs.add(bool(values.min() < 0))
    assert signs == {False, True}

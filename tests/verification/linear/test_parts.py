import numpy as np
import pytest
from scipy.linalg import expm

from surctl.system.linear_loop import blockwise, distinct, eigenvalues, independent
from surctl.verification.linear import (
    _SCREEN_POINTS,
    _SCREENED,
    OpenLoop,
    disk_profile,
    screened_peaks,
)


def test_what_is_coupled_by_any_path_is_one_group() -> None:
    coupled = np.zeros((6, 6), dtype=bool)
    for a, b in ((0, 3), (5, 3), (5, 1)):  # in one direction, and over others
        coupled[a, b] = True
    assert [group.tolist() for group in independent(coupled)] == [[4], [2], [0, 1, 3, 5]]


def test_equal_matrices_are_distinct_once() -> None:
    one, other = np.eye(2), np.array([[1.0, 0.0], [0.0, 2.0]])
    first, which = distinct(np.array([one, other, one, other]), np.array([[3.0], [3.0], [3.0], [4.0]]))
    assert sorted(first) == [0, 1, 3] and first[which].tolist() == [0, 1, 0, 3]


def shuffled(rng: np.random.Generator, blocks: list[list[np.ndarray]]) -> OpenLoop:
    """Loops of independent blocks (A, B, C) of three loops each, their states and channels in an order of their own."""
    sizes = [len(A[0]) for A, _, _ in blocks], [B.shape[-1] for _, B, _ in blocks]
    n, q = (sum(each) for each in sizes)
    A, B, C = np.zeros((3, n, n)), np.zeros((3, n, q)), np.zeros((3, q, n))
    x = c = 0
    for (a, b, o), states, channels in zip(blocks, *sizes, strict=True):
        at, to = slice(x, x + states), slice(c, c + channels)
        A[:, at, at], B[:, at, to], C[:, to, at] = a, b, o
        x, c = x + states, c + channels
    states, channels = rng.permutation(n), rng.permutation(q)
    D = np.zeros((3, q, q))
    return OpenLoop(A[:, states[:, None], states], B[:, states[:, None], channels], C[:, channels[:, None], states], D)


def drawn(rng: np.random.Generator, n: int, q: int) -> list[np.ndarray]:
    """Three loops whose closed loops are stable, the last two of them equal."""
    A, B, C = (rng.normal(size=(3, *shape)) for shape in ((n, n), (n, q), (q, n)))
    A -= (1 + np.abs(np.linalg.eigvals(A - B @ C)).max()) * np.eye(n)
    for matrices in (A, B, C):
        matrices[2] = matrices[1]
    return [A, B, C]


def test_independent_parts_have_the_eigenvalues_and_the_peak_of_the_whole() -> None:
    rng = np.random.default_rng(3)
    loops = shuffled(rng, [drawn(rng, 4, 2), drawn(rng, 3, 1), drawn(rng, 2, 0)])
    for found, matrix in zip(eigenvalues(loops.A), loops.A, strict=True):
        assert np.sort_complex(found) == pytest.approx(np.sort_complex(np.linalg.eigvals(matrix)), abs=1e-9)
    assert blockwise(expm, loops.A) == pytest.approx(expm(loops.A), abs=1e-12)
    grid = np.geomspace(*_SCREENED, _SCREEN_POINTS)
    one_by_one = [1 / disk_profile(loops[np.array(k)], grid).min() for k in range(3)]
    assert screened_peaks(loops) == pytest.approx(np.array(one_by_one), rel=1e-9)
    assert len(set(one_by_one)) == 2  # each has its own


@pytest.mark.parametrize("channels", [0, 1])
def test_an_unstable_part_makes_its_loop_unstable(channels: int) -> None:
    rng = np.random.default_rng(4)
    weak = drawn(rng, 2, channels)
    weak[0][1] += 9 * np.eye(2)
    peaks = screened_peaks(shuffled(rng, [drawn(rng, 3, 2), weak]))
    assert np.isinf(peaks).tolist() == [False, True, False]

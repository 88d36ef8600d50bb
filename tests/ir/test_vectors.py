"""CasADi functions on NumPy vectors: the numbers of CasADi's own call, and buffers that no two calls share."""

from concurrent.futures import ThreadPoolExecutor

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import on_vectors
from surctl.ir.symbolic import on_columns


def function() -> ca.Function:
    x, m = ca.SX.sym("x", 3), ca.SX.sym("m", 2, 3)
    sparse = ca.SX(3, 1)
    sparse[1] = ca.sin(x[0]) * x[2]
    return ca.Function("f", [x, m], [m @ x, sparse, ca.sqrt(x)], ["x", "m"], ["y", "z", "r"])


def test_it_gives_the_numbers_of_casadi() -> None:
    rng, f = np.random.default_rng(3), function()
    run = on_vectors(f)
    for _ in range(20):
        x, m = rng.normal(size=3), rng.normal(size=(2, 3))
        expected = [np.asarray(part).reshape(-1) for part in f(x, m)]
        for got, wanted in zip(run(x, m), expected, strict=True):
            assert got.tobytes() == wanted.tobytes() or np.array_equal(got, wanted, equal_nan=True)


def test_columns_are_evaluated_one_by_one() -> None:
    x = ca.SX.sym("x", 3)
    f = ca.Function("f", [x], [ca.vertcat(x[0] * x[1], ca.sin(x[2])), ca.SX(0, 1), ca.sqrt(x[2])])
    run, points = on_columns(f), np.random.default_rng(4).normal(size=(3, 7))
    for given in (points, points[:, :1], np.asfortranarray(points)):
        found = run(given)
        assert [part.shape for part in found] == [(2, given.shape[1]), (0, given.shape[1]), (1, given.shape[1])]
        for k, column in enumerate(given.T):
            for part, wanted in zip(found, f(column), strict=True):
                np.testing.assert_array_equal(part[:, k], np.asarray(wanted).reshape(-1))
    with pytest.raises(InputError, match="14 numbers, expected 21"):
        run(points[:2])


def test_results_are_kept_when_it_is_called_again() -> None:
    run = on_vectors(function())
    first = run(np.ones(3), np.ones((2, 3)))
    run(np.zeros(3), np.zeros((2, 3)))
    assert first[0].tolist() == [3.0, 3.0] and first[1].tolist() == [0.0, np.sin(1.0), 0.0]


def test_threads_do_not_share_buffers() -> None:
    v = ca.SX.sym("v", 400)
    run = on_vectors(ca.Function("twice", [v], [ca.cos(v) * v]))
    given = [np.full(400, float(k)) for k in range(40)]
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda x: [run(x)[0] for _ in range(20)][-1], given))
    for k, got in enumerate(found):
        assert got.tobytes() == run(given[k])[0].tobytes() and np.ptp(got) == 0.0


def test_what_does_not_fit_is_named() -> None:
    run = on_vectors(function())
    with pytest.raises(InputError, match="x: has 2 numbers, expected 3"):
        run(np.ones(2), np.ones((2, 3)))
    with pytest.raises(InputError, match="takes 2 inputs, got 1"):
        run(np.ones(3))
    diagonal = ca.SX.sym("d", ca.Sparsity.diag(2))
    with pytest.raises(InputError, match="not dense"):
        on_vectors(ca.Function("g", [diagonal], [diagonal @ ca.SX.ones(2)]))

"""The noise generator: published numbers, jumps, exactness in doubles, and the distribution."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from surctl.errors import InputError
from surctl.noise import draw_normals, noise_states
from tests.oracles.noise_stream import NoiseStream


def test_the_first_numbers_are_the_published_ones() -> None:
    # L'Ecuyer, Simard, Chen and Kelton (2002), RngStreams, seed 12345
    stream = NoiseStream(0)
    assert [round(stream.uniform(), 6) for _ in range(4)] == [0.127011, 0.318528, 0.309186, 0.825847]


def test_the_next_stream_starts_where_the_package_puts_it() -> None:
    # RngStreams, second stream of the default seed
    assert noise_states([1])[0].tolist() == [3692455944, 1366884236, 2968912127, 335948734, 4161675175, 475798818]


def test_streams_by_jump_and_by_steps_agree() -> None:
    several = noise_states([5, 0, 2, 5])
    assert np.array_equal(several[0], several[3])
    assert np.array_equal(several[1], np.full(6, 12345))
    assert np.array_equal(several[2], noise_states([2])[0])
    assert len({tuple(row) for row in noise_states(np.arange(1000))}) == 1000
    assert np.all(noise_states([2**63 - 1]) < 2**32)


def test_symbols_and_numbers_give_the_same_noise() -> None:
    state = ca.SX.sym("state", 6)
    normals, after = draw_normals(state, 40)
    draw = ca.Function("draw", [state], [normals, after])
    for seed in (0, 7, 123456789):
        here, stream = noise_states([seed])[0], NoiseStream(seed)
        for _ in range(20):
            found, here = (np.asarray(part).ravel() for part in draw(here))
            assert np.allclose(found, stream.normals(40), rtol=0, atol=2e-13)
            assert np.array_equal(here, [*stream._one, *stream._two])


@given(st.integers(0, 4294967086), st.integers(0, 4294967086), st.sampled_from([4294967087, 4294944443]))
def test_the_remainder_is_exact_in_doubles(a: int, b: int, modulus: int) -> None:
    for first, second in ((1403580, 810728), (527612, 1370589)):
        x = first * a - second * b
        assert x - np.floor(float(x) / modulus) * modulus == x % modulus


def test_the_remainder_holds_right_at_the_multiples() -> None:
    rng = np.random.default_rng(0)
    for modulus in (4294967087, 4294944443):
        whole = rng.integers(-1370589, 1403580, 20_000).astype(object) * modulus
        for offset in (-1, 0, 1):
            x = (whole + offset).astype(float)
            assert np.array_equal(x - np.floor(x / modulus) * modulus, ((whole + offset) % modulus).astype(float))


def test_the_numbers_are_standard_normal_and_independent() -> None:
    numbers = np.concatenate([NoiseStream(seed).normals(500) for seed in range(200)])
    assert stats.kstest(numbers, "norm").pvalue > 0.01
    assert abs(np.corrcoef(numbers[:-1], numbers[1:])[0, 1]) < 0.01
    by_seed = numbers.reshape(200, 500)
    assert abs(np.corrcoef(by_seed[:-1].ravel(), by_seed[1:].ravel())[0, 1]) < 0.01


@pytest.mark.parametrize("seeds", [[-1], [0.5], ["a"]])
def test_a_seed_is_a_whole_number_from_zero(seeds: list[object]) -> None:
    with pytest.raises(InputError, match="seed"):
        noise_states(seeds)


def test_normals_in_symbols_come_in_pairs() -> None:
    with pytest.raises(InputError, match="even"):
        draw_normals(ca.SX.sym("state", 6), 3)

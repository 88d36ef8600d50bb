from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from surctl.errors import InputError
from surctl.marine.sensing import Calibration, Estimate, calibrate
from surctl.marine.sensing.calibration.estimation import LEAST_ROWS, LEAST_ROWS_OF_SLOPE

BIAS, SCALE = 0.02, 0.985
SETS = 40  # tables of each kind of noise


def drawn(rng: np.random.Generator, n: int, s0: float, s1: float) -> tuple[np.ndarray, np.ndarray]:
    x = np.linspace(0.25, 4.45, n)
    return x, SCALE * x + BIAS + (s0 + s1 * x) * rng.standard_normal(n)


def holds(estimate: Estimate | None, truth: float) -> bool:
    assert estimate is not None
    return estimate.low <= truth <= estimate.high


def binomial(count: int, nominal: float = 0.95) -> tuple[float, float]:
    """Shares of `count` that a nominal coverage gives in all but 1 of 1000 cases."""
    low, high = stats.binom.ppf([0.0005, 0.9995], count, nominal)
    return low / count, high / count


def coverage(n: int, s0: float, s1: float, sets: int = SETS) -> dict[str, float]:
    rng = np.random.default_rng(20240607)
    hits: dict[str, list[bool]] = {}
    for _ in range(sets):
        x, y = drawn(rng, n, s0, s1)
        found = calibrate(x, y)
        level = float(np.sqrt(np.mean((s0 + s1 * x) ** 2)))
        errors = SCALE * x + BIAS - x
        case = {
            "bias": holds(found.bias, BIAS),
            "scale": holds(found.scale, SCALE),
            "noise_sd": holds(found.noise_sd, level),
            "slope": found.noise_slope is None or holds(found.noise_slope, s1),
            "mean": holds(found.mean_error, float(errors.mean())),
            "varies": found.varies,
            "outlier": len(found.outliers) > 0,
        }
        for name, hit in case.items():
            hits.setdefault(name, []).append(bool(hit))
    return {name: float(np.mean(values)) for name, values in hits.items()}


@pytest.mark.parametrize("n", [LEAST_ROWS, 18])
def test_intervals_of_constant_noise_hold_what_they_promise(n: int) -> None:
    got = coverage(n, 0.015, 0.0)
    low, high = binomial(SETS)
    for name in ("bias", "scale", "noise_sd"):
        assert low <= got[name] <= high, (name, got[name])
    if n >= LEAST_ROWS_OF_SLOPE:
        assert low <= got["slope"] <= high
        assert binomial(SETS, 0.05)[0] <= got["varies"] <= binomial(SETS, 0.05)[1]
    else:
        assert got["varies"] == 0.0
    # Bonferroni keeps false alarms at 5 % a table or below
    assert got["outlier"] <= binomial(SETS, 0.05)[1]


@pytest.mark.parametrize("s1", [0.01])
def test_intervals_of_noise_that_grows_or_falls_hold_what_they_promise(s1: float) -> None:
    got = coverage(80, 0.004 if s1 > 0 else 0.02, s1)
    low, high = binomial(SETS)
    assert got["varies"] > 0.9
    for name in ("bias", "scale", "noise_sd", "slope"):
        assert low <= got[name] <= high, (name, got[name])


def test_few_rows_of_uneven_noise_are_known_to_hold_less() -> None:
    """The documented limit: with a noise that varies five times and 18 rows, the test sees it in half of the tables."""
    got = coverage(18, 0.0105, -0.0019, sets=SETS)
    assert 0.4 < got["varies"] < 0.75
    assert 0.87 < got["bias"] < 0.95


def test_constant_noise_gives_the_textbook_line() -> None:
    x, y = drawn(np.random.default_rng(3), 18, 0.015, 0.0)
    found, book = calibrate(x, y), stats.linregress(x, y)
    t = stats.t.ppf(0.975, 16)
    assert not found.varies
    assert found.scale.to_list() == pytest.approx(
        [book.slope, book.slope - t * book.stderr, book.slope + t * book.stderr], abs=1e-12
    )
    reach = t * book.intercept_stderr
    assert found.bias.to_list() == pytest.approx([book.intercept, book.intercept - reach, book.intercept + reach])
    residual = y - book.intercept - book.slope * x
    sd = np.sqrt(residual @ residual / 16)
    assert found.noise_sd.value == pytest.approx(sd)
    assert found.noise_sd.low == pytest.approx(sd * np.sqrt(16 / stats.chi2.ppf(0.975, 16)))
    assert found.noise_sd.high == pytest.approx(sd * np.sqrt(16 / stats.chi2.ppf(0.025, 16)))
    assert found.residuals == pytest.approx(residual, abs=1e-12)
    assert found.mean_error.to_list()[1:] == pytest.approx(
        list(stats.t.interval(0.95, 17, np.mean(y - x), stats.sem(y - x)))
    )


def test_a_weighted_line_is_nearer_where_the_noise_is_small() -> None:
    """Growing noise: the weighted bias has less than half the spread of the plain one."""
    rng, weighted, plain = np.random.default_rng(7), [], []
    for _ in range(20):
        x, y = drawn(rng, 80, 0.0005, 0.01)
        weighted.append(calibrate(x, y).bias.value)
        plain.append(stats.linregress(x, y).intercept)
    assert np.std(weighted) < 0.5 * np.std(plain)


def test_studentised_residuals_are_those_of_a_fit_without_the_row() -> None:
    x, y = drawn(np.random.default_rng(5), 14, 0.02, 0.0)
    found = calibrate(x, y)
    for k in (0, 6, 13):
        rest = np.arange(14) != k
        book = stats.linregress(x[rest], y[rest])
        left = y[rest] - book.intercept - book.slope * x[rest]
        sd = np.sqrt(left @ left / 11)
        about = x[k] - x[rest].mean()
        spread = sd * np.sqrt(1 + 1 / 13 + about**2 / np.sum((x[rest] - x[rest].mean()) ** 2))
        assert found.studentised[k] == pytest.approx((y[k] - book.intercept - book.slope * x[k]) / spread)


def test_an_outlier_is_marked_and_left_out() -> None:
    x, y = drawn(np.random.default_rng(11), 30, 0.01, 0.0)
    y[12] += 0.2
    found = calibrate(x, y)
    assert found.outliers.tolist() == [12]
    assert len(found.true) == 30 and found.largest == 12
    without = calibrate(np.delete(x, 12), np.delete(y, 12))
    assert found.scale == without.scale and found.noise_sd == without.noise_sd
    assert found.error_sd.value == pytest.approx(np.std(y - x, ddof=1))  # of all readings
    assert found.outlier_bound == pytest.approx(stats.t.ppf(1 - 0.05 / 60, 27))


@settings(max_examples=20)
@given(st.permutations(range(12)), st.floats(0.5, 2.0))
def test_order_does_not_matter_and_units_scale(order: list[int], factor: float) -> None:
    x, y = drawn(np.random.default_rng(1), 12, 0.01, 0.004)
    one, other = calibrate(x, y), calibrate(factor * x[order], factor * y[order])
    assert other.true == pytest.approx(np.sort(factor * x)) and (factor * x[order])[other.order] == pytest.approx(
        other.true
    )
    assert other.scale.to_list() == pytest.approx(one.scale.to_list(), rel=1e-9)
    assert other.bias.to_list() == pytest.approx([factor * v for v in one.bias.to_list()], abs=1e-9)
    assert other.noise_sd.to_list() == pytest.approx([factor * v for v in one.noise_sd.to_list()], rel=1e-6)
    assert other.noise_slope_p == pytest.approx(one.noise_slope_p, abs=1e-6)


def test_readings_without_noise_have_no_noise() -> None:
    x = np.linspace(0.3, 4.0, 20)
    found = calibrate(x, 1.01 * x + 0.003)
    assert found.bias.to_list() == pytest.approx([0.003] * 3, abs=1e-12)
    assert found.scale.to_list() == pytest.approx([1.01] * 3)
    assert found.noise_sd == Estimate(0.0, 0.0, 0.0) and found.noise_slope is None and len(found.outliers) == 0


def test_one_row_off_a_perfect_line_is_the_outlier() -> None:
    x = np.linspace(0.3, 4.0, 20)
    y = x.copy()
    y[4] += 0.1
    found = calibrate(x, y)
    assert found.outliers.tolist() == [4] and np.all(np.isfinite(found.studentised))


def test_a_slope_of_the_noise_that_rests_on_one_outlier_is_told() -> None:
    rng = np.random.default_rng(6)
    x, y = drawn(rng, 40, 0.01, 0.0)
    y[1] += 0.3
    found = calibrate(x, y)
    assert not found.varies and found.outliers.tolist() == [1] and found.rests_on_outliers
    x, y = drawn(rng, 80, 0.0005, 0.02)
    y[40] += 1.0
    found = calibrate(x, y)
    assert found.varies and found.outliers.tolist() == [40] and not found.rests_on_outliers


def test_three_spikes_among_255_rows_change_nothing() -> None:
    x, y = drawn(np.random.default_rng(3), 255, 0.0033, 0.0)
    spiked = y.copy()
    spiked[[40, 41, 200]] += [0.4, 0.35, -0.5]
    found, without = calibrate(x, spiked), calibrate(*(np.delete(v, [40, 41, 200]) for v in (x, y)))
    assert found.outliers.tolist() == [40, 41, 200] and not found.too_many_outliers
    assert found.scale == without.scale and found.bias == without.bias and found.noise_sd == without.noise_sd
    bent = calibrate(x, np.where(np.arange(255) % 3 == 0, x + 0.5, y))
    assert bent.too_many_outliers or len(bent.outliers) == 0, "a third of the rows is no outlier"


def test_the_line_of_the_noise_is_never_below_its_least() -> None:
    x, y = drawn(np.random.default_rng(2), 200, 0.0, 0.02)
    found = calibrate(x, y)
    assert found.varies and found.least_sd > 0
    assert found.least_sd == pytest.approx(found.noise_sd.value * found.relative_sd.min())


def test_repeated_distances_of_coarse_readings_are_fitted() -> None:
    x = np.repeat([0.5, 1.0, 2.0], 4)
    y = np.round(x + np.tile([0.0, 0.0, 0.01, -0.01], 3), 2)
    y[:4] = 0.5  # no noise at all at one distance
    found = calibrate(x, y)
    assert isinstance(found, Calibration) and found.noise_sd.low < found.noise_sd.value < found.noise_sd.high
    assert all(np.isfinite(found.to_dict()["bias_m"]))


def test_many_rows_are_weighted_in_cells_as_a_thousand_are_one_by_one() -> None:
    rng = np.random.default_rng(2)
    x = np.linspace(0.25, 4.45, 4200)  # more than there are cells
    y = SCALE * x + BIAS + (0.005 + 0.004 * x) * rng.standard_normal(len(x))
    cells, exact = calibrate(x, y), _one_by_one(x, y)
    assert cells.bias.to_list() == pytest.approx(exact.bias.to_list(), abs=2e-7)  # metres
    assert cells.noise_sd.to_list() == pytest.approx(exact.noise_sd.to_list(), rel=1e-5)


def _one_by_one(x: np.ndarray, y: np.ndarray) -> Calibration:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("surctl.marine.sensing.calibration.noise_shape._CELLS", len(x))
        return calibrate(x, y)


GOOD = np.linspace(0.3, 3.0, 10)
REFUSED = {
    "too few": ((GOOD[:5], GOOD[:5]), "5 complete rows are too few"),
    "none": (([], []), "0 complete rows"),
    "one distance": ((np.ones(9), GOOD[:9]), "1 distinct true distance "),
    "two distances": ((np.tile([1.0, 2.0], 5), GOOD), "2 distinct true distances"),
    "NaN": ((GOOD, np.where(GOOD > 2, np.nan, GOOD)), "finite"),
    "negative": ((GOOD, -GOOD), "at least 0"),
    "centimetres": ((GOOD, 100 * GOOD), "100 times"),
    "lengths": ((GOOD, GOOD[:9]), "shapes"),
    "two axes": ((GOOD.reshape(2, 5), GOOD.reshape(2, 5)), "shapes"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_fitted_is_refused(case: str) -> None:
    (x, y), words = REFUSED[case]
    with pytest.raises(InputError, match=words):
        calibrate(x, y)


@pytest.mark.parametrize("seed", range(12))
def test_a_sensor_that_does_not_follow_the_distance_is_no_calibration(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(0.3, 4.0, int(rng.integers(6, 60))))
    stuck = float(rng.uniform(1.0, 3.0))
    for y in (
        np.full(len(x), stuck),  # exactly: the scale is rounding, of either sign
        stuck + 0.2 * rng.standard_normal(len(x)) * (x.std() > 0) - 0.02 * (x - x.mean()),
        x.max() + x.min() - x,  # the scale is -1
    ):
        with pytest.raises(InputError, match=r"measured: does not rise with the true distance: the scale, .*stuck"):
            calibrate(x, np.abs(y))
    assert calibrate(x, 0.9 * x + 0.1 + 0.001 * rng.standard_normal(len(x))).scale.low > 0

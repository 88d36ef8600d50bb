"""Intervals of fitted parameters for coloured residuals too; axes at rest, and what a log does not determine.

The covariance of the estimates is the sandwich B⁻¹ M B⁻¹ (White 1982; Newey & West 1987): B is the information of the
normalised residuals, M the covariance of their weighted sum. M follows from the auto- and cross-correlations of the
residuals, up to a lag that is chosen by the rule of Politis (2003) with his flat-top window. A fit takes up a part of
the noise, above all of its slow part, because masses and drag can represent it. The correlations of the residuals are
therefore too small; what the fit has taken up is added to them. Otherwise intervals would be an eighth too short.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.marine.vehicle.identification.model import AXIS_OF, CONSTANT_FORCE, OFFSETS, LogSection, Model, axes_of
from surctl.marine.vehicle.identification.prediction import Trial
from surctl.marine.vehicle.identification.solve import products
from surctl.marine.vehicle.motion_log import MotionLog
from surctl.marine.vehicle.specs import TERMS

Array = NDArray[np.float64]

_QUIET = 5  # successive correlations within the noise after which the correlation has ended
_LONGEST_SHARE = 0.25  # longest lag, as a share of the rows of a section
_CORRECTIONS = 2  # of the covariances by what the fit has taken up; each is smaller by this share


@dataclass(frozen=True, eq=False)
class Spread:
    """The uncertainty of fitted parameters.

    Attributes:
        covariance: (p, p) of the scaled parameters, with all of them free.
        freedom: degrees of freedom of the estimated covariance.
    """

    covariance: Array
    freedom: float

    def half_intervals(self) -> Array:
        """Return half the width (p,) of the 95 % intervals of the scaled parameters (Student's t)."""
        return self.quantile * np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def quantile(self) -> float:
        """The 97.5 % quantile of Student's t with `freedom` degrees of freedom."""
        from scipy.special import stdtrit  # slow to import

        return float(stdtrit(max(self.freedom, 3.0), 0.975))


def spread_of(parts: list[tuple[Array, Array]], present: list[NDArray[np.bool_]], prior: Array, first: Array) -> Spread:
    """Return the uncertainty of the parameters from the normalised residuals and their derivatives.

    Args:
        parts: for each section the residuals (n, c) and derivatives (n, c, p + s) by the parameters and the section's
            initial state, both 0 where no measurement exists.
        present: for each section which residuals (n, c) exist.
        prior: (p,) prior weights 1/σ² of the parameters.
        first: (s,) prior weights of an initial state.
    """
    size, columns = len(prior), np.flatnonzero(np.vstack(present).any(axis=0))
    parts = [(e[:, columns], slope[:, columns]) for e, slope in parts]
    present = [p[:, columns] for p in present]
    split = [_without_initial(slope, size, first) for _, slope in parts]
    slopes = [slope for slope, _, _ in split]
    known = np.diag(prior) + np.sum([through for _, _, through in split], axis=0)
    inverse = _inverse(known + sum(_over_rows(s, s) for s in slopes))
    root = np.asarray(np.linalg.cholesky(inverse), dtype=np.float64)
    fitted = [np.concatenate([slope @ root, own], axis=-1) for slope, own, _ in split]
    correlation, lag, independent = _correlation([e for e, _ in parts], present, fitted, size)
    freedom = independent - size - len(first) * len(parts)
    if not lag:
        return Spread(inverse, freedom)
    coloured = inverse @ (known + _meat(slopes, correlation)) @ inverse
    if np.diag(coloured).min() <= 0:
        coloured = _semidefinite(coloured, root)
    rows = sum(len(e) for e, _ in parts)
    freedom = min(freedom, 2.0 * rows / (2.0 * float(np.sum(_window(lag) ** 2)) - 1.0))
    # an estimate of M may be too small; the residuals count as white noise at least
    larger = np.sqrt(np.maximum(np.diag(inverse) / np.maximum(np.diag(coloured), 1e-300), 1.0))
    return Spread(coloured * np.outer(larger, larger), freedom)


def _semidefinite(coloured: Array, root: Array) -> Array:
    """Return a covariance without the negative variances that a flat-top window may cause (Politis 2011).

    The eigenvalues are those relative to the covariance `root root'` for white noise.
    """
    relative = np.linalg.solve(root, np.linalg.solve(root, coloured).T)
    values, vectors = np.linalg.eigh((relative + relative.T) / 2)
    scaled = root @ (vectors * np.sqrt(np.maximum(values, 0.0)))
    return np.asarray(scaled @ scaled.T)


def _without_initial(slope: Array, size: int, first: Array) -> tuple[Array, Array, Array]:
    """Return the derivatives (n, c, p) with the best initial state for every value of the parameters, and its own.

    The derivatives (n, c, s) by the initial state are scaled to an orthonormal basis. The third result (p, p) is the
    information about the parameters from the prior of the initial state, e.g. from that of a drifting constant force.
    """
    flat = slope.reshape(-1, slope.shape[-1])
    over_p, over_first = flat[:, :size], flat[:, size:]
    inverse = _inverse(over_first.T @ over_first + np.diag(first))
    change = inverse @ (over_first.T @ over_p)  # of the best initial state, with the sign reversed
    reduced = over_p - over_first @ change
    basis = over_first @ np.linalg.cholesky(inverse)
    return (
        reduced.reshape(*slope.shape[:2], size),
        basis.reshape(*slope.shape[:2], len(first)),
        change.T @ (first[:, None] * change),
    )


def _inverse(matrix: Array) -> Array:
    # also of a nearly singular matrix
    scale = np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    values = np.maximum(values, 1e-14 * values[-1])
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


def _correlation(
    left: list[Array], present: list[NDArray[np.bool_]], fitted: list[Array], size: int
) -> tuple[Array, int, float]:
    """Return the windowed covariances (lags + 1, c, c), the last lag, and the number of independent residuals.

    They are those of the noise. The residuals have less covariance, because the fit has taken up the part of the noise
    that its directions `fitted` (n, c, p + s) can represent; the first `size` directions are common to all sections.
    """
    longest = max(int(_LONGEST_SHARE * max(len(e) for e in left)), 1)
    count = 1 << (2 * max(len(e) for e in left) - 1).bit_length()
    columns = left[0].shape[1]
    cross, pairs = np.zeros((2, count, columns, columns))
    for e, p in zip(left, present, strict=True):
        fe, fp = np.fft.rfft(e, count, axis=0), np.fft.rfft(p.astype(float), count, axis=0)
        cross += np.fft.irfft(np.conj(fe)[:, :, None] * fe[:, None, :], count, axis=0)
        pairs += np.fft.irfft(np.conj(fp)[:, :, None] * fp[:, None, :], count, axis=0)
    cross, pairs = cross[: longest + 1], pairs[: longest + 1]
    numbers = np.vstack(present).sum(axis=0).astype(float)
    result = _windowed(np.where(pairs > 0.5, cross / np.maximum(pairs, 0.5), 0.0), numbers)
    for _ in range(_CORRECTIONS if result[1] else 0):
        lost = _absorbed(_spectrum(result[0], count), fitted, present, size)[: longest + 1]
        result = _windowed(np.where(pairs > 0.5, (cross + lost) / np.maximum(pairs, 0.5), 0.0), numbers)
    return result


def _windowed(raw: Array, numbers: Array) -> tuple[Array, int, float]:
    longest, lag, independent = len(raw) - 1, 0, 0.0
    for c in np.flatnonzero(numbers > 2):
        own = raw[:, c, c] / max(raw[0, c, c], 1e-300)
        end = _end(own[1:], numbers[c])
        lag = max(lag, min(2 * end, longest))
        window = _window(2 * end)[: longest + 1] if end else np.ones(1)
        independent += numbers[c] / max(1.0 + 2.0 * float(np.sum((window * own[: len(window)])[1:])), 1.0)
    return raw[: lag + 1] * _window(lag)[:, None, None], lag, independent


def _absorbed(
    spectrum: NDArray[np.complex128], fitted: list[Array], present: list[NDArray[np.bool_]], size: int
) -> Array:
    """Return the sums of products (count, c, c) by lag that the fit has removed from noise with a spectrum.

    With the directions P and the covariance Σ of the noise, the residuals have the covariance Σ − P Zᵀ − Z Pᵀ with
    Z = Σ P − P G / 2 and G = Pᵀ Σ P. In G, the directions common to all sections count over all of them.
    """
    count = 2 * (len(spectrum) - 1)
    moved = [
        np.fft.irfft(np.conj(spectrum) @ np.fft.rfft(directions, count, axis=0), count, axis=0)[: len(p)]
        * p[:, :, None]
        for directions, p in zip(fitted, present, strict=True)
    ]
    within = [_over_rows(d, m) for d, m in zip(fitted, moved, strict=True)]
    common = np.sum([product[:size, :size] for product in within], axis=0)
    removed = np.zeros_like(spectrum)
    for directions, move, product in zip(fitted, moved, within, strict=True):
        product[:size, :size] = common
        other = np.fft.rfft(move - directions @ (product / 2), count, axis=0)
        half = np.conj(np.fft.rfft(directions, count, axis=0)) @ other.transpose(0, 2, 1)
        removed += half + np.conj(half.transpose(0, 2, 1))
    return np.fft.irfft(removed, count, axis=0)


def _over_rows(one: Array, other: Array) -> Array:
    # (p, q) from (n, c, p) and (n, c, q)
    return products(one.reshape(-1, one.shape[-1]), other.reshape(-1, other.shape[-1]))


def _end(correlation: Array, number: float) -> int:
    # the last lag before `_QUIET` successive correlations that do not differ from 0 (Politis 2003)
    level = 2.0 * np.sqrt(np.log10(max(number, 10.0)) / number)
    quiet = np.abs(correlation) < level
    return next((k for k in range(len(quiet)) if quiet[k : k + _QUIET].all()), len(quiet))


def _window(lag: int) -> Array:
    # flat top: 1 up to half the last lag, then linearly to 0
    at = np.arange(lag + 1) / max(lag, 1)
    return np.clip(2.0 * (1.0 - at), 0.0, 1.0) if lag else np.ones(1)


def _spectrum(covariance: Array, count: int) -> NDArray[np.complex128]:
    # (count / 2 + 1, c, c) without negative eigenvalues, from the covariances (lags + 1, c, c)
    two_sided = np.zeros((count, *covariance.shape[1:]))
    two_sided[: len(covariance)] = covariance
    two_sided[count - len(covariance) + 1 :] = covariance[:0:-1].transpose(0, 2, 1)
    spectrum = np.fft.fft(two_sided, axis=0)[: count // 2 + 1]
    values, vectors = np.linalg.eigh((spectrum + np.conj(spectrum.transpose(0, 2, 1))) / 2)
    return np.asarray((vectors * np.maximum(values, 0.0)[:, None, :]) @ np.conj(vectors.transpose(0, 2, 1)))


def _meat(slopes: list[Array], covariance: Array) -> Array:
    # Σ over pairs of rows and columns of slopeᵀ covariance slope, in the frequency domain
    count = 1 << (max(len(s) for s in slopes) + len(covariance)).bit_length()
    spectrum = _spectrum(covariance, count)
    weight = np.full(count // 2 + 1, 2.0)
    weight[[0, -1]] = 1.0
    size = slopes[0].shape[-1]
    meat = np.zeros((size, size))
    for slope in slopes:
        wave = np.fft.rfft(slope, count, axis=0)  # (f, c, p)
        meat += np.einsum("f,fcp,fcd,fdq->pq", weight, wave, spectrum, np.conj(wave), optimize=True).real / count
    return meat


_FEW = 0.1  # smallest share of rows with thrust, or of its changes, that determine a lag
_LEAST_CHANGES = 8  # changes of thrust that determine a lag
_CHANGE = 0.02  # share of the largest thrust that counts as a change
_WIDE = 0.5  # relative half-interval of a direction above which it is named
_SHARE = 0.4  # smallest component of a direction that is named, relative to the largest
_WHITE = 4.0  # correlation of neighbouring residuals over its standard deviation, above which they are not white noise
_SLOW, _SLOW_SHARE = 2.0, 0.5  # [s] slow residuals: share of the variance that means over this time have
_ROUNDING = 1e-6  # [m, rad, m/s, rad/s] residual standard deviation that is only rounding

_POSE, _RATE = np.array([0, 1, 2, 3, 8, 9]), np.array([4, 5, 6, 7, 10, 11])  # columns of surge to yaw, roll, pitch


def at_rest(model: Model, theta: Array, noise: Array) -> frozenset[str]:
    """Return the names of the masses on axes that did not move by more than the noise.

    There the fit interprets noise as motion, and the mass wrongly seems to be identified. An axis has moved if its
    velocity exceeds the noise of the measured velocity, or its displacement in the sections that of the measured
    position or heading: a body that oscillates, such as a fish with its tail, may have a velocity that is mostly noise
    for the model.
    """
    axes = len(model.masses)
    present = np.atleast_1d(model.present.any(axis=0))
    states = model.states(theta, model.sections)
    velocities = [x[:, model.outputs[_RATE[:axes]]] for x in states]
    fast = np.sqrt(np.mean(np.vstack(velocities) ** 2, axis=0)) > noise[_RATE[:axes]]
    paths = [np.cumsum(v[1:] * s.dt[:, None], axis=0) for v, s in zip(velocities, model.sections, strict=True)]
    displaced = np.sqrt(np.mean(np.vstack([(p - p.mean(axis=0)) ** 2 for p in paths]), axis=0))
    level = noise[_POSE[:axes]]
    level[:2] = max(level[:2])
    far = (displaced > level) & _placed(present, axes)
    still = ~((fast & present[_RATE[:axes]]) | far)
    return frozenset(np.array(model.masses)[still].tolist())


def measured_forces(model: Model) -> frozenset[str]:
    """Return the names of the constant forces on axes with a measured pose or velocity."""
    return frozenset(k for k, measured in zip(CONSTANT_FORCE, _measured_axes(model), strict=False) if measured)


def _measured_axes(model: Model) -> NDArray[np.bool_]:
    """Return which axes of the vehicle (4,) or (6,) have a measured pose or velocity."""
    axes = len(model.masses)
    present = np.atleast_1d(model.present.any(axis=0))
    return np.asarray(present[_RATE[:axes]] | _placed(present, axes))


def _placed(present: NDArray[np.bool_], axes: int) -> NDArray[np.bool_]:
    # which axes have a measured pose; surge and sway need both x and y
    placed = np.asarray(present[_POSE[:axes]])
    placed[:2] = placed[:2].all()
    return placed


def few_thrusts(log: MotionLog, sections: tuple[LogSection, ...]) -> str:
    """Return why the thrust of a log does not determine a lag; an empty text if it does."""
    largest = np.max(np.abs(log.thrust), axis=0)
    scale = np.where(largest > 0, largest, 1.0)
    thrust = [log.thrust[s.rows] / scale for s in sections]
    pushed = float(np.mean(np.concatenate([(np.abs(t) > _CHANGE).any(axis=1) for t in thrust])))
    rows = sum(len(t) for t in thrust)
    if pushed < _FEW:
        return f"the thrust is not 0 in only {round(pushed * rows)} of {rows} rows"
    changes = sum(int((np.abs(np.diff(t, axis=0)) > _CHANGE).any(axis=1).sum()) for t in thrust)
    return f"the thrust changes only {changes} times" if changes < _LEAST_CHANGES else ""


def ill_excited(
    model: Model, spread: Spread, estimates: Mapping[str, tuple[float, float]], rest: frozenset[str]
) -> tuple[str, ...]:
    """Return the axes at rest, and the combinations of parameters that the log does not determine, one text each.

    The combinations are the eigenvectors of the covariance of the relative changes with a large eigenvalue.
    """
    unmeasured = {k for k, measured in zip(model.masses, _measured_axes(model), strict=True) if not measured}
    force_of = dict(zip(model.masses, CONSTANT_FORCE, strict=False))
    texts = [
        f"{AXIS_OF[k]}: not measured, so {k}, its drag and {force_of.get(k, 'its moment')} are unknown"
        if k in unmeasured
        else f"{AXIS_OF[k]}: no motion above the noise, so {k} and its drag are unknown"
        for k in AXIS_OF
        if k in rest
    ]
    unknown = set(CONSTANT_FORCE) - measured_forces(model)
    names = [k for k in model.names if not axes_of(k) & rest and k not in unknown]
    places = [model.names.index(k) for k in names]
    scale = model.scale[places]
    size = np.array(
        [max(abs(estimates[k][0]), (0.1 if k in OFFSETS else 1.0) * s) for k, s in zip(names, scale, strict=True)]
    )
    size *= np.sign([estimates[k][0] or 1.0 for k in names])  # a change away from 0 is positive
    covariance = spread.covariance[np.ix_(places, places)] * np.outer(scale / size, scale / size)
    values, vectors = np.linalg.eigh(covariance)
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        wide = 1.96 * float(np.sqrt(max(value, 0.0)))
        if wide <= _WIDE:
            break
        large = sorted(np.flatnonzero(np.abs(vector) >= _SHARE * np.abs(vector).max()), key=lambda k: -abs(vector[k]))
        vector = vector * np.sign(vector[large[0]])
        if len(large) == 1:
            texts.append(f"{names[large[0]]} is uncertain by ± {wide:.0%}")
        else:
            sign = " ".join(f"{'+' if vector[k] > 0 else '-'}{names[k]}" for k in large)
            texts.append(f"{sign} (changes together, relative to their values) is uncertain by ± {wide:.0%}")
    return tuple(texts)


def notes_of(model: Model, left: list[Array]) -> tuple[str, ...]:
    """Return a text that names the columns whose residuals are not white noise, with possible causes; or none."""
    coloured = []
    for k, column in enumerate(model.columns):
        series = [e[model.present[s.rows][:, k], k] for s, e in zip(model.sections, left, strict=True)]
        number, square = sum(len(e) for e in series), sum(float(e @ e) for e in series)
        if number < 3 or np.sqrt(square / number) < _ROUNDING:
            continue
        alike = sum(float(e[1:] @ e[:-1]) for e in series) / square
        if abs(alike) * np.sqrt(number) > _WHITE:
            coloured.append(f"{column} ({alike:+.2f})")
    if not coloured:
        return ()
    return (
        f"residuals are not white noise: {', '.join(coloured)} (correlation from row to row); the intervals allow for "
        "slow noise, but not for what the model misses: a delay or another curve of the thrust, a current, filtered "
        "measurements, another drag law",
    )


def slow_residuals(model: Model, left: list[Array]) -> bool:
    """Return whether residuals are mainly slow: the means over two seconds have most of the variance of a column."""
    rows = max(int(_SLOW / float(np.median(np.diff(model.log.time)))), 2)
    for k in range(len(model.columns)):
        series = [e[model.present[s.rows][:, k], k] for s, e in zip(model.sections, left, strict=True)]
        blocks = [e[: len(e) // rows * rows].reshape(-1, rows) for e in series]
        values = np.vstack(blocks)
        if len(values) > 2 and np.mean(values.mean(axis=1) ** 2) > _SLOW_SHARE * max(np.mean(values**2), _ROUNDING**2):
            return True
    return False


def drift_note(model: Model, theta: Array, trial: Trial | None) -> list[str]:
    """Return a text with the range of the constant force over the log, if it drifts, or why a drift is not fitted."""
    if trial is None:
        return []
    if not model.drift:
        return [
            "residuals are slow: a constant force that drifts was tried and not used, because with it the errors of "
            f"predicting unseen parts over {trial.window:g} s are {trial.ratio:.3g} times those without it; the "
            "model misses something else"
        ]
    own = theta[model.size :].reshape(-1, model.local)[:, model.order :]
    values = model.values(theta)
    ends = np.concatenate([own[:, :4] - own[:, 4:], own[:, :4] + own[:, 4:]])
    listed = [
        f"{k} from {values[k] + low:.3g} to {values[k] + high:.3g} {TERMS[k].unit}"
        for k, low, high in zip(CONSTANT_FORCE, ends.min(axis=0), ends.max(axis=0), strict=True)
    ]
    return [
        f"the constant force drifts ({', '.join(listed)}); each section of the log has its own force, which changes "
        "linearly, and the file has the mean; with it the errors of predicting unseen parts over "
        f"{trial.window:g} s are {trial.ratio:.3g} times those without it"
    ]

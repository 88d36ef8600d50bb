"""The disk margin of several loops at once, S and T, independent of units; the least margin, text of short ones.

The signal of loop k is multiplied by (2 + δ_k)/(2 − δ_k), where δ_k is any stable complex dynamics with |δ_k| < α (the
balanced disk margin of Seiler, Packard and Gahinet 2020). The largest α is 1/sup_ω μ(M(jω)) with M = (S − T)/2, where S
and T are the sensitivity and the complementary sensitivity, and μ is the structured singular value for diagonal complex
perturbations (Doyle 1982). μ has two bounds:

- upper bound, the minimum over D of the largest singular value σ_max(D M D⁻¹), with D diagonal and positive: no
  perturbation smaller than the inverse of this bound destabilises the loop;
- lower bound, the maximum over U of the spectral radius ρ(U M), with U diagonal and unitary: the perturbation U/ρ
  destabilises the loop.

The peak of μ over frequency is first searched on a grid of frequencies. A second step shows without a grid that no
higher peak lies between the grid points: for a fixed D, the largest singular value σ_max(D M(jω) D⁻¹) equals a given
level only at frequencies ω at which a Hamiltonian matrix has an eigenvalue jω (Boyd and Balakrishnan 1990). One matrix
D is therefore valid at all frequencies up to the next such ω; from that ω on, another matrix D is chosen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.ir.cache import stored_numbers
from surctl.system.linear_loop import distinct, independent
from surctl.verification.loops import LEAST_DELAY_MARGIN, golden_section

# An open loop with several channels as matrices: several loops opened at once, or one


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OpenLoop:
    """The open loop L(s) = C (sI − A)⁻¹ B + D with q channels, for negative feedback; leading axes hold several loops.

    Attributes:
        A: system matrix (…, n, n) [1/s].
        B: input matrix (…, n, q).
        C: output matrix (…, q, n).
        D: feedthrough matrix (…, q, q) of L; I + D must be invertible.
        dt: control period [s] if s stands for z = (1 + s)/(1 − s) of a sampled loop (`of_sampled`); else 0.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    dt: float = 0.0

    @classmethod
    def of_sampled(cls, A: Array, B: Array, C: Array, D: Array, dt: float) -> OpenLoop:
        """Return the loop L(z) = C (zI − A)⁻¹ B + D by z = (1 + s)/(1 − s), from the circle to the axis.

        The transformation keeps every value of the frequency response, at the frequency that `warped` gives; −1 must
        not be an eigenvalue of A.
        """
        eye = np.eye(A.shape[-1])
        whole = np.linalg.inv(A + eye)
        root = np.sqrt(2)
        return cls(whole @ (A - eye), root * whole @ B, root * C @ whole, D - C @ whole @ B, dt)

    def warped(self, omega: Array) -> Array:
        """Return where on the imaginary axis of s the frequencies ω [rad/s] are."""
        return np.asarray(np.tan(0.5 * self.dt * omega) if self.dt else omega, dtype=float)

    def frequency(self, axis: float) -> float:
        """Return the frequency [rad/s] at a point of the imaginary axis of s."""
        return float(2 / self.dt * np.arctan(axis)) if self.dt else axis

    def __getitem__(self, chosen: NDArray[np.intp]) -> OpenLoop:
        """Return the loops at the given indices of the leading axis."""
        return OpenLoop(self.A[chosen], self.B[chosen], self.C[chosen], self.D[chosen], self.dt)

    def complementary(self) -> OpenLoop:
        """Return the complementary sensitivity T = L (I + L)⁻¹; the poles of T are those of the closed loop."""
        inverse = np.linalg.inv(np.eye(self.D.shape[-1]) + self.D)
        B = self.B @ inverse
        return OpenLoop(self.A - B @ self.C, B, inverse @ self.C, self.D @ inverse, self.dt)

    def response(self, omega: Array) -> NDArray[np.complex128]:
        """Return L(s) (…, k, q, q) at points s = jω of the imaginary axis, ω (k,) [rad/s]."""
        A, B, C, D = (m[..., None, :, :] for m in (self.A, self.B, self.C, self.D))
        pencil = 1j * np.asarray(omega)[:, None, None] * np.eye(A.shape[-1]) - A
        inner = np.linalg.solve(pencil, np.broadcast_to(B, (*pencil.shape[:-1], B.shape[-1])))
        return np.asarray(C @ inner + D, dtype=complex)


LEAST_DISK_MARGIN = 0.3
"""Least disk margin, in every check, goal and search: all gains off by 26 %, or all phases off by 17 deg, at once.

The *disk margin* is that of all loops opened at once, the lesser of the margins at the commands and at the
measurements, at the worst corner of the vehicle's ranges."""


def margin_text(value: float, least: float) -> str:
    """Return a margin with two decimals or digits, or with four if two would hide that it is below `least`."""
    if np.isnan(value):
        return "not determined"
    text = f"{value:{'.2f' if value >= 0.1 else '.2g'}}"
    return text if value >= least or float(text) < least else f"{value:.4g}"


def short_margins(disk: tuple[float, str], delay: tuple[float, str], *, least_delay: float = LEAST_DELAY_MARGIN) -> str:
    """Return which margins are too small, as text; empty if neither is.

    The arguments are the disk margin and the least delay margin [s] of one loop alone, each with the place where it is.
    """
    rows = (("1", LEAST_DISK_MARGIN, disk), ("s", least_delay, delay))
    return " and ".join(short_margin(unit, least, *one) for unit, least, one in rows if not one[0] >= least)


def short_margin(unit: str, least: float, value: float, where: str) -> str:
    """Return a disk margin (unit 1) or delay margin (unit s) below the least sufficient one as text."""
    word, unit = ("disk", "") if unit == "1" else ("delay", f" {unit}")
    return f"a {word} margin of {margin_text(value, least)}{unit} {where} (at least {least:g}{unit})"


Complex = NDArray[np.complex128]

_LOWEST, _HIGHEST = 1e-4, 1e3  # [rad/s]
_POINTS = 240
_SCREENED, _SCREEN_POINTS = (1e-4, 1e1), 75
_SCREENED_TOGETHER = 16  # loops evaluated together, so that their responses fit in the cache
_PEAKS = 3  # largest number of peaks of the grid that are refined
_LOW_PEAK = 0.9  # lowest peak that is refined, as a share of the highest
_SHRINKS = 24
_EXCESS = 2e-3  # the level for the proof exceeds the highest peak found by this share
_SINGLE_EXCESS = 1e-5  # the same for one channel, which needs no scaling: the disk margin of this loop alone
_SWEEPS = 12  # largest number of passes over the channels to balance a matrix
_LITTLE = 1e-6  # the passes end if they change all squared scalings by at most this share
_ROUNDS = 40
_STEPS = 400
_ON_AXIS = 1e-7  # an eigenvalue nearer to the imaginary axis than this share of its modulus counts as on the axis
_WIDEST = 1e8  # largest scaling
_UNCOUPLED = 1e-10  # square of an entry of D M D⁻¹ that counts as 0: a wider D would only cause rounding errors
_FLAT = 1e-8  # slope at which a scaling counts as optimal; the value is convex in the logarithm of the scaling


@dataclass(frozen=True)
class DiskMargin:
    """The balanced disk margin of several loops that are opened at once.

    Attributes:
        place: where the loops are opened.
        stable: whether the closed loop is stable; if it is not, `gain` is (1, 1) and every other number is 0.
        guaranteed: size α ≤ 2 of perturbations under which stability is shown at all frequencies, in floating point and
            without a grid; NaN if stability could not be shown for any α.
        reached: size α of a perturbation that was found to destabilise the loop; not less than `guaranteed`.
        frequency_rad_s: frequency [rad/s] of the destabilising perturbation.
        gain: least and largest factor that all loop gains tolerate at once, computed from `guaranteed`.
        phase_deg: largest phase error [deg] that all loops tolerate at once, computed from `guaranteed`.
    """

    place: str
    stable: bool
    guaranteed: float
    reached: float
    frequency_rad_s: float
    gain: tuple[float, float]
    phase_deg: float

    @classmethod
    def unstable(cls, place: str) -> DiskMargin:
        """Return the disk margin of loops whose closed loop is unstable."""
        return cls(place, False, 0.0, 0.0, 0.0, (1.0, 1.0), 0.0)

    def to_dict(self) -> dict[str, Any]:
        """The disk margin as plain data for JSON."""
        return {**asdict(self), "gain": list(self.gain)}

    def line(self) -> str:
        """Return the disk margin as one line of text."""
        low, high = self.gain
        if np.isnan(self.guaranteed):
            return f"all {self.place} at once: disk margin not determined"
        return (
            f"all {self.place} at once: disk margin {self.guaranteed:.3g}, gain factors {low:.3g} … {high:.3g} "
            f"or phase ±{self.phase_deg:.3g} deg, tightest at {self.frequency_rad_s:.4g} rad/s"
        )


def disk_margin(loop: OpenLoop, place: str = "") -> DiskMargin:
    """Compute the disk margin of a loop under unit negative feedback.

    If no α can be shown to hold at all frequencies, `guaranteed`, `gain` and `phase_deg` are NaN.

    Args:
        loop: the open-loop system with q channels, one for each point where the loop is opened.
        place: name of the loop opening, stored in the result.
    """
    closed = loop.complementary()
    if not np.all(np.linalg.eigvals(closed.A).real < -1e-9):
        return DiskMargin.unstable(place)
    least, where = 0.5, np.inf  # lower bound of μ at ω → ∞, where M → ½ I
    level = 0.5
    open_ends = _peaks_of(closed)
    for _ in range(_ROUNDS):
        for omega in open_ends:
            upper, lower, _ = structured_bounds(_sensitivity(closed, np.array([omega]))[0])
            level = max(level, _level(upper, len(closed.D)))
            if lower > least:
                least, where = lower, omega
        higher = _uncovered(closed, level)
        if higher is not None and np.isnan(higher):
            break
        if higher is None:
            alpha = 1 / level
            gain = (2 - alpha) / (2 + alpha)
            phase = float(np.rad2deg(2 * np.arctan(alpha / 2)))
            return DiskMargin(place, True, alpha, 1 / least, loop.frequency(where), (gain, 1 / gain), phase)
        open_ends = [higher]
        level *= 1 + _EXCESS / 4  # raise the level, because rounding decides if it lies just below the peak
    nothing = float("nan")
    return DiskMargin(place, True, nothing, 1 / least, loop.frequency(where), (nothing, nothing), nothing)


def quick_disk_margin(loop: OpenLoop) -> float:
    """Return the disk margin of a stable loop without the proof between frequencies, in a tenth of the time.

    It is the number that `disk_margin` guarantees, unless the grid of frequencies misses the peak.
    """
    closed = loop.complementary()
    matrices = (_sensitivity(closed, np.array([omega]))[0] for omega in _peaks_of(closed))
    peak = max(float(np.linalg.norm(d[:, None] * M / d, 2)) for M in matrices for d in (_scaling(M),))
    return 1 / _level(peak, len(closed.D))


def _level(upper: float, channels: int) -> float:
    # for the proof, above the highest peak found and above μ at ω → ∞
    return max(upper, 0.5) * (1 + (_EXCESS if channels > 1 else _SINGLE_EXCESS))


def _peaks_of(closed: OpenLoop) -> list[float]:
    grid = np.concatenate([[0.0], np.geomspace(_LOWEST, _HIGHEST, _POINTS)])
    return _refined(closed, grid, _local_peaks(_balanced(_sensitivity(closed, grid))[1]))


def stored_disk_margin(loop: OpenLoop, place: str) -> DiskMargin:
    """Return the disk margin of a loop, from the cache on disk if it was computed before."""
    matrices = [np.asarray(matrix, dtype=float) for matrix in (loop.A, loop.B, loop.C, loop.D, loop.dt)]
    values = stored_numbers(
        ("surctl.verification.linear",),
        [(matrix.shape, matrix.tobytes()) for matrix in matrices],
        lambda: asdict(disk_margin(loop)),
        suffix=".disk",
    )
    return DiskMargin(**{**values, "place": place, "gain": tuple(values["gain"])})


def disk_profile(loop: OpenLoop, omega: Array) -> Array:
    """Return a lower bound (k,) of the disk margin α at each single frequency ω (k,) [rad/s]."""
    at = loop.warped(np.asarray(omega, dtype=float))
    profile: Array = 1 / _balanced(_sensitivity(loop.complementary(), at))[1]
    return profile


def screened_peaks(loops: OpenLoop) -> Array:
    """Return estimates (k,) of the peak of μ over frequency for k loops, on a coarse grid; inf for an unstable loop.

    μ is the largest of the independent parts of a loop.
    """
    closed = loops.complementary()
    n = closed.A.shape[-1]
    entries = np.block([[closed.A, closed.B], [closed.C, closed.D]])
    peaks = np.zeros(len(entries))
    for group in independent((entries != 0).any(axis=0)):
        x, c = group[group < n], group[group >= n] - n
        part = OpenLoop(
            closed.A[:, x[:, None], x],
            closed.B[:, x[:, None], c],
            closed.C[:, c[:, None], x],
            closed.D[:, c[:, None], c],
        )
        first, which = distinct(part.A, part.B, part.C, part.D)
        peaks = np.maximum(peaks, _screened(part[first])[which])
    return peaks


def _screened(closed: OpenLoop) -> Array:
    stable = np.all(np.linalg.eigvals(closed.A).real < -1e-9, axis=-1)
    grid = np.geomspace(_SCREENED[0], _SCREENED[1], _SCREEN_POINTS)
    peaks = np.where(stable, 0.0, np.inf)
    index, q = np.flatnonzero(stable), closed.D.shape[-1]
    for at in (index[k : k + _SCREENED_TOGETHER] for k in range(0, len(index) if q else 0, _SCREENED_TOGETHER)):
        M = _sensitivity(closed[at], grid).reshape(-1, q, q)
        peaks[at] = _balanced(M)[1].reshape(len(at), -1).max(axis=1)
    return peaks


def structured_bounds(M: Complex) -> tuple[float, float, Complex]:
    """Return upper and lower bound of the structured singular value μ(M), and the perturbation δ of the lower bound.

    M is (q, q), and the perturbation consists of q independent complex numbers. δ satisfies det(I − diag(δ) M) = 0 with
    all |δ_k| = 1/lower. The bounds are equal for q ≤ 3 (Packard and Doyle 1993) and mostly also for larger q. If the
    lower bound is 0, δ is infinite.
    """
    scale = _scaling(M)
    _, s, vh = np.linalg.svd(scale[:, None] * M / scale[None])
    upper = float(s[0])
    # if the scaling balances the top pair, phases alone satisfy Δ w σ = v
    v = vh[0].conj()
    w = (scale[:, None] * M / scale[None]) @ v
    lower, phases = _ascended(M, np.angle(v) - np.angle(w))
    if lower <= 0:
        return upper, 0.0, np.full(len(M), np.inf + 0j)
    turned = np.exp(1j * phases)
    values = np.linalg.eigvals(turned[:, None] * M)
    top = values[np.argmax(np.abs(values))]
    return max(upper, lower), lower, turned / top


def _sensitivity(closed: OpenLoop, omega: Array) -> Complex:
    # M = ½ I − T (…, k, q, q)
    matrix: Complex = 0.5 * np.eye(closed.D.shape[-1]) - closed.response(omega)
    return matrix


def _balanced(M: Complex) -> tuple[Array, Array]:
    """Return Osborne's scalings D (k, q) of k matrices M (k, q, q), and the largest singular values (k,) of D M D⁻¹.

    The scalings nearly minimise these singular values.
    """
    size = np.abs(M) ** 2
    size[:, np.arange(M.shape[1]), np.arange(M.shape[1])] = 0.0
    square = np.ones(M.shape[:2])  # d²
    for _ in range(_SWEEPS):
        before = square.copy()
        for k in range(M.shape[1]):
            row = np.einsum("nj,nj->n", size[:, k], 1 / square) * square[:, k]
            column = np.einsum("nj,nj->n", size[:, :, k], square) / square[:, k]
            square[:, k] *= np.sqrt((column + _UNCOUPLED) / (row + _UNCOUPLED))
            square[:, k] = np.minimum(np.maximum(square[:, k], 1 / _WIDEST**2), _WIDEST**2)  # faster than np.clip
        if (np.abs(square - before) <= _LITTLE * before).all():
            break
    d = np.sqrt(square)
    scaled = d[:, :, None] * M / d[:, None]
    return d, np.linalg.norm(scaled, 2, axis=(1, 2))


def balanced(M: Complex) -> Complex:
    """Return D M D⁻¹ (k, q, q) for responses M (k, q, q) between q signals and themselves, with a diagonal D for each.

    D balances rows and columns (Osborne), which nearly minimises the largest singular value: it bounds the structured
    singular value, and does not depend on the units of the signals.

    Example:
        >>> import numpy as np
        >>> from surctl.verification.linear import balanced
        >>> in_m_and_rad, in_mm_and_rad = np.array([[[1.0, 0.2], [0.3, 2.0]], [[1.0, 200.0], [3e-4, 2.0]]])
        >>> bool(np.allclose(balanced(in_m_and_rad[None]), balanced(in_mm_and_rad[None])))
        True
    """
    d, _ = _balanced(M)
    return np.asarray(d[:, :, None] * M / d[:, None])


def _scaling(M: Complex) -> Array:
    """Return the diagonal matrix D (q,) that minimises the largest singular value of D M D⁻¹.

    This singular value is convex in log D; quasi-Newton steps start from Osborne's scaling.
    """
    from scipy.optimize import minimize

    start = np.log(_balanced(M[None])[0][0])
    if len(start) == 1:
        return np.ones(1)

    def value(log: Array) -> tuple[float, Array]:
        d = np.exp(log - log.mean())
        u, s, vh = np.linalg.svd(d[:, None] * M / d[None])
        slope = s[0] * (np.abs(u[:, 0]) ** 2 - np.abs(vh[0]) ** 2)
        return float(s[0]), slope

    run = minimize(value, start, jac=True, method="BFGS", options={"gtol": _FLAT})
    best = run.x if run.fun < value(start)[0] else start
    if not run.success:  # two equal singular values have no gradient: a simplex search continues after BFGS
        simplex = minimize(lambda x: value(x)[0], best, method="Nelder-Mead")
        best = simplex.x if simplex.fun < value(best)[0] else best
    scale: Array = np.exp(best - best.mean())
    return scale


def _ascended(M: Complex, phases: Array) -> tuple[float, Array]:
    """Return a local maximum of the spectral radius of diag(e^{jφ}) M and its phases φ, searched from given phases."""
    from scipy.optimize import minimize

    def radius(free: Array) -> float:
        turned = np.exp(1j * np.concatenate([[0.0], free]))
        return -float(np.max(np.abs(np.linalg.eigvals(turned[:, None] * M))))

    start = phases[1:] - phases[0]  # a common phase does not change ρ
    best, least = start, radius(start)
    if start.size:
        for begin in (start, np.zeros_like(start)):
            run = minimize(radius, begin, method="Nelder-Mead", options={"xatol": 1e-7, "fatol": 1e-10})
            if run.fun < least:
                best, least = run.x, float(run.fun)
    return -least, np.concatenate([[0.0], best])


def _local_peaks(values: Array) -> list[int]:
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    tops = np.flatnonzero(
        (padded[1:-1] >= padded[:-2]) & (padded[1:-1] >= padded[2:]) & (values >= _LOW_PEAK * values.max())
    )
    return [int(k) for k in tops[np.argsort(-values[tops], kind="stable")][:_PEAKS]]


def _refined(closed: OpenLoop, grid: Array, at: list[int]) -> list[float]:
    # between the neighbours on the grid
    places = np.array(at)
    low, high = grid[np.maximum(places - 1, 0)], grid[np.minimum(places + 1, len(grid) - 1)]

    def depths(omega: Array) -> Array:
        return -_balanced(_sensitivity(closed, omega.reshape(-1)))[1].reshape(omega.shape)

    best, where = depths(grid[places]), grid[places]
    for both, values in golden_section(depths, low, high, shrinks=_SHRINKS):
        for depth, omega in zip(values, both, strict=True):
            deeper = depth < best
            best, where = np.where(deeper, depth, best), np.where(deeper, omega, where)
    return [float(omega) for omega in where]


def _uncovered(closed: OpenLoop, level: float) -> float | None:
    """Return a frequency at which no D gives σ_max(D M D⁻¹) < level; None if such a D exists at every frequency.

    The result is NaN if the steps become too short to cover all frequencies.
    """
    omega = 0.0
    for _ in range(_STEPS):
        ends = (_covered(closed, scale, omega, level) for scale in _candidates(closed, omega))
        end = next((end for end in ends if end is not None), None)
        if end is None:
            return omega if omega > 0 else _LOWEST
        if not np.isfinite(end):
            return None
        beyond = _inner(end, _next(closed, _scaling(_sensitivity(closed, np.array([end]))[0]), end, level))
        if not _below(closed, beyond, level):
            return beyond  # a peak begins where the last D ended
        omega = end
    return float("nan")


def _below(closed: OpenLoop, omega: float, level: float) -> bool:
    # Osborne's fast scaling is tried first
    M = _sensitivity(closed, np.array([omega]))
    return bool(_balanced(M)[1][0] < level) or _height(closed, _scaling(M[0]), omega) < level


def _candidates(closed: OpenLoop, omega: float) -> Iterator[Array]:
    # if channels are nearly decoupled, the optimal D at ω fails at other frequencies
    for at in (omega, 1.02 * omega + 1e-3, 1.2 * omega + 1e-2, 2 * omega + 0.1):
        yield _balanced(_sensitivity(closed, np.array([at])))[0][0]
    for at in (omega, 1.02 * omega + 1e-3):
        yield _scaling(_sensitivity(closed, np.array([at]))[0])


def _covered(closed: OpenLoop, scale: Array, omega: float, level: float) -> float | None:
    """Return the frequency up to which σ_max(D M D⁻¹) stays below `level` from `omega` on; None if not at `omega`.

    Between two frequencies at which σ_max crosses the level, σ_max stays on one side, so one frequency between them is
    tested. Rounding errors would decide a test at a crossing.
    """
    end = _next(closed, scale, omega, level)
    inside = _height(closed, scale, _inner(omega, end)) < level and _height(closed, scale, omega) < level * (1 + 1e-9)
    return end if inside else None


def _next(closed: OpenLoop, scale: Array, omega: float, level: float) -> float:
    crossings = _crossings(closed, scale, level)
    ahead = crossings[crossings > omega * (1 + 1e-12) + 1e-12]
    return float(ahead[0]) if ahead.size else float("inf")


def _inner(begin: float, end: float) -> float:
    return (begin + end) / 2 if np.isfinite(end) else 2 * begin + 1.0


def _height(closed: OpenLoop, scale: Array, omega: float) -> float:
    M = _sensitivity(closed, np.array([omega]))[0]
    return float(np.linalg.norm(scale[:, None] * M / scale[None], 2))


def _crossings(closed: OpenLoop, scale: Array, level: float) -> Array:
    """Return the ascending frequencies at which a singular value of D M D⁻¹ may equal the level."""
    B, C = closed.B / scale, -scale[:, None] * closed.C
    D = scale[:, None] * (0.5 * np.eye(len(scale)) - closed.D) / scale
    inverse = np.linalg.inv(level**2 * np.eye(len(scale)) - D.T @ D)
    inner = closed.A + B @ inverse @ D.T @ C
    hamiltonian = np.block(
        [[inner, B @ inverse @ B.T], [-C.T @ (np.eye(len(scale)) + D @ inverse @ D.T) @ C, -inner.T]]
    )
    eigenvalues = np.linalg.eigvals(hamiltonian)
    near = np.abs(eigenvalues.real) <= _ON_AXIS * np.maximum(np.abs(eigenvalues), 1.0)
    return np.sort(eigenvalues.imag[near & (eigenvalues.imag > 0)])

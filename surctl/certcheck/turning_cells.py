"""Proof of V̇ < −a V in each cell of headings and each shell of V, for a vehicle with unequal masses that turns.

Let R be the rotation by the heading ψ, ν the velocity in the body frame and U = R ν. With thrust τ, drag D and yaw rate
r, M ν̇ = τ − D − C(ν)ν gives U̇ = R M⁻¹ (τ − D) − r R [[0, e1], [e2, 0]] Rᵀ U, where e1 = 1 − m22/m11 and e2 = m11/m22
− 1; the Coriolis term vanishes for equal masses. Let n_1, n_2 be the axes of the body in the path frame, and ξ = (x, y,
δU) the deviation from the steady cruise, at which x_e* = −ω/k1 and U* = (v, 0). On axis i,

    thrust − drag = φ_i ((g_i + h_i) n_iᵀ δW − g_i n_iᵀ δU) − t_i n_iᵀ δU + l_i.

δW = −(κ x, s y/Δ) is the deviation of the commanded velocity, g_i = m_i k_v the velocity gain, h_i and t_i are secant
slopes of the feedforward and of the true drag, φ_i is the share of the deviation that the thrust limit leaves, and l_i
is the error of the trim force and of the forces in `turning_terms`. So ξ̇ = A ξ + B w, where B selects the velocities.
A is affine in each of φ, h, t, κ, s, 1/m_i and (r e1, r e2). The disturbance w consists of the l_i/m_i along n_i and of
−r R [[0, e1], [e2, 0]] Rᵀ U*. For V ≥ low and a growth η > 0, 2 ξᵀ P B w ≤ ξᵀ P B w wᵀ Bᵀ P ξ/(η low) + η V. So V̇ < −a
V follows from

    Aᵀ P + P A + (a + η) P + P B Q Bᵀ P/(η low) < 0,    Q ⪰ w wᵀ.

On a curve, the path frame turns at σ, |σ| ≤ curvature · v. That adds −σ S to both diagonal blocks of A and −σ S U* to
w, with the quarter turn S. With a coupling c = m12 and ρ² = c²/(m11 m22), M⁻¹ has the diagonal 1/(m_i (1 − ρ²)), as
that of masses smaller by the factor 1 − ρ², and the other entries β = −c/(m11 m22 (1 − ρ²)): a force on axis i also
accelerates the other axis j, so n_i n_iᵀ/m_i becomes n_i n_iᵀ/m_i + β n_j n_iᵀ, which is affine in the same numbers and
in β. In the Coriolis term, e1 and e2 change by less than ρ²/(1 − ρ²) (1 + max(m11/m22, m22/m11)), and the diagonal gets
±r c (1/m11 + 1/m22)/(1 − ρ²): together a matrix of norm ≤ `loose`, whose effect is subtracted as a bound.

n_i n_iᵀ and R [[0, e1], [e2, 0]] Rᵀ are affine in z = (cos 2ψ, sin 2ψ), so the left side is convex in z. An arc of z
lies in the triangle of its ends and of the intersection of the tangents there, so the triangle's corners decide. If P
has no entry between (x, U_x) and (y, U_y), headings in [0, 90°] suffice: the others follow by reflection in the path
and in the axes of the body. The numbers are doubles: bounds are rounded outward, and a bound on all rounding errors is
subtracted before the test for positive definiteness (Rump 2006).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_exact import Matrix, inverse, root_up
from surctl.certcheck.turning_claim import TurningClaim, drag_factors
from surctl.certcheck.turning_masses import UP, coupling_of, inverse_masses, turn_points

__all__ = ["Cells", "Trim", "check_shell", "heading_cells", "steady"]

Array = NDArray[np.float64]

_ROUNDING = 1e-11  # relative rounding error of a matrix and of its factorisation
_WORST = 1e4  # largest condition of the scaled matrix of V
_FIRST = 2 * (np.sqrt(2) - 1)  # least secant slope of |u| u from v, divided by v
_PAIRS = [(i, j) for i in range(4) for j in range(i + 1)]


@dataclass(frozen=True)
class Trim:
    """The steady cruise: ω [m/s] as an affine function of the drag factors, and bounds on ω and W* = v + ω [m/s]."""

    slopes: tuple[Fraction, Fraction]
    omega: tuple[Fraction, Fraction]
    command: tuple[Fraction, Fraction]


def steady(claim: TurningClaim, slopes: tuple[Fraction, Fraction]) -> Trim:
    """Return the steady cruise with ω = slopes · (mean factor of linear drag − 1, mean factor of quadratic drag − 1).

    Raises:
        Rejected: the steady command is not positive, or reaches the speed cap.
    """
    ends = [_omega(slopes, f) for f in drag_factors(claim)]
    low, high = min(ends), max(ends)
    command = (claim.cruise + low, claim.cruise + high)
    if command[0] <= 0 or command[1] >= claim.cap:
        raise Rejected("the steady command leaves the range from 0 to the speed cap")
    return Trim(slopes, (low, high), command)


def _omega(slopes: tuple[Fraction, Fraction], f: tuple[Fraction, ...]) -> Fraction:
    """Return ω for the drag factors (linear surge, linear sway, quadratic surge, quadratic sway)."""
    return slopes[0] * ((f[0] + f[1]) / 2 - 1) + slopes[1] * ((f[2] + f[3]) / 2 - 1)


@dataclass(frozen=True)
class Cells:
    """Cells of headings ψ in [0, 90°].

    `share` (cells, 2, 2) holds the least and largest |cosine| between the path and each axis of the body, `corners`
    (cells, 3, 2) the triangles that contain (cos 2ψ, sin 2ψ), and `lack` (cells, 2) the largest |l_i| [N].
    """

    share: Array
    corners: Array
    lack: Array


def heading_cells(claim: TurningClaim, trim: Trim, count: int) -> Cells:
    """Divide the headings into `count` equal cells and bound the error of the trim force in each of them."""
    edges = np.linspace(0, np.pi / 2, count + 1)
    share = np.empty((count, 2, 2))
    for axis, ends in enumerate((np.cos(edges), np.sin(edges))):
        share[:, axis, 0] = np.clip(np.minimum(ends[1:], ends[:-1]) - 1e-12, 0, 1)
        share[:, axis, 1] = np.clip(np.maximum(ends[1:], ends[:-1]) + 1e-12, 0, 1)
    middle, half = edges[1:] + edges[:-1], edges[1] - edges[0]  # of 2ψ
    ahead, aside = np.stack([np.cos(middle), np.sin(middle)], 1), np.stack([-np.sin(middle), np.cos(middle)], 1)
    c, s = np.cos(half), np.sin(half)
    triangle = np.array([[c, -s], [c, s], [1 / c, 0.0]])
    centre = triangle.mean(axis=0)
    triangle = centre + (triangle - centre) * (1 + 1e-6)  # its edges are rounded
    corners = triangle[None, :, :1] * ahead[:, None] + triangle[None, :, 1:] * aside[:, None]
    return Cells(share, corners, _lack(claim, trim, share))


def _lack(claim: TurningClaim, trim: Trim, share: Array) -> Array:
    """Return the largest |l_i| [N] per cell; without the term in ω², l_i is affine in the drag factors."""
    v, most = claim.cruise, max(map(abs, trim.omega))
    lack = np.zeros(share.shape[:2])
    for axis in (0, 1):
        gain, linear, square = claim.mass[axis] * claim.k_v, claim.linear[axis], claim.quadratic[axis]
        low, high = share[:, axis, 0], share[:, axis, 1]
        for f in drag_factors(claim):
            omega = _omega(trim.slopes, f)
            slope = float(gain * omega + linear * (omega + (1 - f[axis]) * v))
            bend = float(square * (2 * v * omega + (1 - f[2 + axis]) * v * v))
            error = np.maximum(np.abs(slope * low + bend * low**2), np.abs(slope * high + bend * high**2))
            if bend:
                top = -slope / (2 * bend)
                error = np.where(
                    (low - 1e-9 < top) & (top < high + 1e-9), np.maximum(error, abs(slope * top / 2)), error
                )
            lack[:, axis] = np.maximum(lack[:, axis], error * UP + 1e-12 * (abs(slope) + abs(bend)))
        lack[:, axis] += float(square * most**2) * high**2 * UP
    return np.asarray(np.where(lack > 0, lack, 0.0))


class _Form:
    """V = ξᵀ P ξ in double precision, with the exact P⁻¹ rounded to doubles."""

    def __init__(self, p: Matrix) -> None:
        self.exact = inverse(p)
        self.p, self.covariance = (np.array([[float(e) for e in row] for row in m]) for m in (p, self.exact))
        self.change = np.tril(np.linalg.inv(np.linalg.cholesky(self.p)))  # T with T P Tᵀ ≈ I
        size = np.abs(self.change) @ np.abs(self.p) @ np.abs(self.change).T
        if not (size.max() <= _WORST and np.all(np.diag(self.change) > 0)):  # a NaN fails this test too
            raise Rejected("P is too ill-conditioned for double precision")
        self.side = self.change @ self.p[:, 2:]  # T P B

    def largest(self, rows: Array, axes: Array, high: float) -> float:
        """Return a bound on |n · rows ξ| over V ≤ high and unit vectors n with n nᵀ in the hull of `axes` (k, 2, 2)."""
        gram, size = rows @ self.covariance @ rows.T, np.abs(rows) @ np.abs(self.covariance) @ np.abs(rows).T
        at = np.einsum("kij,ij->k", axes, gram) + 1e-12 * np.einsum("kij,ij->k", np.abs(axes), size)
        return float(np.sqrt(max(at.max(), 0.0) * high) * UP + 1e-12)


def _commanded(claim: TurningClaim, trim: Trim, form: _Form, high: Fraction) -> tuple[list[float], list[float]]:
    """Return the ranges of s [m/s] and κ [1/s]: the commanded speed along the path, and its slope in −x_e."""
    x, y = (root_up(form.exact[k][k] * high) for k in (0, 1))
    k1, ahead = claim.k1, claim.lookahead
    most = claim.cap * ahead / root_up(ahead * ahead + y * y)  # the cap limits s √(y² + Δ²)/Δ
    if most < trim.command[1]:
        raise Rejected("the region contains points where the speed cap is below the steady command")
    if k1 * x > trim.command[0]:
        raise Rejected("the region contains points where the law would command backward motion")
    if x + max(map(abs, trim.omega)) / k1 > claim.wait / 2:
        raise Rejected("the region contains points where the path's target waits")
    steer = (trim.command[0] - k1 * x, min(trim.command[1] + k1 * x, claim.cap))
    catch = (min(k1, (most - trim.command[1]) / x), k1)
    return [float(steer[0]) / UP, float(steer[1]) * UP], [float(catch[0]) / UP, float(catch[1]) * UP]


def check_shell(
    claim: TurningClaim,
    trim: Trim,
    cells: Cells,
    p: Matrix,
    low: Fraction,
    high: Fraction,
    growth: Fraction,
    forces: tuple[Fraction, Fraction],
) -> None:
    """Prove V̇ < −a V for low ≤ V ≤ high at every heading; `forces` bounds the body forces beside equation (3) [N].

    Raises:
        Rejected: the proof fails in a cell, the law has another form in a part of the region, or the steady cruise
            alone reaches a thrust limit.
    """
    form = _Form(p)
    steer, catch = _commanded(claim, trim, form, high)
    plans = [np.diag([k, s / float(claim.lookahead)]) for k in sorted(set(catch)) for s in steer]
    turns = turn_points(claim)
    coupling = coupling_of(claim)
    per_mass, loose = inverse_masses(claim, coupling), float(coupling.loose) * UP
    lack = (cells.lack + np.array([float(force) for force in forces])) * UP
    floor = float(growth * low) / UP
    for k in range(len(cells.corners)):
        go_on()
        z = cells.corners[k]
        axes = _axes(z)
        loops = [_axis(claim, trim, form, i, axes[i], cells.share[k, i], plans, float(high)) for i in (0, 1)]
        if not _decays(claim, form, axes, z, loops, plans, turns, per_mass, lack[k], float(growth), floor, loose):
            degrees = 90 * (k + 0.5) / len(cells.corners)
            raise Rejected(f"V does not decay at the claimed rate between levels {float(low):g} and {float(high):g} "
                           f"near a heading of {degrees:.3g} degrees to the path")  # fmt: skip


def _axes(z: Array) -> tuple[Array, Array]:
    """Return n_1 n_1ᵀ and n_2 n_2ᵀ (k, 2, 2) for points (cos 2ψ, sin 2ψ) (k, 2)."""
    turned = np.stack([np.stack([z[:, 0], z[:, 1]], 1), np.stack([z[:, 1], -z[:, 0]], 1)], 1)
    return (np.eye(2) + turned) / 2, (np.eye(2) - turned) / 2


def _axis(
    claim: TurningClaim, trim: Trim, form: _Form, i: int, axes: Array, share: Array, plans: list[Array], high: float
) -> Array:
    """Return the extreme pairs (k, 2) of stiffness φ (g + h) and damping φ g + t of axis i in a cell [N s/m]."""
    still, position = np.hstack([np.zeros((2, 2)), np.eye(2)]), np.eye(2, 4)
    gain, linear, square = (float(n) for n in (claim.mass[i] * claim.k_v, claim.linear[i], claim.quadratic[i]))
    v, (slow, fast), cap = float(claim.cruise), (float(w) for w in trim.command), float(claim.cap)
    moved = form.largest(still, axes, high)
    led = max(form.largest(plan @ position, axes, high) for plan in plans)
    least, most = share[0] / UP, share[1] * UP

    def secant(a: float, b: float, speed: tuple[float, float], change: float, limit: float) -> tuple[float, float]:
        # |u| u from `speed` on has slopes from max(0.828 speed, 2 speed − change) to 2 speed + change
        steep = b * (speed[1] + min(limit, speed[1] + change))
        return a + b * max(_FIRST * speed[0], 2 * speed[0] - change) / UP, (a + steep) * UP

    h = secant(linear, square, (slow * least, fast * most), led, cap)
    low = secant(float(claim.drag_factor[0]) * linear, float(claim.drag_factor[0]) * square,
                 (v * least, v * most), moved, np.inf)[0]  # fmt: skip
    top = secant(float(claim.drag_factor[1]) * linear, float(claim.drag_factor[1]) * square,
                 (v * least, v * most), moved, np.inf)[1]  # fmt: skip
    ends = [((gain + linear) * w - gain * v) * share[j] + square * (w * share[j]) ** 2
            for w in (slow, fast) for j in (0, 1)]  # fmt: skip
    # the trim force increases with w; in the direction cosine n it is a n + b n² with b ≥ 0, so its ends bound it
    # above, and below it is at least a n
    trimmed = max(*map(abs, ends), -((gain + linear) * slow - gain * v) * share[1]) * UP
    left = float(claim.thrust[i]) - trimmed
    if not left > 0:
        raise Rejected("the steady cruise needs all the thrust of an axis")
    most_force = max(
        form.largest(np.hstack([(gain + slope) * plan, gain * np.eye(2)]), axes, high) for plan in plans for slope in h
    )
    part = min(1.0, left / most_force / UP)
    if part == 1:
        return np.array([(gain + slope, gain + t) for slope in h for t in (low, top)])
    # φ moves the rectangle of (h, t): its inner corners for the two ends of φ lie in the hull of the other six
    pairs = [(part, h[0], low), (part, h[0], top), (part, h[1], low), (1, h[0], top), (1, h[1], low), (1, h[1], top)]
    return np.array([(q * (gain + slope), q * gain + t) for q, slope, t in pairs])


def _decays(
    claim: TurningClaim,
    form: _Form,
    axes: tuple[Array, Array],
    z: Array,
    loops: list[Array],
    plans: list[Array],
    turns: list[tuple[float, float, float]],
    per_mass: list[tuple[float, float, float]],
    lack: Array,
    growth: float,
    floor: float,
    loose: float,
) -> bool:
    """Return whether V̇ < −a V holds in one cell; the arrays have the axes (1/m, turn, z, loop 1, loop 2, plan)."""
    t, side, v = form.change, form.side, float(claim.cruise)
    decay = (float(claim.rate) + growth) * UP
    kinematic = t @ form.p[:, :2] @ t[:, 2:].T
    fixed = -(kinematic + kinematic.T) - decay * (t @ form.p @ t.T)
    heavy = np.array(per_mass)
    # X = R [[0, 1], [1, 0]] Rᵀ = n_1 n_2ᵀ + n_2 n_1ᵀ, J = n_1 n_2ᵀ − n_2 n_1ᵀ = [[0, 1], [−1, 0]]
    mirror = np.array([[[-b, a], [a, b]] for a, b in z])
    twist = np.array([[0.0, 1.0], [-1.0, 0.0]])
    crossed = (mirror - twist) / 2, (mirror + twist) / 2  # n_j n_iᵀ: a force on axis i that accelerates axis j
    parts = []
    for i in (0, 1):
        hull = np.einsum("mk,kzij->mzij", heavy[:, [i, 2]], np.array([axes[i], crossed[i]]))
        led = side @ (hull[:, :, None] @ np.array(plans)) @ t[:, :2].T  # (m, z, plan, 4, 4)
        slowed = side @ hull @ t[:, 2:].T  # (m, z, 4, 4)
        led, slowed = led + led.swapaxes(-1, -2), slowed + slowed.swapaxes(-1, -2)
        whole = np.einsum("a,mzpij->mzapij", loops[i][:, 0], led)
        parts.append(whole + np.einsum("a,mzij->mzaij", loops[i][:, 1], slowed)[:, :, :, None])
    # Coriolis term r (e1 n_1 n_2ᵀ + e2 n_2 n_1ᵀ), and the turning path frame: −σ S = σ J
    curved = t @ form.p @ np.kron(np.eye(2), -twist) @ t.T
    rests, sizes = [], []
    for a, b, bend in turns:
        for k in range(len(z)):
            c = (a + b) / 2 * mirror[k] + (a - b) / 2 * twist
            own = side @ c @ t[:, 2:].T + bend * curved
            effect = side @ (c[:, 0] + [0, bend]) * v
            rests.append((own + own.T, effect))
            sizes.append(float(np.linalg.norm(effect)))
    turned = np.array([r[0] for r in rests]).reshape(len(turns), len(z), 4, 4)
    effects = np.array([r[1] for r in rests]).reshape(len(turns), len(z), 4)
    weights = [max(sizes)]
    for i in (0, 1):
        most = max(float(np.trace(side @ n @ side.T)) for n in axes[i])
        weights.append(lack[i] * heavy[:, i].max() * np.sqrt(max(most, 0.0)))
    spread = float(np.linalg.norm(side)) * UP
    weights.append(loose * v * spread)
    total = sum(weights)
    forced, force = np.zeros((len(heavy), len(turns), len(z), 4, 4)), 0.0
    if total > 0:
        if not (floor > 0 and all(weight > 0 for weight, size in zip(weights[1:3], lack, strict=True) if size > 0)):
            return False
        size = float((np.abs(t) @ np.abs(form.p[:, 2:])).sum())
        if weights[0] > 0:
            scale = total / weights[0] / floor
            forced += np.einsum("tzi,tzj->tzij", effects, effects) * scale
            force += (size * 3.3 * v * float(np.abs(turns).max())) ** 2 * scale
        for i in (0, 1):
            if lack[i] > 0:
                # w = l_i (n_i/m_i + β n_j) on axis i
                share, other = heavy[:, i], heavy[:, 2]
                mixed = np.stack([share**2, other**2, share * other], 1)
                outer = np.array([axes[i], axes[1 - i], mirror])
                along = side @ np.einsum("mk,kzij->mzij", mixed, outer) @ side.T
                scale = lack[i] ** 2 * (total / weights[1 + i] / floor)
                forced += (scale * along)[:, None]
                force += 1.1 * size**2 * float(scale * np.square(share + np.abs(other)).max())
        if loose > 0:
            scale = (loose * v) ** 2 * (total / weights[3] / floor)
            forced += scale * (side @ side.T)
            force += size**2 * scale
    base = fixed + turned[None] - forced * UP  # (m, turn, z, 4, 4)
    error = _error(form, decay, heavy, loops, plans, turns) + _ROUNDING * force
    error += 2 * loose * spread * float(np.linalg.norm(t[:, 2:])) * UP
    entries = {}
    for i, j in _PAIRS:
        one, two = parts[0][..., i, j], parts[1][..., i, j]
        whole = base[..., i, j][:, :, :, None, None, None] + (
            one[:, :, :, None] + two[:, :, None, :])[:, None]  # fmt: skip
        entries[i, j] = whole.reshape(-1) - (error if i == j else 0.0)
    return _positive(entries)


def _error(
    form: _Form,
    decay: float,
    heavy: Array,
    loops: list[Array],
    plans: list[Array],
    turns: list[tuple[float, float, float]],
) -> float:
    """Return a bound on the rounding errors of the terms of a matrix in `_decays` without disturbance."""
    t, p = np.abs(form.change), np.abs(form.p)
    block = np.full((2, 2), 1.1)  # |n_i n_iᵀ| and |R [[0, 1], [1, 0]] Rᵀ|, entry by entry
    plan = np.max([np.abs(one) for one in plans], axis=0)
    inner = np.zeros((4, 4))
    inner[:2, 2:] = np.eye(2)
    for i in (0, 1):
        stiff, damped = np.abs(loops[i]).max(axis=0) * (heavy[:, i] + np.abs(heavy[:, 2])).max()
        inner[2:, :2] += stiff * block @ plan
        inner[2:, 2:] += damped * block
    inner[2:, 2:] += 2 * np.max(np.abs(turns)) * block
    inner += np.max(np.abs(turns)) * np.kron(np.eye(2), block)
    size = 2 * t @ p @ inner @ t.T + decay * t @ p @ t.T
    return float(_ROUNDING * size.sum())


def _positive(a: dict[tuple[int, int], Array]) -> bool:
    """Return whether all Cholesky pivots of all matrices (4, 4) are positive; there is one array for each entry."""
    for k in range(4):
        if not np.all(a[k, k] > 0):  # a NaN fails this test too
            return False
        share = 1 / a[k, k]
        for i in range(k + 1, 4):
            factor = a[i, k] * share
            for j in range(k + 1, i + 1):
                a[i, j] = a[i, j] - factor * a[j, k]
    return True

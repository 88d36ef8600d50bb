"""Proof of V̇ < −a V in each cell of headings and each shell of V, for a vehicle with unequal masses that turns.

Let R be the rotation by the heading ψ, ν the velocity in the body frame and U = R ν. With thrust τ, drag D and yaw rate
r, M ν̇ = τ − D − C(ν)ν gives U̇ = R M⁻¹ (τ − D) − r R [[0, e1], [e2, 0]] Rᵀ U, where e1 = 1 − m22/m11 and e2 = m11/m22
− 1; the Coriolis term vanishes for equal masses. Let n_1, n_2 be the axes of the body in the path frame, and ξ = (x, y,
δU) the deviation from the steady cruise, at which x_e* = −ω/k1 and U* = (v, 0). On axis i,

    thrust − drag = φ_i ((g_i + h_i) n_iᵀ δW − g_i n_iᵀ δU) − t_i n_iᵀ δU + l_i

for thrust that is the present command (`turning_form` has the others).
δW = −(κ x, s y/Δ) is the deviation of the commanded velocity, g_i = m_i k_v the velocity gain, h_i and t_i are secant
slopes of the feedforward and of the true drag, φ_i is the share of the deviation that the thrust limit leaves, and l_i
is the error of the trim force and of the forces in `turning_terms`. So ξ̇ = A ξ + B w, where B selects the velocities.
A is affine in each of φ, h, t, κ, s, 1/m_i and (r e1, r e2). The disturbance w consists of the l_i/m_i along n_i and of
−r R [[0, e1], [e2, 0]] Rᵀ U*. For V ≥ low and a growth η > 0, 2 ξᵀ P B w ≤ ξᵀ P B w wᵀ Bᵀ P ξ/(η low) + η V. So V̇ < −a
V follows from

    Aᵀ P + P A + (a + η) P + P B Q Bᵀ P/(η low) < 0,    Q ⪰ w wᵀ.

In a current c, the drag and the Coriolis force act on U − c. So t_i is a secant slope from n_i (U* − c) on, and w also
has −r R [[0, e1], [e2, 0]] Rᵀ c with the opposite sign. The steady cruise shifts with the current: the steady command
is W* = (v + ω − g_x c_x, −g_y c_y) with gains g affine in the mean drag factors, x_e* = −(W*_x − v)/k1 and y_e* = −Δ
W*_y/W*_x (`turning_terms` bounds what is left of the drag's change by the current). Since the course depends on the
speed, δW_y = −s y/Δ + κ x y_e*/Δ.

On a curve, the path frame turns at σ, |σ| ≤ curvature · v. That adds −σ S to both diagonal blocks of A, and to w −σ S
U* and, in the rates of the position, −σ S (x_e*, 0), with the quarter turn S; the steady cruise does not shift with a
current there, since it would move. With a coupling c = m12 and ρ² = c²/(m11 m22), M⁻¹ has the diagonal 1/(m_i (1 −
ρ²)), as that of masses smaller by the factor 1 − ρ², and the other entries β = −c/(m11 m22 (1 − ρ²)): a force on axis i
also accelerates the other axis j, so n_i n_iᵀ/m_i becomes n_i n_iᵀ/m_i + β n_j n_iᵀ, which is affine in the same
numbers and in β. In the Coriolis term, e1 and e2 change by less than ρ²/(1 − ρ²) (1 + max(m11/m22, m22/m11)), and the
diagonal gets ±r c (1/m11 + 1/m22)/(1 − ρ²): together a matrix of norm ≤ `loose`, whose effect is subtracted as a bound.

n_i n_iᵀ and R [[0, e1], [e2, 0]] Rᵀ are affine in z = (cos 2ψ, sin 2ψ), so the left side is convex in z. An arc of z
lies in the triangle of its ends and of the intersection of the tangents there, so the triangle's corners decide. If P
has no entry between (x, U_x) and (y, U_y), headings in [0, 90°] suffice: the others follow by reflection in the path
and in the axes of the body. The numbers are doubles: bounds are rounded outward, and a bound on all rounding errors is
subtracted before the test for positive definiteness (Rump 2006).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.fields import Pair
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_exact import root_up
from surctl.certcheck.turning_claim import TurningClaim, drag_factors
from surctl.certcheck.turning_form import Form, Phase, axes_of, lipschitz, stir
from surctl.certcheck.turning_terms import (
    STILL,
    UP,
    Turn,
    coupling_of,
    flow_error,
    flow_gains,
    inverse_masses,
    outer_force,
    turn_points,
)

__all__ = ["Cells", "Disturbed", "Trim", "check_shell", "decays", "heading_cells", "steady"]

Array = NDArray[np.float64]

_ROUNDING = 1e-11  # relative rounding error of a matrix and of its factorisation
TWIST = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""J = n_1 n_2ᵀ − n_2 n_1ᵀ."""


@dataclass(frozen=True)
class Disturbed:
    """Bounds on what disturbs the inclusion in a cell.

    Attributes:
        lack: largest |l_i| (2,) [N].
        pushed: largest norm of a further error of both axes [N].
        loose: norm of the Coriolis terms that m12 adds [1/s].
        stray: largest acceleration by these terms, by the Coriolis term of the current, and by disturbance forces and
            errors of measurement [m/s²].
        late: bounds (2,) [m/s³] on w_2 along each axis (`turning_form`); 0 for thrust that is the present command.
        spread, swing: the numbers that multiply |δU| and |δW| in the bound on |w_1 + w_3| [1/s²].
        phase: which form it is, if the thrust differs from the present command.
        along: ends of the range of x_e* [m]; 0 on a straight path.
        moves: s_1 and s_2, whether the command of each axis moves.
    """

    lack: Array
    pushed: float
    loose: float
    stray: float
    late: Array
    spread: float
    swing: float
    phase: Phase
    along: tuple[float, ...] = (0.0,)
    moves: tuple[int, ...] = (1, 1)


def decays(
    claim: TurningClaim,
    form: Form,
    axes: tuple[Array, Array],
    z: Array,
    loops: list[Array],
    plans: list[Array],
    turns: list[Turn],
    per_mass: list[tuple[float, float, float]],
    disturbed: Disturbed,
    growth: float,
    floor: float,
) -> bool:
    """Return whether V̇ < −a V holds in one cell; the arrays have the axes (1/m, turn, z, loop 1, loop 2, plan)."""
    t, v, phase = form.change, float(claim.cruise), disturbed.phase
    sides = [form.levers[0] + move * form.levers[1] for move in disturbed.moves]
    pulls = [form.thrust + move * form.pulled for move in disturbed.moves]
    lack, loose, n = disturbed.lack, disturbed.loose, len(form.p)
    decay = (float(claim.rate) + growth) * UP
    kinematic = t @ form.p[:, :2] @ form.speed.T
    fixed = -(kinematic + kinematic.T) - decay * (t @ form.p @ t.T)
    heavy = np.array(per_mass)
    # X = R [[0, 1], [1, 0]] Rᵀ = n_1 n_2ᵀ + n_2 n_1ᵀ, J = n_1 n_2ᵀ − n_2 n_1ᵀ = [[0, 1], [−1, 0]]
    mirror = np.array([[[-b, a], [a, b]] for a, b in z])
    crossed = (mirror - TWIST) / 2, (mirror + TWIST) / 2  # n_j n_iᵀ: a force on axis i that accelerates axis j
    parts = []
    for i in (0, 1):
        hull = np.einsum("mk,kzij->mzij", heavy[:, [i, 2]], np.array([axes[i], crossed[i]]))
        driven = command = sides[i] @ hull  # (m, z, n, 2); no m12 with held commands
        if phase.lag:
            command = np.broadcast_to(form.thrust @ axes[i] / (phase.lag * float(claim.mass[i])), driven.shape)
        led = command[:, :, None] @ np.array(plans) @ form.place.T  # (m, z, plan, n, n)
        slowed, eased = driven @ form.speed.T, command @ form.speed.T  # (m, z, n, n)
        led, slowed, eased = (part + part.swapaxes(-1, -2) for part in (led, slowed, eased))
        whole = np.einsum("a,mzpij->mzapij", loops[i][:, 0], led)
        whole += np.einsum("a,mzij->mzaij", loops[i][:, 1], eased)[:, :, :, None]
        parts.append(whole + np.einsum("a,mzij->mzaij", loops[i][:, 2], slowed)[:, :, :, None])
    # Coriolis term r (e1 n_1 n_2ᵀ + e2 n_2 n_1ᵀ), and the turning path frame: −σ S = σ J
    curved = t @ form.p @ np.kron(np.eye(n // 2), -TWIST) @ t.T  # no curves if n = 6
    along = [x for _ in turns for x in disturbed.along]
    turns = [turn for turn in turns for _ in disturbed.along]
    rests, sizes = [], []
    for (a, b, bend, _), x in zip(turns, along, strict=True):
        for k in range(len(z)):
            c = a * sides[0] @ crossed[1][k] + b * sides[1] @ crossed[0][k]
            own = c @ form.speed.T + bend * curved
            effect = (c[:, 0] + bend * form.levers[0][:, 1]) * v + bend * x * (t @ form.p[:, 1])
            rests.append((own + own.T, effect))
            sizes.append(float(np.linalg.norm(effect)))
    turned = np.array([r[0] for r in rests]).reshape(len(turns), len(z), n, n)
    effects = np.array([r[1] for r in rests]).reshape(len(turns), len(z), n)
    weights = [max(sizes)]
    for i in (0, 1):
        most = max(float(np.trace(sides[i] @ n @ sides[i].T)) for n in axes[i])
        weights.append(lack[i] * heavy[:, i].max() * np.sqrt(max(most, 0.0)))
    spread = float(np.linalg.norm(form.lever)) * UP
    weights.append(disturbed.stray * spread)
    weights += [late * float(np.linalg.norm(pull)) for late, pull in zip(disturbed.late, pulls, strict=True)]
    weights.append(disturbed.pushed * heavy[:, :2].max() * spread)
    total = sum(weights)
    forced, force = np.zeros((len(heavy), len(turns), len(z), n, n)), 0.0
    if total > 0:
        if not floor > 0:
            return False
        size = float((np.abs(t) @ np.abs(form.p) @ form.entry).sum())
        if weights[0] > 0:
            scale = total / weights[0] / floor
            forced += np.einsum("tzi,tzj->tzij", effects, effects) * scale
            far = float(np.abs(along).max() * (np.abs(t) @ np.abs(form.p[:, 1])).sum())
            force += ((size * 3.3 * v + far) * float(np.abs(turns).max())) ** 2 * scale
        for i in (0, 1):
            scale = lack[i] ** 2 * (total / weights[1 + i] / floor) if lack[i] > 0 else 0.0
            if disturbed.pushed > 0:  # ‖M⁻¹ l‖² is that of both axes
                scale += disturbed.pushed**2 * (total / weights[6] / floor)
            if scale > 0:
                # w = l_i (n_i/m_i + β n_j) on axis i
                share, other = heavy[:, i], heavy[:, 2]
                mixed = np.stack([share**2, other**2, share * other], 1)
                outer = np.array([axes[i], axes[1 - i], mirror])
                along = sides[i] @ np.einsum("mk,kzij->mzij", mixed, outer) @ sides[i].T
                forced += (scale * along)[:, None]
                force += 1.1 * size**2 * float(scale * np.square(share + np.abs(other)).max())
            if weights[4 + i] > 0:
                scale = disturbed.late[i] ** 2 * (total / weights[4 + i] / floor)
                forced += scale * (pulls[i] @ axes[i] @ pulls[i].T)
                force += 2.2 * float(np.abs(pulls[i]).sum()) ** 2 * scale
        if disturbed.stray > 0:
            scale = disturbed.stray**2 * (total / weights[3] / floor)
            forced += scale * sum(side @ axis @ side.T for side, axis in zip(sides, axes, strict=True))
            force += size**2 * scale
    base = fixed + turned[None] - forced * UP  # (m, turn, z, n, n)
    rear, away = _behind(claim, form, axes, crossed, heavy, turns, plans, disturbed, sides)
    base = base - rear[:, None]
    error = _error(claim, form, decay, heavy, loops, plans, turns, phase.lag) + _ROUNDING * force
    error += 2 * loose * spread * float(np.linalg.norm(form.speed)) * UP
    if n > 4:
        error += 20 * _ROUNDING * float(np.abs(rear).sum(axis=(-1, -2)).max() + np.abs(away).sum(axis=(-1, -2)).max())
    entries = {}
    for i, j in [(row, column) for row in range(n) for column in range(row + 1)]:
        one, two = parts[0][..., i, j], parts[1][..., i, j]
        whole = base[..., i, j][:, :, :, None, None, None] + (
            one[:, :, :, None] + two[:, :, None, :])[:, None] - away[None, :, :, None, None, :, i, j]  # fmt: skip
        entries[i, j] = whole.reshape(-1) - (error if i == j else 0.0)
    return _positive(entries)


def _behind(
    claim: TurningClaim,
    form: Form,
    axes: tuple[Array, Array],
    crossed: tuple[Array, Array],
    heavy: Array,
    turns: list[Turn],
    plans: list[Array],
    disturbed: Disturbed,
    sides: list[Array],
) -> tuple[Array, Array]:
    """Return what F and ε add to V̇ (m, z, n, n), and what the turning heading adds to it (turn, z, plan, n, n)."""
    n, phase = len(form.p), disturbed.phase
    rear, away = np.zeros((len(heavy), len(axes[0]), n, n)), np.zeros((len(turns), len(axes[0]), len(plans), n, n))
    if n == 4:
        return rear, away
    # n_i · F m_i of the model is a force, which accelerates the true mass
    light, rates = heavy[:, :2] * [float(m) for m in claim.mass], np.array(turns)[:, 3]
    acting = sum(np.einsum("m,zij->mzij", light[:, i], sides[i] @ axes[i]) for i in (0, 1))
    if phase.lag:
        rear += acting @ form.force.T - form.thrust @ form.force.T / phase.lag
        turned = form.thrust @ TWIST @ form.force.T  # r S F = −r J F
        away -= rates[:, None, None, None, None] * (turned + turned.T)
    if claim.period and not phase.begins:
        rear += form.thrust @ form.error.T / phase.lag if phase.lag else acting @ form.error.T
    rear = rear + rear.swapaxes(-1, -2)
    if not claim.period:
        return rear, away
    q = float(form.p[-1, -1])
    rear -= (phase.fall / UP - phase.split * UP) * q * (form.error @ form.error.T)
    if phase.begins:
        each, (first, second) = q / phase.split * UP, disturbed.moves
        rear += each * disturbed.spread**2 * (form.speed @ form.speed.T)
        swung = form.levers[1] @ (first * crossed[1] - second * crossed[0])  # (z, n, 2)
        inner = np.array([form.speed.T + plan @ form.place.T for plan in plans])
        swung = swung[:, None] @ inner
        led = np.array([form.place @ plan.T @ plan @ form.place.T for plan in plans]) * (each * disturbed.swing**2)
        away += rates[:, None, None, None, None] * (swung + swung.swapaxes(-1, -2)) + led
    return rear, away


def _error(
    claim: TurningClaim,
    form: Form,
    decay: float,
    heavy: Array,
    loops: list[Array],
    plans: list[Array],
    turns: list[Turn],
    lag: float,
) -> float:
    """Return a bound on the rounding errors of the terms of a matrix in `_decays` without disturbance."""
    t, p = np.abs(form.change), np.abs(form.p)
    block = np.full((2, 2), 1.1)  # |n_i n_iᵀ| and |R [[0, 1], [1, 0]] Rᵀ|, entry by entry
    plan = np.max([np.abs(one) for one in plans], axis=0)
    n = len(p)
    own, inner = np.zeros((2, n)), np.zeros((n, n))  # acceleration, and the rates of position and curves
    inner[:2, 2:4] = np.eye(2)
    for i in (0, 1):
        per = (heavy[:, i] + np.abs(heavy[:, 2])).max() + (1 / (lag * float(claim.mass[i])) if lag else 0.0)
        stiff, damped, dragged = np.abs(loops[i]).max(axis=0) * per
        own[:, :2] += stiff * block @ plan
        own[:, 2:4] += (damped + dragged) * block
    own[:, 2:4] += 2 * np.max(np.abs(turns)) * block
    inner += form.entry @ own + np.max(np.abs(turns)) * np.kron(np.eye(n // 2), block)
    if lag:
        inner[4:6] += own
    size = 2 * t @ p @ inner @ t.T + decay * t @ p @ t.T
    return float(_ROUNDING * size.sum())


def _positive(a: dict[tuple[int, int], Array]) -> bool:
    """Return whether all Cholesky pivots of all matrices (n, n) are positive; there is one array for each entry."""
    size = max(i for i, _ in a) + 1
    for k in range(size):
        if not np.all(a[k, k] > 0):  # a NaN fails this test too
            return False
        share = 1 / a[k, k]
        for i in range(k + 1, size):
            factor = a[i, k] * share
            for j in range(k + 1, i + 1):
                a[i, j] = a[i, j] - factor * a[j, k]
    return True


_FIRST = 2 * (np.sqrt(2) - 1)  # least secant slope of |u| u from v, divided by v


@dataclass(frozen=True)
class Trim:
    """The steady cruise: ω [m/s] as an affine function of the drag factors, and bounds on ω and W*_x [m/s].

    `flow` holds the coefficients of the gains (g_x, g_y) of the current: constant, and per mean factor − 1 of linear
    and of quadratic drag. `moved` is the range of W*_x − v, `across` the largest |W*_y| [m/s], `beside` the largest
    |y_e*| [m].
    """

    slopes: tuple[Fraction, Fraction]
    omega: tuple[Fraction, Fraction]
    command: tuple[Fraction, Fraction]
    flow: tuple[Pair, Pair, Pair]
    moved: tuple[Fraction, Fraction]
    across: Fraction
    beside: Fraction


def steady(claim: TurningClaim, slopes: tuple[Fraction, Fraction], flow: tuple[Pair, Pair, Pair] = STILL) -> Trim:
    """Return the steady cruise with ω = slopes · (mean factor of linear drag − 1, mean factor of quadratic drag − 1).

    Raises:
        Rejected: the steady command is not positive, or reaches the speed cap.
    """
    ends = [_omega(slopes, f) for f in drag_factors(claim)]
    low, high = min(ends), max(ends)
    gains = [flow_gains(flow, f) for f in drag_factors(claim)]
    along, across = (max(abs(one[k]) for one in gains) * claim.current for k in (0, 1))
    moved = low - along, high + along
    command = (claim.cruise + moved[0], claim.cruise + moved[1])
    if command[0] <= 0 or command[1] >= claim.cap:
        raise Rejected("the steady command leaves the range from 0 to the speed cap")
    return Trim(slopes, (low, high), command, flow, moved, across, claim.lookahead * across / command[0])


def _omega(slopes: tuple[Fraction, Fraction], f: tuple[Fraction, ...]) -> Fraction:
    """Return ω for the drag factors (linear surge, linear sway, quadratic surge, quadratic sway)."""
    return slopes[0] * ((f[0] + f[1]) / 2 - 1) + slopes[1] * ((f[2] + f[3]) / 2 - 1)


@dataclass(frozen=True)
class Cells:
    """Cells of headings ψ in [0, 90°].

    `share` (cells, 2, 2) holds the least and largest |cosine| between the path and each axis of the body, `corners`
    (cells, 3, 2) the triangles that contain (cos 2ψ, sin 2ψ), `lack` (cells, 2) the largest |l_i| [N], and `pushed`
    (cells,) the largest norm of what a current leaves of the trim force [N].
    """

    share: Array
    corners: Array
    lack: Array
    pushed: Array


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
    pushed = np.zeros(count)
    if claim.current:
        pushed = flow_error(claim, trim.flow, (float(trim.omega[0]), float(trim.omega[1])), share)
    return Cells(share, corners, _lack(claim, trim, share), pushed)


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


def _commanded(claim: TurningClaim, trim: Trim, form: Form, high: Fraction) -> tuple[list[float], list[float]]:
    """Return the ranges of s [m/s] and κ [1/s]: the commanded speed along the path, and its slope in −x_e."""
    x, y = (root_up(form.exact[k][k] * high) for k in (0, 1))
    k1, ahead = claim.k1, claim.lookahead
    y = y + trim.beside
    most = claim.cap * ahead / root_up(ahead * ahead + y * y)  # the cap limits s √(y² + Δ²)/Δ
    if most < trim.command[1]:
        raise Rejected("the region contains points where the speed cap is below the steady command")
    if k1 * x > trim.command[0]:
        raise Rejected("the region contains points where the law would command backward motion")
    if x + max(map(abs, trim.moved)) / k1 + claim.place_error > claim.wait / 2:
        raise Rejected("the region contains points where the path's target waits")
    steer = (trim.command[0] - k1 * x, min(trim.command[1] + k1 * x, claim.cap))
    catch = (min(k1, (most - trim.command[1]) / x), k1)
    return [float(steer[0]) / UP, float(steer[1]) * UP], [float(catch[0]) / UP, float(catch[1]) * UP]


def _plans(claim: TurningClaim, trim: Trim, steer: list[float], catch: list[float]) -> list[Array]:
    """Return the slopes (2, 2) of −δW in the position at the ends of the ranges of s, κ and y_e*."""
    ahead, beside = float(claim.lookahead), float(trim.beside) * UP
    return [
        np.array([[k, 0.0], [k * y / ahead, s / ahead]])
        for k in sorted(set(catch)) for s in steer for y in sorted({beside, -beside})
    ]  # fmt: skip


def check_shell(
    claim: TurningClaim,
    trim: Trim,
    cells: Cells,
    form: Form,
    low: Fraction,
    high: Fraction,
    growth: Fraction,
    forces: tuple[Fraction, Fraction],
    phase: Phase,
) -> None:
    """Prove V̇ < −a V for low ≤ V ≤ high at every heading; `forces` bounds the body forces beside equation (3) [N].

    `phase` is a form of `turning_form`.

    Raises:
        Rejected: the proof fails in a cell, the law has another form in a part of the region, or the steady cruise
            alone reaches a thrust limit.
    """
    steer, catch = _commanded(claim, trim, form, high)
    plans = _plans(claim, trim, steer, catch)
    turns = turn_points(claim)
    coupling = coupling_of(claim)
    per_mass, loose, current = inverse_masses(claim, coupling), float(coupling.loose) * UP, float(claim.current)
    stray = loose * (float(claim.cruise) + current) + float(np.abs(np.array(turns)[:, :2]).max()) * current * UP
    beside = float(root_up(form.exact[1][1] * high) + trim.beside) * UP
    stray += outer_force(claim, beside) * max(max(a, b) + abs(c) for a, b, c in per_mass) * UP
    lack = (cells.lack + np.array([float(force) for force in forces])) * UP
    limit, (omega, fast) = _limit(claim, form, steer[1], high), _fastest(trim)
    floor = float(growth * low) / UP
    along: tuple[float, ...] = (0.0,)
    if claim.curvature:
        first, last = (float(-moved / claim.k1) for moved in reversed(trim.moved))
        along = first - abs(first) * (UP - 1), last + abs(last) * (UP - 1)
    for k in range(len(cells.corners)):
        go_on()
        z = cells.corners[k]
        axes = axes_of(z)
        loops = [_axis(claim, trim, form, i, axes[i], cells.share[k, i], plans, float(high)) for i in (0, 1)]
        rate, spread, swing = np.zeros(2), 0.0, 0.0
        if claim.behind:
            led = np.array([_led(form, plans, axes[i], float(high)) for i in (0, 1)])
            at = stir(claim, omega, fast, limit, cells.share[k, :, 1], led)
            rate = at.ahead * UP
            if claim.period and phase.begins:
                spread, swing = np.sqrt(2) * UP * at.spread, np.sqrt(2) * UP * at.swing
        disturbed = Disturbed(lack[k], float(cells.pushed[k]), loose, stray, rate, spread, swing, phase, along)
        modes = list(product((1, 0), repeat=2))
        if not phase.begins:  # s_i does not count, and the pairs of a limited command include the others
            modes = [tuple(int(loop[:, 3].min()) for loop in loops)]
        for moves in modes:
            pairs = [loop[loop[:, 3] == move, :3] for loop, move in zip(loops, moves, strict=True)]
            one = replace(disturbed, moves=moves)
            if all(map(len, pairs)) and not decays(
                claim, form, axes, z, pairs, plans, turns, per_mass, one, float(growth), floor
            ):
                degrees = 90 * (k + 0.5) / len(cells.corners)
                raise Rejected(f"V does not decay at the claimed rate between levels {float(low):g} and "
                               f"{float(high):g} near a heading of {degrees:.3g} degrees to the path")  # fmt: skip


def _fastest(trim: Trim) -> tuple[float, float]:
    """Return the largest |ω| and the largest W* [m/s]."""
    return float(max(map(abs, trim.omega))) * UP, float(trim.command[1]) * UP


def _limit(claim: TurningClaim, form: Form, fast: float, high: Fraction) -> float:
    """Return the Lipschitz constant of the commanded velocity on V ≤ high [1/s]."""
    return lipschitz(claim, fast, float(root_up(form.exact[1][1] * high)) * UP)


def _led(form: Form, plans: list[Array], axes: Array, high: float) -> float:
    """Return the largest |n_i δW| [m/s]."""
    return form.largest(form.rows(np.array(plans), np.zeros((2, 2))), axes, high)


def _axis(
    claim: TurningClaim, trim: Trim, form: Form, i: int, axes: Array, share: Array, plans: list[Array], high: float
) -> Array:
    """Return the extremes (k, 4) of axis i in a cell: φ (g + h), φ g and t [N s/m], and s_i.

    If a thrust limit may be active and the commands are held, s_i is 1 with φ = 1, and 0 with φ ≤ 1; else it is 1.
    """
    still = form.rows(np.zeros((2, 2)), np.eye(2))
    gain, linear, square = (float(n) for n in (claim.mass[i] * claim.k_v, claim.linear[i], claim.quadratic[i]))
    v, (slow, fast), cap = float(claim.cruise), (float(w) for w in trim.command), float(claim.cap)
    moved = form.largest(still, axes, high)
    led, current = _led(form, plans, axes, high), float(claim.current)
    water = max(v * share[0] - current, 0.0) / UP, (v * share[1] + current) * UP
    least, most = share[0] / UP, share[1] * UP
    aside = float(trim.across) * np.sqrt(max(1 - least**2, 0.0)) * UP  # of |n_i W*|, by the command across the path

    def secant(a: float, b: float, speed: tuple[float, float], change: float, limit: float) -> tuple[float, float]:
        # |u| u from `speed` on has slopes from max(0.828 speed, 2 speed − change) to 2 speed + change
        steep = b * (speed[1] + min(limit, speed[1] + change))
        return a + b * max(_FIRST * speed[0], 2 * speed[0] - change) / UP, (a + steep) * UP

    h = secant(linear, square, (max(slow * least - aside, 0.0), fast * most + aside), led, cap)
    low = secant(float(claim.drag_factor[0]) * linear, float(claim.drag_factor[0]) * square,
                 water, moved, np.inf)[0]  # fmt: skip
    top = secant(float(claim.drag_factor[1]) * linear, float(claim.drag_factor[1]) * square,
                 water, moved, np.inf)[1]  # fmt: skip
    ends = [((gain + linear) * w - gain * v) * share[j] + square * (w * share[j]) ** 2
            for w in (slow, fast) for j in (0, 1)]  # fmt: skip
    # the trim force increases with w; in the direction cosine n it is a n + b n² with b ≥ 0, so its ends bound it
    # above, and below it is at least a n
    trimmed = max(*map(abs, ends), -((gain + linear) * slow - gain * v) * share[1]) * UP
    trimmed += (gain + linear + 2 * square * (fast * most + aside)) * aside * UP
    left = float(claim.thrust[i]) - trimmed
    if not left > 0:
        raise Rejected("the steady cruise needs all the thrust of an axis")
    stiff = np.reshape(gain + np.array(h), (2, 1, 1, 1)) * np.array(plans)
    most_force = form.largest(form.rows(stiff, gain * np.eye(2)), axes, high)
    part = min(1.0, left / most_force / UP)
    whole = [(1.0, slope, t, 1.0) for slope in h for t in (low, top)]
    if part < 1:
        limited = [(q, slope, t) for q in (part, 1.0) for slope in h for t in (low, top)]
        if not claim.lag[1]:
            # φ moves the rectangle of (h, t): its inner corners for the two ends of φ lie in the hull of the other six
            limited = [one for one in limited if one not in {(part, h[1], top), (1.0, h[0], low)}]
        whole = [*(whole if claim.period else []), *((*one, 0.0 if claim.period else 1.0) for one in limited)]
    return np.array([(q * (gain + slope), q * gain, t, move) for q, slope, t, move in whole])

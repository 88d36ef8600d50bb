"""The decay of V in one cell of headings and one shell: positive definite matrices at all vertices of the inclusion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.turning_claim import TurningClaim
from surctl.certcheck.turning_form import Form
from surctl.certcheck.turning_late import Phase
from surctl.certcheck.turning_masses import UP, Turn

__all__ = ["Disturbed", "decays"]

Array = NDArray[np.float64]

_ROUNDING = 1e-11  # relative rounding error of a matrix and of its factorisation
TWIST = np.array([[0.0, 1.0], [-1.0, 0.0]])
"""J = n_1 n_2ᵀ − n_2 n_1ᵀ."""


@dataclass(frozen=True)
class Disturbed:
    """Bounds on what disturbs the inclusion in a cell.

    Attributes:
        lack: largest |l_i| (2,) [N].
        loose: norm of the Coriolis terms that m12 adds [1/s].
        stray: largest acceleration by these terms and by the Coriolis term of the current [m/s²].
        late: bounds (2,) [m/s³] on w_2 along each axis (`turning_late`); 0 for thrust that is the present command.
        spread, swing: the numbers that multiply |δU| and |δW| in the bound on |w_1 + w_3| [1/s²].
        phase: which form it is, if the thrust differs from the present command.
    """

    lack: Array
    loose: float
    stray: float
    late: Array
    spread: float
    swing: float
    phase: Phase


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
    t, side, v = form.change, form.lever, float(claim.cruise)
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
        led = side @ (hull[:, :, None] @ np.array(plans)) @ form.place.T  # (m, z, plan, n, n)
        slowed = side @ hull @ form.speed.T  # (m, z, n, n)
        led, slowed = led + led.swapaxes(-1, -2), slowed + slowed.swapaxes(-1, -2)
        whole = np.einsum("a,mzpij->mzapij", loops[i][:, 0], led)
        parts.append(whole + np.einsum("a,mzij->mzaij", loops[i][:, 1], slowed)[:, :, :, None])
    # Coriolis term r (e1 n_1 n_2ᵀ + e2 n_2 n_1ᵀ), and the turning path frame: −σ S = σ J
    curved = t @ form.p @ np.kron(np.eye(n // 2), -TWIST) @ t.T  # no curves if n = 6
    rests, sizes = [], []
    for a, b, bend, _ in turns:
        for k in range(len(z)):
            c = (a + b) / 2 * mirror[k] + (a - b) / 2 * TWIST
            own = side @ c @ form.speed.T + bend * curved
            effect = side @ (c[:, 0] + [0, bend]) * v
            rests.append((own + own.T, effect))
            sizes.append(float(np.linalg.norm(effect)))
    turned = np.array([r[0] for r in rests]).reshape(len(turns), len(z), n, n)
    effects = np.array([r[1] for r in rests]).reshape(len(turns), len(z), n)
    weights = [max(sizes)]
    for i in (0, 1):
        most = max(float(np.trace(side @ n @ side.T)) for n in axes[i])
        weights.append(lack[i] * heavy[:, i].max() * np.sqrt(max(most, 0.0)))
    spread = float(np.linalg.norm(side)) * UP
    weights.append(disturbed.stray * spread)
    pull = t @ form.p[:, 4:]  # of V by a change of E
    weights += [late * float(np.linalg.norm(pull)) for late in disturbed.late]
    total = sum(weights)
    forced, force = np.zeros((len(heavy), len(turns), len(z), n, n)), 0.0
    if total > 0:
        if not (floor > 0 and all(weight > 0 for weight, size in zip(weights[1:3], lack, strict=True) if size > 0)):
            return False
        size = float((np.abs(t) @ np.abs(form.p) @ form.entry).sum())
        if weights[0] > 0:
            scale = total / weights[0] / floor
            forced += np.einsum("tzi,tzj->tzij", effects, effects) * scale
            force += (size * 3.3 * v * float(np.abs(turns).max())) ** 2 * scale
        for i in (0, 1):
            scale = lack[i] ** 2 * (total / weights[1 + i] / floor) if lack[i] > 0 else 0.0
            if scale > 0:
                # w = l_i (n_i/m_i + β n_j) on axis i
                share, other = heavy[:, i], heavy[:, 2]
                mixed = np.stack([share**2, other**2, share * other], 1)
                outer = np.array([axes[i], axes[1 - i], mirror])
                along = side @ np.einsum("mk,kzij->mzij", mixed, outer) @ side.T
                forced += (scale * along)[:, None]
                force += 1.1 * size**2 * float(scale * np.square(share + np.abs(other)).max())
            if disturbed.late[i] > 0:
                scale = disturbed.late[i] ** 2 * (total / weights[4 + i] / floor)
                forced += scale * (pull @ axes[i] @ pull.T)
                force += 2.2 * float(np.abs(pull).sum()) ** 2 * scale
        if disturbed.stray > 0:
            scale = disturbed.stray**2 * (total / weights[3] / floor)
            forced += scale * (side @ side.T)
            force += size**2 * scale
    base = fixed + turned[None] - forced * UP  # (m, turn, z, n, n)
    rear, away = _behind(claim, form, axes, heavy, turns, plans, disturbed, pull)
    base = base - rear[:, None]
    error = _error(form, decay, heavy, loops, plans, turns) + _ROUNDING * force
    error += 2 * loose * spread * float(np.linalg.norm(form.speed)) * UP
    if n > 4:
        error += 20 * _ROUNDING * float(np.abs(rear).sum(axis=(-1, -2)).max() + np.abs(away).sum(axis=(-1, -2)).max())
    entries = {}
    for i, j in [(row, column) for row in range(n) for column in range(row + 1)]:
        one, two = parts[0][..., i, j], parts[1][..., i, j]
        whole = base[..., i, j][:, :, :, None, None, None] + (
            one[:, :, :, None] + two[:, :, None, :])[:, None] - away[None, :, None, None, None, :, i, j]  # fmt: skip
        entries[i, j] = whole.reshape(-1) - (error if i == j else 0.0)
    return _positive(entries)


def _behind(
    claim: TurningClaim,
    form: Form,
    axes: tuple[Array, Array],
    heavy: Array,
    turns: list[Turn],
    plans: list[Array],
    disturbed: Disturbed,
    pull: Array,
) -> tuple[Array, Array]:
    """Return what E adds to V̇ (m, z, n, n), and what the turning commands add to it (turn, plan, n, n)."""
    n, count = len(form.p), len(axes[0])
    if n == 4:
        return np.zeros((len(heavy), count, 4, 4)), np.zeros((len(turns), len(plans), 4, 4))
    # n_i · E m_i of the model is the force error, which accelerates the true mass
    light, phase = heavy[:, :2] * [float(m) for m in claim.mass] * disturbed.phase.acts, disturbed.phase
    rear = form.lever @ np.einsum("mi,izjk->mzjk", light, np.array(axes)) @ form.error.T
    rear = rear + rear.swapaxes(-1, -2)
    q = float(form.p[4, 4])
    rear = rear - (phase.fall / UP - phase.split * UP) * q * (form.error @ form.error.T)
    if not phase.drive:
        return rear, np.zeros((len(turns), len(plans), n, n))
    each = q / phase.split * UP
    rear = rear + each * disturbed.spread**2 * (form.speed @ form.speed.T)
    k_v, rates = float(claim.k_v), np.array(turns)[:, 3]
    swung = np.array([pull @ TWIST @ (form.speed.T + plan @ form.place.T) * k_v for plan in plans])
    swung = swung + swung.swapaxes(-1, -2)
    led = np.array([form.place @ plan.T @ plan @ form.place.T for plan in plans]) * (each * disturbed.swing**2)
    return rear, rates[:, None, None, None] * swung + led


def _error(
    form: Form,
    decay: float,
    heavy: Array,
    loops: list[Array],
    plans: list[Array],
    turns: list[Turn],
) -> float:
    """Return a bound on the rounding errors of the terms of a matrix in `_decays` without disturbance."""
    t, p = np.abs(form.change), np.abs(form.p)
    block = np.full((2, 2), 1.1)  # |n_i n_iᵀ| and |R [[0, 1], [1, 0]] Rᵀ|, entry by entry
    plan = np.max([np.abs(one) for one in plans], axis=0)
    n = len(p)
    own, inner = np.zeros((2, n)), np.zeros((n, n))  # acceleration, and the rates of position and curves
    inner[:2, 2:4] = np.eye(2)
    for i in (0, 1):
        stiff, damped = np.abs(loops[i]).max(axis=0) * (heavy[:, i] + np.abs(heavy[:, 2])).max()
        own[:, :2] += stiff * block @ plan
        own[:, 2:4] += damped * block
    own[:, 2:4] += 2 * np.max(np.abs(turns)) * block
    inner += form.entry @ own + np.max(np.abs(turns)) * np.kron(np.eye(n // 2), block)
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

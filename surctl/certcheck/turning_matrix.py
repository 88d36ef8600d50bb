"""Matrices whose definiteness proves the decay of V on a turning cruise, at all vertices of its parameters.

The rates of a turning cruise (`turning_cells`, `turning_form`) are A ξ + w, with an A that is affine in each of its
parameters. `Inclusion.pieces` is A, term by term; the checker and the search for V both use it. With T P Tᵀ = I, V
decays if −T (Aᵀ P + P A + (a + η) P + P W P/(η low)) Tᵀ is positive definite at all vertices, with w wᵀ ⪯ W: the parts
w_k of w are weighted by sizes s_k, (Σ w_k)(Σ w_k)ᵀ ⪯ Σ_j s_j Σ_k w_k w_kᵀ/s_k.

The numbers are doubles: a bound on all rounding errors, from the same terms with the absolute values of all numbers, is
subtracted before the test for positive definiteness (Rump 2006).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.turning_form import TWIST, Form, Phase
from surctl.certcheck.turning_terms import UP

__all__ = ["Entries", "Inclusion", "indefinite"]

Array = NDArray[np.float64]
Entries = dict[tuple[int, int], Array]
"""The entries on and below the diagonal of many matrices, an array for each."""

_ROUNDING = 1e-11  # relative rounding error of a matrix and of its factorisation
_AXES = "hmtzabp"


@dataclass(frozen=True)
class Inclusion:
    """Vertices of the parameters in a shell of V: of h cells, m masses, t turns, z headings, a and b loops, p laws.

    Attributes:
        speed, gain: cruise speed [m/s], and the law's gain k_v [1/s].
        axes, crossed: n_i n_iᵀ and n_j n_iᵀ (2, h, z, 2, 2) of the body axes i, with the other axis j.
        masses, modelled: diagonal of M⁻¹ and its other entry (m, 3) [1/kg]; masses in the law's model (2,) [kg].
        turns: r e1, r e2, turn rate of the path frame, and r (t, 4) [rad/s].
        along: x_e* (t,) [m], 0 on a straight path.
        loops: stiffness and damping by the command, and drag [N s/m], of surge (h, a, 3) and sway (h, b, 3).
        plans: slopes of −δW in the position (p, 2, 2) [1/s].
        lack: largest error |l_i| of the trim force (h, 2) [N].
        pushed: largest norm (h,) of a further error of both axes [N].
        loose: norm of the Coriolis terms that m12 adds [1/s].
        stray: largest acceleration by these terms, by the Coriolis term of the current, and by disturbance forces and
            errors of measurement [m/s²].
        late: bounds (h, 2) [m/s³] on w_2 along each axis (`turning_form`); 0 for thrust that is the present command.
        spread, swing: the numbers (h,) that multiply |δU| and |δW| in the bound on |w_1 + w_3| [1/s²].
        phase: which form it is.
        moves: s_i (2, h), whether the command of each axis moves.
        twist: `TWIST`, or its absolute values.
    """

    speed: float
    gain: float
    axes: Array
    crossed: Array
    masses: Array
    modelled: Array
    turns: Array
    along: Array
    loops: tuple[Array, Array]
    plans: Array
    lack: Array
    pushed: Array
    loose: float
    stray: float
    late: Array
    spread: Array
    swing: Array
    phase: Phase
    moves: Array
    twist: Array = field(default_factory=lambda: TWIST)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of vertices of each parameter, in the order of the axes of all results."""
        first, second = self.loops
        many = self.masses, self.turns, self.axes[0, 0], first[0], second[0], self.plans
        return len(self.lack), *map(len, many)

    def cell(self, k: int) -> Inclusion:
        """Return the vertices of one cell, no two loops of which are equal."""
        at = slice(k, k + 1)
        first, second = (np.unique(loops[k], axis=0)[None] for loops in self.loops)
        rows = {key: getattr(self, key)[at] for key in ("lack", "pushed", "late", "spread", "swing")}
        columns = {key: getattr(self, key)[:, at] for key in ("axes", "crossed", "moves")}
        return replace(self, loops=(first, second), **rows, **columns)

    def _magnitude(self) -> Inclusion:
        """Return one vertex with the largest absolute values of all numbers."""

        def most(array: Array, *same: int) -> Array:
            others = tuple(k for k in range(array.ndim) if k not in same)
            return np.asarray(np.abs(array).max(axis=others, keepdims=True))

        block = np.full((2, 1, 1, 2, 2), 1.1)  # of |n_i n_iᵀ| and |n_j n_iᵀ|, entry by entry
        rows = [most(array, 1) for array in (self.masses, self.turns, self.lack, self.late)]
        numbers = [most(array) for array in (self.along, self.pushed, self.spread, self.swing)]
        return Inclusion(
            self.speed, self.gain, block, block, rows[0], self.modelled, rows[1], numbers[0],
            (most(self.loops[0], 2), most(self.loops[1], 2)), most(self.plans, 1, 2), rows[2], numbers[1], self.loose,
            self.stray, rows[3], numbers[2], numbers[3], self.phase._replace(fall=abs(self.phase.fall), split=0.0),
            most(self.moves, 0), np.abs(self.twist),
        )  # fmt: skip

    # ---- the terms; left = T P and right = Tᵀ (n, n)

    def _own(self, left: Array) -> tuple[int, float]:
        """Return the number of the first entry of ε, and by how much an acceleration changes it [1/s]."""
        own = 6 if self.phase.lag else 4
        return own, self.gain * (len(left) > own and self.phase.begins)

    def _sides(self, left: Array) -> list[Array]:
        """Return what an acceleration along each body axis changes (h, n, 2)."""
        own, gain = self._own(left)
        held = gain * left[:, own:] if gain else np.zeros((len(left), 2))
        return [left[:, 2:4] + move[:, None, None] * held for move in self.moves]

    def _pulls(self, left: Array) -> list[Array]:
        """Return what w_2 along each body axis changes (h, n, 2)."""
        own, gain = self._own(left)
        held = left[:, own:] if gain else np.zeros((len(left), 2))
        thrust = left[:, 4:6] if self.phase.lag else np.zeros((len(left), 2))
        return [thrust + move[:, None, None] * held for move in self.moves]

    def _hull(self, i: int) -> Array:
        """Return n_i n_iᵀ/m_i + β n_j n_iᵀ (h, m, z, 2, 2): what a force on axis i accelerates."""
        return np.asarray(np.einsum("mk,khzij->hmzij", self.masses[:, [i, 2]], [self.axes[i], self.crossed[i]]))

    def pieces(self, left: Array, right: Array) -> Iterator[tuple[str, Array]]:
        """Yield the terms of T P A Tᵀ, none of which has numbers of different signs, with the names of their axes.

        The last two are those of the loops.
        """
        lag, (own, gain), sides = self.phase.lag, self._own(left), self._sides(left)
        speed, wished = right[2:4], self.plans @ right[:2]
        yield "", left[:, :2] @ speed
        # Coriolis term r (e1 n_1 n_2ᵀ + e2 n_2 n_1ᵀ), and −σ S for the turning path frame
        yield "htz", -self._coriolis(sides) @ speed
        yield "t", -self.turns[:, 2, None, None] * (left @ np.kron(np.eye(len(left) // 2), self.twist.T) @ right)
        light, rates = self.masses[:, :2] * self.modelled, self.turns[:, 3, None, None]
        # n_i · F m_i of the model is a force, which accelerates the true mass
        acting = sum(np.einsum("m,hzij->hmzij", light[:, i], sides[i][:, None] @ self.axes[i]) for i in (0, 1))
        if lag:
            yield "hmz", acting @ right[4:6]
            yield "", -left[:, 4:6] @ right[4:6] / lag
            yield "t", -rates * (left[:, 4:6] @ self.twist @ right[4:6])  # r S F
        if len(left) > own:
            error, swung = right[own:], gain * left[:, own:]
            if not self.phase.begins:
                yield ("", left[:, 4:6] @ error / lag) if lag else ("hmz", acting @ error)
            for i, sign in ((0, 1.0), (1, -1.0)) if gain else ():
                by_turn = sign * self.moves[i][:, None, None, None] * (swung @ self.crossed[1 - i])
                inner = by_turn[:, :, None] @ (speed + wished)  # (h, z, p, n, n)
                yield "htzp", rates[:, None, None] * inner[:, None]
            yield "", -(self.phase.fall / UP - self.phase.split * UP) / 2 * (left[:, own:] @ error)
        for i, loops in enumerate(self.loops):
            driven = command = sides[i][:, None, None] @ self._hull(i)  # (h, m, z, n, 2); no m12 with held commands
            if lag:
                command = (left[:, 4:6] @ self.axes[i] / (lag * self.modelled[i]))[:, None]
            stiff, damped, dragged = (loops[:, None, None, :, None, k, None, None] for k in range(3))
            whole = stiff * (command[:, :, :, None] @ wished)[:, :, :, None]
            whole = whole + damped * (command @ speed)[:, :, :, None, None]
            yield f"hmz{'ab'[i]}p", -(whole + dragged * (driven @ speed)[:, :, :, None, None])

    def _coriolis(self, sides: list[Array]) -> Array:
        """Return r (e1 n_1 n_2ᵀ + e2 n_2 n_1ᵀ) (h, t, z, n, 2)."""
        first, second = (sides[i][:, None] @ self.crossed[1 - i] for i in (0, 1))
        return np.asarray(np.einsum("tk,khzij->htzij", self.turns[:, :2], [first, second]))

    def effects(self, left: Array) -> Array:
        """Return the Coriolis term of the steady cruise, and what the turning path frame adds (h, t, z, n)."""
        bend = self.turns[:, 2, None, None]
        own = self._coriolis(self._sides(left))[..., 0]
        return np.asarray((own + bend * left[:, 3]) * self.speed + bend * self.along[:, None, None] * left[:, 1])

    def _added(self, right: Array, weight: float) -> Iterator[tuple[str, Array]]:
        """Yield what the norm bounds on w_1 + w_3 add to V̇; `weight` is q."""
        if len(right) > self._own(right)[0] and self.phase.begins:
            each, wished = weight * UP, self.plans @ right[:2]
            yield "h", each * self.spread[:, None, None] ** 2 * (right[2:4].T @ right[2:4])
            yield "hp", each * self.swing[:, None, None, None] ** 2 * (wished.swapaxes(-1, -2) @ wished)

    def _disturbed(self, left: Array, sizes: Array) -> Iterator[tuple[str, Array]]:
        """Yield P w_k w_kᵀ P/s_k for each part of w; `sizes` (7, h) are the numbers 1/s_k."""
        effects, sides, mirror = self.effects(left), self._sides(left), self.crossed[0] + self.crossed[1]
        yield "htz", sizes[0][:, None, None, None, None] * (effects[..., :, None] * effects[..., None, :])
        for i, (side, pull) in enumerate(zip(sides, self._pulls(left), strict=True)):
            # w = l_i (n_i/m_i + β n_j) on axis i; ‖M⁻¹ l‖² is that of both axes
            own, other = self.masses[:, i], self.masses[:, 2]
            outer = [self.axes[i], self.axes[1 - i], mirror]
            hull = np.einsum("km,khzij->hmzij", [own**2, other**2, own * other], outer)
            most = self.lack[:, i] ** 2 * sizes[1 + i] + self.pushed**2 * sizes[5]
            yield "hmz", most[:, None, None, None, None] * _within(side[:, None, None], hull)
            late, stray = self.late[:, i] ** 2 * sizes[3 + i], self.stray**2 * sizes[6]
            yield "hz", late[:, None, None, None] * _within(pull[:, None], self.axes[i])
            yield "hz", stray[:, None, None, None] * _within(side[:, None], self.axes[i])

    def _sizes(self, left: Array) -> tuple[Array, float]:
        """Return about the size of each part of w (7, h), by V, and the norm of what an acceleration changes."""
        sides, (own, gain), light = self._sides(left), self._own(left), np.abs(self.masses[:, :2])
        held = gain * left[:, own:] if gain else np.zeros((len(left), 2))
        spread = float(np.linalg.norm(left[:, 2:4] + held)) * UP
        sizes = [np.linalg.norm(self.effects(left), axis=-1).max(axis=(1, 2))]
        for i, side in enumerate(sides):
            most = np.trace(_within(side[:, None], self.axes[i]), axis1=-1, axis2=-2).max(axis=1)
            sizes.append(self.lack[:, i] * light[:, i].max() * np.sqrt(np.maximum(most, 0.0)))
        sizes += [self.late[:, i] * np.linalg.norm(pull, axis=(-1, -2)) for i, pull in enumerate(self._pulls(left))]
        sizes += [self.pushed * light.max() * spread, np.full(len(self.lack), self.stray * spread)]
        return np.array(sizes), spread

    def shares(self, left: Array) -> tuple[Array, float]:
        """Return the weight Σ_j s_j/s_k of each part of w (7, h), and the norm of what an acceleration changes."""
        sizes, spread = self._sizes(left)
        there = sizes > 0
        there[[1, 2, 5, 6]] = np.vstack([self.lack.T, self.pushed, np.full(len(self.pushed), self.stray)]) > 0
        return np.divide(sizes.sum(axis=0), sizes, out=np.zeros_like(sizes), where=there), spread

    # ---- the matrices

    def losses(self, form: Form, rate: float, growth: float, floor: float) -> Entries:
        """Return the matrices, of shape (h, m, t, z, a, b, p) each, that must be positive definite.

        Args:
            form: V.
            rate, growth: decay rate a and growth η [1/s].
            floor: η low.
        """
        left, right, weight = form.left, form.change.T, form.p[-1, -1] / (self.phase.split or np.inf)
        shares, spread = self.shares(left)
        shares = shares / floor
        decay = (rate + growth) * UP
        *terms, one, two = (_placed(axes, _symmetric(term)) for axes, term in self.pieces(left, right))
        more = [_placed(*term) for term in (*self._added(right, weight), *self._disturbed(left, shares))]
        base = sum(terms) + decay * (form.change @ form.p @ right) + UP * sum(more)
        whole, large, back = self._magnitude(), np.abs(form.change) @ np.abs(form.p), np.abs(right)
        size = decay * float((large @ back).sum())
        size += sum(2 * float(np.abs(term).sum()) for _, term in whole.pieces(large, back))
        most = shares.max(axis=1, keepdims=True)
        size += sum(float(term.sum()) for _, term in (*whole._added(back, weight), *whole._disturbed(large, most)))
        error = _ROUNDING * size + 2 * self.loose * spread * float(np.linalg.norm(right[2:4])) * UP
        rows = [(i, j) for i in range(len(left)) for j in range(i + 1)]
        return {
            (i, j): -(base[..., i, j] + (one[..., i, j] + two[..., i, j]) + (error if i == j else 0.0)) for i, j in rows
        }


def _within(side: Array, inner: Array) -> Array:
    return np.asarray(side @ inner @ side.swapaxes(-1, -2))


def _symmetric(term: Array) -> Array:
    return np.asarray(term + term.swapaxes(-1, -2))


def _placed(axes: str, term: Array) -> Array:
    """Return a term with an axis for each parameter."""
    counts = dict(zip(axes, term.shape, strict=False))
    return term.reshape(*(counts.get(axis, 1) for axis in _AXES), *term.shape[-2:])


def indefinite(entries: Entries, more: float = 0.0) -> NDArray[np.bool_]:
    """Return which matrices plus `more` times the identity have a Cholesky pivot that is not positive."""
    a, size = dict(entries), max(i for i, _ in entries) + 1
    if more:
        a |= {(k, k): a[k, k] + more for k in range(size)}
    good = np.ones(a[0, 0].shape, dtype=bool)
    for k in range(size):
        good &= a[k, k] > 0  # false for a NaN too
        share = 1 / np.where(good, a[k, k], 1.0)
        for i in range(k + 1, size):
            factor = a[i, k] * share
            for j in range(k + 1, i + 1):
                a[i, j] = a[i, j] - factor * a[j, k]
    return ~good

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
and in the axes of the body. The numbers are doubles, and bounds are rounded outward. `turning_matrix` has the matrices.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.document import Rejected
from surctl.certcheck.fields import Pair
from surctl.certcheck.patience import go_on
from surctl.certcheck.region_exact import root_up
from surctl.certcheck.turning_claim import TurningClaim, drag_factors
from surctl.certcheck.turning_form import Extent, Form, Phase, axes_of, lipschitz, stir
from surctl.certcheck.turning_matrix import Inclusion, indefinite
from surctl.certcheck.turning_terms import (
    STILL,
    UP,
    coupling_of,
    flow_error,
    flow_gains,
    inverse_masses,
    outer_force,
    turn_points,
)

__all__ = ["Bounds", "Cells", "Setting", "Trim", "cells_of", "check_shell", "heading_cells", "steady"]

Array = NDArray[np.float64]

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
    (cells,) the largest norm of what a current leaves of the trim force [N]. `widest` (cells, 2) is the largest
    |cosine|, or more.
    """

    share: Array
    corners: Array
    lack: Array
    pushed: Array
    widest: Array


def heading_cells(claim: TurningClaim, trim: Trim, count: int) -> Cells:
    """Divide the headings into `count` equal cells and bound the error of the trim force in each of them."""
    edges = np.linspace(0, np.pi / 2, count + 1)
    middle, half = edges[1:] + edges[:-1], edges[1] - edges[0]  # of 2ψ
    ahead, aside = np.stack([np.cos(middle), np.sin(middle)], 1), np.stack([-np.sin(middle), np.cos(middle)], 1)
    c, s = np.cos(half), np.sin(half)
    triangle = np.array([[c, -s], [c, s], [1 / c, 0.0]])
    centre = triangle.mean(axis=0)
    triangle = centre + (triangle - centre) * (1 + 1e-6)  # its edges are rounded
    corners = triangle[None, :, :1] * ahead[:, None] + triangle[None, :, 1:] * aside[:, None]
    return cells_of(claim, trim, edges[:-1], edges[1:], corners)


def cells_of(claim: TurningClaim, trim: Trim, first: Array, last: Array, corners: Array) -> Cells:
    """Return the cells of the headings from `first` to `last` (cells,), with their corners (cells, z, 2)."""
    share = np.empty((len(first), 2, 2))
    for axis, function in enumerate((np.cos, np.sin)):
        ends = np.sort([function(first), function(last)], axis=0)
        share[:, axis] = np.clip(ends.T + np.array([-1e-12, 1e-12]), 0, 1)
    pushed = np.zeros(len(first))
    if claim.current:
        pushed = flow_error(claim, trim.flow, (float(trim.omega[0]), float(trim.omega[1])), share)
    return Cells(share, corners, _lack(claim, trim, share), pushed, share[:, :, 1])


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


def _plans(claim: TurningClaim, trim: Trim, steer: list[float], catch: list[float]) -> list[Array]:
    """Return the slopes (2, 2) of −δW in the position at the ends of the ranges of s, κ and y_e*."""
    ahead, beside = float(claim.lookahead), float(trim.beside) * UP
    return [
        np.array([[k, 0.0], [k * y / ahead, s / ahead]])
        for k in sorted(set(catch)) for s in steer for y in sorted({beside, -beside})
    ]  # fmt: skip


@dataclass(frozen=True)
class Bounds:
    """What holds on {V ≤ high} in every cell.

    `free` and `limited` have the extremes (cells, k, 3) of each axis, see `Setting.loops`, for commands without a limit
    and, unless it is None, with the thrust limit, which may be `active` (2, cells). `base` has all the rest.
    """

    base: Inclusion
    free: list[Array]
    limited: list[Array | None]
    active: NDArray[np.bool_]

    def modes(self, phase: Phase) -> Iterator[tuple[NDArray[np.bool_], Inclusion]]:
        """Yield the cells for which vertices decide, and the vertices, of a form with or without held commands.

        A held command is limited, or moves, on each axis. At σ = 1 it does not count whether it moves, and the extremes
        of a limited command include the others.
        """
        moving = np.ones_like(self.active, dtype=np.float64)
        whole = [own if limited is None else limited for own, limited in zip(self.free, self.limited, strict=True)]
        base = replace(self.base, phase=phase, moves=moving)
        if not phase.split:  # neither held, nor at σ = 0
            yield np.ones(len(moving[0]), dtype=bool), replace(base, loops=(whole[0], whole[1]))
            return
        for held in product((False, True), repeat=2):
            if any(limit and one is None for limit, one in zip(held, self.limited, strict=True)):
                continue
            at = np.array(held)[:, None]
            first, second = (a if limit else b for limit, a, b in zip(held, whole, self.free, strict=True))
            decides = np.all(self.active | ~at, axis=0)
            yield decides, replace(base, loops=(first, second), moves=1.0 - (self.active & at))


@dataclass(frozen=True)
class Setting:
    """A claim, its steady cruise and its cells, with the vertices that are the same on all levels of V.

    A search may keep a share of the thrust in `reserve`.
    """

    claim: TurningClaim
    trim: Trim
    cells: Cells
    reserve: float = 0.0

    @cached_property
    def _same(self) -> tuple[float, Array, Array, Array]:
        """Return the norm of the terms that m12 adds, and masses, turns and x_e* as in `Inclusion`."""
        claim, along = self.claim, [0.0]
        if claim.curvature:
            first, last = (float(-moved / claim.k1) for moved in reversed(self.trim.moved))
            along = [first - abs(first) * (UP - 1), last + abs(last) * (UP - 1)]
        coupling, turns = coupling_of(claim), np.array(turn_points(claim))
        masses = np.array(inverse_masses(claim, coupling))
        return float(coupling.loose) * UP, masses, np.repeat(turns, len(along), axis=0), np.tile(along, len(turns))

    def bounds(self, extent: Extent, high: Fraction, forces: tuple[Fraction, Fraction]) -> Bounds:
        """Return what holds on V ≤ high; `forces` bounds the body forces beside equation (3) [N].

        Raises:
            Rejected: the law has another form in a part of the region, or the steady cruise alone reaches a thrust
                limit.
        """
        claim, trim, cells, (loose, masses, turns, along) = self.claim, self.trim, self.cells, self._same
        steer, catch = self.commanded(extent, high)
        plans, level, count = np.array(_plans(claim, trim, steer, catch)), float(high), len(self.cells.share)
        axes, crossed = axes_of(cells.corners)
        current, light = float(claim.current), (masses[:, :2] + np.abs(masses[:, 2:])).max()
        stray = loose * (float(claim.cruise) + current) + float(np.abs(turns[:, :2]).max()) * current * UP
        beside = float(extent.size(1, high) + trim.beside) * UP
        stray += outer_force(claim, beside) * light * UP
        led = np.array([extent.largest(plans, np.zeros((2, 2)), one, level) for one in axes])  # of |n_i δW|
        late, spread, swing = np.zeros((count, 2)), np.zeros(count), np.zeros(count)
        if claim.behind:
            limit = lipschitz(claim, steer[1], float(extent.size(1, high)) * UP)
            omega, fast = (float(x) * UP for x in (max(map(abs, trim.omega)), trim.command[1]))
            at = stir(claim, omega, fast, limit, cells.widest, led.T)
            late, spread, swing = at.ahead * UP, np.sqrt(2) * UP * at.spread, np.sqrt(2) * UP * at.swing
        base = Inclusion(
            float(claim.cruise), float(claim.k_v), axes, crossed, masses, np.array([float(m) for m in claim.mass]),
            turns, along, (np.zeros((count, 0, 3)),) * 2, plans, (cells.lack + [float(f) for f in forces]) * UP,
            cells.pushed, loose, stray, late, spread, swing, Phase(), np.ones((2, count)),
        )  # fmt: skip
        own = [self.loops(extent, i, axes[i], plans, led[i], level) for i in (0, 1)]
        return Bounds(base, [one[0] for one in own], [one[1] for one in own], np.array([one[2] for one in own]))

    def commanded(self, extent: Extent, high: Fraction) -> tuple[list[float], list[float]]:
        """Return the ranges of s [m/s] and κ [1/s]: the commanded speed along the path, and its slope in −x_e."""
        claim, trim, x, y = self.claim, self.trim, extent.size(0, high), extent.size(1, high) + self.trim.beside
        k1, ahead = claim.k1, claim.lookahead
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

    def loops(
        self, extent: Extent, i: int, axes: Array, plans: Array, led: Array, high: float
    ) -> tuple[Array, Array | None, NDArray[np.bool_]]:
        """Return extremes (cells, k, 3) of axis i, φ (g + h), φ g and t [N s/m], and where its limit may be active.

        The first ones have φ = 1, the second ones also φ < 1; they are None if no limit is active.
        """
        claim, trim, share = self.claim, self.trim, self.cells.share[:, i].T
        gain, linear, square = (float(n) for n in (claim.mass[i] * claim.k_v, claim.linear[i], claim.quadratic[i]))
        v, (slow, fast), cap = float(claim.cruise), (float(w) for w in trim.command), float(claim.cap)
        moved, current = extent.largest(np.zeros((1, 2, 2)), np.eye(2), axes, high), float(claim.current)
        water = np.maximum(v * share[0] - current, 0.0) / UP, (v * share[1] + current) * UP
        least, most = share[0] / UP, share[1] * UP
        aside = float(trim.across) * np.sqrt(np.maximum(1 - least**2, 0.0)) * UP  # of |n_i W*|, by the command across

        def secant(factor: float, speed: tuple[Array, Array], change: Array, limit: float) -> tuple[Array, Array]:
            # |u| u from `speed` on has slopes from max(0.828 speed, 2 speed − change) to 2 speed + change
            a, b = factor * linear, factor * square
            steep = b * (speed[1] + np.minimum(limit, speed[1] + change))
            return a + b * np.maximum(_FIRST * speed[0], 2 * speed[0] - change) / UP, (a + steep) * UP

        h = secant(1.0, (np.maximum(slow * least - aside, 0.0), fast * most + aside), led, cap)
        ends_of_drag = (float(factor) for factor in claim.drag_factor)
        t = [secant(factor, water, moved, np.inf)[k] for k, factor in enumerate(ends_of_drag)]
        ends = [((gain + linear) * w - gain * v) * share[j] + square * (w * share[j]) ** 2
                for w in (slow, fast) for j in (0, 1)]  # fmt: skip
        # the trim force increases with w; in the direction cosine n it is a n + b n² with b ≥ 0, so its ends bound it
        # above, and below it is at least a n
        trimmed = np.max([*np.abs(ends), -((gain + linear) * slow - gain * v) * share[1]], axis=0) * UP
        trimmed += (gain + linear + 2 * square * (fast * most + aside)) * aside * UP
        left = float(claim.thrust[i]) - trimmed
        if not np.all(left > 0):
            raise Rejected("the steady cruise needs all the thrust of an axis")
        stiff = np.concatenate([(gain + end)[:, None, None, None] * plans for end in h], axis=1)
        left = (1 - self.reserve) * left
        part = np.minimum(1.0, left / extent.largest(stiff, gain * np.eye(2), axes, high) / UP)
        every = list(product((0, 1), repeat=2))
        free, active = _extremes(gain, h, t, [(np.ones_like(part), a, b) for a, b in every]), part < 1
        if not active.any():
            return free, None, active
        corners = [(q, a, b) for q in (part, np.ones_like(part)) for a, b in every]
        if not claim.lag[1]:
            # φ moves the rectangle of (h, t): its inner corners for the two ends of φ lie in the hull of the other six
            del corners[4], corners[3]
        return free, _extremes(gain, h, t, corners), active


def _extremes(gain: float, h: tuple[Array, Array], t: list[Array], corners: list[tuple[Array, int, int]]) -> Array:
    """Return φ (g + h), φ g and t (cells, k, 3) for each φ and the ends of the ranges of h and t."""
    return np.stack([np.stack([q * (gain + h[a]), q * gain, t[b]], -1) for q, a, b in corners], 1)


def check_shell(setting: Setting, bounds: Bounds, form: Form, phase: Phase, shell: tuple[Fraction, ...]) -> None:
    """Prove V̇ < −rate V for low ≤ V ≤ high at every heading, with a shell (low, high, growth, rate).

    Raises:
        Rejected: the proof fails in a cell.
    """
    low, high, growth, rate = shell
    floor, count = float(growth * low) / UP, len(setting.cells.corners)
    for decides, vertices in bounds.modes(phase):
        for k in np.flatnonzero(decides).tolist():
            go_on()
            if indefinite(vertices.cell(k).losses(form, float(rate), float(growth), floor)).any():
                degrees = 90 * (k + 0.5) / count
                raise Rejected(f"V does not decay at the claimed rate between levels {float(low):g} and "
                               f"{float(high):g} near a heading of {degrees:.3g} degrees to the path")  # fmt: skip

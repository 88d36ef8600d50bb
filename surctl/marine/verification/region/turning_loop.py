"""The turning cruise on a grid of headings, in floating point: its steady motion, and the inclusion in a level of V.

The inclusion is that of the checker (`certcheck.turning_matrix`), with one point for each heading of the grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Rejected
from surctl.certcheck.turning_cells import Cells, Setting, cells_of, steady
from surctl.certcheck.turning_claim import axis_pairs
from surctl.certcheck.turning_form import Extent, Form, Phase
from surctl.certcheck.turning_matrix import Inclusion
from surctl.certcheck.turning_terms import other_forces
from surctl.marine.verification.region.turning import TurningClaim

Array = NDArray[np.float64]

_WIDER, _RESERVE = 1.002, 0.01  # of a level, and share of the thrust, in reserve
_SPLIT = 0.6  # of the decay of E that serves as multiplier λ


def _least_error(rows: Array, sides: Array) -> Array:
    """Return x (k,) that minimises the largest |rows x + sides|, with six decimals."""
    from scipy.optimize import linprog

    ones, count = np.ones((len(rows), 1)), rows.shape[1]
    solution = linprog(
        [0] * count + [1], A_ub=np.vstack([np.hstack([rows, -ones]), np.hstack([-rows, -ones])]),
        b_ub=np.concatenate([-sides, sides]), bounds=[(None, None)] * (count + 1),
    )  # fmt: skip
    return np.asarray(np.round(solution.x[:count], 6))


_SOME = 8  # number of headings and directions in the choice of the steady command in a current


def _best_flow(claim: TurningClaim, n: Array, factors: Array, means: Array) -> Array:
    """Return the coefficients (3, 2) of the gains of the current with the least error at the worst heading.

    Args:
        claim: the claim.
        n: |cosine| (n, 2) between the path and each axis of the body.
        factors: vertices (k, 2, 2) of the factors of linear and quadratic drag of both axes.
        means: 1 and the mean factors − 1 (k, 3) at the vertices.
    """
    n = n[:: max(len(n) // _SOME, 1)]
    mass, square, u = np.array(claim.mass), np.array(claim.quadratic), claim.cruise * n
    law = claim.gains["k_v"] + (claim.linear + 2 * square * u) / mass
    slopes = np.maximum(0.828 * u, 2 * u - claim.current), 2 * u + claim.current
    linear = factors[:, 0, None] * claim.linear
    drag = np.stack([(linear + factors[:, 1, None] * square * end) / mass for end in slopes])
    body = np.stack([n, n[:, ::-1] * [-1.0, 1.0]], 1)
    half = np.pi * np.arange(_SOME) / _SOME
    one = np.stack([np.cos(half), np.sin(half)], 1)  # directions of the current, and of the error
    shares = np.einsum("ai,bk,hik->abhik", one, one, body)
    sides = np.einsum("abhik,efhi->eabfh", shares, drag)
    rows = np.repeat(-np.einsum("abhik,hi,fj->abfhjk", shares, law, means)[None], 2, axis=0)
    return _least_error(rows.reshape(-1, 6), sides.reshape(-1)).reshape(3, 2)


@dataclass(frozen=True)
class Cruise:
    """The steady cruise: slopes of ω [m/s] in the mean drag factors, and coefficients (3, 2) of the gains of a current.

    `setting` has the grid of headings.
    """

    slopes: tuple[float, float]
    flow: Array
    setting: Setting

    @property
    def moved(self) -> tuple[float, float]:
        """Return the range of W*_x − v [m/s]."""
        low, high = map(float, self.setting.trim.moved)
        return low, high

    @property
    def beside(self) -> float:
        """Return the largest |y_e*| [m]."""
        return float(self.setting.trim.beside)

    def coarse(self, step: int) -> Cruise:
        """Return the cruise with each `step`-th heading of the grid."""
        own = self.setting
        cells = Cells(*(getattr(own.cells, key.name)[::step] for key in fields(Cells)))
        return replace(self, setting=replace(own, cells=cells))


def _grid(setting: Setting, cells: int) -> Cells:
    """Return the headings at the ends of equal cells; what holds near a heading holds up to half a cell away."""
    psi, half = np.linspace(0, np.pi / 2, cells + 1), np.pi / 4 / cells
    first, last = np.clip(psi - half, 0, None), np.clip(psi + half, None, np.pi / 2)
    corners = np.stack([np.cos(2 * psi), np.sin(2 * psi)], 1)[:, None]
    own = cells_of(setting.claim, setting.trim, first, last, corners)
    return replace(own, widest=np.clip(np.stack([np.cos(psi), np.sin(psi)], 1) + half, 0, 1))


def steady_turning(claim: TurningClaim, *, cells: int) -> Cruise:
    """Return the steady cruise whose ω leaves the least trim error at the worst heading."""
    v, psi = claim.cruise, np.linspace(0, np.pi / 2, 2 * cells + 1)
    n = np.stack([np.cos(psi), np.sin(psi)], 1)  # (2 cells + 1, 2)
    corners: Array = np.array(axis_pairs(claim.drag_factor, claim.drag_asymmetry))
    f, g = np.repeat(corners, len(corners), axis=0), np.tile(corners, (len(corners), 1))  # linear, quadratic drag
    gain = np.array(claim.mass) * claim.gains["k_v"]
    own = (gain + claim.linear) * n + 2 * np.array(claim.quadratic) * v * n * n  # force per ω
    missing = (1 - f)[:, None] * claim.linear * n * v + (1 - g)[:, None] * claim.quadratic * (n * v) ** 2
    means = np.stack([f.mean(axis=1) - 1, g.mean(axis=1) - 1], 1)  # (k, 2)
    rows = (means[:, None, None, :] * own[None, :, :, None] / np.array(claim.mass)[:, None]).reshape(-1, 2)
    first, second = map(float, _least_error(rows, (missing / claim.mass).reshape(-1)))
    flow = np.zeros((3, 2))
    if claim.current and not (claim.behind or claim.curvature):
        flow = _best_flow(claim, n, np.stack([f, g], 1), np.hstack([np.ones((len(means), 1)), means]))
    constant, linear, quadratic = ((Fraction(repr(a)), Fraction(repr(b))) for a, b in flow.tolist())
    slopes = Fraction(repr(first)), Fraction(repr(second))
    trim = steady(claim.stated, slopes, (constant, linear, quadratic))
    none = np.zeros((1, 2))
    setting = Setting(claim.stated, trim, Cells(none[..., None], none[None], none, none[0], none), _RESERVE)
    return Cruise((first, second), flow, replace(setting, cells=_grid(setting, cells)))


def fall_of(claim: TurningClaim) -> float:
    """Return φ [1/s] of a claim with held commands."""
    return 1 / claim.period - claim.gains["k_v"] / claim.mass_factor[0] / 2 if claim.period else 0.0


def split_of(claim: TurningClaim) -> float:
    """Return the multiplier λ [1/s] of a claim with held commands."""
    half = fall_of(claim) / 2
    return float(f"{_SPLIT * max(half - claim.gains['k_v'], half / 2):.4g}")


def vertices(claim: TurningClaim, cruise: Cruise, covariance: Array, high: float) -> list[Inclusion] | None:
    """Return the vertices of each form that decides in V ≤ high, for the covariance P⁻¹ (n, n).

    None if the law has another form there.
    """
    fastest = claim.cruise + claim.current + np.sqrt(np.linalg.eigvalsh(covariance[2:4, 2:4])[-1] * max(high, 1.0))
    extent = Extent([Fraction(float(covariance[k, k])) for k in (0, 1)], covariance[:4, :4])
    forces = other_forces(claim.stated, Fraction(float(fastest)))
    try:
        bounds = cruise.setting.bounds(extent, Fraction(_WIDER * high), forces)
    except Rejected:
        return None
    phases = [Phase(claim.lag)]
    if claim.period:
        phases = [Phase(claim.lag, split_of(claim), fall_of(claim)), Phase(claim.lag, 0.0, fall_of(claim), False)]
    return [one for phase in phases for _, one in bounds.modes(phase)]


def selected(at: Inclusion, chosen: Sequence[int] | NDArray[np.intp], P: Array) -> tuple[Array, Array, Array]:
    """Return A (k, n, n), a factor (k, n, c) of W, and weights (k, 4) of the vertices with the numbers (k,).

    The weights are those of q times the squared states with held commands, and 0 without. The weights of the
    disturbances are those of V = ξᵀPξ.
    """
    lag, split, fall, begins = at.phase
    own = 6 if lag else 4
    eye, index = np.eye(own + 2 * (fall != 0)), np.array(np.unravel_index(np.asarray(chosen, dtype=int), at.shape))
    h, m, t, z, _, _, p = index

    def of(axes: str, term: Array) -> Array:
        places = (np.minimum(index["hmtzabp".index(axis)], term.shape[k] - 1) for k, axis in enumerate(axes))
        return np.asarray(term[tuple(places)])

    A = np.zeros((len(h), *eye.shape)) + sum(of(axes, term) for axes, term in at.pieces(eye, eye))
    bodies, (shares, _) = np.moveaxis(at.axes[:, h, z], 0, 1), at.shares(Form(P).left)
    light, share = (at.masses[:, :2] + np.abs(at.masses[:, 2:]))[m], shares[:, h].T[..., None]
    each = light**2 * (at.lack[h] ** 2 * share[:, 1:3, 0] + at.pushed[h, None] ** 2 * share[:, 5])
    root = np.einsum("ki,kiab->kab", np.sqrt(each + at.stray**2 * share[:, 6]), bodies)
    late = np.einsum("ki,kiab->kab", np.sqrt(share[:, 3:5, 0]) * at.late[h], bodies)
    moving, held = np.einsum("ik,kiab->kab", at.moves[:, h], bodies), fall != 0 and begins
    factor, weights = np.zeros((len(h), len(eye), 5)), np.zeros((len(h), 4))
    factor[:, :, 0] = np.sqrt(share[:, 0]) * at.effects(eye)[h, t, z]
    factor[:, 2:4, 1:3] = root
    if lag:
        factor[:, 4:6, 3:] = late
    if held:
        factor[:, own:, 1:3], factor[:, own:, 3:] = at.gain * moving @ root, late
        weights[:, :2] = at.swing[h, None] ** 2 / split * np.square(at.plans[p]).sum(axis=1)
        weights[:, 2:] = at.spread[h, None] ** 2 / split
    return A, factor, weights

"""Proof of a claim about the heading-steered loop: search for a region, round its numbers, let the checker decide.

The search uses cutting planes: only the vertices of the parameter ranges at which the last V violates its inequality
are added to the next semidefinite program.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import Rejected, check_document, seal
from surctl.certcheck.heading_cells import check_cells
from surctl.marine.verification.region.heading import HeadingClaim, Limits, loops_at, rows_at
from surctl.marine.verification.region.proof import RegionProof
from surctl.marine.verification.region.rates import heading_loop, level_ratios
from surctl.verification.conic import minimise, symmetric_basis

Array = NDArray[np.float64]

_UNITS = np.array([0.5, 0.4, 0.4, 0.1, 0.1, 0.3])  # scale of each entry of ξ
_SIGNS = np.array([1.0, -1, -1, 1, -1, -1])
_START = np.array([2.0, 1.2, 1.2, 0.3, 0.3, 1.2])  # semi-axes of the first region, before it is scaled
_SPREAD = 0.02  # weight of the semi-axes other than y, relative to that of y
_CUTS, _ROUNDS = 40, 10
_RADII, _ANGLES = (0.0, 0.55, 1.0), 10  # radii and number of angles of the grid in the ellipse of (ψ, y)


def _basis() -> Array:
    whole = symmetric_basis(6)
    return np.array([b for b in whole if np.array_equal(_SIGNS[:, None] * b * _SIGNS, b)])


def _places(covariance: Array) -> tuple[Array, Array]:
    """Return a grid of points (ψ, y) over the half y ≥ 0 of the region."""
    root = np.linalg.cholesky(covariance[np.ix_((1, 2), (1, 2))])  # y = root_00 cos, so that y ≥ 0 is half a circle
    angle = np.linspace(-np.pi / 2, np.pi / 2, _ANGLES + 1)
    unit = np.concatenate([r * np.stack([np.cos(angle), np.sin(angle)]) for r in _RADII[1:]], axis=1)
    unit = np.concatenate([np.zeros((2, 1)), unit], axis=1)
    y, psi = root @ unit
    return psi, y


def _limits(claim: HeadingClaim, covariance: Array, psi: Array, y: Array) -> Limits:
    """Return the bounds that hold in the region at each grid point (ψ, y)."""
    regression = covariance[:, (2, 1)] @ np.linalg.inv(covariance[np.ix_((2, 1), (2, 1))])
    rest = covariance - regression @ covariance[(2, 1), :]
    z = np.stack([psi, y], 1)
    inner = np.einsum("ni,ij,nj->n", z, np.linalg.inv(covariance[np.ix_((2, 1), (2, 1))]), z)
    left = np.sqrt(np.clip(1 - inner, 0, None))

    def most(row: Array) -> Array:
        own = np.sqrt(np.clip(np.einsum("ni,ij,nj->n", row, rest, row), 0, None))
        return np.asarray(np.abs(np.einsum("ni,ni->n", row, z @ regression.T)) + own * left + 1e-9)

    surge, sway, forces, yaw = rows_at(claim, psi, y)
    trim = float(claim.read.trim[1])
    free = (claim.limits["surge_n"] - trim, claim.limits["sway_n"], claim.limits["yaw_nm"])
    force = np.maximum(*(most(one) for one in forces))
    most_sway = most(sway)
    needed = (force, claim.velocity_gain * most_sway, most(yaw))
    shares = [np.minimum(1.0, 0.995 * f / m) for f, m in zip(free, needed, strict=True)]
    return Limits(most(surge), most_sway, most(np.tile(np.eye(6)[5], (len(psi), 1))), (shares[0], shares[1], shares[2]))


def _improve(claim: HeadingClaim, within: Array, active: set[int]) -> Array | None:
    """Return P ⪰ `within` with the least P_yy (its region lies in that of `within`); None if no such P exists.

    The bounds and thrust shares are computed for the region of `within`; they hold on the smaller region too. `active`
    holds the indices of the vertices whose inequalities the last call used; this call updates `active`.
    """
    covariance = np.asarray(np.linalg.inv(within), dtype=np.float64)
    units = _UNITS[:, None] * _UNITS
    places = _places(covariance)
    inner = loops_at(claim, *places, _limits(claim, covariance, *places)) * _UNITS / _UNITS[:, None]
    basis, outer = _basis(), within * units
    margin = min(0.01, claim.rate / 2)  # reserve for points between the grid points, and for coarse cells
    rate = claim.rate + margin
    active |= set() if active else set(np.random.default_rng(0).choice(len(inner), 60).tolist())
    weight = _SPREAD * np.eye(6)
    weight[1, 1] = 1
    cost = np.einsum("kij,ij->k", basis, weight)
    for _ in range(_ROUNDS):
        some = inner[sorted(active)]
        half = np.einsum("kij,njl->nkil", basis, some)
        slopes = -(half + half.transpose(0, 1, 3, 2) + rate * basis)
        decay = (np.broadcast_to(-1e-4 * np.eye(6), (len(some), 6, 6)), slopes)
        x = minimise(cost, [decay, (-outer[None], basis[None])], tolerance=1e-6)
        if x is None:
            return None
        P = np.einsum("k,kij->ij", x, basis)
        if np.linalg.eigvalsh(P)[0] <= 0:
            return None
        change = np.linalg.inv(np.linalg.cholesky(P))
        half = (change @ P) @ inner @ change.T
        worst = np.linalg.eigvalsh(half + half.transpose(0, 2, 1))[:, -1] + rate
        if worst.max() < margin / 4:
            active.intersection_update(np.flatnonzero(worst > -0.1).tolist())
            return np.asarray(P / units)
        active |= {int(i) for i in np.argsort(-worst)[:_CUTS] if worst[i] > 0}
    return None


def _shapes(claim: HeadingClaim, *, rounds: int) -> Iterator[Array]:
    """Yield matrices P (6, 6) whose regions V ≤ 1 grow in y; the checker has not checked them yet.

    Each region lies in an enlarged copy of the previous region.
    """
    growth, P, active = 1.4, None, set[int]()
    for size in (0.5, 0.3, 0.2, 0.1):
        active.clear()
        P = _improve(claim, np.diag(1 / (size * _START) ** 2), active)
        if P is not None:
            break
    for _ in range(rounds):
        if P is None:
            return
        yield P
        while growth > 1.01:
            wider = _improve(claim, P / growth**2, active)
            if wider is not None and wider[1, 1] < P[1, 1] * 0.998:
                P = wider
                break
            growth = 1 + (growth - 1) / 2
            active.clear()
        else:
            return


def _heave_shape(claim: HeadingClaim) -> Array | None:
    """Return P_z (2, 2) with which the heave thrust is within its limit on V_z ≤ 1; None if no such P_z exists.

    V_z is the Lyapunov function of heave with the matrix P_z.
    """
    law, ranges = claim.law, claim.ranges
    velocity_gain, k_z = law["heave_mass_kg"] * law["k"], law["k_z"]
    basis = symmetric_basis(2)
    drag = (ranges["heave_linear"][0], ranges["heave_linear"][1] + ranges["heave_quadratic"][1] * 0.2)
    slopes = []
    for mass, d in product(ranges["heave_mass_kg"], drag):
        a = np.array([[0.0, 1.0], [-velocity_gain * k_z / mass, -(velocity_gain + d) / mass]])
        half = basis @ a
        slopes.append(-(half + half.transpose(0, 2, 1) + 1.02 * claim.rate * basis))
    decay = (np.broadcast_to(-1e-4 * np.eye(2), (len(slopes), 2, 2)), np.array(slopes))
    rows = np.array([[0.0, 1 / 0.19], [1.01 * velocity_gain * k_z, 1.01 * velocity_gain]])
    rows[1] /= claim.limits["heave_n"]
    limited = (-rows[:, :, None] * rows[:, None, :], np.broadcast_to(basis, (2, *basis.shape)))
    x = minimise(np.einsum("kij,ij->k", basis, np.diag([1.0, 1e-3])), [decay, limited])
    return None if x is None else np.asarray(np.einsum("k,kij->ij", x, basis))


_SHARES = (1.0, 0.985, 0.97, 0.94, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5)  # factors on a proposed region's semi-axes


def prove_heading(claim: HeadingClaim, *, rounds: int, cells: int) -> RegionProof:
    """Search for a large region in which the claim holds, and let the checker decide.

    Args:
        claim: the claim.
        rounds: number of enlargements of the region.
        cells: largest number of cells of (ψ, y) in the check, which processes about 400 cells a second.
    """
    began = time.perf_counter()
    heave, last, reason = _heave_shape(claim), None, "the search found no quadratic V with this decay rate"
    for P in _shapes(claim, rounds=rounds):
        last = P
    if heave is not None and last is not None:
        for share in _SHARES:
            P = _rounded(last / share**2)
            try:
                check_cells(claim.read, P, most=cells)
            except Rejected as rejected:
                reason = str(rejected)
                continue
            document = _certificate(claim, P, _rounded(heave))
            checked = check_document(document)
            if checked.accepted:
                took, motion = time.perf_counter() - began, document["claim"]["motion"]
                ratios = level_ratios(heading_loop(claim), P, claim.rate)
                return RegionProof(
                    claim, "proved", document, "", motion["offset_m"], (motion["ultimate_bound_m"], 0.0), took,
                    checked.seconds, motion["extent"][1], ratios,
                )  # fmt: skip
            reason = checked.reason
    return RegionProof(claim, "unknown", {}, reason, 0.0, (0.0, 0.0), time.perf_counter() - began, 0.0)


def _rounded(P: Array) -> Array:
    return np.array([[float(f"{entry:.9g}") for entry in row] for row in (P + P.T) / 2])


def _down(value: float) -> float:
    return float(np.floor(1e4 * value * 0.99999) / 1e4)


def _certificate(claim: HeadingClaim, P: Array, heave: Array) -> dict[str, Any]:
    # stated numbers are rounded to the safe side
    covariance = np.linalg.inv(P)
    away = max(abs(claim.law["cruise"] - command) / claim.law["k1"] for command in claim.command)
    inner = 1 - P[0, 0] * away**2
    stated = claim.document(
        offset=_down(np.sqrt(max(inner, 0.0) / P[1, 1])),
        beside=_down(1 / np.sqrt(P[1, 1])),
        extent=tuple(_down(np.sqrt(covariance[k, k])) for k in range(3)),
        depth=_down(1 / np.sqrt(heave[0, 0])),
        ultimate_bound=float(np.ceil(1e4 * away + 1e-6) / 1e4),
    )
    proof = {name: [row[: i + 1].tolist() for i, row in enumerate(m)] for name, m in (("P", P), ("P_z", heave))}
    return seal("heading", stated, {"proof": proof})

"""The turning cruise as a linear inclusion on a grid of headings, in floating point; the checker derives its own.

The state is ξ = (x, y, δU_x, δU_y), the deviation from the steady cruise in the path frame; with thrust lag or held
commands, the two entries of E follow (`certcheck.turning_form`). At a vertex of the parameters ξ̇ = A ξ + w with w wᵀ ⪯
W; `certcheck.turning_cells` derives this inclusion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.region_claim import axis_pairs
from surctl.certcheck.turning_terms import flow_error, other_forces, outer_force
from surctl.marine.verification.region.turning import TurningClaim
from surctl.marine.verification.region.turning_behind import Behind, behind_of

Array = NDArray[np.float64]


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


_TURNING = np.kron(np.eye(2), [[0.0, -1.0], [1.0, 0.0]])


@dataclass(frozen=True)
class Cruise:
    """The steady cruise: slopes of ω [m/s] in the mean drag factors, range of ω, and headings ψ (cells + 1,) [rad].

    `lack` (cells + 1, 2) holds the largest error of the trim force on each axis [N] near each heading. In a current,
    the gains of the shift (g_x, g_y) have the coefficients `flow` (3, 2); `moved` is the range of W*_x − v, `across`
    the largest |W*_y| [m/s], `beside` the largest |y_e*| [m], and `pushed` (cells + 1,) the largest norm of the
    error that the current causes near each heading [N].
    """

    slopes: tuple[float, float]
    omega: tuple[float, float]
    headings: Array
    lack: Array
    flow: Array
    moved: tuple[float, float]
    across: float
    beside: float
    pushed: Array


@dataclass(frozen=True)
class Vertices:
    """Vertices of a shell, one for each heading, pair of masses, Coriolis term, pair of loops and law; n in all.

    Attributes:
        bodies: n_i n_iᵀ (headings, 2, 2, 2) of the body axes i.
        crossed: n_j n_iᵀ (headings, 2, 2, 2) with the other axis j.
        masses: 1/m of both axes and the entry β of M⁻¹ beside them (masses, 3) [1/kg].
        coriolis: r R [[0, e1], [e2, 0]] Rᵀ (headings, terms, 2, 2) [1/s].
        bends: turn rate of the path frame (terms,) [rad/s].
        aside: rate of the position across the path (terms,) by this turn of x_e* [m/s].
        loose: norm [1/s] of the Coriolis terms that m12 adds.
        loops: stiffness and damping by the command, and drag (headings, 2, loops, 3), of each body axis [N s/m].
        plans: slopes of −δW in the position (laws, 2, 2) [1/s].
        Q: bound on w wᵀ (headings, masses, terms, 2, 2).
        effect: Coriolis term of the steady cruise (headings, terms, 2) [m/s²].
        lack: trim error (headings, masses, 2) of the body axes [m/s²].
        stray: largest acceleration by disturbance forces and errors of measurement [m/s²].
        pushed: largest norm (headings,) of the error by the current [N].
        turn: rotation matrices (headings, 2, 2) from the body to the path frame.
        behind: what thrust lag adds; None without lag.
        lag: time constant of the thrust [s]; 0 without lag.
        modelled: masses in the law's model (2,) [kg].
        moves: S = Σ n_i n_iᵀ (headings, 2, 2) over the body axes i whose command moves: it is not at its limit.
        limits: with held commands, whether the thrust limit of a body axis may be active (headings, 2), and the pairs
            of an axis at its limit (headings, 2, loops, 3); None if no limit is active.
    """

    bodies: Array
    crossed: Array
    masses: Array
    coriolis: Array
    bends: Array
    aside: Array
    loose: float
    loops: Array
    plans: Array
    Q: Array
    effect: Array
    lack: Array
    stray: float
    pushed: Array
    turn: Array
    behind: Behind | None
    lag: float
    modelled: Array
    moves: Array
    limits: tuple[NDArray[np.bool_], Array] | None

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of headings, masses, Coriolis terms, surge loops, sway loops, and laws."""
        count = self.loops.shape[2]
        return *self.Q.shape[:3], count, count, len(self.plans)

    def phases(self) -> list[Vertices]:
        """Return the vertices of each form that decides: two with held commands, else one."""
        if self.behind is None:
            return [self]
        return [replace(one, behind=phase) for one in self._modes() for phase in self.behind.phases()]

    def _modes(self) -> list[Vertices]:
        """Return the vertices for each set of body axes whose thrust is at its limit."""
        modes = [self]
        if self.limits is None:
            return modes
        active, pairs = self.limits
        own = np.concatenate([self.loops, self.loops], axis=2)[:, :, : pairs.shape[2]]
        for held in product((False, True), repeat=2):
            if not any(held) or not all(active[:, i].any() for i in (0, 1) if held[i]):
                continue
            loops = np.stack([pairs[:, i] if held[i] else own[:, i] for i in (0, 1)], 1)
            moving = ~(active & np.array(held))
            modes.append(replace(self, loops=loops, moves=np.einsum("hi,hijk->hjk", moving, self.bodies)))
        return modes

    def select(self, chosen: NDArray[np.intp] | list[int]) -> tuple[Array, Array, Array]:
        """Return A (k, n, n), a factor (k, n, c) of W, and weights (k, 4) of the vertices with numbers (k,).

        The weights are those of q times the squared states with thrust lag or held commands, and 0 without.
        """
        h, m, t, one, two, p = np.unravel_index(np.asarray(chosen, dtype=int), self.shape)
        pairs = np.stack([self.loops[h, 0, one], self.loops[h, 1, two]], 1)  # (k, 2, 3)
        stiff, damped, dragged = np.einsum("nic,nijk->cnjk", pairs, self._driven()[m, h])
        led, A = np.zeros((len(h), 2, 4)), np.zeros((len(h), 4, 4))
        A[:, 0, 2] = A[:, 1, 3] = 1
        if self.lag:
            stiff, damped = np.einsum("nic,nijk->cnjk", pairs[..., :2], self.model[h])
        led[:, :, :2], led[:, :, 2:] = -stiff @ self.plans[p], -damped
        A[:, 2:, 2:] = -dragged - self.coriolis[h, t]
        if not self.lag:
            A[:, 2:] += led
        A -= self.bends[t][:, None, None] * _TURNING
        values, vectors = np.linalg.eigh(self.Q[h, m, t])
        factor = np.zeros((len(h), 4, 2))
        factor[:, 2:] = vectors * np.sqrt(np.maximum(values, 0))[:, None]
        if self.behind is None:
            return A, factor, np.zeros((len(h), 4))
        inner = np.einsum("ni,nijk->njk", self.behind.light[m], self.bodies[h])
        return self.behind.extended(A, factor, inner, h, t, _straight(self.plans[p]), self.turn[h], self.moves[h], led)

    def _driven(self) -> Array:
        """Return n_i n_iᵀ/m_i + β n_j n_iᵀ (masses, headings, 2, 2, 2): what a force on each axis i accelerates."""
        own = np.einsum("mi,hijk->mhijk", self.masses[:, :2], self.bodies)
        return np.asarray(own + np.einsum("m,hijk->mhijk", self.masses[:, 2], self.crossed))

    def matrices(self, P: Array, rate: float, growth: float, low: float) -> Array:
        """Return T (Aᵀ P + P A + (a + η) P + P W P/(η low)) Tᵀ (n, n, k) of all vertices, where T P Tᵀ = I."""
        change, n = np.linalg.inv(np.linalg.cholesky(P)), len(P)
        side, place, speed = (change @ P[:, 2:4])[None], change[:, :2].T, change[:, 2:4].T
        if self.behind is not None:
            side = side + self._rear(change, P) @ self.moves * self.behind.k_v  # (h, n, 2)
        kinematic = change @ P[:, :2] @ speed
        loose = 2 * self.loose * np.linalg.norm(side, axis=(-1, -2)).max() * np.linalg.norm(speed)
        fixed = kinematic + kinematic.T + (rate + growth + loose) * np.eye(n)
        turned = side[:, None] @ self.coriolis @ speed + self.bends[:, None, None] * _bent(change, P)
        moved = self.effect @ side.swapaxes(-1, -2) + self.aside[:, None] * (change @ P[:, 1])  # (h, t, n)
        weighted, share, rear = self._weighted(side, change, P, np.linalg.norm(moved, axis=-1).max(axis=1))
        outer = side[:, None, None]
        pushed = outer @ weighted @ outer.swapaxes(-1, -2)
        pushed = pushed + share * np.einsum("hti,htj->htij", moved, moved)[:, None]
        base = fixed - (turned + turned.swapaxes(-1, -2))[:, None] + pushed / (growth * low)
        away = np.zeros((n, n, 1, 1, 1, 1, 1, 1))
        if self.behind is not None:
            away, more = self.behind.added(change, P, self.bodies, _straight(self.plans), side, self.moves)
            pull = change @ P @ self.behind.entry(n)
            base = base + more + (pull @ rear @ pull.T / (growth * low))[:, None, None]
        driven = self._driven()
        slowed = side[:, None] @ driven @ speed  # (m, h, 2, n, n)
        rear = change @ P[:, 4:6]
        command = (rear / self.lag @ self.model)[None] if self.lag else side[:, None] @ driven  # (m, h, 2, n, 2)
        led, eased = command[:, :, :, None] @ self.plans @ place, command @ speed  # (m, h, 2, p, n, n)
        led, slowed, eased = (part + part.swapaxes(-1, -2) for part in (led, slowed, eased))
        whole = (
            np.einsum("hil,mhipjk->ihmlpjk", self.loops[..., 0], led)
            + np.einsum("hil,mhijk->ihmljk", self.loops[..., 1], eased)[:, :, :, :, None]
            + np.einsum("hil,mhijk->ihmljk", self.loops[..., 2], slowed)[:, :, :, :, None]
        )
        base, one, two = (np.moveaxis(part, (-2, -1), (0, 1)) for part in (base, *whole))
        return np.asarray(
            base[..., None, None, None] - (one[..., None, :, None, :] + two[..., None, None, :, :]) + away
        ).reshape(n, n, -1)  # fmt: skip

    @property
    def model(self) -> Array:
        """Return n_i n_iᵀ divided by the mass in the law's model (headings, 2, 2, 2)."""
        return self.bodies / self.modelled[:, None, None]

    def _rear(self, change: Array, P: Array) -> Array:
        """Return T P of the entries that the rate of the commands drives (n, 2)."""
        driven = self.behind is not None and self.behind.held and self.behind.driven
        return np.asarray(change @ P[:, -2:] * driven)

    def _weighted(self, side: Array, change: Array, P: Array, most: Array) -> tuple[Array, Array, Array]:
        """Return Q without the steady part, the weight of that part, and Q of E alone (h, 2, 2).

        The weights are those of the checker, which measures the parts of w by V. `side` (headings, n, 2) is T P B, and
        `most` (headings,) bounds the steady part.
        """
        most = most[:, None, None]
        spread = np.linalg.norm(side, axis=(-1, -2)).max()
        strayed, pushed = self.stray * spread, self.pushed * spread * self.masses[:, :2].max()  # (h,)
        gram = np.broadcast_to(side.swapaxes(-1, -2) @ side, (len(self.bodies), 2, 2))
        sizes = self.lack.max(axis=1) * np.sqrt(np.einsum("hijk,hjk->hi", self.bodies, gram))  # (h, i)
        late = np.zeros_like(sizes) if self.behind is None else self.behind.late
        entry = np.zeros((len(P), 2)) if self.behind is None else self.behind.entry(len(P))
        weights = late * float(np.linalg.norm(change @ P @ entry))
        total = most + ((sizes + weights).sum(axis=1) + strayed + pushed)[:, None, None]
        share = np.divide(total, most, out=np.zeros_like(total), where=most > 0)[..., None, None]
        parts = np.divide(total[:, :, 0], sizes, out=np.zeros_like(sizes), where=sizes > 0)  # (h, i)
        own = np.einsum("hi,hmi,hijk->hmjk", parts, self.lack**2, self.bodies)
        share_of = np.divide(total[:, 0, 0], pushed, out=np.zeros_like(pushed), where=pushed > 0) * self.pushed**2
        own = own + np.einsum("h,mi,hijk->hmjk", share_of, self.masses[:, :2] ** 2, self.bodies)
        most_late = np.divide(total[:, :, 0], weights, out=np.zeros_like(sizes), where=weights > 0)
        rear = np.einsum("hi,hijk->hjk", most_late * late**2, self.bodies)
        if strayed:
            own = own + (total[:, :, 0] / strayed * self.stray**2)[..., None, None] * np.eye(2)
        return own[:, :, None], share, rear


def _bent(change: Array, P: Array) -> Array:
    """Return T P S Tᵀ for the turning of the path frame; 0 with thrust lag, whose claims have straight paths."""
    return np.zeros_like(P) if len(P) > 4 else change @ P @ _TURNING @ change.T


def _straight(plans: Array) -> Array:
    """Return κ and s/Δ (k, 2) of the slopes (k, 2, 2) of a steady cruise that no current shifts."""
    return np.stack([plans[:, 0, 0], plans[:, 1, 1]], 1)


def steady_turning(claim: TurningClaim, *, cells: int) -> Cruise:
    """Return the steady cruise whose ω leaves the least trim error at the worst heading.

    The error at a heading is the largest one up to half a cell away.
    """
    v, psi = claim.cruise, np.linspace(0, np.pi / 2, 2 * cells + 1)
    n = np.stack([np.cos(psi), np.sin(psi)], 1)  # (2 cells + 1, 2)
    corners: Array = np.array(axis_pairs(claim.drag_factor, claim.drag_asymmetry))
    f, g = np.repeat(corners, len(corners), axis=0), np.tile(corners, (len(corners), 1))  # linear, quadratic drag
    gain = np.array(claim.mass) * claim.gains["k_v"]
    own = (gain + claim.linear) * n + 2 * np.array(claim.quadratic) * v * n * n  # force per ω
    missing = (1 - f)[:, None] * claim.linear * n * v + (1 - g)[:, None] * claim.quadratic * (n * v) ** 2
    means = np.stack([f.mean(axis=1) - 1, g.mean(axis=1) - 1], 1)  # (k, 2)
    rows = (means[:, None, None, :] * own[None, :, :, None] / np.array(claim.mass)[:, None]).reshape(-1, 2)
    first, second = _least_error(rows, (missing / claim.mass).reshape(-1))
    slopes = float(first), float(second)
    omegas = means @ slopes
    lack = (
        np.abs(missing + omegas[:, None, None] * own).max(axis=0)
        + np.square(omegas).max() * np.array(claim.quadratic) * n * n
    )
    omega = float(omegas.min()), float(omegas.max())
    flow = np.zeros((3, 2))
    if claim.current:
        full = np.hstack([np.ones((len(means), 1)), means])
        if not (claim.behind or claim.curvature):
            flow = _best_flow(claim, n, np.stack([f, g], 1), full)
        along, across = np.abs(full @ flow).max(axis=0) * claim.current
    else:
        along = across = 0.0
    near = np.pad(lack, ((1, 1), (0, 0)), mode="edge")
    lack = np.max([near[:-2], near[1:-1], near[2:]], axis=0)[::2]
    moved = omega[0] - float(along), omega[1] + float(along)
    beside = claim.gains["lookahead"] * float(across) / (v + moved[0])
    pushed = np.zeros(cells + 1)
    if claim.current:
        rounded = tuple((Fraction(repr(a)), Fraction(repr(b))) for a, b in flow.tolist())
        ends = np.stack([np.pad(n, ((1, 1), (0, 0)), mode="edge")[k : len(n) + k : 2] for k in (0, 2)], 2)
        pushed = flow_error(claim.stated, (rounded[0], rounded[1], rounded[2]), omega, np.sort(ends, axis=2))
    return Cruise(slopes, omega, psi[::2], lack, flow, moved, float(across), beside, pushed)


def vertices(claim: TurningClaim, cruise: Cruise, covariance: Array, high: float) -> Vertices | None:
    """Return the vertices in V ≤ high for the covariance P⁻¹ (n, n); None if the law has another form there."""
    k1, ahead, v, cap = claim.gains["k1"], claim.gains["lookahead"], claim.cruise, claim.cap
    x, y = 1.001 * np.sqrt(np.diag(covariance)[:2] * high)
    slow, fast = v + cruise.moved[0], v + cruise.moved[1]
    if slow <= 0 or fast >= cap:
        return None
    most = cap * ahead / np.hypot(ahead, y + cruise.beside)
    ahead_of = x + max(map(abs, cruise.moved)) / k1 + claim.place_error
    if most <= fast or k1 * x >= slow or ahead_of >= claim.gains["wait"] / 2:
        return None
    steer, catch = (slow - k1 * x, min(fast + k1 * x, cap)), (min(k1, (most - fast) / x), k1)
    shifts = sorted({cruise.beside, -cruise.beside})
    plans = np.array([
        [[k, 0.0], [k * y / ahead, s / ahead]] for k, s, y in product(sorted(set(catch)), steer, shifts)
    ])  # fmt: skip
    c, s = np.cos(cruise.headings), np.sin(cruise.headings)
    turn = np.stack([np.stack([c, -s], 1), np.stack([s, c], 1)], 1)  # (headings, 2, 2)
    extremes = _loops(claim, cruise, covariance[:4, :4] * high * 1.002, turn, plans)
    if extremes is None:
        return None
    loops, limits = extremes
    loose, masses, turns = claim.vertex_numbers
    along = [-moved / k1 for moved in cruise.moved] if claim.curvature else [0.0]  # x_e*
    turns, aside = np.repeat(turns, len(along), axis=0), np.outer(turns[:, 2], along).ravel()
    cross = np.array([[[0.0, a], [b, 0.0]] for a, b, *_ in turns])
    coriolis = turn[:, None] @ cross @ turn.swapaxes(-1, -2)[:, None]
    bodies, crossed = np.einsum("hji,hki->hijk", turn, turn), np.einsum("hji,hki->hijk", turn[..., ::-1], turn)
    effect = (coriolis[..., 0] + np.outer(turns[:, 2], [0.0, 1.0])) * claim.cruise
    fastest = v + claim.current + np.sqrt(np.linalg.eigvalsh(covariance[2:4, 2:4])[-1] * max(high, 1.0))
    others = np.array([float(force) for force in other_forces(claim.stated, Fraction(float(fastest)))])
    heavy = masses[:, :2] + np.abs(masses[:, 2:])
    forces, behind = cruise.lack + others, None
    if claim.behind:
        behind = behind_of(claim, cruise.omega, steer[1], covariance, high, turn, _straight(plans), masses, turns)
    lack = forces[:, None, :] * heavy + loose * v + np.abs(turns[:, :2]).max() * claim.current
    stray = outer_force(claim.stated, y + cruise.beside) * heavy.max()
    forced = _forces(bodies, effect, lack, stray, cruise.pushed, masses)
    return Vertices(
        bodies, crossed, masses, coriolis, turns[:, 2], aside, loose, loops, plans, forced, effect, lack, stray,
        cruise.pushed, turn, behind, claim.lag, np.array(claim.mass), bodies.sum(axis=1), limits,
    )  # fmt: skip


def _forces(bodies: Array, effect: Array, lack: Array, stray: float, pushed: Array, masses: Array) -> Array:
    """Return Q (headings, masses, terms, 2, 2) with w wᵀ ⪯ Q for all parts of w of `Vertices`."""
    light = masses[:, :2].max(axis=1)
    size, excess = np.linalg.norm(effect, axis=-1)[:, None], np.outer(pushed, light)[:, :, None]  # (h, 1, t), (h, m, 1)
    total = size + excess + lack.sum(axis=-1)[:, :, None] + stray
    share = np.divide(total, size, out=np.zeros_like(total), where=size > 0)
    Q = share[..., None, None] * np.einsum("hti,htj->htij", effect, effect)[:, None]
    Q = Q + np.einsum("hmt,hmi,hijk->hmtjk", total, lack, bodies)
    return np.asarray(Q + (total * (stray + excess))[..., None, None] * np.eye(2))


def _loops(
    claim: TurningClaim, cruise: Cruise, sized: Array, turn: Array, plans: Array
) -> tuple[Array, tuple[NDArray[np.bool_], Array] | None] | None:
    """Return the extremes (headings, 2, k, 3) of stiffness and damping by the command, and of drag, and `limits`.

    `sized` is P⁻¹ times the level.
    """
    step = (cruise.headings[1] - cruise.headings[0]) / 2
    near, far = np.clip(cruise.headings - step, 0, None), np.clip(cruise.headings + step, None, np.pi / 2)
    shares = np.array([[np.cos(far), np.cos(near)], [np.sin(near), np.sin(far)]])  # (axis, end, headings)
    v, cap, (low, top) = claim.cruise, claim.cap, claim.drag_factor
    slow, fast = v + cruise.moved[0], v + cruise.moved[1]

    def largest(rows: Array) -> Array:
        return np.asarray(np.sqrt(np.maximum(np.einsum("...i,ij,...j->...", rows, sized, rows), 0.0)))

    axes, parts, free = [], [], []
    for i in (0, 1):
        gain, linear, square = claim.mass[i] * claim.gains["k_v"], claim.linear[i], claim.quadratic[i]
        n, (least, most), c = turn[:, :, i], shares[i], claim.current
        still = np.hstack([np.zeros_like(n), n])
        led = np.stack([np.hstack([n @ plan, np.zeros_like(n)]) for plan in plans])
        moved, away = largest(still), largest(led).max(axis=0)
        aside = cruise.across * np.sqrt(1 - least**2)
        w, u = (
            (np.maximum(slow * least - aside, 0.0), fast * most + aside),
            (np.maximum(v * least - c, 0.0), v * most + c),
        )
        h = (linear + square * np.maximum(0.828 * w[0], 2 * w[0] - away),
             linear + square * (w[1] + np.minimum(cap, w[1] + away)))  # fmt: skip
        t = (low * (linear + square * np.maximum(0.828 * u[0], 2 * u[0] - moved)),
             top * (linear + square * (2 * u[1] + moved)))  # fmt: skip
        ends = [((gain + linear) * one - gain * v) * k + square * (one * k) ** 2
                for one in (slow, fast) for k in shares[i]]  # fmt: skip
        left = claim.thrust[i] - np.max([*np.abs(ends), -((gain + linear) * slow - gain * v) * most], axis=0)
        left = left - (gain + linear + 2 * square * w[1]) * aside
        if np.any(left <= 0):
            return None
        need = np.max([largest((gain + slope)[:, None] * one + gain * still) for one in led for slope in h], axis=0)
        part = np.minimum(1.0, 0.99 * left / need)
        parts.append(part)
        axes.append([(q * (gain + h[a]), q * gain, t[b]) for q, a, b in _extremes(part, every=claim.lag > 0)])
        free.append([(gain + h[a], gain + 0 * part, t[b]) for a in (0, 1) for b in (0, 1)])
    if len({len(axis) for axis in axes}) > 1:  # one axis alone may reach its thrust limit: repeat the other's pairs
        axes = [axis if len(axis) > 4 else [*axis, *axis][: max(map(len, axes))] for axis in axes]
    pairs = np.asarray(np.moveaxis(np.array(axes, dtype=np.float64), (0, 1, 2), (1, 2, 3)))
    if not claim.period or pairs.shape[2] == 4:
        return pairs, None
    own = np.asarray(np.moveaxis(np.array(free, dtype=np.float64), (0, 1, 2), (1, 2, 3)))
    return own, (np.stack(parts, 1) < 1, pairs)


def _extremes(part: Array, *, every: bool) -> list[tuple[Array, int, int]]:
    """Return the extreme (φ, end of h, end of t).

    Unless `every` is true, the other two corners of the rectangles of φ lie between these in the sum of both dampings.
    """
    full = np.ones_like(part)
    if np.all(part >= 1):
        return [(full, a, b) for a in (0, 1) for b in (0, 1)]
    if every:
        return [(q, a, b) for q in (part, full) for a in (0, 1) for b in (0, 1)]
    return [(part, 0, 0), (part, 0, 1), (part, 1, 0), (full, 0, 1), (full, 1, 0), (full, 1, 1)]

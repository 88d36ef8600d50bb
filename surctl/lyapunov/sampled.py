"""Regions of attraction of sampled loops, with held commands, proved at the sampling instants and in between.

V decreases from sample to sample, and a function W between them. All matrix inequalities are linear in the inverse
matrices Q of V and of the knots of W, and in Y = G Q for the feedbacks G of the limits (`surctl.certcheck.sampled`).
The region grows in rounds; in each round, the slopes are those of a somewhat larger region. The checker decides.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck import PATIENCE, check_document, seal
from surctl.errors import UnsupportedOperation
from surctl.lyapunov.claims import Stability, every_digit, stated_number
from surctl.lyapunov.decide import Decision
from surctl.lyapunov.dynamics import Dynamics, Range, State
from surctl.lyapunov.radii import drift, norm, radii
from surctl.lyapunov.rays import enclosing
from surctl.lyapunov.slope_search import Embedding, Family, quadratic
from surctl.verification.conic import Inequality, minimise, symmetric_basis
from surctl.verification.formula import number, text_of, variable

Array = NDArray[np.float64]
Bits = NDArray[np.bool_]
_Parts = tuple[Array, Array, list[Array]]

_PIECES = 3  # of a period
_STARTS = (0.3, 0.1, 0.03, 0.01)  # extents that decide the first slopes, relative to the box
_STRETCH, _LEAST_STRETCH, _GROWTH, _ROUNDS = 1.5, 1.03, 1.01, 20
_CUTS, _WORST, _MOST = 12, 6, 13  # cuts of a round; vertices that a cut adds; slopes whose vertices are all tried
_TOLERANCE = 1e-7
_INSIDE, _LOSS, _WIDEST = 1e-4, 1e-4, 100.0  # spare of extents; lost share of W in a period; square of a command


@dataclass(frozen=True)
class Shapes:
    """Region and proof of a sampled loop.

    Attributes:
        inverse: Q (n, n) of V = ξ' Q⁻¹ ξ, with the region V < 1.
        knots: Q(τ) (K, n + m, n + m) of W at equidistant times of a period.
        feedbacks: G (k, n) of the limits.
    """

    inverse: Array
    knots: Array
    feedbacks: Array


def sampled_shapes(dynamics: Dynamics, share: float, *, seconds: float) -> Shapes | None:
    """Return a large region of a sampled loop that the slope rule is likely to prove; None if none is found.

    Args:
        dynamics: the dynamics, with their sampling.
        share: share of V that must be lost in a period.
        seconds: limit of the processor time [s].
    """
    until = time.process_time() + seconds
    try:
        loop = _Loop(dynamics, share, until)
        best = next((shapes for start in _STARTS if (shapes := loop.larger(loop.small(start), 1.0)) is not None), None)
        stretch = _STRETCH
        for _ in range(_ROUNDS):
            if best is None or time.process_time() > until or stretch < _LEAST_STRETCH:
                break
            trial = loop.larger(best, stretch)
            if trial is None:
                stretch = 1 + (stretch - 1) / 2
                continue
            grows = _extent(trial) > _GROWTH * _extent(best)
            best = trial
            if not grows:
                break
    except (UnsupportedOperation, np.linalg.LinAlgError):
        return None
    return best


def _extent(shapes: Shapes) -> float:
    return float(np.exp(np.linalg.slogdet(shapes.inverse)[1] / 2 / len(shapes.inverse)))


class _Loop:
    def __init__(self, dynamics: Dynamics, share: float, until: float) -> None:
        assert dynamics.sampling is not None
        self.dynamics, self.sampling, self.share, self.until = dynamics, dynamics.sampling, share, until
        self.n, self.m = len(dynamics.states), len(self.sampling.commands)
        self.scales = dynamics.freedom
        self.after = [self.sampling.next.get(s.name, variable(s.name)) for s in dynamics.states]
        self.after += [command.value for command in self.sampling.commands]
        self.pools: list[Bits] = []
        first = self.embedded(np.diag(self.scales**2)[None], np.zeros((len(self.after) * 4, self.n)))
        self.limits = [float(gap) for _, gap, _ in first.limits.values()]

    def embedded(self, covers: Array, feedbacks: Array) -> Embedding:
        return Embedding(self.dynamics, covers, rates=self.after, feedbacks=feedbacks)

    def small(self, start: float) -> Shapes:
        """Return balls, relative to the box, whose slopes are the first ones."""
        inverse = np.diag((start * self.scales) ** 2)
        knot = np.zeros((self.n + self.m,) * 2)
        knot[: self.n, : self.n] = inverse
        return Shapes(inverse, np.repeat(knot[None], _PIECES + 1, axis=0), np.zeros((len(self.limits), self.n)))

    def larger(self, shapes: Shapes, stretch: float) -> Shapes | None:
        """Return larger shapes, with the slopes of `shapes` stretched by a factor; None if there are none."""
        jump = self.embedded(shapes.inverse[None] * stretch**2, shapes.feedbacks / stretch)
        ends = [jump.ends(self.n + k) for k in range(self.m)]
        flow = self._between(shapes.knots * stretch**2, ends)
        units = np.array([max(map(abs, pair)) for pair in ends])
        own = np.asarray(np.sqrt(np.diag(shapes.inverse)) * stretch, dtype=float)
        return _Round(self, jump, flow, np.concatenate([own, units]), shapes, stretch).solved(self.until)

    def _between(self, knots: Array, ends: list[tuple[float, float]]) -> Embedding:
        d = self.dynamics
        held = [
            State(command.name, *pair, equilibrium=float(command.rest), exact=command.rest)
            for command, pair in zip(self.sampling.commands, ends, strict=True)
        ]
        zero = number(0)
        rates = [self.sampling.flow.get(s.name, zero) for s in d.states] + [zero] * self.m
        whole = Dynamics("flow", "continuous", (*d.states, *held), tuple(rates), d.parameters, shifts=d.shifts)
        covers = knots.copy()
        for k, pair in enumerate(ends, start=self.n):  # the range of a held command decides, and not its knots
            covers[:, k, k] += _WIDEST * max(map(abs, pair)) ** 2
        return Embedding(whole, covers)


class _Round:
    """The matrix inequalities of one round, in states and commands that are divided by `scales`.

    The unknowns are Q of V, Y = G Q, the knots, and W ⪰ Q⁻¹ for the volume.
    """

    def __init__(
        self, loop: _Loop, jump: Embedding, flow: Embedding, scales: Array, shapes: Shapes, stretch: float
    ) -> None:
        self.loop, self.n, self.size, self.count = loop, loop.n, loop.n + loop.m, len(loop.limits)
        self.scales, self.limits = scales, np.array(loop.limits).reshape(-1)
        self.jump, self.flow = Family(jump), Family(flow)
        own = scales[: self.n]
        self.jump.numbers = self.jump.numbers * np.concatenate([own, self.limits]) / scales[:, None]
        self.flow.numbers = self.flow.numbers * scales / scales[:, None]
        self.few, self.all = symmetric_basis(self.n), symmetric_basis(self.size)
        self.parts = np.cumsum([0, len(self.few), self.count * self.n, *[len(self.all)] * (_PIECES + 1), len(self.few)])
        self.inverse = shapes.inverse / np.outer(own, own)
        self.extents = self._extents(jump, flow, shapes, stretch)

    def unknown(self, part: int, matrices: Array) -> Array:
        """Return matrices (..., k, a, b) of one part of the unknowns as those of all of them."""
        whole = np.zeros((*matrices.shape[:-3], self.parts[-1], *matrices.shape[-2:]))
        whole[..., self.parts[part] : self.parts[part + 1], :, :] = matrices
        return whole

    @cached_property
    def inverses(self) -> Array:
        return self.unknown(0, self.few)

    @cached_property
    def knots(self) -> list[Array]:
        return [self.unknown(2 + k, self.all) for k in range(_PIECES + 1)]

    @cached_property
    def rows(self) -> Array:
        """The matrices (m, k, n) of Y."""
        return self.unknown(1, np.eye(self.count * self.n).reshape(self.count * self.n, self.count, self.n))

    def _extents(self, jump: Embedding, flow: Embedding, shapes: Shapes, stretch: float) -> list[Inequality]:
        """Return that the region lies in the box, and that no range of a slope is left."""
        n, box = self.n, np.eye(self.size)[: self.n]
        bounds, matrices = [], []

        def bound(rows: Array, unknowns: Array, most: Array) -> None:
            keep = most > 0
            matrices.append(np.einsum("ri,bij,rj->rb", rows[keep], unknowns, rows[keep]) / most[keep, None])
            bounds.append(len(matrices[-1]))

        wide = stretch**2
        inner = [rows[:, :n] + rows[:, n:] @ shapes.feedbacks for rows in jump.inner]
        rows = np.vstack([np.eye(n), *inner])
        most = wide * np.einsum("ri,ij,rj->r", rows, shapes.inverse, rows)
        bound(rows * self.scales[:n], self.inverses, most)
        inside = ((1 - _INSIDE) * self.loop.scales / self.scales[:n]) ** 2
        bound(np.eye(n), self.inverses, inside)
        rows = np.vstack([box, *(rows for rows in flow.inner)])
        most = np.einsum("ri,kij,rj->kr", rows, flow.covers, rows).max(axis=0)
        for knot in self.knots:
            bound(rows * self.scales, knot, most)
            bound(box, knot, inside)
            bound(np.eye(self.size)[n:], knot, np.full(self.size - n, _WIDEST))
        every = np.vstack(matrices)
        return [(np.ones((len(every), 1, 1)), -every[:, :, None, None])]

    def needed(self, chosen: Bits, end: int | None, parts: _Parts) -> Array:
        """Return the matrices (B, m, ·, ·) that must be positive semidefinite at vertices (B, K).

        Args:
            chosen: the vertices.
            end: 2 i or 2 i + 1 for the ends of piece i; None means the sampling instant.
            parts: the matrices, each of m unknowns.
        """
        inverses, rows, knots = parts
        if end is None:
            at = self.jump.vertices(chosen)[:, None]
            moved = at[..., : self.n] @ inverses + at[..., self.n :] @ rows
            whole = np.zeros((*moved.shape[:2], self.n + self.size, self.n + self.size))
            whole[..., : self.n, : self.n] = (1 - self.loop.share - _LOSS) * inverses
            whole[..., self.n :, : self.n], whole[..., : self.n, self.n :] = moved, moved.swapaxes(-1, -2)
            whole[..., self.n :, self.n :] = knots[0]
            return whole
        piece, knot = end // 2, knots[end // 2 + end % 2]
        growth = (knots[piece + 1] - knots[piece]) * _PIECES - _LOSS * knot
        moved = self.loop.sampling.period * self.flow.vertices(chosen)[:, None] @ knot
        return np.asarray(growth - moved - moved.swapaxes(-1, -2))

    def solved(self, until: float) -> Shapes | None:
        cost = np.zeros(self.parts[-1])
        cost[self.parts[-2] :] = np.tensordot(self.few, self.inverse / self.n, axes=2)
        n, volume = self.n, self.unknown(len(self.parts) - 2, self.few)
        pair = np.kron(np.array([[0.0, 1.0], [1.0, 0.0]]), np.eye(n))[None].astype(float)
        blocks = np.zeros((self.parts[-1], 2 * n, 2 * n))
        blocks[:, :n, :n], blocks[:, n:, n:] = self.inverses, volume
        last = (1 - _LOSS) * self.inverses - self.knots[-1][:, :n, :n]
        fixed: list[Inequality] = [*self.extents, (pair, blocks[None]), (np.zeros((1, n, n)), last[None])]
        for k in range(self.count):
            side = np.zeros((self.parts[-1], n + 1, n + 1))
            side[:, 1:, 1:] = self.inverses
            side[:, 0, 1:] = side[:, 1:, 0] = self.rows[:, k]
            one = np.zeros((n + 1, n + 1))
            one[0, 0] = (1 - _INSIDE) ** 2
            fixed.append((one[None], side[None]))
        ends, parts = [None, *range(2 * _PIECES)], (self.inverses, self.rows, self.knots)
        pools = [self._all(end)[:1] for end in ends]
        if [pool.shape[1] for pool in self.loop.pools] == [pool.shape[1] for pool in pools]:
            pools = self.loop.pools  # of the round before
        for _ in range(_CUTS):
            if time.process_time() > until:
                return None
            sides = [self.needed(pool, end, parts) for pool, end in zip(pools, ends, strict=True)]
            cuts = [(np.zeros((len(side), *side.shape[2:])), side) for side in sides]
            x = minimise(cost, [*fixed, *cuts], tolerance=_TOLERANCE)
            if x is None:
                return None
            worst = [self._worst(x, end) for end in ends]
            if all(least > -_TOLERANCE for least, _ in worst):
                self.loop.pools = [vertices for _, vertices in worst]
                return self._shapes(x)
            pools = [np.unique(np.vstack([a, b]), axis=0) for a, (_, b) in zip(pools, worst, strict=True)]
        return None

    def _worst(self, x: Array, end: int | None) -> tuple[float, Bits]:
        """Return the least eigenvalue of all vertices, and the vertices with the least ones."""
        knots = [np.tensordot(x, knot, axes=1)[None] for knot in self.knots]
        parts = np.tensordot(x, self.inverses, axes=1)[None], np.tensordot(x, self.rows, axes=1)[None], knots
        chosen = self._all(end)
        least = np.linalg.eigvalsh(self.needed(chosen, end, parts)[:, 0])[:, 0]
        order = np.argsort(least)[:_WORST]
        return float(least[order[0]]), chosen[order]

    def _all(self, end: int | None) -> Bits:
        """Return all vertices, or many of them."""
        count = len((self.jump if end is None else self.flow).low)
        if count > _MOST:
            return np.random.default_rng(0).random((2**_MOST, count)) < 0.5
        return ((np.arange(2**count)[:, None] >> np.arange(count)) & 1).astype(bool)

    def _shapes(self, x: Array) -> Shapes:
        own = self.scales[: self.n]
        q = np.tensordot(x, self.inverses, axes=1)
        feedbacks = np.tensordot(x, self.rows, axes=1) @ np.linalg.inv(q) * self.limits[:, None] / own
        knots = np.array([np.tensordot(x, knot, axes=1) for knot in self.knots])
        # an affine law leaves W(0) flat, and semidefinite only up to the tolerance
        knots = (knots + 2 * _TOLERANCE * np.eye(self.size)) * np.outer(self.scales, self.scales)
        return Shapes(q * np.outer(own, own), knots, feedbacks)


_LEVELS = (0.99, 0.95, 0.85, 0.7, 0.5)  # that are tried, relative to the proposed one
_SEARCH = 0.5  # share of the time for the search
_DIGITS = 9  # of an entry of a knot


@dataclass(frozen=True, eq=False)
class SampledStability(Stability):
    """The claim that V < level at the sampling instants is a region of attraction of a loop with held commands.

    Attributes:
        dynamics: the dynamics, with their sampling.
        function: V, an expression of the states.
        level: level of the region.
        rate: share of V that is lost at least in each period; None means any strict decrease.
    """

    @property
    def statement(self) -> str:
        """The claim in words."""
        sampling = self.dynamics.sampling
        assert sampling is not None
        held = f"sampled every {every_digit(sampling.period)} s with held commands"
        pace = "" if self.rate is None else f" by at least {every_digit(self.rate)} of its value"
        if self.dynamics.shifts:
            start = f"every solution that starts at an instant where V < {every_digit(self.level)}"
            about = f"; V about that equilibrium decreases{pace} from sample to sample"
            return f"{held}: {start} stays in the box and converges to {self.goal}{about}"
        return (
            f"{held}: where the Lyapunov function V < {every_digit(self.level)}, V decreases{pace} from sample to "
            f"sample, and every solution converges to {self.goal}"
        )

    def plain(self) -> dict[str, Any]:
        """Return the claim as plain data, as the certificate states it."""
        sampling = self.dynamics.sampling
        assert sampling is not None
        commands = [{"name": c.name, "unit": c.unit, "value": text_of(c.value)} for c in sampling.commands]
        claim = super().plain()
        rests = claim["equilibrium"] | {c.name: stated_number(c.rest) for c in sampling.commands}
        return claim | {
            "time": "sampled",
            "commands": commands,
            "dynamics": {name: text_of(node) for name, node in sampling.flow.items()},
            "next": {name: text_of(node) for name, node in sampling.next.items()},
            "period_s": float(sampling.period),
            "equilibrium": rests,
        }


def sampled_region(
    dynamics: Dynamics, rate: float | None, *, time_limit: float, progress: Callable[[str], None] | None = None
) -> Decision | None:
    """Find and prove a region of attraction of a loop with held commands; return None if none is proved.

    Args:
        dynamics: the dynamics, with their sampling.
        rate: demanded decay rate of V [1/s]; None means any strict decrease.
        time_limit: limit of the processor time [s].
        progress: function that receives a line of progress from time to time.
    """
    assert dynamics.sampling is not None
    began, until = time.perf_counter(), time.process_time() + time_limit
    share = None if rate is None else float(f"{rate * dynamics.sampling.period:.12g}")  # 1 − r T < exp(−r T)
    if share is not None and share >= 1:
        return None
    shapes = sampled_shapes(dynamics, share or 0.0, seconds=_SEARCH * time_limit)
    if shapes is None:
        return None
    p = np.asarray(np.linalg.inv(shapes.inverse), dtype=float)
    function = quadratic(dynamics, p)
    radius = dict(dynamics.shifts) or _radii(dynamics, shapes, share or 0.0)
    for wide in _LEVELS:
        level = dynamics.inner_level(p, wide)
        left = until - time.process_time()
        if left <= 0 or not level > 0:
            break
        widest = np.vstack([shapes.inverse[None], shapes.knots[:, : len(shapes.inverse), : len(shapes.inverse)]])
        claim = SampledStability(enclosing(dynamics, widest, wide), function, level, share, radius)
        document = seal(claim.kind, claim.plain(), _evidence(shapes))
        checked = check_document(document, time_limit=min(left, PATIENCE))
        if progress:
            progress(f"sampled loop: level {level:g} {'proved' if checked.accepted else checked.reason}")
        if checked.accepted:
            return Decision(claim, "proved", document, "", {}, time.perf_counter() - began, checked.vacuous)
    return None


def _radii(dynamics: Dynamics, shapes: Shapes, share: float) -> dict[str, float]:
    """Return radii of states and commands, if the equilibrium is one only up to rounding; none if it is exact."""
    d, sampling = dynamics, dynamics.sampling
    assert sampling is not None
    at, n, zero = [s.rest for s in d.states], len(d.states), number(0)
    rests = at + [c.rest for c in sampling.commands]
    far = [1 + abs(float(c.rest)) for c in sampling.commands]
    held = [Range(c.name, float(c.rest) - x, float(c.rest) + x) for c, x in zip(sampling.commands, far, strict=True)]
    after = [*(sampling.next.get(s.name, variable(s.name)) for s in d.states), *(c.value for c in sampling.commands)]
    flow = [sampling.flow.get(s.name, zero) for s in d.states] + [zero] * len(held)
    jump = drift(d.variables, after, at, rests)
    moved = drift((*d.states, *held, *d.parameters), flow, rests, [Fraction(0)] * len(rests))
    if not (jump.any() or moved.any()):
        return {}
    inverses = np.linalg.inv(shapes.knots)
    total = norm(inverses[0], jump) + sampling.period * max(norm(p, moved) for p in inverses)
    covers = np.zeros((len(shapes.knots) + 1, len(rests), len(rests)))
    covers[:-1], covers[-1, :n, :n] = shapes.knots, shapes.inverse
    names = [v.name for v in (*d.states, *held)]
    return dict(zip(names, radii(total, covers, share or _LOSS / 4).tolist(), strict=True))


def _evidence(shapes: Shapes) -> Mapping[str, Any]:
    def row(numbers: Any) -> list[float]:
        return [float(f"{x:.{_DIGITS}e}") for x in numbers]

    return {
        "knots": [[row(line) for line in (knot + knot.T) / 2] for knot in shapes.knots],
        "feedbacks": [row(line) for line in shapes.feedbacks],
    }

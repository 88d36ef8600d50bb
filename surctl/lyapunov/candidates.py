"""Candidates for Lyapunov functions: quadratic functions and polynomials that are shaped for a large region."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.equilibrium import Linear, common_quadratic
from surctl.lyapunov.rays import Grid, directions, grid
from surctl.lyapunov.seeds import sampled_function, without_neutral
from surctl.lyapunov.shape import enlarge
from surctl.lyapunov.symmetry import invariant, sign_symmetries
from surctl.lyapunov.template import Template, polynomials, quadratic, with_cosines
from surctl.verification.formula import Node

__all__ = ["Candidate", "candidates", "strict_variants"]

Array = NDArray[np.float64]

_MOST_CORNERS = 8
_MOST_TERMS = 130  # polynomials with more terms are not searched
_SPARE = 0.02  # least decay rate of a candidate, as a share of that of the linearisation
_BRISK = 20.0  # decay rate of a function that is easy to prove, relative to the least one
_FASTER = 1.02  # decay rate of a candidate relative to the demanded one
_MARGIN = 1.25  # radius of the grid relative to that of the region
_ROUNDS = 5
_GROWTH = 1.01  # relative growth of the volume below which the rounds end


@dataclass(frozen=True, eq=False)
class Candidate:
    """A candidate for a Lyapunov function.

    Attributes:
        label: description, such as "polynomial of degree 4".
        function: V, with rounded coefficients; the region is about V < 1.
        volume: estimated volume of the region, relative to the box.
        feedbacks: feedbacks (k, n) of limits, for a proof by the slope rule.
    """

    label: str
    function: Node
    volume: float
    feedbacks: Array = field(default_factory=lambda: np.zeros((0, 0)))


def candidates(
    dynamics: Dynamics, linear: Linear, *, degree: int, seconds: float, rate: float = 0.0, seed: int = 0
) -> Iterator[Candidate]:
    """Yield candidates of increasing degree, each shaped for a large region.

    Args:
        dynamics: the dynamics.
        linear: the linearisation at the corners of the parameters.
        degree: largest degree of a polynomial.
        seconds: limit of the processor time [s].
        rate: decay rate that V must have in the region.
        seed: seed of the random numbers.
    """
    d = dynamics
    until = time.process_time() + seconds
    scales = np.maximum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])
    # a function that decays just as fast as demanded close to the equilibrium is hard to prove
    rate = max(_FASTER * rate, _least_rate(d, linear))
    shaper = _Shaper(d, scales, rate, seed, half=_odd(d))
    part = (0.06 if len(scales) < 4 else 0.25) * seconds
    signs = sign_symmetries(d)

    def restricted(degree: int, *, even: bool = False) -> Template:
        whole = invariant(polynomials(d, degree, scales, even=even), scales, signs)
        return without_neutral(whole, scales, linear.matrices) if linear.verdict == "marginal" else whole

    template = restricted(2)
    matrix = (
        None
        if linear.verdict == "marginal"
        else common_quadratic(_shifted(d, linear, rate), scales, discrete=d.discrete)
    )
    start = (
        sampled_function(template, scales, shaper.corners, half=shaper.half, matrices=linear.matrices)
        if matrix is None
        else _quadratic(template, matrix, scales)
    )
    if start is None and degree >= 4:
        template = restricted(4, even=shaper.half)
        start = sampled_function(template, scales, shaper.corners, half=shaper.half, matrices=linear.matrices)
    if start is None:
        return
    if linear.verdict == "stable" and matrix is not None:
        fast = max(rate, _BRISK * _least_rate(d, linear))
        brisk = _Shaper(d, scales, fast, seed, half=shaper.half)
        own = common_quadratic(_shifted(d, linear, fast), scales, discrete=d.discrete)
        shaped, volume = (
            (start, 0.0) if own is None else brisk.shaped(template, _quadratic(template, own, scales), part)
        )
        if volume > 0:
            yield Candidate("quadratic with a fast decrease", template.function(shaped), volume)
    coefficients, volume = shaper.shaped(template, start, part)
    label = "quadratic" if len(template.basis) == len(restricted(2).basis) else "polynomial of degree 4"
    yield Candidate(label, template.function(coefficients), volume)
    if not volume > 0 or len(scales) >= 4:  # the proof of larger regions takes too long
        if matrix is not None:  # shaping may end at a function that does not decrease close to the equilibrium
            plain = template.function(_quadratic(template, matrix, scales))
            yield Candidate("quadratic of the linearisation", plain, 0.0)
        return
    energy = with_cosines(template, scales)
    if len(energy.basis) > len(template.basis):
        outcome, volume = shaper.shaped(energy, _embedded(template, coefficients, energy), part)
        yield Candidate("quadratic with the potential energy of angles", energy.function(outcome), volume)
    for higher in range(4 if label == "quadratic" else 6, degree + 1, 2):
        wider = restricted(higher, even=shaper.half)
        if len(wider.basis) > _MOST_TERMS:
            return
        start = _embedded(template, coefficients, wider)
        share = (until - time.process_time()) / (1 + (degree - higher) // 2)
        template = wider
        coefficients, volume = shaper.shaped(template, start, share)
        yield Candidate(f"polynomial of degree {higher}", template.function(coefficients), volume)


def _quadratic(template: Template, matrix: Array, scales: Array) -> Array:
    """Return the coefficients of (x − x*)' P (x − x*) in a template of some products of two states."""
    d = template.dynamics
    known = dict(zip(polynomials(d, 2, scales).basis, quadratic(d, matrix), strict=True))
    return np.array([known[node] for node in template.basis])


def _shifted(d: Dynamics, linear: Linear, rate: float) -> Array:
    """Return matrices whose quadratic functions decrease at least at a rate along the linearisation."""
    if d.discrete:
        return np.asarray(linear.matrices / np.sqrt(1 - min(rate, 0.999)))
    return linear.matrices + np.eye(len(d.states)) * rate / 2


def _embedded(template: Template, coefficients: Array, wider: Template) -> Array:
    """Return the coefficients of the same function in a template that contains the basis of the other one."""
    at = {node: k for k, node in enumerate(wider.basis)}
    total = np.zeros(len(wider.basis))
    for node, c in zip(template.basis, coefficients, strict=True):
        total[at[node]] = c
    return total


def strict_variants(dynamics: Dynamics, linear: Linear, function: Node) -> Iterator[Candidate]:
    """Yield a function plus small multiples of a quadratic function that decreases close to the equilibrium.

    They are other functions: a next step for the user, never a proof about the function itself.
    """
    d = dynamics
    scales = np.maximum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])
    matrix = common_quadratic(linear.matrices, scales, discrete=d.discrete)
    if matrix is None:
        return
    template = polynomials(d, 2, scales)
    x = d.equilibrium[:, None] + scales[:, None] * directions(len(scales), 256) * 0.1
    size = float(np.median(np.asarray(d.compiled(function)(x, np.repeat(d.corners()[:, :1], x.shape[1], axis=1)))))
    coefficients = quadratic(d, matrix)
    coefficients *= size / float(np.median(coefficients @ template.features(x, d.corners()[:, 0])[0]))
    for share in (0.3, 0.1, 0.03, 0.01):
        added = template.function(share * coefficients)
        yield Candidate(f"given function plus {share:g} of a quadratic one", function + added, 0.0)


def _least_rate(d: Dynamics, linear: Linear) -> float:
    """Return a small part of the slowest decay rate of a quadratic function close to the equilibrium."""
    if linear.verdict == "marginal":
        return 0.0
    eigenvalues = np.linalg.eigvals(linear.matrices)
    slowest = 1 - float(np.abs(eigenvalues).max()) ** 2 if d.discrete else -2 * float(eigenvalues.real.max())
    return _SPARE * slowest


@dataclass(eq=False)
class _Shaper:
    dynamics: Dynamics
    scales: Array
    rate: float
    seed: int
    half: bool

    def __post_init__(self) -> None:
        d = self.dynamics
        n = len(d.states)
        corners = d.corners(most=10)
        few = np.random.default_rng(0).permutation(corners.shape[1])[:_MOST_CORNERS]
        self.corners = corners[:, np.sort(few)]
        self.rays = {1: 2, 2: 64 if self.half else 128}.get(n, 512 if n == 3 else 1024)
        self.extent: Array | None = None
        self.directions = directions(n, self.rays, half=self.half)

    def shaped(self, template: Template, start: Array, seconds: float) -> tuple[Array, float]:
        """Return coefficients with a large region V < 1, and the volume of the region relative to the box."""
        until = time.process_time() + seconds
        best, volume = start, 0.0
        for k in range(_ROUNDS):
            trial = self._grid(template)
            level = trial.sizes(best[None], self.rate).level[0]
            if not level > 0 and k > 0:
                break
            outcome, size = enlarge(
                trial, best, seconds=(until - time.process_time()) / 2, rate=self.rate, seed=self.seed + k
            )
            if not size > 0:
                return best, volume
            best = outcome
            radii = trial.extent(outcome, 1.0)
            self.extent = radii
            grown = self._volume(radii)
            done = grown < volume * _GROWTH
            volume = max(volume, grown)
            if done or time.process_time() > until:
                break
        return self._polished(template, start, best, max(until - time.process_time(), seconds / 4)), volume

    def _polished(self, template: Template, start: Array, best: Array, seconds: float) -> Array:
        """Return coefficients near `best` that are also good between the points of the coarse grid."""
        fine = self._grid(template, finer=2)
        first = start / max(float(fine.sizes(start[None], self.rate).level[0]), 1e-300)
        for share in (0.0, 0.01, 0.03, 0.1, 0.3):
            trial = (1 - share) * best + share * first
            if fine.sizes(trial[None], self.rate).level[0] > 0:
                return enlarge(fine, trial, seconds=seconds, rate=self.rate, seed=self.seed, step=1e-3)[0]
        return first

    def _grid(self, template: Template, finer: int = 1) -> Grid:
        n = len(self.scales)
        outer = None if self.extent is None else _MARGIN * self.extent
        if outer is not None and finer > 1:
            # each direction takes the radius of the nearest coarse one
            near = np.argmax(directions(n, finer * self.rays, half=self.half).T @ self.directions, axis=1)
            outer = outer[near]
        points = 48 if outer is None else 24 if n < 4 else 16
        return grid(
            template,
            self.scales,
            rays=finer * self.rays,
            points=points,
            corners=self.corners,
            outer=outer,
            half=self.half,
        )

    def _volume(self, radii: Array) -> float:
        from scipy.special import gamma

        n = len(self.scales)
        ball = np.pi ** (n / 2) / gamma(n / 2 + 1)
        box = np.prod((self.dynamics.box[1] - self.dynamics.box[0]) / self.scales)
        return float(ball * (radii**n).mean() / box)


def _odd(d: Dynamics) -> bool:
    """Return whether the dynamics are symmetric to the equilibrium: f(x* + z) = −f(x* − z) for all parameters."""
    low, high = d.box - d.equilibrium
    if not np.allclose(low, -high):
        return False
    random = np.random.default_rng(0)
    z = high[:, None] * random.uniform(-1, 1, (len(high), 64))
    w = d.ranges[0][:, None] + (d.ranges[1] - d.ranges[0])[:, None] * random.uniform(0, 1, (d.ranges.shape[1], 64))
    x = d.equilibrium[:, None]
    ahead, back = d.evaluate(x + z, w), d.evaluate(x - z, w)
    if d.discrete:
        ahead, back = ahead - x, back - x
    return bool(np.allclose(ahead, -back, rtol=1e-9, atol=1e-12 * np.abs(ahead).max()))

"""Candidates for Lyapunov functions: quadratic functions and polynomials that are shaped for a large region."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.equilibrium import Linear, common_quadratic
from surctl.lyapunov.near import slowest
from surctl.lyapunov.rays import Grid, directions, grid
from surctl.lyapunov.template import Template, polynomials, quadratic, with_cosines
from surctl.verification.formula import Node

# First functions of a template by linear programs over samples, where the linearisation gives no quadratic one


Array = NDArray[np.float64]

_PARTS = (0.5, 0.2, 0.05)  # radii of the sampled ball, relative to the box
_ORDERS = (2, 4)  # V and its decrease are bounded below by multiples of r^order
_FLAT = 1e-9  # singular values below this share of the largest one count as 0
_LEAST = 1e-7  # least multiple, for scaled coefficients of at most 1


def _sampled_function(
    template: Template, scales: Array, corners: Array, *, half: bool, matrices: Array
) -> Array | None:
    """Return coefficients (K,) with which V is positive and decreases at samples close to the equilibrium, or None.

    The linear program maximises t with V ≥ t r^p and V' ≤ −t r^q, or V⁺ − V ≤ −t r^q, at all samples.

    Args:
        template: the template.
        scales: lengths (n,) of the states.
        corners: values (m, C) of the parameters.
        half: whether dynamics and template are symmetric to the equilibrium.
        matrices: Jacobians (C, n, n) of the dynamics.
    """
    from scipy.optimize import linprog

    n, count = len(scales), len(template.basis)
    level = _neutral(template, scales, matrices)
    for part in _PARTS:
        rays = 64 if n == 2 else 2 if n == 1 else 256
        samples = grid(
            template, scales, rays=rays, points=10, corners=corners, outer=np.full(rays, part), half=half, beyond=0
        )
        size = np.abs(samples.values).max(axis=1)
        values = samples.values / size[:, None]
        changes = samples.changes / size[:, None]
        r = np.sqrt(samples.square) / part
        for p in _ORDERS:
            for q in (p, p + 2):
                # rows divided by r^order, so that samples close to the equilibrium count as much as the others
                rows = [np.column_stack([-(values / r**p).T, np.ones(r.size)])]
                rows += [np.column_stack([(change / r**q).T, np.ones(r.size)]) for change in changes]
                matrix = np.vstack(rows)
                run = linprog(
                    np.append(np.zeros(count), -1.0), A_ub=matrix, b_ub=np.zeros(len(matrix)),
                    A_eq=np.column_stack([level / size, np.zeros(len(level))]), b_eq=np.zeros(len(level)),
                    bounds=[(-1, 1)] * count + [(0, 1)], method="highs",
                )  # fmt: skip
                if run.status == 0 and run.x[-1] > _LEAST:
                    return np.asarray(run.x[:-1] / size)
    return None


def _without_neutral(template: Template, scales: Array, matrices: Array) -> Template:
    """Return the template without the products whose coefficient has to be 0 by the equations of `_neutral`.

    Args:
        template: the template.
        scales: lengths (n,) of the states.
        matrices: Jacobians (C, n, n) of the dynamics.
    """
    used = np.abs(_neutral(template, scales, matrices)) > _FLAT
    keep = np.ones(len(template.basis), dtype=bool)
    while True:
        alone = used[(used & keep).sum(axis=1) == 1]
        if not alone.size or not (keep & alone.any(axis=0)).any():
            break
        keep &= ~alone.any(axis=0)
    return template.only(keep)


def _neutral(template: Template, scales: Array, matrices: Array) -> Array:
    """Return the rows (k, K) of equations without which V' is not negative close to the equilibrium.

    Along a direction v with A v = 0, the second order of V' = z'(A'P + P A)z vanishes, so that (A'P + P A)v = A'P v
    has to be 0: else V' changes its sign close to v. In discrete time, A − I takes the place of A.
    """
    n = len(scales)
    place = {node: k for k, node in enumerate(template.basis)}
    products = polynomials(template.dynamics, 2, scales).basis
    total = [np.zeros((0, len(place)))]
    for matrix in matrices:
        a = (matrix - np.eye(n) if template.dynamics.discrete else matrix) * scales / scales[:, None]
        _, sizes, directions = np.linalg.svd(a)
        for v in directions[sizes <= _FLAT * max(float(sizes.max()), 1e-300)]:
            equations = np.zeros((n, len(place)))
            for node, i, j in zip(products, *np.triu_indices(n), strict=True):
                if node in place:
                    # in scaled states, the coefficient of a product counts as much as its monomial
                    equations[:, place[node]] = scales[i] * scales[j] * (a[i] * v[j] + a[j] * v[i]) / 2
            total.append(equations[np.abs(equations).max(axis=1) > 0])
    return np.vstack(total)


# Shape a function of a template for a large region V < γ, by an evolution strategy with covariance adaptation


_FLOOR = 1e-5  # least eigenvalue of the correlation of the features that is scaled up
_STALL = 1e-4  # relative growth of the volume in `patience` generations below which the search stops


def enlarge(
    grid: Grid, start: Array, *, seconds: float, rate: float = 0.0, seed: int = 0, step: float = 0.02
) -> tuple[Array, float]:
    """Return coefficients (K,) whose region V < γ is large, and its relative volume; γ is 1.

    The strategy is the covariance matrix adaptation of Hansen (2016) on the logarithm of the volume.

    Args:
        grid: features of the template on rays.
        start: coefficients (K,) of a function with a region that is not empty.
        seconds: limit of the processor time [s].
        rate: decay rate that V must have in the region.
        seed: seed of the random numbers.
        step: first standard deviation, relative to the coefficients that keep V within 1 on the region.
    """
    until = time.process_time() + seconds
    random = np.random.default_rng(seed)
    first = grid.sizes(start[None], rate)
    if not first.level[0] > 0:
        return start, 0.0
    mean0 = start / first.level[0]
    # coordinates in which the features are nearly uncorrelated, with about unit variance
    gram = grid.values @ grid.values.T / grid.values.shape[1]
    size = np.sqrt(np.diag(gram))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    spread = (vectors / np.sqrt(np.maximum(values, _FLOOR * values.max()))).T / size  # rows are directions
    n = len(start)
    batch = 4 + int(3 * np.log(n)) * 2
    half = batch // 2
    weights = np.log(half + 0.5) - np.log(np.arange(1, half + 1))
    weights /= weights.sum()
    mass = 1 / (weights**2).sum()
    c_sigma, c_c = (mass + 2) / (n + mass + 5), (4 + mass / n) / (n + 4 + 2 * mass / n)
    c_1 = 2 / ((n + 1.3) ** 2 + mass)
    c_mu = min(1 - c_1, 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass))
    damping = 1 + 2 * max(0.0, np.sqrt((mass - 1) / (n + 1)) - 1) + c_sigma
    chi = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
    mean, sigma = np.zeros(n), step
    covariance, path_sigma, path_c = np.eye(n), np.zeros(n), np.zeros(n)
    root, inverse = np.eye(n), np.eye(n)
    best, best_volume = mean0, float(first.volume[0])
    history = [best_volume]
    patience = 30 + 3 * n
    generation = 0
    while time.process_time() < until:
        generation += 1
        z = random.standard_normal((batch, n)) @ root
        trial = mean + sigma * z
        coefficients = mean0 + trial @ spread
        sizes = grid.sizes(coefficients, rate)
        possible = sizes.volume > 0
        if possible.sum() < half:
            sigma /= 2
            if sigma < 1e-9:
                break
            continue
        order = np.argsort(-sizes.volume, kind="stable")
        top = order[0]
        if sizes.volume[top] > best_volume:
            best, best_volume = coefficients[top] / sizes.level[top], float(sizes.volume[top])
        picked = z[order[:half]]
        move = weights @ picked
        mean = mean + sigma * move
        path_sigma = (1 - c_sigma) * path_sigma + np.sqrt(c_sigma * (2 - c_sigma) * mass) * (move @ inverse)
        length = np.linalg.norm(path_sigma)
        calm = length / np.sqrt(1 - (1 - c_sigma) ** (2 * generation)) < (1.4 + 2 / (n + 1)) * chi
        path_c = (1 - c_c) * path_c + calm * np.sqrt(c_c * (2 - c_c) * mass) * move
        covariance = (
            (1 - c_1 - c_mu) * covariance + c_1 * np.outer(path_c, path_c) + c_mu * (picked.T * weights) @ picked
        )
        sigma *= np.exp(min(1.0, c_sigma / damping * (length / chi - 1)))
        if generation % max(1, n // 10) == 0:
            eigen, basis = np.linalg.eigh((covariance + covariance.T) / 2)
            scale = np.sqrt(np.maximum(eigen, 1e-14))
            root, inverse = (basis * scale) @ basis.T, (basis / scale) @ basis.T
        history.append(best_volume)
        if len(history) > patience and history[-1] <= history[-patience] * (1 + _STALL):
            break
    return best, best_volume


# Sign symmetries of dynamics: changes of the signs of some states that map solutions to solutions


_SAMPLES, _MOST_STATES = 32, 10
_SAME = 1e-9  # largest difference, relative to the largest value


def sign_symmetries(dynamics: Dynamics) -> Array:
    """Return the sign changes s (m, n) of x − x* with f(x* + s z) = s f(x* + z), other than none, judged by samples.

    Args:
        dynamics: the dynamics.
    """
    d = dynamics
    n = len(d.states)
    random = np.random.default_rng(0)
    size = np.minimum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])
    z = size[:, None] * random.uniform(-1, 1, (n, _SAMPLES))
    low, high = d.ranges
    w = low[:, None] + (high - low)[:, None] * random.uniform(0, 1, (len(low), _SAMPLES))
    x = d.equilibrium[:, None]
    centre = x if d.discrete else 0.0
    rates = d.evaluate(x + z, w) - centre
    limit = _SAME * np.maximum(np.abs(rates).max(axis=1, keepdims=True), 1e-300)
    signs = [np.array(s) for s in itertools.product((1.0, -1.0), repeat=n)][1:] if n <= _MOST_STATES else [-np.ones(n)]
    return np.array(
        [s for s in signs if np.all(np.abs(d.evaluate(x + s[:, None] * z, w) - centre - s[:, None] * rates) <= limit)]
    ).reshape(-1, n)


def invariant(template: Template, scales: Array, signs: Array) -> Template:
    """Return the basis functions of a template that no sign change alters.

    The mean of a Lyapunov function over all changes is one as well, so nothing is lost.

    Args:
        template: the template.
        scales: lengths (n,) of the states.
        signs: the sign changes (m, n).
    """
    d = template.dynamics
    z = scales[:, None] * np.random.default_rng(0).uniform(0.1, 1, (len(scales), 4))
    w = d.corners()[:, 0]
    x = d.equilibrium[:, None]
    values = template.features(x + z, w)[0]
    keep = np.ones(len(template.basis), dtype=bool)
    for s in signs:
        keep &= np.isclose(template.features(x + s[:, None] * z, w)[0], values).all(axis=1)
    return template.only(keep)


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
    signs = sign_symmetries(d)
    low, high = d.box - d.equilibrium
    half = np.allclose(low, -high) and any(np.all(s < 0) for s in signs)  # f(x* + z) = −f(x* − z)
    shaper = _Shaper(d, scales, rate, seed, half=half)
    part = (0.06 if len(scales) < 4 else 0.25) * seconds

    def restricted(degree: int, *, even: bool = False) -> Template:
        whole = invariant(polynomials(d, degree, scales, even=even), scales, signs)
        return _without_neutral(whole, scales, linear.matrices) if linear.verdict == "marginal" else whole

    template = restricted(2)
    matrix = (
        None
        if linear.verdict == "marginal"
        else common_quadratic(_shifted(d, linear, rate), scales, discrete=d.discrete)
    )
    start = (
        _sampled_function(template, scales, shaper.corners, half=shaper.half, matrices=linear.matrices)
        if matrix is None
        else quadratic(template, matrix)
    )
    if start is None and degree >= 4:
        template = restricted(4, even=shaper.half)
        start = _sampled_function(template, scales, shaper.corners, half=shaper.half, matrices=linear.matrices)
    if start is None:
        return
    if linear.verdict == "stable" and matrix is not None:
        fast = max(rate, _BRISK * _least_rate(d, linear))
        brisk = _Shaper(d, scales, fast, seed, half=shaper.half)
        own = common_quadratic(_shifted(d, linear, fast), scales, discrete=d.discrete)
        shaped, volume = (start, 0.0) if own is None else brisk.shaped(template, quadratic(template, own), part)
        if volume > 0:
            yield Candidate("quadratic with a fast decrease", template.function(shaped), volume)
    coefficients, volume = shaper.shaped(template, start, part)
    label = "quadratic" if len(template.basis) == len(restricted(2).basis) else "polynomial of degree 4"
    yield Candidate(label, template.function(coefficients), volume)
    if not volume > 0 or len(scales) >= 4:  # the proof of larger regions takes too long
        if matrix is not None:  # shaping may end at a function that does not decrease close to the equilibrium
            plain = template.function(quadratic(template, matrix))
            yield Candidate("quadratic of the linearisation", plain, 0.0)
        return
    energy = with_cosines(template, scales)
    if len(energy.basis) > len(template.basis):
        start = energy.coefficients(dict(zip(template.basis, coefficients, strict=True)))
        outcome, volume = shaper.shaped(energy, start, part)
        yield Candidate("quadratic with the potential energy of angles", energy.function(outcome), volume)
    for higher in range(4 if label == "quadratic" else 6, degree + 1, 2):
        wider = restricted(higher, even=shaper.half)
        if len(wider.basis) > _MOST_TERMS:
            return
        start = wider.coefficients(dict(zip(template.basis, coefficients, strict=True)))
        share = (until - time.process_time()) / (1 + (degree - higher) // 2)
        template = wider
        coefficients, volume = shaper.shaped(template, start, share)
        yield Candidate(f"polynomial of degree {higher}", template.function(coefficients), volume)


def _shifted(d: Dynamics, linear: Linear, rate: float) -> Array:
    """Return matrices whose quadratic functions decrease at least at a rate along the linearisation."""
    if d.discrete:
        return np.asarray(linear.matrices / np.sqrt(1 - min(rate, 0.999)))
    return linear.matrices + np.eye(len(d.states)) * rate / 2


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
    coefficients = quadratic(template, matrix)
    coefficients *= size / float(np.median(coefficients @ template.features(x, d.corners()[:, 0])[0]))
    if not size or not np.isfinite(coefficients).all():  # no small part of such a function
        return
    for share in (0.3, 0.1, 0.03, 0.01):
        added = template.function(share * coefficients)
        yield Candidate(f"given function plus {share:g} of a quadratic one", function + added, 0.0)


def _least_rate(d: Dynamics, linear: Linear) -> float:
    """Return a small part of the slowest decay rate of a quadratic function close to the equilibrium."""
    return 0.0 if linear.verdict == "marginal" else _SPARE * slowest(d, linear)[1]


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

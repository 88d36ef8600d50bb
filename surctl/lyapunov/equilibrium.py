"""Equilibria in a box: found, made exact, or refused, also where parameters move them too far; linearisation, P."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from flint import fmpq, fmpq_mat
from mpmath import libmp
from numpy.typing import NDArray

from surctl.certcheck.enclosure import Undefined, enclose, rational
from surctl.certcheck.expressions import ExpressionTable
from surctl.errors import InputError, NotApplicable
from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.shifts import shifted
from surctl.verification.formula import Node, exact_values, text_of, variable

Array = NDArray[np.float64]

_REST = 1e-9  # largest residual of an equilibrium, relative to the largest rate of the same state in the box
_MARGIN = 1e-7  # real parts within this share of the largest modulus of an eigenvalue count as 0
_STARTS = 64
_STEPS = 20  # of Newton's method, from an equilibrium that is known to some digits


@dataclass(frozen=True, eq=False)
class Linear:
    """The linearisation at the equilibrium.

    Attributes:
        matrices: Jacobians (C, n, n) at the corners of the parameters.
        verdict: "stable", "unstable", or "marginal": an eigenvalue on the border of stability decides nothing.
        reason: the eigenvalue that is not stable, in words; empty if all are.
    """

    matrices: Array
    verdict: str
    reason: str


def equilibria(dynamics: Dynamics, *, seed: int = 0) -> list[Array]:
    """Return the equilibria (n,) in the box, at the middle of the parameters, that a root search finds."""
    from scipy.optimize import fsolve
    from scipy.stats import qmc

    d = dynamics
    low, high = d.box
    size = d.size()
    size[size == 0] = 1.0

    def rest(z: Array) -> Array:
        x = low + (high - low) * z
        return (d.evaluate(x[:, None])[:, 0] - (x if d.discrete else 0.0)) / size

    outcome: list[Array] = []
    for start in qmc.Sobol(len(low), seed=seed).random(_STARTS):
        z, _, flag, _ = fsolve(rest, start, full_output=True)
        if flag != 1 or np.any(z < 0) or np.any(z > 1) or np.abs(rest(z)).max() > _REST:
            continue
        if all(np.abs(z - other).max() > 1e-6 for other in outcome):
            outcome.append(z)
    ordered = sorted(outcome, key=lambda z: [round(float(v), 6) for v in z])
    return [_short(d, low + (high - low) * z, size) for z in ordered]


def _short(d: Dynamics, x: Array, size: Array) -> Array:
    """Return the equilibrium with the fewest decimals, counted from the size of the box, that is as exact."""

    def rest(at: Array) -> Array:
        return np.asarray(np.abs(d.evaluate(at[:, None])[:, 0] - (at if d.discrete else 0.0)))

    whole = -np.floor(np.log10(d.box[1] - d.box[0])).astype(int)
    for decimals in range(16):
        rounded = np.array([round(float(v), int(k) + decimals) for v, k in zip(x, whole, strict=True)]) + 0.0
        if np.all(rest(rounded) <= np.maximum(rest(x), 1e-13 * size)):
            return rounded
    return x


def at_equilibrium(dynamics: Dynamics, *, seed: int = 0) -> Dynamics:
    """Return the dynamics with their equilibrium: their own, or else the only one that a root search finds.

    Only for dynamics whose equilibrium nobody stated: a stated one is never exchanged.

    Raises:
        InputError: their own equilibrium is not one, and none or several are found; or the dynamics are not defined
            there.
    """
    d = dynamics
    if np.all((d.box[0] < d.equilibrium) & (d.equilibrium < d.box[1])) and d.rests():
        return d
    outcome = equilibria(d, seed=seed)
    texts = "; ".join(", ".join(f"{name} = {v:.9g}" for name, v in zip(d.names, x, strict=True)) for x in outcome)
    if len(outcome) != 1:
        many = (
            f"is not one, and the box contains several: {texts}" if outcome else "is not one, and the search finds none"
        )
        raise InputError(
            many, key=f"{d.name}.equilibrium", remedy="give the equilibrium, or other bounds of the states"
        )
    moved = refined(_about(d, outcome[0]))
    if not moved.rests() and (about_all := shifted(moved)) is not None:
        return about_all
    if not moved.rests():
        raise InputError(
            f"moves with the parameters (at their middle: {texts})", key=f"{d.name}.equilibrium",
            remedy="fix the parameters, or claim a bound instead of stability",
        )  # fmt: skip
    return moved


def _about(d: Dynamics, x: Array) -> Dynamics:
    states = tuple(replace(s, equilibrium=float(v), exact=None) for s, v in zip(d.states, x, strict=True))
    return replace(d, states=states)


def refined(dynamics: Dynamics) -> Dynamics:
    """Return the dynamics with their equilibrium, known to some digits, to the last digit and as short as possible.

    Parameters have the middle of their ranges. An equilibrium that no step of Newton's method improves is kept. If no
    double is the equilibrium, it is exact where the rates are affine close to it, and elsewhere the closest double.
    """
    d = dynamics
    size = d.size()
    size[size == 0] = 1.0

    def rest(x: Array) -> Array:
        return (d.evaluate(x[:, None])[:, 0] - (x if d.discrete else 0.0)) / size

    x, near = d.equilibrium, rest(d.equilibrium)
    for _ in range(_STEPS if near.any() else 0):
        slope = _about(d, x).linear() - (np.eye(len(x)) if d.discrete else 0.0)
        if not (np.isfinite(near).all() and np.isfinite(slope).all()):
            break
        trial = x - np.linalg.lstsq(slope / size[:, None], near, rcond=None)[0]
        error = rest(trial)
        if not np.abs(error).max() < np.abs(near).max():
            break
        x, near = trial, error
    if not np.isfinite(near).all():
        return d
    short = _exact(_about(d, _short(d, x, size)))
    return _about(d, x) if inexact(short) else short


def _exact(d: Dynamics) -> Dynamics:
    rates = [rate - variable(s.name) if d.discrete else rate for s, rate in zip(d.states, d.rates, strict=True)]
    near = {s.name: s.rest for s in d.states}
    near |= {p.name: (Fraction(p.lower) + Fraction(p.upper)) / 2 for p in d.parameters}
    root = exact_root(rates, near, d.names) if inexact(d) else None
    if root is None:
        return d
    states = (replace(s, equilibrium=float(x), exact=x) for s, x in zip(d.states, root, strict=True))
    return replace(d, states=tuple(states))


_NEARBY, _LONGEST = Fraction(1, 2**60), 400  # step of differences; digits of a coordinate that a certificate may state


def exact_root(rates: Sequence[Node], near: Mapping[str, Fraction], moving: Sequence[str]) -> list[Fraction] | None:
    """Return values of the names `moving` at which all rates are exactly 0, by one exact step of Newton's method.

    The step is exact for rates that are affine between the point and the root, as with a linear law within its limits.

    Returns:
        None if the step does not end at a root, or needs too many digits.

    Example:
        >>> from fractions import Fraction
        >>> from surctl.lyapunov.equilibrium import exact_root
        >>> from surctl.verification.formula import parse, variable
        >>> exact_root([parse("min(2, 1 - 3*x)", {"x": variable("x")})], {"x": Fraction(0.33)}, ["x"])
        [Fraction(1, 3)]
    """
    ends = [exact_values(rates, {**near, name: near[name] + _NEARBY}) for name in moving]
    start = exact_values(rates, near)
    if start is None or None in ends:
        return None
    slopes = [fmpq(*((end[k] - x) / _NEARBY).as_integer_ratio()) for k, x in enumerate(start) for end in ends if end]
    try:
        step = fmpq_mat(len(start), len(start), slopes).solve(
            fmpq_mat(len(start), 1, [fmpq(*(-x).as_integer_ratio()) for x in start])
        )
    except ZeroDivisionError:
        return None
    root = [near[name] + Fraction(int(x.p), int(x.q)) for name, x in zip(moving, step.entries(), strict=True)]
    if max(len(str(part)) for one in root for part in one.as_integer_ratio()) > _LONGEST // 2 - 2:
        return None
    end = exact_values(rates, {**near, **dict(zip(moving, root, strict=True))})
    return root if end is not None and not any(end) else None


def require_common(dynamics: Dynamics) -> None:
    """Raise NotApplicable unless the equilibrium lies inside the box and is one for all parameters."""
    d = dynamics
    for s in d.states:
        if not s.lower < s.equilibrium < s.upper:
            where = "with middle parameters, it rests" if d.parameters else "it rests"
            because = f"{where} at {s.name} = {s.equilibrium:.6g} {s.unit}, not in [{s.lower:g}, {s.upper:g}] {s.unit}"
            raise NotApplicable(because, to="the loop", key=f"within.{s.name}")
    if not d.shifts and not d.rests():
        moving, words = held_parameters(d)
        because = f"its equilibrium moves with {moving}, too far for one region about all of them: {words}"
        raise NotApplicable(because, to="the loop", key=f"{d.name}.equilibrium")


def held_parameters(dynamics: Dynamics) -> tuple[str, str]:
    """Return the parameters that move the equilibrium, and constant values to give instead of their ranges, as text."""
    d = dynamics
    middle = [replace(p, lower=m, upper=m) for p, m in zip(d.parameters, d.ranges.mean(axis=0), strict=True)]
    still = refined(replace(d, parameters=tuple(middle), shifts={}))
    alone = [(*middle[:k], p, *middle[k + 1 :]) for k, p in enumerate(d.parameters)]
    held = [m for m, one in zip(middle, alone, strict=True) if not replace(still, parameters=one).rests()] or middle
    values = {p.typed or p.name: f"{p.lower if p.nominal is None else p.nominal:.6g}" for p in held}
    words = " ".join(f"{name}={value}..{value}" for name, value in values.items())
    words += f" or a narrower range (the proof then holds for {'this' if len(held) == 1 else 'these'} only)"
    return ", ".join(values), f"give {words}"


def inexact(dynamics: Dynamics) -> bool:
    """Return whether the equilibrium is one only up to rounding: interval arithmetic shows that a state moves there."""
    d = dynamics
    table = ExpressionTable([v.name for v in d.variables])
    roots = [table.read(text_of(rate)) for rate in d.rates]
    rests = [s.rest for s in d.states]
    try:
        for corner in d.corners(most=4).T:
            point = [rational(x) for x in (*rests, *(Fraction(repr(float(w))) for w in corner))]
            for s, (low, high) in zip(d.states, enclose(table, roots, point), strict=True):
                still = rational(s.rest if d.discrete else Fraction(0))
                if libmp.mpf_gt(low, still[1]) or libmp.mpf_lt(high, still[0]):
                    return True
    except Undefined:
        pass
    return False


def linearisation(dynamics: Dynamics) -> Linear:
    """Return the linearisation at the equilibrium for all corners of the parameters, and whether it is stable.

    Raises:
        InputError: the dynamics have no finite slope there.
    """
    d = dynamics
    corners = d.corners()
    matrices = np.array([d.linear(corner) for corner in corners.T])
    if not np.all(np.isfinite(matrices)):
        problem = "has no finite slope at the equilibrium"
        raise InputError(problem, key=f"{d.name}.dynamics", remedy="use expressions that are smooth there")
    eigenvalues = np.linalg.eigvals(matrices)
    grown = np.abs(eigenvalues) - 1 if d.discrete else eigenvalues.real
    i, j = np.unravel_index(np.argmax(grown), grown.shape)
    worst, size = float(grown[i, j]), max(float(np.abs(eigenvalues[i]).max()), 1e-12)
    if worst < -_MARGIN * size:
        return Linear(matrices, "stable", "")
    value = complex(eigenvalues[i, j])
    text = f"{value.real:.6g}" + (f" ± {abs(value.imag):.6g}i" if abs(value.imag) > 1e-9 * size else "")
    values = zip(d.parameters, corners[:, i], strict=True)
    where = ", ".join(f"{p.name} = {v:.6g}" for p, v in values if p.lower < p.upper)
    reason = f"the linearisation has the eigenvalue {text}" + (f" at {where}" if where else "")
    still = np.abs(eigenvalues[i].real) <= _MARGIN * size
    if not d.discrete and np.all(still) and np.all(np.abs(eigenvalues[i].imag) > _MARGIN * size):
        reason += " (a centre: solutions may circle for ever, and a conserved quantity may exist)"
    # roots of multiplicity k move by the k-th root of the rounding error
    fragile = np.abs(value) < 1e-3 * size or abs(grown[i, j]) < 1e-5 * size
    marginal = worst <= _MARGIN * size or (fragile and worst < 1e-6 * size)
    return Linear(matrices, "marginal" if marginal else "unstable", reason)


def common_quadratic(matrices: Array, scales: Sequence[float], *, discrete: bool) -> Array | None:
    """Return P (n, n) ≻ 0 with A'P + PA ≺ 0, or A'PA − P ≺ 0, for all matrices A (C, n, n); None if none is found.

    Args:
        matrices: stable matrices.
        scales: lengths (n,) of the states in which the decrease is measured.
        discrete: whether the matrices are those of x⁺ = A x.
    """
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    weight = np.diag(1 / np.asarray(scales) ** 2)
    nominal = matrices.mean(axis=0) if len(matrices) > 1 else matrices[0]
    solve = solve_discrete_lyapunov if discrete else lambda a, q: solve_continuous_lyapunov(a, -q)
    trials = [np.asarray(solve(nominal.T, weight))]
    if all(_decreases(trials[0], a, weight, discrete) for a in matrices):
        return trials[0]
    return _by_inequalities(matrices, np.asarray(scales), discrete=discrete)


def _decreases(p: Array, a: Array, weight: Array, discrete: bool) -> bool:
    loss = p - a.T @ p @ a if discrete else -(a.T @ p + p @ a)
    size = np.diag(1 / np.sqrt(np.diag(weight)))
    return bool(np.linalg.eigvalsh(size @ loss @ size).min() > 1e-6 and np.linalg.eigvalsh(size @ p @ size).min() > 0)


def _by_inequalities(matrices: Array, scales: Array, *, discrete: bool) -> Array | None:
    from surctl.verification.conic import minimise, symmetric_basis

    n = len(scales)
    size = np.diag(scales)
    scaled = np.linalg.inv(size) @ matrices @ size
    if not discrete:
        scaled = scaled / np.abs(np.linalg.eigvals(matrices)).max()  # P is the same up to a factor in any unit of time
    basis = symmetric_basis(n)
    zero = np.zeros((1, n, n))
    if discrete:
        loss = basis[None] - scaled[:, None].transpose(0, 1, 3, 2) @ basis[None] @ scaled[:, None]
    else:
        loss = -(scaled[:, None].transpose(0, 1, 3, 2) @ basis[None] + basis[None] @ scaled[:, None])
    rows = [(zero - np.eye(n) * 1e-6, basis[None]), (np.repeat(zero - np.eye(n), len(matrices), axis=0), loss)]
    cost = np.trace(basis, axis1=1, axis2=2)
    x = minimise(cost, rows)
    if x is None:
        return None
    p = np.tensordot(x, basis, axes=1)
    inverse = np.linalg.inv(size)
    return np.asarray(inverse @ p @ inverse)

"""Templates of Lyapunov and barrier functions: linear combinations Σ c_k φ_k of basis functions."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.dynamics import Dynamics
from surctl.verification.formula import Node, number, ordered, power, to_casadi, variable

Array = NDArray[np.float64]
Powers = tuple[int, ...]

_NEGLIGIBLE = 3e-5  # coefficients below this share of the largest one, in scaled states, are left out


@dataclass(frozen=True, eq=False)
class Template:
    """Basis functions of the states; those of a Lyapunov function vanish to second order at the equilibrium.

    Attributes:
        dynamics: the dynamics.
        basis: the K basis functions.
        sizes: typical size (K,) of each basis function, by which coefficients are compared.
    """

    dynamics: Dynamics
    basis: tuple[Node, ...]
    sizes: Array

    def only(self, chosen: NDArray[np.bool_]) -> Template:
        """Return the template of the basis functions that are chosen (K,)."""
        basis = tuple(node for node, stays in zip(self.basis, chosen, strict=True) if stays)
        return Template(self.dynamics, basis, self.sizes[chosen])

    def coefficients(self, known: Mapping[Node, float]) -> Array:
        """Return the coefficients (K,) of a function with those of its basis functions, of which others have 0."""
        return np.array([known.get(node, 0.0) for node in self.basis])

    @cached_property
    def _function(self) -> ca.Function:
        d = self.dynamics
        x = ca.vertcat(*[d.symbols[s.name] for s in d.states])
        w = ca.vertcat(ca.SX(0, 1), *[d.symbols[p.name] for p in d.parameters])
        values = ca.vertcat(*[to_casadi(node, d.symbols) for node in self.basis])
        rates = ca.vertcat(*[to_casadi(node, d.symbols) for node in d.rates])
        change = ca.substitute(values, x, rates) - values if d.discrete else ca.jacobian(values, x) @ rates
        return ca.Function("features", [x, w], [ca.densify(values), ca.densify(change)], {"cse": True})

    def features(self, x: Array, w: Array) -> tuple[Array, Array]:
        """Return φ (K, N), and φ' or φ(x⁺) − φ(x) (K, N), at states x (n, N) for parameters w (m,)."""
        values, change = self._function(x, np.repeat(w[:, None], x.shape[1], axis=1))
        return np.asarray(values), np.asarray(change)

    def function(self, coefficients: Array, digits: int = 4) -> Node:
        """Return Σ c_k φ_k with coefficients (K,) rounded to `digits` digits; negligible terms are left out."""
        share = np.abs(coefficients) * self.sizes
        total: Node | None = None
        for c, size, node in zip(coefficients, share, self.basis, strict=True):
            if not size > _NEGLIGIBLE * share.max():
                continue
            value = Fraction(f"{abs(c):.{digits - 1}e}")
            term = node if value == 1 else number(value) if node == number(1) else number(value) * node
            total = (term if c > 0 else -term) if total is None else total + term if c > 0 else total - term
        assert total is not None
        return total


def polynomials(dynamics: Dynamics, degree: int, scales: Array, *, even: bool = False, whole: bool = False) -> Template:
    """Return the template of all polynomials of degree 2 to `degree` in x − x*; with `whole`, 0 to `degree` in x.

    Args:
        dynamics: the dynamics.
        degree: largest degree.
        scales: typical deviation (n,) of each state from the equilibrium.
        even: whether to leave out the terms of odd degree.
    """
    count = len(dynamics.states)
    powers: list[Powers] = []
    for total in range(0 if whole else 2, degree + 1):
        if even and total % 2:
            continue
        picks = itertools.combinations_with_replacement(range(count), total)
        powers.extend(tuple(picked.count(k) for k in range(count)) for picked in picks)
    sizes = np.array([np.prod(scales ** np.array(p)) for p in powers])
    return Template(dynamics, tuple(_monomial(dynamics, p, whole) for p in powers), sizes)


def with_cosines(template: Template, scales: Array) -> Template:
    """Return the template with 1 − cos(x_k) for every angle: a state whose sine or cosine is part of the dynamics."""
    d = template.dynamics
    basis, sizes = list(template.basis), list(template.sizes)
    parts = {node.args[0] for node in ordered(*d.rates) if node.op in ("sin", "cos")}
    for s, scale in zip(d.states, scales, strict=True):
        if s.equilibrium == 0 and variable(s.name) in parts:
            basis.append(number(1) - Node("cos", (variable(s.name),)))
            sizes.append(1 - np.cos(min(scale, np.pi)))
    return Template(d, tuple(basis), np.array(sizes))


def quadratic(template: Template, matrix: Array) -> Array:
    """Return the coefficients of (x − x*)' P (x − x*) in a template of products of two states."""
    rows, columns = np.triu_indices(len(matrix))
    products = polynomials(template.dynamics, 2, np.ones(len(matrix))).basis
    values = np.where(rows == columns, 1.0, 2.0) * matrix[rows, columns]
    return template.coefficients(dict(zip(products, values.tolist(), strict=True)))


def _monomial(dynamics: Dynamics, powers: Sequence[int], whole: bool) -> Node:
    total: Node | None = None
    for s, exponent in zip(dynamics.states, powers, strict=True):
        if exponent:
            away = variable(s.name) if whole or s.equilibrium == 0 else variable(s.name) - number(s.rest)
            factor = power(away, exponent)
            total = factor if total is None else total * factor
    return number(1) if total is None else total

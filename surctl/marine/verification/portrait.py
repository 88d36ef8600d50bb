"""Phase portraits of a region certificate: flow, level sets in a plane of states, and violations of the decay.

V is the Lyapunov function of the certificate, and a is its decay rate. The flow is that of the certified loop,
but without thrust lag and sampling. The states are the position in the path frame
and the velocity over ground in the path frame; thrust limits and drag act along the body axes. Violations of V̇ ≤ −aV
are searched at the corners of the vehicle's parameter ranges and over headings. An area without violations is therefore
no proof; the proof is the certificate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.region_claim import axis_pairs
from surctl.certcheck.turning_claim import read_claim
from surctl.certcheck.turning_law import true_rate
from surctl.errors import InputError, nearest
from surctl.lyapunov.slope_search import form_of
from surctl.verification.formula import parse, values_of, variable

Array = NDArray[np.float64]
_Rates = Callable[[Array], Array]
"""A function that returns the rates ξ̇ (n, k) of the states ξ (n, k)."""

CRUISE_PLANES: Mapping[str, tuple[int, int]] = {"along": (0, 2), "across": (1, 3), "place": (0, 1)}
"""Planes of two states, with all other deviations 0: x_e and its velocity, y_e and its velocity, x_e and y_e."""

_STEERED_PLANES: Mapping[str, tuple[int, int]] = {"turning": (1, 3), "steering": (0, 1)}
"""Planes of two states of a craft without sway force, with all other states 0: ψ with its rate, and y_e with ψ."""

_CORNERS = 32  # of the ranges of parameters at which the rates of a text are tried
_HEADINGS = np.linspace(0, 2 * np.pi, 16, endpoint=False)


@dataclass(frozen=True, eq=False)
class Portrait:
    """A phase portrait in a plane of two deviations ξ from the steady cruise.

    Attributes:
        plane: name of the plane, one of `planes_of`.
        x, y: grid values of the first deviation (m,) and of the second deviation (k,), in m, m/s, rad or rad/s.
        flow: (2, k, m) time derivatives of the two deviations for the nominal vehicle, which heads along the path.
        level: (k, m) values of V.
        excess: (k, m) largest V̇/V + a [1/s] found over vehicles and headings; where it is positive, V decays more
            slowly than the certified rate.
        levels: values of V to draw: the level of the innermost shell, the levels of the other shells, and 1. The
            innermost level is 0 if V decays to the equilibrium.
        lagged: whether the certificate includes thrust lag; the flow of the portrait never includes it.
    """

    plane: str
    x: Array
    y: Array
    flow: Array
    level: Array
    excess: Array
    levels: tuple[float, ...]
    lagged: bool


@dataclass(frozen=True, eq=False)
class _Loop:
    """Data of a portrait: P of V = ξᵀPξ, rates ξ̇ of the vehicle shown, and rates ξ̇ of all vehicles tried."""

    P: Array
    shown: _Rates
    tried: Iterator[_Rates]
    levels: tuple[float, ...]
    lagged: bool


def planes_of(document: Mapping[str, Any]) -> Mapping[str, tuple[int, int]]:
    """Return the planes in which a certificate can be drawn, as a mapping from plane name to indices of two states.

    Raises:
        InputError: the certificate has no level sets.
    """
    if document.get("kind") == "lyapunov" and (document["claim"]["about"] or {}).get("system") == "steered":
        return _STEERED_PLANES
    if document.get("kind") == "turning":
        return CRUISE_PLANES
    raise InputError(
        "has no level sets", key="certificate", value=document.get("kind"), remedy="give a region certificate"
    )


def portrait(document: Mapping[str, Any], plane: str, *, extent: float = 1.9, points: int = 61) -> Portrait:
    """Compute the phase portrait of a region certificate.

    Args:
        document: a certificate of kind `turning`, or about the law `steered`.
        plane: name of the plane, one of `planes_of`.
        extent: half-width of the plotted area, as a multiple of the half-axes of the ellipse V = 1.
        points: number of grid points along each axis.

    Raises:
        InputError: the certificate is of another kind, or the plane is unknown.
    """
    planes = planes_of(document)
    if plane not in planes:
        raise InputError("is not known", key="plane", value=plane, remedy=nearest(plane, planes))
    loop = {"turning": _turning, "lyapunov": _steering}[document["kind"]](document)
    first, second = planes[plane]
    # half-axes of the section of V = 1 through 0, not of its projection
    section = np.linalg.inv(loop.P[np.ix_((first, second), (first, second))])
    half = extent * np.sqrt(np.diag(section))
    x, y = (np.linspace(-h, h, points) for h in half)
    xi = np.zeros((points * points, len(loop.P)))
    xi[:, first], xi[:, second] = (grid.ravel() for grid in np.meshgrid(x, y))
    gradient = 2 * xi @ loop.P
    value = 0.5 * np.einsum("ni,ni->n", gradient, xi)
    gradient /= np.maximum(value, 1e-12)[:, None]
    growth = np.full(len(xi), -np.inf)
    for rates in loop.tried:
        growth = np.maximum(growth, np.einsum("ni,ni->n", gradient, rates(xi)))
    claim = document["claim"]
    excess = growth + (claim["rate"] if "rate" in claim else claim["motion"]["rate_per_s"])
    flow = loop.shown(xi)[:, [first, second]]
    shape = (points, points)
    return Portrait(
        plane, x, y, flow.T.reshape(2, *shape), value.reshape(shape), excess.reshape(shape), loop.levels,
        loop.lagged,
    )  # fmt: skip


def _turning(document: Mapping[str, Any]) -> _Loop:
    claim, proof = read_claim(document["claim"]), document["proof"]

    def rates(boat: Sequence[Sequence[float]], psi: float, r: float) -> _Rates:
        linear, quadratic = (float(np.mean(pair)) - 1 for pair in boat[1:])
        omega = proof["trim"][0] * linear + proof["trim"][1] * quadratic

        def rate(xi: Array) -> Array:
            state, n = xi.copy(), len(xi)
            state[:, 0] -= omega / float(claim.k1)
            state[:, 2] += float(claim.cruise)
            tiled = {
                key: np.tile(pair, (n, 1)) for key, pair in zip(("mass", "linear", "quadratic"), boat, strict=True)
            } | dict.fromkeys(("term_mass", "term"), np.ones(n))
            return true_rate(claim, tiled, state, np.full(n, psi), np.full(n, r))

        return rate

    masses = [[float(f) for f in one] for one in axis_pairs(claim.mass_factor, claim.mass_asymmetry)]
    drags = [[[float(end)] * 2] * 2 for end in sorted(set(claim.drag_factor))]
    turns = {float(claim.yaw_rate), -float(claim.yaw_rate)}
    return _Loop(
        P=_matrix(proof["P"])[:4, :4],
        shown=rates([[1.0, 1.0]] * 3, 0.0, 0.0),
        tried=(
            rates([mass, *drag], psi, r) for mass in masses for drag in drags for psi in _HEADINGS[:8] for r in turns
        ),
        levels=(proof["floor"], *(shell["level"] for shell in proof["shells"])),
        lagged=claim.behind,
    )


def _steering(document: Mapping[str, Any]) -> _Loop:
    claim = document["claim"]
    states, parameters = ([row["name"] for row in claim[key]] for key in ("states", "parameters"))
    known = {name: variable(name) for name in (*states, *parameters)}
    roots = [parse(claim["dynamics"][name], known) for name in states]
    low, high = (np.array([row[key] for row in claim["parameters"]]) for key in ("lower", "upper"))

    def rates(values: Array) -> _Rates:
        def rate(xi: Array) -> Array:
            fixed = {name: np.full(len(xi), value) for name, value in zip(parameters, values, strict=True)}
            return values_of(roots, {**dict(zip(states, xi.T, strict=True)), **fixed}).T

        return rate

    corners = np.random.default_rng(0).random((_CORNERS, len(low))) < 0.5
    return _Loop(
        P=form_of(parse(claim["function"], known), states) / claim["level"],
        shown=rates((low + high) / 2),
        tried=(rates(np.where(corner, high, low)) for corner in corners),
        levels=(0.0, 1.0),
        lagged=False,
    )


def _matrix(lower: list[list[float]]) -> Array:
    return np.array([[lower[max(i, j)][min(i, j)] for j in range(len(lower))] for i in range(len(lower))])

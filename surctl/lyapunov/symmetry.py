"""Sign symmetries of dynamics: changes of the signs of some states that map solutions to solutions."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from surctl.lyapunov.dynamics import Dynamics
from surctl.lyapunov.template import Template

__all__ = ["invariant", "sign_symmetries"]

Array = NDArray[np.float64]

_SAMPLES, _MOST_STATES = 32, 10
_SAME = 1e-9  # largest difference, relative to the largest value


def sign_symmetries(dynamics: Dynamics) -> Array:
    """Return the sign changes s (m, n) of x − x* with f(x* + s z) = s f(x* + z), other than none, judged by samples.

    Args:
        dynamics: the dynamics.
    """
    d = dynamics
    n = len(d.states)
    if n > _MOST_STATES:
        return np.zeros((0, n))
    random = np.random.default_rng(0)
    size = np.minimum(d.box[1] - d.equilibrium, d.equilibrium - d.box[0])
    z = size[:, None] * random.uniform(-1, 1, (n, _SAMPLES))
    low, high = d.ranges
    w = low[:, None] + (high - low)[:, None] * random.uniform(0, 1, (len(low), _SAMPLES))
    x = d.equilibrium[:, None]
    centre = x if d.discrete else 0.0
    rates = d.evaluate(x + z, w) - centre
    limit = _SAME * np.maximum(np.abs(rates).max(axis=1, keepdims=True), 1e-300)
    signs = [np.array(s) for s in itertools.product((1.0, -1.0), repeat=n)][1:]
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
    basis = tuple(node for node, used in zip(template.basis, keep, strict=True) if used)
    return Template(d, basis, template.sizes[keep])

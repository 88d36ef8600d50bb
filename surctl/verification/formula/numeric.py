"""Values of expressions of the claim grammar at many points, in doubles."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surctl.verification.formula.node import Node, ordered

__all__ = ["values_of"]

Array = NDArray[np.float64]

_NUMPY: Mapping[str, Callable[..., Any]] = MappingProxyType(
    {"add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "sqrt": np.sqrt,
     "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
     "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh, "exp": np.exp, "log": np.log,
     "abs": np.abs, "min": np.minimum, "max": np.maximum,
     "select": lambda a, b, x, y: np.where(np.isnan(a) | np.isnan(b), np.nan, np.where(a <= b, x, y))}
)  # fmt: skip

_POLES = frozenset({"div", "log", "pow", "powr"})


def values_of(roots: Sequence[Node], at: Mapping[str, Array]) -> Array:
    """Return the values (k, N) of expressions at points; an expression that has no value at a point is NaN there.

    A value too large for a double is infinite.

    Args:
        roots: the expressions (k).
        at: values (N,) of each variable, by name.

    Example:
        >>> import numpy as np
        >>> from surctl.verification.formula import parse, values_of, variable
        >>> values_of([parse("x^2 + 1", {"x": variable("x")})], {"x": np.array([1.0, 2.0])})
        array([[2., 5.]])
    """
    known: dict[Node, Any] = {}
    with np.errstate(all="ignore"):
        for node in ordered(*roots):
            args = [known[a] for a in node.args]
            match node.op:
                case "num":
                    known[node] = float(node.value)
                case "pi":
                    known[node] = np.pi
                case "var":
                    known[node] = at[node.name]
                case "pow" if node.value == 2:
                    known[node] = args[0] * args[0]
                case "pow" | "powr":
                    known[node] = np.where(np.isnan(args[0]), np.nan, np.power(args[0], float(node.value)))
                case _:
                    known[node] = _NUMPY[node.op](*args)
            if node.op in _POLES:  # a later division must not turn 1/0 into 0
                known[node] = np.where(np.isinf(known[node]), np.nan, known[node])
    count = len(next(iter(at.values())))
    return np.array([np.broadcast_to(known[root], (count,)) for root in roots])

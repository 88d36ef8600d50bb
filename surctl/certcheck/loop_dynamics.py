"""Comparison of a certificate's dynamics with those derived from controller and plant of a bundle; `not shown`.

A certificate of kind `lyapunov` or `barrier` states its dynamics as text. Here, the expressions of the loop are derived
from the instruction lists of plant and controller, one after the other: measurement, command, rate of the plant state,
and for a controller state z the rate (z⁺ − z)/period. For a sampled loop, the plant has held commands, which are
variables of their own; z⁺ and the commands take the place of the rate of z.

Each expression must be defined in the whole box and equal to the text; the rates of the states that the certificate
holds constant must be 0 up to rounding. What the code computes must be the expression up to a bounded rounding error
(`surctl.certcheck.rounding`). Points only show where two expressions differ.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from surctl.certcheck.bundle import Listed, Port, places
from surctl.certcheck.derivation import Derivation
from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import Undefined
from surctl.certcheck.enclosure import enclose, middle, outward, rational, span
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.inequality import Box
from surctl.certcheck.instructions import read_list
from surctl.certcheck.motion import require_defined
from surctl.certcheck.rounding import SHARE, rounding_error

__all__ = ["compare_dynamics"]

Places: TypeAlias = NDArray[np.intp]

_POINTS = 20
_FEW = 5  # points at which the size of a rate is taken
_SLACK = 1e-9  # largest difference of equal rates, relative to the largest one
_RESTS = 1e-12  # largest rate of a state at rest


def compare_dynamics(
    names: Sequence[str],
    box: Sequence[tuple[float, float]],
    dynamics: Mapping[str, str],
    vectors: Mapping[str, Sequence[float | str]],
    lists: tuple[Listed, Listed, Listed],
    period: float,
    sampled: tuple[Mapping[str, str], Mapping[str, str]] | None = None,
) -> tuple[list[str], list[str]]:
    """Compare the texts of a certificate with the loop of plant and controller.

    Args:
        names: names of the states, then of the parameters.
        box: their bounds.
        dynamics: text of the rate of each state.
        vectors: entries of `plant_state`, `controller_state`, `gains`, `parameters`, `reference` (inputs of the
            controller that are not measured) and `disturbance`; each entry is a number or one of `names`.
        lists: instruction lists of the controller, of the plant's rates and of its measurement.
        period: control period [s].
        sampled: texts of the next values of the controller's states, and of the held commands, of a sampled loop.

    Returns:
        One message for each rate or value that differs at a point of the box, and one for each other that is not shown
        to be equal.

    Raises:
        Rejected: an instruction list cannot be read, no expression is derived from it, or a vector has a wrong size.
        Undefined: a text is not defined in the box.
    """
    after_next, commands = sampled or ({}, {})
    derived = Derivation([*names, *commands])

    def vector(kind: str) -> Places:
        entries = [derived.variable(e) if isinstance(e, str) else derived.constant(e) for e in vectors[kind]]
        return np.array(entries, dtype=np.intp).reshape(-1, 1)

    def run(listed: Listed, *inputs: Places) -> list[Places]:
        block = read_list(listed.text)
        if tuple(map(len, inputs)) != block.inputs:
            raise Rejected(f"{block.name} takes vectors of {block.inputs} entries")
        return block.run(inputs, derived)

    controller, plant, measured = lists
    x, z, d, p = (vector(kind) for kind in ("plant_state", "controller_state", "disturbance", "parameters"))
    (outputs,) = run(measured, x, d, p)
    measurements = _named(measured.vectors["outputs"], outputs)
    free = [port for port in controller.vectors["inputs"] if port.name not in measurements]
    inputs = {**measurements, **_named(free, vector("reference"))}
    command, after, *_ = run(controller, z, _joined(controller.vectors["inputs"], inputs), vector("gains"))
    applied = _joined(plant.vectors["inputs"], _named(controller.vectors["commands"], command))
    if sampled is not None and len(commands) != len(applied):
        raise Rejected("the certificate does not state every command")
    held = np.array([[derived.variable(name)] for name in commands], dtype=np.intp).reshape(-1, 1)
    (flow,) = run(plant, x, held if commands else applied, d, p)
    change = [derived.apply("sub", pair) for pair in zip(after, z, strict=True)]
    if sampled is None:
        change = [derived.apply("div", (c, derived.constant(period))) for c in change]
    texts = {**dynamics, **after_next, **commands}
    entries = [*vectors["plant_state"], *vectors["controller_state"], *commands]
    moves = [isinstance(entry, str) for entry in entries]
    own = [a if sampled and m else c for a, c, m in zip(after[:, 0], change, moves[len(x) :], strict=False)]
    roots = [int(root) for root in (*flow[:, 0], *own, *applied[: len(commands), 0])]
    table, whole = derived.table, list(box)
    if any(table.entries[at].op == "inf" for at in table.needed(roots)):
        raise Rejected("an instruction list computes with infinity: no expression is derived")
    stated = {name: table.read(text) for name, text in texts.items()}
    spans = [span(*ends) for ends in box]
    whole += [outward(value) for value in enclose(table, [stated[name] for name in commands], spans)]
    differs, unknown = list[str](), list[str]()
    for entry, root in zip(entries, roots, strict=True):
        if isinstance(entry, str):
            what = f"{'rate' if entry in dynamics else 'value'} of {entry}"
            claimed, slack = stated[entry], 0.0
        else:
            what, claimed, slack = "rate of a state at rest", derived.constant(0.0), _RESTS
        if reason := _unequal(derived, claimed, root, whole, slack):
            apart = _apart(table, claimed, root, whole, slack)
            (differs if apart else unknown).append(f"{what}{apart or f': {reason}'}")
            continue
        error = rounding_error(table, root, whole, derived.constants)
        if not error <= (SHARE * _largest(table, root, whole) or _RESTS):
            unknown.append(f"{what}: the rounding of the code may change it by {error:.3g}")
    derived.require_arguments(roots, [span(*ends) for ends in whole])
    return differs, unknown


def _unequal(derived: Derivation, claimed: int, root: int, box: Box, slack: float) -> str:
    """Return why two expressions are not shown to be equal, up to a slack, where both are defined in the box."""
    table = derived.table
    try:
        if not derived.equal(claimed, root):
            if not slack:
                return "it is not shown to be the expression of the instruction lists"
            (rate,) = enclose(table, [root], [span(*ends) for ends in box])
            if not max(map(abs, outward(rate))) <= slack:
                return "it is not shown to be 0"
        require_defined(table, [root], box)
    except (Rejected, Undefined) as reason:
        return str(reason)
    return ""


def _apart(table: ExpressionTable, claimed: int, root: int, box: Box, slack: float) -> str:
    """Return a point of the box at which two expressions differ, with both values; "" if no point shows it."""
    rng = np.random.default_rng(21)
    low, high = np.array(box).T
    for point in low + (high - low) * rng.random((_POINTS, len(box))):
        at = [rational(Fraction(x)) for x in point.tolist()]
        try:
            first, second = map(middle, enclose(table, [claimed, root], at))
        except Undefined:
            continue
        if not abs(first - second) <= max(slack, _SLACK * abs(second)):
            place = ", ".join(f"{name} = {x:.6g}" for name, x in zip(table.names, point, strict=True))
            return f" at {place}: {first:.6g} certified, {second:.6g} exported"
    return ""


def _largest(table: ExpressionTable, root: int, box: Box) -> float:
    """Return the largest absolute value of an expression at some points of the box."""
    rng, largest = np.random.default_rng(22), 0.0
    low, high = np.array(box).T
    for point in low + (high - low) * rng.random((_FEW, len(box))):
        value = enclose(table, [root], [rational(Fraction(x)) for x in point.tolist()])[0]
        largest = max(largest, abs(middle(value)))
    return largest


def _named(ports: Sequence[Port], values: Places) -> dict[str, Places]:
    if sum(port.size for port in ports) != len(values):
        raise Rejected("a vector does not have the stated size")
    return {name: values[place] for name, place in places(ports).items()}


def _joined(ports: Sequence[Port], values: Mapping[str, Any]) -> Places:
    lacking = [port.name for port in ports if len(values.get(port.name, ())) != port.size]
    if lacking:
        raise Rejected(f"{', '.join(lacking)}: not connected")
    return np.vstack([values[port.name] for port in ports]) if ports else np.zeros((0, 1), dtype=np.intp)

"""Comparison of the dynamics of a certificate with the loop of an exported controller and its plant.

A certificate of kind `lyapunov` or `barrier` states its dynamics as text. Here, the instruction lists of plant and
controller are evaluated one after the other at some hundreds of points of the certificate's box: measurement, command,
rate of the plant state, and for a controller state z the rate (z⁺ − z)/period. At each point the rates must be those of
the text, and the rates of the states that the certificate holds constant must be 0. For a sampled loop, the plant is
evaluated with held commands of other points; z⁺ and the commands take the place of the rate of z.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from mpmath import libmp
from numpy.typing import NDArray

from surctl.certcheck.bundle import Listed, Port
from surctl.certcheck.document import Rejected
from surctl.certcheck.elementary import Undefined
from surctl.certcheck.enclosure import enclose, rational
from surctl.certcheck.expressions import ExpressionTable
from surctl.certcheck.instructions import evaluate, read_list
from surctl.certcheck.patience import go_on

__all__ = ["compare_dynamics", "values_at"]

Array: TypeAlias = NDArray[np.float64]

_POINTS = 200
_SLACK = 1e-9  # largest difference of equal rates, relative to the largest one of the state
_RESTS = 1e-9  # the same, of rates that must be 0, relative to the largest of all


def compare_dynamics(
    names: Sequence[str],
    box: Sequence[tuple[float, float]],
    dynamics: Mapping[str, str],
    vectors: Mapping[str, Sequence[float | str]],
    lists: tuple[Listed, Listed, Listed],
    period: float,
    sampled: tuple[Mapping[str, str], Mapping[str, str]] | None = None,
) -> str:
    """Return where the dynamics differ from the loop of plant and controller; "" if they agree at all points.

    Args:
        names: names of the states, then of the parameters.
        box: their bounds.
        dynamics: text of the rate of each state.
        vectors: entries of `plant_state`, `controller_state`, `gains`, `parameters`, `reference` (inputs of the
            controller that are not measured) and `disturbance`; each entry is a number or one of `names`.
        lists: instruction lists of the controller, of the plant's rates and of its measurement.
        period: control period [s].
        sampled: texts of the next values of the controller's states, and of the held commands, of a sampled loop.

    Raises:
        Rejected: an instruction list cannot be read, or a vector has a wrong size.
    """
    rng = np.random.default_rng(21)
    low, high = (np.array(ends)[:, None] for ends in zip(*box, strict=True))
    points = low + (high - low) * rng.random((len(names), _POINTS))
    points[:, :: _POINTS // 4] = np.where(rng.random((len(names), 4)) < 0.5, low, high)
    row = {name: points[k] for k, name in enumerate(names)}

    def vector(kind: str) -> Array:
        entries = [row[e] if isinstance(e, str) else np.full(_POINTS, e) for e in vectors[kind]]
        return np.array(entries).reshape(-1, _POINTS)

    controller, plant, measured = lists
    x, z, d, p = (vector(kind) for kind in ("plant_state", "controller_state", "disturbance", "parameters"))
    (outputs,) = evaluate(read_list(measured.text), x, d, p)
    measurements = _named(measured.vectors["outputs"], outputs)
    free = [port for port in controller.vectors["inputs"] if port.name not in measurements]
    inputs = {**measurements, **_named(free, vector("reference"))}
    signals = _joined(controller.vectors["inputs"], inputs)
    command, after, *_ = evaluate(read_list(controller.text), z, signals, vector("gains"))
    applied = _joined(plant.vectors["inputs"], _named(controller.vectors["commands"], command))
    after_next, commands = sampled or ({}, {})
    if sampled is not None and len(commands) != len(applied):
        raise Rejected("the certificate does not state every command")
    held = np.roll(applied, 1, axis=1) if commands else applied
    (flow,) = evaluate(read_list(plant.text), x, held, d, p)
    stays = np.array([not isinstance(entry, str) for entry in vectors["controller_state"]], dtype=bool)[:, None]
    own = (after - z) / period if sampled is None else np.where(stays, after - z, after)
    rates = np.vstack([flow, own, applied[: len(commands)]])
    rounding = np.max(np.abs(np.vstack([x, z])), axis=1) / period  # the difference z⁺ − z rounds by a share of z
    rounding = np.concatenate([0 * rounding[: len(x)], rounding[len(x) :], np.zeros(len(commands))])
    texts = {**dynamics, **after_next, **commands}
    claimed = values_at([*names, *commands], np.vstack([points, held[: len(commands)]]), texts)
    scale = np.max(np.abs(rates))
    entries = [*vectors["plant_state"], *vectors["controller_state"], *commands]
    for entry, rate, spare in zip(entries, rates, 1e-15 * rounding, strict=True):
        moves = isinstance(entry, str)
        own = claimed[entry] if isinstance(entry, str) else np.zeros(_POINTS)
        most = _SLACK * np.max(np.abs(rate)) if moves else _RESTS * scale
        apart = ~(np.abs(own - rate) <= most + spare)
        if apart.any():
            at = int(np.argmax(apart))
            place = ", ".join(f"{name} = {points[k, at]:.6g}" for k, name in enumerate(names))
            what = f"{'rate' if entry in dynamics else 'value'} of {entry}" if moves else "rate of a state at rest"
            return f"{what} at {place}: {own[at]:.6g} certified, {rate[at]:.6g} exported"
    return ""


def values_at(names: Sequence[str], points: Array, texts: Mapping[str, str]) -> dict[str, Array]:
    """Return the values (N,) of texts at points (n, N) of the named variables."""
    table = ExpressionTable(names)
    roots = [table.read(text) for text in texts.values()]
    rows: list[list[float]] = []
    for point in points.T:
        go_on()
        try:
            values = enclose(table, roots, [rational(Fraction(float(x))) for x in point])
        except Undefined as reason:
            raise Rejected(f"the dynamics are not defined at a point of the box: {reason}") from None
        rows.append([(libmp.to_float(v.value[0]) + libmp.to_float(v.value[1])) / 2 for v in values])
    return dict(zip(texts, np.array(rows).T, strict=True))


def _named(ports: Sequence[Port], values: Array) -> dict[str, Array]:
    named: dict[str, Array] = {}
    at = 0
    for port in ports:
        named[port.name] = values[at : at + port.size]
        at += port.size
    if at != len(values):
        raise Rejected("a vector does not have the stated size")
    return named


def _joined(ports: Sequence[Port], values: Mapping[str, Any]) -> Array:
    lacking = [port.name for port in ports if len(values.get(port.name, ())) != port.size]
    if lacking:
        raise Rejected(f"{', '.join(lacking)}: not connected")
    return np.vstack([values[port.name] for port in ports]) if ports else np.zeros((0, _POINTS))

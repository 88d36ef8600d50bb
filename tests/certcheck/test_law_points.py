"""The exported law as a comparison reads it: sizes, names and units of its vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from surctl.certcheck.bundle import Listed, Manifest, Port
from surctl.certcheck.document import Rejected
from surctl.certcheck.law_points import Law, Same, values_at
from surctl.certcheck.loop_dynamics import _joined, _named
from tests.certcheck.test_bundle import bundled, loop


@cache
def exported() -> Manifest:
    return bundled(loop())


def law(ports: dict[str, Sequence[Port]] | None = None, start: Any = None, order: int = 1, **changed: Any) -> Law:
    manifest = replace(exported(), **changed)
    listed: Listed = manifest.lists[manifest.laws[0]]
    numbers = listed.numbers if start is None else {**listed.numbers, "initial_state": start}
    vectors = {**(ports or {}), **{name: own for name, own in listed.vectors.items() if name not in (ports or {})}}
    return Law(replace(listed, vectors=dict([*vectors.items()][::order]), numbers=numbers), manifest)


def refuses(says: str, call: Any, *words: Any, **changed: Any) -> None:
    with pytest.raises(Rejected, match=says):
        call(*words, **changed)


def test_the_vectors_have_the_sizes_and_names_of_the_bundle() -> None:
    law()
    for vector, ports in exported().lists[exported().laws[0]].vectors.items():
        wider = [*ports, Port("more", 1, "1")]
        refuses("do not have the stated sizes", law, {vector: wider})
    refuses("other gains or another initial state", law, start=(0.0,) * 9)
    refuses("other gains or another initial state", law, gains={"other": (2.0,)})
    refuses("the law has no speed among its state", law().part, "state", np.zeros((1, 1)), "speed")


def test_each_part_that_a_comparison_uses_has_its_unit() -> None:
    checked = 0
    for vector, ports in exported().lists[exported().laws[0]].vectors.items():
        for at, port in enumerate(ports):
            other = [*ports[:at], replace(port, name="eta"), *ports[at + 1 :]]
            gains = {**exported().gains}
            if vector == "gains":
                gains["eta"] = gains.pop(port.name)
            for order in (1, -1):  # the vector is the first, or the last
                refuses(
                    f"eta of the law is in {port.unit}, not in m, rad", law, {vector: other}, order=order, gains=gains
                )
            checked += 1
    assert checked > 4


def test_numbers_are_equal_up_to_rounding() -> None:
    same = Same(1e-9)
    first = np.array([[1.0, 2.0, 0.0]])
    assert same.apart(first, first + np.array([0, 1.9e-9, 0])).tolist() == [False] * 3
    assert same.apart(first, first + np.array([0, 0, 2.1e-9])).tolist() == [False, False, True]
    both = np.vstack([first, first])
    assert same.apart(both, both + np.array([[0, 0, 0], [1, 0, 0]])).tolist() == [True, False, False]
    assert same.apart(0 * first, 0 * first + 1e-300).all()


# the loop of a plant


def test_vectors_are_connected_by_name() -> None:
    ports = (Port("a", 2, "m"), Port("b", 1, "s"))
    values = np.arange(6.0).reshape(3, 2)
    named = _named(ports, values)
    assert named["a"].tolist() == [[0, 1], [2, 3]] and named["b"].tolist() == [[4, 5]]
    assert np.array_equal(_joined(ports, named), values)
    for other in (values[:2], np.vstack([values, values])):
        refuses("a vector does not have the stated size", _named, ports, other)
    refuses("b: not connected", _joined, ports, {"a": named["a"]})
    refuses("a: not connected", _joined, ports, {**named, "a": named["b"]})


def test_rates_are_those_of_the_text_or_not_defined() -> None:
    points = np.array([[0.25, 4.0]])
    assert values_at(["x"], points, {"x": "2*x", "y": "sqrt(x)"})["y"].tolist() == [0.5, 2.0]
    refuses("not defined at a point", values_at, ["x"], -points, {"x": "sqrt(x)"})

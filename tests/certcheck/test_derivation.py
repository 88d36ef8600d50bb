"""The expressions that the checker derives from an instruction list are those that the list computes."""

from __future__ import annotations

import json
import math
import random
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.certcheck.belonging import Belonging, compare
from surctl.certcheck.bundle import Manifest
from surctl.certcheck.derivation import Derivation
from surctl.certcheck.document import Rejected
from surctl.certcheck.enclosure import enclose, exact, middle
from surctl.certcheck.instructions import evaluate, read_list
from surctl.ir import Layout, Port
from surctl.lyapunov import continuous_dynamics
from surctl.lyapunov.claims import _plain
from surctl.system import Action, Controller, Plant, System
from tests.certcheck.test_bundle import bundled
from tests.certcheck.test_instructions_parts import BODY, GATHER, LOOP, listing

INPUTS = 3
_BINARY = ("add", "sub", "mul", "fmin", "fmax")
_COMPARE = ("lt", "le", "eq", "ne")
TRUTHS = (*_COMPARE, "and", "or", "not")


def program(draw: random.Random) -> str:
    """A program with every operation that the grammar has, whose values stay small."""
    lines = [f"v{k} = in0[{k}]" for k in range(INPUTS)]
    lines += [f"v{INPUTS + k} = const {value.hex()}" for k, value in enumerate((0.0, 1.0, 2.0, -0.5))]
    values, truths = list(range(len(lines))), list[int]()

    def put(text: str, where: list[int]) -> None:
        where.append(len(lines))
        lines.append(f"v{len(lines)} = {text}")

    def one(where: list[int]) -> str:
        return f"v{draw.choice(where)}"

    for _ in range(12):
        put(f"{draw.choice(_COMPARE)} {one(values)} {one(values)}", truths)
        truth, other = one(truths), one(truths)
        put(draw.choice((f"and {truth} {other}", f"or {truth} {other}", f"not {truth}", f"not {one(values)}")), truths)
        put(f"{draw.choice(_BINARY)} {one(values)} {one(values)}", values)
        put(f"select {one([*truths, *values])} {one(values)} {one(values)}", values)
        put(f"if_else_zero {one(truths)} {one(values)}", values)
        put(f"fabs {one(values)}", values)
        put(f"sqrt v{len(lines) - 1}", values)
        put(f"{draw.choice(('neg', 'twice'))} {one(values[:-3])}", values)
        put(f"fma {one(values[:9])} v1 {one(values)}", values)
        put(f"sq v{draw.randrange(INPUTS)}", values)
        put(f"add v{len(lines) - 1} v4", values)
        put(f"{draw.choice(('inv', 'div v0'))} v{len(lines) - 1}", values)
        put(f"mul {one(truths)} {one(values)}", values)
    outputs = " ".join(f"v{k}" for k in (*truths, *values))
    return "\n".join(["program f", f"in0 x {INPUTS}", *lines, f"out0 y {outputs}", ""])


def derived(text: str, points: np.ndarray) -> np.ndarray:
    """The values of the derived expressions at points (n, N)."""
    algebra, block = Derivation([f"x{k}" for k in range(len(points))]), read_list(text)
    places = np.array([[algebra.variable(name)] for name in algebra.table.names])
    outputs = block.run(np.split(places, np.cumsum(block.inputs)[:-1]), algebra)
    chosen = [
        algebra.apply("select", (place, *map(algebra.constant, (1.0, 0.0)))) for place in np.vstack(outputs)[:, 0]
    ]
    roots = [one if algebra.table.entries[place].op in TRUTHS else place
             for one, place in zip(chosen, np.vstack(outputs)[:, 0].tolist(), strict=True)]  # fmt: skip
    return np.array([[middle(value) for value in enclose(algebra.table, roots, [exact(x) for x in point])]
                     for point in points.T.tolist()]).T  # fmt: skip


@pytest.mark.parametrize("seed", range(6))
def test_an_expression_has_the_values_of_its_instructions(seed: int) -> None:
    text = program(random.Random(seed))
    points = np.random.default_rng(seed).choice([-1.5, -0.5, 0.0, 0.25, 1.0, 2.0], size=(INPUTS, 8))
    (expected,) = evaluate(read_list(text), points)
    assert np.allclose(derived(text, points), expected, rtol=1e-12, atol=1e-12)


COUNTING = """routine l
in s 1
in t 1
k = call {0}
g = gather t2 k width 1 lanes 1
u = loop {1} count 3 index 1 until None carried s sliced fixed g spread lanes 1
out u
"""
TURN = "program turn\nin0 k 1\nin1 s 1\nin2 t 1\nv0 = in0[0]\nv1 = in1[0]\nv2 = in2[0]\nv3 = fma v0 v2 v1\nout0 s v3\n"
ONE = "program one\nv0 = const {}\nout0 y v0\n"
FOUND = (
    "routine l\nin s 1\nin t 1\nk = call {0}\nu v = loop {1} count 5 index 0 until 1 carried s k sliced fixed t spread "
    "lanes 1\nout u\n"
)
STOPS = """program stops
in0 s 1
in1 k 1
in2 t 1
v0 = in0[0]
v1 = in1[0]
v2 = in2[0]
v3 = add v0 v2
v4 = const 0x1.0000000000000p+1
v5 = const 0x1.0000000000000p+0
v6 = add v1 v5
v7 = le v4 v6
v8 = select v7 v5 v1
out0 s v3
out1 k v8
"""


@pytest.mark.parametrize(
    "text",
    [listing(LOOP, BODY), listing(COUNTING.replace("in t 1", "in t2 3"), ONE.format("0x1.8000000000000p+0"), TURN),
     listing(COUNTING.replace("in t 1", "in t2 3"), ONE.format("0x1.2000000000000p+3"), TURN),
     listing(COUNTING.replace("in t 1", "in t2 3"), ONE.format("-0x1.2000000000000p+3"), TURN),
     listing(FOUND, ONE.format("0x0.0p+0"), STOPS.replace("add v1 v5", "add v5 v5")),
     listing(FOUND, ONE.format("0x1.0000000000000p+0"), STOPS)],
)  # fmt: skip
def test_calls_loops_and_places_are_followed(text: str) -> None:
    block = read_list(text)
    points = np.random.default_rng(1).uniform(-1, 1, (sum(block.inputs), 3))
    expected = evaluate(block, *np.split(points, np.cumsum(block.inputs)[:-1]))
    assert np.allclose(derived(text, points), np.vstack(expected), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "says"),
    [(listing(GATHER), "selects by the state"), ("procedure p\nin x 1\nout y 1\ndef f(s):\n    pass\n", "a procedure")],
)
def test_no_expression_of_a_choice_among_many_or_of_a_procedure(text: str, says: str) -> None:
    with pytest.raises(Rejected, match=says):
        derived(text, np.ones((sum(read_list(text).inputs), 1)))


# loops of a system of one's own

Build = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]
PLANTS: dict[str, Build] = {
    "product of numbers": lambda x, v, a, b: a * b * x - (a / b) * v + a * b * a,
    "sine": lambda x, v, a, b: a * ca.sin(b * x) + ca.cos(x * v) * ca.sin(ca.sin(a * v)),
    "angle": lambda x, v, a, b: ca.atan2(x, 2 + v) + a * ca.atan2(x / b, 1) + ca.acos(a * x / 4),
    "branches": lambda x, v, a, b: ca.fmin(a * x, ca.fmax(b * v, x - v)) - ca.fabs(a * b * v) * v,
    "choice": lambda x, v, a, b: ca.if_else(a * x < v, a * x * x, b * ca.if_else(v <= b, x, 0)),
    "exponentials": lambda x, v, a, b: ca.exp(a * x) * ca.log(3 + b * v) - ca.tanh(v / a) + ca.exp(v * x) ** 2,
    "composed": lambda x, v, a, b: ca.tan(a * x) + ca.asin(b * v) - ca.sinh(x) * ca.cosh(b * x) + (2 + v) ** 1.5,
    "root": lambda x, v, a, b: ca.sqrt(3 + x * a) / (2 + v * v * b) - 1 / (3 + x),
}


def own(build: Build) -> System:
    place, speed = Port("x", (1,), "m", "of the cart"), Port("v", (1,), "m/s", "of the cart")
    force = Layout((Port("f", (1,), "N", "force"),))
    numbers = Layout((Port("a", (1,), "1", "number", 0.1), Port("b", (1,), "1", "number", 0.7)))
    gains = Layout((Port("k", (1,), "N/m", "gain", 0.3), Port("c", (1,), "N s/m", "gain", 1.7)))

    def rates(x: Any, f: Any, d: Any, p: Any) -> dict[str, ca.SX]:
        return {"x": x["v"], "v": build(x["x"], x["v"], p["a"], p["b"]) + f["f"]}

    plant = Plant("cart", Layout((place, speed)), force, rates, parameters=numbers)
    law = Controller(
        "pd", 0.02, plant.state, force, lambda x, u, p: -p["k"] * u["x"] / 0.3 - p["c"] * u["v"], gains=gains
    )
    return System(plant, law)


def claim_of(system: System, **ranges: tuple[float, float]) -> dict[str, Any]:
    within = dict.fromkeys(("x", "v"), (-1.0, 1.0))
    dynamics = continuous_dynamics(system, within, ranges={f"plant.{k}": ends for k, ends in ranges.items()})
    plain: dict[str, Any] = json.loads(json.dumps(_plain(dynamics, "stability")))
    return plain


def compared(claim: dict[str, Any], manifest: Manifest, **texts: str) -> Belonging:
    return compare({"kind": "lyapunov", "claim": {**claim, "dynamics": {**claim["dynamics"], **texts}}}, manifest)


@pytest.mark.parametrize("name", PLANTS)
def test_the_loop_of_a_bundle_is_the_stated_one_everywhere_or_does_not_belong(name: str) -> None:
    system, draw = own(PLANTS[name]), random.Random(name)
    manifest = bundled(system)
    for ranges in ({}, {"a": (0.09, 0.11)}):
        claim = claim_of(system, **ranges)
        good = compared(claim, manifest)
        assert good.belongs, good
        text = claim["dynamics"]["v"]
        centre, width = draw.uniform(-1, 1), 10 ** draw.uniform(-6, -2)
        bump = compared(claim, manifest, v=f"{text} + 2e-4*max(0, 1 - abs(x - ({centre}))/{width})")
        assert not bump.belongs and all("rate of v" in text for text in (*bump.differs, *bump.undecided))
        assert not compared(claim, manifest, v=f"({text})*(1 + 1e-30)").belongs
        near = compared(claim, manifest, v=f"({text})*(1 + 1e-13)")
        assert near.undecided and not near.differs
        written = re.sub(r"\bx\b", "(3*x - 2*x)", re.sub(r"\bv\b", "(2*v - v)", text))
        assert compared(claim, manifest, v=written).belongs
        assert not compared(claim, manifest, x="v + 0*1/(x - 2) + 1e-300").belongs
    other = json.loads(json.dumps(claim))
    other["about"]["gains"]["k"] = [math.nextafter(0.3, 1)]
    assert not compare({"kind": "lyapunov", "claim": other}, manifest).belongs


def test_a_rate_that_the_code_does_not_define_everywhere_does_not_belong() -> None:
    claim = claim_of(own(PLANTS["root"]))
    away = bundled(own(lambda x, v, a, b: PLANTS["root"](x, v, a, b) * (x * x - 0.25) / ((x - 0.5) * (x + 0.5))))
    plant = next(key for key, listed in away.lists.items() if listed.text.startswith("program cart\n"))
    measured = next(key for key, listed in away.lists.items() if listed.text.startswith("program cart_measured"))
    claim["about"]["plant"] = plant + measured
    (text,) = compared(claim, away).undecided
    assert text.startswith("dynamics: rate of v: the dynamics may be undefined in the box: a division by")


def test_vectors_have_the_sizes_of_the_lists() -> None:
    system = own(PLANTS["root"])
    claim, manifest = claim_of(system), bundled(system)
    claim["about"]["parameters"] = claim["about"]["parameters"][:1]
    assert says(compared(claim, manifest).differs, "takes vectors of (2, ")


@pytest.mark.parametrize("name", ["exp", "log", "tanh", "tan", "sinh"])
def test_a_law_with_a_function_that_the_code_writes_out(name: str) -> None:
    system = own(lambda x, v, a, b: -x - v)
    law = replace(system.controller, law=lambda x, u, p: -p["k"] * getattr(ca, name)(1.5 + u["x"]) - p["c"] * u["v"])
    system = replace(system, controller=law)
    manifest = bundled(system)
    dynamics = continuous_dynamics(system, dict.fromkeys(("x", "v"), (-0.1, 0.0)))
    claim = json.loads(json.dumps(_plain(dynamics, "bound")))
    assert compared(claim, manifest).belongs
    text = claim["dynamics"]["v"]
    assert name in text
    assert not compared(claim, manifest, v=f"({text})*(1 + 1e-30)").belongs
    assert not compared(claim, manifest, v=text.replace(f"{name}(", f"{name}(1e-20 + ")).belongs


def test_an_operation_that_the_grammar_lacks_is_not_shown_to_be_any_text() -> None:
    floor = own(lambda x, v, a, b: ca.floor(1 + x / 4))
    claim = claim_of(own(lambda x, v, a, b: 1 + 0 * x))
    lists = {listed.text.split("\n")[0]: key for key, listed in bundled(floor).lists.items()}
    claim["about"]["plant"] = lists["program cart"] + lists["program cart_measured"]
    assert not compared(claim, bundled(floor)).belongs


def test_sines_of_large_arguments_do_not_belong() -> None:
    system = own(lambda x, v, a, b: ca.sin(2e6 * x))
    assert says(compared(claim_of(system), bundled(system)).differs, "no sin of an argument beyond -1.04858e+06 to")
    for first, second in ((2e6, 1), (1, 2e6)):
        system = own(lambda x, v, a, b, p=first, q=second: ca.sin(p * x) + ca.cos(q * v))
        assert says(compared(claim_of(system), bundled(system)).differs, "of an argument beyond")
    for function, argument in (("exp", 90.0), ("log", 2.0**-130)):
        system = own(lambda x, v, a, b, f=function, c=argument: getattr(ca, f)(c * (1.5 + x / 2)))
        assert says(compared(claim_of(system), bundled(system)).differs, f"no {function} of an argument beyond")
    near = own(lambda x, v, a, b: ca.sin(1e6 * x))
    assert compared(claim_of(near), bundled(near)).belongs


def test_a_state_at_rest_has_no_rate() -> None:
    place, level = Port("x", (1,), "m", "place"), Port("y", (1,), "m", "level")
    trim, hold = Port("g", (1,), "m/s", "pull", 0.3), Port("k", (1,), "1/s", "gain", 1.0)
    for drift, belongs in (("0", True), ("1e-13", True), ("1e-11", False), ("2e-4*max(0, x - 0.999)", False)):

        def rates(x: Any, f: Any, d: Any, p: Any, text: str = drift) -> dict[str, ca.SX]:
            extra = 2e-4 * ca.fmax(0, x["x"] - 0.999) if "max" in text else float(text)
            return {"x": f["f"], "y": p["g"] - p["g"] + extra}

        plant = Plant("tank", Layout((place, level)), Layout((Port("f", (1,), "m/s", "flow"),)), rates,
                      parameters=Layout((trim,)))  # fmt: skip
        law = Controller("p", 0.02, plant.state, plant.inputs, lambda x, u, p: -p["k"] * u["x"], gains=Layout((hold,)))
        still = System(Plant("tank", plant.state, plant.inputs, lambda x, f, d, p: {"x": f["f"], "y": p["g"] - p["g"]},
                             parameters=Layout((trim,))), law)  # fmt: skip
        dynamics = continuous_dynamics(still, {"x": (-1.0, 1.0)})
        claim, manifest = json.loads(json.dumps(_plain(dynamics, "stability"))), bundled(System(plant, law))
        lists = {listed.text.split("\n")[0]: key for key, listed in manifest.lists.items()}
        claim["about"]["plant"] = lists["program tank"] + lists["program tank_measured"]
        result = compare({"kind": "lyapunov", "claim": claim}, manifest)
        assert result.belongs is belongs, (drift, result)
        assert belongs or says([*result.differs, *result.undecided], "dynamics: rate of a state at rest")


def test_a_state_of_the_controller_at_rest_has_the_value_that_the_bundle_states() -> None:
    place, mode = Port("x", (1,), "m", "place"), Port("mode", (1,), "1", "of the law", 3.0)
    plant = Plant("tank", Layout((place,)), Layout((Port("f", (1,), "m/s", "flow"),)), lambda x, f, d, p: {"x": f["f"]})

    def command(x: Any, u: Any, p: Any) -> Action:
        return Action(-x["mode"] * u["x"], {"mode": x["mode"]})

    law = Controller("p", 0.02, plant.state, plant.inputs, command, state=Layout((mode,)))
    system = System(plant, law)
    claim = json.loads(json.dumps(_plain(continuous_dynamics(system, {"x": (-1.0, 1.0)}), "stability")))
    manifest, doubled = bundled(system), json.loads(json.dumps(claim))
    assert claim["about"]["controller_state"] == [3.0] and compared(claim, manifest).belongs
    doubled["about"]["controller_state"] = [6.0]
    (text,) = compared(doubled, manifest, x=f"2*({claim['dynamics']['x']})").differs
    assert text == "state of the controller[0]: 6.0 certified, 3.0 exported"


def says(texts: Any, words: str) -> bool:
    return any(words in text for text in texts)


@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("sin", math.sin),
        ("cos", math.cos),
        ("acos", math.acos),
        ("exp", math.exp),
        ("log", math.log),
        ("tanh", math.tanh),
    ],
)
def test_the_formulas_of_the_code_are_the_functions_up_to_rounding(name: str, reference: Any) -> None:
    algebra = Derivation(["x"])
    root = getattr(algebra, f"_{name}")(algebra.variable("x"))
    known = set(algebra.table.needed([root]))
    assert root not in algebra._functions and known
    draw = random.Random(1)
    for _ in range(50):
        x = abs(draw.uniform(-1, 1)) if name == "log" else draw.uniform(-1, 1)
        assert abs(valued(algebra, root, x) - reference(x)) < 1e-15


def valued(algebra: Derivation, root: int, x: float) -> float:
    """The value of a formula in doubles, with operations that the grammar does not have."""
    values: dict[int, float] = {}
    operations: dict[str, Callable[..., float]] = {
        "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b,
        "neg": lambda a: -a, "abs": abs, "min": min, "max": max, "exp": math.exp, "sqrt": math.sqrt,
        "floor": math.floor, "inf": lambda: math.inf, "lt": lambda a, b: a < b,
        "select": lambda a, b, p, q: p if a <= b else q,
    }  # fmt: skip
    for at in algebra.table.needed([root]):
        entry = algebra.table.entries[at]
        leaf = {"num": float(entry.value), "var": x}
        values[at] = leaf.get(entry.op) if entry.op in leaf else operations[entry.op](*(values[a] for a in entry.args))  # type: ignore[assignment]
    return values[root]

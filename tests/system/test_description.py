"""What does not fit together in a plant, a controller or a system is named when it is built."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError, SurctlError
from surctl.ir import Layout, Port
from surctl.system import Action, Controller, Cost, Plant, System
from tests.system.examples import ANGLE, RATE, TORQUE, level, pendulum, pendulum_plant, state_feedback


def plant(ode: Callable[..., Any], **changes: Any) -> Plant:
    return Plant("body", **{"state": Layout((ANGLE, RATE)), "inputs": Layout((TORQUE,)), "ode": ode, **changes})


def controller(law: Callable[..., Any], **changes: Any) -> Controller:
    return Controller(
        "law_of_mine", **{"dt": 0.1, "inputs": Layout((ANGLE,)), "command": Layout((TORQUE,)), "law": law, **changes}
    )


GOOD = {"angle": ca.SX(0), "rate": ca.SX(0)}
# arguments of a wrong type are the point of some mistakes, so the type checker is silenced there
MISTAKES: dict[str, tuple[Callable[[], object], str]] = {
    "missing state": (lambda: plant(lambda x, f, d, p: {"angle": x["rate"]}), r"body\.ode\.rate: is not returned"),
    "unknown state": (
        lambda: plant(lambda x, f, d, p: {**GOOD, "rat": 0}),
        r"body\.ode\.rat: is returned, but is not the name of a port",
    ),
    "wrong size": (lambda: plant(lambda x, f, d, p: ca.vertcat(1, 2, 3)), r"body\.ode: returns 3 numbers, expected 2"),
    "wrong part": (lambda: plant(lambda x, f, d, p: {**GOOD, "rate": ca.SX(2, 1)}), r"body\.ode\.rate: has 2 entries"),
    "text": (lambda: plant(lambda x, f, d, p: {**GOOD, "rate": "fast"}), r"body\.ode\.rate: is of type str"),
    "raises": (lambda: plant(lambda x, f, d, p: 1 / 0), r"body\.ode: fails on CasADi symbols \(ZeroDivisionError"),
    "branches": (
        lambda: plant(lambda x, f, d, p: {**GOOD, "rate": 1 if x["angle"] > 0 else 2}),
        r"body\.ode: fails on CasADi symbols",
    ),
    "a number": (
        lambda: plant(lambda x, f, d, p: {**GOOD, "rate": 3}),
        r"body\.ode: returns numbers, which depend on no",
    ),
    "math": (
        lambda: plant(lambda x, f, d, p: {**GOOD, "rate": math.sin(x["angle"])}),
        r"body\.ode: fails on CasADi symbols .*use casadi\.sin instead of math\.sin",
    ),
    "math in a stop": (
        lambda: replace(level(), stops={"s": lambda s: math.cos(s.x["height"]) > 1}),
        r"^stops\.s: .*use casadi\.sin",
    ),
    "unknown name": (
        lambda: plant(lambda x, f, d, p: {**GOOD, "rate": x["rat"]}),
        r"body\.ode: rat: no such name here; did you mean 'rate'",
    ),
    "no function": (lambda: plant(3), r"body\.ode: is of type int; give a function"),
    "unit None": (lambda: replace(ANGLE, unit=None), r"port angle\.unit: is not a text"),  # type: ignore[arg-type]
    "shape": (lambda: replace(ANGLE, shape=1), r"port angle\.shape = 1: is not a shape; write \(n,\)"),  # type: ignore[arg-type]
    "negative shape": (lambda: replace(ANGLE, shape=(-1,)), r"port angle\.shape = \(-1,\): is not a shape"),
    "default of another size": (
        lambda: replace(ANGLE, shape=(2,), default=(0.1, 0.2, 0.3)),
        r"port angle\.default = \(0\.1, 0\.2, 0\.3\): is not a finite number; give one finite number, .* or a list",
    ),
    "default NaN": (lambda: replace(ANGLE, default=np.nan), r"port angle\.default = nan: is not a finite number"),
    "default text": (lambda: replace(ANGLE, default="1"), r"angle\.default = '1': is not a finite"),  # type: ignore[arg-type]
    "one port": (lambda: Layout(ANGLE), r"port angle: is one port; write Layout"),  # type: ignore[arg-type]
    "texts": (lambda: Layout(("angle",)), r"Layout = 'angle': is no Port"),  # type: ignore[arg-type]
    "two ports": (lambda: Layout((ANGLE, ANGLE)), r"angle: is the name of two ports"),
    "name None": (lambda: replace(state_feedback(), name=None), r"name: is not a C identifier"),  # type: ignore[arg-type]
    "one name": (
        lambda: System(
            plant(lambda x, f, d, p: {**GOOD, "rate": f["angle"]}, inputs=Layout((replace(TORQUE, name="angle"),))),
            controller(lambda x, u, p: 0, inputs=Layout((RATE,)), command=Layout((replace(TORQUE, name="angle"),))),
        ),
        r"^angle: is the name of a state and of a command; rename one",
    ),
    "status": (lambda: controller(lambda x, u, p: Action(0, status=-5)), r"law\.status = -5\.0: is negative; return 0"),
    "built-in": (lambda: replace(state_feedback(), name="surctl_guarded"), r"surctl_guarded': begins with surctl_"),
    "numpy": (lambda: plant(lambda x, f, d, p: {**GOOD, "rate": np.interp(x["angle"], [0, 1], [0, 1])}), r"body\.ode"),
    "free symbol": (
        lambda: plant(lambda x, f, d, p: {**GOOD, "rate": ca.SX.sym("q")}),
        r"body: uses symbols that are not its arguments: q;",
    ),
    "operation": (lambda: plant(lambda x, f, d, p: {**GOOD, "rate": ca.erf(x["angle"])}), r"erf"),
    "no unit": (
        lambda: plant(lambda x, f, d, p: GOOD, inputs=Layout((replace(TORQUE, unit=" "),))),
        r"inputs\.torque: has no unit",
    ),
    "no layout": (lambda: plant(lambda x, f, d, p: GOOD, inputs=TORQUE), r"body\.inputs: is one port; write Layout"),
    "no name": (lambda: replace(pendulum_plant(), name="2nd"), r"name = '2nd': is not a C identifier"),
    "no measure": (
        lambda: replace(pendulum_plant(), outputs=Layout((ANGLE,)), measure=None),
        r"pendulum\.measure: is missing",
    ),
    "no period": (lambda: replace(state_feedback(), dt=0.0), r"state_feedback\.dt = 0\.0: is not a control period"),
    "period True": (lambda: replace(state_feedback(), dt=True), r"dt = True: is not a control period"),
    "tiny period": (
        lambda: replace(state_feedback(), dt=1e-300),
        r"dt = 1e-300: is not .* give seconds, at least 1e-09",
    ),
    "NaN period": (lambda: replace(state_feedback(), dt=np.nan), r"dt = nan: is not a control period"),
    "no command": (lambda: controller(lambda x, u, p: 0, command=Layout(())), r"commands nothing"),
    "state lost": (
        lambda: controller(lambda x, u, p: u["angle"], state=Layout((Port("z", (1,), "1", ""),))),
        r"law_of_mine\.law\.state",
    ),
    "unmatched": (
        lambda: System(
            pendulum_plant(), controller(lambda x, u, p: 0, command=Layout((replace(TORQUE, name="force"),)))
        ),
        r"pendulum\.inputs\.torque: is no command of law_of_mine",
    ),
    "other unit": (
        lambda: System(pendulum_plant(), controller(lambda x, u, p: 0, command=Layout((replace(TORQUE, unit="N"),)))),
        r"torque: is in N m, the command of law_of_mine in N; use one unit for both",
    ),
    "other size": (
        lambda: System(pendulum_plant(), controller(lambda x, u, p: 0, inputs=Layout((replace(ANGLE, shape=(2,)),)))),
        r"law_of_mine\.inputs\.angle: has 2 entries, the measured output 1",
    ),
    "figure": (lambda: replace(pendulum(), costs={"f": Cost(lambda s: s.x["angel"], "max", "rad")}), r"costs\.f"),
    "how": (lambda: replace(pendulum(), costs={"f": Cost(lambda s: 0, "sum", "1")}), r"costs\.f\.how = 'sum'"),  # type: ignore[arg-type]
    "figure in C": (
        lambda: replace(level(), costs={"f": Cost(lambda s: ca.erf(s.x["height"]), "max", "1")}),
        r"^costs\.f: operation 'erf' is not supported by the instruction list; approximate it",
    ),
    "stop in C": (
        lambda: replace(level(), stops={"s": lambda s: ca.erf(s.x["height"])}),
        r"^stops\.s: operation 'erf'",
    ),
    "reference in C": (
        lambda: replace(level(), reference=lambda t, r: {"target": ca.erf(t)}),
        r"^reference: operation 'erf'",
    ),
    "disturbance in C": (
        lambda: replace(level(), disturbance=lambda t, d: {"rain": ca.erf(t)}),
        r"^disturbance: operation 'erf' .*; approximate",
    ),
    "figure of a free symbol": (
        lambda: replace(level(), costs={"f": Cost(lambda s: ca.SX.sym("q"), "max", "1")}),
        r"^costs\.f: uses symbols that are not",
    ),
    "figure size": (
        lambda: replace(level(), costs={"f": Cost(lambda s: ca.SX(2, 1), "max", "1")}),
        r"costs\.f: returns 2",
    ),
    "reference": (lambda: replace(level(), reference=lambda t, r: {"target": t, "x": t}), r"reference\.x: is returned"),
    "substeps": (lambda: replace(level(), substeps=0), r"substeps = 0: is not a number of steps"),
    "substeps True": (lambda: replace(level(), substeps=True), r"substeps = True: is not a number of steps"),
    "too many substeps": (lambda: replace(level(), substeps=10**9), r"substeps = 1000000000: .* from 1 to 1000"),
    "costs in a list": (lambda: replace(level(), costs=[]), r"costs: is of type list; write \{"),  # type: ignore[arg-type]
    "a stop named time": (
        lambda: replace(level(), stops={"time": lambda s: s.t > 9}),
        r"^stops\.time: is the reason of",
    ),
    "figure without unit": (lambda: replace(level(), costs={"f": Cost(lambda s: s.t, "max", "")}), r"f: has no unit"),
    "bound": (
        lambda: replace(level(), costs={"f": Cost(lambda s: s.t, "max", "m", at_most=np.nan)}),
        r"^costs\.f\.at_most = nan: is not a number; give a bound in m",
    ),
    "a class": (lambda: replace(level(), controller=Controller), r"^controller: is of type type; give a surctl"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named(mistake: str) -> None:
    build, problem = MISTAKES[mistake]
    with pytest.raises(SurctlError, match=problem) as caught:
        build()
    assert "\n" not in str(caught.value)


def test_a_default_may_be_a_list() -> None:
    both = Port("q", (2,), "rad", "of two joints", (0.1, 0.2))  # type: ignore[arg-type]
    assert Layout((both,)).pack().tolist() == [0.1, 0.2]


def test_a_step_is_guarded_and_sized() -> None:
    law = state_feedback()
    p = law.gains.pack()
    assert law.step([], [0.1, 0.0], p).tau == pytest.approx([-1.97])
    assert law.step([], [1.0, 0.0], p).status == 1 and law.step([], [1.0, 0.0], p).tau == [-5.0]
    lost = law.step([], [np.nan, 0.0], p)
    assert lost.status == -2 and lost.tau == [0.0] and lost.telemetry == [0.0]
    with pytest.raises(InputError, match=r"state_feedback\.u: has 1 numbers, expected 2"):
        law.step([], [1.0], p)


def test_a_digest_follows_what_is_computed() -> None:
    assert pendulum().digest() == pendulum().digest()
    assert replace(pendulum(), substeps=2).digest() != pendulum().digest()
    other = controller(lambda x, u, p: Action(-u["angle"]))
    assert System(pendulum_plant(), other).digest() != System(pendulum_plant(), state_feedback()).digest()
    lighter = replace(pendulum_plant(), ode=lambda x, f, d, p: {"angle": x["rate"], "rate": f["torque"] + d["gust"]})
    assert replace(pendulum(), plant=lighter).digest() != pendulum().digest()

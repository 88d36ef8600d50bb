"""Regions of sampled systems: a crane with a limited force, an integrator and an uncertain load; what is left out."""

from __future__ import annotations

import importlib.util
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import mpmath
import numpy as np
import pytest

from surctl.assessment import ClosedLoop, assess
from surctl.certcheck import check_document, seal
from surctl.errors import NotApplicable
from surctl.ir import Layout, Port
from surctl.lyapunov import Problem, continuous_dynamics, find_stability, sampled_dynamics, solve
from surctl.lyapunov.equilibrium import require_common
from surctl.lyapunov.falsified import least_held_level
from surctl.lyapunov.sampled import SampledStability
from surctl.system import Action, Controller, Plant, System, find_equilibrium, run_system
from surctl.verification.formula import parse, variable

GALLERY = Path(__file__).parents[2] / "notebooks" / "gallery"


@pytest.fixture(scope="module")
def crane() -> Any:
    spec = importlib.util.spec_from_file_location("crane", GALLERY / "crane.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_crane_has_a_region_with_a_force_limit_that_acts_in_it(crane: Any) -> None:
    solution = solve(Problem(sampled_dynamics(crane.build(), crane.WITHIN), "lyapunov"), first=True)
    assert solution.verdict == "proved" and solution.sampled
    claim = solution.decision.claim  # type: ignore[union-attr]
    assert claim.dynamics.box[1, 0] > 0.9
    place, law = np.array([0.2, 0.0, 0.0, 0.0]), crane.build().controller
    assert law.step(law.initial_state(), place, law.gains.pack()).tau == [-crane.LIMIT]
    assert solution.value([*place, *law.initial_state()]) < 0.2 * claim.level


def test_a_simulated_period_is_that_of_the_system(crane: Any) -> None:
    system = crane.build()
    dynamics = sampled_dynamics(system, crane.WITHIN)
    x = np.array([0.3, -0.2, 0.1, 0.2])
    run = run_system(system, 4 * system.dt, {f"start.{n}": v for n, v in zip(dynamics.names[:4], x, strict=True)})
    states = np.hstack([run.signals[name.removeprefix("controller_")] for name in dynamics.names])
    w = [p.nominal for p in dynamics.parameters]
    for before, after in pairwise(states):
        assert np.asarray(dynamics.held(before, w)).ravel() == pytest.approx(after, abs=2e-6)
        assert np.abs(before - after).max() > 1e-3


def cart(law: Any, **ranges: tuple[float, float]) -> System:
    place, speed, force = (Port(name, (1,), unit, "") for name, unit in (("x", "m"), ("v", "m/s"), ("u", "N")))
    mass, gain = Port("mass", (1,), "kg", "", 1.0), Port("k", (1,), "N/m", "", 4.0)
    plant = Plant(
        "cart", Layout((place, speed)), Layout((force,)), parameters=Layout((mass,)),
        ode=lambda x, f, d, p: {"x": x["v"], "v": f["u"] / p["mass"]},
    )  # fmt: skip
    named = {name.replace("_", "."): ends for name, ends in ranges.items()}
    return System(plant, Controller("hold", 0.2, plant.state, plant.inputs, law, gains=Layout((gain,))), ranges=named)


WITHIN = {"x": (-1.0, 1.0), "v": (-2.0, 2.0)}


def limited(x: Any, u: Any, p: Any) -> Any:
    return ca.fmax(-1, ca.fmin(1, -p["k"] * u["x"] - 3 * u["v"]))


def test_sampling_limits_and_ranges_come_from_the_system() -> None:
    system = cart(limited, plant_mass=(0.9, 1.1))
    dynamics = sampled_dynamics(system, WITHIN)
    assert [w.name for w in dynamics.parameters] == ["plant_mass"]
    assert sampled_dynamics(system, WITHIN, ranges={"plant.mass": (0.8, 1.0)}).parameters[0].upper == 1.0
    plain = find_stability(dynamics).claim.plain()  # type: ignore[union-attr]
    assert plain["time"] == "sampled" and plain["period_s"] == 0.2
    assert plain["dynamics"] == {"x": "v", "v": "u/plant_mass"}
    assert plain["commands"] == [{"name": "u", "unit": "N", "value": "max(-1, min(1, -4*x - 3*v))"}]
    assert continuous_dynamics(system, WITHIN).sampling is None


def test_the_law_in_continuous_time_is_named_if_it_is_what_is_proved() -> None:
    # stable as a law in continuous time, unstable if it is sampled every 0.2 s
    fast = cart(lambda x, u, p: -p["k"] * 10 * u["x"] - 12 * u["v"])
    result = find_stability(sampled_dynamics(fast, WITHIN), first=True)
    assert result.verdict == "proved" and not isinstance(result.claim, SampledStability)
    for function, remedy in ((None, True), (parse("44*x^2 + x*v + v^2", {v: variable(v) for v in "xv"}), False)):
        problem = Problem(sampled_dynamics(fast, WITHIN), "lyapunov", function)
        head = solve(problem, first=True, time_limit=10.0).lines()[0]
        assert ", law in continuous time, without sampling" in head and "where the Lyapunov function V < " in head
        assert (" (try to prove the sampled loop: smaller box or shorter control period)" in head) is remedy
    stated = find_stability(sampled_dynamics(cart(limited), WITHIN), first=True, rate=0.05)
    assert isinstance(stated.claim, SampledStability)
    assert stated.claim.rate == pytest.approx(0.05 * 0.2)
    assert "by at least 0.01 of its value" in stated.claim.statement


def test_how_tight_the_level_of_a_sampled_loop_is() -> None:
    def decreases(x: Any, mass: float) -> Any:
        u = np.clip(-4 * x[0] - 3 * x[1], -1, 1) / mass
        after = np.array([x[0] + 0.2 * x[1] + 0.02 * u, x[1] + 0.2 * u])
        return value(after) < value(x)

    def value(x: Any) -> Any:
        return np.asarray(dynamics.compiled(function)(x, [1.0])).ravel()

    function = parse("4*x^2 + 2*x*v + 1.5*v^2", {name: variable(name) for name in "xv"})
    dynamics = sampled_dynamics(cart(limited, plant_mass=(0.9, 1.1)), {"x": (-1.0, 1.0), "v": (-3.0, 3.0)})
    least = least_held_level(dynamics, function, 0.0)
    assert least.cause == "decrease" and set(least.values) == {"x", "v", "plant_mass"}
    worst = np.array([[least.values["x"]], [least.values["v"]]])
    assert not decreases(worst, least.values["plant_mass"]) and value(worst) == pytest.approx(least.level)
    below = np.random.default_rng(1).uniform(*dynamics.box, (40_000, 2)).T
    below = below[:, value(below) < 0.97 * least.level]
    assert below.shape[1] > 2_000 and all(decreases(below, mass).all() for mass in (0.9, 1.0, 1.1))
    # a larger share must be lost; a small box ends the region first
    assert least_held_level(dynamics, function, 0.1).level < 0.97 * least.level
    small = least_held_level(sampled_dynamics(cart(limited), {"x": (-0.1, 0.1), "v": (-3.0, 3.0)}), function, 0.0)
    assert small.cause == "face" and small.level == pytest.approx((4 - 1 / 1.5) * 0.1**2)
    solution = solve(Problem(dynamics, "lyapunov"), first=True)
    assert solution.sampled and solution.level is not None and solution.falsified is not None
    assert 0.3 < solution.level / solution.falsified < 1 and solution.dynamics.sampling is not None


def test_a_command_with_the_name_of_a_state_has_another_one() -> None:
    place, pair = Port("u_0", (1,), "m", ""), Port("u", (2,), "m/s", "")
    plant = Plant("cart", Layout((place,)), Layout((pair,)), lambda x, f, d, p: {"u_0": f["u"][0] + f["u"][1]})
    law = Controller("hold", 0.2, plant.state, plant.inputs, lambda x, u, p: {"u": [-u["u_0"], 0 * u["u_0"]]})
    sampling = sampled_dynamics(System(plant, law), {"u_0": (-1.0, 1.0)}).sampling
    assert sampling is not None and [c.name for c in sampling.commands] == ["command_u_0", "command_u_1"]


def test_a_state_that_a_held_command_may_move_leaves_sampling_out() -> None:
    law = Controller
    place, other, rate = Port("x", (1,), "m", ""), Port("y", (1,), "m", ""), Port("u", (1,), "m/s", "")
    plant = Plant(
        "pair", Layout((place, other)), Layout((rate,)), lambda x, f, d, p: {"x": f["u"], "y": f["u"] + x["x"]}
    )
    system = System(plant, law("hold", 0.2, plant.state, plant.inputs, lambda x, u, p: -u["x"]))
    assert sampled_dynamics(system, {"x": (-1.0, 1.0)}).sampling is None
    assert sampled_dynamics(system, {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}).sampling is not None


def shifted(bend: float, integral: bool) -> System:
    """A cart on a bent track, with a load and a goal; several rest points if it has no integrator."""
    place, force, load = (Port(name, (1,), unit, "") for name, unit in (("x", "m"), ("u", "m/s"), ("load", "m/s")))
    plant = Plant(
        "track", Layout((place,)), Layout((force,)), disturbances=Layout((load,)),
        ode=lambda x, f, d, p: {"x": bend * x["x"] ** 3 + f["u"] + d["load"]},
    )  # fmt: skip

    def law(z: Any, u: Any, p: Any) -> Any:
        error = u["goal"] - u["x"]
        return Action({"u": 2 * error + sum(z.values())}, {"sum": z["sum"] + error / 8} if integral else ())

    memory = Layout((Port("sum", (1,), "m/s", ""),) if integral else ())
    inputs = Layout((place, Port("goal", (1,), "m", "")))
    return System(plant, Controller("hold", 0.125, inputs, plant.inputs, law, state=memory))


@pytest.mark.parametrize("seed", range(4))
def test_a_region_is_about_the_rest_point_of_the_margins(seed: int) -> None:
    rng = np.random.default_rng(seed)
    integral = bool(seed % 2)
    values = {"reference.goal": rng.uniform(-0.3, 0.3), "disturbance.load": rng.uniform(-0.3, 0.3)}
    system, within = shifted(1.0, integral), {"x": (-2.0, 2.0)} | ({"controller.sum": (-2.0, 2.0)} if integral else {})
    at, dynamics = find_equilibrium(system, values), sampled_dynamics(system, within, values=values)
    require_common(dynamics)
    assert dynamics.equilibrium == pytest.approx([*at.x, *at.z], abs=1e-8)
    assert dynamics.sampling is not None
    assert float(dynamics.sampling.commands[0].rest) == pytest.approx(at.f[0], abs=1e-8)
    assert np.abs(dynamics.evaluate(dynamics.equilibrium[:, None])).max() < 1e-12
    solution = solve(Problem(dynamics, "lyapunov"), first=True, time_limit=5.0)
    assert solution.verdict == "proved" and solution.sampled
    if not integral:  # the root of a cubic equation is no fraction
        stated = solution.document["claim"]
        with mpmath.workdps(40):
            goal, load = (mpmath.mpf(values[name]) for name in ("reference.goal", "disturbance.load"))
            root = mpmath.findroot(lambda x: x**3 + 2 * (goal - x) + load, at.x[0])
            assert abs(root - mpmath.mpf(Fraction(stated["equilibrium"]["x"]))) <= stated["radius"]["x"] < 1e-11


@pytest.mark.parametrize(("goal", "load", "gain"), [(0.3, -0.75, 4.0), (0.3, -0.7, 3.0)])
def test_a_shifted_loop_has_a_region_about_its_exact_rest_point(goal: float, load: float, gain: float) -> None:
    place, speed, force, drag = (Port(n, (1,), u, "") for n, u in (("x", "m"), ("v", "m/s"), ("u", "N"), ("load", "N")))
    mass = Port("mass", (1,), "kg", "", 1.0)
    plant = Plant(
        "cart", Layout((place, speed)), Layout((force,)), disturbances=Layout((drag,)), parameters=Layout((mass,)),
        ode=lambda x, f, d, p: {"x": x["v"], "v": (f["u"] + d["load"]) / p["mass"]},
    )  # fmt: skip
    inputs = Layout((*plant.state, Port("goal", (1,), "m", "")))
    law = Controller(
        "hold", 0.1, inputs, plant.inputs,
        lambda x, u, p: ca.fmax(-1, ca.fmin(1, gain * (u["goal"] - u["x"]) - 3 * u["v"])),
    )  # fmt: skip
    system = System(plant, law, ranges={"plant.mass": (0.9, 1.1)})
    dynamics = sampled_dynamics(system, WITHIN, values={"reference.goal": goal, "disturbance.load": load})
    rest = Fraction(goal) + Fraction(load) / Fraction(gain)
    assert [s.rest for s in dynamics.states] == [rest, 0]
    assert dynamics.sampling is not None and dynamics.sampling.commands[0].rest == -Fraction(load)
    solution = solve(Problem(dynamics, "lyapunov"), first=True)
    assert solution.verdict == "proved" and solution.sampled
    stated = solution.document["claim"]["equilibrium"]
    assert Fraction(stated["x"]) == rest
    for wrong in (str(rest + Fraction(1, 10**15)), "1/0", "1/-3", "0.3/2", "1e-3", " 1/3"):
        altered = dict(solution.document["claim"]) | {"equilibrium": stated | {"x": wrong}}
        evidence = {key: solution.document[key] for key in ("knots", "feedbacks")}
        assert not check_document(seal("lyapunov", altered, evidence)).accepted


@pytest.mark.parametrize(
    ("values", "ranges", "because"),
    [
        ({"disturbance.load": 3.0}, {}, "no equilibrium was found"),  # more than the limit of the command
        (
            {"reference.goal": 0.3},
            {"disturbance.load": (-1.9, 1.9)},
            "moves with disturbance.load, .*give disturbance.load=0..0 ",
        ),
        ({"reference.goal": 0.7, "disturbance.load": 0.5}, {"k": (1.5, 2.5)}, "its equilibrium moves with k"),
        ({"reference.goal": 1.5}, {}, r"not in \[-1, 1\] m"),
    ],
)
def test_a_loop_without_one_rest_point_in_the_box_has_no_region(values: Any, ranges: Any, because: str) -> None:
    system = shifted(0.0, False)
    gain = Layout((Port("k", (1,), "1/s", "", 2.0),))
    law = system.controller
    held = Controller(
        "hold", 0.125, law.inputs, law.command, gains=gain,
        law=lambda x, u, p: ca.fmax(-2, ca.fmin(2, p["k"] * (u["goal"] - u["x"]))),
    )  # fmt: skip
    system = System(system.plant, held)
    with pytest.raises(NotApplicable, match=because):
        require_common(sampled_dynamics(system, {"x": (-1.0, 1.0)}, values=values, ranges=ranges))


def test_a_loop_with_an_operation_that_no_claim_has_has_no_region_but_margins() -> None:
    def exact(x: Any, u: Any, p: Any) -> Any:
        wish = -p["k"] * u["x"] - 3 * u["v"]
        return ca.if_else(wish == limited(x, u, p), wish, limited(x, u, p))

    with pytest.raises(NotApplicable, match="operation 'eq' is not part of the claim grammar: compare by <="):
        sampled_dynamics(cart(exact), WITHIN)


def test_a_jump_is_the_cause_of_unknown_in_the_first_line() -> None:
    system = cart(limited)
    plant = Plant(
        "cart", system.plant.state, system.plant.inputs, parameters=system.plant.parameters,
        ode=lambda x, f, d, p: {"x": x["v"], "v": f["u"] + ca.if_else(x["x"] > 0.5, 0.1, 0)},
    )  # fmt: skip
    solution = solve(Problem(sampled_dynamics(System(plant, system.controller), WITHIN), "lyapunov"))
    assert solution.verdict == "unknown" and solution.seconds < 1.0
    assert "the dynamics may jump" in solution.lines()[0]
    line = assess(ClosedLoop(system, region=lambda: solution), parts=["region"]).lines[0]
    assert line.passed is None and "the dynamics may jump" in line.text

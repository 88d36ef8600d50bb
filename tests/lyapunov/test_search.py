"""Search of Lyapunov functions: equilibria, linearisation, levels with counterexamples, shapes and proofs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.lyapunov import Dynamics, continuous_dynamics, find_barrier, find_stability
from surctl.lyapunov.candidates import candidates
from surctl.lyapunov.claims import Stability
from surctl.lyapunov.decide import Decision, prove_motion
from surctl.lyapunov.equilibrium import at_equilibrium, common_quadratic, linearisation
from surctl.lyapunov.falsified import least_level, least_where
from surctl.lyapunov.from_system import NOT_COVERED
from surctl.lyapunov.near import short
from surctl.system import Action, Controller, Plant, System
from surctl.verification.formula import parse, text_of, variable
from tests.lyapunov.problems import dynamics

TRUE_AREA = 13.722
"""Area of the region of attraction of the Van der Pol oscillator in reverse time, inside its limit cycle."""


def van_der_pol(parameters: dict[str, tuple[float, float]] | None = None) -> Dynamics:
    damping = "m*(1 - x^2)*y" if parameters else "(1 - x^2)*y"
    return dynamics({"x": (-3.0, 3.0), "y": (-3.0, 3.0)}, ["-y", f"x - {damping}"], parameters)


def leavers(d: Dynamics, value: object, level: float, *, count: int, seconds: float) -> int:
    """Integrate from the border of V < level with drawn parameters; return how many solutions leave the region."""
    from scipy.integrate import solve_ivp

    random = np.random.default_rng(1)
    n = len(d.states)
    u = random.standard_normal((n, count))
    low, high = np.zeros(count), np.full(count, 2 * float(np.abs(d.box).max()))
    u /= np.linalg.norm(u, axis=0)
    w = d.ranges[0][:, None] + (d.ranges[1] - d.ranges[0])[:, None] * random.uniform(size=(d.ranges.shape[1], count))

    def v(x: np.ndarray) -> np.ndarray:
        return np.asarray(value(x, w)).reshape(-1)  # type: ignore[operator]

    for _ in range(60):  # the innermost crossing, as V grows along each of these rays
        middle = (low + high) / 2
        inside = v(u * middle) < level
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    run = solve_ivp(
        lambda _, x: d.evaluate(x.reshape(n, -1), w).reshape(-1), (0.0, seconds), (u * low).reshape(-1), rtol=1e-8,
        atol=1e-10,
    )  # fmt: skip
    worst = np.max([v(x.reshape(n, -1)) for x in run.y.T], axis=0)
    return int(np.sum((worst > level * (1 + 1e-6)) | (v(run.y[:, -1].reshape(n, -1)) > 0.5 * level)))


def test_the_region_of_van_der_pol_is_nearly_the_true_one() -> None:
    d = van_der_pol()
    outcome = list(candidates(d, linearisation(d), degree=4, seconds=15.0))
    assert [c.label for c in outcome] == ["quadratic with a fast decrease", "quadratic", "polynomial of degree 4"]
    areas = [c.volume * 36 for c in outcome[1:]]
    assert areas[0] >= 0.97 * 6.63  # the best quadratic function, by a scan of all shapes
    assert areas[1] >= 0.87 * TRUE_AREA  # study 28 has degree 6
    bound = least_level(d, outcome[2].function)
    assert bound.confirmed
    assert bound.level == pytest.approx(1, rel=0.03)
    grid = np.linspace(-3, 3, 200)
    points = np.array(np.meshgrid(grid, grid)).reshape(2, -1)
    inside = np.asarray(d.compiled(outcome[2].function)(points, np.zeros((0, points.shape[1])))) < 0.97 * bound.level
    assert inside.mean() * 36 >= 0.84 * TRUE_AREA
    assert leavers(d, d.compiled(outcome[2].function), 0.97 * bound.level, count=60, seconds=10.0) == 0


@pytest.mark.parametrize(
    ("function", "length", "time"), [(1e8, 1.0, 1.0), (1e-8, 1.0, 1.0), (1.0, 1e-4, 1.0), (1.0, 1.0, 1e7)]
)
def test_no_unit_changes_what_is_proved(function: float, length: float, time: float) -> None:
    # the least level with a counterexample is 2.304477565, as in test_decide
    x, y = f"(x/{length!r})", f"(y/{length!r})"
    slower = repr(length / time)
    rates = [f"-{slower}*{y}", f"{slower}*({x} - (1 - {x}^2)*{y})"]
    d = dynamics(dict.fromkeys("xy", (-3.0 * length, 3.0 * length)), rates)
    value = parse(f"{function!r}*(1.5*{x}^2 - {x}*{y} + {y}^2)", {name: variable(name) for name in "xy"})
    outcome = find_stability(d, function=value, time_limit=20.0)
    assert outcome.verdict == "proved"
    assert outcome.claim is not None
    assert outcome.claim.level / function == pytest.approx(0.99 * 2.304477565, rel=1e-3)


@pytest.mark.parametrize("time", [1.0, 1e9])
def test_a_failure_close_to_the_equilibrium_is_found_in_any_unit_of_time(time: float) -> None:
    d = dynamics({"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, [f"{1 / time!r}*y", f"{1 / time!r}*(-x - 0.2*y)"])
    value = parse("x^2 + 0.1*x*y + 2*y^2", {name: variable(name) for name in "xy"})
    outcome = find_stability(d, function=value, time_limit=1.0)
    assert outcome.verdict == "refuted"
    assert "close to the equilibrium" in outcome.reason


def test_unstable_and_marginal_equilibria_are_told_apart() -> None:
    unstable = find_stability(dynamics({"x": (-1.0, 1.0)}, ["k*x - x^3"], {"k": (-1.0, 0.2)}))
    assert unstable.verdict == "refuted"
    assert unstable.reason == "the linearisation has the eigenvalue 0.2 at k = 0.2"
    centre = find_stability(dynamics({"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, ["y", "-x"]), time_limit=1.0)
    assert centre.verdict == "unknown"
    assert "decides nothing" in centre.reason
    grows = dynamics({"x": (-1.0, 1.0)}, ["1.1*x - x^3"], discrete=True)
    assert "eigenvalue 1.1" in find_stability(grows).reason


def test_where_the_linearisation_decides_nothing_samples_give_a_function() -> None:
    d = dynamics({"x": (-1.0, 1.0), "y": (-1.0, 1.0)}, ["-x^3 + y", "-x - y^3"])
    outcome = find_stability(d, degree=4, first=True, time_limit=20.0)
    assert outcome.verdict == "proved"
    assert outcome.ratio > 0


def test_the_equilibrium_is_found_and_several_are_named() -> None:
    moved = at_equilibrium(dynamics({"x": (0.5, 3.0, 1.0)}, ["2 - x"]))
    assert moved.equilibrium == [2.0]
    with pytest.raises(InputError, match="several: x = -1; x = 0; x = 1"):
        at_equilibrium(dynamics({"x": (-2.0, 2.0, 0.5)}, ["x - x^3"]))
    with pytest.raises(InputError, match="the search finds none"):
        at_equilibrium(dynamics({"x": (-2.0, 2.0)}, ["1 + x^2"]))
    with pytest.raises(InputError, match="moves with the parameters"):
        at_equilibrium(dynamics({"x": (-0.3, 2.0, 0.5)}, ["k - x"], {"k": (-0.4, 0.6)}))


def test_one_quadratic_function_for_all_corners_of_the_parameters() -> None:
    # each matrix is stable, but the quadratic function of their mean does not decrease for both
    matrices = np.array([[[0.0, 1.0], [-1.0, -0.6]], [[0.0, 1.0], [-3.0, -0.6]]])
    p = common_quadratic(matrices, [1.0, 1.0], discrete=False)
    assert p is None or all(np.linalg.eigvalsh(a.T @ p + p @ a).max() < 0 for a in matrices)
    closer = np.array([[[0.0, 1.0], [-1.0, -1.0]], [[0.0, 1.0], [-2.5, -1.0]]])
    p = common_quadratic(closer, [1.0, 1.0], discrete=False)
    assert p is not None
    assert all(np.linalg.eigvalsh(a.T @ p + p @ a).max() < 0 for a in closer)
    maps = np.array([[[0.5, 0.4], [-0.4, 0.5]], [[0.5, 0.4], [-0.7, 0.5]]])
    p = common_quadratic(maps, [1.0, 1.0], discrete=True)
    assert p is not None
    assert all(np.linalg.eigvalsh(a.T @ p @ a - p).max() < 0 for a in maps)


def test_a_searched_region_is_claimed_in_the_box_that_hugs_it() -> None:
    d = dynamics({"x": (-9.0, 9.0), "y": (-9.0, 1.0)}, ["-x + y", "-y - x^3"])
    outcome = find_stability(d, degree=2, first=True, time_limit=30.0)
    assert outcome.verdict == "proved"
    claim = outcome.claim
    assert claim is not None
    low, high = claim.dynamics.box
    assert np.all(low >= d.box[0])
    assert np.all(high <= d.box[1])
    assert high[0] < 5
    # the region touches the box nearly, and nowhere reaches it
    v = d.compiled(claim.function)
    edge = np.linspace(low[1], high[1], 200)
    least = float(np.asarray(v(np.vstack([np.full(200, high[0]), edge]), np.zeros((0, 200)))).min())
    assert claim.level <= least < 1.2 * claim.level


def test_the_first_function_is_not_tried_again_at_a_level_that_was_not_proved(monkeypatch: pytest.MonkeyPatch) -> None:
    levels: list[float] = []

    def unproved(claim: Stability, **asked: Any) -> Decision:
        levels.append(claim.level)
        return replace(prove_motion(claim, **asked), verdict="unknown", document={})

    monkeypatch.setattr("surctl.lyapunov.search.prove_motion", unproved)
    monkeypatch.setattr("surctl.lyapunov.search.slope_candidate", lambda *_, **__: None)
    outcome = find_stability(dynamics({"x": (-2.0, 2.0)}, ["-x + x^3"]), degree=2, first=True, time_limit=30.0)
    assert outcome.verdict == "unknown"
    assert outcome.falsified is not None
    assert levels.count(short(0.1 * outcome.falsified.level, digits=4)) == 1


def test_a_map_has_a_region_too() -> None:
    d = dynamics({"x": (-1.0, 1.5, 0.25)}, ["0.25 + 0.5*(x - 0.25) + (x - 0.25)^2"], discrete=True)
    outcome = find_stability(d, degree=2, time_limit=30.0)
    assert outcome.verdict == "proved"
    assert outcome.ratio >= 0.9
    assert outcome.claim is not None
    assert text_of(outcome.claim.function).endswith("(x - 0.25)^2")


def test_a_barrier_is_found_in_continuous_and_in_discrete_time() -> None:
    x = {"x": variable("x"), "y": variable("y")}
    start, bad = [parse("x^2 + y^2 - 0.25", x)], [parse("1.2 - x - y", x)]
    bounds = {"x": (-2.0, 2.0), "y": (-2.0, 2.0)}
    outcome = find_barrier(dynamics(bounds, ["-x + y", "-x - y"]), start, bad, degree=2, time_limit=30.0)
    assert outcome.verdict == "proved"
    turned = dynamics(bounds, ["0.8*x + 0.3*y", "-0.3*x + 0.8*y"], discrete=True)
    assert find_barrier(turned, start, bad, degree=2, time_limit=30.0).verdict == "proved"
    reached = find_barrier(dynamics(bounds, ["1", "0"]), start, [parse("1 - x", x)], degree=2, time_limit=0.2)
    assert reached.verdict == "unknown"
    with pytest.raises(InputError, match="holds no sample"):
        find_barrier(turned, [parse("x^2 + 1", x)], bad)


def _loop(*, integral: bool) -> System:
    plant = Plant(
        "pendulum",
        state=Layout((Port("angle", (1,), "rad", ""), Port("rate", (1,), "rad/s", ""))),
        inputs=Layout((Port("torque", (1,), "N m", ""),)),
        parameters=Layout((Port("gravity", (1,), "1/s^2", "", 9.81),)),
        ode=lambda x, f, d, p: {"angle": x["rate"], "rate": p["gravity"] * ca.sin(x["angle"]) + f["torque"]},
    )
    law = Controller(
        "pd",
        dt=0.01,
        inputs=Layout((*plant.state, Port("target", (1,), "rad", ""))),
        command=plant.inputs,
        state=Layout((Port("sum", (1,), "rad s", "", 0.0),)) if integral else Layout(()),
        gains=Layout((Port("k_p", (1,), "N m/rad", "", 20.0),)),
        law=lambda x, u, p: Action(
            -p["k_p"] * (u["angle"] - u["target"]) - 6 * u["rate"] - sum(x.values()),
            {"sum": x["sum"] + 0.01 * u["angle"]} if integral else (),
        ),
    )
    return System(plant, law)


def test_dynamics_of_a_closed_loop_are_exact_and_say_what_they_leave_out() -> None:
    bounds = {"angle": (-1.0, 1.0), "rate": (-4.0, 4.0)}
    d = continuous_dynamics(_loop(integral=False), bounds, values={"k_p": 25.0}, ranges={"plant.gravity": (9.0, 10.0)})
    assert d.source == NOT_COVERED
    assert [w.name for w in d.parameters] == ["plant_gravity"]
    assert d.about["gains"] == {"k_p": [25.0]}
    rates = d.evaluate([[0.3], [0.1]], [[9.5]])[:, 0]
    assert rates == pytest.approx([0.1, 9.5 * np.sin(0.3) - 25 * 0.3 - 6 * 0.1])
    assert d.about["parameters"] == ["plant_gravity"] and d.about["plant_state"] == ["angle", "rate"]
    # a certificate for a range of a gain belongs to a controller whose gain is inside
    assert continuous_dynamics(_loop(integral=False), bounds, ranges={"k_p": (20.0, 25.0)}).about["gains"]["k_p"] == [
        "k_p"
    ]
    with pytest.raises(InputError, match=r"within\.rate"):
        continuous_dynamics(_loop(integral=False), {"angle": (-1.0, 1.0)})
    with pytest.raises(InputError, match="grvity: no such number"):
        continuous_dynamics(_loop(integral=False), bounds, values={"grvity": 9.0})
    with pytest.raises(InputError, match=r"within\.controller\.sum: is missing"):
        continuous_dynamics(_loop(integral=True), bounds)


def test_a_controller_state_is_a_state_and_a_state_that_rests_is_none() -> None:
    bounds = {"angle": (-1.0, 1.0), "rate": (-4.0, 4.0), "controller.sum": (-2.0, 2.0)}
    d = continuous_dynamics(_loop(integral=True), bounds)
    assert d.names == ("angle", "rate", "controller_sum") and d.source.startswith(NOT_COVERED) and "z+" in d.source
    rates = d.evaluate([[0.3], [0.1], [0.5]])[:, 0]
    assert rates == pytest.approx([0.1, 9.81 * np.sin(0.3) - 20 * 0.3 - 6 * 0.1 - 0.5, 0.3])
    with pytest.raises(InputError, match=r"within\.controller\.sum: has equal bounds, but moves"):
        continuous_dynamics(_loop(integral=True), {**bounds, "controller.sum": (0.0, 0.0)})
    pair, push = Port("pair", (2,), "m", ""), Port("push", (1,), "m/s", "")
    plant = Plant("pair", Layout((pair,)), Layout((push,)), lambda x, f, d, p: {"pair": [f["push"], x["pair"][1] * 2]})
    law = Controller("hold", 0.1, Layout((pair,)), Layout((push,)), lambda x, u, p: -u["pair"][0])
    d = continuous_dynamics(System(plant, law), {"pair[0]": (-1.0, 1.0), "pair[1]": (0.0, 0.0)})
    assert d.names == ("pair_0",) and d.evaluate([[0.5]])[0, 0] == -0.5
    assert continuous_dynamics(System(plant, law), {"pair[0]": (-1.0, 1.0)}).names == ("pair_0",)
    beside = continuous_dynamics(System(plant, law), {"pair[0]": (-1.0, 1.0)}, values={"start.pair[1]": 0.5})
    assert beside.about["plant_state"] == ["pair_0", 0.0]  # the search for the rest point begins beside it
    with pytest.raises(InputError, match=r"within\.pair\[1\]: has equal bounds, but moves"):
        continuous_dynamics(System(plant, law), {"pair[0]": (-1.0, 1.0), "pair[1]": (0.5, 0.5)})


@pytest.mark.parametrize("seed", range(1, 5))
def test_the_unit_of_a_state_does_not_change_its_equilibrium(seed: int) -> None:
    # a pendulum, h = 0 in continuous time; the units of states and time are powers of ten
    random = np.random.default_rng(seed)
    x, y, slow = (10.0 ** int(k) for k in random.integers(-12, 9, 3))
    at = round(float(random.uniform(0.2, 1.2)), 3)
    rates = [f"{slow!r}*{x!r}*(y/{y!r})", f"{slow!r}*{y!r}*(-sin(x/{x!r} - {at}) - 0.8*y/{y!r})"]
    states = {"x": (-x, 3 * x), "y": (-2 * y, 2 * y)}
    for discrete in (False, True):
        step = [f"{name} + {0.1 / slow!r}*({rate})" for name, rate in zip("xy", rates, strict=True)]
        d = dynamics(states, step if discrete else rates, discrete=discrete)
        assert not d.rests()  # 0 is none, although its residual is small in these units
        rest = at_equilibrium(d)
        assert rest.rests()
        assert rest.equilibrium == pytest.approx([at * x, 0.0], rel=1e-8, abs=1e-9 * y)
        assert linearisation(rest).verdict == "stable"


@pytest.mark.parametrize("width", [0.0, 2e-4])  # samples do not meet a bump as narrow as that
def test_a_state_rests_in_the_whole_box_or_is_refused(width: float) -> None:
    pair, push = Port("pair", (2,), "m", ""), Port("push", (1,), "m/s", "")
    plant = Plant(
        "pair", Layout((pair,)), Layout((push,)),
        lambda x, f, d, p: {"pair": [f["push"] + x["pair"][1], ca.fmax(0, width - ca.fabs(x["pair"][0] - 0.3))
                                     + (0.1 + 0.2 - 0.3) * x["pair"][0]]},
    )  # fmt: skip
    law = Controller("hold", 0.1, Layout((pair,)), Layout((push,)), lambda x, u, p: -u["pair"][0])
    if width:
        with pytest.raises(InputError, match=r"within\.pair\[1\]: is not shown to stay at rest in the whole box"):
            continuous_dynamics(System(plant, law), {"pair[0]": (-1.0, 1.0)})
    else:
        assert (
            "pair[1] stay at rest up to rounding"
            in continuous_dynamics(System(plant, law), {"pair[0]": (-1.0, 1.0)}).source
        )


def test_the_least_level_at_which_an_expression_is_reached_is_found_above_a_floor() -> None:
    d = dynamics({"x": (-8.0, 8.0), "y": (-8.0, 8.0)}, ["-x*(1 - x^2/9)", "-y*(1 - y^2/9)"])
    x = {"x": variable("x"), "y": variable("y")}
    function = parse("x^2 + y^2", x)
    rise = d.change(function)  # 0 at the equilibrium, and then from |x| = 3 on
    assert least_where(d, function, rise, floor=1.0) == pytest.approx(9.0, rel=1e-3)
    assert least_where(d, function, parse("max(abs(x), abs(y)) - 2", x)) == pytest.approx(4.0, rel=1e-3)
    assert least_where(d, function, parse("x - 9", x)) == np.inf

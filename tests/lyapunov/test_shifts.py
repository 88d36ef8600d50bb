"""Regions about equilibria that constant parameters move: sampled loops, files, maps; what the checker demands."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from surctl.assessment import ClosedLoop, assess
from surctl.certcheck import check_document, seal
from surctl.certcheck.document import Rejected
from surctl.certcheck.radii import require_rest
from surctl.ir import Layout, Port
from surctl.lyapunov import Problem, find_stability, load_problem, sampled_dynamics, solve
from surctl.lyapunov.shifts import shifted
from surctl.system import Controller, Plant, System, find_equilibrium, run_system
from tests.lyapunov.problems import dynamics

WITHIN = {"angle": (-0.6, 0.6), "rate": (-3.0, 3.0)}
RANGES = {"plant.mass": (0.45, 0.55), "disturbance.gust": (-0.05, 0.1)}


def pendulum() -> System:
    angle, rate, torque = (Port(n, (1,), u, "") for n, u in (("angle", "rad"), ("rate", "rad/s"), ("torque", "N m")))
    plant = Plant(
        "pendulum", Layout((angle, rate)), Layout((torque,)),
        disturbances=Layout((Port("gust", (1,), "N m", ""),)), parameters=Layout((Port("mass", (1,), "kg", "", 0.5),)),
        ode=lambda x, f, d, p: {
            "angle": x["rate"],
            "rate": (f["torque"] + d["gust"] + p["mass"] * 3.924 * ca.sin(x["angle"])) / (0.16 * p["mass"]),
        },
    )  # fmt: skip
    law = Controller(
        "balance", 0.01, plant.state, plant.inputs,
        lambda x, u, p: ca.fmin(ca.fmax(-6 * u["angle"] - 0.8 * u["rate"], -5), 5),
    )  # fmt: skip
    return System(plant, law, ranges=RANGES)


@pytest.fixture(scope="module")
def proved() -> Any:
    return solve(Problem(sampled_dynamics(pendulum(), WITHIN), "lyapunov"), first=True)


def test_the_solutions_of_each_constant_parameter_converge_to_its_equilibrium(proved: Any) -> None:
    assert proved.verdict == "proved" and proved.sampled
    assert "to the equilibrium of its parameters, which are constant, within the stated radii" in proved.lines()[0]
    claim, system, rng = proved.decision.claim, pendulum(), np.random.default_rng(1)
    p = np.array(proved.document["claim"]["radius"]["angle"])
    for k in range(6):
        values = {name: rng.choice(ends) if k < 4 else rng.uniform(*ends) for name, ends in RANGES.items()}
        rest = find_equilibrium(system, values).x
        assert abs(rest[0] - claim.dynamics.equilibrium[0]) <= p
        turn = rng.uniform(0, 2 * np.pi)
        x = np.array([np.cos(turn), np.sin(turn)])
        height = float(claim.dynamics.compiled(claim.function)(x, [0.5, 0.0]))
        x *= np.sqrt(0.999 * claim.level / height)
        run = run_system(system, 6.0, {**values, "start.angle": x[0], "start.rate": x[1]})
        assert abs(run["angle"][-1, 0] - rest[0]) < 1e-5


CURRENT = """
kind = "lyapunov"
name = "station"
[definitions]
w = "v - c"
[states]
x = { rate = "v", lower = -2, upper = 2, unit = "m" }
v = { rate = "(max(-20, min(20, -30*x - 10*v)) - 4*w - DRAG)/m", lower = -2, upper = 2, unit = "m/s" }
[parameters]
m = { lower = 40, upper = 60, unit = "kg" }
b = { lower = 50, upper = 70, unit = "kg/m" }
c = { lower = -0.3, upper = 0.3, unit = "m/s" }
"""


@pytest.mark.parametrize("drag", ["60*w*abs(w)", "(2 + b*abs(w))*w"])
def test_a_craft_with_quadratic_drag_keeps_its_station_in_a_current(tmp_path: Path, drag: str) -> None:
    (path := tmp_path / "station.toml").write_text(CURRENT.replace("DRAG", drag))
    found = solve(load_problem(path), first=True)
    assert found.verdict == "proved" and check_document(found.document).accepted
    claim, rng = found.decision.claim, np.random.default_rng(3)
    still = found.document["claim"]["radius"]["x"]
    for m, b, c in [(40.0, 70.0, 0.3), (60.0, 50.0, -0.3), (50.0, 60.0, 0.1)]:
        x = rng.normal(size=2)
        x *= np.sqrt(0.999 * claim.level / float(claim.dynamics.compiled(claim.function)(x, [m, b, c])))
        for _ in range(1500):
            x = x + 0.02 * np.ravel(claim.dynamics.evaluate(x[:, None], np.array([[m], [b], [c]])))
        assert abs(x[0]) <= still and abs(x[1]) < 1e-4


def test_a_region_says_how_far_it_reaches_and_whether_a_run_starts_in_it(proved: Any) -> None:
    claim, level = proved.decision.claim, proved.level
    assert level == float(f"{level:.6g}") and f"V < {level:g} " in proved.lines()[0]
    (low, high), (slow, fast) = proved.extent["angle"], proved.extent["rate"]
    for angle in (low, high):  # V = level only at one rate, and nowhere beyond
        least = min(proved.value([angle, rate]) for rate in np.linspace(slow, fast, 2001))
        assert least == pytest.approx(level, rel=1e-4)
    assert f"pendulum (angle {low:.2f} to {high:.2f} rad, rate " in proved.lines()[0]
    assert proved.to_dict()["extent"]["rate"] == [slow, fast]
    assert proved.value(claim.dynamics.equilibrium) == 0 and np.isinf(proved.value([0.7, 0.0]))
    for start, word in ((0.05, "inside"), (0.59, "outside")):
        subject = ClosedLoop(pendulum(), {"start.angle": start}, region=lambda: proved)
        result = assess(subject, parts=["region"])
        share = result.figures["start_share"].value
        assert share == pytest.approx(proved.value([start, 0.0]) / level) and (share < 1) == (word == "inside")
        text = next(line.text for line in result.lines if line.text.startswith("the run starts at V = "))
        assert f", {word} the region (V < " in text and result.accepted("region")
        assert result.caveats == [text] * (word == "outside")


def test_no_region_of_all_equilibria_is_said_once_with_a_constant_value_that_has_one() -> None:
    told = list[str]()
    wide = sampled_dynamics(pendulum(), {"angle": (-0.06, 0.06), "rate": (-0.3, 0.3)})
    assert wide.shifts
    solution = solve(Problem(wide, "lyapunov"), time_limit=2.0, progress=told.append)
    assert solution.verdict == "unknown" and "disturbance.gust=0..0 or a narrower range (the proof" in solution.reason
    assert "finds no region: give plant.mass=0.5..0.5 disturbance.gust" in solution.reason
    assert len(told) == len(set(told)) <= 1
    fixed = {"plant.mass": (0.5, 0.5), "disturbance.gust": (0.0, 0.0)}
    still = sampled_dynamics(pendulum(), {"angle": (-0.06, 0.06), "rate": (-0.3, 0.3)}, ranges=fixed)
    assert solve(Problem(still, "lyapunov"), time_limit=5.0).verdict == "proved"


def test_the_checker_demands_an_equilibrium_within_the_radii_and_room_for_it(proved: Any) -> None:
    document = proved.document
    claim = document["claim"]
    evidence = {key: document[key] for key in ("knots", "feedbacks")}

    def outcome(**changes: Any) -> str:
        return check_document(seal("lyapunov", {**claim, **changes}, evidence)).reason

    assert outcome() == ""
    smaller = {name: 0.9 * radius for name, radius in claim["radius"].items()}
    assert "not shown to exist for all parameters" in outcome(radius=smaller)
    moved = {**claim["equilibrium"], "torque": float(Fraction(claim["equilibrium"]["torque"])) + 0.05}
    assert "not shown to exist for all parameters" in outcome(equilibrium=moved)
    assert "reaches the border of the box" in outcome(level=1.3 * claim["level"])
    assert outcome(radius={name: 3 * radius for name, radius in claim["radius"].items()})
    for wrong in (False, 1, "true"):
        assert "'constant' must be true" in outcome(constant=wrong)
    without = {name: value for name, value in claim.items() if name != "constant"}  # they may vary in time
    assert not check_document(seal("lyapunov", without, evidence)).accepted
    exact = {name: value for name, value in claim.items() if name != "radius"}
    assert not check_document(seal("lyapunov", exact, evidence)).accepted


@pytest.mark.parametrize("discrete", [False, True])
def test_a_file_without_an_equilibrium_has_a_region_about_those_of_constant_parameters(
    tmp_path: Path, discrete: bool
) -> None:
    file = tmp_path / "held.toml"
    rate = "x + 0.2*(load - k*x - x^3)" if discrete else "load - k*x - x^3"
    file.write_text(
        f"""kind = "lyapunov"
name = "held"
time = "{"discrete" if discrete else "continuous"}"
[states]
x = {{ {"next" if discrete else "rate"} = "{rate}", lower = -2, upper = 2, unit = "m" }}
[parameters]
k = {{ lower = 1, upper = 1.2 }}
load = {{ lower = 0.2, upper = 0.4 }}
"""
    )
    solution = solve(load_problem(file), first=True)
    assert solution.verdict == "proved"
    claim = solution.document["claim"]
    assert claim["constant"] is True and check_document(solution.document).accepted
    for k in (1.0, 1.2):
        for load in (0.2, 0.4):
            [rest] = [r.real for r in np.roots([1, 0, k, -load]) if abs(r.imag) < 1e-9]
            assert abs(rest - float(claim["equilibrium"]["x"])) <= claim["radius"]["x"]


def test_other_rules_do_not_serve_where_the_equilibrium_moves() -> None:
    d = shifted(dynamics({"x": (-2.0, 2.0)}, ["k - x - x^3"], {"k": (-0.2, 0.3)}))
    assert d is not None and 0.2 < d.shifts["x"] < 0.3
    assert find_stability(d).claim is not None
    stated = find_stability(d, level=0.5)
    assert stated.verdict == "unknown" and "equilibrium moves with the parameters" in stated.reason


def test_no_equilibrium_is_shown_where_there_is_none_for_some_parameter() -> None:
    def demand(low: float, high: float, radius: str = "0.35") -> None:
        require_rest(["x", "k"], [(low, high)], ["k - x^2"], [Fraction("0.9")], [Fraction(radius)])

    demand(0.5, 1.2)
    for low, high in ((-0.1, 1.0), (0.5, 1.7), (0.2, 1.0)):  # a fold; beyond the radius on either side
        with pytest.raises(Rejected, match="not shown to exist for all parameters"):
            demand(low, high)
    assert shifted(dynamics({"x": (0.0, 2.0)}, ["k - x^2"], {"k": (-0.1, 1.0)})) is None

"""Regions about an equilibrium that is one only up to rounding: stated and searched functions, sampled loops."""

from __future__ import annotations

import math
from pathlib import Path

import mpmath
import pytest

from surctl.certcheck import check_document
from surctl.ir import Layout, Port
from surctl.lyapunov import Dynamics, Problem, Stability, State, decide_motion, load_problem, sampled_dynamics, solve
from surctl.system import Controller, Plant, System
from surctl.verification.formula import parse, variable

PENDULUM = """
kind = "lyapunov"
name = "held"
[states]
a = {{ rate = "w", lower = -1, upper = 1.6, unit = "rad", equilibrium = {at!r} }}
w = {{ rate = "0.3 - sin(a) - p*w", lower = -2, upper = 2, unit = "rad/s" }}
[parameters]
p = {{ lower = {low}, upper = 0.5 }}
"""


@pytest.mark.parametrize(
    ("gap", "force", "period", "gains", "speeds"),
    [
        (0.012, 3.2e-5, 0.001, (1500, 40), 0.3),
        (0.0137, 2.7e-4 / 0.083, 0.002, (400, 9), 0.2),  # the matrix of W(0) would be semidefinite up to a tolerance
    ],
)
def test_a_magnetic_levitation_has_a_region_from_its_box_alone(
    gap: float, force: float, period: float, gains: tuple[float, float], speeds: float
) -> None:
    states = Port("gap", (1,), "m", "from the magnet", gap), Port("speed", (1,), "m/s", "away from the magnet")
    plant = Plant(
        "maglev", Layout(states), Layout((Port("i", (1,), "A", "of the coil"),)),
        ode=lambda x, u, d, p: {"gap": x["speed"], "speed": 9.81 - force * u["i"] ** 2 / x["gap"] ** 2},
    )  # fmt: skip
    rest = gap * math.sqrt(9.81 / force)
    law = Controller(
        "pd", period, plant.state, plant.inputs,
        lambda x, u, p: rest + gains[0] * (u["gap"] - gap) + gains[1] * u["speed"],
    )  # fmt: skip
    system = System(plant, law, within={"gap": (0.5 * gap, 1.5 * gap), "speed": (-speeds, speeds)})
    solution = solve(Problem(sampled_dynamics(system, system.within), "lyapunov"), first=True)
    assert solution.verdict == "proved" and solution.sampled
    claim = solution.document["claim"]
    assert set(claim["radius"]) == {"gap", "speed", "i"} and claim["radius"]["gap"] < 1e-9 * gap
    assert check_document(solution.document).accepted
    [line] = [line for line in solution.lines() if line.startswith("  equilibrium ")]
    assert line.endswith(f"speed = 0 ± {claim['radius']['speed']:g}")
    assert "every solution converges to the equilibrium within the stated radii" in solution.lines()[0]


def held(folder: Path, *, low: float = 0.5, more: str = "", digits: int = 17) -> Problem:
    file = folder / "held.toml"
    at = float(f"{math.asin(0.3):.{digits}g}")
    file.write_text(more.replace("AT", repr(at)) + PENDULUM.format(at=at, low=low))
    return load_problem(file)


def test_an_irrational_equilibrium_lies_within_its_radius(tmp_path: Path) -> None:
    solution = solve(held(tmp_path), first=True)
    assert solution.verdict == "proved"
    claim = solution.document["claim"]
    with mpmath.workdps(40):
        at = mpmath.findroot(lambda a: mpmath.mpf(3) / 10 - mpmath.sin(a), 0.3)
        assert abs(at - mpmath.mpf(repr(claim["equilibrium"]["a"]))) <= claim["radius"]["a"] < 1e-12
    assert solution.to_dict()["radius"] == claim["radius"]


def test_with_ranges_solutions_converge_to_the_box_of_the_radii(tmp_path: Path) -> None:
    solution = solve(held(tmp_path, low=0.4), first=True)
    assert solution.verdict == "proved"
    assert "to the box of the radii and, with constant parameters, to the equilibrium" in solution.lines()[0]


FUNCTION = 'function = "1.2*(a - AT)^2 + 0.5*(a - AT)*w + w^2"\n'


@pytest.mark.parametrize("digits", [17, 10])
def test_a_stated_function_and_level_are_decided(tmp_path: Path, digits: int) -> None:
    for level, verdict in ((0.05, "proved"), (4.0, "refuted")):
        claim = held(tmp_path, more=f"{FUNCTION}level = {level}\n", digits=digits).claim
        assert isinstance(claim, Stability)
        decision = decide_motion(claim)
        assert decision.verdict == verdict, decision.reason
        assert (claim.radii, bool(decision.document)) == ({}, verdict == "proved")


def test_a_stated_function_without_level_and_a_rate(tmp_path: Path) -> None:
    solution = solve(held(tmp_path, more=f"{FUNCTION}rate = 0.1\n"), first=True)
    assert solution.verdict == "proved" and solution.document["claim"]["radius"]["a"] < 1e-12
    assert solution.level is not None and solution.level > 0.1


def test_what_is_not_proved_about_such_an_equilibrium_says_what_to_do(tmp_path: Path) -> None:
    quartic = 'function = "1.2*(a - AT)^2 + 0.5*(a - AT)*w + w^2 + w^4"\nlevel = 0.05\n'
    solution = solve(held(tmp_path, more=quartic), time_limit=4.0)
    assert solution.verdict == "unknown"
    assert "about the equilibrium; the rates are 0 at the equilibrium only up to rounding" in solution.reason
    assert "ratios that are 1 (i/i_0)" in solution.reason


def test_a_marginal_equilibrium_up_to_rounding_is_not_proved() -> None:
    x = {"x": variable("x")}
    flat = Dynamics("flat", "continuous", (State("x", 0.0, 3.0, equilibrium=math.sqrt(2)),), (parse("(2 - x^2)^3", x),))
    function = parse(f"(x - {math.sqrt(2)!r})^2", x)
    assert decide_motion(Stability(flat, function, 0.1)).verdict == "unknown"

"""The assessment of a system of one's own: the worst of commands, measurements and corners; run, saturation, region."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from surctl.assessment import ClosedLoop, assess, cost_verdicts
from surctl.errors import InputError
from surctl.ir import Layout, Port
from surctl.system import Action, Controller, Cost, Plant, System, linearise, run_system
from surctl.system.linear import unresponsive
from surctl.verification import system_corners, system_disk_margin, system_margins
from tests.system.examples import pendulum

RANGES = {"plant.gravity": (6.0, 12.0), "plant.drag": (0.0, 0.5)}


def test_the_disk_margin_is_the_least_of_commands_measurements_and_corners() -> None:
    result = assess(ClosedLoop(replace(pendulum(), ranges=RANGES)))
    margins, delays = {}, {}
    for ends in [None, *product(*RANGES.values())]:
        linear = linearise(pendulum(), {} if ends is None else dict(zip(RANGES, ends, strict=True)))
        places = (("torque",), ("angle", "rate"))
        margins[ends] = min(system_disk_margin(linear, *place).guaranteed for place in places)
        delays[ends] = min(m.delay_margin_s for m in system_margins(linear, "torque", "angle", "rate"))
    worst = min(margins, key=lambda ends: margins[ends])
    disk, figures = result.figures["disk_margin"], result.figures
    assert disk.value == margins[worst] < margins[None] == figures["nominal_disk_margin"].value
    assert worst is not None and disk.where == f"plant.gravity = {worst[0]:g}, plant.drag = {worst[1]:g}"
    each = system_margins(linearise(pendulum()), "torque", "angle", "rate")
    assert figures["delay_margin_s"].value == min(delays.values()) < delays[None]
    assert figures["nominal_delay_margin_s"].value == delays[None]
    late = min(delays, key=lambda ends: delays[ends])
    assert figures["delay_margin_s"].where.endswith(f" at plant.gravity = {late[0]:g}, plant.drag = {late[1]:g}")
    assert figures["single_loop_disk_margin"].value == min(m.disk_margin for m in each)
    assert figures["delay_margin_s"].least == pendulum().dt
    # ranges that the caller states take the place of those that the system declares
    alone = assess(ClosedLoop(replace(pendulum(), ranges=RANGES), ranges={}))
    assert alone.figures["disk_margin"].value == margins[None]


def cart(limit: float = 1e3, *, k: float = 2.0, unstable: float = 0.0) -> System:
    speed, force = Port("speed", (1,), "m/s", "of the cart", 5.0), Port("force", (1,), "N", "drive")
    lamp = Port("lamp", (1,), "1", "on")

    def ode(x, f, d, p):
        root = ca.sqrt(1.5 - p["push"]) - ca.sqrt(1.5 - unstable)  # no finite rate beyond
        return {"speed": p["push"] * x["speed"] + f["force"] + root}

    plant = Plant(
        "cart", Layout((speed,)), Layout((force, lamp)), ode,
        parameters=Layout((Port("push", (1,), "1/s", "of the wind", unstable),)),
    )  # fmt: skip
    law = Controller(
        "hold", 0.1, Layout((speed,)), Layout((force, lamp)),
        lambda x, u, p: {"force": ca.fmin(ca.fmax(-k * u["speed"], -limit), limit), "lamp": 1.0},
    )  # fmt: skip
    return System(plant, law, costs={"end": Cost(lambda s: s.x["speed"] ** 2, "final", "m^2/s^2", at_most=0.5)})


@pytest.mark.parametrize(("limit", "share"), [(1e3, 0.0), (1.0, None), (0.1, 1.0)])
def test_a_run_states_costs_and_how_long_commands_do_not_respond(limit: float, share: float | None) -> None:
    system = cart(limit)
    record = run_system(system, 3.0)
    inputs = record.controller[1][:, 0]
    exact = float(np.mean(2.0 * np.abs(inputs) > limit))
    assert unresponsive(record) == {"force": exact}  # the lamp never responds, and is no limit
    assert share is None or exact == share
    result = assess(ClosedLoop(system, record=record), parts=["run"])
    assert result.figures["limited_share"].value == exact
    assert any("do not describe this run" in line.text for line in result.lines) is (exact > 0.5)
    assert result.figures["cost.end"].value == record.figures["end"]
    assert (result.passed is False) is (record.figures["end"] > 0.5)


@pytest.mark.parametrize(
    ("value", "at_most", "passed", "lasts"),
    [(1.0, 2.0, True, False), (2.5, 2.0, False, False), (9.9, 2.0, False, True), (9.9, 20.0, None, True)],
)
def test_a_last_time_at_the_end_of_the_run_is_not_known(
    value: float, at_most: float, passed: bool | None, lasts: bool
) -> None:
    cost = Cost(lambda s: s.x["speed"], "last_time", "s", at_most=at_most)
    (line,) = cost_verdicts("late", cost, value, duration=10.0, dt=0.1)
    assert line.passed is passed and line.counts and ("until the end of the run" in line.text) is lasts
    remarks = cost_verdicts("late", replace(cost, at_most=None), value, duration=10.0, dt=0.1)
    assert [one.counts for one in remarks] == [False] * lasts  # without a bound, only a remark
    assert cost_verdicts("late", replace(cost, how="max"), value, duration=10.0, dt=0.1)[0].passed is (value <= at_most)


def test_an_unstable_corner_and_one_without_equilibrium_fail() -> None:
    lines = assess(ClosedLoop(cart(), ranges={"plant.push": (0.0, 5.0)})).lines
    assert lines[0].passed is False and "no equilibrium at the corner plant.push = 5" in lines[0].text
    unstable = assess(ClosedLoop(cart(k=0.5), ranges={"plant.push": (0.0, 1.0)}))
    assert unstable.passed is False and "UNSTABLE at the corner plant.push = 1" in unstable.banner
    for name in ("disk_margin", "delay_margin_s"):
        assert unstable.figures[name].value == 0 < unstable.figures[f"nominal_{name}"].value
    assert unstable.figures["corner_slowest_pole_per_s"].value > 0 > unstable.figures["slowest_pole_per_s"].value
    nowhere = assess(ClosedLoop(cart(), {"plant.push": 2.0}))  # no finite rate anywhere
    assert nowhere.figures == {} and nowhere.passed is None and "not judged" in nowhere.lines[0].text


def test_a_marginal_loop_is_open_and_names_its_states_and_a_run_at_rest_judges_nothing() -> None:
    x, v, f = Port("x", (1,), "m", "place"), Port("v", (1,), "m/s", "speed"), Port("f", (1,), "N", "drive")
    drag = Layout((Port("drag", (1,), "1/s", "", 1.0),))
    boat = Plant(
        "boat", Layout((x, v)), Layout((f,)), lambda s, u, d, p: {"x": s["v"], "v": u["f"] - p["drag"] * s["v"]},
        parameters=drag,
    )  # fmt: skip
    goal = Port("goal", (1,), "m/s", "reference")
    law = Controller(
        "speed", 0.1, Layout((v, goal)), Layout((f,)), lambda z, u, p: p["k"] * (u["goal"] - u["v"]),
        gains=Layout((Port("k", (1,), "1/s", "", 1.0),)),
    )  # fmt: skip
    free = assess(ClosedLoop(System(boat, law), seconds=1.0))
    assert free.passed is None and free.accepted() and not free.accepted("loop")
    marginal, still = (line.text for line in free.lines if line.counts and not line.passed)
    assert "at the equilibrium is marginal (|z| = 1): nothing returns x after a disturbance" in marginal
    assert "no state changes in this run" in still and "start.x or start.v or reference.goal" in still
    sailing = assess(ClosedLoop(System(boat, law), {"reference.goal": 1.0}, seconds=1.0), parts=["run"])
    assert sailing.passed is True
    # a corner that grows is worse than the others, which are marginal
    grown = assess(ClosedLoop(System(boat, law, ranges={"plant.drag": (-2.0, 2.0)}), seconds=1.0))
    assert grown.passed is False and "UNSTABLE" in grown.banner


@pytest.mark.parametrize(
    ("verdict", "vacuous", "passed"),
    [("proved", "", True), ("proved", "empty", None), ("unknown", "", None), ("refuted", "", False)],
)
def test_a_claimed_region_counts_by_its_verdict(verdict: str, vacuous: str, passed: bool | None) -> None:
    claim = SimpleNamespace(
        verdict=verdict, vacuous=vacuous, level=2.0, falsified=8.0, lines=lambda: [f"{verdict} it"],
        value=lambda state: 3.0, sampled=True, fallback=False,
    )  # fmt: skip
    result = assess(ClosedLoop(pendulum(), region=lambda: claim))
    outside = "the run starts at V = 3, outside the region (V < 2): simulated, not proved"
    assert result.caveats == ([outside] if passed else [])
    assert [f.value for name, f in result.figures.items() if name == "start_share"] == ([1.5] if passed else [])
    assert result.passed is passed and any(f"{verdict} it" in line.text for line in result.lines)
    assert result.figures["region_share"].value == (0.25 if passed else 0.0)
    claim.value = lambda state: float("inf")  # V is not known there
    away = assess(ClosedLoop(pendulum(), region=lambda: claim)).caveats
    assert away == (["the run starts outside the box of the proof: simulated, not proved"] if passed else [])


def test_a_proof_for_the_law_in_continuous_time_does_not_cover_a_sampled_run() -> None:
    claim = SimpleNamespace(
        verdict="proved", vacuous="", level=2.0, falsified=8.0, lines=lambda: ["proved it"], value=lambda state: 1.0,
        sampled=False, fallback=True,
    )  # fmt: skip
    result = assess(ClosedLoop(pendulum(), region=lambda: claim))
    assert result.passed is None and not result.accepted("region")
    assert result.caveats == ["the run starts at V = 1, inside the region (V < 2): simulated, not proved"]
    claim.fallback = False  # the user stated the function
    stated = assess(ClosedLoop(pendulum(), region=lambda: claim))
    assert stated.accepted("region") and stated.caveats == result.caveats


def test_what_is_said_at_the_worst_corner_is_computed_there() -> None:
    swinging = replace(pendulum(), ranges=RANGES)
    loop = system_corners(swinging)
    at = linearise(swinging, {name: float(end) for name, end in (one.split(" = ") for one in loop.corner.split(", "))})
    assert loop.slowest_per_s > at.slowest_per_s, "the slowest pole is that of another corner"
    (worst,) = (line for line in loop.lines() if line.startswith("  worst of the 4 corners of the ranges: stable"))
    assert f"slowest pole {at.slowest_per_s:.3g} 1/s, " in worst and worst.endswith(f"at {loop.corner}")
    assert loop.lines()[-1] == f"  slowest pole of all corners: {loop.slowest_per_s:.3g} 1/s"


@pytest.mark.parametrize(
    ("ranges", "problem"),
    [
        ({"plant.gravit": (1.0, 2.0)}, "did you mean 'plant.gravity'"),
        ({"plant.gravity": (2.0, 1.0)}, r"ranges\.plant\.gravity.*is not a range"),
        ({"plant.gravity": (1.0, float("nan"))}, "is not a range"),
        ({"plant.gravity": 3.0}, "is not a range"),
        (dict.fromkeys(["plant.gravity", "plant.drag", "k_angle", "k_rate", "start.angle", "start.rate",
                        "disturbance.gust"], (1.0, 2.0)), "are 7: every corner is judged; keep the 6"),
    ],
)  # fmt: skip
def test_a_wrong_range_is_named(ranges, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        assess(ClosedLoop(replace(pendulum(), ranges=ranges)))


def test_a_step_that_is_too_long_along_the_run_is_found_there() -> None:
    x, u = Port("x", (1,), "m", "", 0.0), Port("u", (1,), "m/s", "")
    # slow at the start, 200/s from x = 1 on
    cell = Plant("cell", Layout((x,)), Layout((u,)), lambda s, f, d, p: {"x": f["u"] - 200 * ca.fmax(s["x"] - 1, 0)})
    law = Controller("push", 0.1, Layout((x,)), Layout((u,)), lambda z, u, p: 5 - 0.1 * u["x"])
    record = run_system(System(cell, law), 2.0)
    assert record.rough.startswith("the integration step is too long at 0.2 s: after one control period, it gives x = ")
    lines = assess(ClosedLoop(System(cell, law), record=record), parts=["run"]).lines
    assert [line.passed for line in lines if line.text == record.rough] == [None]
    needed = int(record.rough.split("substeps=")[1].split(")")[0])
    finer = run_system(System(cell, law, substeps=needed), 2.0)
    exact = run_system(System(cell, law, substeps=1000), 2.0)
    assert not finer.rough and np.abs(finer["x"] - exact["x"]).max() < 0.01 * np.ptp(exact["x"])


def test_a_command_at_its_limit_opens_the_loop() -> None:
    x, u, wind = Port("x", (1,), "m", ""), Port("u", (1,), "N", ""), Port("wind", (1,), "N", "")
    boat = Plant(
        "boat", Layout((x,)), Layout((u,)), lambda s, f, d, p: {"x": f["u"] + d["wind"] - 0.1 * s["x"]},
        disturbances=Layout((wind,)),
    )  # fmt: skip
    law = Controller("hold", 0.1, Layout((x,)), Layout((u,)), lambda z, u, p: ca.fmax(-1, ca.fmin(1, -2 * u["x"])))
    free, held = (assess(ClosedLoop(System(boat, law), {"disturbance.wind": push})) for push in (0.5, 5.0))
    assert free.accepted("loop") and not held.accepted("loop") and held.passed is None
    assert held.lines[0].text.endswith(
        "; u does not respond there (at a limit, or in a dead zone), so its loop is open"
    )
    # only at a corner of the ranges, and behind a filter of the law
    corner = System(boat, law, ranges={"disturbance.wind": (0.0, 5.0)})
    assert not assess(ClosedLoop(corner)).accepted("loop")
    smooth = Port("smooth", (1,), "N", "")
    filtered = Controller(
        "hold", 0.1, Layout((x,)), Layout((u,)),
        lambda z, i, p: Action(z["smooth"], {"smooth": 0.5 * z["smooth"] + 0.5 * ca.fmax(-1, ca.fmin(1, -2 * i["x"]))}),
        state=Layout((smooth,)),
    )  # fmt: skip
    free, held = (assess(ClosedLoop(System(boat, filtered), {"disturbance.wind": push})) for push in (0.5, 5.0))
    assert free.accepted("loop") and not held.accepted("loop")


def test_no_period_behind_a_stop_is_judged() -> None:
    x, u = Port("x", (1,), "m", "", 1.0), Port("u", (1,), "m/s", "")
    # a stiff floor at 0, which a stop at 0 never lets it reach
    ball = Plant("ball", Layout((x,)), Layout((u,)), lambda s, f, d, p: {"x": f["u"] - 1e3 * ca.fmin(s["x"], 0)})
    fall = Controller("fall", 0.1, Layout((x,)), Layout((u,)), lambda z, u, p: -1.0)
    landed = System(ball, fall, stops={"floor": lambda s: s.x["x"] < 0.05})
    record = run_system(landed, 5.0)
    assert record.stopped == "floor" and not record.rough
    assert run_system(System(ball, fall), 5.0).rough
